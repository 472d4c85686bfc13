//! What is said of an attempt, kept with it.

use super::{Store, StoreError};

/// Lines that are kept of an attempt; the last one says that there are more.
pub const LINES: u32 = 100;
/// Characters that are kept of a line.
pub const CHARACTERS: usize = 2000;

/// How bad what is said is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// It is not.
    Info,
    /// Something went wrong, and the trial goes on.
    Warn,
    /// The attempt came to nothing for it.
    Error,
}

impl Level {
    fn name(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error => "error",
        }
    }
}

impl Store {
    /// Keeps a line with an attempt, bounded in length and number; an error always has room.
    pub async fn log(
        &mut self,
        hash: &str,
        attempt: u32,
        level: Level,
        text: &str,
    ) -> Result<(), StoreError> {
        let id = self.id(hash)?;
        let text: String = match text.char_indices().nth(CHARACTERS) {
            Some((end, _)) => format!("{} …", &text[..end]),
            None => text.to_owned(),
        };
        sqlx::query(
            "INSERT INTO log (trial_id, attempt, line, at, level, text)
             SELECT ?1, ?2, n + 1, strftime('%Y-%m-%dT%H:%M:%fZ'), ?3,
               CASE WHEN n + 1 = ?5 AND ?3 <> 'error' THEN 'more stands in the log beside the database' ELSE ?4 END
             FROM (SELECT coalesce(max(line), 0) AS n FROM log WHERE trial_id = ?1 AND attempt = ?2)
             WHERE n < ?5 OR ?3 = 'error'",
        )
        .bind(id)
        .bind(attempt)
        .bind(level.name())
        .bind(text)
        .bind(LINES)
        .execute(&mut self.connection)
        .await
        .map(|_| ())
        .map_err(|source| StoreError::sql(&self.path, "recording what was said in", source))
    }
}
