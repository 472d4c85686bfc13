//! Why a command could not be carried out.

use std::error::Error as _;
use std::path::{Path, PathBuf};

use metasense_schemas::source::SpecError;
use metasense_worker::design::DesignError;
use metasense_worker::limits::Shortage;
use metasense_worker::measured::MeasuredError;

use super::control;
use crate::cluster::AssignmentError;
use crate::cluster::home::HomeError;
use crate::cluster::merge::MergeError;
use crate::cluster::queue::QueueError;
use crate::control::ControlError;
use crate::engine::EngineError;
use crate::exit::Exit;
use crate::files::host;
use crate::store::StoreError;

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
    /// The machine allows too little.
    #[error("the limits of {host} are too low, and nothing was started: {0}", host = host())]
    Short(String),
    /// A merge.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// Shards that do not get further.
    #[error(
        "shards {shards} ended without a step or a result: see their outputs in {}; the same command tries again",
        folder.display()
    )]
    Shards {
        /// Where they are.
        folder: PathBuf,
        /// Which.
        shards: String,
    },
    /// Which shard runs what.
    #[error(transparent)]
    Assignment(#[from] AssignmentError),
    /// A scheduler's queue.
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// A scheduler has accepted some jobs, and not all.
    #[error("{0}")]
    Partly(String),
    /// A shard's database.
    #[error(transparent)]
    Home(#[from] HomeError),
    /// A run that is to be steered.
    #[error(transparent)]
    Control(#[from] ControlError),
}

impl From<Shortage> for Error {
    fn from(short: Shortage) -> Self {
        Self::Short(short.to_string())
    }
}

impl Error {
    /// A failure of the system in doing something to a file.
    pub(super) fn io(doing: &'static str, path: impl Into<PathBuf>) -> impl Fn(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { doing, path: path.clone(), source }
    }

    /// A file that the command line names cannot be read.
    pub(super) fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Unreadable { path: path.to_owned(), source }
    }

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
            Self::Engine(EngineError::Runtime(_) | EngineError::Short(_) | EngineError::NoWorkers(_))
            | Self::Short(_)
            | Self::Shards { .. } => Exit::Unfit,
            Self::Engine(_) => Exit::Io,
            Self::Merge(MergeError::Nothing { .. } | MergeError::Result { .. } | MergeError::NotFacts(_)) => {
                Exit::BadInput
            }
            Self::Home(
                HomeError::Foreign(_)
                | HomeError::Refused { .. }
                | HomeError::Merge(MergeError::Result { .. }),
            ) => Exit::BadInput,
            Self::Merge(_)
            | Self::Home(_)
            | Self::Queue(_)
            | Self::Partly(_)
            | Self::Assignment(AssignmentError::File { .. }) => Exit::Io,
            Self::Assignment(_) => Exit::BadInput,
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
