//! A subscriber that records all messages of the daemon.

use std::{
    collections::BTreeSet,
    fs::{File, OpenOptions},
    io::Write,
    path::Path,
    sync::{Arc, Mutex, MutexGuard},
};

use pointsd::wire::{Alarm, Health};
use zenoh::{
    Session, Wait,
    query::{ConsolidationMode, QueryTarget, Reply},
    sample::{Sample, SampleKind},
};

use crate::rig;

/// The received messages.
#[derive(Debug, Default)]
pub(crate) struct Received {
    /// Machine, boot id and number of each throw with a received health message.
    pub(crate) health: BTreeSet<(String, String, u64)>,
    /// Alarm events in the order of their first arrival.
    pub(crate) events: Vec<(String, u32)>,
    /// Number of alarm messages, with repetitions.
    pub(crate) messages: usize,
}

impl Received {
    /// The received messages as acknowledgement lines.
    pub(crate) fn acknowledged(&self) -> String {
        let throws = self.health.iter().map(|(machine, boot_id, throw_no)| throw_line(machine, boot_id, *throw_no));
        throws.chain(self.events.iter().map(|(alarm_id, event_no)| event_line(alarm_id, *event_no))).collect()
    }
}

fn throw_line(machine: &str, boot_id: &str, throw_no: u64) -> String {
    format!("judged {machine} {boot_id} {throw_no}\n")
}

fn event_line(alarm_id: &str, event_no: u32) -> String {
    format!("received {alarm_id} {event_no}\n")
}

/// A subscriber that receives until it is dropped.
pub(crate) struct Witness {
    received: Arc<Mutex<Received>>,
    _session: Session,
}

impl Witness {
    /// Subscribes to health and alarms. Appends an acknowledgement for each message to `log`, the log that the shim
    /// writes for the daemon.
    pub(crate) async fn listen(endpoint: &str, log: Option<&Path>) -> Self {
        let session = rig::client_of(endpoint).await;
        let received = Arc::<Mutex<Received>>::default();
        let log = log.map(|path| Arc::new(OpenOptions::new().create(true).append(true).open(path).unwrap()));
        let (health, log_of_health) = (Arc::clone(&received), log.clone());
        let on_health = move |sample: Sample| {
            let message: Health = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
            let (machine, throw) = (message.machine.machine.to_string(), message.throw);
            acknowledge(log_of_health.as_deref(), &throw_line(&machine, &throw.boot_id, throw.throw_no));
            health.lock().unwrap().health.insert((machine, throw.boot_id, throw.throw_no));
        };
        session.declare_subscriber("points/v1/**/health").callback(on_health).background().await.unwrap();
        let on_alarm = Arc::new(alarm_recorder(Arc::clone(&received), log));
        let live = Arc::clone(&on_alarm);
        session
            .declare_subscriber("points/v1/**/alarm")
            .callback(move |sample| live(sample))
            .background()
            .await
            .unwrap();
        // When a daemon connects again, asks it for the events that were missed.
        let asking = session.clone();
        let on_daemon = move |token: Sample| {
            if token.kind() == SampleKind::Put {
                ask(&asking, Arc::clone(&on_alarm));
            }
        };
        let daemons = session.liveliness().declare_subscriber("points/v1/*/monitor/*/alive").history(true);
        daemons.callback(on_daemon).background().await.unwrap();
        Self { received, _session: session }
    }

    /// Subscribes to alarms only, and never asks a daemon for missed events.
    pub(crate) async fn listen_plainly(endpoint: &str) -> Self {
        let session = rig::patient_client_of(endpoint).await;
        let received = Arc::<Mutex<Received>>::default();
        let on_alarm = alarm_recorder(Arc::clone(&received), None);
        session.declare_subscriber("points/v1/**/alarm").callback(on_alarm).background().await.unwrap();
        Self { received, _session: session }
    }

    pub(crate) fn received(&self) -> MutexGuard<'_, Received> {
        self.received.lock().unwrap()
    }

    /// Waits until the received messages fulfil a condition.
    pub(crate) async fn until(&self, what: &str, is_met: impl Fn(&Received) -> bool) {
        rig::until(rig::PATIENCE, async || {
            let received = self.received();
            if is_met(&received) {
                return Ok(());
            }
            let (throws, events) = (received.health.len(), &received.events);
            Err(format!("not received: {what}; received: {throws} throws and {events:?}"))
        })
        .await;
    }
}

fn alarm_recorder(received: Arc<Mutex<Received>>, log: Option<Arc<File>>) -> impl Fn(Sample) + Send + Sync + 'static {
    move |sample| {
        let message: Alarm = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
        acknowledge(log.as_deref(), &event_line(&message.alarm_id, message.event_no));
        let mut received = received.lock().unwrap();
        received.messages += 1;
        let event = (message.alarm_id.clone(), message.event_no);
        if !received.events.contains(&event) {
            received.events.push(event);
        }
    }
}

/// Queries the last alarm events.
fn ask(session: &Session, on_alarm: Arc<impl Fn(Sample) + Send + Sync + 'static>) {
    let get = session.get("points/v1/**/alarm?limit=10000").target(QueryTarget::All);
    let on_reply = move |reply: Reply| reply.into_result().into_iter().for_each(|sample| on_alarm(sample));
    get.consolidation(ConsolidationMode::None).callback(on_reply).wait().unwrap();
}

/// Appends an acknowledgement to the shim's log, in one write.
fn acknowledge(log: Option<&File>, line: &str) {
    let Some(mut log) = log else { return };
    let size = u32::try_from(line.len()).unwrap();
    let mut record = vec![b'A'];
    record.extend_from_slice(&0u32.to_ne_bytes());
    record.extend_from_slice(&size.to_ne_bytes());
    record.extend_from_slice(&0u64.to_ne_bytes());
    record.extend_from_slice(line.as_bytes());
    log.write_all(&record).unwrap();
}
