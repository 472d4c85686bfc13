//! Pages of databases: they load, follow runs, refuse foreign requests, and block nothing.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use metasense::plan::Plan;
use metasense::serve::{Address, ServerState, Token, WatchedDatabase, serve};
use metasense::store::{LogLevel, Store};
use metasense_schemas::record::{Checkpoint, StepRecord};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

use crate::common::roll::{Roll, number};
use crate::common::{Bench, TINY};

/// Headers of a browser on this machine.
const HOST: &str = "Host: localhost\r\nAuthorization: Bearer key\r\n";

/// Pages of a database.
const PAGES: [&str; 8] = [
    "",
    "trials",
    "trials?q=K%3E%3D1+state!%3Dx&sort=-placement&page=2",
    "map",
    "map?by=gain",
    "compare",
    "sql",
    "sql?q=SELECT+*+FROM+v_trial&x=panels&y=sensors",
];

/// Serves databases until it is dropped.
pub struct Server {
    pub port: u16,
    pub served: Arc<ServerState>,
    task: tokio::task::JoinHandle<()>,
}

impl Server {
    async fn new(dbs: &[PathBuf]) -> Self {
        Self::with(dbs, None).await
    }

    async fn with(dbs: &[PathBuf], token: Option<Token>) -> Self {
        Self::at(dbs, token, Address::default()).await
    }

    pub async fn at(dbs: &[PathBuf], token: Option<Token>, address: Address) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let sources = dbs.iter().map(|db| WatchedDatabase::new(db).unwrap()).collect();
        let served = ServerState::new(sources, Token::of("key"), token, address);
        let task = tokio::spawn(serve(listener, Arc::clone(&served)));
        Self { port, served, task }
    }

    pub async fn connect(&self) -> TcpStream {
        TcpStream::connect(("127.0.0.1", self.port)).await.unwrap()
    }

    /// Sends bytes and reads until the connection closes, at most ten seconds.
    async fn raw(&self, request: &[u8]) -> String {
        let mut stream = self.connect().await;
        let _ = stream.write_all(request).await;
        let mut answer = Vec::new();
        let _ = tokio::time::timeout(Duration::from_secs(10), stream.read_to_end(&mut answer)).await;
        String::from_utf8_lossy(&answer).into_owned()
    }

    pub async fn get(&self, path: &str) -> (u16, String) {
        let answer =
            self.raw(format!("GET {path} HTTP/1.1\r\n{HOST}Connection: close\r\n\r\n").as_bytes()).await;
        (status(&answer), answer)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.task.abort();
    }
}

pub fn status(answer: &str) -> u16 {
    answer.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0)
}

fn plan(spec: &str) -> Plan {
    Plan::new("s.toml", spec.to_owned()).unwrap()
}

/// A database of two trials, one of which has started and logged a line.
pub async fn begun(db: &Path) -> (Store, Vec<String>) {
    let plan = plan(TINY);
    let mut store = Store::open(db).await.unwrap();
    store.begin_sweep(&plan.spec, TINY, &plan.trials).await.unwrap();
    let hashes: Vec<String> = plan.trials.iter().map(|trial| trial.hash.clone()).collect();
    store.begin_attempt(&hashes[0]).await.unwrap();
    step(&mut store, &hashes[0], 0).await;
    store.log(&hashes[0], 1, LogLevel::Warn, "something was said").await.unwrap();
    (store, hashes)
}

async fn step(store: &mut Store, hash: &str, step: u32) {
    let record = StepRecord {
        step,
        error_test: Some(20.0 / f64::from(step + 1)),
        outcome: "ok".into(),
        ..Default::default()
    };
    let (_, design) = metasense_lab::simulate::body(&plan(TINY).trials[0].spec).unwrap();
    let checkpoint = Checkpoint { step: step + 1, design, ..Default::default() };
    store.record_step(hash, 1, &record, &checkpoint).await.unwrap();
}

async fn execute(db: &Path, sql: &str) {
    let mut connection = SqliteConnectOptions::new().filename(db).connect().await.unwrap();
    sqlx::raw_sql(AssertSqlSafe(sql.to_owned())).execute(&mut connection).await.unwrap();
    connection.close().await.unwrap();
}

/// All pages of finished databases and of a running one, with their security headers and without foreign content.
#[tokio::test(flavor = "multi_thread")]
async fn every_page_is_there_and_comes_from_here_alone() {
    let bench = Bench::new();
    let (store, hashes) = begun(&bench.path("run.sqlite")).await;
    let mut dbs = vec![bench.path("run.sqlite")];
    for name in ["kept.sqlite", "other.sqlite"] {
        std::fs::copy(crate::upgrade::database(), bench.path(name)).unwrap();
        dbs.push(bench.path(name));
    }
    let server = Server::new(&dbs).await;
    let mut paths: Vec<String> = (0..3).flat_map(|i| PAGES.map(|page| format!("/{i}/{page}"))).collect();
    paths.extend(
        ["/", "/style.css", "/live.js", "/wave.js", "/icon.svg", "/1/compare?with=2"].map(String::from),
    );
    paths.push(format!("/0/trial/{}", hashes[0]));
    paths.push(format!("/0/compare?a={}&b={}", hashes[0], hashes[1]));
    paths.push(format!("/0/compare?trial={}&trial={}", hashes[0], hashes[1]));
    paths.push("/2/sql.csv?q=SELECT+1+AS+x".into());
    paths.push("/2/sql.parquet?q=SELECT+1+AS+x".into());
    for path in &paths {
        let (status, answer) = server.get(path).await;
        assert_eq!(status, 200, "{path}: {answer}");
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        assert!(
            head.contains("content-security-policy: default-src 'none'; script-src 'self';"),
            "{path}: {head}"
        );
        assert!(head.contains("x-content-type-options: nosniff"), "{path}: {head}");
        for forbidden in
            ["unsafe-inline", "style=\"", "<style", "onclick=", "src=\"http", "href=\"http", "url("]
        {
            assert!(!answer.contains(forbidden), "{path} has {forbidden}");
        }
        let scripts = body.matches("<script").count();
        assert!(scripts == 2 || !head.contains("text/html"), "{path}: {scripts}");
    }
    for path in
        ["/3/", "/0/nothing", "/0/trial/nothing", "/0/../../etc/passwd", "/0/%2e%2e/%2e%2e/etc/passwd"]
    {
        let (status, answer) = server.get(path).await;
        assert!([400, 404].contains(&status) && !answer.contains("root:"), "{path}: {answer}");
    }
    for (path, why) in [
        ("/0/trials?page=-1", "page: invalid digit found in string"),
        ("/0/sql.parquet?q=SELECT+1+AS+a,+2+AS+a", "two columns are named a"),
    ] {
        let (status, page) = server.get(path).await;
        assert!(status == 400 && page.contains(why) && page.contains("Back to the start"), "{path}: {page}");
    }
    let (_, page) = server.get(&format!("/0/trial/{}", hashes[0])).await;
    let (_, sql) = server.get("/0/sql").await;
    assert!(sql.contains("<code>training</code>") && !sql.contains('`'), "{sql}");
    let (_, compared) = server.get(&format!("/0/compare?trial={}&trial={}", hashes[0], hashes[1])).await;
    assert!(compared.contains("Settings that differ"), "{compared}");
    let (_, compared) = server.get(&format!("/0/compare?trial={}", hashes[0])).await;
    assert!(compared.contains("Tick two"), "{compared}");
    assert!(page.contains("something was said") && page.contains("body after 1 step<"), "{page}");
    server.served.close().await;
    store.close().await.unwrap();
    let left: Vec<_> =
        std::fs::read_dir(bench.path("")).unwrap().flatten().map(|entry| entry.file_name()).collect();
    assert_eq!(left.len(), 3, "{left:?}");
}

/// A step that the store has written is announced within a second, and the page requested then contains it.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_on_disk_is_on_the_page_within_a_second() {
    let bench = Bench::new();
    let db = bench.path("run.sqlite");
    let (mut store, hashes) = begun(&db).await;
    let server = Server::new(&[db]).await;
    let mut events = server.connect().await;
    events.write_all(format!("GET /0/events HTTP/1.1\r\n{HOST}\r\n").as_bytes()).await.unwrap();
    let mut heard = String::new();
    let mut took = Vec::new();
    for n in 1..12 {
        let recorded = Instant::now();
        step(&mut store, &hashes[0], n).await;
        // the event may be of an earlier step: check the page
        loop {
            let mut bytes = [0; 4096];
            let read = tokio::time::timeout(Duration::from_secs(10), events.read(&mut bytes)).await;
            heard += &String::from_utf8_lossy(&bytes[..read.expect("an event in time").unwrap()]);
            if std::mem::take(&mut heard).contains("data: ") {
                let (_, page) = server.get("/0/").await;
                if page.contains(&format!("{} steps in", n + 1)) {
                    break;
                }
            }
        }
        took.push(recorded.elapsed());
        let (_, page) = server.get(&format!("/0/trial/{}", hashes[0])).await;
        assert!(page.contains(&format!("body after {} steps", n + 1)), "step {n}: {page}");
        // one stop for the initial body and one per design, with its numbers
        assert!(page.contains(&format!("max=\"{}\" value=\"0\" aria-label=\"outer step\"", n + 1)), "{page}");
        let designs =
            page.split("id=\"designs\" data-live hidden>").nth(1).unwrap().split('<').next().unwrap();
        assert_eq!(designs.lines().count() as u32, 1 + 1 + n + 1, "{page}");
    }
    took.sort_unstable();
    println!("steps were told after {took:?}");
    // the median, because other tests may load the machine
    assert!(took[took.len() / 2] < Duration::from_secs(1), "{took:?}");
    server.served.close().await;
}

/// Removed trials disappear from pages, and new trials with their ids have their own settings.
#[tokio::test(flavor = "multi_thread")]
async fn removed_trials_leave_the_pages() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.output(&["run", "tiny.toml", "--db", "s.sqlite"]);
    let server = Server::new(&[bench.path("s.sqlite")]).await;
    // pages follow within a second unless other tests load the machine
    let shows = async |condition: &str, count: usize| {
        for _ in 0..100 {
            let (_, page) = server.get(&format!("/0/trials?q={}", condition.replace('=', "%3D"))).await;
            if page.matches("href=\"../0/trial/").count() == count {
                return;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        panic!("{condition}: not {count} trials");
    };
    shows("M=1", 1).await;
    shows("M=2", 1).await;
    bench.output(&["remove", "s.sqlite", "M=2", "--yes"]);
    shows("M=2", 0).await;
    shows("M=1", 1).await;
    bench.output(&["run", "tiny.toml", "--db", "s.sqlite", "sweep.sensors=[2]", "optimise.batch=3"]);
    shows("M=2", 1).await;
    shows("optimise.batch=3", 1).await;
    shows("optimise.batch=4", 1).await;
    server.served.close().await;
}

/// Foreign host names for this machine, pages of other sites and malformed requests are refused.
#[tokio::test(flavor = "multi_thread")]
async fn only_pages_of_our_own_are_answered() {
    let bench = Bench::new();
    let (_store, _) = begun(&bench.path("run.sqlite")).await;
    let server = Server::new(&[bench.path("run.sqlite")]).await;
    let port = server.port;
    let anyone = format!("Host: 127.0.0.1:{port}\r\n");
    let ours = format!("{anyone}Authorization: Bearer key\r\n");
    for (request, expected) in [
        // another user of the machine without the key, with a wrong one, or with that of another server
        (format!("GET /0/ HTTP/1.1\r\n{anyone}"), 401),
        (format!("GET /style.css HTTP/1.1\r\n{anyone}"), 401),
        (format!("GET /0/sql.csv?q=SELECT+1 HTTP/1.1\r\n{anyone}"), 401),
        (format!("GET /0/events HTTP/1.1\r\n{anyone}Authorization: Bearer kez\r\n"), 401),
        (format!("GET /?key=kez HTTP/1.1\r\n{anyone}"), 401),
        (format!("GET /0/ HTTP/1.1\r\n{anyone}Cookie: metasense-1=key\r\n"), 401),
        (format!("GET /?key=key HTTP/1.1\r\n{anyone}"), 303),
        (format!("GET /0/ HTTP/1.1\r\n{anyone}Cookie: a=b; metasense-{port}=key\r\n"), 200),
        (format!("GET /0/ HTTP/1.1\r\n{ours}"), 200),
        (format!("GET /0/ HTTP/1.1\r\nHost: [::1]:{port}\r\nAuthorization: Bearer key\r\n"), 200),
        (format!("HEAD /0/ HTTP/1.1\r\n{ours}"), 200),
        (format!("GET /0/ HTTP/1.1\r\n{ours}Origin: http://127.0.0.1:{port}\r\n"), 200),
        (
            format!("GET /0/ HTTP/1.1\r\n{ours}Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: navigate\r\n"),
            200,
        ),
        (format!("GET /0/ HTTP/1.1\r\nHost: evil.example:{port}\r\n"), 421),
        (format!("GET /0/ HTTP/1.1\r\nHost: localhost.evil.example:{port}\r\n"), 421),
        ("GET /0/ HTTP/1.1\r\nHost: 127.0.0.1.nip.io\r\n".into(), 421),
        ("GET /0/ HTTP/1.1\r\n".into(), 421),
        ("GET /0/ HTTP/1.0\r\n".into(), 421),
        (format!("GET /0/ HTTP/1.1\r\n{ours}Host: evil.example\r\n"), 421),
        (format!("GET http://evil.example/0/ HTTP/1.1\r\n{ours}"), 421),
        (format!("GET /0/ HTTP/1.1\r\n{ours}Origin: http://evil.example\r\n"), 403),
        (format!("GET /0/ HTTP/1.1\r\n{ours}Origin: null\r\n"), 403),
        (format!("GET /0/ HTTP/1.1\r\n{ours}Origin: http://127.0.0.1:1\r\n"), 403),
        (format!("GET /0/ HTTP/1.1\r\n{ours}Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: no-cors\r\n"), 403),
        (format!("POST /0/ HTTP/1.1\r\n{ours}Content-Length: 0\r\n"), 405),
        (format!("DELETE /0/ HTTP/1.1\r\n{ours}"), 405),
        (format!("OPTIONS /0/ HTTP/1.1\r\n{ours}Origin: http://evil.example\r\n"), 405),
    ] {
        let answer = server.raw(format!("{request}Connection: close\r\n\r\n").as_bytes()).await;
        assert_eq!(status(&answer), expected, "{request}: {answer}");
        assert!(expected == 200 || !answer.contains("trials done"), "{request}: {answer}");
    }
}

/// The list of databases accepts the token; a missing run is not a server error.
#[tokio::test(flavor = "multi_thread")]
async fn pages_with_a_token_steer_from_the_first_one_on() {
    let bench = Bench::new();
    let (store, _) = begun(&bench.path("run.sqlite")).await;
    store.close().await.unwrap();
    let (token, text) = Token::new().unwrap();
    let dbs = [bench.path("run.sqlite"), bench.path("none.sqlite"), bench.path("")];
    let server = Server::with(&dbs, Some(token)).await;
    for (path, panel) in [("/", false), ("/0/", true), ("/1/", true), ("/2/", false), ("/0/trials", false)] {
        let (status, page) = server.get(path).await;
        assert!(status == 200 && page.contains("control.js\""), "{path}: {page}");
        assert_eq!(page.contains("data-control"), panel, "{path}: {page}");
    }
    let port = server.port;
    let own = format!("Host: localhost:{port}\r\nOrigin: http://localhost:{port}\r\nConnection: close\r\n");
    for (path, expected, told) in [
        ("/0/control", 409, "is not used by a run"),
        ("/1/control", 409, "no database"),
        ("/2/control", 404, "folder of shards"),
        ("/3/control", 404, "no such database"),
    ] {
        let request = format!(
            "POST {path} HTTP/1.1\r\n{own}Authorization: Bearer {text}\r\nContent-Length: 5\r\n\r\nstate"
        );
        let answer = server.raw(request.as_bytes()).await;
        assert!(status(&answer) == expected && answer.contains(told), "{path}: {answer}");
    }
    server.served.close().await;
}

/// Names from a database are escaped everywhere.
#[tokio::test(flavor = "multi_thread")]
async fn hostile_names_stay_text() {
    let bench = Bench::new();
    let db = bench.path("run.sqlite");
    let (store, hashes) = begun(&db).await;
    store.close().await.unwrap();
    let evil =
        "\"''></script></title></textarea><script>alert(1)</script><img src=x onerror=alert(1)>".to_owned();
    let quoted = evil.replace('\'', "''");
    execute(
        &db,
        &format!(
            "UPDATE trial SET hash = 'x{quoted}', state = 'failed', reason = '{quoted}', layout = '{quoted}', protocol = '{quoted}',
               spec = json_set(spec, '$.brain.kind', '{quoted}', '$.evil', '{quoted}') WHERE hash = '{}';
             UPDATE trial SET spec = '{quoted}' WHERE hash = '{}';
             UPDATE sweep SET name = '{quoted}', text = '{quoted}';
             UPDATE attempt SET reason = '{quoted}', host = '{quoted}', code = '{quoted}', revision = '{quoted}', cpu = '{quoted}';
             UPDATE log SET text = '{quoted}', level = 'error'; UPDATE step SET outcome = '{quoted}';
             UPDATE artifact SET name = 'design_step_{quoted}', shape = '{quoted}'",
            hashes[0], hashes[1]
        ),
    )
    .await;
    let server = Server::new(&[db]).await;
    let mut paths: Vec<String> = PAGES.iter().map(|page| format!("/0/{page}")).collect();
    paths.push("/0/trial/x".into());
    paths.push(format!("/0/trial/{}", hashes[1]));
    paths.push(format!("/0/compare?a=x&b={}", hashes[1]));
    let encoded: String = evil.bytes().map(|byte| format!("%{byte:02X}")).collect();
    for page in [
        "trials?q=",
        "trials?sort=",
        "map?by=",
        "map?q=",
        "sql?q=",
        "compare?b=1&a=",
        "trial/",
        "trials?page=",
    ] {
        paths.push(format!("/0/{page}{encoded}"));
    }
    for path in paths {
        let (status, answer) = server.get(&path).await;
        assert!([200, 400, 404].contains(&status), "{path}: {answer}");
        assert!(!answer.contains("<script>") && !answer.contains("<img"), "{path}: {answer}");
    }
    let (_, page) = server.get("/0/trials").await;
    assert!(page.contains("&lt;script&gt;alert(1)"), "{page}");
    server.served.close().await;
}

/// Pages show values that no condition can contain without a link; the links of other values find their trials.
#[tokio::test(flavor = "multi_thread")]
async fn every_link_to_trials_finds_them() {
    let bench = Bench::new();
    let db = bench.path("run.sqlite");
    let plan = plan(&TINY.replace("[1, 2]", "[1]\nseeds = [1, 2, 3, 4]"));
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await.unwrap();
    store.close().await.unwrap();
    execute(
        &db,
        "UPDATE trial SET spec = json_set(spec, '$.channels', 'two words');
         UPDATE trial SET spec = json_set(spec, '$.channels', json('[[\"ax\",\"ay\"]]')) WHERE seed > 2",
    )
    .await;
    let server = Server::new(&[db]).await;
    // the first page may be shown before the trials have been read
    for _ in 0..100 {
        if server.get("/0/trials").await.1.contains("4 trials of 4") {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    for path in ["/0/trials", "/0/map?down=channels"] {
        let (_, page) = server.get(path).await;
        let links = page.split("href=\"").filter_map(|rest| rest.split('"').next()?.split_once("?q="));
        let links: Vec<&str> = links.map(|(_, q)| q).filter(|q| q.contains("channels")).collect();
        assert!(links.len() == 1 && page.contains("[[&quot;ax&quot;,&quot;ay&quot;]]"), "{links:?}: {page}");
        let (_, found) = server.get(&format!("/0/trials?q={}", links[0])).await;
        assert!(found.contains("2 trials of 4"), "{links:?}: {found}");
    }
    server.served.close().await;
}

/// Shards of a folder are one database, including shards handed in later.
#[tokio::test(flavor = "multi_thread")]
async fn a_folder_of_shards_is_one_database() {
    let bench = Bench::new();
    let folder = bench.path("tiny.shards");
    std::fs::create_dir(&folder).unwrap();
    let plan = plan(TINY);
    let hand_in = async |shard: usize| {
        let live = bench.path("live.sqlite");
        let mut store = Store::open(&live).await.unwrap();
        store.begin_sweep(&plan.spec, TINY, std::slice::from_ref(&plan.trials[shard])).await.unwrap();
        let hash = &plan.trials[shard].hash;
        store.begin_attempt(hash).await.unwrap();
        step(&mut store, hash, 0).await;
        store.close().await.unwrap();
        std::fs::rename(&live, folder.join(format!("shard-{}-of-2.1-x-1.sqlite", shard + 1))).unwrap();
    };
    hand_in(0).await;
    let server = Server::new(std::slice::from_ref(&folder)).await;
    // somebody watches
    let mut events = server.connect().await;
    events.write_all(format!("GET /0/events HTTP/1.1\r\n{HOST}\r\n").as_bytes()).await.unwrap();
    let shown = async |told: &str| {
        let begun = Instant::now();
        loop {
            let (_, page) = server.get("/0/").await;
            if page.contains(told) {
                return;
            }
            assert!(begun.elapsed() < Duration::from_secs(20), "{told} is not in {page}");
            let _ = tokio::time::timeout(Duration::from_secs(1), events.readable()).await;
        }
    };
    shown("0 of 1 trials done").await;
    hand_in(1).await;
    shown("0 of 2 trials done").await;
    for trial in &plan.trials {
        let (status, page) = server.get(&format!("/0/trial/{}", trial.hash)).await;
        assert!(status == 200 && page.contains("body after 1 step<"), "{page}");
    }
    server.served.close().await;
    let mut left: Vec<_> =
        std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["facts.db", "shard-1-of-2.1-x-1.sqlite", "shard-2-of-2.1-x-1.sqlite"]);
}

/// Requests of valid and invalid fragments: each is answered or closed without a server error, and pages still load afterwards.
/// Three hundred, or `SERVE_CASES`.
#[tokio::test(flavor = "multi_thread")]
async fn whatever_is_asked_the_server_stays() {
    const BITS: [&str; 46] = [
        "GET ",
        "HEAD ",
        "POST ",
        "get ",
        "/",
        "/0/",
        "/1/",
        "/0/trials",
        "/0/trial/",
        "/0/sql?q=",
        "/0/sql.csv?q=",
        "/0/map?by=",
        "/0/compare?a=",
        "/0/events",
        "/0/control",
        "?q=",
        "&sort=-",
        "&page=",
        "99999999999999999999",
        "K>=1",
        "%",
        "%00",
        "%ff",
        "%27",
        "..",
        "%2e%2e%2f",
        "/etc/passwd",
        "SELECT+*+FROM+v_step",
        "SELECT+",
        "WITH+RECURSIVE+c(n)+AS+(SELECT+1+UNION+ALL+SELECT+n%2B1+FROM+c)",
        "+count(*)+FROM+c",
        "ATTACH+'/etc/passwd'+AS+x",
        ";",
        " HTTP/1.1\r\n",
        " HTTP/9.9\r\n",
        "Host: localhost\r\n",
        "Host: evil\r\n",
        "Origin: null\r\n",
        "Authorization: Bearer 0\r\n",
        "Content-Length: 5\r\n",
        "Transfer-Encoding: chunked\r\n",
        "Connection: close\r\n",
        "\r\n\r\n",
        "\u{0}",
        "\u{1F980}",
        "-1",
    ];
    let bench = Bench::new();
    let (_store, hashes) = begun(&bench.path("run.sqlite")).await;
    let server = Arc::new(Server::new(&[bench.path("run.sqlite")]).await);
    let mut roll = Roll::new();
    let cases = number("SERVE_CASES").unwrap_or(300);
    let mut seen = std::collections::BTreeMap::<u16, u64>::new();
    for _ in 0..cases {
        let mut request = String::new();
        // half of them are valid except for their path
        let whole = roll.below(2) == 0;
        if whole {
            request += "GET ";
            request +=
                ["/0/trials?q=", "/0/sql?q=", "/0/trial/", "/0/map?q=", "/0/compare?a=", "/"][roll.place(6)];
        }
        for _ in 0..roll.below(8) {
            match roll.below(8) {
                0 => request.extend((0..roll.below(40)).map(|_| char::from(roll.below(256) as u8))),
                1 => request += &hashes[0],
                _ => request += BITS[roll.place(BITS.len())],
            }
        }
        if whole {
            request = request.replace(['\r', '\n', ' '], "") + " HTTP/1.1\r\n";
            request = request.replacen("GET", "GET ", 1) + HOST + "Connection: close\r\n";
        }
        request += "\r\n\r\n";
        let mut stream = server.connect().await;
        let _ = stream.write_all(request.as_bytes()).await;
        let _ = stream.shutdown().await;
        let mut answer = Vec::new();
        let mut buffer = [0; 16384];
        // event streams do not end by themselves
        let begun = Instant::now();
        loop {
            let read = tokio::time::timeout(Duration::from_secs(30), stream.read(&mut buffer)).await;
            let read = read.unwrap_or_else(|_| panic!("{request:?} is neither answered nor closed"));
            // a reset connection is also closed
            let read = read.unwrap_or(0);
            answer.extend_from_slice(&buffer[..read]);
            if read == 0 || String::from_utf8_lossy(&answer).contains("text/event-stream") {
                break;
            }
        }
        let answer = String::from_utf8_lossy(&answer);
        let code = status(&answer);
        *seen.entry(code).or_default() += 1;
        assert!(code < 500, "{request:?}: {answer}");
        assert!(!answer.contains("root:x:0"), "{request:?}: {answer}");
        assert!(begun.elapsed() < Duration::from_secs(30), "{request:?} took {:?}", begun.elapsed());
    }
    println!("{cases} requests by status: {seen:?}");
    let (status, page) = server.get("/0/").await;
    assert!(status == 200 && page.contains("trials done"), "{page}");
}

/// Clients that send their head byte by byte, or request and read nothing, block neither other clients nor the store.
#[tokio::test(flavor = "multi_thread")]
async fn slow_clients_hold_nothing() {
    let bench = Bench::new();
    let db = bench.path("run.sqlite");
    let (mut store, hashes) = begun(&db).await;
    let server = Server::new(&[db]).await;
    let mut slow = Vec::new();
    for i in 0..40 {
        let mut stream = server.connect().await;
        // a page of several MB that is never read, or half a head
        let big = "WITH+RECURSIVE+c(n)+AS+(SELECT+1+UNION+ALL+SELECT+n%2B1+FROM+c+WHERE+n<900)+SELECT+printf('%252000c','x')+FROM+c";
        let request = match i % 3 {
            0 => "GET /0/ HTTP/1.1\r\nHo".to_owned(),
            1 => format!("GET /0/events HTTP/1.1\r\n{HOST}\r\n"),
            _ => format!("GET /0/sql?q={big} HTTP/1.1\r\n{HOST}\r\n"),
        };
        stream.write_all(request.as_bytes()).await.unwrap();
        slow.push(stream);
    }
    for n in 1..20 {
        let begun = Instant::now();
        step(&mut store, &hashes[0], n).await;
        let recorded = begun.elapsed();
        let (status, page) = server.get("/0/").await;
        assert_eq!(status, 200, "{page}");
        assert!(recorded < Duration::from_secs(2), "{recorded:?}");
        assert!(begun.elapsed() < Duration::from_secs(8), "{:?}", begun.elapsed());
    }
}
