//! `status`: what is done, running, failed and why; also while a run goes on.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::{Error, Format, print_rows};
use crate::exit::Exit;
use crate::store::Reader;

/// Shows what is done, running, pending and failed, and why; also while a run goes on
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database; by default the one under results/ that was written last
    db: Option<PathBuf>,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let db = match args.db {
        Some(db) => db,
        None => newest(Path::new("results")).ok_or_else(|| {
            Error::Usage("there is no database under results/; name one: metasense status DB".into())
        })?,
    };
    let mut reader = Reader::open(&db).await?;
    eprintln!("{}", db.display());
    let table = reader
        .query(
            "SELECT sweep, state, CASE WHEN state <> 'done' THEN coalesce(reason, '') ELSE '' END AS reason,
               count(*) AS trials, sum(steps) AS steps, sum(attempts) AS attempts,
               round(sum(seconds), 1) AS seconds, avg(error_initial) AS error_initial,
               avg(error_optimised) AS error_optimised
             FROM v_trial GROUP BY 1, 2, 3 ORDER BY 1, 2, 3",
        )
        .await?;
    let failed =
        reader.query("SELECT count(*) FROM trial WHERE state = 'failed' AND reason <> 'pruned'").await?;
    reader.close().await;
    print_rows(&table, args.format)?;
    Ok(if failed.rows[0][0] == 0 { Exit::Done } else { Exit::Failed })
}

/// The database written last.
pub(super) fn newest(folder: &Path) -> Option<PathBuf> {
    let written =
        |path: &PathBuf| path.metadata().and_then(|m| m.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    let entries = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    entries.filter(|path| path.extension().is_some_and(|e| e == "sqlite")).max_by_key(written)
}
