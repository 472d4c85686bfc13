//! The log lines of an attempt.

use super::{Result, Store};

/// Most lines per attempt; the last one says that more exist.
pub const LINES: u32 = 100;
/// Most characters per line.
pub const CHARACTERS: usize = 2000;

/// Severity of a log line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogLevel {
    /// Information.
    Info,
    /// Something failed, but the trial continues.
    Warn,
    /// The attempt failed.
    Error,
}

impl LogLevel {
    fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error => "error",
        }
    }
}

impl Store {
    /// Stores a line of an attempt, limited in length and number; errors are always stored.
    pub async fn log(&mut self, hash: &str, attempt: u32, level: LogLevel, text: &str) -> Result<()> {
        let id = self.id(hash)?;
        let text: String = match text.char_indices().nth(CHARACTERS) {
            Some((end, _)) => format!("{} …", &text[..end]),
            None => text.to_owned(),
        };
        run!(self,
            "INSERT INTO log (trial_id, attempt, line, at, level, text)
             SELECT ?1, ?2, n + 1, strftime('%Y-%m-%dT%H:%M:%fZ'), ?3,
               CASE WHEN n + 1 = ?5 AND ?3 <> 'error' THEN 'further lines are in the log file beside the database' ELSE ?4 END
             FROM (SELECT coalesce(max(line), 0) AS n FROM log WHERE trial_id = ?1 AND attempt = ?2)
             WHERE n < ?5 OR ?3 = 'error'"; id, attempt, level.name(), text, LINES)
        .map(drop)
        .map_err(self.at("recording what was said in"))
    }
}
