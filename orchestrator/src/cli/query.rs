//! `query`: SQL to a database, read-only.

use std::path::PathBuf;

use metasense_schemas::database::VIEWS;

use super::{Error, Format, print_rows, write_rows};
use crate::exit::Exit;
use crate::store::{Reader, Table};

/// Asks a database in SQL; it cannot be changed this way, and may be asked while a run writes to it
///
/// For instance:
///   metasense query results/quickstart.sqlite "SELECT panels, sensors, avg(error_optimised) FROM v_trial GROUP BY 1, 2"
#[derive(Debug, clap::Args)]
#[command(verbatim_doc_comment)]
pub(super) struct Args {
    /// The database
    db: PathBuf,
    /// One SQL statement
    #[arg(required_unless_present = "views")]
    sql: Option<String>,
    /// List the views and their columns instead
    #[arg(long, conflicts_with = "sql")]
    views: bool,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
    /// The file that the rows go to, instead of standard output
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let mut reader = Reader::open(&args.db).await?;
    let table = match &args.sql {
        Some(sql) => reader.query(sql).await.map_err(Error::from),
        None => views(&mut reader).await,
    };
    reader.close().await;
    let table = table?;
    match args.out {
        None => print_rows(&table, args.format)?,
        Some(path) => {
            let written = std::fs::File::create(&path).and_then(|file| write_rows(&table, args.format, file));
            written.map_err(|source| Error::Io { doing: "writing", path, source })?;
        }
    }
    Ok(Exit::Done)
}

async fn views(reader: &mut Reader) -> Result<Table, Error> {
    let mut rows = Vec::new();
    for (view, description) in VIEWS {
        let columns = reader
            .query(&format!("SELECT group_concat(name, ', ') FROM pragma_table_info('{view}')"))
            .await?;
        rows.push(vec![(*view).into(), (*description).into(), columns.rows[0][0].clone()]);
    }
    Ok(Table { columns: ["view", "a row is", "columns"].map(String::from).to_vec(), rows })
}
