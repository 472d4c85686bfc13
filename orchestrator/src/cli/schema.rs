//! `schema`: the JSON schema of a spec file.

use metasense_source::spec_schema;

use super::Error;
use crate::exit::Exit;

/// Prints the JSON schema of a spec, for editors that complete and check TOML
#[derive(Debug, clap::Args)]
pub(super) struct Args {}

pub(super) async fn execute(_: Args) -> Result<Exit, Error> {
    let text = serde_json::to_string_pretty(&spec_schema()).expect("a schema is JSON");
    print_line!("{text}")?;
    Ok(Exit::Done)
}
