//! Shards on a real Slurm that the test starts: killed, drained, requeued, cut off; nothing is lost.
//!
//! Skipped without Slurm (Debian: slurm-wlm and munge) or root.

use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::Duration;

use crate::common::skip;
use crate::common::slurm::{Slurm, missing};

/// Trials of half a second (4 outer steps) to several seconds.
fn spec(name: &str, steps: u32, seeds: &str) -> String {
    format!(
        "name = \"{name}\"\n\
         [body]\ncolumns = 4\nrows = 4\nspacing = 15.0\nligament_length = 2.25\ndensity = 1e-8\n\
         stiffness = {{ stretch = 3.0, shear = 0.5, bend = 1.0 }}\n\
         [time]\nduration = 0.2\nsamples = 20\n\
         [stimuli]\nkind = \"bell\"\nsamples = 8\ntest = 2\nholdout = 2\nwidth = [0.05, 0.1]\nonset = [0.0, 0.1]\n\
         [solver]\ntolerance = 1e-3\n\
         [brain]\niterations = 10\nwidth = 16\n\
         [optimise]\niterations = {steps}\nbatch = 4\n\
         [sweep]\npanels = [2]\nsensors = [1]\nseeds = {seeds}\n"
    )
}

/// A user's folder, shared by all nodes, and the cluster.
struct Site {
    slurm: Slurm,
    home: PathBuf,
    _folder: tempfile::TempDir,
}

impl Site {
    fn new(test: &str) -> Option<Self> {
        if let Some(why) = missing() {
            skip::skipped(test, &why);
            return None;
        }
        let folder = tempfile::Builder::new().prefix("sl").tempdir_in("/tmp").unwrap();
        let home = folder.path().join("home");
        std::fs::create_dir(&home).unwrap();
        Some(Self { slurm: Slurm::start(folder.path()), home, _folder: folder })
    }

    fn call(&self, arguments: &str) -> Output {
        let mut command = self.slurm.command(env!("CARGO_BIN_EXE_metasense"));
        command.args(arguments.split_whitespace()).current_dir(&self.home).output().unwrap()
    }

    /// Output of a call that must end with this exit code.
    fn says(&self, code: i32, arguments: &str) -> String {
        let output = self.call(arguments);
        let said =
            format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert_eq!(output.status.code(), Some(code), "{arguments}: {said}");
        said
    }

    fn rows(&self, db: &str, sql: &str) -> String {
        let mut command = self.slurm.command(env!("CARGO_BIN_EXE_metasense"));
        let output =
            command.args(["query", db, sql, "--format", "csv"]).current_dir(&self.home).output().unwrap();
        String::from_utf8_lossy(&output.stdout).lines().skip(1).collect::<Vec<_>>().join("\n")
    }

    fn results(&self, db: &str) -> String {
        let trials =
            "SELECT hash, state, error_initial, error_optimised, best_step FROM v_trial ORDER BY hash";
        let steps = "SELECT hash, step, loss_test, gradient_norm FROM v_step ORDER BY hash, step";
        format!("{}\n{}", self.rows(db, trials), self.rows(db, steps))
    }

    /// The latest database that a shard handed in.
    fn handed_in(&self, name: &str, shard: u32) -> Option<String> {
        let folder = format!("results/{name}.shards");
        let files = std::fs::read_dir(self.home.join(&folder)).ok()?.flatten();
        let names = files.map(|file| file.file_name().into_string().unwrap());
        let mine = |n: &String| n.starts_with(&format!("shard-{shard}-of-")) && n.ends_with(".sqlite");
        names.filter(mine).max().map(|name| format!("{folder}/{name}"))
    }

    fn read(&self, file: &str) -> String {
        std::fs::read_to_string(self.home.join(file)).unwrap_or_default()
    }

    /// Waits for the start of a shard's `nth` run in its log.
    fn until_running(&self, log: &str, nth: usize) {
        self.slurm.until("a shard runs", 60, || self.read(log).matches("worker started").count() >= nth);
    }
}

/// Process id of the run with this folder.
fn shard_process(folder: &Path) -> Option<i32> {
    let folder = folder.to_string_lossy().into_owned();
    std::fs::read_dir("/proc").unwrap().flatten().find_map(|entry| {
        let pid: i32 = entry.file_name().to_str()?.parse().ok()?;
        let command = std::fs::read_to_string(entry.path().join("cmdline")).ok()?;
        (command.contains("--folder") && command.contains(&folder)).then_some(pid)
    })
}

/// Two shards one after the other, because one node is drained; a merge before the last; the merge that Slurm starts.
#[test]
fn a_sweep_in_shards_is_the_sweep() {
    let Some(site) = Site::new("a_sweep_in_shards_is_the_sweep") else { return };
    std::fs::write(site.home.join("tiny.toml"), spec("tiny", 4, "[1, 2, 3, 4]")).unwrap();
    site.says(0, "run tiny.toml --db whole.sqlite");
    site.slurm.tool("scontrol", "update nodename=n2 state=drain reason=test");
    let said =
        site.says(0, "cluster submit slurm tiny.toml --shards 2 --cpus 1 --time 5 -- --partition=main");
    assert!(said.contains("4 trials in 2 shards") && said.contains("submitted: job"), "{said}");
    site.slurm.until("the first shard is handed in", 60, || site.handed_in("tiny", 1).is_some());
    let early = site.says(0, "cluster merge results/tiny.shards --out early.sqlite");
    assert!(early.contains("1 of its 2 shards have no database: 2"), "{early}");
    site.slurm.tool("scontrol", "update nodename=n2 state=resume");
    site.slurm.until_empty(90);
    assert_eq!(
        site.results("results/tiny.sqlite"),
        site.results("whole.sqlite"),
        "{}",
        site.read("results/tiny.shards/merge.out")
    );
    let status = site.says(0, "status --folder");
    assert!(status.contains("2 of 2 shards complete, 0 in the queue"), "{status}");
    assert!(site.says(0, "cluster submit slurm tiny.toml").contains("nothing left to do"));
    let jobs = "SELECT count(*) FROM v_run WHERE job LIKE 'slurm %\\__' ESCAPE '\\' AND outcome = 'complete'";
    assert_eq!(site.rows("results/tiny.sqlite", jobs), "2");
    assert_eq!(site.slurm.tool("ls", &site.home.parent().unwrap().join("tmp").display().to_string()), "");
}

/// A search with rounds of jobs ends like one run; it waits for the queue.
#[test]
fn a_search_in_jobs_is_the_search() {
    let Some(site) = Site::new("a_search_in_jobs_is_the_search") else { return };
    let text = spec("tiny", 24, "[1]") + "placements = 2\n[goal]\nerror = 1e6\n";
    std::fs::write(site.home.join("tiny.toml"), text).unwrap();
    site.says(0, "design tiny.toml --db whole.sqlite");
    let said = site
        .says(0, "cluster submit slurm tiny.toml --goal --shards 2 --cpus 1 --time 5 -- --partition=main");
    assert!(
        said.contains("submitted: job") && said.contains("the cheapest design that meets 1e6 %"),
        "{said}"
    );
    assert_eq!(site.results("results/tiny.sqlite"), site.results("whole.sqlite"));
    let again = site.says(0, "cluster submit slurm tiny.toml --goal");
    assert!(!again.contains("submitted: job") && again.contains("the cheapest design"), "{again}");
}

/// More shards than an array may have, one at a time per array; options of shards do not apply to the merge.
#[test]
fn arrays_are_cut_and_throttled() {
    let Some(site) = Site::new("arrays_are_cut_and_throttled") else { return };
    std::fs::write(site.home.join("tiny.toml"), spec("tiny", 4, "[1, 2, 3, 4]")).unwrap();
    site.says(0, "run tiny.toml --db whole.sqlite --simd baseline");
    let options =
        "--at-most 1 --prefix env --run=--simd=baseline -- --mem=100M -- --mem=50M --comment=behind";
    let said =
        site.says(0, &format!("cluster submit slurm tiny.toml --shards 4 --cpus 1 --time 5 {options}"));
    assert!(said.contains("shards 1-2") && said.contains("shards 3-4"), "{said}");
    let jobs = site.slurm.tool("scontrol", "show job");
    let merge = jobs.split("JobId=").find(|job| job.contains("Comment=behind")).expect("the merge is a job");
    assert!(merge.contains("Dependency=afterany") && !merge.contains("ArrayTaskId"), "{merge}");
    assert!(
        merge.contains("mem=50M") && jobs.contains("mem=100M") && jobs.contains("ArrayTaskThrottle=1"),
        "{jobs}"
    );
    site.slurm.until_empty(120);
    assert_eq!(site.results("results/tiny.sqlite"), site.results("whole.sqlite"));
    assert_eq!(site.rows("results/tiny.sqlite", "SELECT DISTINCT simd FROM v_trial"), "baseline");
    let status = site.says(0, "status --folder");
    assert!(status.contains("4 of 4 shards complete"), "{status}");
    let outputs =
        ["shard-2-of-4.out", "shard-2+2-of-4.out"].map(|name| format!("results/tiny.shards/{name}"));
    assert!(outputs.iter().all(|file| site.home.join(file).exists()), "{outputs:?}");
}

/// After a kill the shard must be submitted again; after a requeue it returns by itself; both times it resumes.
#[test]
fn a_shard_that_is_killed_or_requeued_goes_on() {
    let Some(site) = Site::new("a_shard_that_is_killed_or_requeued_goes_on") else { return };
    std::fs::write(site.home.join("slow.toml"), spec("slow", 600, "[1]")).unwrap();
    site.says(0, "run slow.toml --db whole.sqlite");
    let log = "results/slow.shards/shard-1-of-1.log";
    site.says(0, "cluster submit slurm slow.toml --shards 1 --cpus 1 --time 5");
    site.until_running(log, 1);
    let pid = shard_process(&site.home.join("results/slow.shards")).expect("the shard is a process");
    // SAFETY: sends a signal to a process that this test has caused to start.
    unsafe { libc::kill(pid, libc::SIGKILL) };
    site.slurm.until_empty(60);
    let status = site.says(0, "status --folder results/slow.shards");
    assert!(
        status.contains("0 of 1 shards complete") && status.contains("`metasense cluster submit` resumes"),
        "{status}"
    );

    site.says(0, "cluster submit slurm slow.toml --cpus 1 --time 5");
    site.until_running(log, 2);
    let again = site.says(0, "cluster submit slurm slow.toml --cpus 1 --time 5");
    assert!(again.contains("running or queued: shards 1") && again.contains("nothing to submit"), "{again}");
    let job = site.slurm.tool("squeue", "-h -t running -o %A").trim().to_owned();
    site.slurm.tool("scontrol", &format!("requeue {job}"));
    // By default Slurm delays it for two minutes.
    site.slurm.until("the shard waits again", 60, || {
        site.slurm.tool("squeue", "-h -r -t pending -o %r").contains("BeginTime")
    });
    // pending, and briefly also completing
    site.slurm.until("status says so", 60, || {
        site.says(0, "status --folder results/slow.shards").contains("pending")
    });
    let interrupted = "SELECT outcome FROM v_run ORDER BY started_at DESC LIMIT 1";
    assert_eq!(site.rows(&site.handed_in("slow", 1).unwrap(), interrupted), "interrupted");
    let id = site.slurm.tool("squeue", "-h -r -t pending -o %i");
    let id = id.lines().find(|id| id.contains('_')).expect("an array's job");
    // A node refuses a job that starts in the second of its own termination: "Job credential revoked".
    std::thread::sleep(Duration::from_secs(2));
    site.slurm.tool("scontrol", &format!("update jobid={id} starttime=now"));
    site.slurm.until_empty(90);
    // Slurm sometimes takes the requeue for the end that the merge waits for; a second merge is complete
    site.says(0, "cluster merge results/slow.shards --out results/slow.sqlite");
    assert_eq!(site.results("results/slow.sqlite"), site.results("whole.sqlite"));
    let runs =
        "SELECT group_concat(coalesce(outcome, 'lost')) FROM (SELECT outcome FROM v_run ORDER BY started_at)";
    assert_eq!(site.rows("results/slow.sqlite", runs).trim_matches('"'), "lost,interrupted,complete");
}

/// A shard gets a signal one minute before its time limit, here at once, queues itself again and resumes. After a cancellation it
/// does not.
#[test]
fn a_shard_queues_again_at_its_time_limit_and_not_when_it_is_cancelled() {
    let Some(site) = Site::new("a_shard_queues_again_at_its_time_limit_and_not_when_it_is_cancelled") else {
        return;
    };
    std::fs::write(site.home.join("long.toml"), spec("long", 6000, "[1]")).unwrap();
    // A name in which shell and sbatch must not expand anything.
    let folder = "$(touch${IFS}pwned)#'%d.shards";
    site.says(
        0,
        &format!("cluster submit slurm long.toml --shards 1 --cpus 1 --time 1 --folder {folder} -- --mem=0"),
    );
    let waits = || site.slurm.tool("squeue", "-h -r -t pending -o %r").contains("BeginTime");
    site.slurm.until("the shard waits again", 100, waits);
    assert!(site.home.join(folder).join("shard-1-of-1.out").exists() && !site.home.join("pwned").exists());
    site.says(0, &format!("cluster merge {folder} --out early.sqlite"));
    let outcome = "SELECT outcome, shards, estimated_seconds > 0 FROM v_run";
    assert_eq!(site.rows("early.sqlite", outcome), "interrupted,1,1");
    assert_ne!(site.rows("early.sqlite", "SELECT count(*) FROM v_step"), "0");

    // A longer limit, and then a cancellation.
    let id = site.slurm.tool("squeue", "-h -r -t pending -o %i");
    let id = id.lines().find(|id| id.contains('_')).expect("an array's job").to_owned();
    std::thread::sleep(Duration::from_secs(2)); // as above
    site.slurm.tool("scontrol", &format!("update jobid={id} starttime=now timelimit=5"));
    site.until_running(&format!("{folder}/shard-1-of-1.log"), 2);
    site.slurm.tool("scancel", &id);
    site.slurm.until_empty(60);
    let status = site.says(0, &format!("status --folder {folder}"));
    assert!(status.contains("partial") && status.contains("`metasense cluster submit` resumes"), "{status}");
    site.says(0, &format!("cluster merge {folder} --out late.sqlite"));
    let outcomes = "SELECT group_concat(outcome) FROM (SELECT outcome FROM v_run ORDER BY started_at)";
    assert_eq!(site.rows("late.sqlite", outcomes).trim_matches('"'), "interrupted,interrupted");
}
