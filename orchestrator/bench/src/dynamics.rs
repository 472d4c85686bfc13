//! `dynamics`: error of the signals and of dα against milliseconds per sample, for every integrator, with conclusions per
//! scene; or the race.
//!
//! Shows which integrator `auto` should pick and whether stiff scenes need their own; `--race` compares with other programs.

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

/// Error of signals and of dα against milliseconds per sample, for every integrator; or a race against other programs
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scenes of the diagram, cheapest first
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["reference", "contact", "stretch100", "stretch10000"])]
    scenes: Vec<BenchScene>,
    /// Samples (default 16, which fill all SIMD lanes; race: 300)
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..))]
    samples: Option<u16>,
    /// Simulate 0.1 s with forces ten times as fast, instead of 1 s
    #[arg(long)]
    quick: bool,
    /// Time forward and gradient of the reference scene with tsit5 at 1e-6 and with the default, on one thread and on
    /// `--threads`, and with narrower instruction sets
    #[arg(long, conflicts_with = "redraw")]
    race: bool,
    /// Threads of the second rows of the race
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
    /// Repetitions of the race; the fastest counts
    #[arg(long, default_value_t = 2)]
    repeat: usize,
    /// Measure nothing; draw the rows in the file
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
        // Written per scene: the stiffest takes longest, and an interruption then loses only the current one.
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
