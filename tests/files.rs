//! Files of a database during a run and for readers: removed, locked, damaged, read-only.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::common::processes::{eventually, kill};
use crate::common::{Bench, TINY, results, without_cost};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Executor};

/// A sweep that ends only by request.
fn endless() -> String {
    TINY.replace("iterations = 4\n", "iterations = 100000\nbrain = \"linear\"\n")
        .replace("iterations = 10\nwidth = 16", "kind = \"linear\"")
}

/// Executes SQL on a database as another program would.
pub fn execute(db: &Path, sql: &str) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let options =
            SqliteConnectOptions::new().filename(db).foreign_keys(false).disable_statement_logging();
        let mut connection = options.connect().await.unwrap();
        connection.execute(AssertSqlSafe(sql.to_owned())).await.unwrap();
        connection.close().await.unwrap();
    });
}

fn begin(bench: &Bench, args: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    command.args(args).current_dir(bench.path("")).stdout(Stdio::null()).stderr(Stdio::piped());
    command.spawn().unwrap()
}

fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !holds() {
        assert!(begun.elapsed() < Duration::from_secs(60), "{what}: not after a minute");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The message names a database with all recorded steps.
#[test]
fn a_database_taken_away_under_a_run_ends_it_within_seconds_and_is_saved() {
    let bench = Bench::new();
    bench.file("tiny.toml", &endless());
    bench.file("other.txt", "another");
    let steps = |db: &str| bench.number(db, "SELECT count(*) FROM step");
    let runs = ["deleted", "replaced"].map(|name| {
        let db = format!("{name}.sqlite");
        (name, db.clone(), begin(&bench, &["run", "tiny.toml", "--db", &db, "--workers", "1"]))
    });
    for (name, db, run) in runs {
        until("steps", || steps(&db) > 2);
        let before = steps(&db);
        match name {
            "deleted" => std::fs::remove_file(bench.path(&db)).unwrap(),
            _ => std::fs::rename(bench.path("other.txt"), bench.path(&db)).unwrap(),
        }
        let output = run.wait_with_output().unwrap();
        let said = said(&output);
        assert_eq!(output.status.code(), Some(3), "{name}: {said}");
        let names = std::fs::read_dir(bench.path(""))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let saved = names.into_iter().find(|file| file.starts_with(&format!("{name}.saved")));
        let saved = saved.unwrap_or_else(|| panic!("{name}: nothing is saved: {said}"));
        assert!(said.contains(&db) && said.contains(&saved), "{name}: {said}");
        assert!(steps(&saved) >= before, "{name}: {} of {before} steps", steps(&saved));
        if name == "replaced" {
            assert_eq!(std::fs::read(bench.path(&db)).unwrap(), b"another");
        }
    }
}

/// A short lock of another program does not end the run; a lock that stays ends it after `run.lock_wait`.
#[tokio::test]
async fn a_foreign_lock_is_waited_for_and_one_that_stays_ends_the_run() {
    let bench = Bench::new();
    bench.file("tiny.toml", &endless());
    let options = SqliteConnectOptions::new().filename(bench.path("a.sqlite")).disable_statement_logging();
    let mut run =
        begin(&bench, &["run", "tiny.toml", "--db", "a.sqlite", "--workers", "1", "run.lock_wait=1"]);
    let deadline = Instant::now() + Duration::from_secs(60);
    let more_than = async |steps_before: u64| {
        let options = options.clone().read_only(true);
        loop {
            let asked = async {
                let mut other = options.connect().await.ok()?;
                let steps: Option<i64> =
                    sqlx::query_scalar("SELECT count(*) FROM step").fetch_one(&mut other).await.ok();
                other.close().await.ok()?;
                steps
            };
            if let Some(steps) = asked.await.filter(|steps| *steps as u64 > steps_before) {
                return steps as u64;
            }
            assert!(Instant::now() < deadline, "no step more than {steps_before}");
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    let before = more_than(2).await;
    let mut other = options.clone().busy_timeout(Duration::from_secs(30)).connect().await.unwrap();
    // shorter than the wait limit
    for sql in ["BEGIN IMMEDIATE", "ROLLBACK"] {
        other.execute(sql).await.unwrap();
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    more_than(before + 1).await;
    assert!(run.try_wait().unwrap().is_none(), "a short lock has ended the run");
    other.execute("BEGIN EXCLUSIVE").await.unwrap();
    let output = tokio::task::spawn_blocking(|| run.wait_with_output().unwrap()).await.unwrap();
    let said = said(&output);
    assert!(
        output.status.code() == Some(3) && said.contains("a.sqlite") && said.contains("lock_wait"),
        "{said}"
    );
    other.execute("ROLLBACK").await.unwrap();
    other.close().await.unwrap();
}

/// A trial with a damaged checkpoint is named and restarted, with the same bits. A damaged array is not exported.
#[test]
fn a_damaged_checkpoint_is_named_and_changes_no_result() {
    let bench = Bench::new();
    bench.file("tiny.toml", &TINY.replace("iterations = 4", "iterations = 400"));
    bench.output(&["run", "tiny.toml", "--db", "whole.sqlite", "sweep.sensors=[1]"]);
    let hash = "SELECT hash FROM v_trial";
    let hash =
        bench.output(&["query", "whole.sqlite", hash, "--format", "csv"]).lines().nth(1).unwrap().to_owned();
    // stopped after its second step
    let mut run =
        begin(&bench, &["run", "tiny.toml", "--db", "cut.sqlite", "sweep.sensors=[1]", "--workers", "1"]);
    until("a checkpoint", || {
        bench.number("cut.sqlite", "SELECT count(*) FROM checkpoint WHERE step > 1") > 0
    });
    run.kill().unwrap();
    run.wait().unwrap();
    let flip =
        "UPDATE checkpoint SET bytes = CAST(substr(bytes, 1, 100) || x'5a' || substr(bytes, 102) AS BLOB)";
    execute(&bench.path("cut.sqlite"), flip);
    let output = bench.metasense(&["run", "tiny.toml", "--db", "cut.sqlite", "sweep.sensors=[1]"]);
    let said = said(&output);
    assert!(output.status.success() && said.contains(&hash[..8]) && said.contains("checksum"), "{said}");
    assert_eq!(results(&bench, "cut.sqlite"), results(&bench, "whole.sqlite"));
    // damage to arrays
    execute(
        &bench.path("cut.sqlite"),
        "UPDATE artifact SET bytes = zeroblob(length(bytes)) WHERE name = 'alpha_optimised'",
    );
    for words in [
        &["export", "cut.sqlite", &hash, "--format", "stl", "--out", "x.stl"][..],
        &["export", "cut.sqlite", &hash, "--format", "npz", "--out", "x.npz"],
    ] {
        let output = bench.metasense(words);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{words:?}: {said}");
        assert!(said.contains(&hash) && said.contains("alpha_optimised"), "{words:?}: {said}");
    }
    assert!(!bench.path("x.stl").exists() && !bench.path("x.npz").exists());
}

/// Runs the program as a user who owns none of the files.
fn as_other(bench: &Bench, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    command.args(args).current_dir(bench.path(""));
    if rustix::process::geteuid().is_root() {
        command.uid(65534).gid(65534);
    }
    command.output().unwrap()
}

/// Finished databases and those of a killed run can be read without write permission. No file changes.
#[tokio::test]
async fn a_database_that_may_not_be_written_is_read() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.output(&["run", "tiny.toml", "--db", "new.sqlite", "sweep.sensors=[1]"]);
    // as after a kill: the files are copied before the connection is closed
    let options = SqliteConnectOptions::new().filename(bench.path("new.sqlite")).disable_statement_logging();
    let mut left = options.connect().await.unwrap();
    left.execute("UPDATE trial SET reason = NULL").await.unwrap();
    for end in ["", "-wal"] {
        std::fs::copy(bench.path(&format!("new.sqlite{end}")), bench.path(&format!("left.sqlite{end}")))
            .unwrap();
    }
    left.close().await.unwrap();
    let before = bench.files("");
    let mode = |file: u32, folder: u32| {
        for (name, _) in &before {
            std::fs::set_permissions(bench.path(name), PermissionsExt::from_mode(file)).unwrap();
        }
        std::fs::set_permissions(bench.path(""), PermissionsExt::from_mode(folder)).unwrap();
    };
    // a read-only folder; or a folder that others may write, where their files would lock out the owner
    for (file, folder) in [(0o444, 0o555), (0o444, 0o777)] {
        mode(file, folder);
        for db in ["new.sqlite", "left.sqlite"] {
            for words in [
                &["query", db, "SELECT count(*) FROM v_trial"][..],
                &["status", db],
                &["analyse", db, "--question", "seconds"],
            ] {
                let output = as_other(&bench, words);
                assert!(output.status.success(), "{words:?}: {}", said(&output));
            }
        }
        if folder == 0o777 && !rustix::process::geteuid().is_root() {
            continue; // the owner may write
        }
        assert!(bench.files("") == before, "{folder:o}: something was changed");
    }
    mode(0o644, 0o755);
}

/// The message names a cell that is not JSON, and its trial. `run` replaces a damaged spec.
#[test]
fn a_cell_without_json_is_named() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.output(&["run", "tiny.toml", "--db", "s.sqlite"]);
    let hash = bench.output(&[
        "query",
        "s.sqlite",
        "SELECT hash FROM v_trial ORDER BY sensors DESC",
        "--format",
        "csv",
    ]);
    let hash = hash.lines().nth(1).unwrap();
    for column in ["spec", "result"] {
        execute(
            &bench.path("s.sqlite"),
            &format!("UPDATE trial SET {column} = substr({column}, 1, 50) WHERE hash = '{hash}'"),
        );
        for words in
            [&["query", "s.sqlite", "SELECT * FROM v_trial"][..], &["report", "s.sqlite", "--out", "r.html"]]
        {
            let output = bench.metasense(words);
            let said = said(&output);
            assert_eq!(output.status.code(), Some(3), "{words:?}: {said}");
            assert!(said.contains(hash) && said.contains(column), "{words:?}: {said}");
        }
        if column == "spec" {
            bench.output(&["run", "tiny.toml", "--db", "s.sqlite"]);
            bench.output(&["query", "s.sqlite", "SELECT * FROM v_trial"]);
        }
    }
    bench.output(&["remove", "s.sqlite", &format!("hash={hash}"), "--yes"]);
    bench.output(&["query", "s.sqlite", "SELECT * FROM v_trial"]);
}

/// A spec may come from a pipe. A signal ends the wait for it.
#[test]
fn a_spec_is_read_from_a_pipe() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    let script = "cat tiny.toml | \"$0\" expand /dev/stdin --format csv";
    let mut shell = Command::new("sh");
    shell.args(["-c", script, env!("CARGO_BIN_EXE_metasense")]).current_dir(bench.path(""));
    let output = shell.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    let expected = bench.output(&["expand", "tiny.toml", "--format", "csv"]);
    let [found, expected] =
        [&*text, &*expected].map(|text| text.lines().map(without_cost).collect::<Vec<_>>());
    assert_eq!(found, expected, "{}", said(&output));

    let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
    command.args(["run", "/dev/stdin"]).current_dir(bench.path("")).stdin(Stdio::piped());
    let mut run = command.spawn().unwrap();
    std::thread::sleep(Duration::from_millis(500));
    kill(run.id(), libc::SIGTERM);
    let ended = eventually(Duration::from_secs(20), || run.try_wait().unwrap());
    assert!(ended.is_some(), "the run waits for its spec");
}

/// A path that SQLite cannot use is refused by name, and no file is left.
#[test]
fn a_path_that_sqlite_cannot_use_leaves_no_file() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    let odd = bench.path("").join(OsStr::from_bytes(b"odd-\xff"));
    std::fs::create_dir(&odd).unwrap();
    // with -wal, the last is longer than a name may be
    let name = "x".repeat(253);
    for (db, told) in [
        (odd.join("s.sqlite"), "odd-\\xFF"),
        (Path::new(OsStr::from_bytes(b"s\xff.sqlite")).to_owned(), "s\\xFF.sqlite"),
        (Path::new(&name).to_owned(), name.as_str()),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
        command.args(["run", "tiny.toml", "--db"]).arg(&db).current_dir(bench.path(""));
        let output = command.output().unwrap();
        let said = said(&output);
        assert!(output.status.code() == Some(2) && said.contains(told), "{told}: {said}");
        assert!(!bench.path("").join(&db).exists(), "{told}: {said}");
    }
    assert_eq!(std::fs::read_dir(bench.path("")).unwrap().count(), 2);
}
