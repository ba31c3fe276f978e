//! The gauges of a machine: its last throws against the normal values.

use serde::{Deserialize, Serialize};

use super::{Gauge, Normal, Values, sd_of_mean};
use crate::{
    diagnose::statistics::{LastValues, Level, WINDOWS, median, moving_range_sd, to_f32},
    estimate::Features,
    throw::Direction,
};

/// Number of stored throws, of both directions together: the largest number in a level.
const RECENT: usize = WINDOWS[2];
/// Change of the field of a magnet with its temperature \[1/K\], and the standard deviation of this change: -0.2 % per
/// K for ferrite, -0.1 % for rare earths, hardly any for Alnico and for a wound field. The magnet has the temperature
/// of the air, as a throw warms only the winding.
const MAGNETS: (f64, f64) = (-0.001, 0.0006);
/// Largest change of running current and charge at which a current is usual, as logarithms: the weather changes them by
/// this.
const USUAL_CURRENT: f64 = 0.15;
/// Running times of the motor, as parts of the normal time, below and above which a throw is unusual. A third less
/// voltage lengthens a throw by two thirds. In a slow recording, the motor of a throw that the spring drives seems to be
/// off after half of the time now and then. The change is also larger than this many standard deviations of one throw.
const UNUSUAL_RUN: [f64; 2] = [0.4, 1.8];
const UNUSUAL_SD: f64 = 4.0;
/// Running time and mean current above which a throw is unusual, too: a motor that stalls takes several times its
/// running current, until a time-out that may be less than twice the normal time.
const STALLED: [f64; 2] = [1.35, 1.5];
/// Travel of a throw that ends short of its usual end, as part of the usual travel: far below what scatter, springs and
/// adjustments do.
const SHORT_TRAVEL: f64 = 0.8;
/// Largest change of the travel of a throw that stops where it always stops, as a logarithm.
const USUAL_TRAVEL: f64 = 0.02;

/// A changed gauge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct GaugeChange {
    pub(crate) gauge: Gauge,
    /// Median change of the last throws, as a logarithm.
    pub(crate) level: Level,
}

/// Direction and gauges of a throw. Snapshots have the values of the known gauges only.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "(u16, Vec<f32>)", into = "(u16, Vec<f32>)")]
struct Shown {
    /// Bit 0 is the direction; bit `at + 1` says whether gauge `at` is known.
    bits: u16,
    /// Values of the gauges, 0 for unknown ones.
    values: [f32; Gauge::COUNT],
}

const _: () = assert!(Gauge::COUNT < u16::BITS as usize, "a bit for each gauge, and one for the direction");

impl Shown {
    fn new(side: usize, values: Values) -> Self {
        let bits = (0..Gauge::COUNT).filter(|at| values[*at].is_some()).fold(side, |bits, at| bits | (2 << at));
        Self { bits: u16::try_from(bits).unwrap_or_default(), values: values.map(Option::unwrap_or_default) }
    }

    fn side(self) -> usize {
        usize::from(self.bits & 1)
    }

    fn value(self, gauge: Gauge) -> Option<f32> {
        is_known(self.bits, gauge as usize).then(|| self.values[gauge as usize])
    }
}

fn is_known(bits: u16, at: usize) -> bool {
    bits & (2 << at) != 0
}

impl From<(u16, Vec<f32>)> for Shown {
    fn from((bits, known): (u16, Vec<f32>)) -> Self {
        let mut known = known.into_iter();
        let mut value = |at| if is_known(bits, at) { known.next() } else { None };
        Self { bits, values: std::array::from_fn(|at| value(at).unwrap_or_default()) }
    }
}

impl From<Shown> for (u16, Vec<f32>) {
    fn from(Shown { bits, values }: Shown) -> Self {
        (bits, (0..Gauge::COUNT).filter(|at| is_known(bits, *at)).map(|at| values[at]).collect())
    }
}

/// The gauges of one machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Gauges {
    pub(super) sides: [Normal; 2],
    /// The last throws, the newest last.
    recent: LastValues<Shown, RECENT>,
}

impl Gauges {
    /// Adds a throw. If the machine is `suspicious`, the throw is not used for the normal values.
    pub(crate) fn push(&mut self, direction: Direction, features: &Features, celsius: Option<f64>, suspicious: bool) {
        let side = direction.side();
        let values = self.sides[side].values(features, celsius);
        if !suspicious {
            self.sides[side].learn(values);
        }
        self.recent.push(Shown::new(side, values));
    }

    /// Number of throws from which the normal duration of a direction is learned so far, and the number that this
    /// needs.
    pub(crate) fn progress(&self, direction: Direction) -> (usize, usize) {
        self.sides[direction.side()].progress(Gauge::Duration)
    }

    /// For some gauges of a throw: the part of the departure from normal that supply and temperature of the throw do
    /// not explain, as a logarithm, and the standard deviation of one throw. `None` if the gauge or its normal value is
    /// unknown.
    pub(crate) fn unexplained<const N: usize>(
        &self,
        gauges: [Gauge; N],
        direction: Direction,
        features: &Features,
        celsius: Option<f64>,
    ) -> [Option<(f32, f32)>; N] {
        let normal = &self.sides[direction.side()];
        let values = normal.values(features, celsius);
        let supplied = normal.supplied(&values);
        gauges.map(|gauge| {
            let (centre, sd) = normal.of(gauge)?;
            let change = values[gauge as usize]? - centre;
            let [from, to] = supplied.range(gauge);
            let by_weather = normal.of_weather(gauge, &values);
            Some((change - change.clamp(from + by_weather.min(0.0), to + by_weather.max(0.0)), sd))
        })
    }

    /// Whether running time and current of a throw are those of the other direction and not of its own, or those of its
    /// own and not of the other; `None` if they fit both, or neither.
    pub(crate) fn is_of_other(&self, direction: Direction, features: &Features, celsius: Option<f64>) -> Option<bool> {
        /// Largest departure from a direction that fits, in standard deviations: hardly any healthy throw has a larger
        /// one. A departure of twice as many does not fit.
        const FITS_SD: f32 = 4.0;
        const DIFFERS_SD: f32 = 8.0;
        const GAUGES: [Gauge; 3] = [Gauge::Duration, Gauge::Running, Gauge::Charge];
        let farthest = |direction| {
            let departures = self.unexplained(GAUGES, direction, features, celsius);
            let in_sd = |(departure, gauge): (Option<(f32, f32)>, Gauge)| {
                departure.map(|(change, sd)| change.abs() / sd.hypot(to_f32(gauge.floor())))
            };
            let [duration, running, charge] = std::array::from_fn(|at| in_sd((departures[at], GAUGES[at])));
            // At 25 Hz few machines have a charge.
            Some(f32::max(duration?, f32::max(running.or(charge)?, charge.or(running)?)))
        };
        let [own, other] = [farthest(direction)?, farthest(direction.other())?];
        let is_clear = own.min(other) < FITS_SD && own.max(other) > DIFFERS_SD;
        is_clear.then_some(other < own)
    }

    /// Running time of the motor in a throw and that in a normal throw \[s\], if it ran much longer or shorter, beyond
    /// what the supply explains.
    pub(crate) fn unusual_run_s(
        &self,
        direction: Direction,
        features: &Features,
        celsius: Option<f64>,
    ) -> Option<[f64; 2]> {
        let [run, charge] = self.unexplained([Gauge::Duration, Gauge::Charge], direction, features, celsius);
        let (longer, sd) = run.map(|(longer, sd)| (f64::from(longer), f64::from(sd)))?;
        let stalls = charge.is_some_and(|(charge, _)| {
            let of_current = f64::from(charge) - longer;
            [longer, of_current].iter().zip(STALLED).all(|(change, least)| *change > least.ln())
        });
        let [least, most] = UNUSUAL_RUN.map(f64::ln);
        let is_unusual = (stalls || !(least..most).contains(&longer)) && longer.abs() > UNUSUAL_SD * sd;
        let (usual, _) = self.normal(direction, Gauge::Duration).filter(|_| is_unusual)?;
        Some([features.duration_s?, usual.exp()])
    }

    /// The travel of a normal throw \[mm\], if that of this throw is much shorter, and its duration too: a position
    /// sensor with another gain leaves the duration.
    pub(crate) fn longer_usual_travel_mm(&self, direction: Direction, features: &Features) -> Option<f64> {
        let (usual, _) = self.normal(direction, Gauge::Travel)?;
        let (usual_duration, _) = self.normal(direction, Gauge::Duration)?;
        let [shorter, sooner] = [features.travel_mm?.ln() - usual, features.duration_s?.ln() - usual_duration];
        let is_short = shorter < SHORT_TRAVEL.ln() && sooner < 0.5 * SHORT_TRAVEL.ln();
        is_short.then(|| usual.exp())
    }

    /// Whether a travel is that of a normal throw.
    pub(crate) fn is_usual_travel(&self, direction: Direction, travel_mm: f64) -> bool {
        self.normal(direction, Gauge::Travel).is_some_and(|(centre, _)| (travel_mm.ln() - centre).abs() < USUAL_TRAVEL)
    }

    /// Whether the current of a throw is as in a normal throw: as large, and flowing as long.
    pub(crate) fn is_usual_current(&self, direction: Direction, features: &Features, celsius: Option<f64>) -> bool {
        let changes = self.unexplained([Gauge::Running, Gauge::Charge], direction, features, celsius);
        changes.iter().all(|change| change.is_some_and(|(change, _)| f64::from(change.abs()) < USUAL_CURRENT))
    }

    /// Level of a gauge over the last `throws` that contain it, without the effect of the temperature on magnets. It is
    /// the mean of their departures, for the shortest window the median. `None` if too few throws contain the gauge, or
    /// its normal value is unknown.
    pub(crate) fn level(&self, gauge: Gauge, throws: usize) -> Option<Level> {
        let departures = self.departures(gauge, throws)?;
        let mut values: Vec<f64> = departures.iter().map(|(_, value, _)| *value).collect();
        let sd = usual_sd(gauge, &departures);
        // The median has the whole size of a change as soon as most of the throws show it.
        let value = if throws == WINDOWS[0] { median(&mut values) } else { mean(&values) };
        let of_magnets = gauge.sign_of_magnets();
        let warmer_k =
            if of_magnets == 0.0 { 0.0 } else { self.level(Gauge::Air, throws).map_or(0.0, |air| air.value) };
        Some(Level { value: value - of_magnets * MAGNETS.0 * warmer_k, sd: sd.hypot(MAGNETS.1 * warmer_k) })
    }

    /// [`Self::level`] with a standard deviation from the scatter of these throws, if that is larger than normal, as
    /// with a sensor that has become noisy.
    pub(crate) fn scattered_level(&self, gauge: Gauge, throws: usize) -> Option<Level> {
        let (level, departures) = (self.level(gauge, throws)?, self.departures(gauge, throws)?);
        // The two directions may have changed by different amounts, so the scatter is that within each direction.
        let sd = sd_of_mean(gauge, moving_range_sd(&by_side(&departures)), departures.len() as f64);
        Some(Level { sd: level.sd.max(sd), ..level })
    }

    /// The last `throws` that contain a gauge, newest first: side, departure from normal, and standard deviation of one
    /// throw. `None` if too few throws contain the gauge, or its normal value is unknown.
    pub(super) fn departures(&self, gauge: Gauge, throws: usize) -> Option<Vec<(usize, f64, f64)>> {
        let departure = |shown: &Shown| {
            let (centre, sd) = self.sides[shown.side()].of(gauge)?;
            Some((shown.side(), f64::from(shown.value(gauge)? - centre), f64::from(sd)))
        };
        let departures: Vec<_> = self.recent.iter().rev().filter_map(departure).take(throws).collect();
        // Half of the throws are enough: those of one direction may all be without the gauge.
        let are_enough = !departures.is_empty() && 2 * departures.len() >= throws.min(self.recent.len());
        are_enough.then_some(departures)
    }

    /// Two gauges in the last throws of a direction that contain both, newest first.
    pub(super) fn pairs(&self, direction: Direction, gauges: [Gauge; 2]) -> impl Iterator<Item = (f64, f64)> {
        let of_side = self.recent.iter().rev().filter(move |shown| shown.side() == direction.side());
        of_side.filter_map(move |shown| {
            let [a, b] = gauges.map(|gauge| shown.value(gauge).map(f64::from));
            a.zip(b)
        })
    }

    /// Normal value of a gauge in a direction, and standard deviation of one throw.
    pub(super) fn normal(&self, direction: Direction, gauge: Gauge) -> Option<(f64, f64)> {
        self.sides[direction.side()].of(gauge).map(|(centre, sd)| (f64::from(centre), f64::from(sd)))
    }

    /// Normal values of a gauge in the directions in which it is known.
    pub(super) fn normals(&self, gauge: Gauge) -> impl Iterator<Item = f64> {
        self.sides.iter().filter_map(move |side| side.of(gauge)).map(|(centre, _)| f64::from(centre))
    }

    /// Change of the duration in the last few throws of a direction, as a logarithm; for `None`, the mean of both
    /// directions.
    pub(crate) fn longer(&self, direction: Option<Direction>) -> Option<Level> {
        let departures = self.departures(Gauge::Duration, WINDOWS[1])?;
        let wanted = direction.map(Direction::side);
        let sides =
            by_side(&departures).into_iter().enumerate().filter(|(side, _)| wanted.is_none_or(|of| of == *side));
        let medians: Vec<f64> = sides.filter(|(_, of)| !of.is_empty()).map(|(_, mut of)| median(&mut of)).collect();
        let sd = usual_sd(Gauge::Duration, &departures);
        (!medians.is_empty()).then(|| Level { value: mean(&medians), sd })
    }

    /// Normal running current as part of the inrush, as the mean of both directions; 0 if it is unknown.
    pub(crate) fn running_of_inrush(&self) -> f64 {
        let part =
            |side: &Normal| Some(f64::from(side.of(Gauge::Running)?.0 - side.of(Gauge::Inrush)?.0).exp().min(1.0));
        let parts: Vec<f64> = self.sides.iter().filter_map(part).collect();
        if parts.is_empty() { 0.0 } else { mean(&parts) }
    }

    /// Largest normal delay of the start \[ms\] of both directions, as of a stroke that unlocks, or of play and an
    /// elastic drive.
    pub(crate) fn normal_delay_ms(&self) -> f64 {
        self.normals(Gauge::StartDelay).map(f64::abs).fold(0.0, f64::max)
    }

    /// Normal travel \[mm\]; `None` if unknown.
    pub(crate) fn normal_travel_mm(&self) -> Option<f64> {
        self.normals(Gauge::Travel).map(f64::exp).next()
    }

    /// Whether the throws give the constants of the motor without a toe position.
    pub(crate) fn is_without_toe_sensor(&self) -> bool {
        self.normals(Gauge::BackEmf).next().is_some() && self.normal_travel_mm().is_none()
    }

    /// Deletes the last throws.
    pub(crate) fn forget_recent(&mut self) {
        self.recent.clear();
    }
}

/// Standard deviation of the mean of these departures, from the normal scatter of each.
fn usual_sd(gauge: Gauge, departures: &[(usize, f64, f64)]) -> f64 {
    let sds: Vec<f64> = departures.iter().map(|(.., sd)| *sd).collect();
    sd_of_mean(gauge, mean(&sds), departures.len() as f64)
}

/// The departures of each side.
pub(super) fn by_side(departures: &[(usize, f64, f64)]) -> [Vec<f64>; 2] {
    [0, 1].map(|side| departures.iter().filter(|(of, ..)| *of == side).map(|(_, value, _)| *value).collect())
}

/// The mean; NaN without values.
pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::gauges::normal::LEARNED;

    const NORMAL: Direction = Direction::NormalToReverse;

    /// 5 A through 0.9 Ω take 4.5 of 36 V, so the speed follows V - 4.5 V.
    fn features(supply_v: f64, duration_s: f64, resistance_ohm: Option<f64>) -> Features {
        Features {
            supply_v: Some(supply_v),
            duration_s: Some(duration_s),
            resistance_ohm,
            running_current_a: Some(5.0),
            peak_current_a: Some(30.0),
            ..Features::default()
        }
    }

    #[test]
    fn the_field_of_magnets_follows_a_published_temperature() {
        let learned = |celsius: Option<f64>| {
            let mut gauges = Gauges::default();
            for _ in 0..LEARNED.1 {
                let features = Features { back_emf_v_s_per_rad: Some(4.0), ..features(36.0, 7.0, Some(0.9)) };
                gauges.push(NORMAL, &features, celsius, false);
            }
            gauges
        };
        for per_k in [0.0_f64, -0.001, -0.002] {
            let mut gauges = learned(Some(0.0));
            for _ in 0..WINDOWS[1] {
                let warm = Features { back_emf_v_s_per_rad: Some(4.0 * (1.0 + 25.0 * per_k)), ..Features::default() };
                gauges.push(NORMAL, &warm, Some(25.0), false);
            }
            let level = gauges.level(Gauge::BackEmf, WINDOWS[1]).unwrap();
            assert!(level.value.abs() < 2.0 * level.sd && level.sd < 0.03, "{per_k} per K: {level:?}");
        }
        let mut gauges = learned(None);
        gauges.push(NORMAL, &Features { back_emf_v_s_per_rad: Some(3.8), ..Features::default() }, None, false);
        let level = gauges.level(Gauge::BackEmf, WINDOWS[0]).unwrap();
        assert!(level.sd < 0.01, "without a temperature nothing is known about its effect: {level:?}");
    }

    /// The weather of the throws from which the normal values were learned is unknown.
    #[test]
    fn a_temperature_that_is_published_later_changes_no_resistance() {
        let mut gauges = Gauges::default();
        for at in 0..3 * LEARNED.1 {
            let celsius = (at >= LEARNED.1).then_some(-20.0);
            let features = Features { back_emf_v_s_per_rad: Some(4.0), ..features(36.0, 7.0, Some(0.9)) };
            gauges.push(NORMAL, &features, celsius, false);
        }
        let level = gauges.level(Gauge::Resistance, WINDOWS[0]).unwrap();
        assert!(level.value.abs() < 1e-6, "{level:?}");
        assert_eq!(gauges.level(Gauge::Air, WINDOWS[0]), None);
    }

    #[test]
    fn a_resistance_that_scatters_much_is_not_judged() {
        for (scatter, is_judged) in [(0.02_f64, true), (0.3, false)] {
            let mut gauges = Gauges::default();
            let mut push = |ohm: f64| {
                let features = Features { back_emf_v_s_per_rad: Some(4.0), ..features(36.0, 7.0, Some(ohm)) };
                gauges.push(NORMAL, &features, Some(20.0), false);
            };
            for at in 0..LEARNED.1 {
                push(0.9 * if at % 2 == 0 { scatter.exp() } else { (-scatter).exp() });
            }
            for _ in 0..WINDOWS[1] {
                push(18.0);
            }
            assert_eq!(gauges.circuit().is_some_and(|circuit| circuit.size > 1.0), is_judged, "{scatter}");
        }
    }

    #[test]
    fn a_resistance_that_falls_in_one_direction_is_that_of_no_winding() {
        for falls_in_both in [true, false] {
            let mut gauges = Gauges::default();
            let mut push = |direction: Direction, ohm: f64, peak_a: f64| {
                let back_emf_v_s_per_rad = Some(4.0);
                let peak_current_a = Some(peak_a);
                let features = features(36.0, 7.0, Some(ohm));
                gauges.push(
                    direction,
                    &Features { peak_current_a, back_emf_v_s_per_rad, ..features },
                    Some(20.0),
                    false,
                );
            };
            for _ in 0..LEARNED.1 {
                for direction in Direction::BOTH {
                    push(direction, 0.9, 30.0);
                }
            }
            for _ in 0..WINDOWS[1] {
                push(NORMAL, if falls_in_both { 0.5 } else { 0.9 }, 45.0);
                push(Direction::ReverseToNormal, 0.5, 45.0);
            }
            let circuit = gauges.circuit().unwrap();
            assert!(circuit.size > 1.0 && circuit.is_doubtful != falls_in_both, "{falls_in_both}: {circuit:?}");
        }
    }

    #[test]
    fn a_voltage_explains_a_duration_up_to_that_of_the_back_emf() {
        for (ohm, longest) in
            [(Some(0.9), (36.0 - 4.5) / (30.0 - 4.5)), (None, (1.0 - 5.0 / 30.0) / (30.0 / 36.0 - 5.0 / 30.0))]
        {
            let mut gauges = Gauges::default();
            for _ in 0..LEARNED.0 {
                gauges.push(NORMAL, &features(36.0, 7.0, ohm), None, false);
            }
            for (factor, rest) in [
                (1.0, 0.0),
                (longest, 0.0),
                (1.2 * longest, 1.2_f64.ln()),
                // A shorter throw is not the effect of a lower voltage.
                (0.9, 0.9_f64.ln()),
            ] {
                let throw = features(30.0, 7.0 * factor, ohm);
                let [found] = gauges.unexplained([Gauge::Duration], NORMAL, &throw, None);
                let found = f64::from(found.unwrap().0);
                assert!((found - rest).abs() < 1e-3, "{ohm:?}, {factor}: {found}");
            }
        }
    }
}
