//! Texts about loggers and the throws that they send.

use jiff::Timestamp;

use crate::{
    diagnose::Missing,
    throw::{counted, utc},
};

/// Text for messages of a machine that are not valid throws.
pub(crate) fn invalid(name: &str, count: u32, reason: &str) -> String {
    format!(
        "Machine {name}: the last {count} messages of its logger are not valid throws, so the machine is not \
         monitored: {reason}. Correct the logger; the messages are in quarantined_messages."
    )
}

/// Text for a logger whose clock is wrong: `started_at` by this clock, `received_at` by that of this computer.
pub(crate) fn wrong_clock(name: &str, started_at: Timestamp, received_at: Timestamp) -> String {
    format!(
        "Machine {name}: the clock of the logger is wrong: it dates a throw {}, received {}. Set the clock; until \
         then the times of alarms are those of reception.",
        utc(&started_at),
        utc(&received_at)
    )
}

/// Text for two loggers that publish as one machine; the two texts are their boots. The alarm ends when only one of
/// them has published for `hours`.
pub(crate) fn two_loggers(name: &str, [first, second]: &[String; 2], hours: i64) -> String {
    format!(
        "Machine {name}: two loggers publish as this machine: throws of the boots {first} and {second} take turns, so \
         it is not monitored. Give each logger its own machine name. The machine is monitored again {hours} hours \
         after the last turn, or after a new baseline (rebaseline)."
    )
}

pub(crate) const ONE_LOGGER: &str = "only one logger publishes as this machine now, so its throws are evaluated again.";

pub(crate) const RIGHT_CLOCK: &str = "the clock of the logger is right again.";

/// Text for a logger that sends fields with impossible values.
pub(crate) fn unused_fields(name: &str, sentence: &str) -> String {
    format!("Machine {name}: a field in the messages of the logger is not used: {sentence}. Correct the logger.")
}

/// Text for a logger that names other directions than those of the movement.
pub(crate) const CONTRADICTED: &str = "\
    the logger names another direction than the position shows. The position must rise from normal to reverse. \
    pointsd uses the position: correct its sign, or the directions of the logger.";

/// Text for a logger that has exchanged the names of the directions, if no position shows the movement.
pub(crate) const EXCHANGED: &str = "\
    throws that the logger names normal to reverse look like the earlier throws from reverse to normal, and the other \
    way round. The logger has probably exchanged the names, so these throws have no coefficients. Correct the logger; if \
    the names were wrong before, take a new baseline (rebaseline).";

/// A length of time: `value` in the `large` unit, or below 1 in the `small` one, a sixtieth of it.
fn length(value: f64, large: &str, small: &str) -> String {
    if value < 0.95 {
        counted(format_args!("{:.0}", 60.0 * value), small)
    } else {
        counted(format_args!("{value:.0}"), large)
    }
}

pub(crate) fn silent(name: &str, hours: f64) -> String {
    let length = length(hours, "hour", "minute");
    format!(
        "Machine {name}: no throw arrived for {length}, so the machine is not monitored. Check the logger and the \
         network; if the machine was not used, acknowledge."
    )
}

pub(crate) fn logger_gone(name: &str, minutes: f64) -> String {
    let length = length(minutes, "minute", "second");
    format!(
        "Machine {name}: its logger has been gone for {length}, so the machine is not monitored. Check the \
         logger's supply and the network."
    )
}

pub(crate) const LOGGER_BACK: &str = "its logger is connected again.";

/// Text for missing throws; `at`: time of the count.
pub(crate) fn gap(name: &str, missing: &Missing, at: Timestamp) -> String {
    let Missing { throws, refused, reason } = missing;
    if *throws >= Missing::MOST {
        return format!(
            "Machine {name}: its throw number jumped by so many throws that the number of lost ones is not known. The \
             counter of the logger is wrong: restart the logger with a new boot_id; data_gaps has the range."
        );
    }
    let (lost, at) = (counted(*throws, "throw"), utc(&at));
    let counted_at = format!("(counted at {at}; data_gaps has the present number)");
    let reason = if reason.is_empty() { String::new() } else { format!(": {reason}") };
    let (are, their) = if *throws == 1 { ("is", "its message was") } else { ("are", "their messages were") };
    if *refused == 0 {
        format!(
            "Machine {name}: {lost} never arrived {counted_at}. Check the link to the logger; what happened in \
             between is not known."
        )
    } else if refused >= throws {
        format!(
            "Machine {name}: {lost} {are} missing because {their} refused {counted_at}{reason}. Correct the logger; \
             the messages are in quarantined_messages."
        )
    } else {
        format!(
            "Machine {name}: {lost} {are} missing, {refused} of them because of refused messages \
             {counted_at}{reason}. Correct the logger (the messages are in quarantined_messages), and check the link \
             to it for the others."
        )
    }
}

pub(crate) fn no_gap(name: &str, throws: u32) -> String {
    if throws == 1 {
        return format!("Machine {name}: the last throw was not lost, invalid or a repetition.");
    }
    format!("Machine {name}: none of the last {throws} throws was lost, invalid or a repetition.")
}

pub(crate) const REPEATED_NUMBER: &str = "\
    its logger restarted without a new boot_id, or its counter is stuck: different throws have the same number. They \
    are stored and judged. Give the logger a new boot_id at each start.";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_throw_is_no_plural() {
        assert_eq!(no_gap("21B", 1), "Machine 21B: the last throw was not lost, invalid or a repetition.");
        let unevaluated = super::super::blind::unevaluated("21B", Some(crate::throw::Direction::BOTH[0]), 1, None);
        assert!(unevaluated.contains("the last 1 throw normal to reverse could not"), "{unevaluated}");
    }

    #[test]
    fn one_minute_and_one_hour_are_singular() {
        assert!(silent("21B", 0.5).contains("no throw arrived for 30 minutes, so"));
        assert!(logger_gone("21B", 0.1).contains("has been gone for 6 seconds, so"));
        assert!(logger_gone("21B", 1.2).contains("has been gone for 1 minute, so"));
        assert!(logger_gone("21B", 10.0).contains("has been gone for 10 minutes, so"));
        assert!(silent("21B", 1.2).contains("for 1 hour, so") && silent("21B", 26.0).contains("for 26 hours, so"));
    }
}
