//! Texts about faults that are not monitored: throws without an estimate, scatter, temperature, season.

use crate::{
    diagnose::{Blindness, HidingTemperature, statistics::percent},
    estimate::RejectionCode,
    throw::{CENTIMETRE_MM, Direction, INCH_MM, counted},
};

/// Text for throws without an estimate, of one direction or of both; `reason`: code of the last rejection, perhaps by
/// another version of the program.
pub(crate) fn unevaluated(name: &str, direction: Option<Direction>, in_a_row: u32, reason: Option<&str>) -> String {
    let (side, what) = match direction {
        None => (String::new(), "the machine is"),
        Some(direction) => (format!(" {direction}"), "this direction is"),
    };
    // A misfit of all throws is nearly always the load of the machine, and seldom a setting.
    let check = match reason.and_then(|code| code.parse().ok()) {
        Some(RejectionCode::Misfit) => {
            "for a load that varies along the stroke (slide chairs, rods, locking), then for play, then whether \
             current and position are of the same moment, and neutral_mm and motor"
        }
        Some(RejectionCode::Undersampled) => {
            "the sampling rate of the logger, and set anti_alias_hz if it has a filter"
        }
        Some(RejectionCode::StartMissing | RejectionCode::OnsetMissing | RejectionCode::MovedBeforeCurrent) => {
            "that the logger records some tenths of a second before the motor starts, and that current and position are of \
             the same moment"
        }
        Some(RejectionCode::EndMissing) => {
            "that the logger records until the motor is off, and whether the machine became slow"
        }
        Some(RejectionCode::Reopened) => "lock, brake and drive, which must hold the toe closed",
        Some(RejectionCode::Clipped) => "the measuring range of the logger, which is too small",
        Some(RejectionCode::NotPositive) => {
            "neutral_mm, as a wrong one makes the friction of one direction negative, then the machine and its sensors"
        }
        Some(RejectionCode::NoPosition) => {
            "whether the logger sends position_mm or, without a toe sensor, the direction: a throw without both is not monitored"
        }
        _ => "the machine and its sensors",
    };
    let reason = reason.map_or_else(String::new, |code| format!(" (last reason: {code})"));
    format!(
        "Machine {name}: the last {}{side} could not be evaluated{reason}, so {what} not monitored. Check \
         {check}; throw_features has the details of each throw.",
        counted(in_a_row, "throw")
    )
}

pub(crate) const MONITORED_AGAIN: &str = "it is monitored again.";

/// Text for a machine that is monitored, with many rejected throws.
pub(crate) fn often_rejected(name: &str, direction: Direction, rejected: u32, of: u32, code: &str) -> String {
    let reason = match code.parse() {
        Ok(RejectionCode::NoPosition) => "features only".to_owned(),
        _ => code.replace('_', " "),
    };
    format!(
        "Machine {name}, {direction}: {rejected} of the last throws (at most {of}) were rejected (the last: {reason}), so a \
         fault is detected later. throws_not_evaluated has the reasons."
    )
}

/// Text for a machine whose throws end before the configured stroke.
pub(crate) fn short_of_stroke(name: &str, [travel_mm, stroke_mm]: [f64; 2]) -> String {
    format!(
        "Machine {name}: its throws end at {travel_mm:.1} mm of a stroke of {stroke_mm:.1} mm, without an \
         obstruction. Correct stroke_mm if this is the whole stroke; else check the gain of the position sensor."
    )
}

/// Text for a machine whose toe moves less than points ever do.
pub(crate) fn small_travel(name: &str, travel_mm: f64) -> String {
    format!(
        "Machine {name}: its toe moves {travel_mm:.1} mm, much less than that of most points. If position_mm is in \
         centimetres ({:.0} mm) or in inches ({:.0} mm), send millimetres and take a new baseline (rebaseline).",
        CENTIMETRE_MM * travel_mm,
        INCH_MM * travel_mm
    )
}

/// Text for a machine without a toe position whose throws no longer give the coefficients of its baseline.
pub(crate) fn lost_coefficients(name: &str, throws: u32) -> String {
    format!(
        "Machine {name}: its last {throws} throws give no coefficients, although the throws of its baseline did, so \
         only duration, running current and charge are monitored. The reasons are in throws_not_evaluated. A fault \
         may be the reason: inspect the machine."
    )
}

/// Caveat about a logger that names the same direction for all of the last `throws`.
pub(crate) fn same_direction(name: &str, direction: Direction, throws: u32) -> String {
    format!(
        "Machine {name}: the logger names the direction {direction} for all of the last {throws} throws, but points \
         throw to both sides in turn. So both directions share one baseline, in which faults are hard to see. Check \
         the direction in the logger, then take a new baseline (rebaseline)."
    )
}

/// Text for a machine without a baseline of its coefficients.
pub(crate) const ONLY_FEATURES: &str = "\
    it has no baseline of its coefficients yet, so only duration, running current, charge and travel are monitored. \
    A change of these is reported without its cause. throws_not_evaluated has the reason of \
    each throw.";

/// Text for a machine whose neutral position seems to be `off_mm` from the configured one, towards reverse if positive.
/// `is_corrected`: whether the drifts are corrected for this.
pub(crate) fn neutral(name: &str, configured_mm: f64, off_mm: f64, is_corrected: bool) -> String {
    let harder = if off_mm > 0.0 { Direction::ReverseToNormal } else { Direction::NormalToReverse };
    let effect = if is_corrected {
        "The sizes and names of its drifts are corrected for this, a1 of its throws and its ratio to b0 are not."
    } else {
        "Its baseline does not correct this, so the sizes and names of its drifts may be wrong."
    };
    format!(
        "Machine {name}: its friction seems much larger {harder} than in the other direction. If the rails were \
         unstressed at about {:.0} mm, the friction would be equal; configured is neutral_mm = {configured_mm}. \
         {effect} Set neutral_mm to where the rails lie without the machine (this starts a new baseline). If \
         neutral_mm is right, look for parts that are dry or bind {harder}.",
        configured_mm + off_mm
    )
}

/// Text for a machine whose inertia is not monitored. `of_baseline`: because its baseline has only ratios; otherwise
/// because its last throws have only ratios.
pub(crate) fn ratios_only(name: &str, of_baseline: bool) -> String {
    let reasons = "a load that varies along the stroke, play, a brake that releases late, a position behind the \
                   current, or a sampling rate below 500 Hz";
    let (what, advice) = if of_baseline {
        let what = "its baseline has only the ratios of the coefficients, as throws in it were rough";
        (
            what,
            format!(
                "If its last throws are good, take a new baseline (rebaseline); else look for the reason: {reasons}."
            ),
        )
    } else {
        let what = "its last throws are all rough: they give the ratios of the coefficients, but not the coefficients";
        (what, format!("Each throw names its reason: {reasons}."))
    };
    format!(
        "Machine {name}: {what}, so a change of inertia is not monitored. Motor, friction and stiffness are. {advice}"
    )
}

/// Text for a machine whose faults are hidden, at this temperature or by the scatter of its throws.
pub(crate) fn blind(name: &str, blind: &Blindness) -> String {
    let Blindness { cause, below_pct, temperature } = blind;
    let Some(HidingTemperature { temperature_c, baseline_c }) = temperature else {
        return format!(
            "Machine {name}: its throws scatter so much, or vary so slowly, that a change of {cause} below \
             {below_pct:.0} % cannot be distinguished from the scatter, so the machine is not monitored for smaller \
             changes. Look for the reason (weather, supply, sensors), then take a new baseline (rebaseline)."
        );
    };
    let away_k = (temperature_c - baseline_c).abs().max(1.0);
    format!(
        "Machine {name}: at {temperature_c:.0} °C a change of {cause} below {below_pct:.0} % cannot be distinguished \
         from the effect of the temperature. This effect is not known well enough for {away_k:.0} K from the baseline \
         ({baseline_c:.0} °C), so the machine is not monitored for smaller changes. The daemon learns the effect from \
         the next throws. Until then inspect the machine, or take a new baseline (rebaseline) when it is known to be \
         healthy."
    )
}

/// Text for a slow change of the friction of a machine without a temperature.
pub(crate) fn season(name: &str, pct: f64) -> String {
    slow_change(name, "friction", pct, "a change at the critical limit")
}

/// Text for a slow change of the current of a machine that is monitored by its features, without a temperature.
pub(crate) fn season_of_features(name: &str, pct: f64) -> String {
    slow_change(name, "current", pct, "twice the usual limit")
}

fn slow_change(name: &str, what: &str, pct: f64, least: &str) -> String {
    let way = if pct < 0.0 { "fell" } else { "rose" };
    format!(
        "Machine {name}: its {what} {way} by {:.0} % over more than a week. The baseline has no temperature, so the \
         season looks the same as wear or lubrication; only {least} raises an alarm. Publish temperature_c, then take \
         a new baseline (rebaseline).",
        pct.abs()
    )
}

/// Text for a machine whose throws changed steadily while its baseline was taken, by `slopes` per throw.
pub(crate) fn trend(name: &str, slopes: [f64; 3], of_ratios: bool) -> String {
    let of = |(slope, what): (f64, &str)| {
        let pct = percent(slope);
        let digits = if pct.abs() < 0.1 { 3 } else { 2 };
        (slope != 0.0).then(|| format!("{what} {pct:+.digits$} %"))
    };
    let [of_b0, of_a1, of_a0] = slopes;
    let names = if of_ratios && of_b0 == 0.0 {
        ["b0", "a1/b0 (friction, or a weaker motor)", "a0/b0 (stiffness, or a weaker motor)"]
    } else {
        ["b0 (motor or inertia)", "a1 (friction)", "a0 (stiffness)"]
    };
    let changes: Vec<String> = slopes.into_iter().zip(names).filter_map(of).collect();
    let is_wear = of_b0 < 0.0 || of_a1 > 0.0 || of_a0 > 0.0;
    let (from, since) = if is_wear { ("wear or weather", "first") } else { ("running-in, grease or weather", "last") };
    format!(
        "Machine {name}: the baseline has a trend ({} a throw), from {from} while it was taken. It stays \
         provisional, and changes are measured from its {since} throw. Inspect the machine, then take a new baseline \
         (rebaseline).",
        changes.join(", ")
    )
}
