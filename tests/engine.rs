//! Nothing is lost or left behind: real processes, real signals, and databases compared row by row.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::processes::{children, eventually, is_alive, kill, rows};
use crate::common::roll::{self, Roll};
use crate::common::skip;
use metasense::link::SHARED_MEMORY;

/// A run of `metasense-bench engine` on a database in its own process; dropping it kills the process.
struct Run {
    child: Child,
    db: PathBuf,
}

impl Run {
    fn start(db: &Path, arguments: &str) -> Self {
        let child = Command::new(env!("CARGO_BIN_EXE_metasense-bench"))
            .args(["engine", "--db"])
            .arg(db)
            .args(arguments.split_whitespace())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary starts");
        Self { child, db: db.to_owned() }
    }

    /// Waits for the end; returns the exit code.
    fn wait(&mut self) -> Option<i32> {
        let ended = eventually(Duration::from_secs(60), || self.child.try_wait().unwrap());
        ended.expect("the run ends within a minute").code()
    }

    fn signal(&self, signal: i32) {
        kill(self.child.id(), signal);
    }

    /// Living worker processes.
    fn workers(&self) -> Vec<u32> {
        children(self.child.id())
    }

    /// Waits for `n` worker processes.
    fn some_workers(&self, n: usize) -> Vec<u32> {
        eventually(Duration::from_secs(20), || Some(self.workers()).filter(|workers| workers.len() >= n))
            .expect("workers start within 20 s")
    }

    /// Names in shared memory of all runs on this database, from its log.
    fn places(&self) -> Vec<String> {
        let log = std::fs::read_to_string(self.db.with_extension("log")).unwrap_or_default();
        let names = log.lines().filter_map(|line| line.split_once("place=")).map(|(_, rest)| rest);
        names.map(|rest| rest.split_whitespace().next().unwrap().trim_matches('"').to_owned()).collect()
    }

    /// Those of these names that still exist.
    fn leftovers(&self) -> Vec<String> {
        let places = self.places();
        assert!(!places.is_empty(), "the log names no place");
        let there = std::fs::read_dir(SHARED_MEMORY).unwrap().flatten();
        let there = there.map(|entry| entry.file_name().to_string_lossy().into_owned());
        there.filter(|name| places.iter().any(|place| name.starts_with(place))).collect()
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// All results of a run except times and attempts.
fn results(db: &Path) -> Vec<String> {
    [
        "SELECT hash, state, reason, error_initial, error_optimised, holdout_error_initial, holdout_error_optimised,
           best_step, simd, solver, result FROM trial ORDER BY hash",
        "SELECT t.hash, p.step, p.error_test, p.projection, p.outcome, p.fresh_samples
           FROM step p JOIN trial t ON t.id = p.trial_id ORDER BY t.hash, p.step",
        "SELECT t.hash, n.body, n.network, n.error_train, n.error_test, n.error_holdout, n.iterations, n.outcome
           FROM network n JOIN trial t ON t.id = n.trial_id ORDER BY 1, 2, 3",
        "SELECT t.hash, a.name, a.shape, hex(a.bytes)
           FROM artifact a JOIN trial t ON t.id = a.trial_id ORDER BY 1, 2",
        "SELECT count(*) FROM checkpoint",
    ]
    .iter()
    .flat_map(|sql| rows(db, sql))
    .collect()
}

const SWEEP: &str = "--trials 24 --steps 12 --step-ms 8 --array 3000 --workers 2";

/// Results of the same sweep without disturbance.
fn undisturbed(folder: &Path) -> Vec<String> {
    let mut run = Run::start(&folder.join("undisturbed.sqlite"), SWEEP);
    assert_eq!(run.wait(), Some(0));
    assert_eq!(run.leftovers(), [""; 0]);
    results(&run.db)
}

/// Fifty kills (`KILLS=N` for more, `KILL_SEED=N` to repeat) of a worker, the orchestrator, or all processes, at random moments
/// until the sweep is done.
#[test]
fn fifty_kills_at_random_moments_leave_the_results_of_an_undisturbed_run() {
    let folder = tempfile::tempdir().unwrap();
    let expected = undisturbed(folder.path());
    let least = roll::number("KILLS").unwrap_or(50);
    let (mut kills, mut sweeps, mut roll) = (0, 0, Roll::new());
    while kills < least {
        let db = folder.path().join(format!("disturbed-{sweeps}.sqlite"));
        sweeps += 1;
        loop {
            let mut run = Run::start(&db, SWEEP);
            let ended = loop {
                let workers = run.workers();
                std::thread::sleep(Duration::from_millis(5 + roll.below(150)));
                if let Some(status) = run.child.try_wait().unwrap() {
                    break Some(status);
                }
                let Some(&worker) = workers.get(roll.place(2)) else { continue };
                kills += 1;
                if roll.below(3) > 0 {
                    kill(worker, libc::SIGKILL);
                    continue;
                }
                run.signal(libc::SIGKILL);
                if roll.below(2) == 0 {
                    kill(worker, libc::SIGKILL);
                }
                let gone = || workers.iter().all(|pid| !is_alive(*pid)).then_some(());
                assert!(
                    eventually(Duration::from_secs(1), gone).is_some(),
                    "workers outlive their orchestrator"
                );
                break None;
            };
            if let Some(status) = ended {
                assert_eq!(status.code(), Some(0), "after {kills} kills");
                assert_eq!(run.leftovers(), [""; 0]);
                break;
            }
        }
        let found = results(&db);
        let differing = expected.iter().zip(&found).find(|(a, b)| a != b);
        assert_eq!(expected.len(), found.len(), "rows after {kills} kills");
        assert_eq!(differing, None, "after {kills} kills");
    }
    println!("{kills} kills in {sweeps} sweeps");
}

/// SIGINT and SIGTERM: the steps in progress are finished and recorded, nothing is left behind, and the same command resumes.
#[test]
fn a_stop_on_request_keeps_every_step_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let expected = undisturbed(folder.path());
    for (name, signals) in
        [("int", vec![libc::SIGINT]), ("term", vec![libc::SIGTERM]), ("twice", vec![libc::SIGINT; 2])]
    {
        let db = folder.path().join(format!("{name}.sqlite"));
        let mut run = Run::start(&db, SWEEP);
        let workers = run.some_workers(2);
        eventually(Duration::from_secs(20), || (rows(&db, "SELECT 1 FROM step").len() > 20).then_some(()))
            .expect("steps come in");
        let asked = Instant::now();
        for signal in signals {
            run.signal(signal);
            std::thread::sleep(Duration::from_millis(2));
        }
        assert_eq!(run.wait(), Some(4), "{name}: the exit code of a stop on request");
        assert!(asked.elapsed() < Duration::from_secs(5), "{name}: took {:?}", asked.elapsed());
        assert!(workers.iter().all(|pid| !is_alive(*pid)), "{name}: workers are left");
        assert_eq!(run.leftovers(), [""; 0], "{name}");
        assert_eq!(rows(&db, "SELECT * FROM trial WHERE state = 'running'"), [""; 0], "{name}");
        if name != "twice" {
            let open = rows(&db, "SELECT reason FROM attempt WHERE state = 'failed'");
            assert!(open.iter().all(|row| row == r#"["stopped"]"#), "{name}: {open:?}");
            // The step in progress was finished: no step occurs twice.
            let repeated = "SELECT a.trial_id FROM attempt a GROUP BY a.trial_id
                HAVING sum(a.steps) <> (SELECT count(*) FROM step p WHERE p.trial_id = a.trial_id)";
            assert_eq!(rows(&db, repeated), [""; 0], "{name}");
        }
        assert_eq!(Run::start(&db, SWEEP).wait(), Some(0));
        assert!(results(&db) == expected, "{name}: other results after going on");
    }
}

/// Steps that end within the grace time of a stop are kept; longer steps are abandoned, and a second stop does not wait.
#[test]
fn a_stop_waits_for_a_step_as_long_as_it_says() {
    let folder = tempfile::tempdir().unwrap();
    for (name, grace, signals, kept) in
        [("kept", 20_000, 1, "[1]"), ("cut", 100, 1, "[0]"), ("twice", 20_000, 2, "[0]")]
    {
        let db = folder.path().join(format!("{name}.sqlite"));
        let sweep = "--trials 1 --steps 2 --workers 1";
        let mut run = Run::start(&db, &format!("{sweep} --step-ms 2500 --grace-ms {grace}"));
        run.some_workers(1);
        let begun = || (!rows(&db, "SELECT 1 FROM attempt").is_empty()).then_some(());
        eventually(Duration::from_secs(20), begun).expect("a step begins");
        for _ in 0..signals {
            run.signal(libc::SIGINT);
            std::thread::sleep(Duration::from_millis(20));
        }
        assert_eq!(run.wait(), Some(4), "{name}");
        assert_eq!(rows(&db, "SELECT count(*) FROM step"), [kept], "{name}");
        assert_eq!(rows(&db, "SELECT state, reason FROM attempt"), [r#"["failed","stopped"]"#], "{name}");
        assert_eq!(run.leftovers(), [""; 0], "{name}");
        assert_eq!(Run::start(&db, sweep).wait(), Some(0), "{name}");
        assert_eq!(rows(&db, "SELECT count(*) FROM step"), ["[2]"], "{name}");
    }
}

/// SIGINT and SIGTERM before the first trial: exit code 4, and the sweep is not recorded partly.
#[test]
fn a_stop_while_a_large_sweep_is_recorded_ends_in_order() {
    let folder = tempfile::tempdir().unwrap();
    for (name, signal) in [("int", libc::SIGINT), ("term", libc::SIGTERM)] {
        let db = folder.path().join(format!("{name}.sqlite"));
        let mut run = Run::start(&db, "--trials 60000");
        let journal = folder.path().join(format!("{name}.sqlite-wal"));
        let growing = || fs::metadata(&journal).is_ok_and(|file| file.len() > 1 << 20).then_some(());
        eventually(Duration::from_secs(30), growing).expect("the sweep is being recorded");
        run.signal(signal);
        assert_eq!(run.wait(), Some(4), "{name}: the exit code of a stop on request");
        assert!(!journal.exists(), "{name}: the journal is left");
        assert_eq!(rows(&db, "SELECT count(*) FROM trial"), ["[0]"], "{name}");
        assert_eq!(rows(&db, "SELECT count(*) FROM sweep"), ["[0]"], "{name}");
    }
}

/// The database contains the reason of each failure by name, with its message.
#[test]
fn what_ends_an_attempt_stands_in_the_database_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        ("hang", "--fault hang --no-progress-ms 150 --retries 1", "no_progress", 2, ""),
        ("slow", "--steps 100 --step-ms 50 --time-limit-ms 300", "time_limit", 1, ""),
        ("die", "--fault die --retries 2", "worker_killed(6)", 3, ": a no-op trial that is to die"),
        ("reject", "--fault reject", "rejected", 1, ": a no-op trial that is to be refused"),
        ("nan", "--fault non-finite", "non_finite", 1, ": a no-op trial that is to fail"),
    ];
    for (name, arguments, reason, attempts, detail) in cases {
        let db = folder.path().join(format!("{name}.sqlite"));
        let mut run = Run::start(&db, &format!("--trials 1 --workers 1 {arguments}"));
        assert_eq!(run.wait(), Some(1), "{name}: the exit code of failed trials");
        let expected = vec![format!(r#"["{reason}"]"#); attempts];
        assert_eq!(rows(&db, "SELECT reason FROM attempt ORDER BY number"), expected, "{name}");
        assert_eq!(rows(&db, "SELECT state, reason FROM trial"), [format!(r#"["failed","{reason}"]"#)]);
        assert_eq!(run.leftovers(), [""; 0], "{name}");
        // the message of each attempt, after the messages of its worker
        let errors = rows(&db, "SELECT text FROM v_log WHERE level = 'error' ORDER BY attempt");
        assert_eq!(errors, vec![format!(r#"["{reason}{detail}"]"#); attempts], "{name}");
        if name == "die" {
            let lines = rows(&db, "SELECT attempt, line, level FROM v_log ORDER BY attempt, line LIMIT 2");
            assert_eq!(lines, [r#"[1,1,"warn"]"#, r#"[1,2,"error"]"#]);
        }
    }
}

/// If every trial dies on a machine, the run ends before the trials' retries are used up.
#[test]
fn ten_deaths_one_after_the_other_end_the_run_and_fail_no_trial() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("unfit.sqlite");
    let mut run = Run::start(&db, "--trials 20 --workers 2 --fault die");
    assert_eq!(run.wait(), Some(5));
    let trials =
        rows(&db, "SELECT state, count(*), (SELECT count(*) IN (10, 11) FROM attempt) FROM trial GROUP BY 1");
    assert_eq!(trials, [r#"["pending",20,1]"#]);
    assert_eq!(run.leftovers(), [""; 0]);
}

/// A shortage of the machine fails no trial: trials are retried at growing intervals, and stay pending when the run ends for it.
#[test]
fn a_shortage_ends_the_run_and_fails_no_trial() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("short.sqlite");
    let mut run = Run::start(&db, "--trials 3 --workers 2 --fault short --retries 2");
    assert_eq!(run.wait(), Some(5));
    assert_eq!(rows(&db, "SELECT DISTINCT state FROM trial"), [r#"["pending"]"#]);
    assert_eq!(rows(&db, "SELECT DISTINCT reason FROM attempt"), [r#"["shortage"]"#]);
    let said = rows(&db, "SELECT text FROM log");
    assert!(said.iter().all(|line| line.contains("of what a no-op trial is to be short of")), "{said:?}");
    assert_eq!(run.leftovers(), [""; 0]);
    assert_eq!(Run::start(&db, "--trials 3 --workers 2").wait(), Some(0), "the same run goes on");
}

/// Results that do not fit into shared memory; the run has its own, small one.
#[test]
fn a_full_shared_memory_is_a_reason_of_its_own() {
    if !rustix::process::geteuid().is_root()
        || !Command::new("unshare").args(["-m", "true"]).status().is_ok_and(|s| s.success())
    {
        eprintln!("not run: only root can have a shared memory of its own");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("s.sqlite");
    let arguments = "--trials 1 --workers 1 --retries 1 --array 6000000";
    let command = format!(
        "mount -t tmpfs -o size=40m tmpfs {SHARED_MEMORY} && exec {} engine --db {} {arguments}",
        env!("CARGO_BIN_EXE_metasense-bench"),
        db.display()
    );
    let ended = Command::new("unshare").args(["-m", "bash", "-c", &command]).output().unwrap();
    assert_eq!(ended.status.code(), Some(5), "{}", String::from_utf8_lossy(&ended.stderr));
    assert_eq!(rows(&db, "SELECT reason FROM attempt"), vec![r#"["shared_memory_full"]"#; 2]);
    assert_eq!(rows(&db, "SELECT state FROM trial"), [r#"["pending"]"#]);
    let said = rows(&db, "SELECT text FROM log");
    assert!(said.iter().any(|line| line.contains("making room failed")), "{said:?}");
}

/// A death is detected and its worker replaced in less than a second.
#[test]
fn a_dead_worker_is_replaced_within_a_second() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::start(&folder.path().join("s.sqlite"), "--trials 2 --steps 1000 --step-ms 20 --workers 1");
    let [worker] = run.some_workers(1)[..] else { panic!("one worker") };
    kill(worker, libc::SIGKILL);
    let another = || run.workers().into_iter().find(|pid| *pid != worker);
    assert!(eventually(Duration::from_secs(1), another).is_some(), "no new worker after a second");
}

/// The file of a worker killed between `shm_open` and `ftruncate` would hang iceoryx2's own clean-up.
#[test]
fn an_empty_connection_file_of_a_killed_worker_is_in_nobodys_way() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = Run::start(&folder.path().join("s.sqlite"), SWEEP);
    for round in 1..4 {
        let workers = run.some_workers(2);
        let place = eventually(Duration::from_secs(5), || run.places().pop()).expect("a place");
        for slot in 0..2 {
            for generation in 1..4 {
                let name = format!("{place}_{slot}.{generation}_1234567_89.connection");
                let _ = fs::File::create_new(Path::new(SHARED_MEMORY).join(name));
            }
        }
        kill(workers[round % 2], libc::SIGKILL);
        let replaced = || run.workers().iter().any(|pid| !workers.contains(pid)).then_some(());
        assert!(eventually(Duration::from_secs(2), replaced).is_some(), "no new worker in round {round}");
    }
    assert_eq!(run.wait(), Some(0));
    assert_eq!(run.leftovers(), [""; 0]);
}

/// A worker that neither reads nor sends heartbeats, but lives, is killed at its deadline.
#[test]
fn a_stopped_worker_is_ended_by_its_deadline() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = "--trials 4 --steps 20 --step-ms 10 --workers 1 --no-progress-ms 300";
    let mut run = Run::start(&folder.path().join("s.sqlite"), arguments);
    let [worker] = run.some_workers(1)[..] else { panic!("one worker") };
    eventually(Duration::from_secs(20), || (!rows(&run.db, "SELECT 1 FROM step").is_empty()).then_some(()));
    kill(worker, libc::SIGSTOP);
    assert_eq!(run.wait(), Some(0));
    let reasons = rows(&run.db, "SELECT reason FROM attempt WHERE state = 'failed'");
    assert_eq!(reasons, [r#"["no_progress"]"#]);
}

/// The run is stopped (SIGSTOP, a debugger, a suspended machine) for longer than the silence limit, with or without its workers: no
/// worker counts as dead, and no step is repeated.
#[test]
fn a_run_that_was_stopped_ends_no_worker_on_waking() {
    let folder = tempfile::tempdir().unwrap();
    for with_workers in [false, true] {
        let db = folder.path().join(format!("stopped-{with_workers}.sqlite"));
        // More than a second, the maximum that one interval between checks counts for.
        let sweep = "--trials 4 --steps 100 --step-ms 20 --workers 2 --no-progress-ms 1500";
        let mut run = Run::start(&db, sweep);
        let workers = run.some_workers(2);
        eventually(Duration::from_secs(20), || (rows(&db, "SELECT 1 FROM step").len() > 20).then_some(()))
            .expect("steps come in");
        let stopped = if with_workers { &workers[..] } else { &[] };
        run.signal(libc::SIGSTOP);
        stopped.iter().for_each(|pid| kill(*pid, libc::SIGSTOP));
        std::thread::sleep(Duration::from_millis(2500));
        run.signal(libc::SIGCONT);
        if with_workers {
            // Workers stop after the run.
            std::thread::sleep(Duration::from_millis(200));
        }
        stopped.iter().for_each(|pid| kill(*pid, libc::SIGCONT));
        assert_eq!(run.wait(), Some(0));
        assert_eq!(rows(&db, "SELECT number, reason FROM attempt WHERE state = 'failed'"), [""; 0]);
        assert_eq!(rows(&db, "SELECT DISTINCT number FROM attempt"), ["[1]"]);
    }
}

/// The next run removes segments and directories of dead runs, but not of living runs.
#[test]
fn leftovers_of_dead_runs_are_removed_and_living_runs_are_not() {
    let shared = Path::new(SHARED_MEMORY);
    let id = format!("metasense-dead{:06x}", std::process::id());
    fs::create_dir(shared.join(&id)).unwrap();
    fs::write(shared.join(&id).join("lock"), "").unwrap();
    fs::write(shared.join(format!("{id}_0.1_1.connection")), "").unwrap();
    let orphan = shared.join(format!("metasense-gone{:06x}_0.1_1.data", std::process::id()));
    fs::write(&orphan, "x").unwrap();
    let alive = format!("metasense-live{:06x}", std::process::id());
    fs::create_dir(shared.join(&alive)).unwrap();
    let lock = fs::File::create(shared.join(&alive).join("lock")).unwrap();
    lock.lock().unwrap();

    let folder = tempfile::tempdir().unwrap();
    assert_eq!(Run::start(&folder.path().join("s.sqlite"), "--trials 1").wait(), Some(0));
    let there: Vec<String> = fs::read_dir(shared)
        .unwrap()
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.starts_with(&id) || shared.join(name) == orphan)
        .collect();
    assert_eq!(there, [""; 0]);
    assert!(shared.join(&alive).join("lock").exists(), "a living run was removed");
    fs::remove_dir_all(shared.join(&alive)).unwrap();
}

/// Leftovers of another user cannot be removed, but do not block a run. Only root can act as two users.
#[test]
fn a_stale_run_of_another_user_is_in_nobodys_way() {
    if !rustix::process::geteuid().is_root() {
        return skip::skipped("a_stale_run_of_another_user_is_in_nobodys_way", "this is not root");
    }
    let shared = Path::new(SHARED_MEMORY);
    let id = format!("metasense-root{:06x}", std::process::id());
    fs::create_dir(shared.join(&id)).unwrap();
    fs::set_permissions(shared.join(&id), fs::Permissions::from_mode(0o700)).unwrap();
    fs::write(shared.join(&id).join("lock"), "").unwrap();
    let segment = shared.join(format!("{id}_0.1_1.connection"));
    fs::write(&segment, "").unwrap();
    // Locked, because other tests of this binary run as root and would remove it.
    let lock = fs::File::open(shared.join(&id).join("lock")).unwrap();
    lock.lock().unwrap();

    let folder = tempfile::tempdir().unwrap();
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o777)).unwrap();
    let binary = folder.path().join("metasense");
    fs::copy(env!("CARGO_BIN_EXE_metasense-bench"), &binary).unwrap();
    let db = folder.path().join("s.sqlite");
    let ended = Command::new(binary)
        .args(["engine", "--trials", "3", "--db"])
        .arg(&db)
        .uid(65534)
        .gid(65534)
        .output()
        .unwrap();
    assert!(ended.status.success(), "{ended:?}");
    assert!(segment.exists(), "removed what another user owns");
    fs::remove_file(segment).unwrap();
    fs::remove_dir_all(shared.join(&id)).unwrap();
}

/// A worker of another build ends at once with its own exit code and changes nothing.
#[test]
fn a_worker_of_another_build_does_not_connect() {
    let start = r#"{"root": "/nowhere", "prefix": "x_", "build": "another", "parent": 1, "niceness": 0, "memory_mib": null, "simd": "baseline"}"#;
    let ended = Command::new(env!("CARGO_BIN_EXE_metasense-bench")).args(["worker", start]).output().unwrap();
    assert_eq!(ended.status.code(), Some(metasense_worker::process::OTHER_BUILD));
    assert!(String::from_utf8_lossy(&ended.stderr).contains("build another"), "{ended:?}");
}

/// One writer and many readers: neither gets a lock error.
#[test]
fn a_reader_that_queries_all_the_time_meets_no_lock() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = Run::start(&folder.path().join("s.sqlite"), "--trials 120 --steps 2 --workers 2");
    run.some_workers(1);
    let mut queries = 0;
    while run.child.try_wait().unwrap().is_none() {
        rows(&run.db, "SELECT count(*), sum(error_optimised) FROM v_trial");
        queries += 1;
    }
    assert_eq!(run.wait(), Some(0));
    assert!(queries > 3, "{queries} queries");
    assert_eq!(rows(&run.db, "SELECT count(*) FROM trial WHERE state = 'done'"), ["[120]"]);
}

/// A full disk (here: a limit on file sizes): exit code 3, a message, and nothing is partly written.
#[test]
fn a_full_disk_ends_the_run_in_order_and_room_lets_it_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("s.sqlite");
    let sweep = "--trials 600 --steps 6 --workers 2 --array 4000";
    let command = format!(
        "ulimit -f 9000; exec {} engine --db {} {sweep}",
        env!("CARGO_BIN_EXE_metasense-bench"),
        db.display()
    );
    let ended = Command::new("timeout").args(["-s", "KILL", "60", "bash", "-c", &command]).output().unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(3), "{said}");
    assert!(said.contains("database") && said.contains("ulimit -f"), "{said}");
    assert_eq!(children(std::process::id()).into_iter().filter(|pid| is_metasense(*pid)).count(), 0);
    assert_eq!(rows(&db, "PRAGMA integrity_check"), [r#"["ok"]"#]);
    assert_eq!(Run::start(&db, sweep).wait(), Some(0));
    assert_eq!(rows(&db, "SELECT count(*) FROM trial WHERE state = 'done'"), ["[600]"]);
    // a worker at the same limit: the shortage is the machine's, not the trial's
    let db = folder.path().join("large.sqlite");
    let large = format!("--trials 1 --workers 1 --retries 1 --array 300000 --db {}", db.display());
    let command = format!("ulimit -f 9000; exec {} engine {large}", env!("CARGO_BIN_EXE_metasense-bench"));
    let ended = Command::new("bash").args(["-c", &command]).output().unwrap();
    assert_eq!(ended.status.code(), Some(5), "{}", String::from_utf8_lossy(&ended.stderr));
    assert_eq!(rows(&db, "SELECT DISTINCT reason FROM attempt"), [r#"["shortage"]"#]);
    let said = rows(&db, "SELECT text FROM log");
    assert!(said.iter().any(|line| line.contains("ulimit -f")), "{said:?}");
}

/// Whether a process is a worker that this test has orphaned.
fn is_metasense(pid: u32) -> bool {
    fs::read_to_string(format!("/proc/{pid}/cmdline")).is_ok_and(|line| line.contains("\0worker\0"))
}
