//! One pass over the samples: every signal filtered by 1/C(s), and the sums of the normal equations.
//!
//! The regressor φ and the instrument z are linear in the canonical states s of the filters (see `filter`) and in the
//! samples, with constant coefficients. So the sums are formed from states and samples, and are converted to
//! derivatives afterwards. A sample then needs P² + P products, and at most N multiplications for each filter. The
//! highest derivative is not computed either, as `y_f⁽ᴺ⁾` = y - `c_1` `y_f⁽ᴺ⁻¹⁾` - … - `c_N` `y_f` for C = sᴺ + `c_1`
//! sᴺ⁻¹ + … + `c_N`:
//!
//! ```text
//! θ = (Σ z φ')⁻¹ Σ z y_f⁽ᴺ⁾ = [0, c_1 … c_N] + (Σ z φ')⁻¹ Σ z (y - c_N y_eq,f)
//! ```
//!
//! The samples are processed in blocks, as filters and sums in one loop do not fit into the registers. The auxiliary
//! output x̂ of a block is filtered together with the signals of the next block, so that no filter waits for another
//! one.

use super::{
    block::{BLOCK, BankSamples, Block, Samples},
    filter::{Discrete, Hold},
    problem::{Problem, Sriv, Workspace},
    sums::{Raw, Sums, regressor},
};

/// Least number of samples that the first pass of an estimation uses, if the trace has as many.
const START_SAMPLES: usize = 200;

/// The auxiliary model of a pass.
#[derive(Clone, Copy)]
pub(crate) struct Auxiliary<'a, const N: usize, const P: usize> {
    /// Parameters of the model. A pass uses only its numerators.
    pub(crate) parameters: &'a [f64; P],
    /// Denominator of the model; `None` if it is that of the filter.
    pub(super) denominator: Option<&'a [f64; N]>,
}

/// The filters of a pass.
struct Filters<'a, const N: usize, const P: usize> {
    /// The filter 1/C, and that with the denominator of the auxiliary model.
    banks: [Bank<'a, N, P>; 2],
    /// Parameters of the auxiliary model.
    theta: &'a [f64; P],
    /// Last coefficient of the denominator of the auxiliary model.
    a_last: f64,
}

/// One filter for the inputs and the equilibrium, with the weights that give its outputs.
struct Bank<'a, const N: usize, const P: usize> {
    filter: &'a Discrete<N>,
    /// Input of each numerator column.
    input: [usize; P],
    /// Weights of each numerator column on the states of its input's filter, and on the input itself.
    state: [[f64; N]; P],
    through: [f64; P],
    /// Weights of the filtered equilibrium on the states of its filter.
    shift: [f64; N],
}

/// States of all filters before a sample.
#[derive(Clone, Copy)]
struct States<const N: usize, const S: usize> {
    banks: [BankStates<N, S>; 2],
    output: [f64; N],
    auxiliary: [f64; N],
}

#[derive(Clone, Copy)]
struct BankStates<const N: usize, const S: usize> {
    inputs: [[f64; N]; S],
    shift: [f64; N],
}

impl<const N: usize, const S: usize, const P: usize> Sriv<N, S, P> {
    /// Filters by 1/C and forms the sums. Without an auxiliary model the instrument is the regressor (least squares).
    /// Such a pass only starts the iteration, so it uses two of every `workspace.stride` samples. `None` if C cannot be
    /// discretised.
    pub(crate) fn pass(
        &self,
        problem: &Problem<S>,
        c: &[f64; N],
        auxiliary: Option<Auxiliary<N, P>>,
        workspace: &mut Workspace<P>,
    ) -> Option<Sums<P>> {
        workspace.prepare(problem.output.len(), c, problem.interval_s);
        let shifted = problem.equilibrium.is_some();
        let parameters = auxiliary.map_or(&[0.0; P], |auxiliary| auxiliary.parameters);
        let denominator = auxiliary.and_then(|auxiliary| auxiliary.denominator);
        let filtered_sums = match (auxiliary.is_some(), denominator.is_some(), shifted) {
            (false, _, false) => Self::filtered_sums::<false, false, false>,
            (false, _, true) => Self::filtered_sums::<false, false, true>,
            (true, false, false) => Self::filtered_sums::<true, false, false>,
            (true, false, true) => Self::filtered_sums::<true, false, true>,
            (true, true, false) => Self::filtered_sums::<true, true, false>,
            (true, true, true) => Self::filtered_sums::<true, true, true>,
        };
        filtered_sums(self, problem, c, (parameters, denominator.unwrap_or(c)), workspace)
    }

    /// [`Self::pass`] for one structure. `IV`: with an auxiliary model (instrumental variables). `APART`: its
    /// denominator differs from that of the filter. `SHIFTED`: with an equilibrium `y_eq`.
    fn filtered_sums<const IV: bool, const APART: bool, const SHIFTED: bool>(
        &self,
        problem: &Problem<S>,
        c: &[f64; N],
        (theta, a): (&[f64; P], &[f64; N]),
        workspace: &mut Workspace<P>,
    ) -> Option<Sums<P>> {
        let stride = workspace.stride;
        let len = problem.output.len();
        let step = if IV { 1 } else { stride.div_ceil(2).min(len / START_SAMPLES).max(1) };
        let filter = Discrete::new(c, problem.interval_s * step as f64)?;
        let own_filter = if APART { Some(Discrete::new(a, problem.interval_s)?) } else { None };
        let model_filter = own_filter.as_ref().unwrap_or(&filter);
        let banks = [&filter, model_filter].map(|filter| Bank::new(self, problem, filter));
        let filters = Filters { banks, theta, a_last: a[N - 1] };
        let linear = filter.readout(Hold::First);
        let mut kept = (stride / 2..).step_by(stride).zip(&mut workspace.instruments).peekable();
        let mut keep = |block: &Block<N, S, P>, to: usize| {
            while let Some((k, kept)) = kept.next_if(|(k, _)| *k < to) {
                let z = std::array::from_fn(|i| block.instrument::<true>(i)[k % BLOCK]);
                *kept = regressor(&z, linear, block.model[k % BLOCK], block.shift[k % BLOCK]);
            }
        };

        let mut states = filters.start(problem);
        let mut raw = Raw::ZERO;
        let mut blocks = [Block::ZERO, Block::ZERO];
        let [mut block, mut before] = blocks.each_mut();
        for from in (0..len).step_by(BLOCK * step) {
            let used = block.load(problem, from, step);
            filters.run::<IV, APART, SHIFTED, S>(&mut states, block, before);
            filters.read::<IV, APART, SHIFTED, S>(block, used);
            if !IV {
                raw.add::<IV, APART, SHIFTED, N, S>(block);
                continue;
            }
            workspace.model_output[from..from + used].copy_from_slice(&block.model[..used]);
            if from == 0 {
                states.auxiliary = linear.start(&[0.0; N], block.model[0]);
            } else {
                raw.add::<IV, APART, SHIFTED, N, S>(before);
                keep(before, from);
            }
            std::mem::swap(&mut block, &mut before);
        }
        if IV {
            filters.run::<IV, APART, SHIFTED, S>(&mut states, block, before);
            raw.add::<IV, APART, SHIFTED, N, S>(before);
            keep(before, len);
        }
        let mut raw = raw.total();
        if IV && !APART {
            raw.set_model(&theta[..P - N], a[N - 1]);
        }
        Some(raw.sums(linear, c[N - 1]))
    }
}

impl<const N: usize, const P: usize> Filters<'_, N, P> {
    /// The states of filters that are at rest at the first sample.
    fn start<const S: usize>(&self, problem: &Problem<S>) -> States<N, S> {
        let start = |filter: &Discrete<N>, hold: Hold, first: f64| filter.readout(hold).start(&[0.0; N], first);
        let banks = self.banks.each_ref().map(|bank| BankStates {
            inputs: problem.inputs.map(|(input, hold)| start(bank.filter, hold, input[0])),
            shift: [0.0; N],
        });
        let output = start(self.banks[0].filter, Hold::First, problem.output[0]);
        States { banks, output, auxiliary: [0.0; N] }
    }

    /// Filters the signals of `block`, and x̂ of the block `before` it. Inlined into its caller, the states would not
    /// stay in registers.
    #[inline(never)]
    fn run<const IV: bool, const APART: bool, const SHIFTED: bool, const S: usize>(
        &self,
        states: &mut States<N, S>,
        block: &mut Block<N, S, P>,
        before: &mut Block<N, S, P>,
    ) {
        let [own, model] = &self.banks;
        let Block { inputs, output, equilibrium, banks, phi, .. } = block;
        let Some(output_states) = phi.last_chunk_mut::<N>() else { return };
        let mut now = *states;
        for k in 0..BLOCK {
            own.store_and_advance::<SHIFTED, S>(&mut now.banks[0], inputs, equilibrium, &mut banks[0], k);
            if APART {
                model.store_and_advance::<SHIFTED, S>(&mut now.banks[1], inputs, equilibrium, &mut banks[1], k);
            }
            own.filter.store_and_advance(&mut now.output, output[k], output_states, k);
            if IV {
                own.filter.store_and_advance(&mut now.auxiliary, before.model[k], &mut before.auxiliary, k);
            }
        }
        *states = now;
    }

    /// Computes the numerator columns, `y_eq,f` and x̂ of `used` samples from the states of the filters.
    fn read<const IV: bool, const APART: bool, const SHIFTED: bool, const S: usize>(
        &self,
        block: &mut Block<N, S, P>,
        used: usize,
    ) {
        let [own, model] = &self.banks;
        for k in 0..BLOCK {
            let (mut values, mut shift) = own.read::<SHIFTED, S>(&block.banks[0], &block.inputs, k);
            for at in 0..P - N {
                block.phi[at][k] = values[at];
            }
            block.shift[k] = shift;
            block.model[k] = block.output[k];
            if IV {
                if APART {
                    (values, shift) = model.read::<SHIFTED, S>(&block.banks[1], &block.inputs, k);
                }
                let mut model = 0.0;
                for at in 0..P - N {
                    model += self.theta[at] * values[at];
                }
                if SHIFTED {
                    model += self.a_last * shift;
                }
                block.model[k] = model;
            }
        }
        // Samples after the last one must not contribute to the sums.
        for values in block.phi.iter_mut().chain([&mut block.shift]) {
            values[used..].fill(0.0);
        }
    }
}

impl<'a, const N: usize, const P: usize> Bank<'a, N, P> {
    fn new<const S: usize>(sriv: &Sriv<N, S, P>, problem: &Problem<S>, filter: &'a Discrete<N>) -> Self {
        let shift = filter.readout(Hold::Zero).state[0];
        let mut bank = Self { filter, input: [0; P], state: [[0.0; N]; P], through: [0.0; P], shift };
        for (at, (input, derivative)) in sriv.columns[..P - N].iter().enumerate() {
            let readout = filter.readout(problem.inputs[*input].1);
            bank.input[at] = *input;
            bank.state[at] = readout.state[*derivative];
            bank.through[at] = readout.through[*derivative];
        }
        bank
    }

    /// Stores the states before sample `k`, then advances them by it.
    #[inline]
    fn store_and_advance<const SHIFTED: bool, const S: usize>(
        &self,
        states: &mut BankStates<N, S>,
        inputs: &[Samples; S],
        equilibrium: &Samples,
        stored: &mut BankSamples<N, S>,
        k: usize,
    ) {
        for s in 0..S {
            self.filter.store_and_advance(&mut states.inputs[s], inputs[s][k], &mut stored.inputs[s], k);
        }
        if SHIFTED {
            self.filter.store_and_advance(&mut states.shift, equilibrium[k], &mut stored.shift, k);
        }
    }

    /// The numerator columns at sample `k`, of which the last N values are 0, and `y_eq,f`.
    #[inline]
    fn read<const SHIFTED: bool, const S: usize>(
        &self,
        states: &BankSamples<N, S>,
        inputs: &[Samples; S],
        k: usize,
    ) -> ([f64; P], f64) {
        let mut values = [0.0; P];
        for at in 0..P - N {
            // If every numerator is of order 0, column and input have the same number, known to the compiler.
            let input = if P - N == S { at } else { self.input[at] };
            values[at] = self.through[at] * inputs[input][k] + weighted(&self.state[at], &states.inputs[input], k);
        }
        (values, if SHIFTED { weighted(&self.shift, &states.shift, k) } else { 0.0 })
    }
}

/// The sum of the states at sample `k` with these weights.
#[inline]
fn weighted<const N: usize>(weights: &[f64; N], states: &[Samples; N], k: usize) -> f64 {
    let mut sum = weights[0] * states[0][k];
    for i in 1..N {
        sum += weights[i] * states[i][k];
    }
    sum
}
