//! Texts about the daemon: its stored data of a machine, commands of operators, other daemons.

use jiff::Timestamp;

use crate::{diagnose::Away, throw::utc};

/// Text of an open alarm in the database that no monitor has.
pub(crate) fn orphaned(name: &str) -> String {
    format!(
        "{name}: the daemon has lost its data about this alarm. The fault may still exist: check it, then acknowledge \
         this alarm."
    )
}

/// Text for a machine whose stored monitor cannot be read.
pub(crate) const UNREAD: &str = "\
    this version of pointsd cannot read the stored baselines and alarms of the machine, so it learns a new baseline. \
    The stored data are kept: install the version of pointsd that wrote them, or inspect the machine and take a new \
    baseline (rebaseline).";

/// Text for an alarm whose rule starts anew, after maintenance or two loggers, and with a new baseline that does not
/// close it.
pub(crate) const CHECKED_ANEW: &str = "this alarm ends. The next throws raise it again if its reason still exists.";

/// Text of an alarm at the end of maintenance; `before`: its text until then.
pub(crate) fn before_maintenance(before: &str) -> String {
    const UNCHECKED: &str = " This was before the maintenance or during it: the next throws show whether it is over.";
    if before.ends_with(UNCHECKED) { before.to_owned() } else { format!("{before}{UNCHECKED}") }
}

const REBASELINED: &str = "a new baseline is being taken";
const RETIRED: &str = "is no longer monitored";

/// Text of a new baseline.
pub(crate) fn rebaselined(name: &str, by: &str, why: &str) -> String {
    format!("Machine {name}: {REBASELINED} ({by}: {why}).")
}

/// Text of the end of the alarms of a machine that is no longer monitored.
pub(crate) fn retired(name: &str, by: &str, why: &str) -> String {
    format!("Machine {name} {RETIRED} ({by}: {why}).")
}

/// The text without the operator's name and reason.
pub(crate) fn without_operator(text: &str) -> String {
    let of = |phrase: &str| Some(format!("{}{phrase}.", text.split_once(&format!("{phrase} ("))?.0));
    [REBASELINED, RETIRED].into_iter().find_map(of).unwrap_or_else(|| text.to_owned())
}

pub(crate) const DAEMON_CALM: &str = "pointsd stores all data again.";

/// Text about watched daemons that cannot be reached.
pub(crate) fn peers_away(Away { daemons: away, has_link }: &Away) -> String {
    let since =
        |since: &Option<Timestamp>| since.map_or_else(|| "the start of this one".to_owned(), |since| utc(&since));
    let daemons: Vec<String> = away.iter().map(|(name, at)| format!("{name} since {}", since(at))).collect();
    if !has_link {
        return format!(
            "This daemon has no link to any other program, so it cannot see these daemons: {}. Check its own link, \
             the router and the certificates first.",
            daemons.join(", ")
        );
    }
    let (daemons_are, their, those) = if away.len() == 1 {
        ("The daemon", "Its", "that computer and its link")
    } else {
        ("These daemons", "Their", "those computers and their links")
    };
    format!(
        "{daemons_are} cannot be reached: {}. {their} machines are not monitored. Check {those}.",
        daemons.join(", ")
    )
}

pub(crate) const PEERS_BACK: &str = "All watched daemons can be reached again.";
