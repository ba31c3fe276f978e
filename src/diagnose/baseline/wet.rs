//! Wet spells in the throws of a baseline.
//!
//! Rain lowers the friction of the slide chairs for some hours or days. A wet spell in the throws of a baseline would
//! increase its scatter, and a larger scatter hides wear. So the effect of each spell that begins and ends within these
//! throws is subtracted. The evidence compares two models of the logarithm of the friction. The first has a level for
//! each direction, the effect of the temperature and a slope. The second has wet spells in addition. The evidence is
//! that of [`Series`], in which slow random changes do not look like spells.

use std::ops::{Range, RangeInclusive};

use serde::{Deserialize, Serialize};

use super::Filling;
use crate::diagnose::statistics::Series;

/// Change of ln a1 in a spell: 10 to 25 % by rain, and some per cent less and more, as its edges are not sharp.
const CHANGE: Range<f64> = -0.34..-0.07;
/// Number of throws in a spell.
const LENGTH: RangeInclusive<usize> = 6..=LONGEST_SPELL;
/// Largest number of throws in a spell.
pub(crate) const LONGEST_SPELL: usize = 48;
/// Least number of dry throws before a spell and after it; without them, a change is a step and not rain.
const DRY_THROWS: usize = 6;
/// Least logarithm of the Bayes factor of a model with spells against one without.
const EVIDENCE: f64 = 4.0;
/// Largest number of spells in a baseline.
const MAX_SPELLS: usize = 3;
/// Number of throws on each side of an edge whose mean values show the edge.
const BESIDE: usize = 3;
/// Number of the clearest edges of each kind, down and up, between which spells are searched: several for each spell.
const EDGES: usize = 10;

/// A wet spell among the throws of a baseline.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct WetSpell {
    /// Number of its first throw, counted by the machine's monitor.
    first: u32,
    /// Number of its last throw.
    last: u32,
    /// Change of ln a1.
    change: f64,
}

impl WetSpell {
    /// Change of ln a1 by this spell in the throw with the number `order`.
    pub(super) fn change_at(&self, order: u32) -> f64 {
        if (self.first..=self.last).contains(&order) { self.change } else { 0.0 }
    }
}

/// The wet spells in the throws of both directions.
pub(crate) fn wet_spells(filling: &Filling) -> Vec<WetSpell> {
    /// Index of ln a1 in the logarithms.
    const A1: usize = 1;
    let values = filling.values(A1, CHANGE.start.abs());
    if !values.windows(*LENGTH.start()).any(|few| few.iter().sum::<f64>() < CHANGE.end * few.len() as f64) {
        return Vec::new();
    }
    let mut levels = filling.levels();
    levels.push(filling.time());
    let spells = likeliest(&values, &Series::new(&values, &levels, filling.error_part[A1]));
    let columns: Vec<Vec<f64>> = spells.iter().map(|spell| column(std::slice::from_ref(spell), values.len())).collect();
    let with_change = |(at, spell): (usize, &Range<usize>)| {
        let mut others = columns.clone();
        let own = others.remove(at);
        others.extend(levels.iter().cloned());
        let change = Series::new(&values, &others, filling.error_part[A1]).with(&own).change;
        let [first, last] = [spell.start, spell.end - 1].map(|index| filling.throws[index].order);
        WetSpell { first, last, change }
    };
    spells.iter().enumerate().map(with_change).filter(|spell| CHANGE.contains(&spell.change)).collect()
}

/// The likeliest spells, for a common change of ln a1 in all of them; none without enough evidence. All spells that fit
/// have the same prior probability. The search starts with the likeliest single spell between two clear edges. Then it
/// makes the throws between two edges wet or dry as long as this increases the evidence.
fn likeliest(values: &[f64], series: &Series) -> Vec<Range<usize>> {
    let throws = values.len();
    let Some(latest) = throws.checked_sub(DRY_THROWS) else { return Vec::new() };
    let fits = |spell: &Range<usize>| DRY_THROWS <= spell.start && spell.end <= latest && LENGTH.contains(&spell.len());
    let possible =
        (DRY_THROWS..=latest).flat_map(|start| (start..=latest).map(move |end| start..end)).filter(fits).count();
    let (without, of_chance) = (series.evidence(), (possible as f64).ln());
    let gain = |spells: &[Range<usize>]| -> f64 {
        series.with(&column(spells, throws)).evidence - without - spells.len() as f64 * of_chance
    };
    let rise = |at: usize| -> f64 {
        values[at..at + BESIDE].iter().sum::<f64>() - values[at - BESIDE..at].iter().sum::<f64>()
    };
    let mut edges: Vec<usize> = (DRY_THROWS..=latest).collect();
    edges.sort_by(|a, b| rise(*a).total_cmp(&rise(*b)));
    let falls = edges.iter().take(EDGES);
    let rises = edges.iter().rev().take(EDGES);
    let pairs: Vec<(usize, usize)> = falls.flat_map(|fall| rises.clone().map(move |rise| (*fall, *rise))).collect();
    let (mut best, mut spells) = (f64::NEG_INFINITY, Vec::new());
    loop {
        let changed = pairs.iter().map(|&(fall, rise)| {
            let is_wet = |at: usize| match fall < rise {
                true if (fall..rise).contains(&at) => true,
                false if (rise..fall).contains(&at) => false,
                _ => spells.iter().any(|spell: &Range<usize>| spell.contains(&at)),
            };
            runs(throws, is_wet)
        });
        let allowed = changed.filter(|spells| (1..=MAX_SPELLS).contains(&spells.len()) && spells.iter().all(fits));
        let next = allowed.map(|spells| (gain(&spells), spells)).max_by(|a, b| a.0.total_cmp(&b.0));
        match next {
            Some((more, next)) if more > best => (best, spells) = (more, next),
            _ => return if best > EVIDENCE { spells } else { Vec::new() },
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

/// The regressor of the spells: 1 in their throws, 0 in the others.
fn column(spells: &[Range<usize>], throws: usize) -> Vec<f64> {
    (0..throws).map(|at| f64::from(u8::from(spells.iter().any(|spell| spell.contains(&at))))).collect()
}
