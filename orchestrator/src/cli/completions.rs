//! `completions`: prints completion scripts of shells.

use std::io::{Write, stdout};

use clap_complete::{Shell, generate};

use super::{Error, command};
use crate::exit::Exit;

/// Prints the completion script of a shell for commands and options
///
/// For instance `metasense setup completions bash > ~/.local/share/bash-completion/completions/metasense`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The shell
    shell: Shell,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let mut script = Vec::new();
    generate(args.shell, &mut command(), "metasense", &mut script);
    stdout().write_all(&script)?;
    Ok(Exit::Done)
}
