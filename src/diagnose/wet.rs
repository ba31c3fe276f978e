//! Wet spells in the throws of a baseline.
//!
//! Rain lowers the friction of the slide chairs for some hours or days. In the scatter of a baseline it would hide wear for
//! good, and in its centre dry rails would look like a fault. So spells are taken out. Two models of the friction's logarithm
//! are compared: levels, effect of the temperature and slope; and the same with spells, any of those that fit into the throws.
//! The evidence is that of [`super::regression`], in which a machine whose throws wander needs no spells.
//!
//! A baseline may also begin or end in a spell. A fall that lasts to the last throw is one, as wear raises the friction. A
//! rise is the end of a spell only within the first throws: a fault that exists from the first throws on is not detected
//! anyway.

use std::ops::{Range, RangeInclusive};

use serde::{Deserialize, Serialize};

use super::{regression::Series, trend::Filling};

/// Change of the friction's logarithm in a spell: some per cent more and less than the 10 to 30 % of rain, as the edges of a
/// spell are not sharp.
const CHANGE: Range<f64> = -0.47..-0.07;
/// Number of throws of a spell.
const LENGTH: RangeInclusive<usize> = 6..=48;
/// Least number of throws before a spell and after it, unless the throws begin or end with it.
const DRY: usize = 6;
/// Last throw of a spell from the first throw on: a day and a half of rain at twenty throws a day, and some throws of drying.
const FIRST: usize = 34;
/// Least dry part of the throws: the level of the dry throws must be known.
const DRY_PART: f64 = 0.25;
/// Logarithm of the Bayes factor of spells against none.
pub(super) const EVIDENCE: f64 = 2.5;
/// The same if a drift of the friction is above its limit, in which the usual scatter counts too.
pub(super) const EVIDENCE_OF_DRIFT: f64 = -2.0;
/// Throws of drying after the spells that are compared: a sharp end, and some hours.
const DRYING: [u32; 2] = [0, 4];
/// Largest number of spells in a baseline.
const MOST: usize = 3;
/// Throws before an edge and after it whose means show it.
const BESIDE: usize = 3;
/// Number of the most prominent edges of each kind between which spells are compared: some for every spell.
const EDGES: usize = 10;

/// A wet spell.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct WetSpell {
    /// Numbers of its first and last throw among those of the machine.
    first: u32,
    last: u32,
    /// Change of ln a1.
    change: f64,
    /// Throws after the last one in which the machine dries.
    #[serde(default)]
    drying: u32,
}

impl WetSpell {
    /// Change of ln a1.
    pub(super) fn change(&self) -> f64 {
        self.change
    }

    /// Whether it begins with the throw with this number.
    pub(super) fn is_from(&self, order: u32) -> bool {
        self.first == order
    }

    /// Numbers of its first and last throw.
    pub(super) fn throws(&self) -> [u32; 2] {
        [self.first, self.last]
    }

    /// Change of ln a1 in the throw with this number.
    pub(super) fn change_at(&self, order: u32) -> f64 {
        if order < self.first { 0.0 } else { self.change * wetness(order.saturating_sub(self.last), self.drying) }
    }
}

/// Wetness in a throw this many throws after the last one of a spell.
fn wetness(after: u32, drying: u32) -> f64 {
    (1.0 - f64::from(after) / f64::from(drying + 1)).max(0.0)
}

/// The wet spells in the throws of both directions, with at least this evidence.
pub(super) fn wet_spells(filling: &Filling, evidence: f64) -> Vec<WetSpell> {
    /// Coefficient of the friction.
    const A1: usize = 1;
    let values = filling.values(A1, CHANGE.start.abs());
    let means = values.windows(*LENGTH.start()).map(|few| few.iter().sum::<f64>() / few.len() as f64);
    let (low, high) = means.fold((f64::MAX, f64::MIN), |(low, high), mean| (low.min(mean), high.max(mean)));
    if low - high > CHANGE.end {
        return Vec::new();
    }
    let mut levels = filling.levels();
    let level = Series::new(&values, &levels, filling.error_part(A1));
    let of_level = level.evidence().max(level.with(&filling.time()).evidence);
    levels.push(filling.time());
    let sloped = Series::new(&values, &levels, filling.error_part(A1));
    let of_slope = sloped.evidence();
    // A spell must explain the throws better than wear does.
    let gain = |wet: &[f64]| (level.with(wet).evidence - of_level).max(sloped.with(wet).evidence - of_slope);
    let (spells, drying) = likeliest(&values, gain, evidence);
    let columns: Vec<Vec<f64>> =
        spells.iter().map(|spell| column(std::slice::from_ref(spell), drying, values.len())).collect();
    let with_change = |(at, spell): (usize, &Range<usize>)| {
        let mut others = columns.clone();
        let own = others.remove(at);
        others.extend(levels.iter().cloned());
        let change = Series::new(&values, &others, filling.error_part(A1)).with(&own).change;
        let [first, last] = [spell.start, spell.end - 1].map(|index| filling.order(index));
        WetSpell { first, last, change, drying }
    };
    spells.iter().enumerate().map(with_change).filter(|spell| CHANGE.contains(&spell.change)).collect()
}

/// The likeliest spells with one common change, by the `gain` of evidence that they bring; none without enough. Before, those
/// at the first or last throw are as probable as the others, and all of a kind equally. The search starts with the likeliest single spell between two prominent edges, and makes the throws between two
/// edges wet or dry as long as the evidence grows.
fn likeliest(values: &[f64], gain_of: impl Fn(&[f64]) -> f64, evidence: f64) -> (Vec<Range<usize>>, u32) {
    let throws = values.len();
    let Some(latest) = throws.checked_sub(DRY) else { return (Vec::new(), 0) };
    let fits = |spell: &Range<usize>| {
        let begins = if spell.start == 0 { spell.end <= FIRST } else { spell.start >= DRY };
        begins && (spell.end == throws || spell.end <= latest) && LENGTH.contains(&spell.len())
    };
    let fit_together = |spells: &[Range<usize>]| {
        let wet: usize = spells.iter().map(Range::len).sum();
        (1..=MOST).contains(&spells.len())
            && spells.iter().all(fits)
            && (throws - wet) as f64 >= DRY_PART * throws as f64
    };
    let is_inside = |spell: &Range<usize>| spell.start > 0 && spell.end < throws;
    let possible = (0..throws).flat_map(|start| (start..=throws).map(move |end| start..end)).filter(fits);
    let (inside, beside): (Vec<_>, Vec<_>) = possible.partition(is_inside);
    let of_chance = |spell: &Range<usize>| 2.0 * if is_inside(spell) { inside.len() } else { beside.len() } as f64;
    let gain = |spells: &[Range<usize>]| -> (f64, u32) {
        let of = |drying: u32| (gain_of(&column(spells, drying, throws)), drying);
        let (gain, drying) =
            DRYING.map(of).into_iter().fold((f64::NEG_INFINITY, 0), |a, b| if b.0 > a.0 { b } else { a });
        (gain - spells.iter().map(|spell| of_chance(spell).ln()).sum::<f64>(), drying)
    };
    let rise = |at: usize| -> f64 {
        values[at..at + BESIDE].iter().sum::<f64>() - values[at - BESIDE..at].iter().sum::<f64>()
    };
    let mut edges: Vec<usize> = (DRY..=latest).collect();
    edges.sort_by(|a, b| rise(*a).total_cmp(&rise(*b)));
    let falls = edges.iter().take(EDGES).copied().chain([0]);
    let rises = edges.iter().rev().take(EDGES).copied().chain([throws]);
    let pairs: Vec<(usize, usize)> = falls.flat_map(|fall| rises.clone().map(move |rise| (fall, rise))).collect();
    let (mut best, mut spells) = ((f64::NEG_INFINITY, 0), Vec::new());
    loop {
        let changed = pairs.iter().map(|&(fall, rise)| {
            let is_wet = |at: usize| match fall < rise {
                true if (fall..rise).contains(&at) => true,
                false if (rise..fall).contains(&at) => false,
                _ => spells.iter().any(|spell: &Range<usize>| spell.contains(&at)),
            };
            runs(throws, is_wet)
        });
        let allowed = changed.filter(|spells| fit_together(spells));
        let next = allowed.map(|spells| (gain(&spells), spells)).max_by(|a, b| a.0.0.total_cmp(&b.0.0));
        match next {
            Some((more, next)) if more.0 > best.0 => (best, spells) = (more, next),
            _ => return if best.0 > evidence { (spells, best.1) } else { (Vec::new(), 0) },
        }
    }
}

/// The ranges of consecutive throws that are wet.
fn runs(throws: usize, is_wet: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for at in (0..throws).filter(|at| is_wet(*at)) {
        match runs.last_mut() {
            Some(run) if run.end == at => run.end += 1,
            _ => runs.push(at..at + 1),
        }
    }
    runs
}

/// The wetness of the throws: 1 in the spells, less after them while the machine dries.
fn column(spells: &[Range<usize>], drying: u32, throws: usize) -> Vec<f64> {
    let mut wet = vec![0.0_f64; throws];
    for spell in spells {
        wet[spell.clone()].fill(1.0);
        for (wet, after) in wet[spell.end..].iter_mut().zip(1..=drying) {
            *wet = wet.max(wetness(after, drying));
        }
    }
    wet
}
