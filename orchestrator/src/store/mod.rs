//! The store: one SQLite file a database, one writer, any number of readers.
//!
//! Journal in WAL mode with `synchronous = FULL`: what a method has returned from is on disk, and survives `kill -9`
//! and power loss alike. The price is one fsync a transaction, which `begin_batch` … `commit_batch` shares between
//! many records. A lock on the file keeps a second writer out for as long as a `Store` lives.
//! All methods fail where SQLite does; what else can go wrong is said with each.

mod allow;
mod confined;
mod connect;
mod designs;
mod digest;
mod disk;
mod error;
mod functions;
mod lock;
mod log;
mod looks;
mod made;
mod npy;
mod presence;
mod prior;
mod read;
mod redo;
mod runs;
mod stored;
mod sweep;
mod wait;
mod write;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use metasense_schemas::database::{APPLICATION_ID, SCHEMA, VERSION};
use metasense_schemas::record::Provenance;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection};

pub use confined::Limits;
pub use connect::ask_unchanging;
pub(crate) use connect::{copy_with_journal, state_of};
pub(crate) use digest::{add_function, check};
use error::OPENING;
pub use error::StoreError;
pub(crate) use error::is_shortage;
pub(crate) use lock::{beside, has_journal, is_still, lock, real};
pub use log::Level;
pub use looks::Standing;
pub use made::{Made, Nearest};
pub use npy::{npy_bytes, npy_values};
pub use presence::{Lost, Presence};
pub use prior::Attempted;
pub use read::{Answer, Artifact, Reader, Row, quoted};
pub use runs::{RunKey, RunPlan};
pub use stored::Stored;
pub use wait::{hurry, wait_for_locks};
pub use write::Array;
pub(crate) use write::RELEASE_ORPHANS;

/// The writer. All methods are cancel-safe only as a whole: drop the store, not a call.
#[derive(Debug)]
pub struct Store {
    connection: SqliteConnection,
    path: PathBuf,
    ids: HashMap<String, i64>,
    /// The sweep that was begun.
    sweep: Option<i64>,
    in_batch: bool,
    /// Of the attempts that are begun, where it is known.
    provenance: Option<Provenance>,
    /// Start of each attempt in progress, by a monotonic clock.
    begun: HashMap<(i64, u32), Instant>,
    // Last field: it owns the locked file; closing that before the connection would drop SQLite's locks.
    presence: Presence,
}

impl Store {
    /// Opens or creates a database and puts trials that a dead run left `running`
    /// back to `pending`.
    ///
    /// # Errors
    /// Unwritable, not ours, of another version, or in use by another run.
    pub async fn open(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        Self::open_file(path.as_ref().to_owned()).await.map_err(StoreError::on_opening)
    }

    async fn open_file(path: PathBuf) -> Result<Self, StoreError> {
        let file = real(&path);
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder)
            .map_err(|source| StoreError::Unwritable { path: path.clone(), source })?;
        if let Some(system) = disk::network_of(folder) {
            return Err(StoreError::NetworkDisk { path, system });
        }
        let lock = Arc::new(lock(&path, true)?);
        let at = |source| StoreError::sql(&path, OPENING, source);
        let mut connection = options(&path).foreign_keys(true).connect().await.map_err(at)?;
        wait::wait_on(&mut connection).await.map_err(at)?;
        functions::register(&mut connection).await.map_err(at)?;
        let version = check_version(&mut connection, &path).await?;
        for pragma in ["PRAGMA journal_mode = WAL", "PRAGMA synchronous = FULL"] {
            sqlx::query(pragma).execute(&mut connection).await.map_err(at)?;
        }
        add_schema(&mut connection, version).await.map_err(at)?;
        let mut store = Self {
            presence: Presence::new(Arc::clone(&lock), &path),
            connection,
            path,
            ids: HashMap::new(),
            sweep: None,
            in_batch: false,
            provenance: None,
            begun: HashMap::new(),
        };
        store.release_orphans().await?;
        // the log exists now
        store.presence = Presence::new(lock, &store.path);
        Ok(store)
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// From here on this is recorded with each attempt and run.
    pub fn set_provenance(&mut self, provenance: Provenance) {
        self.provenance = Some(provenance);
    }

    /// Checks the files of the database while it is open.
    #[must_use]
    pub fn presence(&self) -> Presence {
        self.presence.clone()
    }

    /// Folds the journal into the file and closes it, so that one file alone is left.
    ///
    /// # Errors
    /// If SQLite fails; `Lost` if the files were taken away, which says where the recorded data is.
    pub async fn close(self) -> Result<(), StoreError> {
        let Self { connection, path, presence, .. } = self;
        if let Some(lost) = presence.look() {
            return Err(presence::rescue(connection, &presence, lost).await);
        }
        connection.close().await.map_err(|source| StoreError::sql(&path, "closing", source))
    }
}

/// A connection that waits for others, and says nothing of what it is asked.
pub(crate) fn options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(real(path))
        .busy_timeout(Duration::from_secs(10))
        .disable_statement_logging()
}

/// The version of a database, 0 for an empty file.
pub(crate) async fn check_version(
    connection: &mut SqliteConnection,
    path: &Path,
) -> Result<usize, StoreError> {
    let at = |source| StoreError::sql(path, "reading the version of", source);
    let application: i32 =
        sqlx::query_scalar("PRAGMA application_id").fetch_one(&mut *connection).await.map_err(at)?;
    let version = version(connection).await.map_err(at)?;
    let tables: i64 = sqlx::query_scalar("SELECT count(*) FROM sqlite_schema")
        .fetch_one(&mut *connection)
        .await
        .map_err(at)?;
    // A name that is no text ends sqlx's thread, and whoever has asked waits for ever.
    let schema: Vec<Vec<u8>> =
        sqlx::query_scalar("SELECT CAST(name || coalesce(sql, '') AS BLOB) FROM sqlite_schema")
            .fetch_all(&mut *connection)
            .await
            .map_err(at)?;
    if schema.iter().any(|text| std::str::from_utf8(text).is_err()) {
        return Err(at(sqlx::Error::Protocol("the file is damaged: a name in it is no text".into())));
    }
    if application != APPLICATION_ID && (application != 0 || tables != 0) {
        return Err(StoreError::NotOurs { path: path.to_owned() });
    }
    match usize::try_from(version) {
        Ok(version @ (0 | VERSION)) => Ok(version),
        Ok(version @ 1..VERSION) => Err(StoreError::Older { path: path.to_owned(), version }),
        _ => Err(StoreError::Newer { path: path.to_owned(), version }),
    }
}

/// What a database says that its version is.
pub(crate) async fn version(connection: &mut SqliteConnection) -> sqlx::Result<i64> {
    sqlx::query_scalar("PRAGMA main.user_version").fetch_one(connection).await
}

/// Makes an empty file a database. Nobody else may know of it: nothing is locked.
pub(crate) async fn create(path: &Path) -> Result<(), StoreError> {
    let at = |source| StoreError::sql(path, "creating", source);
    let mut connection = options(path).pragma("journal_mode", "MEMORY").connect().await.map_err(at)?;
    add_schema(&mut connection, 0).await.map_err(at)?;
    connection.close().await.map_err(at)
}

/// Gives a database of version 0, which is empty, the tables and views of this version, all or nothing.
pub(crate) async fn add_schema(connection: &mut SqliteConnection, version: usize) -> sqlx::Result<()> {
    if version > 0 {
        return Ok(());
    }
    let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
    sqlx::raw_sql(SCHEMA).execute(&mut *transaction).await?;
    // Numbers of our own only.
    let mark = format!("PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {VERSION}");
    sqlx::raw_sql(AssertSqlSafe(mark)).execute(&mut *transaction).await?;
    transaction.commit().await
}
