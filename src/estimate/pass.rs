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
    rows: [Row<P>; P],
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

/// Sums of a row with the columns, and with y; together, as they are computed two at a time.
#[derive(Clone, Copy)]
struct Row<const P: usize> {
    columns: [f64; P],
    output: f64,
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

    /// `IV`: with an auxiliary model; `APART`: its denominator differs from that of the filter; `SHIFTED`: with `y_eq`.
    fn filtered_sums<const IV: bool, const APART: bool, const SHIFTED: bool>(
        &self,
        problem: &Problem<S>,
        c: &[f64; N],
        (theta, a): (&[f64; P], &[f64; N]),
        workspace: &mut Workspace<P>,
    ) -> Option<Sums<P>> {
        let stride = workspace.stride;
        let len = problem.output.len();
        let step = if IV { 1 } else { (stride / 2).min(len / START_SAMPLES).max(1) };
        let filter = Discrete::new(c, problem.interval_s * step as f64)?;
        let own_filter = if APART { Some(Discrete::new(a, problem.interval_s)?) } else { None };
        let model_filter = own_filter.as_ref().unwrap_or(&filter);
        let Workspace { instruments, model_output, ones, .. } = workspace;
        let output = &problem.output[..len];
        let model_output = &mut model_output[..len];
        let equilibrium = &problem.equilibrium.unwrap_or(output)[..len];
        if problem.inputs.iter().any(|input| matches!(input, Signal::Constant)) {
            ones.resize(len, 1.0);
        }
        let inputs = problem.inputs.map(|input| match input {
            Signal::Sampled(u, _) => &u[..len],
            Signal::Constant => &ones[..len],
        });
        let at = |k: usize| -> [f64; S] { std::array::from_fn(|s| inputs[s][k]) };

        let filters = Filters::new(self, problem, [&filter, model_filter], theta, a[N - 1]);
        let mut states = filters.start(at(0), output[0]);
        let linear = filter.readout(Hold::First);
        let mut raw = Raw::new();
        let (mut from, mut to) = (0, if IV { (stride / 2).min(len) } else { len });
        let mut kept = instruments.iter_mut();
        // Between two kept instruments there is no branch.
        loop {
            for k in (from..to).step_by(step) {
                let (u, y) = (at(k), output[k]);
                let Sample { phi, z, shift, model } = filters.read::<IV, APART, SHIFTED>(&states, &u, y);
                if IV {
                    model_output[k] = model;
                }
                raw.add::<IV, APART, SHIFTED>(&z, &phi, y, shift, model);
                filters.advance::<IV, APART, SHIFTED>(&mut states, &u, [y, model, equilibrium[k]]);
            }
            if to == len {
                break;
            }
            if let Some(kept) = kept.next() {
                let Sample { z, shift, model, .. } = filters.read::<IV, APART, SHIFTED>(&states, &at(to), output[to]);
                *kept = regressor(&z, linear, model, shift);
            }
            (from, to) = (to, (to + stride).min(len));
        }
        if IV && !APART {
            raw.model_from_columns(&theta[..P - N], a[N - 1]);
        } else if !IV {
            raw.model_is_output();
        }
        Some(raw.sums(linear, c[N - 1]))
    }
}

/// The filters of a pass; those of the auxiliary model are the second.
struct Filters<'a, const N: usize, const S: usize, const P: usize> {
    each: [&'a Discrete<N>; 2],
    columns: [Columns<N, P>; 2],
    shift_rows: [[f64; N]; 2],
    holds: [Hold; S],
    theta: &'a [f64; P],
    /// Last coefficient of the denominator of the auxiliary model.
    a_last: f64,
}

/// States of the filters before a sample.
struct States<const N: usize, const S: usize> {
    inputs: [[f64; N]; S],
    model: [[f64; N]; S],
    output: [f64; N],
    auxiliary: [f64; N],
    shift: [f64; N],
    model_shift: [f64; N],
}

/// Columns of the regressor and of the instrument at a sample, with `y_eq,f` and x̂.
struct Sample<const P: usize> {
    phi: [f64; P],
    z: [f64; P],
    shift: f64,
    model: f64,
}

impl<'a, const N: usize, const S: usize, const P: usize> Filters<'a, N, S, P> {
    fn new(
        sriv: &Sriv<N, S, P>,
        problem: &Problem<S>,
        filters: [&'a Discrete<N>; 2],
        theta: &'a [f64; P],
        a_last: f64,
    ) -> Self {
        let holds: [Hold; S] = problem.inputs.map(|input| match input {
            Signal::Sampled(_, hold) => hold,
            Signal::Constant => Hold::Zero,
        });
        let columns = filters.map(|filter| Columns::new(sriv, &holds, filter));
        let shift_rows = filters.map(|filter| filter.readout(Hold::Zero).state[0]);
        Self { each: filters, columns, shift_rows, holds, theta, a_last }
    }

    /// Every filter starts at rest.
    fn start(&self, u: [f64; S], y: f64) -> States<N, S> {
        let start =
            |filter: &Discrete<N>| std::array::from_fn(|s| filter.readout(self.holds[s]).start(&[0.0; N], u[s]));
        let [inputs, model] = self.each.map(start);
        let linear = self.each[0].readout(Hold::First);
        let first = combined::<N, P>(self.theta, &self.columns[1].read(&model, &u));
        let [output, auxiliary] = [y, first].map(|first| linear.start(&[0.0; N], first));
        States { inputs, model, output, auxiliary, shift: [0.0; N], model_shift: [0.0; N] }
    }

    #[inline]
    fn read<const IV: bool, const APART: bool, const SHIFTED: bool>(
        &self,
        states: &States<N, S>,
        u: &[f64; S],
        y: f64,
    ) -> Sample<P> {
        let mut phi = self.columns[0].read(&states.inputs, u);
        let mut z = phi;
        let shift = if SHIFTED { dot(&self.shift_rows[0], &states.shift) } else { 0.0 };
        let mut model = y;
        if IV {
            let own = if APART { self.columns[1].read(&states.model, u) } else { phi };
            model = combined::<N, P>(self.theta, &own);
            if SHIFTED {
                let own = if APART { dot(&self.shift_rows[1], &states.model_shift) } else { shift };
                model += self.a_last * own;
            }
        }
        let auxiliary = if IV { &states.auxiliary } else { &states.output };
        for i in 0..N {
            phi[P - N + i] = states.output[i];
            z[P - N + i] = auxiliary[i];
        }
        Sample { phi, z, shift, model }
    }

    #[inline]
    fn advance<const IV: bool, const APART: bool, const SHIFTED: bool>(
        &self,
        states: &mut States<N, S>,
        u: &[f64; S],
        [y, model, equilibrium]: [f64; 3],
    ) {
        let [filter, model_filter] = self.each;
        for s in 0..S {
            filter.advance(&mut states.inputs[s], u[s]);
            if APART {
                model_filter.advance(&mut states.model[s], u[s]);
            }
        }
        filter.advance(&mut states.output, y);
        if IV {
            filter.advance(&mut states.auxiliary, model);
        }
        if SHIFTED {
            filter.advance(&mut states.shift, equilibrium);
            if APART {
                model_filter.advance(&mut states.model_shift, equilibrium);
            }
        }
    }
}

impl<const P: usize> Raw<P> {
    fn new() -> Self {
        Self {
            rows: [Row { columns: [0.0; P], output: 0.0 }; P],
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
            let Row { columns, output } = &mut self.rows[i];
            for j in 0..P {
                columns[j] += z[i] * phi[j];
            }
            *output += z[i] * y;
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
                self.model[j] += numerator * self.rows[at].columns[j];
            }
            self.model_output += numerator * self.rows[at].output;
            self.model_shift += numerator * self.shift_rows[at];
        }
    }

    /// Least squares: y replaces x̂.
    fn model_is_output(&mut self) {
        self.model = self.rows.map(|row| row.output);
        self.model_shift = self.shift_output;
    }

    /// Converts the sums from states to derivatives.
    fn sums<const N: usize>(&self, linear: &Readout<N>, c_last: f64) -> Sums<P> {
        let by_row = |row: &[f64; P], output: f64, shift: f64| regressor(row, linear, output, shift);
        let rows: [[f64; P]; P] =
            std::array::from_fn(|i| by_row(&self.rows[i].columns, self.rows[i].output, self.shift_rows[i]));
        let model_row = by_row(&self.model, self.model_output, self.model_shift);
        let shift_row = by_row(&self.shift_columns, self.shift_output, self.shift_square);
        let right: [f64; P] = std::array::from_fn(|i| self.rows[i].output - c_last * self.shift_rows[i]);
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
