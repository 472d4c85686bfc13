//! `why`: what a trial has that no trial of the database has, and by what code the nearest one was made.

use std::path::PathBuf;

use serde_json::{Value, json};

use super::{Error, Format, print_rows, read_plan, status, trial};
use crate::exit::Exit;
use crate::look::Table;
use crate::provenance;
use crate::store::Reader;

/// Says why a trial counts as another: the keys by which it differs from the nearest one in the database, and by what
/// code that was made
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The spec file (TOML)
    spec: PathBuf,
    /// The trial, by its hash or the beginning of it; `metasense expand SPEC` lists them
    #[arg(long)]
    hash: String,
    /// The database; by default results/NAME.sqlite
    #[arg(long, value_name = "FILE")]
    db: Option<PathBuf>,
    /// The form of the rows, one a key
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let plan = read_plan(&args.spec)?;
    let trial = trial::find(&plan, &args.hash, &args.spec)?;
    let db = args.db.unwrap_or_else(|| plan.default_database());
    let spec = serde_json::to_value(&trial.spec).expect("a trial is JSON");
    let (nearest, attempts) = Reader::asked(&db, async |reader| {
        let nearest = reader.nearest(&spec).await?;
        let attempts = match &nearest {
            Some(nearest) => status::attempts(reader, &nearest.hash).await?,
            None => Vec::new(),
        };
        Ok::<_, Error>((nearest, attempts))
    })
    .await?;
    let Some(nearest) = nearest else {
        return Err(Error::Usage(format!("{} holds no trial at all", db.display())));
    };
    match nearest.hash == trial.hash {
        true => say!("trial {} is in {}: {}", trial.hash, db.display(), nearest.state),
        false => {
            say!("trial {} is not in {}", trial.hash, db.display());
            say!(
                "the nearest there: {}, {}; {} keys differ",
                nearest.hash,
                nearest.state,
                nearest.differs.len()
            );
        }
    }
    attempts.iter().for_each(|line| say!("  {line}"));
    say!(
        "this program: code {}{}",
        provenance::code(),
        provenance::revision().map_or(String::new(), |r| format!(" ({r})"))
    );
    let shown = |value: &Option<Value>| value.as_ref().map_or(Value::Null, |value| json!(value.to_string()));
    let rows = nearest.differs.iter().map(|(key, [there, here])| vec![json!(key), shown(here), shown(there)]);
    print_rows(&Table::new("key here nearest", rows), args.format)?;
    Ok(Exit::Done)
}
