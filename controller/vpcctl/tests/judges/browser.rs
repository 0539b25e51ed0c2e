//! A headless Chromium, driven through its debugging pipe: JSON, each message ended by a zero byte.

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Seconds after which it is ended, whatever it does.
const LIFE: &str = "90";
/// Longest wait for a page to become as it should.
const PATIENCE: Duration = Duration::from_secs(40);

/// A browser with one page.
pub struct Browser {
    child: Child,
    to: File,
    from: BufReader<File>,
    session: Value,
    number: u64,
}

impl Browser {
    /// Opens the page; `None` if there is no Chromium.
    pub fn open(directory: &Path, url: &str) -> Option<Self> {
        let [to, from] = ["to", "from"].map(|name| directory.join(name));
        for fifo in [&to, &from] {
            assert!(
                testkit::command("mkfifo")
                    .arg(fifo)
                    .status()
                    .unwrap()
                    .success()
            );
        }
        let flags =
            "--headless --no-sandbox --disable-gpu --window-size=1400,1000 --remote-debugging-pipe";
        let line = format!(
            "exec timeout --foreground {LIFE} chromium {flags} --user-data-dir=\"$0\" 3<\"$1\" 4>\"$2\""
        );
        let child = testkit::command("sh")
            .args(["-c", &line])
            .args([&directory.join("profile"), &to, &from])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // In the order of the shell: each opening waits for the other side.
        let to = File::options().write(true).open(&to).unwrap();
        let from = BufReader::new(File::open(&from).unwrap());
        let mut browser = Self {
            child,
            to,
            from,
            session: Value::Null,
            number: 0,
        };
        let page = browser.call("Target.createTarget", json!({ "url": url }))?;
        let attach = json!({ "targetId": page["targetId"], "flatten": true });
        browser.session = browser.call("Target.attachToTarget", attach)?["sessionId"].clone();
        Some(browser)
    }

    /// Calls a method; `None` if the browser is gone.
    fn call(&mut self, method: &str, parameters: Value) -> Option<Value> {
        self.number += 1;
        let mut message = json!({ "id": self.number, "method": method, "params": parameters });
        if !self.session.is_null() {
            message["sessionId"] = self.session.clone();
        }
        write!(self.to, "{message}\0").ok()?;
        loop {
            let mut bytes = Vec::new();
            self.from.read_until(0, &mut bytes).ok()?;
            bytes.pop()?;
            let answer: Value = serde_json::from_slice(&bytes).unwrap();
            if answer["id"] == self.number {
                return Some(answer["result"].clone());
            }
        }
    }

    /// The value of an expression in the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let parameters = json!({ "expression": expression });
        let answer = self
            .call("Runtime.evaluate", parameters)
            .expect("the browser is gone");
        answer["result"]["value"].clone()
    }

    /// Gives the page a window of this size, px.
    pub fn resize(&mut self, width: u32, height: u32) {
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600 });
        self.call("Emulation.setDeviceMetricsOverride", size)
            .expect("the browser is gone");
    }

    /// Keeps a picture of the page, to be looked at, as PNG.
    pub fn keep_picture(&mut self, path: &Path) {
        let answer = self.call("Page.captureScreenshot", json!({})).unwrap();
        let picture = answer["data"].as_str().unwrap();
        let mut base64 = testkit::command("base64")
            .arg("-d")
            .stdin(Stdio::piped())
            .stdout(File::create(path).unwrap())
            .spawn()
            .unwrap();
        let mut to = base64.stdin.take().unwrap();
        to.write_all(picture.as_bytes()).unwrap();
        drop(to);
        assert!(base64.wait().unwrap().success());
    }

    /// Waits until an expression of the page is true.
    pub fn wait_for(&mut self, expression: &str) {
        let end = Instant::now() + PATIENCE;
        while self.value(expression) != true {
            let page = self.value("document.body.innerText");
            assert!(
                Instant::now() < end,
                "{expression} does not become true:\n{page}"
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Its processes end together; killing the first would leave the others.
        self.session = Value::Null;
        let _ = self.call("Browser.close", json!({}));
        let _ = self.child.wait();
    }
}
