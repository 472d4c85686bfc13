//! The `metasense` command.

use std::process::ExitCode;

use metasense::cli;
use metasense_worker::limits;

fn main() -> ExitCode {
    if let Err(short) = limits::check_start() {
        return cli::exit_code(Err(short.into()));
    }
    cli::exit_code(cli::execute(std::env::args_os()))
}
