//! The pages of `serve` in a real browser, over the DevTools protocol. They load without console messages and without requests to
//! other hosts, follow a run, and can be used by keyboard alone, on a phone, and by accessible names.

use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use metasense::plan::Plan;
use metasense::store::Store;
use metasense_schemas::record::{Checkpoint, StepRecord};
use serde_json::{Value, json};

use crate::common::proxy::{FRONT, proxy};
use crate::common::skip;
use crate::common::{Bench, TINY};

/// Maximum time for a page or an event.
const DEADLINE: Duration = Duration::from_secs(60);

/// Killed at the end of the test.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A browser's page, controlled by the DevTools protocol over two pipes.
struct Page {
    _browser: Process,
    to: File,
    from: Receiver<Value>,
    session: Option<String>,
    asked: u64,
    /// Requested addresses, and messages of the console.
    requests: Vec<String>,
    complaints: Vec<String>,
    /// Navigations that have completely loaded.
    loaded: Vec<Value>,
}

impl Page {
    fn new(bench: &Bench) -> Self {
        let [to, from] = ["to", "from"].map(|name| bench.path(name));
        assert!(Command::new("mkfifo").args([&to, &from]).status().unwrap().success());
        let browser = Command::new("bash")
            .arg("-c")
            .arg("exec chromium --headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-sync \
                  --disable-background-networking --disable-component-update --remote-debugging-pipe \"--user-data-dir=$0\" \
                  about:blank 3<\"$1\" 4>\"$2\"")
            .args([bench.path("profile"), to.clone(), from.clone()])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let browser = Process(browser);
        let to = OpenOptions::new().write(true).open(to).unwrap();
        let mut pipe = BufReader::new(File::open(from).unwrap());
        let (out, from) = channel();
        std::thread::spawn(move || {
            let mut bytes = Vec::new();
            while pipe.read_until(0, &mut bytes).is_ok_and(|n| n > 0) {
                bytes.pop();
                if out.send(serde_json::from_slice(&bytes).unwrap()).is_err() {
                    return;
                }
                bytes.clear();
            }
        });
        let (requests, complaints, loaded) = Default::default();
        let mut page =
            Self { _browser: browser, to, from, session: None, asked: 0, requests, complaints, loaded };
        let target = page.ask("Target.createTarget", json!({"url": "about:blank"}));
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        let session = page.ask("Target.attachToTarget", attach);
        page.session = session["sessionId"].as_str().map(str::to_owned);
        for domain in ["Page", "Runtime", "Log", "Network", "Accessibility"] {
            page.ask(&format!("{domain}.enable"), json!({}));
        }
        page.ask("Page.setLifecycleEventsEnabled", json!({"enabled": true}));
        page
    }

    /// Sends a command and waits for its result.
    fn ask(&mut self, method: &str, params: Value) -> Value {
        self.asked += 1;
        let mut message = json!({"id": self.asked, "method": method, "params": params});
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        self.to.write_all(format!("{message}\0").as_bytes()).unwrap();
        let begun = Instant::now();
        loop {
            let left = DEADLINE.saturating_sub(begun.elapsed());
            let heard = self.from.recv_timeout(left).unwrap_or_else(|e| panic!("{method}: {e}"));
            if heard["id"] == self.asked {
                assert!(heard["error"].is_null(), "{method}: {heard}");
                return heard["result"].clone();
            }
            self.hear(&heard);
        }
    }

    fn hear(&mut self, heard: &Value) {
        let params = &heard["params"];
        match heard["method"].as_str().unwrap_or_default() {
            "Page.lifecycleEvent" if params["name"] == "load" => self.loaded.push(params["loaderId"].clone()),
            "Network.requestWillBeSent" => {
                self.requests.push(params["request"]["url"].as_str().unwrap_or_default().to_owned());
            }
            "Runtime.exceptionThrown" => self.complaints.push(params.to_string()),
            "Runtime.consoleAPICalled" => self.complaints.push(params.to_string()),
            "Log.entryAdded" => self.complaints.push(params.to_string()),
            _ => {}
        }
    }

    /// Opens an address and waits until this navigation has loaded.
    fn open(&mut self, address: &str) {
        let navigation = self.ask("Page.navigate", json!({"url": address}))["loaderId"].clone();
        self.until(address, |page| page.loaded.contains(&navigation));
    }

    /// Processes messages until a condition holds.
    fn until(&mut self, what: &str, mut holds: impl FnMut(&mut Self) -> bool) {
        let begun = Instant::now();
        while !holds(self) {
            assert!(begun.elapsed() < DEADLINE, "{what}: {:?}", self.complaints);
            match self.from.recv_timeout(Duration::from_millis(10)) {
                Ok(heard) => self.hear(&heard),
                Err(RecvTimeoutError::Timeout) => {}
                Err(e) => panic!("{what}: {e}"),
            }
        }
    }

    /// The value of an expression.
    fn value(&mut self, expression: &str) -> Value {
        let asked = json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let answer = self.ask("Runtime.evaluate", asked);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    fn key(&mut self, key: &str, code: u32, modifiers: u32) {
        for kind in ["rawKeyDown", "keyUp"] {
            let event = json!({"type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code, "modifiers": modifiers});
            self.ask("Input.dispatchKeyEvent", event);
        }
    }

    fn width(&mut self, width: u32) {
        let metrics = json!({"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600});
        self.ask("Emulation.setDeviceMetricsOverride", metrics);
    }

    /// Controls without an accessible name.
    fn nameless(&mut self) -> Vec<String> {
        let tree = self.ask("Accessibility.getFullAXTree", json!({}));
        let roles =
            ["link", "button", "textbox", "searchbox", "combobox", "slider", "image", "meter", "progressbar"];
        let nodes = tree["nodes"].as_array().unwrap().iter();
        let bad = nodes.filter(|node| {
            let role = node["role"]["value"].as_str().unwrap_or_default();
            node["ignored"] != true
                && roles.contains(&role)
                && node["name"]["value"].as_str().unwrap_or_default().is_empty()
        });
        bad.map(Value::to_string).collect()
    }
}

/// `metasense serve` on these databases, and its address.
fn served(dbs: &[&Path]) -> (Process, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    command.arg("serve").args(dbs).args(["--listen", "0"]).stdout(Stdio::piped());
    let mut process = Process(command.spawn().unwrap());
    let mut line = String::new();
    BufReader::new(process.0.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
    (process, line.trim().to_owned())
}

/// Address of the pages without key and token.
fn pages(address: &str) -> &str {
    address.split("/?key=").next().unwrap()
}

/// A run with pages in a folder with its spec, and the address with the token.
fn steered(bench: &Bench) -> (Process, String) {
    let long = TINY.replace("iterations = 4\n", "iterations = 40\n");
    bench.file("s.toml", &long.replace("[1, 2]", "[1, 2]\nseeds = [1, 2, 3, 4]"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    command.args(["run", "s.toml", "--db", "s.sqlite", "--workers", "1", "--serve=0"]);
    let mut run = Process(
        command.current_dir(bench.path("")).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap(),
    );
    let mut line = String::new();
    let mut said = BufReader::new(run.0.stderr.take().unwrap());
    said.read_line(&mut line).unwrap();
    // reads all further output
    std::thread::spawn(move || std::io::copy(&mut said, &mut std::io::sink()));
    let address = line.split_once("http://").unwrap_or_else(|| panic!("{line}")).1;
    (run, format!("http://{}", address.trim()))
}

/// Behind a proxy with a path. Without the token there are no controls; with it the keyboard controls a run, and the page shows the
/// result.
#[test]
fn a_run_is_steered_by_its_pages() {
    if !here() {
        return;
    }
    let bench = Bench::new();
    let (mut run, address) = steered(&bench);
    let (port, key) = address.rsplit_once(':').unwrap().1.split_once('/').unwrap();
    let address = format!("http://127.0.0.1:{}{FRONT}/{key}", proxy(port.parse().unwrap(), true));
    let mut page = Page::new(&bench);
    let plain = address.split("#token=").next().unwrap();
    page.open(plain);
    page.until("a page without controls", |page| {
        page.value("document.querySelector('#control')?.hidden") == true
    });
    page.open(&address);
    page.until("controls", |page| page.value("document.querySelector('#control')?.hidden") == false);
    let plain = pages(&address);
    assert_eq!(page.value("location.href"), format!("{plain}/0/"), "key and token stay in the address");
    for width in [1200, 390] {
        page.width(width);
        let nameless = page.nameless();
        assert!(nameless.is_empty(), "{nameless:?}");
        let beyond = page.value("document.documentElement.scrollWidth - innerWidth").as_i64().unwrap();
        assert!(beyond <= 0, "{beyond} px too wide for {width}");
    }
    let press = |page: &mut Page, value: &str, expected: &str| {
        page.value(&format!("document.querySelector('button[value^=\"{value}\"]').focus()"));
        assert_ne!(page.value("getComputedStyle(document.activeElement).outlineStyle"), "none");
        page.key(" ", 32, 0);
        page.until(value, |page| {
            let said = page.value("document.querySelector('#control [role=status]')?.textContent");
            said.as_str().is_some_and(|said| said.starts_with(expected))
        });
    };
    press(&mut page, "pause", "paused: ");
    let state = "document.querySelector('[data-state]').textContent.startsWith('paused: 0 of 1 worker busy')";
    page.until("the pause", |page| page.value(state) == true);
    page.value("document.querySelector('input[name=count]').focus()");
    page.ask("Input.insertText", json!({"text": "2"}));
    press(&mut page, "workers", "workers: 1 before, 2 from now on");
    press(&mut page, "reload", "trials added: 0");
    // the page of a trial also has the token
    let trial =
        page.value("fetch('sql.csv?q=SELECT+hash+FROM+v_trial+ORDER+BY+attempts,hash').then(a => a.text())");
    let hash = trial.as_str().unwrap().lines().nth(1).unwrap().to_owned();
    page.open(&format!("{plain}/0/trial/{hash}"));
    page.until("controls", |page| page.value("document.querySelector('#control')?.hidden") == false);
    assert!(page.nameless().is_empty());
    press(&mut page, "next", "starts on the next free worker");
    press(&mut page, "cancel", "cancelled");
    let failed = "document.querySelector('#facts .question').textContent === 'failed: cancelled'";
    page.until("the end of the trial", |page| page.value(failed) == true);
    page.open(&format!("{plain}/0/"));
    page.until("controls", |page| page.value("document.querySelector('#control')?.hidden") == false);
    assert!(page.complaints.is_empty(), "{:?}", page.complaints);
    press(&mut page, "stop", "stopping: no trial is running");
    assert_eq!(run.0.wait().unwrap().code(), Some(4));
    let elsewhere: Vec<&String> = page.requests.iter().filter(|url| !url.starts_with(plain)).collect();
    assert!(elsewhere.iter().all(|url| *url == "about:blank"), "{elsewhere:?}");
}

/// Modes swing and a wave can be played. If the reader prefers reduced motion, nothing moves by itself, in a report and on live
/// pages.
#[test]
fn nothing_moves_where_no_motion_is_wanted() {
    if !here() {
        return;
    }
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.output(&["run", "tiny.toml", "--db", "done.sqlite"]);
    bench.output(&["report", "done.sqlite", "--out", "report.html"]);
    let (_server, address) = served(&[&bench.path("done.sqlite")]);
    let mut page = Page::new(&bench);
    page.open(&address);
    let address = pages(&address);
    let report = format!("file://{}", bench.path("report.html").display());
    let hash = bench.output(&["query", "done.sqlite", "SELECT hash FROM v_trial LIMIT 1", "--format", "csv"]);
    let trial = format!("{address}/0/trial/{}?replay=1", hash.lines().nth(1).unwrap());
    for (wish, swings) in [("no-preference", true), ("reduce", false)] {
        let wish = json!({"features": [{"name": "prefers-reduced-motion", "value": wish}]});
        page.ask("Emulation.setEmulatedMedia", wish.clone());
        for (at, moves) in [(&report, swings), (&trial, false)] {
            page.open(at);
            let moving = "document.getAnimations().some(a => a.playState === 'running')";
            assert_eq!(page.value(moving), moves, "{at}, {wish}");
            let wave = "[...document.querySelectorAll('.wave polygon, .course polygon')].map(e =>
                            e.getAttribute('transform') + e.getAttribute('points')).join()";
            let before = page.value(wave);
            assert!(before.as_str().is_some_and(|shape| shape.contains("rotate")), "{at}: {before}");
            page.value("new Promise(done => setTimeout(done, 150))");
            assert_eq!(page.value(wave), before, "{at}, {wish}");
        }
    }
}

fn here() -> bool {
    let found =
        Command::new("chromium").arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    let found = found.is_ok_and(|status| status.success());
    if !found {
        skip::skipped("pages in a browser", "PATH has no chromium");
    }
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn a_browser_shows_follows_and_asks() {
    if !here() {
        return;
    }
    let bench = Bench::new();
    let tiny = TINY.replace("iterations = 4\n", "iterations = 7\n");
    let spec = bench.file("tiny.toml", &tiny);
    let done = bench.path("done.sqlite");
    let mut run = Command::new(env!("CARGO_BIN_EXE_metasense"));
    assert!(run.arg("run").arg(&spec).arg("--db").arg(&done).output().unwrap().status.success());
    let (plan, db) = (Plan::new("s.toml", tiny.clone()).unwrap(), bench.path("run.sqlite"));
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&plan.spec, &tiny, &plan.trials).await.unwrap();
    let first = &plan.trials[0];
    store.begin_attempt(&first.hash).await.unwrap();
    let (_server, address) = served(&[&db, &done]);
    let mut page = Page::new(&bench);
    page.open(&address);
    let address = pages(&address);

    // recorded steps appear without any action
    page.open(&format!("{address}/0/"));
    let (_, initial) = metasense_lab::simulate::body(&first.spec).unwrap();
    let recorded = |n: u32| {
        let record =
            StepRecord { step: n, error_test: Some(9.0), outcome: "ok".into(), ..Default::default() };
        let design = initial.iter().map(|x| x + 0.1 * f64::from(n + 1)).collect();
        (record, Checkpoint { step: n + 1, design, ..Default::default() })
    };
    let mut took = Vec::new();
    for n in 0..6 {
        let (record, checkpoint) = recorded(n);
        store.record_step(&first.hash, 1, &record, &checkpoint).await.unwrap();
        let begun = Instant::now();
        let seen = format!("document.querySelector('#progress').textContent.includes('{} steps in')", n + 1);
        page.until("the step on the page", |page| page.value(&seen) == true);
        took.push(begun.elapsed());
    }
    took.sort_unstable();
    println!("steps were on the page after {took:?}");
    assert!(took[took.len() / 2] < Duration::from_secs(1), "{took:?}");

    // the slider of steps follows the newest step, and stays where keys have moved it
    page.open(&format!("{address}/0/trial/{}", first.hash));
    let step = "document.querySelector('.course input').getAttribute('aria-valuetext')";
    let unit = "document.querySelector('.course polygon.unit').getAttribute('points')";
    assert_eq!(page.value(step), "step 6 of 7");
    let before = page.value(unit);
    let (record, checkpoint) = recorded(6);
    store.record_step(&first.hash, 1, &record, &checkpoint).await.unwrap();
    page.until("the design on the page", |page| page.value(step) == "step 7 of 7");
    assert_ne!(page.value(unit), before);
    page.value("document.querySelector('.course input').focus()");
    for (key, code, expected) in
        [("Home", 36, 0), ("ArrowRight", 39, 1), ("End", 35, 7), ("ArrowLeft", 37, 6)]
    {
        page.key(key, code, 0);
        assert_eq!(page.value(step), format!("step {expected} of 7"), "{key}");
        assert_eq!(page.value(unit) == before, expected == 6, "{key}");
    }
    let (record, checkpoint) = (recorded(6).0, recorded(7).1);
    let told = "document.querySelector('#designs').textContent.split('\\n').length";
    store.record_step(&first.hash, 1, &record, &checkpoint).await.unwrap();
    page.until("a design more", |page| page.value(told) == 1 + 1 + 8);
    assert_eq!((page.value(step), page.value(unit)), ("step 6 of 7".into(), before.clone()));
    page.value("document.querySelector('.course button').click()");
    page.until("the body in motion", |page| page.value(unit) != before);

    // every page, wide and narrow: all controls have names, and nothing exceeds the page's width
    let of_trial = format!("/1/trial/{}?replay=1", first.hash);
    let paths = ["/", "/0/", "/1/", "/1/trials", "/1/map", "/1/sql", "/1/compare?with=0", &of_trial];
    for width in [1200, 390] {
        page.width(width);
        for path in paths {
            page.open(&format!("{address}{path}"));
            let nameless = page.nameless();
            assert!(nameless.is_empty(), "{path}: {nameless:?}");
            let beyond = page.value("document.documentElement.scrollWidth - innerWidth").as_i64().unwrap();
            assert!(beyond <= 0, "{path} is {beyond} px too wide for {width}");
        }
    }

    // keys move through the wave
    let shape = "document.querySelector('.wave polygon.unit:last-of-type').getAttribute('transform')";
    page.value("document.querySelector('.wave input').focus()");
    page.key("Home", 36, 0);
    let before = page.value(shape);
    page.key("End", 35, 0);
    assert_ne!(page.value(shape), before);

    // by keyboard alone: skip the head, and run a query
    page.width(1200);
    page.open(&format!("{address}/1/sql"));
    page.key("Tab", 9, 0);
    assert_eq!(page.value("document.activeElement.className"), "skip");
    assert_eq!(page.value("document.activeElement.getBoundingClientRect().left >= 0"), true);
    assert_ne!(page.value("getComputedStyle(document.activeElement).outlineStyle"), "none");
    page.value("document.querySelector('textarea').focus()");
    page.value("document.querySelector('textarea').value = 'SELECT count(*) AS told FROM v_step'");
    let before = page.loaded.len();
    page.key("Enter", 13, 2);
    page.until("the answer", |page| page.loaded.len() > before);
    let told = page.value("document.querySelector('td').textContent");
    assert_eq!(told, "14");

    let elsewhere: Vec<&String> = page.requests.iter().filter(|url| !url.starts_with(address)).collect();
    assert!(elsewhere.iter().all(|url| *url == "about:blank"), "{elsewhere:?}");
    assert!(page.requests.len() > 30, "{}", page.requests.len());
    assert!(page.complaints.is_empty(), "{:?}", page.complaints);

    // an injected script does not run, and the browser reports it
    page.value("{ const s = document.createElement('script'); s.textContent = 'window.ran = 1'; document.body.append(s) }");
    assert_eq!(page.value("window.ran"), Value::Null);
    page.until("the refusal", |page| {
        page.complaints.iter().any(|told| told.contains("Content Security Policy"))
    });
    store.close().await.unwrap();
}
