//! Shortages of the machine are named before the first worker starts; no trial fails for them, and with more resources the same
//! command resumes.

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::process::{Command, Output};

use crate::common::{Bench, TINY, skip};

const PROGRAM: &str = env!("CARGO_BIN_EXE_metasense");
/// A user without other processes.
const NOBODY: u32 = 64_123;

/// Runs the program in a shell after other commands.
fn after(bench: &Bench, before: &str, arguments: &str) -> Command {
    let mut command = Command::new("bash");
    command.args(["-c", &format!("{before}; exec {PROGRAM} {arguments}")]).current_dir(bench.path(""));
    command
}

fn stderr_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Checks for exit code 5, the limit's name, and no failed trial.
fn refused(bench: &Bench, output: &Output, limit: &str) {
    let message = stderr_text(output);
    assert_eq!(output.status.code(), Some(5), "{limit}: {message}");
    assert!(message.contains(limit), "{limit}: {message}");
    let db = bench.path("results/tiny.sqlite");
    if db.exists() {
        let charged = "SELECT count(*) FROM v_attempt";
        assert_eq!(bench.number("results/tiny.sqlite", charged), 0, "{limit}: {message}");
    }
}

/// File descriptors, file sizes, memory, stack, threads: each limit is refused by name before a worker starts.
#[test]
fn limits_of_the_shell_are_named_before_the_first_worker_starts() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    let run = "run tiny.toml --workers 2 --threads 2";
    for (before, limit) in [
        ("ulimit -n 5", "ulimit -n"),
        ("ulimit -n 60", "ulimit -n"),
        ("ulimit -f 1", "ulimit -f"),
        ("ulimit -f 5000", "ulimit -f"),
        ("ulimit -v 100000", "ulimit -v"),
        ("ulimit -d 10000", "ulimit -d"),
        ("ulimit -d 40000", "ulimit -d"),
        ("ulimit -s 64", "ulimit -s"),
    ] {
        refused(&bench, &after(&bench, before, run).output().unwrap(), limit);
    }
    let done = after(&bench, "ulimit -Ss 64; ulimit -Sn 30", run).output().unwrap();
    assert!(done.status.success(), "what may be raised is: {}", stderr_text(&done));
}

/// The kernel limits the threads of all users except root.
#[test]
fn a_limit_on_threads_is_named_before_the_first_worker_starts() {
    let who = "a_limit_on_threads_is_named_before_the_first_worker_starts";
    let mut tried = Command::new(PROGRAM);
    if !rustix::process::geteuid().is_root() || tried.arg("--version").uid(NOBODY).output().is_err() {
        return skip::skipped(who, "this is not root, or another user cannot start the program");
    }
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    std::fs::set_permissions(bench.path(""), PermissionsExt::from_mode(0o777)).unwrap();
    let run = |most: u32, threads: u32| {
        let run = format!("run tiny.toml --workers 2 --threads {threads}");
        after(&bench, &format!("ulimit -u {most}"), &run).uid(NOBODY).gid(NOBODY).output().unwrap()
    };
    refused(&bench, &run(1, 1), "ulimit -u");
    refused(&bench, &run(60, 60), "ulimit -u");
    let done = run(60, 1);
    assert!(done.status.success(), "{}", stderr_text(&done));
}

/// Mounted disks that are full, without inodes, or noexec; and a small shared memory.
#[test]
fn disks_without_room_are_named_before_the_first_worker_starts() {
    let who = "disks_without_room_are_named_before_the_first_worker_starts";
    let own = Command::new("unshare").args(["-m", "true"]).output();
    if !rustix::process::geteuid().is_root() || !own.is_ok_and(|output| output.status.success()) {
        return skip::skipped(who, "only root can mount disks");
    }
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    std::fs::create_dir(bench.path("results")).unwrap();
    let call = |mount: &str, arguments: &str| {
        let script = format!("mount -t tmpfs {mount} && exec {PROGRAM} {arguments}");
        let mut command = Command::new("unshare");
        command.args(["-m", "bash", "-c", &script]).current_dir(bench.path("")).output().unwrap()
    };
    let run = "run tiny.toml --workers 2";
    refused(&bench, &call("-o size=2m tmpfs results", run), "results");
    refused(&bench, &call("-o nr_inodes=4 tmpfs results", run), "df -i");
    refused(&bench, &call("-o size=2m tmpfs /dev/shm", run), "/dev/shm");
    refused(&bench, &call("-o nr_inodes=20 tmpfs /dev/shm", run), "df -i");
    refused(
        &bench,
        &call("-o nr_inodes=4 tmpfs results", "run tiny.toml --shard 1/2 --folder results/s"),
        "df -i",
    );
    // SQLite's temporary data stays in memory
    std::fs::create_dir(bench.path("full")).unwrap();
    let full = "-o size=4k tmpfs full && export TMPDIR=$PWD/full";
    let done = call(full, "run tiny.toml --db t.sqlite --workers 2");
    assert!(done.status.success(), "{}", stderr_text(&done));
    let submitted = call("-o noexec tmpfs results", "cluster submit local tiny.toml --shards 2 --cpus 1");
    assert_eq!(submitted.status.code(), Some(2), "{}", stderr_text(&submitted));
    assert!(
        stderr_text(&submitted).contains("noexec") && stderr_text(&submitted).contains("--folder"),
        "{}",
        stderr_text(&submitted)
    );
}

/// If the machine lacks memory, trials are retried and stay pending. With the worker's own limit, the trial would fail, as on every
/// machine.
#[test]
fn a_trial_that_the_machine_has_no_memory_for_stays_pending() {
    let bench = Bench::new();
    let text = TINY.replace("sensors = [1, 2]", "sensors = [4]").replace("samples = 20", "samples = 250");
    bench.file("tiny.toml", &text.replace("[sweep]", "[run]\nretries = 1\nbackoff = 0.1\n[sweep]"));
    let short = after(&bench, "ulimit -d 122880", "run tiny.toml --workers 1").output().unwrap();
    assert_eq!(short.status.code(), Some(5), "{}", stderr_text(&short));
    assert!(stderr_text(&short).contains("memory allocation of"), "{}", stderr_text(&short));
    let rows = |sql: &str| bench.output(&["query", "results/tiny.sqlite", sql, "--format", "csv"]);
    assert_eq!(rows("SELECT DISTINCT state FROM v_trial"), "state\npending\n");
    assert_eq!(rows("SELECT reason FROM v_attempt"), "reason\nout_of_memory\nout_of_memory\n");
    bench.output(&["run", "tiny.toml"]);
}
