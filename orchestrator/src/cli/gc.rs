//! `gc`: lists or removes files of killed processes and superfluous copies of shards.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::{Error, Format, print_rows};
use crate::cluster::home::attempts;
use crate::cluster::merge::contains;
use crate::exit::Exit;
use crate::leftovers::{abandoned, is_abandoned, remove};
use crate::look::{Table, row};
use crate::plan::counted;

/// Lists files that can be removed: of killed processes, and copies of shards
///
/// A copy of a shard is listed if the last copy of that shard contains all its rows. Files from another machine are listed
/// when they are one day old. Folders inside the given folders are searched as well.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folders
    #[arg(value_name = "DIR", default_value = "results")]
    folders: Vec<PathBuf>,
    /// Removes the files; by default they are only listed
    #[arg(long)]
    yes: bool,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let mut found = Vec::new();
    for folder in &args.folders {
        let entries = std::fs::read_dir(folder).map_err(Error::unreadable(folder))?;
        let inner = entries.flatten().map(|entry| entry.path()).filter(|path| path.is_dir());
        for folder in std::iter::once(folder.clone()).chain(inner) {
            found.extend(left_behind(&folder));
            superseded(&folder, &mut found).await;
        }
    }
    found.sort();
    found.dedup(); // folders may contain one another
    let size = |path: &Path| path.metadata().map_or(0, |m| m.len());
    let rows = found.iter().map(|(path, why)| row![path.display().to_string(), size(path), why]);
    print_rows(&Table::new("file bytes why", rows), Format::Table)?;
    if args.yes {
        for (path, _) in &found {
            match remove(path) {
                // another process has removed it meanwhile
                Err(e) if e.kind() == ErrorKind::NotFound => {}
                removed => removed.map_err(Error::io("removing", path))?,
            }
        }
    }
    let done = if args.yes { "removed" } else { "would be removed; pass --yes to remove them" };
    say!("{} {done}", counted(found.len(), "file"));
    Ok(Exit::Done)
}

/// Temporary files and folders of processes that have ended.
fn left_behind(folder: &Path) -> impl Iterator<Item = (PathBuf, String)> {
    let is_one = |name: &str| {
        let beside = name.starts_with('.') && (name.ends_with(".tmp") || name.contains(".merge-"));
        beside || name.starts_with("shard-") && name.ends_with(".tmp")
    };
    abandoned(folder, is_one).map(|path| (path, "its process has ended".to_owned()))
}

/// Copies of shards whose rows are all in the last copy of the shard.
async fn superseded(folder: &Path, found: &mut Vec<(PathBuf, String)>) {
    for mut files in attempts(folder).into_values() {
        let Some(last) = files.pop() else { continue };
        for file in files {
            if !is_abandoned(&file) {
                continue;
            }
            match contains(&last, &file).await {
                Ok(true) => found.push((file, format!("all its rows are in {}", last.display()))),
                Ok(false) => {}
                Err(_) if !file.exists() => {}
                Err(error) => say!("{} cannot be compared and is kept: {error}", file.display()),
            }
        }
    }
}
