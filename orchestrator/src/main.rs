//! The `metasense` command: parse, dispatch, exit code.

use std::process::ExitCode;

use clap::Parser;
use metasense::cli::{self, Cli};
use metasense::exit::Exit;

fn main() -> ExitCode {
    match cli::dispatch(Cli::parse()) {
        Ok(exit) => exit.into(),
        // Whoever reads our output has had enough of it.
        Err(e) if e.is_broken_pipe() => Exit::Done.into(),
        Err(e) => {
            e.say();
            e.exit().into()
        }
    }
}
