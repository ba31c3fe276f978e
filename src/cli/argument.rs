//! Parsers of command-line arguments that several commands share.

use anyhow::Context as _;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use jiff::{
    SignedDuration, Span, SpanRelativeTo, Timestamp,
    civil::{Date, DateTime},
    tz::TimeZone,
};
use strum::VariantArray as _;

use super::{Exit, Failure, ResultExt as _};
use crate::{
    daemon::{clock, config::check_endpoint},
    diagnose::{Cause, LONGEST_SHELVING_DAYS, MachineState, Severity},
    estimate::Motor,
    simulate::Part,
    throw::{Direction, MachineId},
};

/// A machine as `SITE/MACHINE`.
pub(super) fn machine(text: &str) -> Result<MachineId, String> {
    let (site, machine) = text.split_once('/').ok_or("write SITE/MACHINE, as north/21B")?;
    MachineId::new(site, machine).map_err(|error| error.to_string())
}

/// An endpoint of zenoh, as `tcp/HOST:7447`.
pub(super) fn endpoint(text: &str) -> Result<String, &'static str> {
    check_endpoint(text, false).map(|()| text.to_owned())
}

/// The cause of an alarm, by its word in messages or on pages.
pub(super) fn cause(text: &str) -> Result<Cause, String> {
    let known = || Cause::VARIANTS.iter().map(|cause| cause.as_str()).collect::<Vec<_>>().join(", ");
    Cause::named(text).ok_or_else(|| format!("must be motor or one of {}", known()))
}

pub(super) fn severity(word: &str) -> Result<Severity, String> {
    let known = [Severity::Warning, Severity::Critical];
    known.into_iter().find(|known| known.as_str() == word).ok_or_else(|| "must be warning or critical".to_owned())
}

pub(super) fn machine_state(word: &str) -> Result<MachineState, String> {
    let wrong = |_| "must be learning, healthy, warning, critical, not_monitored or maintenance".to_owned();
    word.replace([' ', '-'], "_").parse().map_err(wrong)
}

/// The part that a simulated fault changes.
pub(super) fn part(word: &str) -> Result<Part, String> {
    word.parse().map_err(|_| format!("{word:?} is not kt, friction, stiffness, rail_stiffness or inertia"))
}

/// A direction, as a word with hyphens.
pub(super) fn direction() -> impl TypedValueParser<Value = Direction> {
    PossibleValuesParser::new(["normal-to-reverse", "reverse-to-normal"])
        .map(|word| if word == "reverse-to-normal" { Direction::ReverseToNormal } else { Direction::NormalToReverse })
}

/// A kind of motor.
pub(super) fn motor() -> impl TypedValueParser<Value = Motor> {
    let magnet = PossibleValue::new("permanent-magnet").alias("permanent_magnet");
    let magnet = magnet.help("Torque proportional to the current");
    let series = PossibleValue::new("series").help("Torque proportional to I |I|");
    let three_phase = PossibleValue::new("three-phase").alias("three_phase");
    let three_phase = three_phase.help("The current does not show the torque: features only");
    PossibleValuesParser::new([magnet, series, three_phase]).map(|word| match word.as_str() {
        "series" => Motor::Series,
        "three-phase" | "three_phase" => Motor::ThreePhase,
        _ => Motor::PermanentMagnet,
    })
}

/// A moment: a date (0:00 UTC) or a time with its zone.
pub(super) fn moment(text: &str) -> Result<Timestamp, String> {
    let date = || text.parse::<Date>().ok()?.to_zoned(TimeZone::UTC).ok().map(|day| day.timestamp());
    // `Date` would accept a date and time without a zone, and ignore the time.
    let date = if text.contains(['T', ' ', ':']) { None } else { date() };
    let wrong = || match text.parse::<DateTime>() {
        Ok(_) => format!("{text:?} has no time zone: end it with Z for UTC, or with the offset, as +02:00"),
        Err(_) => format!("{text:?} is neither a date, as 2026-05-04, nor a time, as 2026-05-04T06:00:00Z"),
    };
    date.or_else(|| text.parse().ok()).ok_or_else(wrong)
}

/// A length of time, as 90m, 8h, 3d or 2w. It is at most the longest that the configuration of a daemon can allow. A
/// day has 24 hours.
fn length(text: &str) -> Result<SignedDuration, String> {
    let length = text.parse::<Span>().and_then(|span| span.to_duration(SpanRelativeTo::days_are_24_hours()));
    let allowed =
        |length: &SignedDuration| length.is_positive() && length.as_secs_f64() <= 86_400.0 * LONGEST_SHELVING_DAYS;
    let wrong = || {
        format!(
            "{text:?} is not a length of time above 0 and up to {LONGEST_SHELVING_DAYS} days, as 90m, 8h, 3d or 2w; a daemon \
             allows longest_shelving_days (31 by default)"
        )
    };
    length.ok().filter(allowed).ok_or_else(wrong)
}

/// The options of a shelving or a maintenance: reason and end, or `--end` to end it now.
#[derive(Debug, clap::Args)]
pub(super) struct Window {
    /// Reason for the shelving or the maintenance.
    #[arg(long, value_name = "TEXT", required_unless_present = "end")]
    why: Option<String>,
    /// Length, as 90m, 8h, 3d or 2w.
    #[arg(long = "for", value_name = "LENGTH", conflicts_with = "until", value_parser = length)]
    length: Option<SignedDuration>,
    /// Its end: a date (its midnight in UTC), or a time as 2026-05-04T06:00:00Z.
    #[arg(long, value_name = "TIME", value_parser = moment)]
    until: Option<Timestamp>,
    /// End it now.
    #[arg(long, conflicts_with_all = ["why", "length", "until"])]
    end: bool,
}

impl Window {
    /// Reason and end of the window; `None` with `--end`. `default` is the length of a window without `--for` and
    /// `--until`.
    pub(super) fn bounds(&self, default: Option<SignedDuration>) -> Result<Option<(String, Timestamp)>, Failure> {
        if self.end {
            return Ok(None);
        }
        let from_now = || {
            let length = self.length.or(default);
            let length = length.context("no end given: use --for 8h or --until 2026-05-04T06:00:00Z")?;
            clock::end_of_window(clock::now(), length).ok().context("--for is too long")
        };
        let until = self.until.map_or_else(from_now, Ok).or_exit(Exit::Usage)?;
        Ok(Some((self.why.clone().unwrap_or_default(), until)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_without_its_zone_is_refused_with_the_reason() {
        assert_eq!(moment("2026-05-04"), moment("2026-05-04T02:00+02:00"));
        for text in ["2026-05-04T06:00", "2026-05-04 06:00:00"] {
            assert!(moment(text).unwrap_err().contains("has no time zone: end it with Z"), "{text}");
        }
        for text in ["06:00", "2026-13-01", "yesterday"] {
            assert!(moment(text).unwrap_err().contains("is neither a date"), "{text}");
        }
    }

    #[test]
    fn a_length_out_of_range_is_refused_with_the_range() {
        assert_eq!(length("90m"), Ok(SignedDuration::from_mins(90)));
        assert!(length("3660d").is_ok());
        for text in ["0h", "-3h", "3661d", "99999999w", "soon"] {
            let error = length(text).unwrap_err();
            assert!(error.contains("above 0 and up to 3660 days"), "{text}: {error}");
        }
    }
}
