//! The log of a run: a file beside its database, one line per event.

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;

use super::Error;

/// Environment variable that selects what is logged, such as `debug` or `metasense::engine=trace`.
const FILTER: &str = "METASENSE_LOG";

/// Path of the log of a run with this database.
///
/// # Errors
/// If the log would be the database itself.
pub fn path(database: &Path) -> Result<PathBuf, Error> {
    match database.extension().is_some_and(|ending| ending == "log") {
        true => usage!(
            "--db {}: the log of the run would be this file; use another extension for the database",
            database.display()
        ),
        false => Ok(database.with_extension("log")),
    }
}

/// Appends all later events to the file. Call once per process.
pub fn start(path: &Path) -> Result<(), Error> {
    let file = OpenOptions::new().create(true).append(true).open(path);
    let file = file.map_err(Error::io("opening the log", path))?;
    let asked = std::env::var(FILTER).ok().and_then(|filter| filter.parse::<Targets>().ok());
    let lines = tracing_subscriber::fmt::layer().with_writer(Mutex::new(file)).with_ansi(false);
    let filter = asked.unwrap_or_else(|| Targets::new().with_default(tracing::Level::INFO));
    let subscriber = tracing_subscriber::registry().with(filter).with(lines);
    // A second run in the same process keeps the log of the first.
    let _ = tracing::subscriber::set_global_default(subscriber);
    Ok(())
}
