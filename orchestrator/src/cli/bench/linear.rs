//! `bench linear`: what it costs to solve for a linear brain, by sensors and memory.
//!
//! It decides what memory a step can afford: the factor takes D³/3 operations, all else grows with D² at most.

use std::path::PathBuf;

use metasense_worker::bench::{LinearBench, linear_rows};
use serde_json::json;

use super::super::{Error, Format, print_rows};
use super::append;
use crate::exit::Exit;
use crate::look::{Table, row};

/// Time to solve for a linear brain on one thread: moments of the samples, normal matrix with its factor, answers, pull-back
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Args {
    /// Samples N
    #[arg(long, default_value_t = 270, value_parser = clap::value_parser!(u16).range(1..))]
    samples: u16,
    /// Instants T
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u16).range(2..=1000))]
    instants: u16,
    /// Numbers of sensors M
    #[arg(long, value_delimiter = ',', default_value = "1,2,3,4,5,6")]
    sensors: Vec<u8>,
    /// Panels K
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=100))]
    panels: u16,
    /// Memories, each way, in instants
    #[arg(long, value_delimiter = ',', default_value = "40,100,199")]
    memories: Vec<u16>,
    /// Where the rows are appended as JSON lines
    #[arg(long, value_name = "FILE", default_value = "results/bench.jsonl")]
    append: PathBuf,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

pub(in crate::cli) fn execute(args: &Args) -> Result<Exit, Error> {
    let mut rows = Vec::new();
    for (&sensors, &memory) in args.sensors.iter().flat_map(|m| args.memories.iter().map(move |l| (m, l))) {
        let found = linear_rows(LinearBench {
            samples: args.samples.into(),
            instants: args.instants.into(),
            sensors: usize::from(sensors.max(1)),
            panels: args.panels.into(),
            memory: memory.min(args.instants - 1).into(),
        });
        rows.push(
            row![sensors, memory, found.unknowns; found.milliseconds.into_iter().chain([found.gflops])],
        );
    }
    let columns = "sensors memory unknowns moments_ms solve_ms answers_ms pull_back_ms factor_gflops";
    let table = Table::new(columns, rows);
    print_rows(&table, args.format)?;
    let head =
        json!({"bench": "linear", "samples": args.samples, "instants": args.instants, "panels": args.panels});
    append(&args.append, &head, &table)?;
    Ok(Exit::Done)
}
