//! `check`: checks measured records before any fit.

use std::path::PathBuf;

use metasense_lab::check::{Severity, check, read};

use super::named::Designed;
use super::report::write_figures;
use super::{Error, Format, end_on_signal, print_rows, write};
use crate::exit::Exit;
use crate::report::check as pictures;

/// Checks measured records before any fit: instruments, units, axes, clocks, panels
///
/// Compares the signals with those of the model, at frequencies and times at which a cast and its design agree. For each mistake
/// that would explain a difference it prints the numbers and the key that corrects it. Exit code 1 if it finds a fault.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    one: Designed,
    /// The records (TOML; keys in docs/reference/measured.md)
    #[arg(long, value_name = "TOML")]
    records: PathBuf,
    /// Writes a page (index.html), its figures (SVG) and their data into this folder
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out_dir: Option<PathBuf>,
    /// Format of the findings
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    end_on_signal(None);
    let (_, trial, design) = &args.one.read().await?;
    let described = read(&args.records, trial)?;
    let checked = check(trial, design, &described, 1).map_err(|e| args.one.trial.failed(e))?;
    let (records, findings) = (pictures::records(&checked), pictures::findings(&checked));
    if args.format == Format::Table {
        print_rows(&records, args.format)?;
        print_rows(&pictures::rings(&checked), args.format)?;
    }
    print_rows(&findings, args.format)?;
    if let Some(folder) = &args.out_dir {
        let figures = pictures::figures(trial, design, &checked);
        write_figures(folder, &figures)?;
        write(&folder.join("findings.csv"), findings.csv())?;
        write(&folder.join("records.csv"), records.csv())?;
        write(&folder.join("index.html"), pictures::html(&args.records, &checked, &figures))?;
    }
    let fault = checked.findings.iter().any(|finding| finding.level == Severity::Fault);
    Ok(if fault { Exit::Failed } else { Exit::Done })
}
