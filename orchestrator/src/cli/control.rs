//! `control`: controls the run that holds a database.

use std::path::PathBuf;

use super::Error;
use crate::control::{Command, ask};
use crate::exit::Exit;

/// Controls a run: pauses or stops it, changes workers, cancels trials, reloads its spec
///
/// Commands go to the `run` that holds the database, through the socket DB.control beside it, which only its owner can
/// open. Trials stop after the step in progress and keep their checkpoints. `stop` waits for this at most as long as Ctrl-C
/// does (`run.grace`). The log of the run records commands and replies.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Exit codes:
  0  done; the answer is on standard output
  1  the run refused the command and printed the reason; nothing has changed
  2  no run holds the database, or the command line is at fault
  3  the run does not answer

Examples:
  metasense control results/two-core.sqlite pause
  metasense control results/two-core.sqlite next 3f6a
  metasense control results/two-core.sqlite workers 4")]
pub(super) struct Args {
    /// The database that the run writes to
    db: PathBuf,
    #[command(subcommand)]
    command: Command,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    // apply the same checks as to commands from the browser
    args.command.to_string().parse::<Command>().map_err(|e| Error::Usage(e.to_string()))?;
    let said = ask(&args.db, &args.command).await?;
    if said.done {
        print_line!("{}", said.text)?;
        return Ok(Exit::Done);
    }
    say!("refused: {}", said.text);
    Ok(Exit::Failed)
}
