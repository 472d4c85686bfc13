//! The log of a run: a file beside its database, one line an event.

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use tracing_subscriber::EnvFilter;

use super::Error;

/// Variable that chooses what is logged, for instance `debug` or `metasense::engine=trace`.
const FILTER: &str = "METASENSE_LOG";

/// Where the log of a run with this database is.
pub fn path(database: &Path) -> PathBuf {
    database.with_extension("log")
}

/// From here on, what happens is written to the end of the file. To be called once.
///
/// # Errors
/// If the file cannot be written.
pub fn start(path: &Path) -> Result<(), Error> {
    let file = OpenOptions::new().create(true).append(true).open(path);
    let file =
        file.map_err(|source| Error::Io { doing: "opening the log", path: path.to_owned(), source })?;
    let filter = EnvFilter::try_from_env(FILTER).unwrap_or_else(|_| EnvFilter::new("info"));
    let subscriber = tracing_subscriber::fmt()
        .with_writer(Mutex::new(file))
        .with_ansi(false)
        .with_env_filter(filter)
        .finish();
    // A second run of the same process goes on with the first one's log.
    let _ = tracing::subscriber::set_global_default(subscriber);
    Ok(())
}
