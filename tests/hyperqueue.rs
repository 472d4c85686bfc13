//! Shards on a real HyperQueue: a killed worker, a cancelled job, a second submission during the run; nothing is lost.
//!
//! Skipped if `hq` is not in PATH (one file, from its releases or `cargo build --bin hq`).

use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::common::skip;
use crate::common::{Bench, TINY, results};

/// A server with its folder and processes; dropping it ends them.
struct Site {
    bench: Bench,
    started: Vec<Child>,
}

impl Site {
    fn new() -> Option<Self> {
        let there = Command::new("hq").arg("--version").stdout(Stdio::null()).status();
        if !there.is_ok_and(|status| status.success()) {
            skip::skipped("shards on HyperQueue", "there is no hq in PATH");
            return None;
        }
        let bench = Bench::new();
        std::fs::create_dir(bench.path("tmp")).unwrap();
        let mut site = Self { bench, started: Vec::new() };
        site.start(&["server", "start"]);
        site.until("the server answers", || site.hq("job list").status.success());
        Some(site)
    }

    fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.current_dir(self.bench.path(""));
        command.env("HQ_SERVER_DIR", self.bench.path("server")).env("TMPDIR", self.bench.path("tmp"));
        command
    }

    fn start(&mut self, arguments: &[&str]) {
        let log = std::fs::File::create(self.bench.path(&format!("hq-{}.log", self.started.len()))).unwrap();
        let mut command = self.command("hq");
        command.args(arguments).stdin(Stdio::null()).stdout(log.try_clone().unwrap()).stderr(log);
        self.started.push(command.spawn().unwrap());
    }

    fn worker(&mut self) {
        self.start(&["worker", "start", "--cpus", "2", "--heartbeat", "1s"]);
    }

    fn hq(&self, arguments: &str) -> Output {
        self.command("hq").args(arguments.split(' ')).output().unwrap()
    }

    /// Output of a call that must end with exit code 0.
    fn says(&self, arguments: &str) -> String {
        let output =
            self.command(env!("CARGO_BIN_EXE_metasense")).args(arguments.split(' ')).output().unwrap();
        let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        assert_eq!(output.status.code(), Some(0), "{arguments}: {said}");
        said
    }

    fn until(&self, what: &str, mut ask: impl FnMut() -> bool) {
        let began = Instant::now();
        while !ask() {
            let jobs = || String::from_utf8_lossy(&self.hq("job list --all").stdout).into_owned();
            let logs = || (1..=2).map(|i| self.log(i)).collect::<String>();
            assert!(
                began.elapsed() < Duration::from_secs(90),
                "not within 90 s: {what}\n{}{}",
                jobs(),
                logs()
            );
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Number of starts of shards in their logs.
    fn begun(&self) -> usize {
        (1..=2).map(|i| self.log(i).matches("worker started").count()).sum()
    }

    fn log(&self, shard: u32) -> String {
        let log = self.bench.path(&format!("results/tiny.shards/shard-{shard}-of-2.log"));
        std::fs::read_to_string(log).unwrap_or_default()
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        let _ = self.hq("server stop");
        for child in &mut self.started {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

#[test]
fn shards_survive_their_worker_and_are_not_submitted_twice() {
    let Some(mut site) = Site::new() else { return };
    // Several seconds per shard.
    let text = TINY.replace("iterations = 4\n", "iterations = 300\n") + "seeds = [1, 2]\n";
    site.bench.file("tiny.toml", &text);
    site.says("run tiny.toml --db whole.sqlite");
    let submitted = site.says("cluster submit hq tiny.toml --shards 2 --cpus 1 --time 10");
    assert_eq!(submitted.matches("submitted: job").count(), 1, "{submitted}");

    // Neither waiting for a worker nor running shards are submitted again.
    for state in ["waiting", "running"] {
        let again = site.says("cluster submit hq tiny.toml --cpus 1 --time 10");
        assert!(
            again.contains("running or queued: shards 1-2") && again.contains("nothing to submit"),
            "{again}"
        );
        let status = site.says("status --folder");
        assert!(status.contains(state) && status.contains("2 in the queue"), "{status}");
        if state == "waiting" {
            site.worker();
            site.until("both shards run", || site.begun() == 2);
        }
    }

    // The worker dies; its shards are queued again, and another worker runs them.
    let mut worker = site.started.pop().unwrap();
    worker.kill().unwrap();
    worker.wait().unwrap();
    site.worker();
    site.until("both shards run again", || site.begun() == 4);

    // A cancelled job has handed in its results or left them on the node; the next job resumes.
    site.until("the job is cancelled", || site.hq("job cancel 1").status.success());
    site.until("the queue is empty", || site.says("status --folder").contains("0 in the queue"));
    site.says(
        "cluster submit hq tiny.toml --cpus 1 --time 10 --prefix env --run=--copy-every=1 -- --max-fails 1",
    );
    site.until("all is complete", || site.says("status --folder").contains("2 of 2 shards complete"));
    let merged = || site.bench.metasense(&["run", "tiny.toml", "--db", "results/tiny.sqlite"]);
    site.until("the merge is done", || site.hq("job wait all").status.success());
    assert!(String::from_utf8_lossy(&merged().stderr).contains("nothing left to do"));
    assert_eq!(results(&site.bench, "results/tiny.sqlite"), results(&site.bench, "whole.sqlite"));
    assert!(site.says("cluster submit hq tiny.toml").contains("nothing left to do"));
}

/// A search with rounds of jobs ends like one run; it waits for the queue.
#[test]
fn a_search_in_jobs_is_the_search() {
    let Some(mut site) = Site::new() else { return };
    site.bench.file("tiny.toml", &(TINY.replace("[1, 2]", "[1]") + "placements = 2\n[goal]\nerror = 1e6\n"));
    site.says("design tiny.toml --db whole.sqlite");
    site.worker();
    let said = site.says("cluster submit hq tiny.toml --goal --shards 2 --cpus 1 --time 5");
    assert!(
        said.contains("submitted: job") && said.contains("the cheapest design that meets 1e6 %"),
        "{said}"
    );
    assert_eq!(results(&site.bench, "results/tiny.sqlite"), results(&site.bench, "whole.sqlite"));
    let again = site.says("cluster submit hq tiny.toml --goal");
    assert!(!again.contains("submitted: job") && again.contains("the cheapest design"), "{again}");
}
