//! `bench`: how fast, in rows that can be compared over the years.

mod answers;
mod brain;
mod dynamics;
mod engine;
mod judgement;
mod linear;
mod merge;
mod picture;
mod projection;
mod protocols;
mod soak;

use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;

use clap::Subcommand;
use serde_json::{Value, json};

use super::Error;
use super::simd::Simd;
use crate::exit::Exit;
use crate::look::Table;

/// Measures.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
    #[command(flatten)]
    simd: Simd,
}

#[derive(Debug, Subcommand)]
enum What {
    Answers(answers::Args),
    Brain(brain::Args),
    Dynamics(dynamics::Args),
    Engine(engine::Args),
    Linear(linear::Args),
    Merge(merge::Args),
    Projection(projection::Args),
    Protocols(protocols::Args),
}

pub async fn execute(args: Args) -> Result<Exit, Error> {
    args.simd.choose()?;
    match args.what {
        What::Answers(args) => answers::execute(args).await,
        What::Brain(args) => brain::execute(&args),
        What::Dynamics(args) => dynamics::execute(&args),
        What::Engine(args) => engine::execute(args).await,
        What::Linear(args) => linear::execute(&args),
        What::Merge(args) => merge::execute(args).await,
        What::Projection(args) => projection::execute(&args),
        What::Protocols(args) => protocols::execute(&args),
    }
}

/// Appends rows as JSON lines: the fields of `head`, the version and the instruction set, then those of the row.
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

/// The name of a file, for such a head.
fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
