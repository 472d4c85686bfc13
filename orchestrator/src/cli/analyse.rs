//! `analyse`: what a database's finished trials teach, as tables.

use std::path::PathBuf;

use serde_json::{Map, Value};

use super::{Error, Format, print_rows};
use crate::analysis::{Question, Terms};
use crate::exit::Exit;
use crate::report::load::finished_trials;
use crate::store::{Reader, Table};

/// Answers what a sweep was run to learn: is the optimised body better, how many sensors are enough, what does
/// complexity buy, what did the error cost in time
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database
    db: PathBuf,
    /// Answer this question alone; may be given several times
    #[arg(long, value_enum)]
    question: Vec<Question>,
    #[command(flatten)]
    terms: Terms,
    /// The form of the tables; JSON of several is an object of lists by question, CSV and Parquet hold one
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let all = args.question.is_empty();
    let questions = if all { &Question::ALL[..] } else { &args.question };
    if matches!(args.format, Format::Csv | Format::Parquet) && questions.len() > 1 {
        return Err(Error::Usage("CSV and Parquet hold one table: choose it with --question".into()));
    }
    let trials = Reader::asked(&args.db, finished_trials).await?;
    let mut objects = Map::new();
    for &question in questions {
        let table = question.answer(&trials, args.terms);
        match args.format {
            Format::Json if questions.len() > 1 => {
                let name = clap::ValueEnum::to_possible_value(&question).expect("none is hidden");
                objects.insert(name.get_name().to_owned(), list(table));
            }
            Format::Table if all && table.rows.is_empty() => {}
            Format::Table => {
                print_line!("{}", question.title())?;
                match table.sole_verdict() {
                    Some(verdict) => print_line!("{verdict}")?,
                    None => {
                        let shown = table.without_empty_columns();
                        print_rows(&shown, args.format)?;
                        let empty = table.columns.iter().filter(|c| !shown.columns.contains(c));
                        let empty: Vec<&str> = empty.map(String::as_str).collect();
                        if !empty.is_empty() && !table.rows.is_empty() {
                            print_line!("left out, as nothing stands there yet: {}", empty.join(", "))?;
                        }
                    }
                }
                print_line!()?;
            }
            _ => print_rows(&table, args.format)?,
        }
    }
    if !objects.is_empty() {
        print_line!("{:#}", Value::Object(objects))?;
    }
    if trials.is_empty() {
        say!("no trial of {} is done yet", args.db.display());
    }
    Ok(Exit::Done)
}

fn list(table: Table) -> Value {
    let object = |row: Vec<Value>| Value::Object(table.columns.iter().cloned().zip(row).collect());
    Value::Array(table.rows.into_iter().map(object).collect())
}
