//! `init`: writes a commented spec to start from.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::PathBuf;

use clap::ValueEnum;

use super::Error;
use crate::exit::Exit;

/// Specs in the program that need no other files.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Template {
    /// One sensor or two, a network or a linear decoder, and virtual casts: two minutes on two cores
    Quickstart,
    /// A search for the cheapest design that meets a requirement ([goal])
    DesignTwoCore,
    /// A comparison of several lattice families
    Families,
    /// A body that is compressed before each sample
    Pressed,
    /// A body of 50 mm units, with a chip on each sensor's unit
    RealScale,
}

impl Template {
    fn text(self) -> &'static str {
        match self {
            Self::Quickstart => include_str!("../../../schemas/sweeps/quickstart.toml"),
            Self::DesignTwoCore => include_str!("../../../schemas/sweeps/design-two-core.toml"),
            Self::Families => include_str!("../../../schemas/sweeps/families.toml"),
            Self::Pressed => include_str!("../../../schemas/sweeps/pressed.toml"),
            Self::RealScale => include_str!("../../../schemas/sweeps/real-scale.toml"),
        }
    }
}

/// Writes a commented spec to start from
///
/// The sweep takes the name of the file. An existing file is not overwritten. Continue with `metasense expand FILE`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The template
    #[arg(value_enum, default_value = "quickstart")]
    template: Template,
    /// File to write; by default TEMPLATE.toml in the current folder
    #[arg(value_name = "FILE.toml")]
    file: Option<PathBuf>,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let template = args.template.to_possible_value().expect("none is hidden");
    let file = args.file.unwrap_or_else(|| format!("{}.toml", template.get_name()).into());
    let name = file.file_stem().unwrap_or_default().to_string_lossy();
    if name.is_empty() || !name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_') {
        let file = file.display();
        return usage!("{file}: the file's name becomes the name of the sweep: use letters, digits, - and _");
    }
    let [old, new] = [template.get_name(), &*name].map(|name| format!("name = \"{name}\""));
    let text = args.template.text().replacen(&old, &new, 1);
    let made = OpenOptions::new().write(true).create_new(true).open(&file);
    let mut made = made.map_err(|e| match e.kind() {
        ErrorKind::AlreadyExists => {
            Error::Usage(format!("{}: exists already; remove it, or pass another FILE.toml", file.display()))
        }
        _ => Error::io("writing", &file)(e),
    })?;
    made.write_all(text.as_bytes()).map_err(Error::io("writing", &file))?;
    print_line!("{}", file.display())?;
    Ok(Exit::Done)
}
