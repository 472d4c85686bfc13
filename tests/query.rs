//! `query` runs SQL and changes nothing.

use std::io::Read;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::common::{Bench, SPEC, TINY};
use crate::synthetic;
use metasense::plan::Plan;
use metasense::store::Store;
use metasense_schemas::record::{Checkpoint, StepRecord};
use parquet::basic::{LogicalType, Type};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::schema::types::ColumnDescPtr;

/// A database with the two trials of the spec, both pending.
async fn database(bench: &Bench) {
    let plan = Plan::new("s.toml", SPEC.into()).unwrap();
    let mut store = Store::open(bench.path("s.sqlite")).await.unwrap();
    store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await.unwrap();
    store.close().await.unwrap();
}

#[tokio::test]
async fn rows_come_in_every_form() {
    let bench = Bench::new();
    database(&bench).await;
    let sql = "SELECT panels, sensors, state, error_initial, spec->>'$.body.columns' AS columns FROM v_trial";
    insta::assert_snapshot!(bench.output(&["query", "s.sqlite", sql]), @r"
    | panels | sensors | state   | error_initial | columns |
    |--------|---------|---------|---------------|---------|
    |      2 |       1 | pending |               |       6 |
    |      2 |       2 | pending |               |       6 |
    ");
    insta::assert_snapshot!(bench.output(&["query", "s.sqlite", sql, "--format", "csv"]), @r"
    panels,sensors,state,error_initial,columns
    2,1,pending,,6
    2,2,pending,,6
    ");
    let rows: serde_json::Value =
        serde_json::from_str(&bench.output(&["query", "s.sqlite", sql, "--format", "json"])).unwrap();
    assert_eq!(rows[1]["sensors"], 2, "{rows}");
    assert!(rows[1]["error_initial"].is_null(), "{rows}");
    let parquet = ["query", "s.sqlite", sql, "--format", "parquet", "--out", "rows.parquet"];
    assert_eq!(bench.output(&parquet), "");
    let bytes = std::fs::read(bench.path("rows.parquet")).unwrap();
    assert!(bytes.starts_with(b"PAR1") && bytes.ends_with(b"PAR1"), "{} bytes", bytes.len());
    let none = bench.output(&["query", "s.sqlite", "SELECT 1 WHERE 0", "--format", "json"]);
    assert_eq!(serde_json::from_str::<serde_json::Value>(&none).unwrap(), serde_json::json!([]));
    for view in ["v_trial", "v_step", "v_curve", "v_attempt", "v_error_time"] {
        assert!(bench.output(&["query", "s.sqlite"]).contains(view), "{view}");
    }
    let views = ["query", "s.sqlite", "--format", "csv", "--out", "views.csv"];
    assert_eq!(bench.output(&views), "");
    assert_eq!(std::fs::read_to_string(bench.path("views.csv")).unwrap(), bench.output(&views[..4]));
}

/// Parquet files of a view have the same types whatever the database contains, also without rows.
#[tokio::test]
async fn a_view_has_the_same_types_in_every_file() {
    let bench = Bench::new();
    database(&bench).await;
    let full = bench.path("full.sqlite");
    tokio::task::spawn_blocking(move || synthetic::write(&full)).await.unwrap();
    let types = |db: &str, sql: &str| {
        bench.output(&["query", db, sql, "--format", "parquet", "--out", "rows.parquet"]);
        let file = std::fs::File::open(bench.path("rows.parquet")).unwrap();
        let reader = SerializedFileReader::new(file).unwrap();
        let columns = reader.metadata().file_metadata().schema_descr().columns().to_vec();
        let of = |column: &ColumnDescPtr| {
            (column.name().to_owned(), column.physical_type(), column.logical_type_ref().cloned())
        };
        columns.iter().map(of).collect::<Vec<_>>()
    };
    for view in ["v_trial", "v_step", "v_network", "v_run", "v_cast"] {
        let all = format!("SELECT * FROM {view}");
        let expected = types("full.sqlite", &all);
        assert!(
            expected.iter().all(|(_, _, logical)| *logical != Some(LogicalType::Unknown)),
            "{expected:?}"
        );
        assert_eq!(types("s.sqlite", &all), expected, "{view}");
        assert_eq!(types("full.sqlite", &format!("{all} WHERE 0")), expected, "{view}");
    }
    let untyped =
        types("s.sqlite", "SELECT avg(seconds) AS a, CAST(avg(seconds) AS REAL) AS b FROM v_trial WHERE 0");
    let [(_, _, a), (_, b, _)] = &untyped[..] else { panic!("{untyped:?}") };
    assert_eq!((a, *b), (&Some(LogicalType::Unknown), Type::DOUBLE));
}

/// SQL has geometric means, medians and quantiles, also of infinite values.
#[tokio::test]
async fn errors_are_averaged_and_ranked_in_sql() {
    let bench = Bench::new();
    database(&bench).await;
    let sql = "WITH errors(e) AS (VALUES (1.0), (2.0), (4.0), (8.0)) SELECT round(exp(avg(ln(e))), 6) AS geomean, \
               median(e) AS median, round(percentile(e, 90), 6) AS p90, sqrt(pow(2, 4)) AS four, \
               (SELECT median(column1) FROM (VALUES (9e999), (9e999))) AS endless FROM errors";
    insta::assert_snapshot!(bench.output(&["query", "s.sqlite", sql, "--format", "csv"]), @r"
    geomean,median,p90,four,endless
    2.828427,3.0,6.8,4.0,inf
    ");
}

/// A query cannot overwrite its database under any name, another database or a spec; a failing query keeps the earlier rows.
#[tokio::test]
async fn what_is_read_and_what_was_there_stay() {
    let bench = Bench::new();
    database(&bench).await;
    std::fs::hard_link(bench.path("s.sqlite"), bench.path("link.sqlite")).unwrap();
    std::fs::copy(bench.path("s.sqlite"), bench.path("other.sqlite")).unwrap();
    std::fs::write(bench.path("s.toml"), SPEC).unwrap();
    std::fs::write(bench.path("rows.csv"), "former").unwrap();
    let read = |name: &str| std::fs::read(bench.path(name)).unwrap();
    let kept = ["s.sqlite", "other.sqlite", "s.toml", "rows.csv"];
    let before = kept.map(read);
    for (words, why) in [
        (&["query", "s.sqlite", "SELECT 1", "--out", "s.sqlite"][..], "`query` reads this file"),
        (&["query", "s.sqlite", "SELECT 1", "--out=link.sqlite"], "`query` reads this file"),
        (&["query", "s.sqlite", "SELECT 1", "--out", "other.sqlite"], "it is a database"),
        (&["report", "s.sqlite", "--out", "./s.sqlite"], "`report` reads this file"),
        (&["report", "s.sqlite", "--out", "other.sqlite"], "it is a database"),
        (&["body", "draw", "s.toml", "--out", "s.toml"], "`draw` reads this file"),
        (&["query", "s.sqlite", "SELECT FROM", "--format", "csv", "--out", "rows.csv"], "syntax error"),
    ] {
        let output = bench.metasense(words);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(why), "{words:?}: {said}");
    }
    assert!(kept.map(read) == before);
    assert_eq!(std::fs::read_dir(bench.path("")).unwrap().count(), 5, "nothing is left beside");
}

#[tokio::test]
async fn nothing_can_be_changed_and_no_file_is_left() {
    let bench = Bench::new();
    database(&bench).await;
    let before = std::fs::read(bench.path("s.sqlite")).unwrap();
    for sql in [
        "DELETE FROM trial",
        "DROP VIEW v_trial",
        "PRAGMA query_only = 0; DELETE FROM trial",
        "PRAGMA user_version = 7",
        "ATTACH 'other.sqlite' AS o; CREATE TABLE o.t (x)",
        "VACUUM",
        "not SQL at all",
    ] {
        let output = bench.metasense(&["query", "s.sqlite", sql]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{sql}: {message}");
        assert!(message.contains("the query failed"), "{sql}: {message}");
    }
    assert!(std::fs::read(bench.path("s.sqlite")).unwrap() == before, "the file was changed");
    let files: Vec<_> = std::fs::read_dir(bench.path("")).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(files, ["s.sqlite"]);
}

/// Two statements are refused; invalid text is shown as far as possible.
#[tokio::test]
async fn one_statement_is_answered_and_none_panics() {
    let bench = Bench::new();
    database(&bench).await;
    for sql in [
        "SELECT 1, 2; SELECT 3",
        "SELECT 1; SELECT 2",
        "SELECT 1 WHERE 0; SELECT 2, 3",
        "; SELECT 1; ; SELECT 2",
    ] {
        let output = bench.metasense(&["query", "s.sqlite", sql]);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{sql}: {message}");
        assert!(message.contains("one statement at a time") && output.stdout.is_empty(), "{sql}: {message}");
    }
    for sql in ["SELECT 1 AS one; -- that is all", "SELECT 1 AS one ; ;", "SELECT ';' AS one"] {
        let out = bench.output(&["query", "s.sqlite", sql, "--format", "csv"]);
        assert!(out.starts_with("one\n"), "{sql}: {out}");
    }
    for format in ["table", "csv", "json", "parquet"] {
        for (sql, why) in [
            ("", "the statement is empty"),
            (" ;", "the statement is empty"),
            ("VACUUM INTO 'v.db'", "only statements that read"),
        ] {
            let output = bench.metasense(&["query", "s.sqlite", sql, "--format", format]);
            let message = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.code() == Some(2) && message.contains(why), "{format} {sql}: {message}");
        }
        for sql in ["/* nothing */", "SELECT CAST(x'61ff' AS TEXT) AS t, 9e999, -0.0, NULL"] {
            let output = bench.metasense(&["query", "s.sqlite", sql, "--format", format]);
            let message = String::from_utf8_lossy(&output.stderr);
            assert!(
                output.status.code() == Some(0) && !message.contains("panicked"),
                "{format} {sql}: {message}"
            );
        }
        let twice = bench.metasense(&["query", "s.sqlite", "SELECT 1 AS a, 2 AS a", "--format", format]);
        let said = String::from_utf8_lossy(&twice.stderr);
        let (code, why) = match format {
            "json" | "parquet" => (2, "two columns are named a"),
            _ => (0, ""),
        };
        assert!(twice.status.code() == Some(code) && said.contains(why), "{format}: {said}");
    }
    for (words, why) in [
        (&["export", "s.sqlite", "v_trial", "abc", "--format", "csv", "--out", "x"][..], "v_trial is a view"),
        (&["analyse", "s.sqlite", "--compare", "s.sqlite", "--fall", "0.5"], "cannot be used with"),
        (&["status", "--folder", "s.shards", "more"], "cannot be used with"),
    ] {
        let output = bench.metasense(words);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains(why), "{words:?}: {said}");
    }
}

/// Exit code 3 for failures that no other command line or spec can correct, so that scripts can wait or report.
#[tokio::test]
async fn a_database_that_is_damaged_or_in_use_gives_code_3() {
    let bench = Bench::new();
    database(&bench).await;
    bench.file("s.toml", SPEC);
    let whole = std::fs::read(bench.path("s.sqlite")).unwrap();
    std::fs::write(bench.path("half.sqlite"), &whole[..whole.len() / 2]).unwrap();
    let held = Store::open(bench.path("s.sqlite")).await.unwrap();
    for (args, expected) in [
        (&["run", "s.toml", "--db", "s.sqlite"][..], "in use by another run"),
        (
            &["remove", "s.sqlite", "M=1", "--yes"],
            "in use by another run; wait for it, or choose another file\n",
        ),
        (&["query", "half.sqlite", "SELECT * FROM v_trial"], "damaged"),
        (&["report", "half.sqlite", "--out", "r.html"], "damaged"),
        (&["run", "s.toml", "--db", "half.sqlite"], "damaged"),
    ] {
        let output = bench.metasense(args);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{args:?}: {message}");
        assert!(message.contains(expected), "{args:?}: {message}");
    }
    held.close().await.unwrap();
}

/// The error to quote, under a name that states its set.
#[tokio::test]
async fn status_shows_the_error_on_the_holdout() {
    let bench = Bench::new();
    database(&bench).await;
    let header = bench.output(&["status", "s.sqlite", "--format", "csv"]);
    assert!(
        header.contains(",holdout_error_initial,holdout_error_optimised,holdout_median_initial,"),
        "{header}"
    );
}

/// Trials that meet conditions are removed with all their data on request; a run repeats them with the same bits.
#[tokio::test]
async fn trials_are_taken_out_by_conditions() {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.output(&["run", "tiny.toml", "--db", "s.sqlite"]);
    let count = |table: &str| {
        bench.output(&["query", "s.sqlite", &format!("SELECT count(*) FROM {table}"), "--format", "csv"])
    };
    let tables = ["trial", "sweep_trial", "attempt", "step", "network", "curve", "artifact"];
    let errors =
        "SELECT hash, error_initial, error_optimised, holdout_error_optimised FROM v_trial ORDER BY 1";
    let results = || bench.output(&["query", "s.sqlite", errors, "--format", "csv"]);
    let (whole, before) = (tables.map(count), results());
    for (words, why) in [
        (&["remove", "s.sqlite"][..], "CONDITION"),
        (&["remove", "s.sqlite", "sensor!=7", "--yes"], "no trial has `sensor`"),
        (&["remove", "s.sqlite", "M", "--yes"], "`M` is not a condition"),
        (&["remove", "s.sqlite", "M<two", "--yes"], "M is a number, but `two` is not"),
        (&["remove", "s.sqlite", "M>", "--yes"], "`M>`"),
        (&["remove", "s.sqlite", "K!=", "--yes"], "`K!=`"),
        (&["remove", "s.sqlite", "reason~", "--yes"], "`reason~`"),
        (&["remove", "s.sqlite", "reason=", "--yes"], "`reason=`"),
        (&["remove", "s.sqlite", "sensors.search!=rendom", "--yes"], "`sensors.search!=rendom`"),
        (&["remove", "none.sqlite", "M=1", "--yes"], "no database none.sqlite"),
    ] {
        let output = bench.metasense(words);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && said.contains(why), "{words:?}: {said}");
    }
    assert!(!bench.path("none.sqlite").exists());
    let listed = bench.metasense(&["remove", "s.sqlite", "M=2", "state=done"]);
    assert!(
        String::from_utf8_lossy(&listed.stderr)
            .contains("1 trial of 2 would be removed; pass --yes to remove them"),
        "{listed:?}"
    );
    assert_eq!(tables.map(count), whole);
    bench.output(&["remove", "s.sqlite", "M=2", "state=done", "--yes"]);
    for (table, whole) in tables.into_iter().zip(&whole) {
        let [rows, all] =
            [&count(table), whole].map(|text| text.lines().nth(1).unwrap().parse::<u32>().unwrap());
        assert!(rows > 0 && rows < all, "{table}: {rows} of {all}");
    }
    bench.output(&["run", "tiny.toml", "--db", "s.sqlite"]);
    assert_eq!(count("step"), whole[3]);
    assert_eq!(results(), before);
}

/// If nobody reads the answer while a run writes, the log (WAL) is still checkpointed, and the answer is that of the query's start.
#[tokio::test]
async fn a_stalled_reader_does_not_make_the_log_grow() {
    let bench = Bench::new();
    let plan = Plan::new("s.toml", SPEC.into()).unwrap();
    let mut store = Store::open(bench.path("s.sqlite")).await.unwrap();
    store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await.unwrap();
    let hash = &plan.trials[0].hash;
    store.begin_attempt(hash).await.unwrap();
    let mut recorded = 0..;
    let mut record = async |store: &mut Store, count: usize| {
        for step in recorded.by_ref().take(count) {
            let record = StepRecord { step, outcome: "ok".into(), ..Default::default() };
            let design = vec![f64::from(step); 5000];
            store
                .record_step(hash, 1, &record, &Checkpoint { step: step + 1, design, ..Default::default() })
                .await
                .unwrap();
        }
    };
    record(&mut store, 3).await;
    // Several MB, of which a pipe takes 64 kB.
    let sql =
        "WITH n (i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i < 19999) SELECT i, p.* FROM n, step p";
    let mut asking = std::process::Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args(["query", "s.sqlite", sql, "--format", "csv"])
        .current_dir(bench.path(""))
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut answer = asking.stdout.take().unwrap();
    let mut begun = vec![0; 10];
    answer.read_exact(&mut begun).unwrap();
    let log = || bench.path("s.sqlite-wal").metadata().unwrap().len();
    // A held snapshot would make the log grow by 40 kB per step.
    let begun_at = std::time::Instant::now();
    let mut grown = Vec::new();
    loop {
        let before = log();
        record(&mut store, 200).await;
        grown.push(log() - before);
        if grown.ends_with(&[0, 0]) {
            break;
        }
        assert!(begun_at.elapsed().as_secs() < 20, "the log has {} bytes, grown by {grown:?}", log());
    }
    let mut rest = String::new();
    answer.read_to_string(&mut rest).unwrap();
    assert!(asking.wait().unwrap().success());
    assert_eq!(rest.lines().count(), 1 + 3 * 20_000 - usize::from(begun.contains(&b'\n')));
}

/// With standard output as the file, what it contains stays, and its path is not printed into it.
#[tokio::test]
async fn standard_output_is_written_to_as_it_is() {
    let bench = Bench::new();
    database(&bench).await;
    bench.file("kept.csv", "before\n");
    for script in [
        "{ \"$0\" query s.sqlite 'SELECT 1 AS a' --format csv --out /dev/stdout; echo after; } >> kept.csv",
        "\"$0\" export s.sqlite v_trial --format parquet --out /dev/fd/1 > file.parquet",
        "\"$0\" export s.sqlite v_trial --format parquet --out /dev/stdout | cat > pipe.parquet",
    ] {
        let mut shell = Command::new("sh");
        shell.args(["-c", script, env!("CARGO_BIN_EXE_metasense")]).current_dir(bench.path(""));
        assert!(shell.status().unwrap().success(), "{script}");
    }
    assert_eq!(std::fs::read_to_string(bench.path("kept.csv")).unwrap(), "before\na\n1\nafter\n");
    for name in ["file.parquet", "pipe.parquet"] {
        let bytes = std::fs::read(bench.path(name)).unwrap();
        assert!(bytes.starts_with(b"PAR1") && bytes.ends_with(b"PAR1"), "{name}: {} bytes", bytes.len());
    }
}

/// If rows cannot be held for a slow reader, the message names the temporary folder.
#[tokio::test]
async fn a_full_temporary_folder_is_named() {
    let bench = Bench::new();
    database(&bench).await;
    // 20 MB, of which a pipe takes 64 kB and the memory 4 MB
    let sql = "WITH n (i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i < 19999) SELECT printf('%01000d', i) FROM n";
    let asking = Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args(["query", "s.sqlite", sql, "--format", "csv"])
        .current_dir(bench.path(""))
        .env("TMPDIR", "/no/such/folder")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_secs(2));
    let output = asking.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains("holding rows for the reader in /no/such/folder"), "{said}");
}
