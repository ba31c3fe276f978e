//! The dashboard in a real browser, which the tests control over the pipe of its debugging protocol. Skipped, with a
//! message, without `chromium`.

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{ChildStdin, Command, Stdio},
    sync::mpsc::{self, Receiver},
    thread,
    time::{Duration, Instant},
};

use serde_json::{Value, json};

use crate::{
    http::{address, small_history},
    operators::daemon_with_alarm,
    rig::{PATIENCE, Program, has},
};

/// A running browser.
struct Browser {
    _program: Program,
    input: ChildStdin,
    messages: Receiver<Value>,
    last_id: u64,
}

/// A tab of the browser.
#[derive(Clone)]
struct Tab(String);

impl Browser {
    /// Starts the browser; `None`, with a message, without chromium.
    fn start(profile: &Path) -> Option<Self> {
        if !has("chromium") {
            return None;
        }
        // The protocol uses file descriptor 3 for messages to the browser and 4 for messages from it.
        let mut child = Command::new("sh")
            .args(["-c", "exec chromium \"$@\" 3<&0 4>&1 </dev/null >/dev/null", "chromium"])
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--remote-debugging-pipe"])
            .arg(format!("--user-data-dir={}", profile.display()))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let (sender, messages) = mpsc::channel();
        let output = BufReader::new(child.stdout.take().unwrap());
        thread::spawn(move || {
            for message in output.split(0).map_while(Result::ok) {
                let _ = sender.send(serde_json::from_slice(&message).unwrap());
            }
        });
        let input = child.stdin.take().unwrap();
        Some(Self { _program: Program(child), input, messages, last_id: 0 })
    }

    /// Calls a method of the protocol. Fails if a script has failed since the last call, or a page has violated its
    /// content security policy.
    fn call(&mut self, tab: Option<&Tab>, method: &str, parameters: &Value) -> Value {
        self.last_id += 1;
        let mut message = json!({"id": self.last_id, "method": method, "params": parameters});
        if let Some(Tab(session)) = tab {
            message["sessionId"] = json!(session);
        }
        write!(self.input, "{message}\0").unwrap();
        loop {
            let mut answer = self.messages.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("no answer to {message}"));
            let is_violation = answer["params"]["entry"]["source"] == "security";
            assert!(answer["method"] != "Runtime.exceptionThrown" && !is_violation, "{answer}");
            if answer["id"] == self.last_id {
                assert!(answer["error"].is_null(), "{message}: {answer}");
                return answer["result"].take();
            }
        }
    }

    fn open(&mut self, url: &str) -> Tab {
        let target = self.call(None, "Target.createTarget", &json!({"url": url}));
        let session =
            self.call(None, "Target.attachToTarget", &json!({"targetId": target["targetId"], "flatten": true}));
        let tab = Tab(session["sessionId"].as_str().unwrap().to_owned());
        for reports in ["Runtime.enable", "Log.enable"] {
            self.call(Some(&tab), reports, &json!({}));
        }
        tab
    }

    /// The value of an expression; `None` while the page changes.
    fn value(&mut self, tab: &Tab, expression: &str) -> Option<Value> {
        let parameters = json!({"expression": expression, "returnByValue": true});
        let mut result = self.call(Some(tab), "Runtime.evaluate", &parameters);
        result["exceptionDetails"].is_null().then(|| result["result"]["value"].take())
    }

    /// Waits until an expression is true.
    fn until(&mut self, tab: &Tab, expression: &str) {
        let deadline = Instant::now() + PATIENCE;
        while self.value(tab, expression) != Some(json!(true)) {
            let page = self.value(tab, "location.href + document.body.innerText");
            assert!(Instant::now() < deadline, "not true: {expression}: {page:?}");
            thread::sleep(Duration::from_millis(100));
        }
    }

    /// Sends an event of the mouse at a place: `mouseMoved`, `mousePressed` or `mouseReleased`.
    fn mouse(&mut self, tab: &Tab, kind: &str, [x, y]: [f64; 2]) {
        let (button, clicks) = if kind == "mouseMoved" { ("none", 0) } else { ("left", 1) };
        let event = json!({"type": kind, "x": x, "y": y, "button": button, "clickCount": clicks});
        self.call(Some(tab), "Input.dispatchMouseEvent", &event);
    }

    /// Clicks on the middle of the first element of a selector, with the mouse.
    fn click(&mut self, tab: &Tab, selector: &str) {
        let place = format!(
            "(() => {{ const it = document.querySelector({selector:?}); it.scrollIntoView({{block: 'center'}}); \
             const box = it.getClientRects()[0]; return [box.x + box.width / 2, box.y + box.height / 2]; }})()"
        );
        self.until(tab, &format!("document.readyState == 'complete' && document.querySelector({selector:?}) != null"));
        let place = serde_json::from_value(self.value(tab, &place).unwrap()).unwrap();
        self.mouse(tab, "mousePressed", place);
        self.mouse(tab, "mouseReleased", place);
    }

    /// Types into a field of the form.
    fn write(&mut self, tab: &Tab, field: &str, text: &str) {
        self.click(tab, &format!("input[name={field}]"));
        self.call(Some(tab), "Input.insertText", &json!({"text": text}));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_maintainer_follows_an_alarm_to_its_throw_and_acknowledges_it() {
    let web = "[web]\nlisten = \"127.0.0.1:0\"\ntoken = \"correct horse battery\"\n";
    let (rig, daemon) = daemon_with_alarm("a", web);
    rig.until_sql("SELECT 1 AS n FROM active_alarms WHERE severity = 'critical'").await;
    let Some(mut browser) = Browser::start(&rig.folder().join("browser")) else { return };
    let fleet = browser.open(&format!("http://{}/", address(&daemon)));
    let tab = browser.open(&format!("http://{}/", address(&daemon)));
    browser.until(&fleet, "document.querySelector('ul.alarms')?.innerText.includes('not acknowledged') ?? false");
    browser.value(&fleet, "window.untouched = true; document.querySelector('form.filters button').focus()");

    browser.click(&tab, "ul.alarms li.critical a");
    browser.until(&tab, "location.pathname == '/machines/north/machine-1' && document.querySelector('h1') != null");
    browser.click(&tab, "ul.alarms li.critical a[href*='/throws/']");
    browser.until(&tab, "document.querySelector('h1')?.innerText.startsWith('Throw ') ?? false");
    browser.until(&tab, "document.querySelectorAll('figure svg').length >= 3");
    browser.click(&tab, "a[href='/machines/north/machine-1']");
    browser.until(&tab, "document.querySelector('form.act select') != null");

    // A chosen command stays, also while the focus is elsewhere.
    browser.value(&tab, "document.querySelector('form.act select').value = 'rebaseline'");
    browser.until(&tab, "document.querySelector('#silence').innerText.includes('Not refreshed while you write')");
    assert_eq!(browser.value(&tab, "document.querySelector('form.act select').value"), Some("rebaseline".into()));
    browser.value(&tab, "document.querySelector('form.act select').value = 'ack'");

    // A wrong token changes nothing, and the page says so.
    browser.write(&tab, "by", "A. Meyer");
    browser.write(&tab, "token", "wrong");
    browser.click(&tab, "form.act button");
    browser.until(&tab, "document.body.innerText.includes('the token is wrong')");
    assert!(rig.sql("SELECT * FROM operator_commands").is_empty());
    browser.until(&tab, "document.querySelector('form.act select')?.value == 'ack'");
    browser.until(&tab, "document.querySelector('input[name=by]').value == 'A. Meyer'");
    browser.write(&tab, "token", "correct horse battery");
    browser.click(&tab, "form.act button");
    browser.until(&tab, "document.querySelector('ul.alarms')?.innerText.includes('acknowledged by A. Meyer') ?? false");
    // The page of the fleet changes without a reload.
    browser.until(&fleet, "document.querySelector('ul.alarms').innerText.includes('acknowledged by A. Meyer')");
    assert_eq!(browser.value(&fleet, "window.untouched"), Some(true.into()));
    assert_eq!(browser.value(&fleet, "document.activeElement.innerText"), Some("Show".into()));
    assert_eq!(rig.sql("SELECT by_whom FROM operator_commands")[0]["by_whom"], "A. Meyer");
}

/// The page shows a boot id that contains a script as text, and says when the daemon does not answer.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_page_shows_hostile_names_as_text_and_says_when_the_daemon_is_gone() {
    let (rig, daemon, address) = small_history().await;
    let Some(mut browser) = Browser::start(&rig.folder().join("browser")) else { return };
    let machine = browser.open(&format!("http://{address}/machines/north/21B"));
    let link = "document.readyState == 'complete' && document.querySelector('a[href*=\"%3Cscript%3E\"]') != null";
    browser.until(&machine, link);
    let html = browser.value(&machine, "document.documentElement.outerHTML").unwrap();
    assert!(!html.as_str().unwrap().contains("<script>alert"), "{html}");
    let fleet = browser.open(&format!("http://{address}/"));
    browser.until(&fleet, "document.body.innerText.includes('baseline 1 of 50')");
    daemon.kill();
    browser.until(&fleet, "document.body.innerText.includes('No answer since')");
    browser.until(&fleet, "document.body.innerText.includes('baseline 1 of 50')");
}

/// JavaScript expression: the chart of friction, the second chart of the page.
const FRICTION: &str = "uPlot.sync('page').plots[1]";
/// JavaScript expression: all values of that chart, of both directions.
const VALUES: &str = "uPlot.sync('page').plots[1].series.flatMap((it, at) => it.label.includes(' to ') \
                      ? uPlot.sync('page').plots[1].data[at].filter((value) => value != null) : [])";
/// JavaScript functions for places on the page: `at` is the middle of the chart at a share of its width; `point` is a
/// point of the chart, moved inside if it is at the edge.
const PLACES: &str = "
    chart = uPlot.sync('page').plots[1];
    chart.root.scrollIntoView({block: 'center'});
    box = chart.over.getBoundingClientRect();
    at = (share) => [box.x + share * box.width, box.y + box.height / 2];
    inside = (place, size) => Math.min(Math.max(place, 2), size - 2);
    point = (x, y) => [box.x + inside(chart.valToPos(x, 'x'), box.width),
                       box.y + inside(chart.valToPos(y, 'y'), box.height)];";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_charts_show_every_throw_zoom_and_lead_to_it_and_are_pictures_without_scripts() {
    let (rig, daemon) = daemon_with_alarm("a", "[web]\nlisten = \"127.0.0.1:0\"\n");
    rig.until_sql("SELECT 1 AS n FROM health_history WHERE throw_no = 50").await;
    let Some(mut browser) = Browser::start(&rig.folder().join("browser")) else { return };
    let page = format!("http://{}/machines/north/machine-1", address(&daemon));
    let tab = browser.open("about:blank");
    browser.call(Some(&tab), "Emulation.setTimezoneOverride", &json!({"timezoneId": "Europe/Berlin"}));
    browser.call(Some(&tab), "Page.navigate", &json!({"url": page}));
    browser.until(
        &tab,
        "document.querySelectorAll('figure .uplot').length >= 7 && document.querySelectorAll('figure:not(.live)').length == 0",
    );
    let drawn = format!("{VALUES}.length");
    let stored = "SELECT count(a1_pct) AS n FROM health_history WHERE machine = 'machine-1'";
    assert_eq!(browser.value(&tab, &drawn).unwrap(), rig.sql(stored)[0]["n"]);

    // A drag zooms all charts, a double click ends it.
    let place = |browser: &mut Browser, expression: &str| -> [f64; 2] {
        serde_json::from_value(browser.value(&tab, &format!("{PLACES} {expression}")).unwrap()).unwrap()
    };
    let is_zoomed = "uPlot.sync('page').plots.every((it) => it.scales.x.max - it.scales.x.min \
                     < 0.5 * (it.data[0].at(-1) - it.data[0][0]))";
    assert_eq!(browser.value(&tab, is_zoomed), Some(false.into()));
    for (kind, share) in [("mouseMoved", 0.6), ("mousePressed", 0.6), ("mouseMoved", 0.8), ("mouseReleased", 0.8)] {
        let place = place(&mut browser, &format!("at({share})"));
        browser.mouse(&tab, kind, place);
    }
    browser.until(&tab, is_zoomed);
    // The zoom stays when the page updates itself.
    browser.value(&tab, "document.dispatchEvent(new Event('replaced'))");
    browser.until(&tab, is_zoomed);
    browser.value(&tab, &format!("{FRICTION}.over.dispatchEvent(new MouseEvent('dblclick'))"));
    browser.until(&tab, &format!("!({is_zoomed})"));

    // The pointer shows throw, size and time, and a click opens the throw.
    let newest = "at = chart.data[0].findLastIndex((_, at) => chart.series.some((it, of) => \
                  it.label.includes(' to ') && chart.data[of][at] != null)), \
                  of = chart.series.findIndex((it, of) => it.label.includes(' to ') && chart.data[of][at] != null)";
    let over = place(&mut browser, &format!("{newest}; point(chart.data[0][at], chart.data[of][at])"));
    browser.mouse(&tab, "mouseMoved", over);
    let last = rig.sql(
        "SELECT throw_no, strftime('%Y-%m-%d %H:%M:%S UTC (', started_at) AS at FROM health_history
         WHERE a1_pct IS NOT NULL ORDER BY started_at DESC",
    );
    let readout =
        browser.value(&tab, &format!("{FRICTION}.root.closest('figure').querySelector('.readout').innerText"));
    let readout = readout.unwrap().as_str().unwrap().to_owned();
    assert!(readout.starts_with(last[0]["at"].as_str().unwrap()) && readout.contains("GMT+"), "{readout}");
    assert!(readout.ends_with(&format!("throw {}", last[0]["throw_no"])), "{readout}");
    browser.mouse(&tab, "mousePressed", over);
    browser.mouse(&tab, "mouseReleased", over);
    browser.until(
        &tab,
        &format!("location.pathname.endsWith('/{}') && document.readyState == 'complete'", last[0]["throw_no"]),
    );
    browser
        .until(&tab, "document.querySelectorAll('figure .uplot').length == document.querySelectorAll('figure').length");

    // Without scripts the page shows pictures.
    browser.call(Some(&tab), "Emulation.setScriptExecutionDisabled", &json!({"value": true}));
    browser.call(Some(&tab), "Page.navigate", &json!({"url": page}));
    browser.until(&tab, "document.readyState == 'complete' && document.querySelectorAll('figure svg').length >= 7");
    let is_seen = "[...document.querySelectorAll('figure svg')].every((it) => it.getBoundingClientRect().height > 100)";
    assert_eq!(browser.value(&tab, is_seen), Some(true.into()));
    assert_eq!(browser.value(&tab, "document.querySelector('.uplot')"), Some(Value::Null));
}
