//! A block of samples: the signals, the states of their filters, and the values computed from these states.

use super::problem::Problem;

/// Number of samples in a block.
pub(super) const BLOCK: usize = 64;

/// The values of a signal, or of one state of a filter, in a block.
pub(crate) type Samples = [f64; BLOCK];

/// The states of one filter for the inputs and for `y_eq` in a block.
#[derive(Clone, Copy)]
pub(super) struct BankSamples<const N: usize, const S: usize> {
    pub(super) inputs: [[Samples; N]; S],
    pub(super) shift: [Samples; N],
}

/// Signals of a block, the states of their filters, and the values computed from these states.
pub(crate) struct Block<const N: usize, const S: usize, const P: usize> {
    pub(crate) inputs: [Samples; S],
    pub(crate) output: Samples,
    pub(crate) equilibrium: Samples,
    /// States of the filter of the signals, and of that of the auxiliary model (not used if it is the same).
    pub(super) banks: [BankSamples<N, S>; 2],
    /// The regressor before its conversion to derivatives: the numerator columns, and the N states of the filter of y.
    pub(crate) phi: [Samples; P],
    /// States of the filter of the auxiliary output x̂.
    pub(super) auxiliary: [Samples; N],
    /// The filtered equilibrium `y_eq,f`.
    pub(crate) shift: Samples,
    /// The auxiliary output x̂; without an auxiliary model, y.
    pub(crate) model: Samples,
}

impl<const N: usize, const S: usize, const P: usize> Block<N, S, P> {
    pub(super) const ZERO: Self = {
        let (none, states) = ([0.0; BLOCK], [[0.0; BLOCK]; N]);
        Self {
            inputs: [none; S],
            output: none,
            equilibrium: none,
            banks: [BankSamples { inputs: [states; S], shift: states }; 2],
            phi: [none; P],
            auxiliary: states,
            shift: none,
            model: none,
        }
    };

    /// Copies every `step`-th sample of the signals, from the sample `from` on, into the block, with zeros after the
    /// last one. Returns the number of samples copied.
    pub(crate) fn load(&mut self, problem: &Problem<S>, from: usize, step: usize) -> usize {
        let load = |to: &mut Samples, signal: &[f64]| {
            let signal = &signal[from..signal.len().min(from + BLOCK * step)];
            let used = signal.len().div_ceil(step);
            if step == 1 {
                to[..used].copy_from_slice(signal);
            } else {
                to.iter_mut().zip(signal.iter().step_by(step)).for_each(|(to, sample)| *to = *sample);
            }
            to[used..].fill(0.0);
            used
        };
        for (to, (input, _)) in self.inputs.iter_mut().zip(&problem.inputs) {
            load(to, input);
        }
        if let Some(equilibrium) = problem.equilibrium {
            load(&mut self.equilibrium, equilibrium);
        }
        load(&mut self.output, problem.output)
    }

    /// Row `row` of the instrument. The first P - N rows are the numerator columns. The last N rows are the states of
    /// the filter of x̂, or of the filter of y if there is no auxiliary model (`IV` is false).
    pub(super) fn instrument<const IV: bool>(&self, row: usize) -> &Samples {
        if !IV || row < P - N { &self.phi[row] } else { &self.auxiliary[row - (P - N)] }
    }
}
