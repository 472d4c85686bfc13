//! Queue to the database's writer, and checks of its files.

use std::time::{Duration, Instant};

use metasense_schemas::wire::Lease;
use tokio::sync::mpsc;

use super::writer::Entry;
use super::{Engine, Event, Events};
use crate::store::{LogLevel, Presence, StoreError};

/// Time between two checks.
const LOOK: Duration = Duration::from_secs(1);
/// Size of the write-ahead log at which the run warns (bytes). SQLite moves the log into the database every few MB unless a
/// reader holds an older snapshot.
const LOG_LARGE: u64 = 256 << 20;

/// Queue to the writer, state of the database files, and the first error.
pub(super) struct WriterLink {
    pub queue: mpsc::Sender<Entry>,
    /// Log lines that the writer does not have yet.
    pub pending_log: Vec<(Lease, LogLevel, String)>,
    pub files: Files,
    pub error: Option<StoreError>,
}

/// The files, and what was noticed about them.
#[derive(Debug)]
pub(super) struct Files {
    presence: Presence,
    checked: Instant,
    /// Size of the write-ahead log at which to warn next (bytes).
    warn_at: u64,
}

impl Files {
    pub fn new(presence: Presence) -> Self {
        Self { presence, checked: Instant::now(), warn_at: LOG_LARGE }
    }
}

impl Engine<'_> {
    /// Ends the run if the database files have disappeared, so that the data can be saved. Warns if the log grows large.
    pub(super) fn check_database(&mut self, events: &mut Events) {
        if self.writer.files.checked.elapsed() < LOOK {
            return;
        }
        self.writer.files.checked = Instant::now();
        if self.writer.error.is_none()
            && let Some(lost) = self.writer.files.presence.check()
        {
            tracing::error!(?lost, "the database files were deleted, moved or replaced; the run ends");
            let saved = Err("the run ends".into());
            self.writer.error =
                Some(StoreError::Lost { path: self.writer.files.presence.path().to_owned(), lost, saved });
            events.push_back(Event::StoreBroken);
        }
        let bytes = self.writer.files.presence.log_bytes();
        if bytes > self.writer.files.warn_at {
            self.writer.files.warn_at = 2 * bytes;
            let text = format!(
                "warning: the database's log (-wal) has grown to {} MB because another program keeps a read transaction open; it grows \
                 until that program ends",
                bytes >> 20
            );
            tracing::warn!(bytes, "{text}");
            self.watch.warned(&text);
        }
    }
}
