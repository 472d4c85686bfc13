//! `verify`: compares the numerics with reference cases.

use std::path::PathBuf;

use metasense_worker::run::Pool;
use metasense_worker::verify::{self, Row};
use serde_json::Value;

use super::{Error, Format, cores, print_rows};
use crate::exit::Exit;
use crate::look::{Table, row};

/// Compares the numerics with reference cases
///
/// Prints one row per quantity, with its error, tolerance and verdict. Exit code 1 if any quantity fails.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder of the reference cases: one folder per case, with case.json and .npy arrays
    #[arg(value_name = "DIR")]
    cases: PathBuf,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let pool =
        Pool::new(cores()).map_err(|e| Error::Usage(format!("cannot start {} threads: {e}", cores())))?;
    let rows = verify::cases(&args.cases, &pool).map_err(|e| Error::Usage(e.to_string()))?;
    let columns = "case quantity error tolerance pass note";
    print_rows(&Table::new(columns, rows.iter().map(values)), Format::Table)?;
    let failed = rows.iter().filter(|row| !row.pass).count();
    say!("{} of {} quantities pass", rows.len() - failed, rows.len());
    Ok(if failed == 0 { Exit::Done } else { Exit::Failed })
}

fn values(row: &Row) -> Vec<Value> {
    let Row { case, quantity, error, tolerance, pass, note } = row;
    row![case, quantity, error, tolerance, pass, note]
}
