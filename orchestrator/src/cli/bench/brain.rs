//! `bench brain`: what an iteration of training costs, beside the machine's own multiply-add peak.
//!
//! It decides whether the kernels leave anything to gain, and what a Hessian-vector product costs in iterations.

use std::path::PathBuf;

use metasense_worker::bench::{BrainBench, BrainTimes, brain_rows};
use serde_json::{Value, json};

use super::super::{Error, Format, print_rows};
use super::append;
use crate::exit::Exit;
use crate::look::{Table, row};

/// Time of a training iteration and of second derivatives, share of the multiply-add peak
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Args {
    /// Samples N of the batch
    #[arg(long, default_value_t = 270, value_parser = clap::value_parser!(u16).range(1..))]
    samples: u16,
    /// Instants T
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u16).range(1..))]
    instants: u16,
    /// Sensors M
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=100))]
    sensors: u16,
    /// Panels K
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=100))]
    panels: u16,
    /// Repetitions, of which the quickest counts
    #[arg(long, default_value_t = 20)]
    repeat: usize,
    /// Threads of the second pair of rows; narrower instruction sets, in the last ones, run on one
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
    /// Where the rows are appended as JSON lines
    #[arg(long, value_name = "FILE", default_value = "results/bench.jsonl")]
    append: PathBuf,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

const COLUMNS: &str = "network precision simd threads forward_ms iteration_ms hessian_ms gauss_newton_ms \
    hessian_iterations gauss_newton_iterations gflop peak_gflops share_of_peak";

fn row(t: &BrainTimes) -> Vec<Value> {
    row![
        t.network,
        t.precision,
        t.simd,
        t.threads,
        t.forward,
        t.iteration,
        t.hessian,
        t.gauss_newton,
        t.hessian / t.iteration,
        t.gauss_newton / t.iteration,
        t.gflop,
        t.peak,
        t.share_of_peak()
    ]
}

pub(in crate::cli) fn execute(args: &Args) -> Result<Exit, Error> {
    let rows = brain_rows(BrainBench {
        samples: args.samples.into(),
        instants: args.instants.into(),
        sensors: args.sensors.into(),
        panels: args.panels.into(),
        repeat: args.repeat,
        threads: args.threads.into(),
    });
    let table = Table::new(COLUMNS, rows.iter().map(row));
    print_rows(&table, args.format)?;

    let head = json!({"bench": "brain", "samples": args.samples, "instants": args.instants,
        "sensors": args.sensors, "panels": args.panels});
    append(&args.append, &head, &table)?;
    Ok(Exit::Done)
}
