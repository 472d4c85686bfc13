//! `merge`: merges synthetic databases of shards.
//!
//! Shows how many trials one merge and one file can handle.

use std::path::{Path, PathBuf};
use std::time::Instant;

use metasense::cli::Error;
use metasense::cluster::Shard;
use metasense::cluster::merge::{Extent, merge};
use metasense::exit::Exit;
use metasense::print_line;
use metasense::store::Store;
use serde_json::json;

use crate::answers::measure_command;
use crate::made_up::{BulkDatabase, Scratch, count};

/// Trials and bytes per second of a merge of synthetic shards.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Number of databases.
    #[arg(long, default_value_t = 20)]
    shards: u32,
    /// Trials per database.
    #[arg(long, default_value_t = 100)]
    trials: u32,
    /// Outer steps per trial.
    #[arg(long, default_value_t = 200)]
    steps: u32,
    /// Points of the loss curves per trial.
    #[arg(long, default_value_t = 400)]
    points: u32,
    /// Bytes of six arrays per trial.
    #[arg(long, default_value_t = 120_000)]
    bytes: u32,
    /// Merge only facts, and time `status` on them.
    #[arg(long)]
    facts: bool,
    /// Folder for the temporary databases.
    #[arg(long, default_value = "results", value_name = "DIR")]
    folder: PathBuf,
}

pub async fn execute(args: Args) -> Result<Exit, Error> {
    let scratch = Scratch::new(&args.folder, "merge");
    measure(&args, &scratch.0).await
}

async fn measure(args: &Args, folder: &Path) -> Result<Exit, Error> {
    let shards = folder.join("shards");
    let mut bytes = 0;
    for i in 1..=args.shards {
        let Some(shard) = Shard::new(i, args.shards) else {
            return Err(Error::Usage(format!("--shards {} is too many", args.shards)));
        };
        let file = shards.join(format!("{}.sqlite", shard.file_stem()));
        make(&file, shard, args).await?;
        bytes += size(&file);
    }
    let out = folder.join("merged.sqlite");
    let began = Instant::now();
    let shards = std::slice::from_ref(&shards);
    let extent = if args.facts { Extent::Facts } else { Extent::Whole };
    let summary = merge(extent, shards, &out).await?;
    let seconds = began.elapsed().as_secs_f64();
    let resident = crate::peak_mib();
    let status = if args.facts { Some(measure_command(&["status", &out.to_string_lossy()])?) } else { None };
    let row = json!({
        "bench": "merge",
        "shards": args.shards,
        "trials": summary.trials,
        "steps": args.steps,
        "points": args.points,
        "bytes_per_trial": bytes / u64::from(args.shards * args.trials).max(1),
        "seconds": seconds,
        "trials_per_second": summary.trials as f64 / seconds,
        "rows_per_second": summary.trials as f64 * f64::from(args.steps + args.points + 12) / seconds,
        "bytes_per_second": bytes as f64 / seconds,
        "merged_bytes": size(&out),
        "resident_mib": resident,
        "facts": args.facts,
        "status_seconds": status.map(|asked| asked.0),
        "version": env!("CARGO_PKG_VERSION"),
    });
    print_line!("{row}")?;
    Ok(if summary.trials as u32 == args.shards * args.trials { Exit::Done } else { Exit::Failed })
}

fn size(file: &Path) -> u64 {
    file.metadata().map_or(0, |m| m.len())
}

/// Creates the database of a shard with finished trials, as the engine would.
async fn make(file: &Path, shard: Shard, args: &Args) -> Result<(), Error> {
    Store::open(file).await?.close().await?;
    let mut made = BulkDatabase::begin(file).await?;
    let (first, trials) = ((shard.index() - 1) * args.trials, args.trials);
    let (steps, points, bytes) = (args.steps, args.points / 2, args.bytes / 6);
    let numbers = "0.1, 0.2, 0.3, 0.4, 0.5, 0.6";
    let sql = [
        "INSERT INTO sweep VALUES (1, 'bench-merge', '', '{}', '0', '2026-01-01T00:00:00.000Z')".to_owned(),
        format!(
            "INSERT INTO run (sweep_id, started_at, host, shard, shards, job, version, workers, threads, trials, estimated_seconds,
               ended_at, outcome, done, failed)
             VALUES (1, '2026-01-01T00:00:00.000Z', 'bench', {}, {}, NULL, '0', 1, 1, {trials}, 1.0,
               NULL, 'complete', {trials}, 0)",
            shard.index(),
            shard.count()
        ),
        format!(
            "{} INSERT INTO trial SELECT i + 1, printf('%016x%016x', (i + {first}) * 7046029254386353131, i + {first}),
               json_object('brain', json_object('kind', 'cnn'), 'sensor_units', '[]', 'more', hex(zeroblob(650))), 'done', NULL, 'planar', 6, 6, 36, 2, 1, i, 1, 'joint', 168, 13122, 1.0, {numbers}, 3,
               1.0, 'avx512', 'tsit5', json_object('more', hex(zeroblob(290))), '2026-01-01T00:00:00.000Z', '2026-01-01T00:00:00.000Z', NULL,
               NULL, NULL, NULL, NULL, NULL, NULL FROM n",
            count(trials)
        ),
        format!("INSERT INTO sweep_trial SELECT 1, id, id + {first} FROM trial"),
        format!(
            "INSERT INTO attempt (trial_id, number, state, steps, version, started_at, ended_at)
             SELECT id, 1, 'done', {steps}, '0', '2026-01-01T00:00:00.000Z', '2026-01-01T00:00:00.000Z' FROM trial"
        ),
        format!(
            "{} INSERT INTO step SELECT trial.id, n.i, 1, {numbers}, 'projected', 0.1, NULL, NULL, NULL, NULL, 'ok', 64, 1000000,
               100000, 1000, 10, 0, 20, {numbers}, '2026-01-01T00:00:00.000Z', NULL FROM trial CROSS JOIN n",
            count(steps)
        ),
        "INSERT INTO network SELECT trial.id, value, 0, 0.1, 0.2, 0.3, 1000, 'ok', NULL, NULL, NULL
         FROM trial, json_each('[\"initial\", \"optimised\"]')"
            .to_owned(),
        format!(
            "{} INSERT INTO curve SELECT trial.id, value, 0, n.i + 1, 0.5, 10.0
             FROM trial CROSS JOIN json_each('[\"initial\", \"optimised\"]') CROSS JOIN n",
            count(points)
        ),
        format!(
            "INSERT INTO artifact (trial_id, name, shape, bytes) SELECT trial.id, 'array_' || value, '[1]', randomblob({bytes})
             FROM trial, json_each('[1, 2, 3, 4, 5, 6]')"
        ),
    ];
    made.execute(&sql).await?;
    made.commit().await
}
