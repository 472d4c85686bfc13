//! `claims`: the paper's claims, each rated by the trials that can tell.

use std::path::PathBuf;

use maud::html;

use super::named::Database;
use super::report::write_figures;
use super::{Error, Format, print_rows, write};
use crate::analysis::claims::is_other;
use crate::exit::Exit;
use crate::look::page;
use crate::provenance;
use crate::report::claims::{claims_table, evidence_table, figure, trials_table, tried};
use crate::report::load::finished_trials;
use crate::store::Reader;

/// Rates the claims of arXiv:2605.23967 by finished trials
///
/// A claim holds, is compatible with the paper's number, holds in part, makes no difference, fails, is open, or depends on the brain.
/// First run the specs that it names into one database (run SPEC --db FILE). Trials of different settings (noise, damping, …) are rated
/// apart. Those with chips or fewer channels, placed sensors, frozen or pressed units, bodies of their own or another lattice are not
/// of the paper's scenes: the claims of random bodies alone may count them.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database; of a folder of shards, their facts
    #[arg(value_name = "DB|FOLDER")]
    db: PathBuf,
    /// A row per claim, brain and set, with ratios, intervals and votes, instead of a row per claim
    #[arg(long)]
    evidence: bool,
    /// Also writes into this folder both tables and the trials (CSV), the figure (SVG) and a page of all (index.html)
    #[arg(long, value_name = "DIR")]
    out_dir: Option<PathBuf>,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let (trials, caveats) = Reader::asked(Database::at(&args.db).await?, async |reader| {
        let made = reader.made().await?;
        Ok::<_, Error>((finished_trials(reader).await?, provenance::caveats(reader, &made).await?))
    })
    .await?;
    let found = tried(&trials);
    let [claims, evidence] = [claims_table(&found), evidence_table(&found)];
    print_rows(if args.evidence { &evidence } else { &claims }, args.format)?;
    if let Some(folder) = &args.out_dir {
        let drawn: Vec<_> = figure(&found).into_iter().collect();
        write_figures(folder, &drawn)?;
        write(&folder.join("claims.csv"), claims.csv())?;
        write(&folder.join("evidence.csv"), evidence.csv())?;
        write(&folder.join("trials.csv"), trials_table(&trials).csv())?;
        let content = html! {
            (claims.html(None))
            @for figure in &drawn { (figure.html(&[])) }
            h2 { "Evidence" }
            (evidence.html(Some("evidence")))
        };
        let question = "Does what arXiv:2605.23967 claims hold, and with which brain?";
        write(&folder.join("index.html"), page("The paper's claims", question, content))?;
    }
    match trials.iter().filter(|trial| is_other(trial)).count() {
        0 => {}
        other => say!(
            "{} of {} trials with chips or fewer channels, placed sensors, frozen or pressed units, bodies of their own or another \
             lattice are not of the paper's scenes: the claims of random bodies alone may count them",
            other,
            trials.len()
        ),
    }
    caveats.iter().for_each(|caveat| say!("{caveat}"));
    Ok(Exit::Done)
}
