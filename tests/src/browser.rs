//! A headless Chromium, driven as people do: real pointer events, real files, pictures of what is seen.
//!
//! By its debugging protocol (<https://chromedevtools.github.io/devtools-protocol/>) over one socket.

use std::{
    env, fs,
    net::TcpStream,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use base64::{Engine, engine::general_purpose::STANDARD};
use serde_json::{Value, json};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket, stream::MaybeTlsStream};

use crate::skipped;

/// The variable that names the browser to use.
pub const VARIABLE: &str = "ECLIPSE_BROWSER";
/// WebGL in software, so that tests need no graphics card.
pub const SOFTWARE: [&str; 3] = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
];
const NAMES: [&str; 6] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "chrome-headless-shell",
];
/// A busy machine without a graphics card takes its time.
const PATIENCE: Duration = Duration::from_secs(120);

/// The browser that the environment names or the path has; says so and gives `None` where there is none.
pub fn installed() -> Option<PathBuf> {
    let named = env::var_os(VARIABLE).map(PathBuf::from);
    let folders: Vec<PathBuf> =
        env::split_paths(&env::var_os("PATH").unwrap_or_default()).collect();
    let found = named.or_else(|| {
        let all = folders
            .iter()
            .flat_map(|folder| NAMES.map(|name| folder.join(name)));
        all.into_iter().find(|path| path.is_file())
    });
    if found.is_none() {
        skipped(&format!(
            "no Chromium found; install one or name it in {VARIABLE}"
        ));
    }
    found
}

/// One browser with one page.
pub struct Browser {
    process: Child,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    session: String,
    last: u64,
    /// What scripts threw.
    pub exceptions: Vec<String>,
    // Deleted after the process has ended.
    _profile: TempDir,
}

impl Browser {
    /// Starts `program` with `flags` besides those it needs and opens a page of `width` × `height`.
    pub fn start(program: &Path, flags: &[&str], [width, height]: [u32; 2]) -> Self {
        let profile = tempfile::tempdir().unwrap();
        let process = Command::new(program)
            .args([
                "--headless=new",
                "--no-sandbox",
                "--no-first-run",
                "--disable-extensions",
                "--disable-dev-shm-usage",
                "--remote-debugging-port=0",
            ])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg(format!("--window-size={width},{height}"))
            .args(flags)
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let port = profile.path().join("DevToolsActivePort");
        let address = wait(|| {
            let text = fs::read_to_string(&port).ok()?;
            let (port, path) = text.trim().split_once('\n')?;
            Some(format!("ws://127.0.0.1:{port}{path}"))
        });
        let address = address.expect("the browser opens its debugging port");
        let (socket, _) = tungstenite::connect(address).unwrap();
        let mut browser = Self {
            process,
            socket,
            session: String::new(),
            last: 0,
            exceptions: Vec::new(),
            _profile: profile,
        };
        let page = browser.call("Target.createTarget", json!({"url": "about:blank"}));
        let attached = browser.call(
            "Target.attachToTarget",
            json!({"targetId": page["targetId"], "flatten": true}),
        );
        browser.session = attached["sessionId"].as_str().unwrap().to_owned();
        browser.call("Page.enable", json!({}));
        browser.call("Runtime.enable", json!({}));
        browser.call(
            "Emulation.setDeviceMetricsOverride",
            json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false}),
        );
        browser
    }

    /// Runs `script` before those of every page.
    pub fn before_each_page(&mut self, script: &str) {
        self.call(
            "Page.addScriptToEvaluateOnNewDocument",
            json!({"source": script}),
        );
    }

    /// Opens a file and waits until it is loaded.
    pub fn open(&mut self, file: &Path) {
        let url = format!("file://{}", file.display());
        self.call("Page.navigate", json!({"url": url}));
        self.wait_for(&format!(
            "location.href === {} && document.readyState === 'complete'",
            json!(url)
        ));
    }

    /// The value of a script's expression.
    pub fn evaluate(&mut self, expression: &str) -> Value {
        let answer = self.call(
            "Runtime.evaluate",
            json!({"expression": expression, "returnByValue": true, "awaitPromise": true}),
        );
        assert!(
            answer["exceptionDetails"].is_null(),
            "{expression}: {}",
            answer["exceptionDetails"]
        );
        answer["result"]["value"].clone()
    }

    /// Waits until the expression is true.
    pub fn wait_for(&mut self, expression: &str) {
        let came = wait(|| (self.evaluate(expression) == json!(true)).then_some(()));
        assert!(came.is_some(), "never came true: {expression}");
    }

    /// Left, top, width and height of an element that is scrolled into view, in pixels of the window.
    pub fn place(&mut self, id: &str) -> [f64; 4] {
        let script = format!(
            "(() => {{ const e = document.getElementById('{id}'); e.scrollIntoView({{block: 'center', behavior: 'instant'}}); \
             const b = e.getBoundingClientRect(); return [b.left, b.top, b.width, b.height]; }})()"
        );
        let values = self.evaluate(&script);
        std::array::from_fn(|k| values[k].as_f64().unwrap())
    }

    /// Presses at a share of an element's width and height.
    pub fn click(&mut self, id: &str, share: [f64; 2]) {
        self.drag(id, share, share);
    }

    /// Presses at one place within an element, moves to another in steps, and lets go.
    pub fn drag(&mut self, id: &str, from: [f64; 2], to: [f64; 2]) {
        const STEPS: usize = 6;
        let [left, top, width, height] = self.place(id);
        let at = |share: [f64; 2]| [left + width * share[0], top + height * share[1]];
        self.mouse("mouseMoved", at(from), 0);
        self.mouse("mousePressed", at(from), 1);
        for step in 1..=STEPS {
            let part = step as f64 / STEPS as f64;
            let place = [0, 1].map(|k| from[k] + part * (to[k] - from[k]));
            self.mouse("mouseMoved", at(place), 1);
        }
        self.mouse("mouseReleased", at(to), 0);
        self.painted();
    }

    /// Moves the pointer over an element.
    pub fn hover(&mut self, id: &str, share: [f64; 2]) {
        let [left, top, width, height] = self.place(id);
        self.mouse(
            "mouseMoved",
            [left + width * share[0], top + height * share[1]],
            0,
        );
        self.painted();
    }

    /// Drops a file from outside onto an element.
    pub fn drop_file(&mut self, id: &str, file: &Path) {
        let [left, top, width, height] = self.place(id);
        for kind in ["dragEnter", "dragOver", "drop"] {
            self.call(
                "Input.dispatchDragEvent",
                json!({
                    "type": kind, "x": left + width / 2.0, "y": top + height / 2.0,
                    "data": {"items": [], "files": [file], "dragOperationsMask": 1},
                }),
            );
        }
        self.painted();
    }

    /// Chooses a file in a file input.
    pub fn choose_file(&mut self, id: &str, file: &Path) {
        let document = self.call("DOM.getDocument", json!({}));
        let node = self.call(
            "DOM.querySelector",
            json!({"nodeId": document["root"]["nodeId"], "selector": format!("#{id}")}),
        );
        self.call(
            "DOM.setFileInputFiles",
            json!({"nodeId": node["nodeId"], "files": [file]}),
        );
        self.painted();
    }

    /// What is seen of an element.
    pub fn picture(&mut self, id: &str) -> image::RgbImage {
        let [left, top, width, height] = self.place(id);
        self.painted();
        let scrolled = self.evaluate("[scrollX, scrollY]");
        let scroll = [0, 1].map(|k| scrolled[k].as_f64().unwrap());
        let clip = json!({"x": left + scroll[0], "y": top + scroll[1], "width": width, "height": height, "scale": 1});
        let answer = self.call(
            "Page.captureScreenshot",
            json!({"format": "png", "clip": clip}),
        );
        let png = STANDARD.decode(answer["data"].as_str().unwrap()).unwrap();
        image::load_from_memory(&png).unwrap().to_rgb8()
    }

    /// Waits for two frames: one may be under way already.
    fn painted(&mut self) {
        self.evaluate(
            "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))",
        );
    }

    fn mouse(&mut self, kind: &str, [x, y]: [f64; 2], buttons: u32) {
        let button = if kind == "mouseMoved" && buttons == 0 {
            "none"
        } else {
            "left"
        };
        self.call(
            "Input.dispatchMouseEvent",
            json!({"type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": 1, "pointerType": "mouse"}),
        );
    }

    /// One command of the protocol.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.last += 1;
        let mut message = json!({"id": self.last, "method": method, "params": parameters});
        if !self.session.is_empty() {
            message["sessionId"] = json!(self.session);
        }
        self.socket
            .send(Message::text(message.to_string()))
            .unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else {
                continue;
            };
            let answer: Value = serde_json::from_str(&text).unwrap();
            if answer["method"] == "Runtime.exceptionThrown" {
                let details = &answer["params"]["exceptionDetails"];
                self.exceptions.push(details.to_string());
            }
            if answer["id"] == json!(self.last) {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Asked to close it ends its own processes; one that does not is ended.
        let close = json!({"id": self.last + 1, "method": "Browser.close"}).to_string();
        let _ = self.socket.send(Message::text(close));
        let until = Instant::now() + Duration::from_secs(10);
        while Instant::now() < until {
            if matches!(self.process.try_wait(), Ok(Some(_))) {
                return;
            }
            thread::sleep(Duration::from_millis(50));
        }
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Asks again until there is an answer or patience ends.
fn wait<T>(mut ask: impl FnMut() -> Option<T>) -> Option<T> {
    let until = Instant::now() + PATIENCE;
    while Instant::now() < until {
        if let Some(answer) = ask() {
            return Some(answer);
        }
        thread::sleep(Duration::from_millis(50));
    }
    None
}
