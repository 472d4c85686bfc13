//! What is handed to a cluster's scheduler, to the letter; and that it is handed over.

use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Output};

use crate::common::{Bench, SPEC, TINY};

/// Without the paths of this machine.
fn dry_run(bench: &Bench, arguments: &[&str]) -> String {
    bench.file("s.toml", SPEC);
    let text = bench.output(&[&["submit"], arguments, &["s.toml", "--dry-run"]].concat());
    let folder = bench.path("").canonicalize().unwrap();
    assert!(!bench.path("results").exists(), "a dry run writes nothing");
    text.replace(env!("CARGO_BIN_EXE_metasense"), "/opt/metasense")
        .replace(folder.to_str().unwrap(), "/home/user")
}

#[test]
fn scripts_for_slurm_are_readable() {
    let bench = Bench::new();
    insta::assert_snapshot!(dry_run(
        &bench,
        &["slurm", "--shards", "12", "--partition", "main", "--time", "1-12", "--cpus", "8"]
    ));
}

#[test]
fn scripts_for_hyperqueue_run_the_same_shard() {
    let bench = Bench::new();
    insta::assert_snapshot!(dry_run(&bench, &["hq", "--shards", "3"]));
}

/// Calls the program where `hq` is this script.
fn with_hq(bench: &Bench, script: &str, arguments: &[&str]) -> Output {
    let hq = bench.file("hq", &format!("#!/bin/sh\n{script}\n"));
    std::fs::set_permissions(&hq, PermissionsExt::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", bench.path("").display(), std::env::var("PATH").unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    command.args(arguments).current_dir(bench.path("")).env("PATH", path).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A stand-in for `hq` writes down how it is called.
#[test]
fn hyperqueue_is_handed_shards_and_a_merge() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let call = |arguments: &[&str]| {
        let hq = "case \"$*\" in *task\\ list*) echo '{}';; *) echo \"$@\" >> calls; echo 7;; esac";
        let output = with_hq(&bench, hq, arguments);
        assert!(output.status.success(), "{}", said(&output));
        said(&output)
    };
    call(&["submit", "hq", "s.toml", "--shards", "2", "--", "--pin", "taskset"]);
    let calls = std::fs::read_to_string(bench.path("calls")).unwrap();
    let calls: Vec<&str> = calls.lines().collect();
    assert!(
        calls[0].contains("--array 1-2 --cpus 4 --time-limit 14400s")
            && calls[0].contains("--pin taskset -- sh"),
        "{calls:?}"
    );
    assert!(calls[1].ends_with("merge.sh 7") && calls[1].contains("--priority=-1"), "{calls:?}");
    let again = bench.metasense(&["submit", "hq", "s.toml", "--shards", "3"]);
    assert!(again.status.code() == Some(2) && said(&again).contains("holds shards of 2"), "{}", said(&again));
    let status = call(&["status", "--cluster"]);
    assert!(status.contains("0 of 2 shards complete"), "{status}");
}

/// The scheduler has accepted the shards, and then refuses the merge: they are known all the same.
#[test]
fn what_was_accepted_is_written_down_before_anything_else_can_fail() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let hq = "case \"$*\" in *merge.sh*) echo refused >&2; exit 2;; *) echo 7;; esac";
    let output = with_hq(&bench, hq, &["submit", "hq", "s.toml", "--shards", "2"]);
    let message = said(&output);
    assert!(output.status.code() == Some(2) && message.contains("refused"), "{message}");
    assert!(message.contains("metasense merge"), "{message}");
    let running = r#"echo '{"7": [{"id": 1, "state": "running"}, {"id": 2, "state": "waiting"}]}'"#;
    let status = with_hq(&bench, running, &["status", "--cluster"]);
    assert!(said(&status).contains("2 in the queue"), "{}", said(&status));
    // Where nothing can be written down, nothing is submitted.
    std::fs::create_dir_all(bench.path("no/jobs.jsonl")).unwrap();
    let output = with_hq(&bench, "touch called; echo 8", &["submit", "hq", "s.toml", "--out-dir", "no"]);
    assert!(output.status.code() == Some(3) && !bench.path("called").exists(), "{}", said(&output));
    // A line that is none is not overlooked.
    bench.file("results/s.shards/jobs.jsonl", "{\"scheduler\": \"hq\", \"jo");
    let output = with_hq(&bench, running, &["status", "--cluster"]);
    assert!(output.status.code() == Some(3) && said(&output).contains("jobs.jsonl:1"), "{}", said(&output));
}

/// The script as it is written, run by a shell: a folder may be called anything that a line can hold.
#[test]
fn no_part_of_a_folder_is_run() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let folder = "a $(touch pwned) `touch pwned` 'b' $HOME %d";
    let output = with_hq(&bench, "echo 7", &["submit", "hq", "s.toml", "--shards", "1", "--out-dir", folder]);
    assert!(output.status.success(), "{}", said(&output));
    // Changed since, so that the shard ends at once.
    bench.file("s.toml", &SPEC.replace("columns = 6", "columns = 5"));
    for script in ["shard.sh", "merge.sh"] {
        let mut sh = Command::new("sh");
        sh.arg(bench.path(folder).join(script))
            .args(["7"])
            .env("HQ_TASK_ID", "1")
            .env("PATH", "/bin:/usr/bin");
        sh.current_dir(bench.path("")).output().unwrap();
    }
    let log = std::fs::read_to_string(bench.path(folder).join("shard-1-of-1.out")).unwrap();
    assert!(log.contains("has changed since") && !bench.path("pwned").exists(), "{log}");
    assert!(bench.path(folder).join("merge.out").exists());
    for (scheduler, folder) in [("hq", "a\nb"), ("slurm", "a\nb"), ("slurm", "a\"b"), ("slurm", "a\\b")] {
        let args = ["submit", scheduler, "s.toml", "--shards", "1", "--out-dir", folder, "--dry-run"];
        let output = bench.metasense(&args);
        assert!(output.status.code() == Some(2) && said(&output).contains("folder"), "{}", said(&output));
    }
}

/// What runs or waits is not submitted a second time, whatever it has handed in; a queue that does not answer is not an
/// empty one. The merge waits for all that is at work on the folder.
#[test]
fn what_the_queue_still_has_is_left_out() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let tasks = |states: &str| {
        format!(
            "case \"$*\" in *task\\ list*) echo '{{\"7\": [{states}], \"8\": [{{\"id\": 0, \"state\": \"waiting\"}}]}}';; \
             *merge.sh*) echo \"$@\" >> calls; echo 8;; *) echo \"$@\" >> calls; cat id;; esac"
        )
    };
    let call = |states: &str, more: &[&str]| {
        let _ = std::fs::remove_file(bench.path("calls"));
        let output = with_hq(&bench, &tasks(states), &[&["submit", "hq", "s.toml"], more].concat());
        assert!(output.status.success(), "{}", said(&output));
        (said(&output), std::fs::read_to_string(bench.path("calls")).unwrap_or_default())
    };
    bench.file("id", "7\n");
    call("", &["--shards", "2"]);
    bench.file("id", "9\n");
    let one = r#"{"id": 1, "state": "running"}, {"id": 2, "state": "failed"}"#;
    let (message, calls) = call(one, &[]);
    assert!(message.contains("left out: shards 1"), "{message}");
    assert!(calls.contains("--array 2 ") && calls.contains("merge.sh 9,7,8"), "{calls}");
    let both = r#"{"id": 1, "state": "running"}, {"id": 2, "state": "waiting"}"#;
    let (message, calls) = call(both, &[]);
    assert!(message.contains("left out: shards 1-2") && message.contains("nothing to submit"), "{message}");
    assert_eq!(calls, "");
    for (broken, expected) in [("echo broken >&2; exit 1", "broken"), ("echo 7", "not understood")] {
        let output = with_hq(&bench, broken, &["submit", "hq", "s.toml"]);
        assert!(output.status.code() == Some(3) && said(&output).contains(expected), "{}", said(&output));
    }
    // Slurm: a controller that is away, and one that has long forgotten the job.
    bench
        .file("results/s.shards/jobs.jsonl", r#"{"scheduler":"slurm","job":"7","merge_job":"8","shards":2}"#);
    let squeue = |script: &str| {
        let file = bench.file("squeue", script);
        std::fs::set_permissions(file, PermissionsExt::from_mode(0o755)).unwrap();
        with_hq(&bench, "echo 9", &["submit", "hq", "s.toml"])
    };
    let away =
        squeue("#!/bin/sh\necho 'slurm_load_jobs error: Unable to contact slurm controller' >&2; exit 1\n");
    assert!(away.status.code() == Some(3) && said(&away).contains("Unable to contact"), "{}", said(&away));
    let forgotten = squeue("#!/bin/sh\necho 'slurm_load_jobs error: Invalid job id specified' >&2; exit 1\n");
    assert!(forgotten.status.success(), "{}", said(&forgotten));
}

/// A submitted shard runs the trials that were written down for it: it needs no spec's expansion, and an edited spec no longer
/// concerns it. What a folder's trials have become is told by what was assigned.
#[test]
fn a_submitted_shard_runs_the_trials_that_were_written_down() {
    let bench = Bench::new();
    bench.file("tiny.toml", &(TINY.replace("1e-4", "1e-3") + "seeds = [1, 2]\n"));
    let hq = "case \"$*\" in *task\\ list*) echo '{}';; *) echo 7;; esac";
    let call = |arguments: &[&str]| said(&with_hq(&bench, hq, arguments));
    call(&["submit", "hq", "tiny.toml", "--shards", "2"]);
    let folder = "results/tiny.shards";
    let trials = |shard: u32| {
        std::fs::read_to_string(bench.path(&format!("{folder}/shard-{shard}-of-2.trials.jsonl"))).unwrap()
    };
    assert_eq!([trials(1).lines().count(), trials(2).lines().count()], [2, 2]);
    let spec = format!("{folder}/spec.toml");
    let shard = |shard: &str| bench.metasense(&["run", &spec, "--shard", shard, "--copy-to", folder]);
    assert!(shard("1/2").status.success());
    let status = call(&["status", "--cluster"]);
    assert!(status.contains("1 of 2 shards complete, 0 in the queue"), "{status}");
    let mut hashes: Vec<String> =
        trials(2).lines().map(|line| line.split('"').nth(3).unwrap()[..8].to_owned()).collect();
    hashes.sort();
    assert!(status.contains(&format!("never begun: 2 trials ({})", hashes.join(", "))), "{status}");
    let early = said(&bench.metasense(&["merge", folder, "--out", "early.sqlite"]));
    assert!(early.contains("never begun: 2 trials"), "{early}");
    // A line that is not what this program makes of it.
    let file = bench.path(&format!("{folder}/shard-2-of-2.trials.jsonl"));
    std::fs::write(&file, trials(2).replacen("\"seed\":", "\"seed\":7", 1)).unwrap();
    let refused = shard("2/2");
    assert!(
        refused.status.code() == Some(2) && said(&refused).contains("jsonl:1: trial"),
        "{}",
        said(&refused)
    );
    std::fs::remove_file(&file).unwrap();
    assert!(shard("2/2").status.success());
    let status = call(&["status", "--cluster"]);
    assert!(status.contains("2 of 2 shards complete") && !status.contains("never"), "{status}");
}

/// Failed trials are settled, and not complete: `submit` says how many there are, and runs them again where it is told to.
#[test]
fn failed_trials_are_told_and_run_again_on_request() {
    let bench = Bench::new();
    let text = TINY
        .replace("sensors = [1, 2]", "sensors = [4]\nseeds = [1, 2]")
        .replace("samples = 20", "samples = 250");
    bench.file("tiny.toml", &text.replace("[sweep]", "[run]\nmemory = 120\n[sweep]"));
    let hq = "case \"$*\" in *task\\ list*) echo '{}';; *) echo \"$@\" >> calls; echo 7;; esac";
    let call = |arguments: &[&str]| said(&with_hq(&bench, hq, arguments));
    call(&["submit", "hq", "tiny.toml", "--shards", "1"]);
    let folder = "results/tiny.shards";
    let spec = format!("{folder}/spec.toml");
    bench.metasense(&["run", &spec, "--shard", "1/1", "--copy-to", folder]);
    let status = call(&["status", "--cluster"]);
    assert!(status.contains("0 of 1 shards complete") && status.contains("2 trials failed"), "{status}");
    let again = call(&["submit", "hq", "tiny.toml"]);
    assert!(again.contains("2 trials of shards 1 failed") && again.contains("nothing left to do"), "{again}");
    let again = call(&["submit", "hq", "tiny.toml", "--retry-failed"]);
    assert!(again.contains("submitted: job 7, shards 1"), "{again}");
    let script = std::fs::read_to_string(bench.path(&format!("{folder}/shard.sh"))).unwrap();
    assert!(script.contains("--retry-failed"), "{script}");
}
