//! Ticks of a time axis: dates and times in UTC at round moments, as many as fit.

use jiff::{SignedDuration, Timestamp, civil::Date, tz::TimeZone};

/// A tick: its value and label, and a second label below (the date or the year) if it differs from that of the tick
/// before.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub(super) value: f64,
    pub(super) label: String,
    pub(super) below: Option<String>,
}

const DAY: i64 = 86_400;
/// Midnight of a Monday \[s since 1970\]. Steps of fixed length count from it, so that weeks begin on Mondays.
const MONDAY: i64 = 4 * DAY;
/// Possible distances of ticks with fixed length, up to two weeks \[s\].
const FIXED: [i64; 22] = [
    1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1_800, 3_600, 7_200, 10_800, 21_600, 43_200, 86_400, 172_800, 345_600,
    604_800, 1_209_600,
];
/// Longer possible distances of ticks \[months\].
const MONTHS: [i64; 15] = [1, 3, 6, 12, 24, 60, 120, 240, 600, 1_200, 2_400, 6_000, 12_000, 24_000, 60_000];
/// Least space between neighbouring labels \[characters\].
const GAP: f64 = 1.5;

/// Distance between ticks.
#[derive(Debug, Clone, Copy)]
enum Step {
    Seconds(i64),
    Months(i64),
}

impl Step {
    /// Least length \[s\].
    fn length_s(self) -> f64 {
        match self {
            Self::Seconds(seconds) => seconds as f64,
            // February has 28 days.
            Self::Months(months) => (months * 28 * DAY) as f64,
        }
    }

    /// Format of the label, width of the label \[characters\], and format of the second label below it.
    const fn labels(self) -> (&'static str, f64, &'static str) {
        match self {
            Self::Seconds(..60) => ("%H:%M:%S", 8.0, "%-d %b %Y"),
            Self::Seconds(..DAY) => ("%H:%M", 5.0, "%-d %b %Y"),
            Self::Seconds(_) => ("%-d %b", 6.0, "%Y"),
            Self::Months(..12) => ("%b", 3.0, "%Y"),
            Self::Months(_) => ("%Y", 4.0, ""),
        }
    }

    /// Whether the labels fit on an axis of `span_s` seconds that is `characters` long.
    fn fits(self, span_s: f64, characters: f64) -> bool {
        let (_, width, _) = self.labels();
        self.length_s() / span_s * characters >= width + GAP
    }

    /// The moment of tick number `count`, counted from the last tick at or before `low`. `None` if no calendar has it.
    fn moment(self, low: Timestamp, count: i64) -> Option<Timestamp> {
        match self {
            Self::Seconds(step) => {
                let first = (low.as_second() - MONDAY).div_euclid(step) + count;
                Timestamp::from_second(first * step + MONDAY).ok()
            }
            Self::Months(step) => {
                let low = TimeZone::UTC.to_datetime(low);
                let month = ((i64::from(low.year()) * 12 + i64::from(low.month()) - 1).div_euclid(step) + count) * step;
                let year = i16::try_from(month.div_euclid(12)).ok()?;
                let month = i8::try_from(month.rem_euclid(12) + 1).ok()?;
                Some(Date::new(year, month, 1).ok()?.to_zoned(TimeZone::UTC).ok()?.timestamp())
            }
        }
    }
}

/// Ticks between two moments \[s since 1970\] on an axis that is `characters` of a label long.
pub(super) fn ticks(low: f64, high: f64, characters: f64) -> Vec<Tick> {
    let mut steps = FIXED.into_iter().map(Step::Seconds).chain(MONTHS.into_iter().map(Step::Months));
    let Some(step) = steps.find(|step| step.fits(high - low, characters)) else { return Vec::new() };
    let Some(start) = timestamp(low) else { return Vec::new() };
    let (label, _, below) = step.labels();
    let mut ticks: Vec<Tick> = Vec::new();
    let mut last = String::new();
    for at in (0..).map_while(|count| step.moment(start, count)) {
        let value = at.as_second() as f64;
        if value > high {
            break;
        }
        if value >= low {
            let now = at.strftime(below).to_string();
            let below = (now != last).then(|| now.clone());
            ticks.push(Tick { value, label: at.strftime(label).to_string(), below });
            last = now;
        }
    }
    // The first date is dropped if the next one would overlap it.
    let next = ticks.iter().skip(1).find(|tick| tick.below.is_some()).map(|tick| tick.value);
    if let (Some(first), Some(next)) = (ticks.first_mut(), next) {
        let width = first.below.as_ref().map_or(0, String::len) as f64;
        if (next - first.value) / (high - low) * characters < width + GAP {
            first.below = None;
        }
    }
    ticks
}

fn timestamp(second: f64) -> Option<Timestamp> {
    Timestamp::from_duration(SignedDuration::try_from_secs_f64(second).ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Length of the axis of a dashboard chart.
    const CHARACTERS: f64 = 42.0;

    /// The labels of the ticks between two moments, with the second label after a slash.
    fn labels(from: &str, to: &str) -> Vec<String> {
        let second = |text: &str| text.parse::<Timestamp>().unwrap().as_second() as f64;
        let text = |tick: Tick| match tick.below {
            Some(below) => format!("{}/{below}", tick.label),
            None => tick.label,
        };
        ticks(second(from), second(to), CHARACTERS).into_iter().map(text).collect()
    }

    #[test]
    fn each_span_has_its_own_labels() {
        assert_eq!(
            labels("2026-11-21T10:00:07Z", "2026-11-21T10:01:00Z"),
            ["10:00:15/21 Nov 2026", "10:00:30", "10:00:45", "10:01:00"]
        );
        assert_eq!(
            labels("2026-11-21T21:10:00Z", "2026-11-22T02:00:00Z"),
            ["22:00/21 Nov 2026", "23:00", "00:00/22 Nov 2026", "01:00", "02:00"]
        );
        assert_eq!(
            labels("2026-12-20T10:00:00Z", "2027-01-20T10:00:00Z"),
            ["21 Dec/2026", "28 Dec", "4 Jan/2027", "11 Jan", "18 Jan"]
        );
        assert_eq!(
            labels("2026-08-05T02:50:00Z", "2027-03-17T19:50:00Z"),
            ["Sep/2026", "Oct", "Nov", "Dec", "Jan/2027", "Feb", "Mar"]
        );
        assert_eq!(
            labels("1969-12-31T23:00:00Z", "2026-11-21T10:00:00Z"),
            ["1970", "1980", "1990", "2000", "2010", "2020"]
        );
    }

    #[test]
    fn labels_never_overlap_and_always_show_the_date() {
        // Spans from a minute to eight hundred years, with different starts.
        for power in 0..110 {
            for shift in 0..40 {
                let span = 60.0 * 1.2_f64.powi(power) + f64::from(shift);
                let low = -2e9 + 1.234_567e8 * f64::from(shift);
                let ticks = ticks(low, low + span, CHARACTERS);
                assert!(ticks.len() >= 2, "{span} s from {low}: {ticks:?}");
                let place = |tick: &Tick| (tick.value - low) / span * CHARACTERS;
                let apart = |row: Vec<(f64, usize)>| {
                    row.windows(2).all(|two| two[1].0 - two[0].0 >= (two[0].1 + two[1].1) as f64 / 2.0 + 1.0)
                };
                assert!(ticks.iter().all(|tick| (0.0..=CHARACTERS).contains(&place(tick))), "{ticks:?}");
                assert!(apart(ticks.iter().map(|tick| (place(tick), tick.label.len())).collect()), "{span}: {ticks:?}");
                let below: Vec<_> =
                    ticks.iter().filter_map(|tick| Some((place(tick), tick.below.as_ref()?.len()))).collect();
                let has_year = ticks[0].label.len() == 4 || !below.is_empty();
                assert!(has_year && apart(below), "{span} s from {low}: {ticks:?}");
            }
        }
    }
}
