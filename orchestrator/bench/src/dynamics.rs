//! `dynamics`: error of the signals and of dα against milliseconds a sample, for every integrator, and what that
//! says of each scene; or the race.
//!
//! It decides what `auto` picks and whether a stiff scene has a method of its own; `--race` is what is set beside a peer.

mod judgement;
mod measure;
mod picture;

use std::path::PathBuf;

use metasense::cli::{Error, Format, print_rows};
use metasense::exit::Exit;
use metasense::look::Table;
use metasense::say;
use serde_json::json;

use crate::append;
use measure::{BenchScene, LAP, POINT, race, work_precision};

/// Error of the signals and of dα against milliseconds a sample, for every integrator; or the race against a peer
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scenes of the diagram, cheapest first
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["reference", "contact", "stretch100", "stretch10000"])]
    scenes: Vec<BenchScene>,
    /// Samples: sixteen fill the lanes, of f32 too; of the race 300
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..))]
    samples: Option<u16>,
    /// A tenth of a second, with blows ten times as fast, instead of a second
    #[arg(long)]
    quick: bool,
    /// Forward and gradient of the reference scene by tsit5 at 1e-6 and by the default, on one thread and on two, and by
    /// the default with narrower instruction sets
    #[arg(long, conflicts_with = "redraw")]
    race: bool,
    /// Threads of the race's second rows
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
    /// Repetitions of the race, of which the quickest counts
    #[arg(long, default_value_t = 2)]
    repeat: usize,
    /// Measure nothing; draw the rows that are there
    #[arg(long)]
    redraw: bool,
    /// File to which the rows are appended as JSON lines
    #[arg(long, value_name = "FILE", default_value = "results/bench.jsonl")]
    append: PathBuf,
    /// File for a picture of the newest rows
    #[arg(long, value_name = "SVG", default_value = "results/work-precision.svg")]
    picture: PathBuf,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

pub fn execute(args: &Args) -> Result<Exit, Error> {
    let instants: u16 = if args.quick { 20 } else { 200 };
    if args.race {
        let samples = args.samples.unwrap_or(300);
        let laps = race(samples.into(), instants.into(), args.threads.into(), args.repeat);
        let table = Table::new(LAP, laps);
        print_rows(&table, args.format)?;
        append(&args.append, &json!({"bench": "race", "instants": instants}), &table)?;
        return Ok(Exit::Done);
    }
    let samples = args.samples.unwrap_or(16);
    let mut all = Vec::new();
    for &scene in args.scenes.iter().filter(|_| !args.redraw) {
        let rows = work_precision(scene, samples.into(), instants.into());
        // Scene by scene: the stiffest takes most of the time, and what is before it should not be lost with it.
        let head = json!({"bench": "dynamics", "samples": samples, "instants": instants});
        append(&args.append, &head, &Table::new(POINT, rows.clone()))?;
        all.extend(rows);
    }
    print_rows(&Table::new(POINT, all), args.format)?;
    for line in judgement::lines(&picture::write(&args.append, &args.picture, instants)?) {
        say!("{line}");
    }
    Ok(Exit::Done)
}
