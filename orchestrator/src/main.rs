//! The `metasense` command.

use std::process::ExitCode;

use metasense::cli;

fn main() -> ExitCode {
    cli::exit_code(cli::execute(std::env::args_os()))
}
