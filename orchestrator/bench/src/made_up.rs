//! Databases of synthetic trials, filled by SQL.

use std::path::{Path, PathBuf};

use metasense::cli::Error;
use metasense::store::StoreError;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, Executor};

/// A folder for databases, removed when dropped.
pub struct Scratch(pub PathBuf);

impl Scratch {
    pub fn new(within: &Path, name: &str) -> Self {
        Self(within.join(format!("bench-{name}-{}", std::process::id())))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A database in an open transaction, without syncs to disk.
pub struct BulkDatabase<'a> {
    file: &'a Path,
    pub db: SqliteConnection,
}

impl<'a> BulkDatabase<'a> {
    pub async fn begin(file: &'a Path) -> Result<Self, Error> {
        let options = SqliteConnectOptions::new().filename(file).pragma("synchronous", "OFF");
        let db = options.disable_statement_logging().connect().await.map_err(at(file))?;
        let mut made = Self { file, db };
        made.execute(&["PRAGMA journal_mode = DELETE; BEGIN".to_owned()]).await?;
        Ok(made)
    }

    pub async fn execute(&mut self, statements: &[String]) -> Result<(), Error> {
        self.db.execute(AssertSqlSafe(statements.join(";\n"))).await.map(|_| ()).map_err(at(self.file))
    }

    pub async fn commit(mut self) -> Result<(), Error> {
        self.execute(&["COMMIT".to_owned()]).await?;
        self.db.close().await.map_err(at(self.file))
    }
}

/// Converts SQLite errors while creating this file.
pub fn at(file: &Path) -> impl Fn(sqlx::Error) -> Error {
    move |source| Error::Store(StoreError::sql(file, "making", source))
}

/// Start of a statement that defines the table `n (i)` with the numbers 0 … n − 1.
pub fn count(n: u32) -> String {
    format!("WITH RECURSIVE n (i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i + 1 < {n})")
}
