//! The store: one SQLite file per database, one writer, any number of readers (`reader`).
//!
//! In WAL mode with `synchronous = FULL`, data is on disk when a method returns, and survives `kill -9` and power loss. Each
//! transaction costs one fsync; `begin_batch` … `commit_batch` shares it among many records. A file lock excludes a second
//! writer while a `Store` exists. All methods fail if SQLite does; their documentation lists other errors.

/// A query with these arguments.
macro_rules! bound {
    ($query:expr; $($argument:expr),+ $(,)?) => { $query$(.bind($argument))+ };
}

/// Runs a statement of a `Store` with these arguments.
macro_rules! run {
    ($store:expr, $sql:expr; $($argument:expr),+) => {
        bound!(sqlx::query($sql); $($argument),+).execute(&mut $store.connection).await
    };
}

mod designs;
mod digest;
mod error;
mod lock;
mod log;
mod presence;
mod prior;
mod redo;
mod result;
mod runs;
mod sweep;
mod write;

use std::collections::HashMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use metasense_schemas::database::{APPLICATION_ID, SCHEMA, VERSION, VIEWS, view_sql};
use metasense_schemas::record::Provenance;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection};

use crate::files::{self, resolve_links};
use crate::sql;

pub(crate) use designs::NAME as KEPT_DESIGNS;
pub(crate) use digest::check;
pub(crate) use error::{OPENING, check_utf8, is_no_json, is_not_opened, is_shortage, is_trouble};
pub use error::{Result, StoreError};
pub(crate) use lock::lock;
pub use log::LogLevel;
pub use metasense_worker::files::{npy_bytes, npy_values};
pub use presence::{FileLoss, Presence};
pub use prior::PriorProgress;
pub use runs::{RunKey, RunPlan};
pub use write::StoredArray;
pub(crate) use write::{RELEASE_ORPHANS, read_checkpoint};

/// The writer. Cancelling a call leaves it in an undefined state: then drop the store.
#[derive(Debug)]
pub struct Store {
    connection: SqliteConnection,
    path: PathBuf,
    ids: HashMap<String, i64>,
    /// Id of the current sweep.
    sweep: Option<i64>,
    in_batch: bool,
    /// Recorded with each attempt, if known.
    provenance: Option<Provenance>,
    /// Start of each attempt in progress, by a monotonic clock.
    begun: HashMap<(i64, u32), Instant>,
    // Last field: it owns the locked file. Closing that before the connection would drop SQLite's locks.
    presence: Presence,
}

impl Store {
    /// Opens or creates a database, and sets trials that a dead run left `running` to `pending`.
    ///
    /// # Errors
    /// If the file is unwritable, not a metasense database, of another version, on a network file system, or used by another
    /// run.
    pub async fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::open_file(path.as_ref().to_owned()).await.map_err(StoreError::on_opening)
    }

    async fn open_file(path: PathBuf) -> Result<Self> {
        let file = resolve_links(&path);
        check_utf8(&file)?;
        let folder = files::folder(&file);
        std::fs::create_dir_all(folder).map_err(|source| StoreError::Unwritable(path.clone(), source))?;
        if let Some(system) = files::disk::network_of(folder) {
            return Err(StoreError::NetworkDisk(path, system));
        }
        // A link to a missing file stays.
        let is_new = file.symlink_metadata().is_err();
        let lock = Arc::new(lock(&path, true)?);
        let opened = Self::open_locked(path, Arc::clone(&lock)).await;
        if opened.is_err() && is_new && files::is_still(&lock, &file) {
            let _ = std::fs::remove_file(&file);
        }
        opened
    }

    async fn open_locked(path: PathBuf, lock: Arc<File>) -> Result<Self> {
        let at = |source| StoreError::sql(&path, OPENING, source);
        let mut connection = options(&path).foreign_keys(true).connect().await.map_err(at)?;
        sql::wait_on(&mut connection).await.map_err(at)?;
        sql::register(&mut connection).await.map_err(at)?;
        let version = check_version(&mut connection, &path).await?;
        // Statement journals in memory: TMPDIR may be full.
        for pragma in ["PRAGMA temp_store = MEMORY", "PRAGMA journal_mode = WAL", "PRAGMA synchronous = FULL"]
        {
            sqlx::query(pragma).execute(&mut connection).await.map_err(at)?;
        }
        add_schema(&mut connection, version).await.map_err(at)?;
        let presence = Presence::new(Arc::clone(&lock), &path);
        let (ids, begun, sweep, in_batch, provenance) = Default::default();
        let mut store = Self { presence, connection, path, ids, sweep, in_batch, provenance, begun };
        store.release_orphans().await?;
        // the write-ahead log exists now
        store.presence = Presence::new(lock, &store.path);
        Ok(store)
    }

    /// Path of the database.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Sets the provenance to record with each attempt and run from now on.
    pub fn set_provenance(&mut self, provenance: Provenance) {
        self.provenance = Some(provenance);
    }

    /// A checker for the database files.
    pub fn presence(&self) -> Presence {
        self.presence.clone()
    }

    /// Moves the write-ahead log into the database and closes it, so that a single file remains.
    /// Fails with `Lost` if the files have disappeared, with the path of the saved data.
    pub async fn close(self) -> Result<()> {
        let Self { connection, path, presence, .. } = self;
        if let Some(lost) = presence.check() {
            return Err(presence::rescue(connection, &presence, lost).await);
        }
        connection.close().await.map_err(|source| StoreError::sql(&path, "closing", source))
    }
}

/// Options of a connection that waits for locks and logs no statements.
pub(crate) fn options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(resolve_links(path))
        .busy_timeout(Duration::from_secs(10))
        .disable_statement_logging()
}

/// Version of a database, 0 for an empty file.
pub(crate) async fn check_version(connection: &mut SqliteConnection, path: &Path) -> Result<usize> {
    let at = |source| StoreError::sql(path, "reading the version of", source);
    let id = sqlx::query_scalar("PRAGMA application_id");
    let application: i32 = id.fetch_one(&mut *connection).await.map_err(at)?;
    let version = version(connection).await.map_err(at)?;
    // sqlx's thread dies on a name that is not UTF-8, and the caller would wait forever; therefore read names as blobs.
    let names = sqlx::query_scalar("SELECT CAST(name || coalesce(sql, '') AS BLOB) FROM sqlite_schema");
    let schema: Vec<Vec<u8>> = names.fetch_all(&mut *connection).await.map_err(at)?;
    if schema.iter().any(|text| std::str::from_utf8(text).is_err()) {
        return Err(at(sqlx::Error::Protocol(
            "the file is damaged: the name of a table or column is not UTF-8".into(),
        )));
    }
    if application != APPLICATION_ID && (application != 0 || !schema.is_empty()) {
        return Err(StoreError::NotOurs(path.to_owned()));
    }
    match usize::try_from(version) {
        Ok(version @ (0 | VERSION)) => Ok(version),
        Ok(version @ 1..VERSION) => Err(StoreError::Older(path.to_owned(), version)),
        _ => Err(StoreError::Newer(path.to_owned(), version)),
    }
}

/// The stored version number of a database.
pub(crate) async fn version(connection: &mut SqliteConnection) -> sqlx::Result<i64> {
    sqlx::query_scalar("PRAGMA main.user_version").fetch_one(connection).await
}

/// Creates a database in an empty file, without locks: no other process may know the file.
pub(crate) async fn create(path: &Path) -> Result<()> {
    let at = |source| StoreError::sql(path, "creating", source);
    let mut connection = options(path).pragma("journal_mode", "MEMORY").connect().await.map_err(at)?;
    add_schema(&mut connection, 0).await.map_err(at)?;
    connection.close().await.map_err(at)
}

/// Creates the views that an earlier build of this version did not create or created otherwise: `create` is `CREATE`, or
/// `CREATE TEMP` for one connection, which hides the stored view.
pub(crate) async fn add_views(connection: &mut SqliteConnection, create: &str) -> sqlx::Result<()> {
    let stored = "SELECT sql || ';' FROM sqlite_schema WHERE type = 'view'";
    let known: Vec<String> = sqlx::query_scalar(stored).fetch_all(&mut *connection).await?;
    for (view, _) in VIEWS.iter().filter(|(view, _)| !known.iter().any(|sql| sql == view_sql(view))) {
        let drop = if create == "CREATE" { format!("DROP VIEW IF EXISTS {view};") } else { String::new() };
        // Safe: contains only our own text.
        let sql =
            AssertSqlSafe(format!("BEGIN;{drop}{};COMMIT", view_sql(view).replacen("CREATE", create, 1)));
        sqlx::raw_sql(sql).execute(&mut *connection).await?;
    }
    Ok(())
}

/// Creates tables and views in an empty database (version 0), in one transaction; in others only missing views.
pub(crate) async fn add_schema(connection: &mut SqliteConnection, version: usize) -> sqlx::Result<()> {
    if version > 0 {
        return add_views(connection, "CREATE").await;
    }
    let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
    sqlx::raw_sql(SCHEMA).execute(&mut *transaction).await?;
    // Safe: contains only our own integers.
    let mark = format!("PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {VERSION}");
    sqlx::raw_sql(AssertSqlSafe(mark)).execute(&mut *transaction).await?;
    transaction.commit().await
}
