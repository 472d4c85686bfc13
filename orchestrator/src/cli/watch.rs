//! `watch`: a run as it goes on, seen from its database, from any terminal.

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use super::status::newest;
use super::{Error, Format, is_live, print_rows};
use crate::exit::Exit;
use crate::progress::Looks;
use crate::store::Reader;

/// Watches a run in a terminal: workers, steps, errors, time to go
///
/// It does not disturb the run, and ends with it. `silent_s` is the time since the last record of a trial, `cpu_%` the worker's
/// share of a core since the last look.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database; by default the one under results/ that was written last
    db: Option<PathBuf>,
    /// Look once
    #[arg(long)]
    once: bool,
}

/// Time between two looks.
const EVERY: Duration = Duration::from_secs(1);

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let db = args.db.map_or_else(|| newest("watch"), Ok)?;
    let live = is_live(&std::io::stdout()) && !args.once;
    let mut looks = Looks::default();
    if looks.begin(&db).await {
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    loop {
        let seen = Reader::asked(&db, async |reader| looks.look(reader).await).await?;
        if live {
            // Home, and clear to the end of the screen.
            write!(std::io::stdout(), "\x1b[H\x1b[2J")?;
        }
        print_line!("{}: {}", db.display(), seen.summary)?;
        if !seen.workers.rows.is_empty() {
            print_rows(&seen.workers, Format::Table)?;
        }
        std::io::stdout().flush()?;
        if seen.run.is_none() {
            print_line!("no run is at work on it")?;
        }
        if args.once || seen.run.is_none() {
            return Ok(Exit::Done);
        }
        tokio::time::sleep(EVERY).await;
    }
}
