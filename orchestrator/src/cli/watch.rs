//! `watch`: shows a run in any terminal, from its database.

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use super::status::newest;
use super::{Error, Format, is_live, print_rows};
use crate::exit::Exit;
use crate::progress::Observer;
use crate::reader::Reader;

/// Shows a run in the terminal: workers, steps, errors, remaining time
///
/// It does not slow the run and ends with it. `seconds_since_step` is the time since a trial was last recorded; `cpu_%` is the
/// worker's share of a core since the last update.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database; by default the most recently written one in results/
    db: Option<PathBuf>,
}

/// Time between two updates.
const EVERY: Duration = Duration::from_secs(1);

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let db = args.db.map_or_else(|| newest("watch"), Ok)?;
    let live = is_live(&std::io::stdout());
    let mut looks = Observer::default();
    if looks.begin(&db).await {
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    loop {
        let seen = Reader::with_reader(&db, async |reader| looks.look(reader).await).await?;
        if live {
            // Moves the cursor home and clears the screen.
            write!(std::io::stdout(), "\x1b[H\x1b[2J")?;
        }
        // a closed pipe ends the command
        writeln!(std::io::stdout(), "{}: {}", db.display(), seen.summary)?;
        if !seen.workers.rows.is_empty() {
            print_rows(&seen.workers, Format::Table)?;
        }
        std::io::stdout().flush()?;
        if seen.run.is_none() {
            print_line!("no run is active")?;
            return Ok(Exit::Done);
        }
        tokio::time::sleep(EVERY).await;
    }
}
