//! Submissions to a cluster's scheduler: exact scripts and commands, and their execution.

use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use crate::common::processes::{children, eventually, is_alive, kill};
use crate::common::{Bench, SPEC, TINY, results};

/// A dry run's output without the paths of this machine.
fn dry_run(bench: &Bench, arguments: &[&str]) -> String {
    bench.file("s.toml", SPEC);
    let text = bench
        .output(&[&["cluster", "submit", arguments[0], "s.toml", "--dry-run"], &arguments[1..]].concat());
    let folder = bench.path("").canonicalize().unwrap();
    assert!(!bench.path("results").exists(), "a dry run writes nothing");
    let text = text.replace(folder.to_str().unwrap(), "/home/user");
    let digest = text.split("metasense-").nth(1).map_or(String::new(), |rest| rest[..8].to_owned());
    text.replace(&digest, "DIGEST")
}

#[test]
fn scripts_for_slurm_are_readable() {
    let bench = Bench::new();
    insta::assert_snapshot!(dry_run(
        &bench,
        &[
            "slurm",
            "--shards",
            "12",
            "--time",
            "1-12",
            "--cpus",
            "8",
            "--at-most",
            "3",
            "--",
            "--partition=main"
        ]
    ));
}

#[test]
fn scripts_for_hyperqueue_run_the_same_shard() {
    let bench = Bench::new();
    let prefix = "apptainer exec image.sif";
    insta::assert_snapshot!(dry_run(
        &bench,
        &[
            "hq",
            "--shards",
            "3",
            "--prefix",
            prefix,
            "--run",
            "--simd avx2 --copy-every 300",
            "--retry-failed"
        ]
    ));
}

/// Runs the program with this script as `hq`.
fn with_hq(bench: &Bench, script: &str, arguments: &[&str]) -> Output {
    let hq = bench.file("hq", &format!("#!/bin/sh\n{script}\n"));
    std::fs::set_permissions(&hq, PermissionsExt::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", bench.path("").display(), std::env::var("PATH").unwrap());
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    command.args(arguments).current_dir(bench.path("")).env("PATH", path).output().unwrap()
}

fn stderr_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A script in place of `hq` logs its arguments.
#[test]
fn hyperqueue_is_handed_shards() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let call = |arguments: &[&str]| {
        let hq = "case \"$*\" in *task\\ list*) echo '{}';; *) echo \"$@\" >> calls; echo 7;; esac";
        let output = with_hq(&bench, hq, arguments);
        assert!(output.status.success(), "{}", stderr_text(&output));
        stderr_text(&output)
    };
    call(&["cluster", "submit", "hq", "s.toml", "--shards", "2", "--", "--pin", "taskset"]);
    let calls = std::fs::read_to_string(bench.path("calls")).unwrap();
    let calls: Vec<&str> = calls.lines().collect();
    assert!(
        calls[0].contains("--array 1-2 --cpus 4 --time-limit 14400s")
            && calls[0].contains("--pin taskset -- sh"),
        "{calls:?}"
    );
    assert_eq!(calls.len(), 1, "no job waits for others: {calls:?}");
    let queue = "echo '{}'";
    let again = with_hq(&bench, queue, &["cluster", "submit", "hq", "s.toml", "--shards", "3"]);
    assert!(
        again.status.code() == Some(2) && stderr_text(&again).contains("contains a sweep of 2 shards"),
        "{}",
        stderr_text(&again)
    );
    let status = call(&["status", "--folder"]);
    assert!(status.contains("0 of 2 shards complete"), "{status}");
}

/// If jobs cannot be noted, nothing is submitted.
#[test]
fn what_was_accepted_is_written_down() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let output = with_hq(&bench, "echo 7", &["cluster", "submit", "hq", "s.toml", "--shards", "2"]);
    assert!(output.status.success(), "{}", stderr_text(&output));
    let running = r#"echo '{"7": [{"id": 1, "state": "running"}, {"id": 2, "state": "waiting"}]}'"#;
    let status = with_hq(&bench, running, &["status", "--folder"]);
    assert!(stderr_text(&status).contains("2 in the queue"), "{}", stderr_text(&status));
    std::fs::create_dir_all(bench.path("no/jobs.jsonl")).unwrap();
    let output =
        with_hq(&bench, "touch called; echo 8", &["cluster", "submit", "hq", "s.toml", "--folder", "no"]);
    assert!(output.status.code() == Some(3) && !bench.path("called").exists(), "{}", stderr_text(&output));
}

/// Runs the written script in a shell: a folder's name may contain any character of a line.
#[test]
fn no_part_of_a_folder_is_run() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let folder = "a $(touch pwned) `touch pwned` 'b' $HOME %d";
    let output = with_hq(
        &bench,
        "echo 7",
        &["cluster", "submit", "hq", "s.toml", "--shards", "1", "--folder", folder],
    );
    assert!(output.status.success(), "{}", stderr_text(&output));
    // Damaged, so that the shard ends at once.
    std::fs::write(bench.path(folder).join("shard-1-of-1.trials.jsonl"), "{}\n").unwrap();
    for script in ["shard.sh", "merge.sh"] {
        let mut sh = Command::new("sh");
        sh.arg(bench.path(folder).join(script))
            .args(["7"])
            .env("HQ_TASK_ID", "1")
            .env("PATH", "/bin:/usr/bin");
        sh.current_dir(bench.path("")).output().unwrap();
    }
    let log = std::fs::read_to_string(bench.path(folder).join("shard-1-of-1.out")).unwrap();
    assert!(log.contains("jsonl:1") && !bench.path("pwned").exists(), "{log}");
    for (scheduler, folder) in [("hq", "a\nb"), ("slurm", "a\nb"), ("slurm", "a\"b"), ("slurm", "a\\b")] {
        let args =
            ["cluster", "submit", scheduler, "s.toml", "--shards", "1", "--folder", folder, "--dry-run"];
        let output = bench.metasense(&args);
        assert!(
            output.status.code() == Some(2) && stderr_text(&output).contains("folder"),
            "{}",
            stderr_text(&output)
        );
    }
}

/// Running and pending shards are not submitted again, whatever they have handed in; a queue that does not answer does not count as
/// empty.
#[test]
fn what_the_queue_still_has_is_left_out() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let tasks = |states: &str| {
        format!(
            "case \"$*\" in *task\\ list*) echo '{{\"7\": [{states}], \"8\": [{{\"id\": 0, \"state\": \"waiting\"}}]}}';; \
             *) echo \"$@\" >> calls; cat id;; esac"
        )
    };
    let call = |states: &str, more: &[&str]| {
        let _ = std::fs::remove_file(bench.path("calls"));
        let output =
            with_hq(&bench, &tasks(states), &[&["cluster", "submit", "hq", "s.toml"], more].concat());
        assert!(output.status.success(), "{}", stderr_text(&output));
        (stderr_text(&output), std::fs::read_to_string(bench.path("calls")).unwrap_or_default())
    };
    bench.file("id", "7\n");
    call("", &["--shards", "2"]);
    bench.file("id", "9\n");
    let one = r#"{"id": 1, "state": "running"}, {"id": 2, "state": "failed"}"#;
    let (message, calls) = call(one, &[]);
    assert!(
        message.contains("running or queued: shards 1") && calls.contains("--array 2 "),
        "{message}: {calls}"
    );
    let both = r#"{"id": 1, "state": "running"}, {"id": 2, "state": "waiting"}"#;
    let (message, calls) = call(both, &[]);
    assert!(
        message.contains("running or queued: shards 1-2") && message.contains("nothing to submit"),
        "{message}"
    );
    assert_eq!(calls, "");
    for (broken, expected) in [("echo broken >&2; exit 1", "broken"), ("echo 7", "unexpected output")] {
        let output = with_hq(&bench, broken, &["cluster", "submit", "hq", "s.toml"]);
        assert!(
            output.status.code() == Some(3) && stderr_text(&output).contains(expected),
            "{}",
            stderr_text(&output)
        );
    }
    // Slurm: an unreachable controller, and one that has forgotten the job.
    bench
        .file("results/s.shards/jobs.jsonl", r#"{"scheduler":"slurm","job":"7","merge_job":"8","shards":2}"#);
    let squeue = |script: &str| {
        let file = bench.file("squeue", script);
        std::fs::set_permissions(file, PermissionsExt::from_mode(0o755)).unwrap();
        with_hq(&bench, "echo 9", &["cluster", "submit", "hq", "s.toml"])
    };
    let away =
        squeue("#!/bin/sh\necho 'slurm_load_jobs error: Unable to contact slurm controller' >&2; exit 1\n");
    assert!(
        away.status.code() == Some(3) && stderr_text(&away).contains("Unable to contact"),
        "{}",
        stderr_text(&away)
    );
    let forgotten = squeue("#!/bin/sh\necho 'slurm_load_jobs error: Invalid job id specified' >&2; exit 1\n");
    assert!(forgotten.status.success(), "{}", stderr_text(&forgotten));
}

/// A submitted shard runs the trials noted for it: it does not expand the spec, and later edits have no effect. `status` counts the
/// assigned trials.
#[test]
fn a_submitted_shard_runs_the_trials_that_were_written_down() {
    let bench = Bench::new();
    bench.file("tiny.toml", &(TINY.to_owned() + "seeds = [1, 2]\n"));
    let hq = "case \"$*\" in *task\\ list*) echo '{}';; *) echo 7;; esac";
    let call = |arguments: &[&str]| stderr_text(&with_hq(&bench, hq, arguments));
    call(&["cluster", "submit", "hq", "tiny.toml", "--shards", "2"]);
    let folder = "results/tiny.shards";
    let trials = |shard: u32| {
        std::fs::read_to_string(bench.path(&format!("{folder}/shard-{shard}-of-2.trials.jsonl"))).unwrap()
    };
    assert_eq!([trials(1).lines().count(), trials(2).lines().count()], [2, 2]);
    let spec = format!("{folder}/spec.toml");
    let shard = |shard: &str| bench.metasense(&["run", &spec, "--shard", shard, "--folder", folder]);
    assert!(shard("1/2").status.success());
    let status = call(&["status", "--folder"]);
    assert!(status.contains("1 of 2 shards complete, 0 in the queue"), "{status}");
    let mut hashes: Vec<String> =
        trials(2).lines().map(|line| line.split('"').nth(3).unwrap()[..8].to_owned()).collect();
    hashes.sort();
    assert!(status.contains(&format!("never started: 2 trials ({})", hashes.join(", "))), "{status}");
    let early = stderr_text(&bench.metasense(&["cluster", "merge", folder, "--out", "early.sqlite"]));
    assert!(early.contains("never started: 2 trials"), "{early}");
    // A line that does not match its trial.
    let file = bench.path(&format!("{folder}/shard-2-of-2.trials.jsonl"));
    std::fs::write(&file, trials(2).replacen("\"seed\":", "\"seed\":7", 1)).unwrap();
    let refused = shard("2/2");
    assert!(
        refused.status.code() == Some(2)
            && stderr_text(&refused).contains("jsonl:1: this program computes a different hash for trial"),
        "{}",
        stderr_text(&refused)
    );
    std::fs::remove_file(&file).unwrap();
    assert!(shard("2/2").status.success());
    let status = call(&["status", "--folder"]);
    assert!(status.contains("2 of 2 shards complete") && !status.contains("never"), "{status}");
}

/// Failed trials are settled, but not complete: `submit` prints their number, and repeats them on request.
#[test]
fn failed_trials_are_told_and_run_again_on_request() {
    let bench = Bench::new();
    let text = TINY
        .replace("sensors = [1, 2]", "sensors = [4]\nseeds = [1, 2]")
        .replace("samples = 20", "samples = 250");
    bench.file("tiny.toml", &text.replace("[sweep]", "[run]\nmemory = 120\n[sweep]"));
    let hq = "case \"$*\" in *task\\ list*) echo '{}';; *) echo \"$@\" >> calls; echo 7;; esac";
    let call = |arguments: &[&str]| stderr_text(&with_hq(&bench, hq, arguments));
    call(&["cluster", "submit", "hq", "tiny.toml", "--shards", "1"]);
    let folder = "results/tiny.shards";
    let spec = format!("{folder}/spec.toml");
    bench.metasense(&["run", &spec, "--shard", "1/1", "--folder", folder]);
    let status = call(&["status", "--folder"]);
    assert!(status.contains("0 of 1 shards complete") && status.contains("2 trials failed"), "{status}");
    let again = call(&["cluster", "submit", "hq", "tiny.toml"]);
    assert!(again.contains("2 trials of shards 1 failed") && again.contains("nothing left to do"), "{again}");
    let again = call(&["cluster", "submit", "hq", "tiny.toml", "--retry-failed"]);
    assert!(again.contains("submitted: job 7, shards 1"), "{again}");
    let script = std::fs::read_to_string(bench.path(&format!("{folder}/shard.sh"))).unwrap();
    assert!(script.contains("--retry-failed"), "{script}");
}

/// Options that a shard's run or the scheduler would refuse are refused before anything is submitted.
#[test]
fn options_that_nobody_has_are_refused_at_once() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    for (arguments, expected) in [
        // without Slurm, too
        ("slurm s.toml --dry-run --run=--no-such", "unexpected argument"),
        ("slurm s.toml --dry-run --run=--workers=3", "cannot be used multiple times"),
        ("hq s.toml --at-most 3", "HyperQueue"),
        ("local s.toml --time 10", "without a limit"),
        ("ssh s.toml", "--hosts"),
        ("local s.toml --hosts s.toml", "cluster submit ssh"),
        ("ssh s.toml --hosts s.toml", "s.toml:1"),
    ] {
        let words: Vec<&str> = ["cluster", "submit"].into_iter().chain(arguments.split(' ')).collect();
        let output = bench.metasense(&words);
        let message = stderr_text(&output);
        assert!(output.status.code() == Some(2) && message.contains(expected), "{arguments}: {message}");
        assert!(!bench.path("results").exists(), "{arguments}");
    }
}

/// Slurm limits the index of an array: more shards become several arrays with offsets. Options after a second `--` are only for the
/// merge.
#[test]
fn shards_beyond_the_largest_array_are_further_arrays() {
    let bench = Bench::new();
    let seeds: Vec<String> = (0..1050).map(|seed| seed.to_string()).collect();
    let text = TINY
        .replace("sensors = [1, 2]", "sensors = [1, 2]\nseeds = [SEEDS]")
        .replace("SEEDS", &seeds.join(", "));
    bench.file("tiny.toml", &text);
    let args = [
        "cluster",
        "submit",
        "slurm",
        "tiny.toml",
        "--shards",
        "2050",
        "--dry-run",
        "--",
        "--mem=9G",
        "--",
        "--mem=1G",
    ];
    let text = bench.output(&args);
    let commands: Vec<&str> = text.lines().filter(|line| line.starts_with('$')).collect();
    let expected = [
        ("--array=1-1000 --mem=9G ", "shard.sh"),
        ("--array=1-1000 --output=", "shard-%a+1000-of-2050.out --mem=9G "),
        ("--array=1-50 --output=", "shard.sh 2000"),
        ("--dependency=afterany:JOB --mem=1G ", "merge.sh"),
    ];
    assert_eq!(commands.len(), expected.len(), "{commands:#?}");
    for (command, (first, second)) in commands.iter().zip(expected) {
        assert!(command.contains(first) && command.contains(second), "{command}");
    }
}

/// A rebuilt program does not affect pending shards: they use the submitted copy.
#[test]
fn what_waits_is_run_by_the_program_that_was_submitted() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let copies = || -> Vec<String> {
        let names = bench.path("results/s.shards").read_dir().unwrap().flatten();
        let names = names.map(|file| file.file_name().into_string().unwrap());
        names.filter(|name| name.starts_with("metasense-")).collect()
    };
    let submit = |queue: &str| {
        let hq = format!("case \"$*\" in *task\\ list*) echo '{queue}';; *) echo 7;; esac");
        let output = with_hq(&bench, &hq, &["cluster", "submit", "hq", "s.toml", "--shards", "2"]);
        assert!(output.status.success(), "{}", stderr_text(&output));
    };
    submit("{}");
    let [copy] = &copies()[..] else { panic!("{:?}", copies()) };
    let same = std::fs::read(bench.path("results/s.shards").join(copy)).unwrap()
        == std::fs::read(env!("CARGO_BIN_EXE_metasense")).unwrap();
    let script = std::fs::read_to_string(bench.path("results/s.shards/shard.sh")).unwrap();
    assert!(same && script.contains(&format!("s.shards/{copy} run ")), "{script}");
    // The copy of another build stays while its shards may be pending.
    bench.file("results/s.shards/metasense-01234567", "");
    submit(r#"{"7": [{"id": 1, "state": "waiting"}]}"#);
    assert_eq!(copies().len(), 2);
    submit("{}");
    assert_eq!(copies().len(), 1);
}

/// Without a scheduler: shards on this machine, stopped cleanly, resumed and merged.
#[test]
fn shards_on_this_machine_are_the_sweep() {
    let bench = Bench::new();
    let text = TINY.replace("iterations = 4\n", "iterations = 60\n") + "seeds = [1, 2]\n";
    bench.file("tiny.toml", &text);
    bench.output(&["run", "tiny.toml", "--db", "whole.sqlite"]);
    std::fs::create_dir(bench.path("tmp")).unwrap();
    let submit = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
        command.args([
            "cluster",
            "submit",
            "local",
            "tiny.toml",
            "--shards",
            "2",
            "--cpus",
            "1",
            "--at-most",
            "2",
        ]);
        command.current_dir(bench.path("")).env("TMPDIR", bench.path("tmp"));
        command.stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap()
    };
    let first = submit();
    let log = |i: u32| bench.path(&format!("results/tiny.shards/shard-{i}-of-2.log"));
    let begun = |i| std::fs::read_to_string(log(i)).unwrap_or_default().contains("worker started");
    eventually(Duration::from_secs(60), || (begun(1) && begun(2)).then_some(())).expect("both shards begin");
    let status = stderr_text(&bench.metasense(&["status", "--folder"]));
    assert!(status.contains("`cluster submit` is running them now"), "{status}");
    let second = submit().wait_with_output().unwrap();
    assert!(
        second.status.code() == Some(3)
            && stderr_text(&second).contains("another `metasense cluster submit`"),
        "{}",
        stderr_text(&second)
    );
    kill(first.id(), libc::SIGTERM);
    let first = first.wait_with_output().unwrap();
    assert_eq!(first.status.code(), Some(4), "{}", stderr_text(&first));
    assert!(stderr_text(&first).contains("left: shards 1-2"), "{}", stderr_text(&first));
    let again = submit().wait_with_output().unwrap();
    assert_eq!(again.status.code(), Some(0), "{}", stderr_text(&again));
    assert_eq!(results(&bench, "results/tiny.sqlite"), results(&bench, "whole.sqlite"));
    assert_eq!(bench.path("tmp").read_dir().unwrap().count(), 0, "nothing is left on the machine");
    let status = stderr_text(&bench.metasense(&["status", "--folder"]));
    assert!(status.contains("2 of 2 shards complete"), "{status}");
}

/// Shards on this machine end in order if their `submit` is killed: they hand in what they have done.
#[test]
fn shards_end_with_the_submit_that_started_them() {
    let bench = Bench::new();
    bench.file("tiny.toml", &TINY.replace("iterations = 4\n", "iterations = 100000\n"));
    let mut submit =
        bench.start(&["cluster", "submit", "local", "tiny.toml", "--shards", "1", "--cpus", "1"]);
    let read = |end: &str| {
        let file = bench.path(&format!("results/tiny.shards/shard-1-of-1.{end}"));
        std::fs::read_to_string(file).unwrap_or_default()
    };
    let begun = || read("log").contains("worker started").then_some(());
    eventually(Duration::from_secs(60), begun).expect("the shard begins");
    let shards = children(submit.id());
    assert_eq!(shards.len(), 1);
    kill(submit.id(), libc::SIGKILL);
    submit.wait().unwrap();
    let ended = eventually(Duration::from_secs(60), || (!is_alive(shards[0])).then_some(()));
    assert!(ended.is_some(), "{}", read("out"));
    let files = bench.path("results/tiny.shards").read_dir().unwrap();
    let copies =
        files.filter(|file| file.as_ref().unwrap().path().extension().is_some_and(|e| e == "sqlite"));
    assert_eq!(copies.count(), 1, "{}", read("out"));
}
