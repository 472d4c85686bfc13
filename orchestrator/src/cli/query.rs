//! `query`: SQL to a database, read-only.

use std::path::PathBuf;

use metasense_schemas::database::VIEWS;

use super::{Error, Format, print_rows, write_rows};
use crate::exit::Exit;
use crate::store::{Reader, Table};

/// Asks a database in SQL; it cannot be changed this way, and may be asked while a run writes to it
///
/// For instance:
///   metasense query results/quickstart.sqlite "SELECT sensors, avg(holdout_error_optimised) FROM v_trial GROUP BY 1"
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
    let table = Reader::asked(&args.db, async |reader| match &args.sql {
        Some(sql) => reader.query(sql).await.map_err(Error::from),
        None => views(reader, args.format).await,
    })
    .await?;
    match args.out {
        None => print_rows(&table, args.format)?,
        Some(path) => {
            let written = std::fs::File::create(&path).and_then(|file| write_rows(&table, args.format, file));
            written.map_err(|source| Error::Io { doing: "writing", path, source })?;
        }
    }
    Ok(Exit::Done)
}

/// The views; as a table to read, with their texts in lines.
async fn views(reader: &mut Reader, format: Format) -> Result<Table, Error> {
    let mut rows = Vec::new();
    let wide = |text: &str, most: usize| match format {
        Format::Table => in_lines(text, most),
        _ => text.to_owned(),
    };
    for (view, description) in VIEWS {
        let columns = reader
            .query(&format!("SELECT group_concat(name, ', ') FROM pragma_table_info('{view}')"))
            .await?;
        let columns = columns.rows[0][0].as_str().unwrap_or_default();
        rows.push(vec![(*view).into(), wide(description, 40).into(), wide(columns, 60).into()]);
    }
    Ok(Table { columns: ["view", "a row is", "columns"].map(String::from).to_vec(), rows })
}

/// A text in lines of at most `most` characters, where its words allow.
fn in_lines(text: &str, most: usize) -> String {
    let mut lines = String::new();
    let mut length = 0;
    for word in text.split(' ') {
        let more = word.chars().count() + 1;
        if length > 0 {
            let full = length + more > most;
            lines.push(if full { '\n' } else { ' ' });
            length = if full { 0 } else { length };
        }
        lines.push_str(word);
        length += more;
    }
    lines
}
