use super::*;
use crate::diagnose::Cause;

fn load(text: &str) -> Result<Config, ConfigError> {
    let folder = tempfile::tempdir().unwrap();
    let text = if text.contains("[store]") {
        text.to_owned()
    } else {
        format!("{text}\n[store]\npath = {:?}\n", folder.path().join("points.db"))
    };
    Config::from_document(&Document::parse(Path::new("pointsd.toml"), text)?)
}

fn shipped() -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/pointsd.toml")).unwrap()
}

#[test]
fn the_shipped_file_is_the_built_in_defaults() {
    let document = Document::parse(Path::new("config/pointsd.toml"), shipped()).unwrap();
    let shipped: Config = document.deserialize().unwrap();
    let built_in = Config::default();
    assert_eq!(toml::Table::try_from(&shipped).unwrap(), toml::Table::try_from(&built_in).unwrap());
    assert_eq!(shipped.machine_entries, []);
    let session = |section| checked_session(zenoh::MONITOR, section, &document).unwrap().to_string();
    assert_eq!(session(section(&document).unwrap().as_ref()), session(None));
}

fn token(secret: &str) -> Token {
    serde_json::from_value(secret.into()).unwrap()
}

#[test]
fn the_shipped_file_shows_every_key() {
    let mut config = Config::default();
    config.machine_defaults.stroke_mm = Some(115.0);
    config.web.listen = Some("127.0.0.1:7480".parse().unwrap());
    config.web.token = Some(token("0123456789abcdef"));
    config.webhook.url = Some("http://a".to_owned());
    config.webhook.authorization = Some(token("secret"));
    config.webhook.ca_file = Some("ca.pem".into());
    // Keys without a default are shown as comments.
    let hidden = ["stroke_mm", "listen", "token", "url", "authorization", "ca_file"];
    let text = hidden.iter().fold(shipped(), |text, key| text.replace(&format!("# {key} ="), &format!("{key} =")));
    let mut all = toml::Table::try_from(config).unwrap();
    all.insert("zenoh".to_owned(), zenoh::base(zenoh::MONITOR).unwrap().into());
    let shown = keys(&text);
    for key in keys(&all.to_string()) {
        assert!(shown.contains(&key), "config/pointsd.toml does not show {key}");
    }
}

#[test]
fn an_error_names_line_and_key() {
    for (text, says) in [
        ("[subscribe]\nkee = 1", "pointsd.toml:2: subscribe.kee: unknown field"),
        ("[stor]\npath = 1", "pointsd.toml:1: stor: unknown field"),
        ("[subscribe]\n\nmax_machines = 0", "pointsd.toml:3: subscribe.max_machines: is 0, must be 1 to 100000"),
        ("[subscribe]\nmax_machines = \"many\"", "pointsd.toml:2: subscribe.max_machines: invalid type"),
        ("[subscribe]\nkey = \"elsewhere/**\"", "pointsd.toml:2: subscribe.key: "),
        ("[diagnosis]\nmodel_error = 7", "pointsd.toml:2: diagnosis.model_error: "),
        ("[machines]\nlead_mm = 0", "pointsd.toml:2: machines.lead_mm: is 0, must be 0.5 to 500 mm"),
        (
            "[[machines]]\nlead_mm = 5",
            "pointsd.toml:1: machines[0]: invalid type: map, expected a number; a section has one bracket on each side",
        ),
        ("[machines]\nmotor = \"steam\"", "pointsd.toml:2: machines.motor: unknown variant `steam`"),
        ("[[machine]]\nsite = \"a b\"\nmachine = \"1\"", "pointsd.toml:2: machine[0].site: "),
        ("[[machine]]\nsite = \"a\"", "pointsd.toml:1: machine[0]: missing field `machine`"),
        (
            "[[machine]]\nsite = \"a\"\nmachine = \"1\"\nlead_mm = nan",
            "pointsd.toml:4: machine[0].lead_mm: is NaN, must be",
        ),
        (
            "[[machine]]\nsite = \"a\"\nmachine = \"1\"\n[[machine]]\nsite = \"a\"\nmachine = \"1\"",
            "pointsd.toml:6: machine[1].machine: a/1 is described a second time",
        ),
        ("[log]\nlevel = \"loud=very\"", "pointsd.toml:2: log.level: "),
        ("[log]\nlevel = \"inof\"", "pointsd.toml:2: log.level: \"inof\" is not a level"),
        ("[log]\nlevel = \"zenoh=warn, info\"", "pointsd.toml:2: log.level: \" info\" is not a level"),
        ("[web]\nlisten = \"localhost:7480\"", "pointsd.toml:2: web.listen: invalid socket address syntax"),
        ("[web]\nlisten = \"127.0.0.1\"", "pointsd.toml:2: web.listen: invalid socket address syntax"),
        ("[web]\ntoken = \"short\"", "pointsd.toml:2: web.token: must have 16 to 256 characters"),
        ("[web]\nhosts = [\"a\", \"b:80\"]", "pointsd.toml:2: web.hosts[1]: \"b:80\" is not a host name"),
        ("[webhook]\nurl = \"ftp://a\"", "pointsd.toml:2: webhook.url: \"ftp://a\" is not http://HOST/PATH"),
        ("[webhook]\nurl = \"http://a:b@c/\"", "pointsd.toml:2: webhook.url: "),
        ("[webhook]\nurl = \"alarms.example\"", "pointsd.toml:2: webhook.url: "),
        (
            "[webhook]\nurl = \"http://[::1]:70000/\"",
            "pointsd.toml:2: webhook.url: \"http://[::1]:70000/\": the port must",
        ),
        ("[monitor]\nid = \"all-machines\"", "pointsd.toml:2: monitor.id: is the name of the common alarms of a site"),
        ("[zenoh]\nmode = \"client\"", "pointsd.toml:2: zenoh.mode: mode = \"client\" needs the endpoint of a router"),
        ("[zenoh]\nlisten.endpoints = []", "pointsd.toml:2: zenoh.listen.endpoints: without"),
        (
            "[zenoh]\ntransport.unicast.max_sessions = 0",
            "pointsd.toml:2: zenoh.transport.unicast.max_sessions: is 0, must be at least 1",
        ),
        (
            "[zenoh]\ntransport.link.rx.max_message_size = 1000",
            "pointsd.toml:2: zenoh.transport.link.rx.max_message_size: is 1000, must be at least 65536",
        ),
        ("[web]\nlisten = \"127.0.0.1:7447\"", "pointsd.toml:2: web.listen: 127.0.0.1:7447 is an address of zenoh"),
        (
            "[web]\nlisten = \"127.0.0.1:80\"\n[zenoh]\nlisten.endpoints = [\"tcp/[::]:80\"]",
            "pointsd.toml:2: web.listen: 127.0.0.1:80 is an address",
        ),
        (
            "[diagnosis]\nslow_throw_pct = 60",
            "pointsd.toml:2: diagnosis.slow_throw_pct: is 60, must be at most slow_throw_critical_pct (50 by default)",
        ),
        (
            "[diagnosis]\nslow_throw_critical_pct = 1",
            "pointsd.toml:2: diagnosis.slow_throw_critical_pct: is 1, must be",
        ),
        ("[webhook]\nmax_messages = 0", "pointsd.toml:2: webhook.max_messages: is 0, must be 1 to 1000"),
        ("[webhook]\ncauses = [\"magnet\"]", "pointsd.toml:2: webhook.causes"),
        ("[webhook]\nauthorization = \"a\\nb\"", "pointsd.toml:2: webhook.authorization: must be"),
        ("[webhook]\nca_file = \"/no/such/file\"", "pointsd.toml:2: webhook.ca_file: /no/such/file cannot be read"),
        ("[zenoh]\nmode = \"rooter\"", "pointsd.toml:2: zenoh.mode: "),
        ("[zenoh]\nlisten.endpoint = []", "pointsd.toml:2: zenoh.listen.endpoint: unknown field"),
        ("[zenoh]\nlisten = [\"tcp/[::]:7447\"]", "pointsd.toml:2: zenoh.listen: is a table: write listen.endpoints"),
        ("[zenoh]\nlisten.endpoints = [\"7447\"]", "pointsd.toml:2: zenoh.listen.endpoints"),
        (
            "[zenoh]\nlisten.endpoints = [\"tcp/127.0.0.1:7447\",\n \"tcp/127.0.0.1:99999\"]",
            "pointsd.toml:3: zenoh.listen.endpoints[1]: \"tcp/127.0.0.1:99999\": the port must be 0 to 65535",
        ),
        (
            "[zenoh]\nconnect.endpoints = [\"tcp/localhost\"]",
            "pointsd.toml:2: zenoh.connect.endpoints[0]: \"tcp/localhost\": the port",
        ),
        (
            "[zenoh]\nconnect.endpoints.router = [\"foo/a:1\"]",
            "pointsd.toml:2: zenoh.connect.endpoints.router[0]: \"foo/a:1\": this",
        ),
        (
            "[zenoh]\nlisten.endpoints = [\"tls/0.0.0.0:7447\"]",
            "pointsd.toml:2: zenoh.listen.endpoints[0]: \"tls/0.0.0.0:7447\": needs",
        ),
        (
            "[zenoh.access_control]\nenabled = true\nrules = []",
            "pointsd.toml:1: zenoh.access_control: with enabled = true, rules, subjects and policies must be given",
        ),
        (
            "[zenoh.access_control]\nenabled = true\nsubjects = [{ id = \"s\" }]\n\
             rules = [{ id = \"r\", permission = \"allow\", messages = [\"put\"], key_exprs = [\"a\"] }]\n\
             policies = [{ rules = [\"r\"], subjects = [\"s\"] },\n { rules = [\"q\"], subjects = [\"s\"] }]",
            "pointsd.toml:6: zenoh.access_control.policies[1].rules[0]: \"q\" is not in zenoh.access_control.rules",
        ),
        (
            "[zenoh.transport.link.tls]\nroot_ca_certificate = \"/no/such/file\"",
            "pointsd.toml:2: zenoh.transport.link.tls.root_ca_certificate: there is no file",
        ),
        ("[store]\npath = \"/no/such/folder/points.db\"", "pointsd.toml:2: store.path: "),
        ("[store]\npath = \"/tmp\"", "pointsd.toml:2: store.path: /tmp is a folder"),
        (
            "[store]\npath = \"/dev/null\"",
            "pointsd.toml:2: store.path: /dev/null is a folder or a device, must be a file",
        ),
        ("[log]\nlevel = \"\"", "pointsd.toml:2: log.level: \"\" is not a level"),
        ("[store]\nmax_wal_mib = 1", "pointsd.toml:2: store.max_wal_mib: "),
        ("monitor = 3", "pointsd.toml:1: monitor: invalid type"),
        ("[monitor\nid = 3", "pointsd.toml:1: "),
    ] {
        let error = load(text).unwrap_err().to_string();
        assert!(error.starts_with(says), "{text:?} says: {error}");
    }
}

#[test]
fn machines_differ_from_the_defaults_where_they_say_so() {
    let config = load(
        "[machines]\nlead_mm = 12\nstroke_mm = 110\n[[machine]]\nsite = \"north\"\nmachine = \"21B\"\nneutral_mm = 55\nmotor = \"series\"",
    )
    .unwrap();
    let own = config.machines.of(&crate::throw::MachineId::new("north", "21B").unwrap());
    assert_eq!((own.lead_mm, own.neutral_mm, own.stroke_mm), (12.0, 55.0, Some(110.0)));
    assert_eq!(own.motor, crate::estimate::Motor::Series);
    let other = config.machines.of(&crate::throw::MachineId::new("north", "22").unwrap());
    assert_eq!((other.lead_mm, other.neutral_mm), (12.0, 0.0));
}

#[test]
fn settings_of_a_machine_that_is_not_served_are_warned_about() {
    let config = load(
        "[subscribe]\nkey = \"points/v1/north/**\"\n[[machine]]\nsite = \"south\"\nmachine = \"1\"\n\
         [[machine]]\nsite = \"north\"\nmachine = \"1\"",
    )
    .unwrap();
    let warnings = config.warnings();
    assert!(matches!(&warnings[..], [one] if one.starts_with("[[machine]] south/1: ")), "{warnings:?}");
}

#[test]
fn the_causes_of_the_webhook_may_be_the_words_of_alarms_for_people() {
    let config = load("[webhook]\nurl = \"http://a/\"\ncauses = [\"motor\", \"friction\"]").unwrap();
    assert_eq!(config.webhook.causes, [Cause::Kt, Cause::Friction]);
    let error = load("[webhook]\ncauses = [\"magnet\"]").unwrap_err().to_string();
    assert!(error.contains("`motor`") && error.contains("`friction`"), "{error}");
}

#[test]
fn a_section_that_is_off_is_warned_about() {
    let off = load("[web]\ntoken = \"0123456789abcdef\"\n[webhook]\nseverity = \"critical\"").unwrap();
    let without = |key| format!("[{key}]: has no effect without {key}");
    let warnings = off.warnings();
    assert!(warnings.len() == 2 && warnings[0].starts_with(&without("web")), "{warnings:?}");
    assert!(warnings[1].starts_with(&without("webhook")), "{warnings:?}");
    assert_eq!(load(&shipped()).unwrap().warnings(), [""; 0]);
}

#[test]
fn a_command_that_reads_some_sections_refuses_an_unknown_one() {
    let check = |text: &str| check_sections(&Document::parse(Path::new("x.toml"), text.to_owned()).unwrap());
    assert_eq!(check(&shipped()), Ok(()));
    let error = check("[monitor]\n[stores]\npath = \"b.db\"").unwrap_err().to_string();
    assert!(error.starts_with("x.toml:2: stores: unknown section, expected one of monitor, "), "{error}");
}

#[test]
fn the_zenoh_section_overrides_the_built_in_one() {
    let config = load("[zenoh]\nlisten.endpoints = [\"tcp/0.0.0.0:17447\"]").unwrap();
    assert!(config.zenoh.get_json("listen/endpoints").unwrap().contains("17447"));
    assert_eq!(config.zenoh.get_json("mode").unwrap(), "\"router\"");
    assert_eq!(config.zenoh.get_json("scouting/multicast/enabled").unwrap(), "false");
}
