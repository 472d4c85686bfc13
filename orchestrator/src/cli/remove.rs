//! `remove`: removes trials from a database.

use std::path::PathBuf;

use super::{Error, Format, print_rows};
use crate::exit::Exit;
use crate::look::{Table, row};
use crate::plan::counted;
use crate::serve::Trials;
use crate::store::{Store, StoreError};

/// Lists trials that meet conditions, and removes them from the database
///
/// Their results, steps, networks and arrays are removed as well. `run` repeats removed trials of its spec. New rows use
/// the freed space; `sqlite3 DB VACUUM` returns it to the disk.
///
/// For instance: metasense remove results/x.sqlite state=failed "M<=3" optimise.brain=linear 'reason=took too long'
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database; no run may hold it
    db: PathBuf,
    /// KEY=VALUE, also with != < > <= >= and ~ (contains); all conditions must hold. KEY is K, M, placement, seed, units,
    /// state, reason, hash, an error (holdout_initial, holdout_optimised, test_initial, test_optimised), or a path of the
    /// spec. reason="" (with the quotes) matches an empty value
    #[arg(required = true, value_name = "CONDITION")]
    conditions: Vec<String>,
    /// Removes the listed trials; by default they are only listed
    #[arg(long)]
    yes: bool,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    if !args.db.is_file() {
        return Err(StoreError::Missing(args.db).into());
    }
    // Holds the database, so that no run changes the listed trials before they are removed.
    let store = if args.yes { Some(Store::open(&args.db).await?) } else { None };
    let trials = Trials::of(&args.db).await?;
    let found = trials.chosen(&args.conditions).map_err(Error::Usage)?;
    let cells = ["K", "M", "placement", "seed", "holdout_optimised"];
    let rows = found.iter().map(|trial| {
        let [panels, sensors, placement, seed, error] = cells.map(|key| trial.cell(key));
        row![trial.hash.clone(), trial.state.clone(), panels, sensors, placement, seed, error]
    });
    print_rows(&Table::new("hash state K M placement seed holdout_optimised", rows), Format::Table)?;
    let count = counted(found.len(), "trial");
    let Some(mut store) = store else {
        say!("{count} of {} would be removed; pass --yes to remove them", trials.rows.len());
        return Ok(Exit::Done);
    };
    say!("removing {count} of {}", trials.rows.len());
    store.remove(found.iter().map(|trial| trial.hash.as_str())).await?;
    store.close().await?;
    say!("{count} removed");
    Ok(Exit::Done)
}
