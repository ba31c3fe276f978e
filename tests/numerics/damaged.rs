//! Damaged traces: each is rejected with its reason, or its damage does no harm.

use pointsd::estimate::{Identification, Identifier, Rejection, Settings};
use pointsd::simulate::{Conditions, Parameters, Sensors};
use pointsd::throw::{Channel, Direction, Throw, Trace};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use super::identify::{settings_of, simulated, simulated_in};

#[derive(Clone)]
pub(crate) struct Channels {
    rate_hz: f64,
    current: Vec<f64>,
    position: Vec<f64>,
}

impl Channels {
    pub(crate) fn healthy(sensors: &Sensors, direction: Direction, seed: u64) -> Self {
        let throw = simulated(&Parameters::default(), sensors, direction, seed);
        let rate_hz = throw.trace.sample_rate_hz();
        let (current, position) = (throw.trace.current_a().to_vec(), throw.trace.position_mm().to_vec());
        Self { rate_hz, current, position }
    }

    pub(crate) fn identify(&self, identifier: &mut Identifier, settings: &Settings) -> Identification {
        let trace = Trace::new(self.rate_hz, self.current.clone(), self.position.clone()).unwrap();
        identifier.identify(&Throw::recorded(trace), settings)
    }
}

/// Channels that a random damage changes.
#[derive(Clone, Copy)]
enum Damaged {
    Position,
    Current,
    Both,
}

/// Damages the channels at random; returns the name of the damage.
#[expect(clippy::too_many_lines, reason = "one arm for each kind of damage")]
pub(crate) fn mutate(channels: &mut Channels, rng: &mut ChaCha8Rng) -> &'static str {
    let len = channels.current.len();
    let from = rng.random_range(0..len);
    let to = (from + rng.random_range(1..=len / 4)).min(len);
    let size = 10.0_f64.powf(rng.random_range(-1.0..2.0)) * if rng.random() { 1.0 } else { -1.0 };
    let kind = rng.random_range(0..16);
    let damaged = match rng.random_range(0..3) {
        0 => Damaged::Position,
        1 => Damaged::Current,
        _ => Damaged::Both,
    };
    let mut pick = |apply: &dyn Fn(&mut Vec<f64>)| {
        if matches!(damaged, Damaged::Current | Damaged::Both) {
            apply(&mut channels.current);
        }
        if matches!(damaged, Damaged::Position | Damaged::Both) {
            apply(&mut channels.position);
        }
    };
    match kind {
        0 => {
            let value = [f64::NAN, f64::INFINITY, 188_776.0, -1e300, 0.0][rng.random_range(0..5)];
            pick(&|c| c[from] = value);
            "value"
        }
        1 => {
            pick(&|c| c[from] += size);
            "spike"
        }
        2 => {
            pick(&|c| c[from..to].iter_mut().for_each(|v| *v += size));
            "shifted stretch"
        }
        3 => {
            let factor = rng.random_range(-2.0..3.0);
            pick(&|c| c[from..to].iter_mut().for_each(|v| *v *= factor));
            "scaled stretch"
        }
        4 => {
            channels.current.drain(from..to);
            channels.position.drain(from..to);
            "lost stretch"
        }
        5 => {
            let copy = [channels.current[from..to].to_vec(), channels.position[from..to].to_vec()];
            channels.current.splice(from..from, copy[0].iter().copied());
            channels.position.splice(from..from, copy[1].iter().copied());
            "repeated stretch"
        }
        6 => {
            pick(&|c| {
                let value = c[from];
                c[from..to].fill(value);
            });
            "frozen stretch"
        }
        7 => {
            pick(&|c| c[from..to].fill(0.0));
            "zeroed stretch"
        }
        8 => {
            pick(&|c| c[from..to].reverse());
            "reversed stretch"
        }
        9 => {
            pick(&|c| c.reverse());
            "reversed"
        }
        10 => {
            let by = rng.random_range(1..=len / 20);
            // Only the shift between the channels counts, so either of them may move.
            let channel = match damaged {
                Damaged::Position => &mut channels.current,
                Damaged::Current | Damaged::Both => &mut channels.position,
            };
            if rng.random() {
                channel.rotate_left(by);
            } else {
                channel.rotate_right(by);
            }
            "channels apart"
        }
        11 => {
            channels.current.truncate(from.max(1));
            channels.position.truncate(from.max(1));
            "cut off"
        }
        12 => {
            channels.current.drain(..from);
            channels.position.drain(..from);
            "begun late"
        }
        13 => {
            let limit = size.abs();
            pick(&|c| c.iter_mut().for_each(|v| *v = v.clamp(-limit, limit)));
            "clipped"
        }
        14 => {
            let seed = rng.random();
            pick(&|c| {
                let mut noise = ChaCha8Rng::seed_from_u64(seed);
                for value in c.iter_mut() {
                    *value += size * noise.random_range(-1.0..1.0);
                }
            });
            "noise"
        }
        _ => {
            let bit = 1_u64 << rng.random_range(0..64);
            pick(&|c| c[from] = f64::from_bits(c[from].to_bits() ^ bit));
            "flipped bit"
        }
    }
}

/// Description, expected qualities joined by `|`, and the damage to a healthy trace.
type Damage = (&'static str, &'static str, fn(&mut Channels));

const TABLE: &[Damage] = &[
    ("one NaN in the current", "good", |c| c.current[900] = f64::NAN),
    ("one NaN before the motor's start", "good", |c| c.current[5] = f64::NAN),
    ("three NaN in a row in the position", "good", |c| c.position[900..903].fill(f64::NAN)),
    ("one NaN in the inrush", "rough", |c| c.current[203] = f64::NAN),
    ("five NaN in a row in the inrush", "rough", |c| c.current[203..208].fill(f64::NAN)),
    ("eleven NaN in a row", "not_finite", |c| c.current[900..911].fill(f64::NAN)),
    ("every fiftieth current is NaN", "not_finite", |c| c.current.iter_mut().step_by(50).for_each(|i| *i = f64::NAN)),
    ("one infinity in the position", "not_finite", |c| c.position[900] = f64::INFINITY),
    ("a corrupt current of 188,776 A", "implausible_value", |c| c.current[1200] = 188_776.0),
    ("a corrupt position of 1e300 mm", "implausible_value", |c| c.position[1200] = 1e300),
    ("the toe stands still", "no_movement", |c| c.position.fill(3.0)),
    ("there is no toe sensor", "current_only", |c| c.position.fill(0.0)),
    ("the current channel is dead", "no_current", |c| c.current.fill(0.01)),
    ("three samples", "too_short", |c| c.keep(0..3)),
    ("only the first 30 ms of the throw", "too_short", |c| c.keep(0..230)),
    ("the first 250 ms of the throw", "too_short", |c| c.keep(0..450)),
    ("half of the throw", "end_missing", |c| c.keep(0..1200)),
    ("two thirds of the throw", "end_missing", |c| c.keep(0..3000)),
    ("the position in metres", "wrong_unit", |c| c.position.iter_mut().for_each(|x| *x *= 1e-3)),
    ("the current in milliamperes", "implausible_value", |c| c.current.iter_mut().for_each(|i| *i *= 1e3)),
    ("begun 300 ms after the motor's start", "moved_before_current", |c| c.keep(500..4500)),
    ("begun 6 ms after the motor's start", "rough", |c| c.keep(206..c.current.len())),
    ("begun 6 ms after the motor's start, and cut at the end", "end_missing", |c| c.keep(206..4500)),
    ("the current half a second late", "moved_before_current", |c| c.current.rotate_right(500)),
    ("the toe comes back half-way", "moved_backwards", |c| {
        let half = c.position[2200];
        for (k, x) in c.position[2200..].iter_mut().enumerate() {
            *x = half - 0.02 * k as f64;
        }
    }),
    ("2 mm of position lost at once", "position_jump", |c| c.position[2200..].iter_mut().for_each(|x| *x += 2.0)),
    ("100 samples lost in mid-throw", "position_jump", |c| {
        c.current.drain(2000..2100);
        c.position.drain(2000..2100);
    }),
    ("the current clipped at 8 A", "clipped", |c| c.current.iter_mut().for_each(|i| *i = i.min(8.0))),
    ("the negative current clipped at -8 A", "clipped", |c| c.current.iter_mut().for_each(|i| *i = -i.min(8.0))),
    ("the current stuck for half a second", "stuck", |c| {
        let stuck = c.current[2000];
        c.current[2000..2500].fill(stuck);
    }),
    ("the position stuck from half-way on", "stuck", |c| {
        let stuck = c.position[2000];
        c.position[2000..].fill(stuck);
    }),
    ("the position stuck for 60 ms", "position_jump", |c| {
        let stuck = c.position[2000];
        c.position[2000..2060].fill(stuck);
    }),
    ("a lone current of 5 A", "spike", |c| c.current[1500] += 5.0),
    ("a lone position 0.3 mm off", "spike|position_jump", |c| c.position[1500] += 0.3),
    ("1 A of noise in the current", "noisy", |c| c.noise_in_current(1.0)),
    ("2 mm of noise in the position", "noisy", |c| c.noise_in_position(2.0)),
    ("6 mm of noise in the position", "noisy", |c| c.noise_in_position(6.0)),
    ("20 mm of noise in the position", "noisy", |c| c.noise_in_position(20.0)),
    ("45 mm of noise in the position", "noisy", |c| c.noise_in_position(45.0)),
    ("an open input in place of the position", "noisy", |c| {
        let mut noise = ChaCha8Rng::seed_from_u64(4);
        c.position.iter_mut().for_each(|x| *x = 115.0 * noise.random::<f64>());
    }),
    ("hum of 6 mm in the position", "noisy", |c| {
        for (k, x) in c.position.iter_mut().enumerate() {
            *x += 6.0 * (std::f64::consts::TAU * 0.05 * k as f64).sin();
        }
    }),
    ("a tenth of the true sampling rate", "too_slow", |c| c.rate_hz = 100.0),
    ("every tenth sample only, unfiltered", "undersampled", |c| {
        c.rate_hz = 100.0;
        c.current = c.current.iter().step_by(10).copied().collect();
        c.position = c.position.iter().step_by(10).copied().collect();
    }),
    ("played backwards", "not_positive", |c| {
        c.current.reverse();
        c.position.reverse();
    }),
    ("the current off for 200 ms while the toe moves on", "current_jump", |c| {
        for (k, i) in c.current[2000..2200].iter_mut().enumerate() {
            *i = 0.02 * (k as f64).sin();
        }
    }),
    ("the current doubled for a second", "current_jump", |c| {
        c.current[2000..3000].iter_mut().for_each(|i| *i *= 2.0);
    }),
    ("the current's gain a third higher for a second", "current_jump|gain_changed", |c| {
        c.current[300..1300].iter_mut().for_each(|i| *i *= 1.35);
    }),
    ("the inrush and what went before at twice the gain", "current_jump|gain_changed", |c| {
        c.current[..900].iter_mut().for_each(|i| *i *= 2.0);
    }),
    ("0.3 mm of position lost for half a second", "position_jump", |c| {
        c.position[1500..2000].iter_mut().for_each(|x| *x += 0.3);
    }),
    ("the first sample of the inrush is zero", "rough", |c| c.current[201] = 0.0),
    ("the current 10 ms late", "rough", |c| c.current.rotate_right(10)),
    ("the position 40 ms late", "rough", |c| {
        let first = c.position[0];
        c.position.rotate_right(40);
        c.position[..40].fill(first);
    }),
    ("a position that has nothing to do with the current", "misfit|not_positive", |c| {
        for (k, x) in c.position.iter_mut().enumerate() {
            let share = (k as f64 - 200.0).clamp(0.0, 4000.0) / 4000.0;
            *x = 115.0 * share * share * (3.0 - 2.0 * share);
        }
    }),
];

impl Channels {
    fn keep(&mut self, range: std::ops::Range<usize>) {
        let range = range.start..range.end.min(self.current.len());
        self.current = self.current[range.clone()].to_vec();
        self.position = self.position[range].to_vec();
    }

    /// Adds noise with this standard deviation \[A\] to the current.
    fn noise_in_current(&mut self, a: f64) {
        add_noise(&mut self.current, a);
    }

    /// Adds noise with this standard deviation \[mm\] to the position.
    fn noise_in_position(&mut self, mm: f64) {
        add_noise(&mut self.position, mm);
    }
}

/// Adds uniform noise with this standard deviation.
fn add_noise(channel: &mut [f64], sd: f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for value in channel {
        *value += sd * 1.7 * rng.random_range(-1.0..1.0);
    }
}

#[test]
fn every_damaged_trace_has_its_quality_or_its_reason() {
    let settings = settings_of(&Parameters::default());
    let mut wrong = Vec::new();
    for (what, code, damage) in TABLE {
        let mut channels = Channels::healthy(&Sensors::default(), Direction::NormalToReverse, 5);
        damage(&mut channels);
        let found = channels.identify(&mut Identifier::default(), &settings);
        let quality = found.quality();
        if !code.split('|').any(|code| code == quality) {
            wrong.push(format!("{what}: {quality} instead of {code}: {:?}", found.outcome));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A motor that the rails help takes much less current than its mean with the inrush.
#[test]
fn a_recording_cut_soon_after_the_inrush_is_no_obstruction() {
    let settings = Settings { stroke_mm: Some(115.0), ..settings_of(&Parameters::default()) };
    for direction in Direction::BOTH {
        for cut in [500, 800, 1000, 1500, 4000] {
            let mut channels = Channels::healthy(&Sensors::default(), direction, 4);
            channels.keep(0..cut);
            let found = channels.identify(&mut Identifier::default(), &settings);
            assert_eq!(found.quality(), "end_missing", "{direction}, {cut}: {:?}", found.outcome);
        }
    }
}

/// Means over four samples before and after the start of the toe differ as after a jump.
#[test]
fn the_start_of_the_toe_in_a_slow_recording_is_no_jump() {
    for (sample_rate_hz, direction, seed) in
        [(250.0, Direction::ReverseToNormal, 14), (260.0, Direction::NormalToReverse, 14)]
    {
        for seed in [seed, 1, 2] {
            let sensors = Sensors { sample_rate_hz, ..Sensors::default() };
            let found =
                Channels::healthy(&sensors, direction, seed).identify(&mut Identifier::default(), &Settings::default());
            assert_eq!(found.quality(), "rough", "{direction}, {seed}: {:?}", found.outcome);
        }
    }
}

/// Noise above the configured one must not switch off the check of the ratios' error.
#[test]
fn a_position_that_has_nothing_to_do_with_the_current_gives_no_ratios_with_noise_either() {
    let (_, _, damage) = TABLE.iter().find(|(what, ..)| what.contains("nothing to do with the current")).unwrap();
    let mut channels = Channels::healthy(&Sensors::default(), Direction::NormalToReverse, 5);
    damage(&mut channels);
    let settings = Settings { current_noise_a: 0.002, ..settings_of(&Parameters::default()) };
    assert_eq!(channels.identify(&mut Identifier::default(), &settings).quality(), "noisy");
}

/// A logger that samples a slow sensor at 1 kHz repeats each value five times. The reader looks for the damage in the
/// trace that the logger sent.
#[test]
fn the_reason_for_a_channel_with_repeated_values_refers_to_the_sent_trace() {
    let healthy = Channels::healthy(&Sensors::default(), Direction::NormalToReverse, 1);
    let held = |values: &[f64]| (0..values.len()).map(|at| values[at.saturating_sub(3) / 5 * 5 + 3]).collect();
    let with = |damage: std::ops::Range<usize>, value: f64| {
        let mut channels =
            Channels { rate_hz: healthy.rate_hz, current: held(&healthy.current), position: held(&healthy.position) };
        channels.current[damage].fill(value);
        let trace = Trace::new(channels.rate_hz, channels.current.clone(), channels.position).unwrap();
        let throw = Throw { anti_alias_hz: Some(150.0), ..Throw::recorded(trace) };
        let found = Identifier::default().identify(&throw, &settings_of(&Parameters::default()));
        // The declared filter is below half of the rate that the logger sent.
        assert_eq!(found.unused_fields, None);
        (found.outcome.unwrap_err(), channels.current)
    };
    let (reason, _) = with(1003..1008, 1e6);
    let Rejection::ImplausibleValue { at_s, .. } = reason else { panic!("{reason}") };
    assert!((at_s - 1.003).abs() < 1e-9, "{at_s}");
    let (reason, current) = with(1003..1041, f64::NAN);
    let Rejection::NotFinite { sample, at_s, .. } = reason else { panic!("{reason}") };
    assert!(current[sample].is_nan() && (at_s - sample as f64 * 1e-3).abs() < 1e-9, "{sample}, {at_s}");
}

#[test]
fn a_few_missing_samples_do_not_change_the_coefficients() {
    let settings = settings_of(&Parameters::default());
    for seed in 0..5 {
        for direction in Direction::BOTH {
            let mut channels = Channels::healthy(&Sensors::default(), direction, seed);
            let identify = |channels: &Channels| channels.identify(&mut Identifier::default(), &settings);
            let whole = identify(&channels).outcome.unwrap();
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            for _ in 0..12 {
                let at = rng.random_range(450..channels.current.len());
                channels.current[at] = f64::NAN;
                channels.position[at / 2 + 225] = f64::NAN;
            }
            let found = identify(&channels);
            assert_eq!(found.quality(), "good", "{:?}", found.outcome);
            let found = found.outcome.unwrap();
            for at in 0..3 {
                let change = (found.coefficients()[at] - whole.coefficients()[at]) / whole.sd()[at];
                assert!(change.abs() < 0.5, "{direction}: coefficient {at} changes by {change} standard deviations");
            }
        }
    }
}

#[test]
fn faults_of_the_machine_are_distinguished_from_those_of_the_sensors() {
    let machine = Parameters::default();
    let outcome = |machine: &Parameters, conditions: Conditions, stroke_mm: Option<f64>| {
        let throw = simulated_in(&conditions, machine, &Sensors::default(), Direction::NormalToReverse, 3);
        let settings = Settings { stroke_mm, ..settings_of(machine) };
        Identifier::default().identify(&throw, &settings)
    };
    let obstructed = Conditions { obstruction_mm: Some(60.0), ..Conditions::default() };
    let refused = outcome(&machine, obstructed, None).outcome.unwrap_err();
    assert!(matches!(refused, Rejection::Obstructed { .. }) && refused.is_incomplete(), "{refused}");
    let found = outcome(&machine, obstructed, Some(115.0));
    assert!(matches!(found.outcome, Err(Rejection::Incomplete { .. })), "{:?}", found.outcome);
    assert!((58.0..75.0).contains(&found.features.travel_mm.unwrap()), "{:?}", found.features);
    let cut_off = Parameters { timeout_s: 2.0, ..machine };
    let refused = outcome(&cut_off, Conditions::default(), Some(115.0)).outcome.unwrap_err();
    assert!(matches!(refused, Rejection::Incomplete { .. }), "{refused}");
}

/// A position that ends or jumps within the movement shows no arrival, after which the motor would have run on. A dead
/// current hides the start, but not the travel.
#[test]
fn a_lost_channel_shows_neither_an_arrival_nor_another_travel() {
    let healthy = Channels::healthy(&Sensors::default(), Direction::NormalToReverse, 3);
    let middle = healthy.position.len() / 2;
    let damages: [fn(&mut Channels, usize); 3] = [
        |channels, middle| channels.position[middle..].fill(f64::NAN),
        |channels, middle| channels.position[..middle].fill(f64::NAN),
        |channels, middle| channels.position[middle..].iter_mut().for_each(|x| *x += 30.0),
    ];
    for damage in damages {
        let mut channels = healthy.clone();
        damage(&mut channels, middle);
        let found = channels.identify(&mut Identifier::default(), &Settings::default());
        assert!(
            matches!(found.outcome, Err(Rejection::NotFinite { .. } | Rejection::PositionJump { .. })),
            "{found:?}"
        );
        let features = found.features;
        let of_position = (features.duration_s, features.run_on_s, features.travel_mm, features.end_position_mm);
        assert_eq!(of_position, (None, None, None, None));
        assert!(features.running_current_a.is_some());
    }
    let mut dead = healthy;
    dead.current.fill(0.25);
    let found = dead.identify(&mut Identifier::default(), &Settings::default());
    assert!(matches!(found.outcome, Err(Rejection::NoCurrent { .. })), "{found:?}");
    assert!((found.features.travel_mm.unwrap() - 114.6).abs() < 0.5, "{found:?}");
}

#[test]
fn noise_of_the_position_neither_makes_nor_hides_an_obstruction() {
    let machine = Parameters::default();
    for direction in Direction::BOTH {
        for (noise_mm, seed) in [0.3, 1.0, 3.0, 6.0, 12.0].into_iter().zip(7..) {
            for stroke_mm in [None, Some(115.0)] {
                let settings = Settings { stroke_mm, ..settings_of(&machine) };
                let identify = |obstruction_mm: Option<f64>| {
                    let conditions = Conditions { obstruction_mm, ..Conditions::default() };
                    let trace = simulated_in(&conditions, &machine, &Sensors::default(), direction, seed).trace;
                    let mut rng = ChaCha8Rng::seed_from_u64(seed + 100);
                    let (current, mut position) = (trace.current_a().to_vec(), trace.position_mm().to_vec());
                    for mm in &mut position {
                        *mm += noise_mm * rng.sample::<f64, _>(rand_distr::StandardNormal);
                    }
                    let trace = Trace::new(1000.0, current, position).unwrap();
                    Identifier::default().identify(&Throw::recorded(trace), &settings)
                };
                let what = format!("{direction}, {noise_mm} mm, stroke {stroke_mm:?}");
                let free = identify(None);
                let channel =
                    free.outcome.as_ref().err().map(|refused| (refused.is_incomplete(), refused.faulty_channel()));
                let expected = if noise_mm > 0.5 { Some((false, Some(Channel::Position))) } else { None };
                assert_eq!(channel, expected, "{what}: {:?}", free.outcome);
                assert_eq!(free.features.duration_s.is_some(), channel.is_none(), "{what}: {:?}", free.features);
                // Noise of a tenth of the stroke hides the movement of the toe.
                let stopped = identify(Some(60.0)).outcome.unwrap_err();
                let hidden = noise_mm > 10.0 && stopped.faulty_channel() == Some(Channel::Position);
                assert!(stopped.is_incomplete() || hidden, "{what}: {stopped}");
            }
        }
    }
}

#[test]
fn absurd_settings_and_the_shortest_traces_are_refused_without_a_panic() {
    let healthy = Channels::healthy(&Sensors::default(), Direction::NormalToReverse, 5);
    for lead_mm in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let refused =
            healthy.identify(&mut Identifier::default(), &Settings { lead_mm, ..Settings::default() }).outcome;
        assert_eq!(refused.unwrap_err().code(), "bad_settings");
    }
    for len in 1..40 {
        let mut short = Channels::healthy(&Sensors::default(), Direction::NormalToReverse, 5);
        short.keep(195..195 + len);
        assert!(short.identify(&mut Identifier::default(), &Settings::default()).outcome.is_err());
    }
}
