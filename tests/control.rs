//! Control of a run from another terminal and from its pages, with real processes: commands take effect, are reported, and change
//! no result; requests without permission change nothing.

use std::fs::File;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Output};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use crate::common::roll::{Roll, number};
use crate::common::{Bench, TINY, results};
use metasense::plan::Plan;
use metasense::processes::children;
use rustix::process::{Pid, Signal, kill_process};

/// Specs of six and of eight trials.
fn specs() -> [String; 2] {
    let long = TINY.replace("iterations = 4\n", "iterations = 240\n");
    ["[1, 2, 3]", "[1, 2, 3, 4]"].map(|seeds| long.replace("[1, 2]", &format!("[1, 2]\nseeds = {seeds}")))
}

/// A run in a folder; dropping it kills the process.
struct Run<'a> {
    bench: &'a Bench,
    child: Child,
}

impl<'a> Run<'a> {
    fn start(bench: &'a Bench, arguments: &[&str]) -> Self {
        let file = |name| File::create(bench.path(name)).unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_metasense"))
            .args(["run", "s.toml", "--db", "s.sqlite"])
            .args(arguments)
            .current_dir(bench.path(""))
            .stdout(file("said.csv"))
            .stderr(file("told"))
            .spawn()
            .unwrap();
        Self { bench, child }
    }

    /// Waits until the run accepts commands and its workers are busy.
    fn busy(&self, workers: &str) {
        self.until(|| self.asks(&["state"]).1.contains(workers));
    }

    fn until(&self, mut holds: impl FnMut() -> bool) {
        let began = Instant::now();
        while !holds() {
            assert!(began.elapsed() < Duration::from_secs(60), "{}", self.told());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Its output on standard error.
    fn told(&self) -> String {
        std::fs::read_to_string(self.bench.path("told")).unwrap()
    }

    fn control(&self, words: &[&str]) -> Output {
        self.bench.metasense(&[&["control", "s.sqlite"], words].concat())
    }

    /// Exit code and output of a command.
    fn asks(&self, words: &[&str]) -> (Option<i32>, String) {
        let output = self.control(words);
        let said = [output.stdout, output.stderr].concat();
        (output.status.code(), String::from_utf8(said).unwrap())
    }

    fn asked(&self, words: &[&str], code: i32, expected: &str) {
        let (found, said) = self.asks(words);
        assert!(found == Some(code) && said.contains(expected), "{words:?}: {found:?}: {said}");
    }

    fn count(&self, sql: &str) -> String {
        let sql = format!("SELECT {sql}");
        self.bench.output(&["query", "s.sqlite", &sql, "--format", "csv"]).lines().nth(1).unwrap().to_owned()
    }

    /// Waits for the end; returns the exit code.
    fn wait(&mut self) -> Option<i32> {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            assert!(began.elapsed() < Duration::from_secs(120), "{}", self.told());
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Run<'_> {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A folder with the first spec.
fn bench() -> Bench {
    let bench = Bench::new();
    bench.file("s.toml", &specs()[0]);
    bench
}

/// The same with trials that outlast every test.
fn endless() -> Bench {
    let bench = Bench::new();
    bench.file("s.toml", &specs()[0].replace("iterations = 120", "iterations = 10000"));
    bench
}

/// Results of the second spec without any command.
fn whole() -> &'static [String] {
    static WHOLE: OnceLock<Vec<String>> = OnceLock::new();
    WHOLE.get_or_init(|| {
        let bench = Bench::new();
        bench.file("s.toml", &specs()[1]);
        bench.output(&["run", "s.toml", "--db", "whole.sqlite"]);
        results(&bench, "whole.sqlite")
    })
}

/// Each command once, most of them during a pause; a refused command changes nothing. The results equal those without commands.
#[test]
fn a_run_does_what_it_is_asked_and_comes_to_the_same_results() {
    let bench = bench();
    let hashes: Vec<String> =
        Plan::new("s.toml", specs()[0].clone()).unwrap().trials.into_iter().map(|trial| trial.hash).collect();
    let mut run = Run::start(&bench, &["--workers", "1", "--format", "csv"]);
    run.busy("running: 1 of 1 worker busy");
    run.until(|| bench.number("s.sqlite", "SELECT count(*) FROM v_step") > 0);

    run.asked(&["pause"], 0, "paused: 1 running trial stops");
    run.until(|| run.asks(&["state"]).1.contains("paused: 0 of 1 worker busy"));
    run.until(|| run.count("count(*) FROM v_attempt WHERE state = 'running'") == "0");
    let steps = run.count("count(*) FROM v_step");
    run.asked(&["cancel", &hashes[0]], 0, "cancelled\n");
    run.asked(&["cancel", &hashes[1][..12]], 0, "cancelled\n");
    run.asked(&["next", &hashes[5]], 0, "starts on the next free worker");
    run.asked(&["workers", "2"], 0, "workers: 1 before, 2 from now on");

    run.asked(&["cancel", &hashes[0]], 1, "refused: the trial has already ended (cancelled)");
    run.asked(&["next", "no-such"], 1, "refused: trial no-such: no hash begins with this text");
    run.asked(&["workers", "0"], 2, "0 is not in");
    run.asked(&["cancel", "a b"], 2, "unknown command");
    run.asked(&["dance"], 2, "unrecognized subcommand");
    bench.file("s.toml", &specs()[0].replace("samples = 8", "samples = -8"));
    run.asked(&["reload"], 1, "refused: s.toml");
    bench.file("s.toml", &specs()[0].replace("\"tiny\"", "\"other\""));
    run.asked(&["reload"], 1, "name = \"other\"");
    std::fs::remove_file(bench.path("s.toml")).unwrap();
    assert!(Command::new("mkfifo").arg(bench.path("s.toml")).status().unwrap().success());
    run.asked(&["reload"], 1, "refused: s.toml is not a regular file");
    std::fs::remove_file(bench.path("s.toml")).unwrap();
    bench.file("s.toml", &specs()[1].replace("seeds = [1, ", "seeds = ["));
    run.asked(&["reload"], 0, "trials added: 2; no longer in the spec, but still run: 2\n");
    bench.file("s.toml", &specs()[1]);
    run.asked(&["reload"], 0, "trials added: 0\n");
    assert_eq!(run.count("count(*) FROM v_step"), steps, "nothing has gone on");

    run.asked(&["resume"], 0, "resumed; pending trials: 6\n");
    assert_eq!(run.wait(), Some(0), "{}", run.told());
    run.asked(&["state"], 2, "s.sqlite is not used by a run");
    assert!(!bench.path("s.sqlite.control").exists());

    let table = std::fs::read_to_string(bench.path("said.csv")).unwrap();
    assert_eq!(table.lines().filter(|line| line.contains(",done,")).count(), 6, "{table}");
    let order = "group_concat(hash, ' ') FROM (SELECT hash FROM v_attempt WHERE reason IS NOT 'cancelled' ORDER BY started_at, attempt LIMIT 2)";
    assert_eq!(run.count(order), format!("{} {}", hashes[0], hashes[5]));
    let cancelled = "count(*), sum(reason = 'cancelled'), sum(attempts), (SELECT count(*) FROM checkpoint) FROM v_trial WHERE state = 'failed'";
    // its own attempt, by which a merge recognises the later copy
    assert_eq!(run.count(cancelled), "2,2,3,1");
    let log = std::fs::read_to_string(bench.path("s.log")).unwrap();
    for word in ["pause", "resume", "workers 2", "reload", &format!("next {}", hashes[5])] {
        assert!(log.contains(&format!("command={word} done=true")), "{word}: {log}");
        assert!(run.told().contains(&format!("control: {word}: ")), "{word}: {}", run.told());
    }

    let again = bench.metasense(&["run", "s.toml", "--db", "s.sqlite"]);
    let said = String::from_utf8_lossy(&again.stderr);
    assert_eq!(again.status.code(), Some(0), "{said}");
    assert!(said.contains("nothing left to do") && said.contains("2 trials cancelled on request"), "{said}");
    bench.output(&["run", "s.toml", "--db", "s.sqlite", "--retry-failed"]);
    assert_eq!(results(&bench, "s.sqlite"), whole());
}

/// A running trial is cancelled, a run is stopped, and a run is killed: its socket does not block the next run.
#[test]
fn what_runs_is_taken_back_and_what_is_killed_leaves_nothing_in_the_way() {
    let bench = endless();
    let mut run = Run::start(&bench, &["--workers", "2"]);
    run.busy("2 of 2 workers busy");
    let running = "hash FROM v_attempt WHERE state = 'running' ORDER BY hash LIMIT 1";
    // the scheduler has this state before the database
    run.until(|| run.bench.metasense(&["query", "s.sqlite", "SELECT 1"]).status.success());
    run.until(|| run.count("count(*) FROM v_attempt WHERE state = 'running'") == "2");
    let hash = run.count(running);
    run.asked(&["next", &hash], 1, "refused: the trial is already running");
    run.asked(&["workers", "1"], 0, "workers: 2 before, 1 from now on");
    run.asked(&["cancel", &hash], 0, "it ends after its step in progress");
    let ended =
        format!("count(*) FROM v_trial WHERE hash = '{hash}' AND state = 'failed' AND reason = 'cancelled'");
    run.until(|| run.count(&ended) == "1");
    run.busy("1 of 1 worker busy");
    run.asked(&["stop"], 0, "stopping: 1 running trial stops");
    assert_eq!(run.wait(), Some(4), "{}", run.told());
    let others = "count(*) FROM v_attempt WHERE state = 'failed' AND reason NOT IN ('stopped', 'cancelled')";
    assert_eq!(run.count(others), "0", "something else has ended an attempt");

    let bench = self::bench();
    bench.file("s.toml", &specs()[1]);
    let mut run = Run::start(&bench, &[]);
    run.busy("busy");
    run.child.kill().unwrap();
    run.child.wait().unwrap();
    assert!(bench.path("s.sqlite.control").exists());
    run.asked(&["pause"], 2, "s.sqlite is not used by a run");
    bench.output(&["run", "s.toml", "--db", "s.sqlite"]);
    assert!(!bench.path("s.sqlite.control").exists());
    assert_eq!(results(&bench, "s.sqlite"), whole());
    let nowhere = bench.metasense(&["control", "none.sqlite", "pause"]);
    assert_eq!(nowhere.status.code(), Some(2));
}

/// With [until] or an assignment, a reloaded spec adds no trials. Workers and pauses persist from round to round.
#[test]
fn questions_and_shards_decide_themselves_what_is_run() {
    let bench = Bench::new();
    let [first, _] = specs();
    let asks = first.replace("seeds = [1, 2, 3]", "");
    bench.file("s.toml", &(asks + "\n[until]\nat_most = { placements = 6 }\npaired = 1e-9\n"));
    let mut run = Run::start(&bench, &["--workers", "1"]);
    run.busy("1 of 1 worker busy");
    run.asked(&["reload"], 1, "refused: [until] decides which trials are run");
    run.asked(&["workers", "2"], 0, "workers: 1 before, 2 from now on");
    // this round has only trials to cancel
    run.asked(&["pause"], 0, "paused");
    run.until(|| run.asks(&["state"]).1.contains("paused: 0 of 2"));
    run.until(|| run.count("count(*) FROM v_trial WHERE state = 'running'") == "0");
    let waiting = [
        "query",
        "s.sqlite",
        "SELECT hash FROM v_trial WHERE state = 'pending' AND placement < 4",
        "--format",
        "csv",
    ];
    for hash in bench.output(&waiting).lines().skip(1) {
        run.asked(&["cancel", hash], 0, "cancelled");
    }
    run.until(|| run.count("count(*) FROM v_run") == "2");
    run.until(|| run.asks(&["state"]).1.starts_with("paused: 0 of 2 workers busy, 0 of 2 trials finished"));
    run.asked(&["resume"], 0, "resumed");
    assert_eq!(run.wait(), Some(0), "{}", run.told());
    assert_eq!(
        run.count("group_concat(workers, ' ') FROM (SELECT workers FROM v_run ORDER BY started_at)"),
        "1 2 2"
    );

    bench.file("s.toml", &first);
    std::fs::remove_file(bench.path("s.sqlite")).unwrap();
    let mut run = Run::start(&bench, &["--workers", "1", "--shard", "1/2"]);
    run.busy("1 of 1 worker busy");
    run.asked(&["reload"], 1, "refused: the trials of a shard are assigned before it starts");
    run.asked(&["stop"], 0, "stopping");
    assert_eq!(run.wait(), Some(4), "{}", run.told());
}

/// Forty commands (`COMMANDS=N` for more, `KILL_SEED=N` to repeat) at random moments, including kills of workers, in as many runs
/// as needed; then cancelled trials resume.
#[test]
fn a_run_that_is_steered_at_random_comes_to_the_same_results() {
    let bench = bench();
    bench.file("s.toml", &specs()[1]);
    let plan = Plan::new("s.toml", specs()[1].clone()).unwrap();
    let (mut roll, most) = (Roll::new(), number("COMMANDS").unwrap_or(40));
    let mut commands = 0;
    while commands < most {
        let mut run = Run::start(&bench, &["--workers", "2", "--retry-failed"]);
        run.until(|| run.asks(&["state"]).0 == Some(0) || run.told().contains("database: "));
        while commands < most && run.child.try_wait().unwrap().is_none() {
            let hash = &plan.trials[roll.place(plan.trials.len())].hash;
            let workers = (1 + roll.below(4)).to_string();
            let command = match roll.below(12) {
                0..2 => vec!["pause"],
                2..5 => vec!["resume"],
                5..7 => vec!["cancel", hash],
                7..9 => vec!["next", hash],
                9..11 => vec!["workers", &workers],
                _ => vec!["reload"],
            };
            let (code, said) = run.asks(&command);
            // the run may end during the last command
            let late = ["is not used by a run", "takes no commands", "without a reply"]
                .iter()
                .any(|why| said.contains(why));
            assert!(matches!(code, Some(0 | 1)) || late, "{command:?}: {said}");
            commands += 1;
            let workers = children(run.child.id());
            if roll.below(4) == 0 && !workers.is_empty() {
                let pid = workers[roll.place(workers.len())];
                let _ = kill_process(Pid::from_raw(pid as i32).unwrap(), Signal::KILL);
            }
            std::thread::sleep(Duration::from_millis(roll.below(250)));
        }
        let _ = run.asks(&["resume"]);
        let ended = run.wait();
        assert!(matches!(ended, Some(0 | 1)), "{ended:?}: {}", run.told());
        let lost = "count(*) FROM v_trial WHERE state NOT IN ('done', 'failed')";
        assert_eq!(run.count(lost), "0", "{}", run.told());
        if run.count("count(*) FROM v_trial WHERE state = 'failed'") == "0" {
            break;
        }
    }
    println!("{commands} commands");
    bench.output(&["run", "s.toml", "--db", "s.sqlite", "--retry-failed"]);
    assert_eq!(results(&bench, "s.sqlite"), whole());
}

/// Pauses and resumes without a break while six workers receive trials that an earlier run started: a stop overtakes jobs whose
/// checkpoints are still being read. The workers survive, and every attempt ends by request.
#[test]
fn a_stop_that_overtakes_its_job_ends_no_worker() {
    let bench = endless();
    let mut run = Run::start(&bench, &["--workers", "6"]);
    run.busy("6 of 6 workers busy");
    run.until(|| run.count("count(*) FROM checkpoint") == "6");
    run.asked(&["stop"], 0, "stopping");
    assert_eq!(run.wait(), Some(4), "{}", run.told());
    std::fs::remove_file(bench.path("s.log")).unwrap();

    let mut run = Run::start(&bench, &["--workers", "6"]);
    run.until(|| bench.path("s.sqlite.control").exists());
    // until some trials have returned, and a little longer
    let back = || run.count("count(*) FROM v_attempt WHERE state = 'failed'").parse::<usize>().unwrap() > 6;
    let (mut commands, mut more) = (0, 3);
    while more > 0 {
        more -= u32::from(commands % 200 == 0 && back());
        for command in ["pause\n", "resume\n"] {
            let mut asked = UnixStream::connect(bench.path("s.sqlite.control")).unwrap();
            let mut said = String::new();
            asked.write_all(command.as_bytes()).and_then(|()| asked.read_to_string(&mut said)).unwrap();
            assert!(said.starts_with("done "), "{said}");
            commands += 1;
        }
    }
    run.asked(&["stop"], 0, "stopping");
    assert_eq!(run.wait(), Some(4), "{}", run.told());
    let stops = "count(*) > 6, sum(reason <> 'stopped') FROM v_attempt WHERE state = 'failed'";
    assert_eq!(run.count(stops), "1,0", "after {commands} commands");
    let log = std::fs::read_to_string(bench.path("s.log")).unwrap();
    let started = log.matches("worker started").count();
    assert!(started <= 6, "{started} workers for 6 trials: {log}");
}

/// The response to a raw request.
fn post(port: u16, head: &str, body: &str) -> (u16, String) {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let length = body.len();
    let request = format!("{head}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}");
    let _ = stream.write_all(request.as_bytes());
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    (answer.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or(0), answer)
}

/// Port, key and token of a run's pages.
fn pages(run: &Run) -> (u16, String, String) {
    run.until(|| run.told().contains("#token="));
    let told = run.told();
    let address = told.split("http://127.0.0.1:").nth(1).unwrap().lines().next().unwrap();
    let (port, secrets) = address.split_once("/?key=").unwrap();
    let (key, token) = secrets.split_once("#token=").unwrap();
    (port.parse().unwrap(), key.to_owned(), token.to_owned())
}

/// Only pages with the token control a run, and only from their own origin. They end with the run and leave no files.
#[test]
fn pages_of_a_run_steer_it_and_nobody_else_does() {
    let bench = bench();
    bench.file("s.toml", &specs()[1]);
    let mut run = Run::start(&bench, &["--workers", "1", "--serve=0"]);
    run.busy("1 of 1 worker busy");
    let (port, key, token) = pages(&run);
    assert_eq!(token.len(), 32, "{token}");

    let (status, page) =
        post(port, &format!("GET /0/ HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {key}\r\n"), "");
    assert!(status == 200 && page.contains("data-control=\"control\""), "{page}");
    let host = format!("Host: 127.0.0.1:{port}\r\n");
    let own = format!("{host}Origin: http://127.0.0.1:{port}\r\n");
    let bearer = format!("Authorization: Bearer {token}\r\n");
    let line = "POST /0/control HTTP/1.1\r\n";
    let reversed: String = token.chars().rev().collect();
    for (head, body, expected) in [
        (format!("{line}{own}"), "stop", 401),
        (format!("{line}{own}Authorization: Bearer {key}\r\n"), "stop", 401),
        (format!("{line}{own}Authorization: Bearer \r\n"), "stop", 401),
        (format!("{line}{own}Authorization: Bearer {}\r\n", &token[1..]), "stop", 401),
        (format!("{line}{own}Authorization: Bearer {reversed}\r\n"), "stop", 401),
        (format!("{line}{own}Authorization: Basic {token}\r\n"), "stop", 401),
        (format!("{line}{own}Cookie: metasense-token={token}\r\n"), "stop", 401),
        (format!("POST /0/control?token={token} HTTP/1.1\r\n{own}"), "stop", 401),
        (format!("{line}{host}{bearer}"), "stop", 403),
        (format!("{line}{host}Origin: null\r\n{bearer}"), "stop", 403),
        (format!("{line}{host}Origin: http://evil.example\r\n{bearer}"), "stop", 403),
        (format!("{line}{host}Origin: http://127.0.0.1:1\r\n{bearer}"), "stop", 403),
        (format!("{line}{own}Origin: http://evil.example\r\n{bearer}"), "stop", 403),
        (format!("{line}Host: evil.example\r\nOrigin: http://evil.example\r\n{bearer}"), "stop", 421),
        (format!("OPTIONS /0/control HTTP/1.1\r\n{host}Origin: http://evil.example\r\n"), "", 405),
        (format!("PUT /0/control HTTP/1.1\r\n{own}{bearer}"), "stop", 405),
        (format!("GET /0/control HTTP/1.1\r\n{own}{bearer}"), "stop", 405),
        (format!("POST /0/ HTTP/1.1\r\n{own}{bearer}"), "stop", 405),
        (format!("POST /0/trials/control HTTP/1.1\r\n{own}{bearer}"), "stop", 404),
        (format!("POST /7/control HTTP/1.1\r\n{own}{bearer}"), "stop", 404),
        (format!("{line}{own}{bearer}"), "stop it", 400),
        (format!("{line}{own}{bearer}"), "pause\nstop", 400),
        (format!("{line}{own}{bearer}"), "", 400),
        (format!("{line}{own}{bearer}"), "cancel ../../etc/passwd", 400),
        (format!("{line}{own}{bearer}"), "cancel no-such", 409),
        (format!("{line}{own}{bearer}"), &"x".repeat(2000), 413),
    ] {
        let (status, answer) = post(port, &head, body);
        assert_eq!(status, expected, "{head}{body}: {answer}");
    }
    run.asked(&["state"], 0, "running: 1 of 1 worker busy");
    let log = std::fs::read_to_string(bench.path("s.log")).unwrap();
    assert!(!log.contains("done=true") && !log.contains(&token), "{log}");

    // an unfinished request blocks nobody
    let mut slow = TcpStream::connect(("127.0.0.1", port)).unwrap();
    slow.write_all(format!("{line}{own}{bearer}Content-Length: 9\r\n\r\np").as_bytes()).unwrap();
    let steer = |body: &str| post(port, &format!("{line}{own}{bearer}"), body);
    let (status, answer) = steer("pause");
    assert!(status == 200 && answer.ends_with("paused: 1 running trial stops after its step in progress"));
    run.until(|| run.asks(&["state"]).1.contains("paused: 0 of 1"));
    assert_eq!(steer("resume").0, 200);
    run.asked(&["state"], 0, "running");
    assert_eq!(run.wait(), Some(0), "{}", run.told());
    assert!(TcpStream::connect(("127.0.0.1", port)).is_err(), "pages outlive their run");
    let mut left: Vec<_> =
        std::fs::read_dir(bench.path("")).unwrap().map(|e| e.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["s.log", "s.sqlite", "s.toml", "said.csv", "told"]);
    assert_eq!(results(&bench, "s.sqlite"), whole());

    // an occupied port
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let at = format!("--serve={}", taken.local_addr().unwrap().port());
    let refused = bench.metasense(&["run", "s.toml", "--db", "t.sqlite", &at]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("--serve=0 for any free port"), "{said}");
    let port = taken.local_addr().unwrap().port().to_string();
    let refused = bench.metasense(&["serve", "s.sqlite", "--listen", &port]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("or 0 for any free port"), "{said}");
    // the pages end with a killed run
    bench.file("s.toml", &specs()[0].replace("[1, 2, 3]", "[7, 8, 9]"));
    let mut run = Run::start(&bench, &["--serve=0"]);
    let (port, ..) = pages(&run);
    run.child.kill().unwrap();
    run.child.wait().unwrap();
    run.until(|| TcpStream::connect(("127.0.0.1", port)).is_err());
}
