//! A cabinet connected to the central router: which messages pass, for which clients.

use std::sync::atomic::Ordering;

use super::{
    rig::{has, matched},
    site::*,
};

const NORTH: &str = "points/v1/north/21A/alarm";
const SOUTH: &str = "points/v1/south/21A/alarm";
const COMMAND: &str = "points/v1/north/21A/command";

#[tokio::test(flavor = "multi_thread")]
async fn alarms_and_commands_pass_the_central_router_and_throws_stay_in_the_cabinet() {
    if !has("openssl") {
        return;
    }
    let folder = railway().folder("router");
    let text = replaced(&read("zenoh/router.json5"), "/etc/zenohd/tls/", &format!("{}/", folder.display()));
    let text = replaced(&text, "tls/[::]:7447", "tls/127.0.0.1:0");
    let (router, endpoint) = open_and_locate(zenoh::Config::from_json5(&text).unwrap()).await;
    let (cabinet, loggers) = open_and_locate(zenoh_table(&cabinet_toml("tls/127.0.0.1:0", Some(&endpoint)))).await;

    let daemons = cabinet.liveliness().declare_subscriber("points/v1/*/monitor/*/alive").history(true).await.unwrap();
    let throws = throw_subscriber(&cabinet).await;
    let commands = answer(&cabinet, "points/v1/north/*/command", COMMAND).await;
    let _north = answer(&cabinet, "points/v1/north/*/alarm", NORTH).await;
    let _south = answer(&cabinet, "points/v1/south/*/alarm", SOUTH).await;
    let viewer = client("viewer", &endpoint).await;
    let operator = client("operator", &endpoint).await;
    let curious = viewer.declare_subscriber("points/v1/**/throw").await.unwrap();

    // The daemon of another site, which this cabinet may watch.
    let _south = router.liveliness().declare_token("points/v1/south/monitor/box/alive").await.unwrap();
    let _logger = router.liveliness().declare_token("points/v1/south/21A/alive").await.unwrap();
    until("the cabinet joins the router", async || !ask(&viewer, "points/v1/**/alarm", None).await.is_empty()).await;
    assert_eq!(ask(&viewer, "points/v1/**/alarm", None).await, [NORTH], "a cabinet speaks for its own site only");
    let seen = tokio::time::timeout(PATIENCE, daemons.recv_async()).await.expect("the cabinet sees a daemon").unwrap();
    assert_eq!(seen.key_expr().as_str(), "points/v1/south/monitor/box/alive");
    assert!(alive(&cabinet, "points/v1/south/21A/alive").await.is_empty(), "loggers of another site are not shown");

    assert!(ask(&viewer, COMMAND, Some("{}")).await.is_empty());
    assert_eq!(commands.load(Ordering::SeqCst), 0);
    assert_eq!(ask(&operator, COMMAND, Some("{}")).await, [COMMAND]);
    assert_eq!(commands.load(Ordering::SeqCst), 1);

    let logger = client("logger.north.21A", &loggers).await;
    let publisher = matched(&logger, THROW_A).await;
    publisher.put("a throw").await.unwrap();
    assert_eq!(next(&throws).await.0, THROW_A);
    assert!(tokio::time::timeout(SILENCE, curious.recv_async()).await.is_err(), "a throw left the cabinet");
    // A client of the central router cannot publish in the cabinet with the certificate of the router.
    operator.put(THROW_A, "forged").await.unwrap();
    assert!(tokio::time::timeout(SILENCE, throws.recv_async()).await.is_err(), "a throw came from the router");
}
