//! After any answer of a scheduler, or none, nothing is submitted twice and nothing is forgotten; shards use their time as
//! documented. Scripts replace Slurm and HyperQueue.

use std::os::unix::fs::PermissionsExt;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use crate::common::processes::{children, eventually, kill};
use crate::common::{Bench, TINY, results};

/// Logs its arguments and queues the job. `refuse` contains numbers of calls to refuse; with `deaf` the answer is lost, with `kill`
/// the caller dies before the answer; `cluster` is printed after the number.
const SBATCH: &str = r#"echo "$@" >> calls
call=$(wc -l < calls)
grep -qx "$call" refuse 2>/dev/null && { echo 'sbatch: error: QOSMaxSubmitJobPerUserLimit' >&2; exit 1; }
for word; do case $word in --job-name=*) name=${word#*=};; --array=*) array=${word#*=};; esac; done
echo "$((100 + call)) ${name:-merge} ${array:-N/A}" >> queue
[ -e deaf ] && { echo 'sbatch: error: Socket timed out on send/recv operation' >&2; exit 1; }
[ -e kill ] && kill -9 $PPID
echo "$((100 + call))$(cat cluster 2>/dev/null)""#;

/// Lists queued jobs, only for its own cluster.
const SQUEUE: &str = r#"for word; do case $word in --clusters=*) on=${word#*=};; --jobs=*) jobs=,${word#*=},;;
  --name=*) name=${word#*=};; --format=*) format=${word#*=};; esac; done
own=$(tr -d ';' < cluster 2>/dev/null)
[ "$on" = "$own" ] || { echo 'slurm_load_jobs error: Invalid job id specified' >&2; exit 1; }
[ -z "$own" ] || echo "CLUSTER: $own"
[ -e queue ] || exit 0
while read -r number its array; do
  [ "$format $its" != "%F $name" ] || echo "$number"
  case $format$jobs in *%K*,$number,*) ;; *) continue;; esac
  [ "$array" != N/A ] || echo "$number|N/A|PENDING|Dependency"
  for part in $(echo "$array" | tr , ' '); do
    [ "$part" = N/A ] || for index in $(seq "${part%-*}" "${part#*-}"); do echo "$number|$index|PENDING|Resources"; done
  done
done < queue"#;

/// A folder with a spec and scripts.
struct Site(Bench);

impl Site {
    fn new(spec: &str) -> Self {
        let bench = Bench::new();
        bench.file("tiny.toml", spec);
        let site = Self(bench);
        site.program("sbatch", SBATCH);
        site.program("squeue", SQUEUE);
        site.program("scontrol", "echo \"$@\" >> scontrol-calls; echo 'MaxArraySize = 3'");
        site
    }

    fn program(&self, name: &str, script: &str) {
        let file = self.0.file(name, &format!("#!/bin/sh\n{script}\n"));
        std::fs::set_permissions(file, PermissionsExt::from_mode(0o755)).unwrap();
    }

    fn command(&self, program: &str, arguments: &str) -> Command {
        let mut command = Command::new(program);
        let path = format!("{}:{}", self.0.path("").display(), std::env::var("PATH").unwrap());
        command.args(arguments.split_whitespace()).current_dir(self.0.path("")).env("PATH", path);
        command
    }

    fn call(&self, arguments: &str) -> Output {
        self.command(env!("CARGO_BIN_EXE_metasense"), arguments).output().unwrap()
    }

    /// Output of a call with this exit code.
    fn says(&self, code: i32, arguments: &str) -> String {
        let output = self.call(arguments);
        let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments}: {said}");
        said
    }

    fn read(&self, file: &str) -> String {
        std::fs::read_to_string(self.0.path(file)).unwrap_or_default()
    }

    /// Calls of the scheduler.
    fn calls(&self) -> Vec<String> {
        self.read("calls").lines().map(str::to_owned).collect()
    }

    /// Starts a shard's script as a scheduler does.
    fn shard(&self, variable: &str, number: u32) -> Child {
        let mut sh = self.command("sh", "results/tiny.shards/shard.sh");
        sh.env(variable, number.to_string()).env("TMPDIR", self.0.path("tmp"));
        let output = std::fs::File::create(self.0.path(&format!("shard-{number}.said"))).unwrap();
        std::fs::create_dir_all(self.0.path("tmp")).unwrap();
        sh.stdout(output.try_clone().unwrap()).stderr(output).stdin(Stdio::null()).spawn().unwrap()
    }
}

/// Four quick trials.
fn four() -> String {
    TINY.to_owned() + "seeds = [1, 2]\n"
}

const SUBMIT: &str = "cluster submit slurm tiny.toml --shards 4";

/// With several clusters, a job number belongs to a cluster: queries and the merge's dependency name it.
#[test]
fn jobs_are_known_on_their_cluster() {
    let site = Site::new(&four());
    site.0.file("cluster", ";gpu");
    let submit = "cluster submit slurm tiny.toml --shards 2 -- --clusters=cpu,gpu";
    site.says(0, submit);
    let calls = site.calls();
    assert!(
        calls[1].contains("--dependency=afterany:101") && calls[1].contains("--clusters=gpu"),
        "{calls:?}"
    );
    for said in [site.says(0, submit), site.says(0, "status --folder results/tiny.shards")] {
        assert!(said.contains("shards 1-2") || said.contains("2 in the queue"), "{said}");
    }
    assert_eq!(site.calls(), calls, "nothing is submitted again");
}

/// If a later array or the merge is refused, the queued jobs are printed, and the same command queues only the rest. If the first
/// is refused, nothing has started.
#[test]
fn what_a_scheduler_refuses_is_submitted_by_the_same_command() {
    for (refused, code, queued) in [("1", 2, ""), ("2", 3, "101"), ("3", 3, "102")] {
        let site = Site::new(&four());
        site.0.file("refuse", refused);
        let said = site.says(code, SUBMIT);
        assert!(said.contains("QOSMax") && said.contains(queued), "{said}");
        let before = site.calls().len();
        site.says(0, SUBMIT);
        let arrays: String =
            site.calls()[before..].iter().filter_map(|call| call.split(' ').nth(1)).collect();
        let expected = match refused {
            "1" => "--array=1-2--array=1-2--dependency=afterany:102:103",
            "2" => "--array=1-2--dependency=afterany:101:103",
            _ => "--dependency=afterany:101:102",
        };
        assert_eq!(arrays, expected, "{:?}", site.calls());
        assert!(site.says(0, SUBMIT).contains("nothing to submit"));
    }
}

/// A job whose number was lost is found by its name: the answer was lost, or `submit` died.
#[test]
fn a_job_whose_number_was_lost_is_not_submitted_again() {
    let site = Site::new(&four());
    site.0.file("deaf", "");
    let said = site.says(3, SUBMIT);
    assert!(said.contains("job 101") && said.contains("job 102"), "the shards were accepted: {said}");
    std::fs::remove_file(site.0.path("deaf")).unwrap();
    let site = Site::new(&four());
    site.0.file("kill", "");
    assert_eq!(site.call(SUBMIT).status.code(), None, "it was killed");
    assert!(site.says(0, "status --folder results/tiny.shards").contains("2 in the queue"));
    std::fs::remove_file(site.0.path("kill")).unwrap();
    site.says(0, SUBMIT);
    let calls = site.calls();
    assert!(calls[1].contains("shard.sh 2") && calls[2].contains("afterany:101:102"), "{calls:?}");
    assert_eq!(calls.len(), 3, "{calls:?}");
    // an incomplete last line is ignored, and the next one is complete
    let notes = site.read("results/tiny.shards/jobs.jsonl");
    site.0.file("results/tiny.shards/jobs.jsonl", &(notes + "{\"scheduler\": \"slurm\", \"jo"));
    for arguments in [SUBMIT, "status --folder results/tiny.shards", "cluster gc"] {
        site.says(0, arguments);
    }
    assert_eq!(site.calls(), calls);
    site.0.file("results/tiny.shards/jobs.jsonl", "{\"scheduler\": \"slurm\", \"jo\n{}\n");
    assert!(site.says(3, "status --folder results/tiny.shards").contains("jobs.jsonl:1"));
}

/// Trials in the merged database are not computed again by any scheduler; others are.
#[test]
fn trials_that_are_done_are_left_out() {
    let site = Site::new(TINY);
    site.0.output(&["run", "tiny.toml"]);
    assert!(site.says(0, SUBMIT).contains("nothing left to do"));
    assert!(site.calls().is_empty() && !site.0.path("results/tiny.shards").exists());
    site.0.file("tiny.toml", &four());
    site.says(0, "cluster submit slurm tiny.toml --shards 1");
    let trials = site.read("results/tiny.shards/shard-1-of-1.trials.jsonl");
    assert_eq!(trials.lines().count(), 2, "{trials}");
    std::fs::remove_dir_all(site.0.path("results/tiny.shards")).unwrap();
    site.says(0, "cluster submit local tiny.toml --shards 2 --cpus 1");
    let attempts =
        site.0.output(&["query", "results/tiny.sqlite", "SELECT attempts FROM v_trial", "--format", "csv"]);
    assert_eq!(attempts, "attempts\n1\n1\n1\n1\n");
    site.0.file("other.sqlite", "notes of mine");
    site.says(2, "cluster submit slurm tiny.toml --out other.sqlite");
}

/// Without the scheduler there is an error, and nothing is written; a dry run does not need it.
#[test]
fn without_a_scheduler_nothing_is_written() {
    for scheduler in ["slurm", "hq"] {
        let site = Site::new(TINY);
        let call = |more: &str| {
            let arguments = format!("cluster submit {scheduler} tiny.toml --shards 1 {more}");
            site.command(env!("CARGO_BIN_EXE_metasense"), &arguments)
                .env("PATH", "/nowhere")
                .output()
                .unwrap()
        };
        let output = call("");
        let said = String::from_utf8_lossy(&output.stderr);
        let program = if scheduler == "slurm" { "sbatch" } else { "hq" };
        assert!(output.status.code() == Some(2) && said.contains(program), "{said}");
        assert!(!site.0.path("results").exists());
        assert!(call("--dry-run").status.success());
    }
}

/// HyperQueue: no job waits for others. The last shard to hand in merges; the database that it names exists.
#[test]
fn the_last_shard_of_hyperqueue_merges() {
    let site = Site::new(&four());
    site.program("hq", "case \"$*\" in *task\\ list*) echo '{}';; *) echo \"$@\" >> calls; echo 7;; esac");
    site.0.output(&["run", "tiny.toml", "--db", "whole.sqlite"]);
    site.says(0, "cluster submit hq tiny.toml --shards 2 --cpus 2");
    assert_eq!(site.calls().len(), 1, "{:?}", site.calls());
    for shard in [2, 1] {
        assert!(!site.0.path("results/tiny.sqlite").exists(), "before shard {shard}");
        let code = site.shard("HQ_TASK_ID", shard).wait().unwrap().code();
        let said = site.read(&format!("results/tiny.shards/shard-{shard}-of-2.out"));
        assert_eq!(code, Some(0), "{said}");
        for line in said.lines().filter_map(|line| line.strip_prefix("database: ")) {
            assert!(site.0.path(line).exists(), "{line}");
        }
    }
    assert_eq!(results(&site.0, "results/tiny.sqlite"), results(&site.0, "whole.sqlite"));
    assert!(site.says(0, "cluster submit hq tiny.toml").contains("nothing left to do"));
    site.says(2, "cluster submit hq tiny.toml -- --pin taskset -- --cpus 1");
}

/// On notice from Slurm, a shard finishes its step however long it takes, and is queued again. Its database has been handed in
/// before, in case the time does not suffice.
#[test]
fn a_shard_uses_its_notice_for_the_step_in_progress() {
    let slow = TINY.replace("samples = 8\n", "samples = 12000\n").replace("batch = 4", "batch = 11990");
    let site = Site::new(&slow.replace("[1, 2]", "[1]").replace("test = 2", "test = 8"));
    site.says(0, "cluster submit slurm tiny.toml --shards 1 --cpus 1");
    let script = site.read("results/tiny.shards/shard.sh");
    assert!(script.contains("--grace 45") && script.contains("USR1@60"), "{script}");
    let handed_in = || {
        let files = std::fs::read_dir(site.0.path("results/tiny.shards")).unwrap().flatten();
        files.map(|file| file.path()).find(|path| path.extension().is_some_and(|end| end == "sqlite"))
    };
    let mut shard = site.shard("SLURM_ARRAY_TASK_ID", 1);
    let log = || site.read("results/tiny.shards/shard-1-of-1.log").contains("worker started");
    eventually(Duration::from_secs(60), || log().then_some(())).expect("the shard begins");
    let run = eventually(Duration::from_secs(10), || children(shard.id()).first().copied()).unwrap();
    let worker = eventually(Duration::from_secs(10), || children(run).first().copied()).unwrap();
    let works =
        || metasense::processes::cpu_seconds(worker).is_some_and(|seconds| seconds > 0.5).then_some(());
    eventually(Duration::from_secs(60), works).expect("its worker works");
    kill(shard.id(), libc::SIGUSR1);
    eventually(Duration::from_secs(60), handed_in).expect("what there is is handed in");
    assert!(shard.try_wait().unwrap().is_none(), "the step in progress is waited for");
    shard.wait().unwrap();
    assert!(site.read("scontrol-calls").contains("requeue"), "{}", site.read("shard-1.said"));
    let db = handed_in().unwrap();
    assert_eq!(site.0.number(db.to_str().unwrap(), "SELECT count(*) FROM v_step"), 1);
    // run.grace is part of the notice; a grace that leaves no time is refused
    std::fs::remove_dir_all(site.0.path("results")).unwrap();
    let dry = site.says(0, "cluster submit slurm tiny.toml run.grace=100.5 --shards 1 --dry-run");
    assert!(dry.contains("--grace 100.5") && dry.contains("USR1@116"), "{dry}");
    site.says(2, "cluster submit slurm tiny.toml run.grace=100 --shards 1 --time 1 --dry-run");
}
