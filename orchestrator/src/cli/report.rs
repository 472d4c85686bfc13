//! `report`: one HTML file to look at.

use std::path::{Path, PathBuf};

use super::Error;
use crate::exit::Exit;
use crate::report::{csv, figures, html, load, standalone};
use crate::store::Reader;

/// Writes what a database's trials teach as one HTML file: question and answer first, then figures with their data
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database
    db: PathBuf,
    /// The file to write; by default beside the database
    #[arg(long)]
    out: Option<PathBuf>,
    /// The trial whose forces, bodies and waves are shown (the beginning of its hash); by default a typical one
    #[arg(long)]
    trial: Option<String>,
    /// Also write every figure (SVG) and its data (CSV) into this folder
    #[arg(long)]
    figures: Option<PathBuf>,
    /// Threads for simulating the shown trial again
    #[arg(long, default_value_t = 1)]
    threads: usize,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let mut reader = Reader::open(&args.db).await?;
    let story = load::story(&mut reader, args.trial.as_deref()).await?;
    let (drawn, missing) = figures(&story, args.threads);
    let out = args.out.unwrap_or_else(|| args.db.with_extension("html"));
    write(&out, html(&story, &drawn, missing.as_deref()))?;
    println!("{}", out.display());
    if let Some(folder) = &args.figures {
        std::fs::create_dir_all(folder).map_err(|source| Error::Io {
            doing: "making the folder",
            path: folder.clone(),
            source,
        })?;
        for figure in &drawn {
            for (i, svg) in figure.plots.iter().filter_map(|p| standalone(p)).enumerate() {
                let number = if figure.plots.len() > 1 { format!("-{}", i + 1) } else { String::new() };
                write(&folder.join(format!("{}{number}.svg", figure.name)), svg)?;
            }
            write(&folder.join(format!("{}.csv", figure.name)), csv(&figure.data))?;
        }
        println!("{}", folder.display());
    }
    Ok(Exit::Done)
}

fn write(path: &Path, text: String) -> Result<(), Error> {
    std::fs::write(path, text).map_err(|source| Error::Io { doing: "writing", path: path.to_owned(), source })
}
