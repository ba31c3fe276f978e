//! Fleets of healthy machines whose scatter or weather the diagnosis does not assume.

use rand_chacha::ChaCha8Rng;

use super::{
    scatter::Scatter,
    timeline::Timeline,
    weather::{Climate, WetSpells},
};

/// A fleet of healthy machines.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fleet {
    pub(super) label: &'static str,
    pub(super) scatter: Scatter,
    weather: fn(&mut Timeline, &mut ChaCha8Rng),
}

/// Scatter three times the usual one.
const TRIPLE_SD: [f64; 3] = [3.0 * Scatter::USUAL.sd[0], 3.0 * Scatter::USUAL.sd[1], 3.0 * Scatter::USUAL.sd[2]];

/// The fleets, in the order of the table. The index of a fleet determines its random streams.
pub(super) const FLEETS: [Fleet; 7] = [
    scattering("serial correlation 0.5", Scatter::USUAL),
    scattering("serial correlation 0.8", Scatter { phi: 0.8, ..Scatter::USUAL }),
    scattering("serial correlation 0.9", Scatter { phi: 0.9, ..Scatter::USUAL }),
    scattering("Student's t, 3 degrees of freedom", Scatter { tail: Some(3), ..Scatter::USUAL }),
    scattering("three times the scatter", Scatter { sd: TRIPLE_SD, ..Scatter::USUAL }),
    // Seasons with 20 K up and down, and 3 K over a day.
    Fleet {
        label: "year of +-20 K, not published",
        scatter: Scatter::USUAL,
        weather: |life, random| life.climate = Some(Climate::year(random)),
    },
    // Rare spells with 20 % less friction for 15 throws.
    Fleet {
        label: "wet spells",
        scatter: Scatter::USUAL,
        weather: |life, random| life.wet = WetSpells::new(life.throws, random),
    },
];

const fn scattering(label: &'static str, scatter: Scatter) -> Fleet {
    Fleet { label, scatter, weather: |_, _| {} }
}

impl Fleet {
    /// A life of `throws` throws in the weather of this fleet.
    pub(super) fn life(&self, throws: usize, random: &mut ChaCha8Rng) -> Timeline {
        let mut life = Timeline::healthy(throws);
        (self.weather)(&mut life, random);
        life
    }
}
