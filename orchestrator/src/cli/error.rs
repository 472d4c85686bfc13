//! Errors of commands.

use std::path::{Path, PathBuf};

use metasense_lab::measured::MeasuredError;
use metasense_source::SpecError;
use metasense_worker::design::DesignError;
use metasense_worker::limits::Shortage;

use crate::cluster::AssignmentError;
use crate::cluster::home::HomeError;
use crate::cluster::merge::MergeError;
use crate::cluster::queue::QueueError;
use crate::control::ControlError;
use crate::engine::EngineError;
use crate::exit::Exit;
use crate::files::host;
use crate::signals::SignalError;
use crate::store::StoreError;

/// The reason why a command failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "names and messages say what failed")]
pub enum Error {
    #[error(transparent)]
    Spec(#[from] SpecError),
    /// A file that the command line names cannot be read.
    #[error("cannot read {}", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Design(#[from] DesignError),
    #[error(transparent)]
    Measured(#[from] MeasuredError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("{doing} {}", path.display())]
    Io { doing: &'static str, path: PathBuf, source: std::io::Error },
    #[error("writing the output")]
    Output(#[from] std::io::Error),
    #[error("{0}")]
    Usage(String),
    #[error(transparent)]
    Engine(#[from] EngineError),
    #[error("the limits of {host} are too low, and nothing was started: {0}", host = host())]
    Short(String),
    #[error(transparent)]
    Merge(#[from] MergeError),
    #[error(
        "shards {shards} ended without a step or a result: see their outputs in {}; the same command tries again",
        folder.display()
    )]
    Shards { folder: PathBuf, shards: String },
    #[error(transparent)]
    Assignment(#[from] AssignmentError),
    #[error(transparent)]
    Queue(#[from] QueueError),
    /// The scheduler accepted only some of the jobs.
    #[error("{0}")]
    Partly(String),
    #[error(transparent)]
    Home(#[from] HomeError),
    #[error(transparent)]
    Signals(#[from] SignalError),
    #[error(transparent)]
    Control(#[from] ControlError),
}

/// An error and its causes, one per line.
pub fn with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(e) = cause {
        text += &format!("\n  because: {e}");
        cause = e.source();
    }
    text
}

impl From<Shortage> for Error {
    fn from(short: Shortage) -> Self {
        Self::Short(short.to_string())
    }
}

impl Error {
    /// Returns a conversion of I/O errors during an operation on a file.
    pub(super) fn io(doing: &'static str, path: impl Into<PathBuf>) -> impl Fn(std::io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { doing, path: path.clone(), source }
    }

    /// Returns a conversion of I/O errors for an unreadable file of the command line.
    pub(super) fn unreadable(path: &Path) -> impl Fn(std::io::Error) -> Self {
        move |source| Self::Unreadable { path: path.to_owned(), source }
    }

    /// The exit code.
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
            Self::Control(ControlError::NoDatabase { .. } | ControlError::NoRun { .. })
            | Self::Usage(_)
            | Self::Spec(_)
            | Self::Design(_)
            | Self::Measured(_)
            | Self::Unreadable { .. } => Exit::BadInput,
            Self::Store(_) | Self::Io { .. } | Self::Output(_) | Self::Signals(_) | Self::Control(_) => {
                Exit::Io
            }
        }
    }

    /// Prints the error and its causes on standard error.
    pub fn say(&self) {
        say!("error: {}", with_causes(self));
    }

    /// Whether the program that reads our output has closed the pipe.
    pub fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(e) if e.kind() == std::io::ErrorKind::BrokenPipe)
    }
}
