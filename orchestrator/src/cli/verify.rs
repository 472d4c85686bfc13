//! `verify`: compares the numerics with reference cases, or tests an external body.

use std::path::PathBuf;

use metasense_lab::verify::{self, ComparedQuantity};
use metasense_worker::run::Pool;

use super::named::Spec;
use super::{Error, Format, cores, print_rows};
use crate::exit::Exit;
use crate::look::{Table, row};

/// Compares the numerics with reference cases, or tests an external body
///
/// Prints one row per quantity, with its error, tolerance and verdict. Exit code 1 if any quantity fails. The body of a spec with
/// body.kind = "external" is tested for repeatability, independent samples and its gradient.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder of the reference cases (one folder per case, with case.json and .npy arrays), or a spec
    #[arg(value_name = "DIR|SPEC")]
    cases: PathBuf,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let pool =
        Pool::new(cores()).map_err(|e| Error::Usage(format!("cannot start {} threads: {e}", cores())))?;
    let rows = if args.cases.is_file() {
        let trial = Spec { file: args.cases.clone(), changes: Vec::new() }.plan()?.trials.swap_remove(0);
        let name = args.cases.display();
        verify::external(&trial.spec, &pool).map_err(|e| Error::Usage(format!("{name}: {e}")))?
    } else {
        verify::cases(&args.cases, &pool).map_err(|e| Error::Usage(e.to_string()))?
    };
    let values = |r: &ComparedQuantity| row![r.case, r.quantity, r.error, r.tolerance, r.pass, r.note];
    let table = Table::new("case quantity error tolerance pass note", rows.iter().map(values));
    print_rows(&table, Format::Table)?;
    let failed = rows.iter().filter(|row| !row.pass).count();
    say!("{} of {} quantities pass", rows.len() - failed, rows.len());
    Ok(if failed == 0 { Exit::Done } else { Exit::Failed })
}
