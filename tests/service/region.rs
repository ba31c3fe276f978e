//! A region: a router, and four daemons behind it, each of which serves a site.

use std::{fs, time::Duration};

use pointsd::wire;
use zenoh::Session;

use crate::{
    backlogs::keep,
    http::{ALIVE, KEY},
    rig::{PATIENCE, Rig, Sender, client_of, ends, listen, next, pointsd, stub, throws, until},
};

const SITES: [&str; 4] = ["east", "north", "south", "west"];

/// The daemon of a site; the daemon of the first site watches the others.
fn rig(site: &str, router: &str) -> Rig {
    let peers = if site == SITES[0] {
        SITES[1..].iter().map(|peer| format!("{{ site = {peer:?}, id = \"box\" }}")).collect()
    } else {
        Vec::new()
    };
    Rig::with(&format!(
        "[monitor]\nsite = {site:?}\nid = \"box\"\npeers = [{}]\n[subscribe]\nkey = \"points/v1/{site}/**\"",
        peers.join(", ")
    ))
    .behind(router)
}

/// The machines whose health the daemons return to one query.
async fn machines(session: &Session) -> Vec<String> {
    let none = zenoh::query::ConsolidationMode::None;
    let replies = session.get("points/v1/**/health").consolidation(none).await.unwrap();
    let mut machines = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        machines.push(reply.result().unwrap().key_expr().split('/').nth(2).unwrap().to_owned());
    }
    machines.sort();
    machines.dedup();
    machines
}

async fn until_machines(session: &Session, expected: &[&str]) {
    until(PATIENCE, async || {
        let machines = machines(session).await;
        if machines == expected { Ok(()) } else { Err(format!("{machines:?} answer, not {expected:?}")) }
    })
    .await;
}

/// A router without a daemon, and its endpoint.
pub(crate) async fn router() -> (Session, String) {
    let config =
        "{ mode: 'router', listen: { endpoints: ['tcp/127.0.0.1:0'] }, scouting: { multicast: { enabled: false } } }";
    let router = zenoh::open(zenoh::Config::from_json5(config).unwrap()).await.unwrap();
    let endpoint = router.info().locators().await[0].to_string();
    (router, endpoint)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_daemons_with_the_same_machines_or_name_are_reported() {
    let (_router, endpoint) = router().await;
    let rigs = [Rig::new().behind(&endpoint), Rig::new().behind(&endpoint)];
    let _first = rigs[0].start();
    let second = rigs[1].start();
    second.until_log("another daemon with the name fleet/pointsd is connected");
    let text = ends(1, &mut pointsd(&["status", "--connect", &endpoint]));
    let both = "fleet/pointsd (points/v1/*/*/**) and fleet/pointsd (points/v1/*/*/**) serve the same machines: correct monitor.id";
    assert!(text.contains(both), "{text}");
    let session = client_of(&endpoint).await;
    Sender::of(&session, KEY).await.send(throws("b", 1)).await;
    for rig in &rigs {
        rig.judged(1).await;
    }
    let text = ends(1, &mut pointsd(&["status", "--connect", &endpoint]));
    assert!(
        text.contains("north/21B is served by fleet/pointsd and fleet/pointsd: stop all daemons of one name but one"),
        "{text}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_daemon_that_is_gone_is_an_alarm_and_another_continues_from_its_backup() {
    let (_router, endpoint) = router().await;
    let rigs = SITES.map(|site| rig(site, &endpoint));
    let mut daemons: Vec<_> = rigs.iter().map(Rig::start).collect();
    let session = client_of(&endpoint).await;
    let alarms = listen(&session).await;
    let send = async |site: &str, throw_no: usize| {
        let throw = throws("b", throw_no as u64).remove(throw_no - 1);
        Sender::of(&session, &format!("points/v1/{site}/21B/throw")).await.send([throw]).await;
    };
    for (site, rig) in SITES.iter().zip(&rigs) {
        send(site, 1).await;
        rig.judged(1).await;
    }
    until_machines(&session, &SITES).await;

    // The last backup of the daemon that is killed.
    let backup = rigs[2].folder().join("backup.db");
    ends(0, pointsd(&["backup", "--config"]).arg(rigs[2].write_config()).arg(&backup));
    daemons.remove(2).kill();
    let (key, alarm) = next(&alarms).await;
    assert_eq!(key, "points/v1/east/box/alarm");
    assert!(alarm.text.starts_with("The daemon cannot be reached: south/box since "), "{}", alarm.text);
    assert_eq!((alarm.cause.as_str(), alarm.severity.as_str()), ("not_monitored", "critical"));
    let text = ends(69, &mut pointsd(&["status", "--site", "south", "--connect", &endpoint]));
    assert!(
        text.contains("no machine of site south is known to east/box") && text.contains("cannot be reached: south/box"),
        "{text}"
    );
    until_machines(&session, &["east", "north", "west"]).await;
    for at in [0, 1, 3] {
        send(SITES[at], 2).await;
        rigs[at].judged(2).await;
    }

    // Another computer takes over, with the configuration and the backup of the first.
    let other = rig("south", &endpoint);
    fs::copy(&backup, other.database()).unwrap();
    let _taken_over = other.start();
    let (_, alarm) = next(&alarms).await;
    assert_eq!(alarm.text, "All watched daemons can be reached again.");
    send("south", 2).await;
    let history = other.judged(2).await;
    assert_eq!(history.iter().map(|health| health.throw.throw_no).collect::<Vec<_>>(), [1, 2]);
    until_machines(&session, &SITES).await;
    assert!(alarms.try_recv().unwrap().is_none(), "an alarm without a fault");
}

/// The first daemon would continue the alarms of a machine that another daemon serves now.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_machine_that_moved_to_another_daemon_is_left_to_it() {
    let (_router, endpoint) = router().await;
    let first = Rig::new().behind(&endpoint);
    let daemon = first.start();
    let session = client_of(&endpoint).await;
    let token = session.liveliness().declare_token(ALIVE).await.unwrap();
    Sender::of(&session, KEY).await.send([stub("boot", 1)]).await;
    first.judged(1).await;
    first.until_sql("SELECT 1 AS n FROM monitor WHERE snapshot LIKE '%\"logger\":\"there\"%'").await;
    daemon.terminate();

    let other = Rig::with("[monitor]\nid = \"north\"\n[subscribe]\nkey = \"points/v1/north/**\"").behind(&endpoint);
    let _other = other.start();
    let kept = [1, 2].map(|throw_no| {
        let throw = stub("boot", throw_no);
        (throw.id.clone(), wire::encode_throw(&throw))
    });
    keep(&session, KEY, kept.to_vec()).await;
    Sender::of(&session, KEY).await.send([stub("boot", 3)]).await;
    other.judged(3).await;
    let south = "[subscribe]\nkey = \"points/v1/south/**\"\n[diagnosis]\nlogger_gone_minutes = 0.01";
    let narrowed = Rig::with(south).behind(&endpoint).in_folder(first.folder());
    let _narrowed = narrowed.start();
    // Two ticks, and the first rounds in which loggers without a token are queried.
    tokio::time::sleep(Duration::from_secs(7)).await;
    let said = ends(1, &mut pointsd(&["status", "--connect", &endpoint]));
    let is_served_twice = said.contains("north/21B is served by");
    let alarm_events = first.number("SELECT count(*) FROM alarm_events");
    assert_eq!((first.history().await.len(), alarm_events, is_served_twice), (1, 0, false), "{said}");
    assert!(said.contains("NOT SERVED: north/21B"), "{said}");
    drop(token);
}

/// Their alarms would stay open for ever, and no command could end them.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn machines_that_a_new_key_leaves_out_are_named() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    logger.send([&throws("boot", 1)[0]]).await;
    rig.judged(1).await;
    daemon.terminate();
    let narrowed = Rig::with("[subscribe]\nkey = \"points/v1/south/**\"").in_folder(rig.folder());
    let daemon = narrowed.start();
    let said = daemon.says(1, &["status"]);
    assert!(said.contains("NOT SERVED: north/21B: in the database, but not in subscribe.key"), "{said}");
    daemon.terminate();
    let daemon = rig.start();
    daemon.says(0, &["retire", "north/21B", "--why", "moved", "--by", "tester"]);
    daemon.terminate();
    narrowed.start().says(0, &["status"]);
}
