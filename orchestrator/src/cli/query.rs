//! `query`: runs SQL on a database, read-only.

use std::io::Write;
use std::path::{Path, PathBuf};

use metasense_schemas::database::VIEWS;

use super::named::Database;
use super::{Error, Format, print_rows, write};
use crate::exit::Exit;
use crate::files::Output;
use crate::look::{RowWriter, Table, lines, screen, standard_output};
use crate::reader::Reader;
use crate::spool::{self, Spool};

/// Runs an SQL query on a database, read-only, also while a run writes to it
///
/// For instance:
///   metasense query results/quickstart.sqlite "SELECT sensors, avg(holdout_error_optimised) FROM v_trial GROUP BY 1"
#[derive(Debug, clap::Args)]
#[command(verbatim_doc_comment)]
pub(super) struct Args {
    /// The database, or a folder of shards: their facts
    #[arg(value_name = "DB|FOLDER")]
    db: PathBuf,
    /// One SQL statement; by default, lists the views and their columns
    sql: Option<String>,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
    /// File to write instead of standard output
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    out: Option<PathBuf>,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let Args { db, sql, format, out } = args;
    Reader::with_reader(Database::at(&db).await?, async |reader| {
        let Some(sql) = &sql else {
            let views = views(reader, format).await?;
            return match &out {
                None => Ok(print_rows(&views, format)?),
                Some(path) => write(path, views.written(format)),
            };
        };
        match &out {
            None => {
                let mut spool = Spool::new(standard_output(format)?);
                let answered = answer(reader, sql, &mut spool, (format, screen())).await;
                // The query has ended: slow readers of the rows do not hold the database.
                let passed_on = spool.finish();
                answered.and(passed_on.map_err(Error::Output)).map_err(|error| match error {
                    Error::Output(source) if spool::is_of_file(&source) => {
                        Error::io("holding rows for the reader in", std::env::temp_dir())(source)
                    }
                    error => error,
                })
            }
            Some(path) => answer_in(reader, sql, path, format).await,
        }
    })
    .await?;
    Ok(Exit::Done)
}

/// Writes the answer into a file, row by row; the file replaces `path` when it is complete.
pub(super) async fn answer_in(
    reader: &mut Reader,
    sql: &str,
    path: &Path,
    format: Format,
) -> Result<(), Error> {
    let failed = Error::io("writing", path);
    let mut output = Output::create(path).map_err(&failed)?;
    let written = answer(reader, sql, &mut output, (format, None)).await;
    written.map_err(|e| if let Error::Output(source) = e { failed(source) } else { e })?;
    output.finish().map_err(failed)
}

/// Maximum number of rows of a printed table.
const MOST_ROWS: usize = 10_000;

/// Writes rows as they arrive; a printed table fits a screen of `screen` columns.
async fn answer(
    reader: &mut Reader,
    sql: &str,
    out: impl Write + Send,
    (format, screen): (Format, Option<usize>),
) -> Result<(), Error> {
    let columns = reader.columns(sql).await?;
    format.check(&columns).map_err(Error::Usage)?;
    let mut writer = RowWriter::new(out, format, &columns, screen)?;
    if format == Format::Parquet {
        writer = writer.typed(reader.types(sql).await);
    }
    let mut count = 0usize;
    reader
        .each(sql, |row| {
            count += 1;
            match format == Format::Table && count > MOST_ROWS {
                true => Ok(()),
                false => Ok::<_, Error>(writer.row(row.values())?),
            }
        })
        .await?;
    writer.end()?;
    if format == Format::Table && count > MOST_ROWS {
        say!("… and {} more rows: --format csv, json or parquet prints all", count - MOST_ROWS);
    }
    Ok(())
}

/// The views; in a printed table, long texts are wrapped.
async fn views(reader: &mut Reader, format: Format) -> Result<Table, Error> {
    let mut rows = Vec::new();
    let wide = |text: &str, most: usize| match format {
        Format::Table => lines(text, most).join("\n"),
        _ => text.to_owned(),
    };
    for (view, description) in VIEWS.iter() {
        let sql = format!("SELECT group_concat(name, ', ') FROM pragma_table_info('{view}')");
        let columns: Table = reader.query(&sql).await?;
        let columns = columns.rows[0][0].as_str().unwrap_or_default();
        rows.push(vec![(*view).into(), wide(description, 40).into(), wide(columns, 60).into()]);
    }
    Ok(Table { columns: ["view", "a row is", "columns"].map(String::from).to_vec(), rows })
}
