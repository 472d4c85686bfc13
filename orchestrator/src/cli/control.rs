//! `control`: controls the run that holds a database.

use std::path::PathBuf;

use clap::Subcommand;

use super::Error;
use crate::control::{self, Command, ControlError, WORKERS_MAX};
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
    command: Steer,
}

#[derive(Debug, Subcommand)]
enum Steer {
    /// Prints the state of the run: running, paused or stopping, busy workers, finished and pending trials
    State,
    /// Stops trials after their step in progress and starts none until `resume`; workers stay idle
    Pause,
    /// Resumes the run after a pause, each trial from its last step
    Resume,
    /// Ends the run cleanly, like one Ctrl-C; `run SPEC` resumes it
    Stop,
    /// Cancels a trial; a running trial ends after its step in progress. It is stored as failed (`cancelled`), also for
    /// later runs; `run SPEC --retry-failed` resumes it from its last step
    Cancel {
        /// Hash of the trial, or the beginning of it
        hash: String,
    },
    /// Gives a pending trial to the next free worker
    Next {
        /// Hash of the trial, or the beginning of it
        hash: String,
    },
    /// Changes the number of worker processes; surplus workers end when idle
    Workers {
        /// Number of worker processes, at least 1
        #[arg(value_parser = clap::value_parser!(u32).range(1..=i64::from(WORKERS_MAX)))]
        count: u32,
    },
    /// Reads the spec again and adds its new trials. Trials that the spec no longer contains stay; [run] is not read again;
    /// a spec with an error changes nothing
    Reload,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let command = match args.command {
        Steer::State => Command::State,
        Steer::Pause => Command::Pause,
        Steer::Resume => Command::Resume,
        Steer::Stop => Command::Stop,
        Steer::Cancel { hash } => Command::Cancel(hash),
        Steer::Next { hash } => Command::Next(hash),
        Steer::Workers { count } => Command::Workers(count),
        Steer::Reload => Command::Reload,
    };
    // apply the same checks as to commands from the browser
    command.to_string().parse::<Command>().map_err(|e| Error::Usage(e.to_string()))?;
    let said = control::ask(&args.db, &command).await?;
    if said.done {
        print_line!("{}", said.text)?;
        return Ok(Exit::Done);
    }
    say!("refused: {}", said.text);
    Ok(Exit::Failed)
}

/// The exit code of an error.
pub(super) fn exit(error: &ControlError) -> Exit {
    match error {
        ControlError::NoDatabase { .. } | ControlError::NoRun { .. } => Exit::BadInput,
        ControlError::NotListening { .. } | ControlError::Io { .. } => Exit::Io,
    }
}
