//! `man`: writes the help as manual pages.

use std::path::PathBuf;

use super::{Error, command, make_folder};
use crate::exit::Exit;

/// Writes a manual page per command into a folder
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The folder, such as ~/.local/share/man/man1; created if missing
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    make_folder(&args.folder)?;
    clap_mangen::generate_to(command(), &args.folder).map_err(Error::io("writing into", &args.folder))?;
    print_line!("{}", args.folder.display())?;
    Ok(Exit::Done)
}
