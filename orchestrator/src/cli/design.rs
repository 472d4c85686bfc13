//! `design`: searches the cheapest body, sensors and decoder that meet a requirement.

use std::path::{Path, PathBuf};

use super::named::Spec;
use super::run::{RunConfig, Running, exit_of, run};
use super::{Error, Format, log, print_rows};
use crate::exit::Exit;
use crate::files;
use crate::plan::{Plan, counted};
use crate::reader::Reader;
use crate::report::search::{COLUMNS, SearchState};
use crate::rounds::search;
use crate::rounds::space::Space;
use crate::scheduler::RunOutcome;
use crate::signals::Signals;
use tokio::sync::Notify;

/// Searches a sweep for the cheapest design that meets the requirement in its [goal]
///
/// The search trains the candidates that are likeliest to meet the requirement and pauses the others, so that most of the sweep is
/// never run. The chosen design is confirmed on fresh seeds that had no part in its choice. After Ctrl-C or `kill -9` the same command
/// resumes the search and ends at the same design. A legend below the table explains its columns.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    spec: Spec,
    #[command(flatten)]
    running: Running,
}

/// Why the spec cannot be reloaded during a search.
const FIXED: &str = "[goal] decides which trials are run: stop the search; the same command then resumes it with the edited spec";

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    args.running.simd.choose()?;
    // Before signals are received, as in `run`.
    let plan = args.spec.plan()?;
    let mut signals = Signals::new()?;
    let space = space(&plan)?;
    let db: PathBuf = args.running.db.clone().unwrap_or_else(|| plan.default_database());
    let asked = Notify::new();
    let Args { spec, running, .. } = &args;
    let how = RunConfig { spec, running, shard: None, fixed: Some(FIXED), asked: &asked };
    let (outcome, plan) = run(plan, &how, &db, &log::path(&db)?, &mut signals, async |round, again| {
        search(round, &space, again).await
    })
    .await?;
    end(&db, plan, space, args.running.format, outcome).await
}

/// Returns the search space. Prints the trials that limits of the search exclude.
pub(super) fn space(plan: &Plan) -> Result<Space, Error> {
    let space = Space::new(plan)?;
    for out in &space.left_out {
        say!("{} excludes {}; the smallest value is {}", out.key, counted(out.trials, "trial"), out.least);
    }
    Ok(space)
}

/// Prints the table and the verdict; returns the exit code.
pub(super) async fn end(
    db: &Path,
    plan: Plan,
    space: Space,
    format: Format,
    outcome: RunOutcome,
) -> Result<Exit, Error> {
    let found = Reader::with_reader(db, async |reader| SearchState::of(reader, plan, space).await).await?;
    exit_of(&outcome, print_search(db, &found, format))
}

/// Prints the table and the verdict; returns the exit code of a complete search.
fn print_search(db: &Path, found: &SearchState, format: Format) -> Result<Exit, Error> {
    print_rows(&found.table(), format)?;
    if format == Format::Table {
        COLUMNS.iter().for_each(|line| say!("  {line}"));
    }
    found.verdict().iter().for_each(|line| say!("{line}"));
    let chosen = found.chosen();
    if let Some((trial, _)) = chosen {
        let reader = if found.reads_all_casts() { " --reader casts" } else { "" };
        say!("  metasense export {} {} --format device{reader} --out device", files::quoted(db), trial.hash);
    }
    Ok(if chosen.is_some() { Exit::Done } else { Exit::Failed })
}
