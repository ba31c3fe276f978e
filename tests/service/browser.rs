//! A real browser, controlled over the pipe of its debugging protocol, as a person uses the dashboard. Skipped, with a
//! message, without `chromium`.

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Child, ChildStdin, Command, Stdio},
    sync::mpsc::{self, Receiver},
    thread,
    time::{Duration, Instant},
};

use serde_json::{Value, json};

use crate::{http::address, operators::daemon_with_alarm, rig::PATIENCE};

/// A running browser.
struct Browser {
    child: Child,
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
        if Command::new("chromium").arg("--version").stdout(Stdio::null()).status().is_err() {
            println!("skipped: chromium is not installed");
            return None;
        }
        // The protocol has descriptor 3 for messages to the browser and 4 for messages from it.
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
        Some(Self { child, input, messages, last_id: 0 })
    }

    fn call(&mut self, tab: Option<&Tab>, method: &str, parameters: &Value) -> Value {
        self.last_id += 1;
        let mut message = json!({"id": self.last_id, "method": method, "params": parameters});
        if let Some(Tab(session)) = tab {
            message["sessionId"] = json!(session);
        }
        write!(self.input, "{message}\0").unwrap();
        loop {
            let mut answer = self.messages.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("no answer to {message}"));
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
        Tab(session["sessionId"].as_str().unwrap().to_owned())
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

    /// Clicks on the middle of the first element of a selector, with the mouse.
    fn click(&mut self, tab: &Tab, selector: &str) {
        let place = format!(
            "(() => {{ const it = document.querySelector({selector:?}); it.scrollIntoView({{block: 'center'}}); \
             const box = it.getClientRects()[0]; return [box.x + box.width / 2, box.y + box.height / 2]; }})()"
        );
        self.until(tab, &format!("document.readyState == 'complete' && document.querySelector({selector:?}) != null"));
        let place = self.value(tab, &place).unwrap();
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({"type": kind, "x": place[0], "y": place[1], "button": "left", "clickCount": 1});
            self.call(Some(tab), "Input.dispatchMouseEvent", &event);
        }
    }

    /// Types into a field of the form.
    fn write(&mut self, tab: &Tab, field: &str, text: &str) {
        self.click(tab, &format!("input[name={field}]"));
        self.call(Some(tab), "Input.insertText", &json!({"text": text}));
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
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
    browser.value(&fleet, "window.untouched = true");

    browser.click(&tab, "ul.alarms li.critical a");
    browser.until(&tab, "location.pathname == '/machines/north/machine-1' && document.querySelector('h1') != null");
    browser.click(&tab, "ul.alarms li.critical a[href*='/throws/']");
    browser.until(&tab, "document.querySelector('h1')?.innerText.startsWith('Throw ') ?? false");
    browser.until(&tab, "document.querySelectorAll('figure svg').length >= 3");
    browser.click(&tab, "a[href='/machines/north/machine-1']");
    browser.until(&tab, "document.querySelector('form.act select') != null");

    // A wrong token changes nothing, and the page says so.
    browser.write(&tab, "by", "A. Meyer");
    browser.write(&tab, "token", "wrong");
    browser.click(&tab, "form.act button");
    browser.until(&tab, "document.body.innerText.includes('the token is wrong')");
    assert!(rig.sql("SELECT * FROM operator_commands").is_empty());
    browser.value(&tab, "history.back()");
    browser.until(&tab, "document.querySelector('form.act select')?.value == 'ack'");
    browser.value(
        &tab,
        "document.querySelector('input[name=by]').value = document.querySelector('input[name=token]').value = ''",
    );
    browser.write(&tab, "by", "A. Meyer");
    browser.write(&tab, "token", "correct horse battery");
    browser.click(&tab, "form.act button");
    browser.until(&tab, "document.querySelector('ul.alarms')?.innerText.includes('acknowledged by A. Meyer') ?? false");
    // The page of the fleet changes without a reload.
    browser.until(&fleet, "document.querySelector('ul.alarms').innerText.includes('acknowledged by A. Meyer')");
    assert_eq!(browser.value(&fleet, "window.untouched"), Some(true.into()));
    assert_eq!(rig.sql("SELECT by_whom FROM operator_commands")[0]["by_whom"], "A. Meyer");
    drop(browser);
    assert!(daemon.terminate().success());
}
