//! Weather that changes all machines of a site is not a fault of a machine, and a fault of one machine is still found.

use jiff::{SignedDuration, Timestamp};
use nalgebra::Vector3;
use pointsd::{
    diagnose::{AlarmEvent, Cause, Common, MachineMonitor, Settings},
    estimate::Grade,
};

use crate::fleet::{Machine, Scatter, shift};

/// Machines of a site, which throw in turn.
struct Site {
    machines: Vec<Machine>,
    events: Vec<(usize, AlarmEvent)>,
    now: Timestamp,
}

impl Site {
    fn new(seed: u64, count: u64) -> Self {
        let machine = |at| Machine::in_field(seed + at, Scatter::USUAL);
        Self { machines: (0..count).map(machine).collect(), events: Vec::new(), now: Timestamp::UNIX_EPOCH }
    }

    /// One throw of every machine. The effect of `weather` differs between machines; `own` is a change of one machine.
    fn throw(&mut self, weather: Vector3<f64>, own: impl Fn(usize) -> Vector3<f64>) {
        for at in 0..self.machines.len() {
            let exposure = 1.3 - 0.15 * (at % 5) as f64;
            let throw = self.machines[at].throw(exposure * weather + own(at));
            let others = self.machines.iter().enumerate().filter(|(other, _)| *other != at);
            let common = MachineMonitor::common(others.map(|(_, other)| &other.monitor), throw.started_at);
            self.now = throw.started_at;
            // The monitor continues from its snapshot, as after a restart.
            let monitor = &mut self.machines[at].monitor;
            *monitor = MachineMonitor::from_snapshot(&serde_json::to_string(monitor).unwrap()).unwrap();
            let events = monitor.observe_beside(&throw, &common, &Settings::default()).events;
            self.events.extend(events.into_iter().map(|event| (at, event)));
        }
    }
}

fn wet(throw: u64) -> Vector3<f64> {
    if throw % 60 >= 45 { shift(Cause::Friction, -33.0) } else { Vector3::zeros() }
}

#[test]
fn wet_spells_raise_no_alarm_on_a_site_of_five_and_a_fault_is_named() {
    let (mut weather_alarms, mut alone) = (0, 0);
    for seed in 0..8 {
        for machines in [1, 5] {
            let mut site = Site::new(70_000 + 10 * seed, machines);
            for throw in 0..420 {
                let weather = if throw < 120 { Vector3::zeros() } else { wet(throw) };
                site.throw(weather, |_| Vector3::zeros());
            }
            let count = if machines == 5 { &mut weather_alarms } else { &mut alone };
            *count += site.events.len();
            site.events.clear();
            for throw in 420..480 {
                site.throw(wet(throw), |at| if at == 0 { shift(Cause::Friction, 40.0) } else { Vector3::zeros() });
            }
            let named: Vec<_> = site.events.iter().map(|(at, event)| (*at, event.cause)).collect();
            assert!(machines == 1 || named.contains(&(0, Cause::Friction)), "seed {seed}: {named:?}");
            assert!(named.iter().all(|(at, _)| *at == 0), "seed {seed}: {named:?}");
        }
    }
    println!("{weather_alarms} events of 40 machines on sites of five, {alone} of 8 machines alone");
    assert!(alone > 0, "without the site the weather raises no alarm: the test cannot fail");
    assert_eq!(weather_alarms, 0);
}

/// The cold changes the machines differently, so some of them exceed each limit of a common change before the others.
#[test]
fn a_season_of_a_site_is_no_intermittent_fault_of_a_machine() {
    for seed in 0..4 {
        let mut site = Site::new(73_000 + 10 * seed, 6);
        for throw in 0..1_700_u64 {
            let cold = shift(Cause::Friction, 25.0 * (throw.saturating_sub(200) as f64 / 1_500.0));
            site.throw(cold, |at| if at >= 3 { -0.5 * cold } else { Vector3::zeros() });
        }
        let texts: Vec<_> = site.events.iter().map(|(at, event)| (at, &event.text)).collect();
        assert!(site.events.is_empty(), "seed {seed}: {texts:#?}");
    }
}

#[test]
fn faults_of_two_machines_in_five_are_not_taken_for_weather() {
    for seed in 0..6 {
        let mut site = Site::new(71_000 + 10 * seed, 5);
        for _ in 0..120 {
            site.throw(Vector3::zeros(), |_| Vector3::zeros());
        }
        for _ in 0..60 {
            site.throw(Vector3::zeros(), |at| if at < 2 { shift(Cause::Friction, 40.0) } else { Vector3::zeros() });
        }
        for at in 0..5 {
            let named = site.events.iter().any(|(machine, event)| *machine == at && event.cause == Cause::Friction);
            assert_eq!(named, at < 2, "seed {seed}, machine {at}");
        }
    }
}

#[test]
fn the_alarm_of_the_whole_site_is_raised_once_and_ends() {
    let settings = Settings::default();
    let mut site = Site::new(72_000, 5);
    let mut whole = MachineMonitor::new("All machines of north");
    let (mut events, mut wetted) = (Vec::new(), Vec::new());
    for throw in 0..200 {
        let weather = if (140..170).contains(&throw) { shift(Cause::Friction, -25.0) } else { Vector3::zeros() };
        site.throw(weather, |_| Vector3::zeros());
        let now = site.now;
        let common = MachineMonitor::common(site.machines.iter().map(|machine| &machine.monitor), now);
        let news = whole.follow_site(&common, now, &settings);
        if !news.is_empty() && events.is_empty() {
            wetted = site.machines.iter().map(|machine| machine.monitor.clone()).collect();
        }
        events.extend(news);
    }
    assert!(site.events.is_empty(), "{:?}", site.events);
    let states = |monitor: &MachineMonitor| monitor.caveats().iter().any(|caveat| caveat.contains("common to most"));
    // Machines that threw before the common change was known do not state it yet.
    assert!(wetted.iter().any(states), "{:?}", wetted.iter().map(MachineMonitor::caveats).collect::<Vec<_>>());
    assert!(!site.machines.iter().any(|machine| states(&machine.monitor)), "the rails are dry again");
    let said: Vec<_> = events.iter().map(|event| (event.cause, event.state.as_str())).collect();
    assert_eq!(said, [(Cause::Friction, "active_unacknowledged"), (Cause::Friction, "cleared_unacknowledged")]);
    assert!(events[0].text.contains("All machines of north: friction down"), "{}", events[0].text);
    // At night no machine throws: the alarm about the weather does not end.
    let raised = events[0].event_at;
    let mut wet = MachineMonitor::new("All machines of north");
    let monitors = || wetted.iter();
    assert_eq!(wet.follow_site(&MachineMonitor::common(monitors(), raised), raised, &settings).len(), 1);
    let night = raised + SignedDuration::from_hours(14);
    assert_eq!(wet.follow_site(&MachineMonitor::common(monitors(), night), night, &settings), []);
    // After rain in the evening there is frost in the morning, and no machine has thrown between.
    let mut frozen = Site::new(73_000, 5);
    let mut in_frost = wet.clone();
    for throw in 0..150 {
        frozen.throw(shift(Cause::Friction, if throw < 140 { 0.0 } else { 25.0 }), |_| Vector3::zeros());
    }
    let morning = frozen.now;
    let common = MachineMonitor::common(frozen.machines.iter().map(|machine| &machine.monitor), morning);
    let [turned] = &in_frost.follow_site(&common, morning, &settings)[..] else { panic!("an event") };
    assert!(turned.text.contains("friction up") && turned.change_pct.is_some_and(|pct| pct > 0.0), "{turned:?}");
    // The machines are not used any more.
    let mut later = Vec::new();
    for hour in 0..24 * 10 {
        let now = night + SignedDuration::from_hours(hour);
        assert_eq!(wet.tick(now, &settings), []);
        later.extend(wet.follow_site(&MachineMonitor::common(monitors(), now), now, &settings));
    }
    let said: Vec<_> = later.iter().map(|event| (event.cause, event.state.as_str())).collect();
    assert_eq!(said, [(Cause::Friction, "cleared_unacknowledged")]);
    assert!(later[0].text.contains("too few of the machines"), "{}", later[0].text);
    assert!(later[0].event_at > night + SignedDuration::from_hours(24 * 6), "{}", later[0].event_at);
    assert!(Common::default() == MachineMonitor::common(std::iter::empty(), events[0].event_at));
}

/// A rough throw is not compared with the other machines, so nothing is known of the common change.
#[test]
fn a_machine_whose_throws_became_rough_shares_no_change() {
    let mut site = Site::new(74_000, 5);
    for throw in 0..160 {
        let weather = if throw >= 140 { shift(Cause::Friction, -25.0) } else { Vector3::zeros() };
        site.throw(weather, |_| Vector3::zeros());
    }
    let machine = &mut site.machines[0];
    let is_shared = |caveats: Vec<String>| caveats.iter().any(|caveat| caveat.contains("is common to most machines"));
    assert!(is_shared(machine.monitor.caveats()));
    let mut rough = machine.throw(shift(Cause::Friction, -25.0));
    let estimate = rough.outcome.as_mut().unwrap().as_mut().unwrap();
    (estimate.grade, estimate.ratios_only) = (Grade::Rough, true);
    assert!(!is_shared(machine.observe(&rough).present.caveats));
}
