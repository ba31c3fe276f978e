//! The reasons why a throw has no estimate.

use crate::throw::{CENTIMETRE_MM, Channel, INCH_MM, brief, rounded};

/// Least number of samples in the rise of an unfiltered current.
pub(super) const MIN_RISE_SAMPLES: usize = 4;

/// The field of a channel in the message and its unit, for the text of a rejection.
fn field(channel: Channel) -> &'static str {
    match channel {
        Channel::Current => "current_a is in A",
        Channel::Position => "position_mm is in mm",
    }
}

/// A hint at the unit if the travel is a whole stroke in centimetres or inches; else empty.
fn likely_unit(travel_mm: f64, stroke_mm: f64) -> String {
    let is_stroke = |unit_mm: f64| (0.9..1.1).contains(&(unit_mm * travel_mm / stroke_mm));
    let units = [(CENTIMETRE_MM, "centimetres"), (INCH_MM, "inches")];
    let text = |(_, unit)| {
        format!(", as in a complete throw with the position in {unit}; it must be in millimetres (position_mm)")
    };
    units.into_iter().find(|(unit_mm, _)| is_stroke(*unit_mm)).map(text).unwrap_or_default()
}

/// The reason why a throw has no estimate. `Display` is one sentence for people; [`Rejection::code`] is stable for
/// programs.
#[derive(Debug, Clone, PartialEq, thiserror::Error, strum::EnumDiscriminants)]
#[strum_discriminants(name(RejectionCode), vis(pub(crate)), derive(strum::EnumString, strum::IntoStaticStr))]
#[strum_discriminants(doc = "The reason without its values.", strum(serialize_all = "snake_case"))]
#[expect(missing_docs, reason = "the text of each reason names its values, and their names have the units")]
pub enum Rejection {
    /// The trace or its window is too short for three coefficients.
    #[error(
        "the trace is too short for three coefficients: {duration_s:.3} s, {samples} samples at the rate of the estimate. Either \
         the recording ends early, or sample_rate_hz is wrong"
    )]
    TooShort { samples: usize, duration_s: f64 },
    /// NaN or infinite values.
    #[error("the {channel} is not a finite number at {at_s:.3} s, sample {sample}")]
    NotFinite { channel: Channel, sample: usize, at_s: f64 },
    /// The message has no toe position, and the coefficients do not follow from current and supply voltage either. Or the
    /// motor is a three-phase one, whose coefficients do not follow from current and position.
    #[error("{sent}, so only the features are known: {why}")]
    #[strum_discriminants(strum(serialize = "current_only"))]
    NoPosition { sent: &'static str, why: String },
    /// A value that a point machine cannot have.
    #[error(
        "the {channel} at {at_s:.3} s is {}, which is not possible for a point machine: a corrupt value, or a wrong \
         unit ({field})", brief(rounded(*.value)), field = field(*.channel)
    )]
    ImplausibleValue { channel: Channel, at_s: f64, value: f64 },
    /// The position is in metres.
    #[error(
        "the toe moved {travel_mm:.3}, resolved as finely as a whole stroke: the position seems to be in metres, and must be in \
         millimetres (position_mm)"
    )]
    WrongUnit { travel_mm: f64 },
    /// The toe did not move.
    #[error("the toe did not move")]
    NoMovement,
    /// The toe moved, but the current does not show a motor.
    #[error(
        "the toe moved {travel_mm:.1} mm, but the current stayed within its noise: the current channel is dead or stuck"
    )]
    NoCurrent { travel_mm: f64 },
    /// The toe moved before the motor was on.
    #[error(
        "the toe moved {moved_mm:.2} mm before the current rose: the recording begins during a movement, or the channels are not synchronous"
    )]
    MovedBeforeCurrent { moved_mm: f64 },
    /// The recording began after the start of the motor, or its first samples are lost.
    #[error("the start of the motor is not in the recording: the current is {current_a:.2} A at its first sample")]
    StartMissing { current_a: f64 },
    /// The toe stopped short of the stroke.
    #[error(
        "the throw is incomplete: the toe moved {travel_mm:.1} mm of {stroke_mm:.1} mm{}", likely_unit(*travel_mm, *stroke_mm)
    )]
    Incomplete { travel_mm: f64, stroke_mm: f64 },
    /// The toe stood still while the motor drove it, before the end of the stroke.
    #[error(
        "obstructed: the toe stood still at {position_mm:.1} mm for {stalled_s:.2} s while the motor was driving it"
    )]
    Obstructed { position_mm: f64, stalled_s: f64 },
    /// The toe moved further than the machine can.
    #[error(
        "the toe moved {travel_mm:.1} mm, more than the stroke of {stroke_mm:.1} mm: check the position sensor's scale"
    )]
    TravelTooLong { travel_mm: f64, stroke_mm: f64 },
    /// The movement, or the run of the motor without a toe position, took longer than possible for a point machine.
    /// `rate_hz`: that of the message.
    #[error(
        "the movement lasts {duration_s:.0} s, a point machine needs {longest_s:.0} s at most: check sample_rate_hz, {} Hz",
        rounded(*.rate_hz)
    )]
    TooSlow { duration_s: f64, longest_s: f64, rate_hz: f64 },
    /// The toe moved backwards during the throw; `returned`: it ended at its start.
    #[error(
        "the toe moved back by {back_mm:.1} mm during the throw{}",
        if *.returned { ", to its start: the throw was reversed midway, or the toe was pushed back" } else { "" }
    )]
    MovedBackwards { back_mm: f64, returned: bool },
    /// The toe arrived, and did not stay there.
    #[error("reopened: the toe came back by {back_mm:.1} mm after its arrival, and stands open at {position_mm:.1} mm")]
    Reopened { back_mm: f64, position_mm: f64 },
    /// The current reached the limit of its range and stayed there.
    #[error("the current is clipped at {limit:.3} from {at_s:.3} s on")]
    Clipped { limit: f64, at_s: f64 },
    /// A channel repeated one value while the machine moved.
    #[error("the {channel} is stuck at {value:.3} for {stuck_s:.2} s from {at_s:.3} s on")]
    Stuck { channel: Channel, value: f64, at_s: f64, stuck_s: f64 },
    /// The position jumped: samples are missing, or the sensor slipped.
    #[error("the position jumps by {jump_mm:.2} mm at {at_s:.3} s: samples are missing or the sensor slipped")]
    PositionJump { jump_mm: f64, at_s: f64 },
    /// The current stepped: its gain or offset changed, or samples are missing.
    #[error(
        "the current jumps by {jump_a:.2} A at {at_s:.3} s: a disturbed channel, lost samples, or a knock in the drive (play or \
         lost motion where the load reverses)"
    )]
    CurrentJump { jump_a: f64, at_s: f64 },
    /// The noise of the current changed for some time, so its gain did too.
    #[error(
        "the noise of the current is {ratio:.2} times that of the rest for some time: its gain changed, or it was disturbed or smoothed"
    )]
    GainChanged { ratio: f64 },
    /// The first samples of the inrush, over `missing_s`, are missing.
    #[error(
        "the current's rise begins {missing_s:.4} s before the first sample that shows it: samples are missing at the \
         motor's start"
    )]
    OnsetMissing { missing_s: f64 },
    /// The first samples of the current do not rise as in an armature with inductance and resistance.
    #[error(
        "the current's first samples depart from an armature's rise by {departure_a:.2} A: samples are missing at the \
         motor's start, or their instants jitter"
    )]
    RoughRise { departure_a: f64 },
    /// The toe starts later or, with a negative delay, earlier than the current shows.
    #[error(
        "the toe starts {:.1} ms {} than the current shows: {}",
        delay_ms.abs(),
        if *delay_ms < 0.0 { "earlier" } else { "later" },
        if *delay_ms < 0.0 {
            "channels that are not synchronous, or a drive that is already under tension"
        } else {
            "a brake that releases late, play, lost motion, or channels that are not synchronous"
        }
    )]
    LateStart { delay_ms: f64 },
    /// The first movement needs less torque than the motor gives.
    #[error("the toe starts with less torque than the current gives: a brake that releases late, or drags")]
    BrakedStart,
    /// A single value far from its neighbours.
    #[error("the {channel} has a spike of {height:.2} at {at_s:.3} s")]
    Spike { channel: Channel, height: f64, at_s: f64 },
    /// The rise of the current was not sampled well enough, and no anti-alias filter is declared.
    #[error(
        "undersampled: the current has a new value every {:.3} ms and rises within {rise_samples} of them; at least {} are \
         needed unless both channels passed one anti-alias filter (declare it as anti_alias_hz)",
        1e3 * interval_s, MIN_RISE_SAMPLES
    )]
    Undersampled { interval_s: f64, rise_samples: usize },
    /// The noise of a channel is much larger than configured, or, with `expected` `None`, too large for any estimate.
    #[error("{}", noise(*.channel, *.measured, *.expected))]
    Noisy { channel: Channel, measured: f64, expected: Option<f64> },
    /// The normal equations are singular or nearly so.
    #[error("the trace does not determine the three coefficients: the normal equations are singular")]
    Singular,
    /// The iteration did not converge.
    #[error("the estimation did not converge in {iterations} iterations: the model does not describe this trace")]
    NotConverged { iterations: usize },
    /// The identified model is unstable.
    #[error("the model found is unstable (a1 {a1:.3}, a0 {a0:.3}): it does not describe a point machine")]
    Unstable { a1: f64, a0: f64 },
    /// A coefficient that must be positive is not.
    #[error(
        "the model found has b0 {b0:.3}, a1 {a1:.3}, a0 {a0:.3}, which must all be positive (with a wrong neutral_mm, a1 is negative in one \
         direction)"
    )]
    NotPositive { b0: f64, a1: f64, a0: f64 },
    /// The fit of the model is too low.
    #[error("the model follows the movement to {fit_pct:.2} % only, at least {floor_pct:.2} % are needed")]
    PoorFit { fit_pct: f64, floor_pct: f64 },
    /// The model's output departs from the measured one by more than the sensors' noise and dry friction explain.
    #[error(
        "the movement departs from the model by up to {peak_mm:.2} mm at {at_s:.2} s: the load varies along the stroke, \
         or the channels do not belong together (lost samples, a disturbed channel, channels that are not synchronous)"
    )]
    Misfit { peak_mm: f64, at_s: f64 },
    /// The current has no inrush.
    #[error("the current has no inrush: {peak_a:.2} A at the start against {running_a:.2} A later")]
    NoInrush { peak_a: f64, running_a: f64 },
    /// The recording ends in the middle of the movement.
    #[error(
        "the recording ends after {travel_mm:.1} mm while the toe is still moving: record until the motor is off, or, if this \
         is the whole stroke, set stroke_mm to it"
    )]
    EndMissing { travel_mm: f64 },
    /// A coefficient is too uncertain because of noise.
    #[error(
        "the noise leaves {name} uncertain by {sd_pct:.0} % (one standard deviation), at most {limit_pct:.0} % are of use"
    )]
    Uncertain { name: &'static str, sd_pct: f64, limit_pct: f64 },
    /// A setting is out of its range.
    #[error("the setting {problem}")]
    BadSettings { problem: String },
}

/// The text of [`Rejection::Noisy`].
fn noise(channel: Channel, measured: f64, configured: Option<f64>) -> String {
    let (unit, key) = match channel {
        Channel::Current => ("A", "current_noise_a"),
        Channel::Position => ("mm", "position_noise_mm"),
    };
    if let Some(configured) = configured {
        format!(
            "the noise of the {channel} is {measured:.3} {unit}, configured {configured:.3} {unit}: check the sensor, or set \
             {key} if it is sound"
        )
    } else {
        format!(
            "the noise of the {channel} is {measured:.3} {unit}, too much for an estimate: check the sensor and its cable"
        )
    }
}

impl Rejection {
    /// The code of the reason, as in the column `quality`.
    pub fn code(&self) -> &'static str {
        RejectionCode::from(self).into()
    }

    /// Changes times and sample of a reason from a trace that begins at the sample `first` of the logger's trace, at
    /// `first_s` \[s\], and has one of `every` samples, to those of the logger's trace.
    pub(super) fn refer_to_logger(&mut self, first_s: f64, first: usize, every: usize) {
        if let Self::NotFinite { sample, .. } = self {
            *sample = first + every * *sample;
        }
        if let Self::NotFinite { at_s, .. }
        | Self::ImplausibleValue { at_s, .. }
        | Self::Clipped { at_s, .. }
        | Self::Stuck { at_s, .. }
        | Self::PositionJump { at_s, .. }
        | Self::CurrentJump { at_s, .. }
        | Self::Spike { at_s, .. }
        | Self::Misfit { at_s, .. } = self
        {
            *at_s += first_s;
        }
    }

    /// Whether the reason is a jump or a spike between `from_s` and `to_s` \[s from the start of the trace\].
    pub(super) fn is_between(&self, from_s: f64, to_s: f64) -> bool {
        match self {
            Self::CurrentJump { at_s, .. } | Self::PositionJump { at_s, .. } | Self::Spike { at_s, .. } => {
                (from_s..to_s).contains(at_s)
            }
            _ => false,
        }
    }

    /// Whether the later movement may still give the ratios of the coefficients, as the reason concerns only the start
    /// of the throw or the full model.
    pub(super) fn leaves_ratios(&self) -> bool {
        let is_of_start =
            matches!(self, Self::Misfit { .. } | Self::LateStart { .. } | Self::BrakedStart | Self::Uncertain { .. });
        is_of_start || self.refutes_the_model()
    }

    /// Whether the full model does not describe the throw at all. The toe may move long after the motor, as with a long
    /// unlocking stroke, or the channels do not belong together.
    pub(super) fn refutes_the_model(&self) -> bool {
        matches!(self, Self::NotPositive { .. } | Self::Unstable { .. } | Self::PoorFit { .. })
    }

    /// The channel with a faulty sensor or cable; `None` if the reason does not show such a fault.
    pub fn faulty_channel(&self) -> Option<Channel> {
        match self {
            Self::NotFinite { channel, .. }
            | Self::ImplausibleValue { channel, .. }
            | Self::Stuck { channel, .. }
            | Self::Noisy { channel, .. } => Some(*channel),
            Self::WrongUnit { .. } => Some(Channel::Position),
            Self::NoCurrent { .. } | Self::Clipped { .. } => Some(Channel::Current),
            _ => None,
        }
    }

    /// Whether the toe is at its start when the motor stops, so that its movement has no duration.
    pub(crate) fn never_arrived(&self) -> bool {
        matches!(self, Self::NoMovement | Self::MovedBackwards { returned: true, .. })
    }

    /// Whether the points did not complete their movement, which is a fault of the machine and not of the sensors.
    pub fn is_incomplete(&self) -> bool {
        matches!(
            self,
            Self::NoMovement
                | Self::Incomplete { .. }
                | Self::Obstructed { .. }
                | Self::MovedBackwards { .. }
                | Self::Reopened { .. }
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measured_values_in_a_reason_have_six_digits() {
        let value = Rejection::ImplausibleValue { channel: Channel::Current, at_s: 0.1, value: 188_776.123_456_7 };
        assert!(value.to_string().contains("at 0.100 s is 188776, "), "{value}");
        let slow = Rejection::TooSlow { duration_s: 60.0, longest_s: 30.0, rate_hz: 1.0 / 0.03 };
        assert!(slow.to_string().ends_with("check sample_rate_hz, 33.3333 Hz"), "{slow}");
    }
}
