//! The command line: one file a command.

#[macro_use]
mod say;

mod analyse;
mod bound;
mod claims;
mod control;
mod draw;
mod evaluate;
mod expand;
mod export;
mod identify;
mod live;
pub mod log;
mod merge;
mod modes;
mod one;
mod pages;
mod place;
mod project;
mod query;
mod report;
mod run;
mod schema;
mod serve;
pub mod simd;
mod simulate;
mod status;
mod submit;
mod trial;
mod unfinished;
mod verify;
mod watch;
mod why;

use std::error::Error as _;
use std::path::{Path, PathBuf};
use std::pin::Pin;

use clap::{Parser, Subcommand};

use crate::cluster::DealError;
use crate::cluster::home::HomeError;
use crate::cluster::merge::MergeError;
use crate::cluster::queue::QueueError;
use crate::control::ControlError;
use crate::engine::{EngineError, Signals};
use crate::exit::{EXIT_CODES, Exit};
use crate::plan::{OneBody, Plan};
use crate::store::StoreError;
use metasense_schemas::source::SpecError;
use metasense_worker::design::DesignError;
use metasense_worker::measured::MeasuredError;
use metasense_worker::process;

use crate::look::duration;
pub use crate::look::{Format, print_rows};

/// Trains bodies of flexible metamaterial together with the neural networks that read them, many variants at a time.
///
/// A sweep is a spec file (TOML); it expands into trials; each trial trains one body with its brain. `run` works through
/// the trials with worker processes and keeps everything in one SQLite file; stopped or killed, the same command goes on.
#[derive(Debug, Parser)]
#[command(version, after_help = EXIT_CODES, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Run(run::Args),
    Expand(expand::Args),
    Submit(submit::Args),
    Merge(merge::Args),
    Trial(trial::Args),
    Simulate(simulate::Args),
    Identify(identify::Args),
    Status(status::Args),
    Watch(watch::Args),
    Serve(serve::Args),
    Control(control::Args),
    Why(why::Args),
    Query(query::Args),
    Analyse(analyse::Args),
    Claims(claims::Args),
    Report(report::Args),
    Place(place::Args),
    Modes(modes::Args),
    Bound(bound::Args),
    Project(project::Args),
    Draw(draw::Args),
    Export(export::Args),
    Evaluate(evaluate::Args),
    Schema(schema::Args),
    /// Where the benches went.
    #[command(hide = true, disable_help_flag = true)]
    Bench {
        /// Whatever was asked.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// What the orchestrator starts; not for people.
    #[command(hide = true)]
    Worker {
        /// Where to connect to.
        start: String,
    },
    Verify(verify::Args),
}

/// Carries a command out.
///
/// # Errors
/// Bad input and failed I/O, each with its exit code.
pub fn dispatch(cli: Cli) -> Result<Exit, Error> {
    match cli.command {
        Command::Bench { arguments } => Err(Error::Usage(format!(
            "`bench` is a program of its own now, for development: `cargo run --release -p metasense-bench -- {}`",
            arguments.join(" ")
        ))),
        Command::Worker { start } => std::process::exit(process::run(&start, process::perform_trial)),
        Command::Run(args) => block_on(run::execute(args)),
        Command::Expand(args) => expand::execute(&args),
        Command::Submit(args) => block_on(submit::execute(args)),
        Command::Merge(args) => block_on(merge::execute(args)),
        Command::Trial(args) => trial::execute(&args),
        Command::Simulate(args) => simulate::execute(&args),
        Command::Identify(args) => identify::execute(&args),
        Command::Status(args) => block_on(status::execute(args)),
        Command::Watch(args) => block_on(watch::execute(args)),
        Command::Serve(args) => serve::execute(args),
        Command::Control(args) => block_on(control::execute(args)),
        Command::Why(args) => block_on(why::execute(args)),
        Command::Query(args) => block_on(query::execute(args)),
        Command::Analyse(args) => block_on(analyse::execute(args)),
        Command::Claims(args) => block_on(claims::execute(args)),
        Command::Place(args) => place::execute(&args),
        Command::Modes(args) => modes::execute(&args),
        Command::Bound(args) => block_on(bound::execute(args)),
        Command::Project(args) => project::execute(&args),
        Command::Draw(args) => draw::execute(&args),
        Command::Schema(args) => schema::execute(&args),
        Command::Report(args) => block_on(report::execute(args)),
        Command::Export(args) => block_on(export::execute(args)),
        Command::Evaluate(args) => block_on(evaluate::execute(args)),
        Command::Verify(args) => verify::execute(&args),
    }
}

/// Runs a command that waits for the database, in a runtime of its own.
///
/// # Errors
/// The command's own, or no runtime can be started.
pub fn block_on<T: 'static>(future: impl Future<Output = Result<T, Error>> + 'static) -> Result<T, Error> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|source| Error::Io { doing: "starting", path: PathBuf::from("the runtime"), source })?;
    // Boxed: the runtime's loop is compiled once, not around every command.
    let future: Pin<Box<dyn Future<Output = Result<T, Error>>>> = Box::pin(future);
    runtime.block_on(future)
}

/// From here on a signal ends the program at once, with the exit code of a stop on request: for commands that write when they
/// are done, and until then at most what they have come to.
fn end_on_signal(kept: Option<&Path>) {
    let next = kept.map_or("begins anew", |_| "goes on from here");
    std::thread::spawn(move || {
        let asked = block_on(async { Ok(Signals::new()?.unless(std::future::pending::<()>()).await) });
        if asked.is_ok() {
            say!("stopped; the same command {next}");
            std::process::exit(Exit::Interrupted as i32);
        }
    });
}

/// Reads and expands a spec file.
///
/// # Errors
/// If it cannot be read, or is no spec.
pub fn read_plan(file: &Path) -> Result<Plan, Error> {
    let text = std::fs::read_to_string(file)
        .map_err(|source| Error::Unreadable { path: file.to_owned(), source })?;
    Ok(Plan::new(file, text)?)
}

/// Reads the body of a trial of a spec file; without its hash, the one that all trials have.
fn read_body(file: &Path, hash: Option<&str>) -> Result<OneBody, Error> {
    if let Some(hash) = hash {
        let plan = read_plan(file)?;
        let trial = trial::find(&plan, hash, file)?;
        return OneBody::of_trial(&trial.spec).map_err(|e| Error::Usage(format!("{}: {e}", file.display())));
    }
    let text = std::fs::read_to_string(file)
        .map_err(|source| Error::Unreadable { path: file.to_owned(), source })?;
    OneBody::new(file, text)?.ok_or_else(|| {
        let path = file.display();
        Error::Usage(format!(
            "{path} has several bodies: choose a trial's with --hash; `metasense expand {path}` lists them"
        ))
    })
}

/// Writes a whole file.
fn write(path: &Path, bytes: impl AsRef<[u8]>) -> Result<(), Error> {
    std::fs::write(path, bytes).map_err(|source| Error::Io {
        doing: "writing",
        path: path.to_owned(),
        source,
    })
}

/// Makes a folder where it is missing.
fn make_folder(path: &Path) -> Result<(), Error> {
    std::fs::create_dir_all(path).map_err(|source| Error::Io {
        doing: "making the folder",
        path: path.to_owned(),
        source,
    })
}

/// Why a command could not be carried out.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The spec.
    #[error(transparent)]
    Spec(#[from] SpecError),
    /// A file that the command line names.
    #[error("cannot read {}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A design file.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// Measured records.
    #[error(transparent)]
    Measured(#[from] MeasuredError),
    /// The database.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A file.
    #[error("{doing} {}", path.display())]
    Io {
        /// What was being done.
        doing: &'static str,
        /// To which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The terminal or pipe that we write to.
    #[error("writing the output")]
    Output(#[from] std::io::Error),
    /// Arguments that do not go together.
    #[error("{0}")]
    Usage(String),
    /// A run that could not go on.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// A merge.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// Which shard runs what.
    #[error(transparent)]
    Deal(#[from] DealError),
    /// A scheduler's queue.
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// A shard's database.
    #[error(transparent)]
    Home(#[from] HomeError),
    /// A run that is to be steered.
    #[error(transparent)]
    Control(#[from] ControlError),
}

impl Error {
    /// The exit code.
    #[must_use]
    pub fn exit(&self) -> Exit {
        match self {
            Self::Store(e)
            | Self::Merge(MergeError::Store(e))
            | Self::Home(HomeError::Store(e) | HomeError::Merge(MergeError::Store(e)))
                if e.is_bad_input() =>
            {
                Exit::BadInput
            }
            Self::Engine(EngineError::Runtime(_)) => Exit::BadInput,
            Self::Engine(_) => Exit::Io,
            Self::Merge(MergeError::Nothing { .. }) => Exit::BadInput,
            Self::Home(HomeError::Foreign(_) | HomeError::Refused { .. }) => Exit::BadInput,
            Self::Merge(_) | Self::Home(_) | Self::Queue(_) | Self::Deal(DealError::File { .. }) => Exit::Io,
            Self::Deal(_) => Exit::BadInput,
            Self::Control(e) => control::exit(e),
            Self::Usage(_)
            | Self::Spec(_)
            | Self::Design(_)
            | Self::Measured(_)
            | Self::Unreadable { .. } => Exit::BadInput,
            Self::Store(_) | Self::Io { .. } | Self::Output(_) => Exit::Io,
        }
    }

    /// Says what went wrong and why on standard error.
    pub fn say(&self) {
        say!("error: {self}");
        let mut cause = self.source();
        while let Some(e) = cause {
            say!("  because: {e}");
            cause = e.source();
        }
    }

    /// Whether the reader of our output has gone.
    #[must_use]
    pub fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(e) if e.kind() == std::io::ErrorKind::BrokenPipe)
    }
}
