//! One pass over the samples: every signal filtered by 1/C(s), and the sums of the normal equations.
//!
//! The sums are over the canonical states s of the filters (see `filter`) and the samples, and are converted to
//! derivatives afterwards: φ and z are linear in them with constant coefficients, so a sample needs P² + P products,
//! and at most N multiplications for each filter. The highest derivative is not computed either: as `y_f⁽ᴺ⁾` = y -
//! `c_1` `y_f⁽ᴺ⁻¹⁾` - … - `c_N` `y_f`,
//!
//! ```text
//! θ = (Σ z φ')⁻¹ Σ z y_f⁽ᴺ⁾ = [0, c_1 … c_N] + (Σ z φ')⁻¹ Σ z (y - c_N y_eq,f)
//! ```

use super::{
    filter::{Discrete, Hold, Readout, dot},
    problem::{Problem, Signal, Sriv, Workspace},
};

/// Least number of samples of a start.
const START_SAMPLES: usize = 200;

/// Both sides of the instrumental-variable equations, summed over the samples in one pass.
pub(super) struct Sums<const P: usize> {
    /// Σ z φ'.
    pub(super) normal: [[f64; P]; P],
    /// Σ z (y - `c_N` `y_eq,f`).
    pub(super) right: [f64; P],
}

/// The auxiliary model of a pass.
#[derive(Clone, Copy)]
pub(super) struct Auxiliary<'a, const N: usize, const P: usize> {
    /// Parameters of the model; a pass uses only their numerators.
    pub(super) parameters: &'a [f64; P],
    /// Denominator, if it differs from that of the filter.
    pub(super) denominator: Option<&'a [f64; N]>,
}

/// Sums over the raw signals: rows are (numerator columns, states of x̂), columns (numerator columns, states of y).
struct Raw<const P: usize> {
    cross: [[f64; P]; P],
    /// Σ row · y.
    output: [f64; P],
    /// Σ row · `y_eq,f`, Σ `y_eq,f` · column.
    shift_rows: [f64; P],
    shift_columns: [f64; P],
    /// Σ `y_eq,f` y, Σ `y_eq,f`².
    shift_output: f64,
    shift_square: f64,
    /// Σ x̂ · column, and x̂ with y and `y_eq,f`.
    model: [f64; P],
    model_output: f64,
    model_shift: f64,
}

/// Weights of the numerator columns on the states of the input filters.
struct Columns<const N: usize, const P: usize> {
    input: [usize; P],
    state: [[f64; N]; P],
    through: [f64; P],
}

impl<const N: usize, const P: usize> Columns<N, P> {
    fn new<const S: usize>(sriv: &Sriv<N, S, P>, holds: &[Hold; S], filter: &Discrete<N>) -> Self {
        let mut columns = Self { input: [0; P], state: [[0.0; N]; P], through: [0.0; P] };
        for (at, (input, derivative)) in sriv.columns[..P - N].iter().enumerate() {
            let readout = filter.readout(holds[*input]);
            columns.input[at] = *input;
            columns.state[at] = readout.state[*derivative];
            columns.through[at] = readout.through[*derivative];
        }
        columns
    }

    /// The numerator columns at this sample; the rest is 0.
    #[inline]
    fn read<const S: usize>(&self, states: &[[f64; N]; S], samples: &[f64; S]) -> [f64; P] {
        let mut values = [0.0; P];
        for at in 0..P - N {
            // A constant at compile time if every numerator is a constant.
            let input = if P - N == S { at } else { self.input[at] };
            values[at] = self.through[at] * samples[input];
            for i in 0..N {
                values[at] += self.state[at][i] * states[input][i];
            }
        }
        values
    }
}

impl<const N: usize, const S: usize, const P: usize> Sriv<N, S, P> {
    /// Filters by 1/C and forms the sums. Without an auxiliary model the instrument is the regressor (least squares), and
    /// only every `workspace.stride`-th sample is used, as this is a start for the iteration. `None` if C cannot be
    /// discretised.
    pub(super) fn pass(
        &self,
        problem: &Problem<S>,
        c: &[f64; N],
        auxiliary: Option<Auxiliary<N, P>>,
        workspace: &mut Workspace<P>,
    ) -> Option<Sums<P>> {
        workspace.prepare(problem.output.len(), c, problem.interval_s);
        let shifted = problem.equilibrium.is_some();
        let zero = [0.0; P];
        match auxiliary {
            None if shifted => self.filtered_sums::<false, false, true>(problem, c, (&zero, c), workspace),
            None => self.filtered_sums::<false, false, false>(problem, c, (&zero, c), workspace),
            Some(Auxiliary { parameters, denominator: None }) if shifted => {
                self.filtered_sums::<true, false, true>(problem, c, (parameters, c), workspace)
            }
            Some(Auxiliary { parameters, denominator: None }) => {
                self.filtered_sums::<true, false, false>(problem, c, (parameters, c), workspace)
            }
            Some(Auxiliary { parameters, denominator: Some(a) }) if shifted => {
                self.filtered_sums::<true, true, true>(problem, c, (parameters, a), workspace)
            }
            Some(Auxiliary { parameters, denominator: Some(a) }) => {
                self.filtered_sums::<true, true, false>(problem, c, (parameters, a), workspace)
            }
        }
    }

    /// `IV`: with an auxiliary model; `APART`: its denominator differs from that of the filter; `SHIFTED`: with `y_eq`.
    fn filtered_sums<const IV: bool, const APART: bool, const SHIFTED: bool>(
        &self,
        problem: &Problem<S>,
        c: &[f64; N],
        (theta, a): (&[f64; P], &[f64; N]),
        workspace: &mut Workspace<P>,
    ) -> Option<Sums<P>> {
        let stride = workspace.stride;
        let step = if IV { 1 } else { (stride / 2).min(problem.output.len() / START_SAMPLES).max(1) };
        let filter = Discrete::new(c, problem.interval_s * step as f64)?;
        let own_filter = if APART { Some(Discrete::new(a, problem.interval_s)?) } else { None };
        let model_filter = own_filter.as_ref().unwrap_or(&filter);
        let len = problem.output.len();
        let output = &problem.output[..len];
        let mut kept = workspace.instruments.iter_mut();
        let mut until_kept = stride / 2;
        let model_output = &mut workspace.model_output[..len];
        let holds: [Hold; S] = problem.inputs.map(|input| match input {
            Signal::Sampled(_, hold) => hold,
            Signal::Constant => Hold::Zero,
        });
        // A signal without samples is an empty slice and a constant.
        let sampled: [&[f64]; S] = problem.inputs.map(|input| match input {
            Signal::Sampled(u, _) => u,
            Signal::Constant => &[],
        });
        let constants: [f64; S] = problem.inputs.map(|input| f64::from(u8::from(matches!(input, Signal::Constant))));
        let value = |s: usize, k: usize| sampled[s].get(k).copied().unwrap_or(constants[s]);
        // Every filter starts at rest.
        let start = |filter: &Discrete<N>, s: usize| filter.readout(holds[s]).start(&[0.0; N], value(s, 0));
        let linear = filter.readout(Hold::First);
        let columns = Columns::new(self, &holds, &filter);
        let model_columns = Columns::new(self, &holds, model_filter);
        let shift_row = filter.readout(Hold::Zero).state[0];
        let model_shift_row = model_filter.readout(Hold::Zero).state[0];
        let equilibrium = &problem.equilibrium.unwrap_or(output)[..len];

        let mut input_states: [[f64; N]; S] = std::array::from_fn(|s| start(&filter, s));
        let mut model_states: [[f64; N]; S] = std::array::from_fn(|s| start(model_filter, s));
        let mut output_state = linear.start(&[0.0; N], output[0]);
        let (mut shift_state, mut model_shift_state) = ([0.0; N], [0.0; N]);
        let first = std::array::from_fn(|s| value(s, 0));
        let mut auxiliary_state =
            linear.start(&[0.0; N], combined::<N, P>(theta, &model_columns.read(&model_states, &first)));
        let mut raw = Raw::new();
        for k in (0..len).step_by(step) {
            let u: [f64; S] = std::array::from_fn(|s| value(s, k));
            let y = output[k];
            let mut phi = columns.read(&input_states, &u);
            let mut z = phi;
            let shift = if SHIFTED { dot(&shift_row, &shift_state) } else { 0.0 };
            let mut model = y;
            if IV {
                let own = if APART { model_columns.read(&model_states, &u) } else { phi };
                model = combined::<N, P>(theta, &own);
                if SHIFTED {
                    let own = if APART { dot(&model_shift_row, &model_shift_state) } else { shift };
                    model += a[N - 1] * own;
                }
                model_output[k] = model;
            }
            let auxiliary = if IV { &auxiliary_state } else { &output_state };
            for i in 0..N {
                phi[P - N + i] = output_state[i];
                z[P - N + i] = auxiliary[i];
            }
            raw.add::<IV, APART, SHIFTED>(&z, &phi, y, shift, model);
            if IV {
                if until_kept == 0 {
                    until_kept = stride;
                    if let Some(kept) = kept.next() {
                        *kept = regressor(&z, linear, model, shift);
                    }
                }
                until_kept -= 1;
            }
            for s in 0..S {
                filter.advance(&mut input_states[s], u[s]);
                if APART {
                    model_filter.advance(&mut model_states[s], u[s]);
                }
            }
            filter.advance(&mut output_state, y);
            if IV {
                filter.advance(&mut auxiliary_state, model);
            }
            if SHIFTED {
                filter.advance(&mut shift_state, equilibrium[k]);
                if APART {
                    model_filter.advance(&mut model_shift_state, equilibrium[k]);
                }
            }
        }
        if IV && !APART {
            raw.model_from_columns(&theta[..P - N], a[N - 1]);
        } else if !IV {
            raw.model_is_output();
        }
        Some(raw.sums(linear, c[N - 1]))
    }
}

impl<const P: usize> Raw<P> {
    fn new() -> Self {
        Self {
            cross: [[0.0; P]; P],
            output: [0.0; P],
            shift_rows: [0.0; P],
            shift_columns: [0.0; P],
            shift_output: 0.0,
            shift_square: 0.0,
            model: [0.0; P],
            model_output: 0.0,
            model_shift: 0.0,
        }
    }

    #[inline]
    fn add<const IV: bool, const APART: bool, const SHIFTED: bool>(
        &mut self,
        z: &[f64; P],
        phi: &[f64; P],
        y: f64,
        shift: f64,
        model: f64,
    ) {
        for i in 0..P {
            for j in 0..P {
                self.cross[i][j] += z[i] * phi[j];
            }
            self.output[i] += z[i] * y;
        }
        if !IV || APART {
            self.model_output += model * y;
        }
        if APART {
            for j in 0..P {
                self.model[j] += model * phi[j];
            }
        }
        if SHIFTED {
            for i in 0..P {
                self.shift_rows[i] += z[i] * shift;
                self.shift_columns[i] += shift * phi[i];
            }
            self.shift_output += shift * y;
            self.shift_square += shift * shift;
            if APART {
                self.model_shift += model * shift;
            }
        }
    }

    /// x̂ = Σ numerator · column + `a_N` `y_eq,f`, so its sums follow from those of the columns.
    fn model_from_columns(&mut self, numerators: &[f64], a_last: f64) {
        self.model = self.shift_columns.map(|sum| a_last * sum);
        self.model_output = a_last * self.shift_output;
        self.model_shift = a_last * self.shift_square;
        for (at, numerator) in numerators.iter().enumerate() {
            for j in 0..P {
                self.model[j] += numerator * self.cross[at][j];
            }
            self.model_output += numerator * self.output[at];
            self.model_shift += numerator * self.shift_rows[at];
        }
    }

    /// Least squares: y replaces x̂.
    fn model_is_output(&mut self) {
        self.model = self.output;
        self.model_shift = self.shift_output;
    }

    /// Converts the sums from states to derivatives.
    fn sums<const N: usize>(&self, linear: &Readout<N>, c_last: f64) -> Sums<P> {
        let by_row = |row: &[f64; P], output: f64, shift: f64| regressor(row, linear, output, shift);
        let rows: [[f64; P]; P] = std::array::from_fn(|i| by_row(&self.cross[i], self.output[i], self.shift_rows[i]));
        let model_row = by_row(&self.model, self.model_output, self.model_shift);
        let shift_row = by_row(&self.shift_columns, self.shift_output, self.shift_square);
        let right: [f64; P] = std::array::from_fn(|i| self.output[i] - c_last * self.shift_rows[i]);
        let model_right = self.model_output - c_last * self.model_shift;
        let shift_right = self.shift_output - c_last * self.shift_square;
        let mut normal = [[0.0; P]; P];
        for j in 0..P {
            let column: [f64; P] = std::array::from_fn(|i| rows[i][j]);
            let column = regressor(&column, linear, model_row[j], shift_row[j]);
            for i in 0..P {
                normal[i][j] = column[i];
            }
        }
        Sums { normal, right: regressor(&right, linear, model_right, shift_right) }
    }
}

/// (columns, states of v) to (columns, -`v_f⁽ᴺ⁻¹⁾` … -(`v_f` - `y_eq,f`)).
#[inline]
fn regressor<const N: usize, const P: usize>(raw: &[f64; P], linear: &Readout<N>, sample: f64, shift: f64) -> [f64; P] {
    let mut regressor = *raw;
    for i in 0..N {
        let mut derivative = linear.through[i] * sample;
        for j in 0..N {
            derivative += linear.state[i][j] * raw[P - N + j];
        }
        regressor[P - 1 - i] = -derivative;
    }
    regressor[P - 1] += shift;
    regressor
}

/// The numerators applied to their columns.
#[inline]
fn combined<const N: usize, const P: usize>(theta: &[f64; P], columns: &[f64; P]) -> f64 {
    let mut sum = 0.0;
    for at in 0..P - N {
        sum += theta[at] * columns[at];
    }
    sum
}
