//! The `metasense-bench` command: measures the speed of metasense on this machine, in rows that stay comparable between
//! versions.

#![warn(clippy::print_stdout, clippy::print_stderr)]

mod brain;
mod dynamics;
mod engine;

use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use metasense::cli::simd::Simd;
use metasense::cli::{self, Error, block_on};
use metasense::exit::{EXIT_CODES, Exit};
use metasense::look::Table;
use metasense_numerics::simd::Width;
use metasense_numerics::{Heartbeat, Pool};
use metasense_worker::simd::width;
use serde_json::{Value, json};

/// Measures the speed of metasense on this machine. For development: `cargo run --release -p metasense-bench -- BENCH`
#[derive(Debug, Parser)]
#[command(version, after_help = EXIT_CODES, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    what: What,
    #[command(flatten)]
    simd: Simd,
}

#[derive(Debug, Subcommand)]
enum What {
    Brain(brain::Args),
    Dynamics(dynamics::Args),
    Engine(engine::Args),
    /// Runs a worker of the engine.
    #[command(hide = true)]
    Worker {
        /// Address of the engine.
        start: String,
    },
}

fn main() -> ExitCode {
    cli::exit_code(dispatch(Cli::parse()))
}

fn dispatch(cli: Cli) -> Result<Exit, Error> {
    cli.simd.choose()?;
    metasense_worker::process::keep_memory();
    metasense_worker::limits::raise_limits();
    match cli.what {
        What::Brain(args) => brain::execute(&args),
        What::Dynamics(args) => dynamics::execute(&args),
        What::Engine(args) => block_on(engine::execute(args)),
        What::Worker { start } => {
            std::process::exit(metasense_worker::process::run(&start, engine::noop::perform))
        }
    }
}

/// Appends rows as JSON lines: the fields of `head`, version and instruction set, then those of the row.
fn append(path: &Path, head: &Value, table: &Table) -> Result<(), Error> {
    let failed = |source| Error::Io { doing: "appending to", path: path.to_owned(), source };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    let mut file = OpenOptions::new().create(true).append(true).open(path).map_err(failed)?;
    for values in &table.rows {
        let mut line = head.clone();
        line["version"] = json!(env!("CARGO_PKG_VERSION"));
        line["simd"] = json!(metasense_worker::simd::name());
        let fields = line.as_object_mut().expect("a head that is an object");
        fields.extend(table.columns.iter().cloned().zip(values.iter().cloned()));
        writeln!(file, "{line}").map_err(failed)?;
    }
    Ok(())
}

/// The instruction sets up to the process's own, widest first.
fn widths() -> impl Iterator<Item = Width> {
    Width::ALL.into_iter().rev().filter(|narrow| *narrow <= width())
}

fn pool(threads: usize, width: Width) -> Pool {
    Pool::with(threads, width, Heartbeat::default()).expect("threads")
}

/// Peak resident memory of this process (MiB).
fn peak_mib() -> f64 {
    metasense::processes::peak_mib(std::process::id()).unwrap_or(f64::NAN)
}
