//! `verify`: the maths against reference cases.

use std::path::PathBuf;

use metasense_worker::run::Pool;
use metasense_worker::verify::{self, Row};
use serde_json::Value;

use super::{Error, Format, print_rows};
use crate::exit::Exit;
use crate::look::{Table, row};

/// Compares the maths with reference cases
///
/// One row a quantity, with its error, tolerance and verdict; exit code 1 if any fails.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder of the reference cases: one folder per case, with case.json and .npy arrays
    #[arg(long, value_name = "DIR")]
    cases: PathBuf,
    /// Threads; by default one a core
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u16).range(0..=1024))]
    threads: u16,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let pool = Pool::new(args.threads.into())
        .map_err(|e| Error::Usage(format!("cannot start {} threads: {e}", args.threads)))?;
    let rows = verify::cases(&args.cases, &pool).map_err(|e| Error::Usage(e.to_string()))?;
    let columns = "case quantity error tolerance pass note";
    print_rows(&Table::new(columns, rows.iter().map(values)), args.format)?;
    let failed = rows.iter().filter(|row| !row.pass).count();
    say!("{} of {} quantities pass", rows.len() - failed, rows.len());
    Ok(if failed == 0 { Exit::Done } else { Exit::Failed })
}

fn values(row: &Row) -> Vec<Value> {
    let Row { case, quantity, error, tolerance, pass, note } = row;
    row![case, quantity, error, tolerance, pass, note]
}
