//! Databases and copies of shards that other programs wrote or a disk damaged give an answer or an error, never a panic.
//!
//! The test replaces bytes of the file or cells of its tables. `FOREIGN_SEED=N` repeats one case, `FOREIGN_CASES=N` sets their
//! number.

use std::panic::AssertUnwindSafe;
use std::path::Path;

use crate::common::SPEC;
use crate::common::roll::{self, Roll};
use metasense::analysis::{DecisionTerms, Question};
use metasense::cluster::{Assignment, Shard, merge, state};
use metasense::plan::Plan;
use metasense::reader::Reader;
use metasense::report::load;
use metasense::store::Store;
use metasense_schemas::database::VIEWS;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Row};

/// Values that any column of a foreign file may contain.
const AWKWARD: &[&str] = &[
    "NULL",
    "-1",
    "0",
    "9223372036854775807",
    "9e999",
    "1.5",
    "''",
    "'x'",
    "'done'",
    "'running'",
    "'{}'",
    "'[1, {\"a\": null}]'",
    "CAST(x'ff61' AS TEXT)",
    "x''",
    "x'01ffffffff'",
    "x'934e554d5059'",
    "zeroblob(100)",
];

async fn damage_cells(file: &Path, roll: &mut Roll) -> sqlx::Result<()> {
    let options = SqliteConnectOptions::new().filename(file).foreign_keys(false);
    let mut db = options.disable_statement_logging().connect().await?;
    let columns = sqlx::query(
        "SELECT t.name, c.name FROM sqlite_schema t, pragma_table_info(t.name) c
         WHERE t.type = 'table' AND t.name NOT LIKE 'sqlite%' ORDER BY 1, c.cid",
    )
    .fetch_all(&mut db)
    .await?;
    for _ in 0..=roll.place(4) {
        let column = &columns[roll.place(columns.len())];
        let (table, name): (&str, &str) = (column.get(0), column.get(1));
        let value = AWKWARD[roll.place(AWKWARD.len())];
        // Constraints of a table may refuse the value.
        let sql = format!("UPDATE {table} SET \"{name}\" = {value}");
        let _ = sqlx::query(AssertSqlSafe(sql)).execute(&mut db).await;
    }
    db.close().await
}

fn damage_bytes(file: &Path, roll: &mut Roll) {
    let mut bytes = std::fs::read(file).unwrap();
    for _ in 0..=roll.place(30) {
        // Half of the bytes are in the headers of pages.
        let page = 4096 * roll.place(bytes.len() / 4096);
        let at = if roll.place(2) == 0 { page + roll.place(120) } else { roll.place(bytes.len()) };
        bytes[at] = roll.place(256) as u8;
    }
    if roll.place(10) == 0 {
        bytes.truncate(roll.place(bytes.len()));
    }
    std::fs::write(file, bytes).unwrap();
}

/// Runs all readers of databases, ignoring errors.
async fn read(folder: &Path, file: &Path, plan: &Plan) {
    let assignment = Assignment::in_folder(folder, &plan.trials, 1);
    let assignment = assignment.unwrap_or_else(|_| Assignment::new(&plan.trials, 1));
    let _ = state::states(folder, &assignment, &Default::default()).await;
    let _ = state::never_begun(&[file.to_owned()], file).await;
    let _ = merge::merge(merge::Extent::Whole, &[file.to_owned()], &folder.join("merged.sqlite")).await;
    if let Ok(mut reader) = Reader::open(file).await {
        for (view, _) in VIEWS.iter() {
            let _ = reader.query::<metasense::look::Table>(&format!("SELECT * FROM {view}")).await;
        }
        if let Ok(trials) = load::finished_trials(&mut reader).await {
            for question in Question::all() {
                let _ = question.answer(&trials, DecisionTerms::default());
            }
        }
        let _ = load::story(&mut reader, None, DecisionTerms::default()).await;
        for trial in &plan.trials {
            let _ = reader.stored(&trial.hash).await;
        }
        reader.close().await;
    }
    if let Ok(mut store) = Store::open(file).await {
        let _ = store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await;
        let _ = store.attempted().await;
        for trial in &plan.trials {
            let _ = store.checkpoint(&trial.hash).await;
        }
        let _ = store.close().await;
    }
}

#[test]
fn no_database_makes_a_reader_panic() {
    let seeds: Vec<u64> = match roll::number("FOREIGN_SEED") {
        Some(seed) => vec![seed],
        // 1102: a name that is not text, for which a reader could wait forever.
        None => (0..roll::number("FOREIGN_CASES").unwrap_or(50)).chain([1102]).collect(),
    };
    let whole = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/databases/v15.sqlite");
    // As in tests/upgrade.rs.
    let then = "[optimise]\nprotocol = \"paper\"\niterations = 100\nlearning_rate = 0.1\n\
                [solver]\nmethod = \"tsit5\"\ntolerance = 1e-6\n";
    let plan = Plan::new("s.toml", format!("{SPEC}{then}")).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let mut failed = Vec::new();
    for seed in seeds {
        let folder = tempfile::tempdir().unwrap();
        let stem = Shard::new(1, 1).unwrap().file_stem();
        let file = folder.path().join(format!("{stem}.1-a-1.sqlite"));
        std::fs::copy(whole, &file).unwrap();
        let mut roll = Roll(seed);
        match roll.place(3) {
            0 => damage_bytes(&file, &mut roll),
            _ => runtime.block_on(damage_cells(&file, &mut roll)).unwrap(),
        }
        let reading = || runtime.block_on(read(folder.path(), &file, &plan));
        if std::panic::catch_unwind(AssertUnwindSafe(reading)).is_err() {
            failed.push(seed);
        }
    }
    assert!(failed.is_empty(), "FOREIGN_SEED: {failed:?}");
}
