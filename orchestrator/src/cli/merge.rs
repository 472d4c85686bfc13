//! `merge`: merges databases of shards or of whole sweeps.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::{Error, Format, print_rows};
use crate::cluster::home::attempts;
use crate::cluster::merge::{Extent, FindingKind, MergeFinding, Summary, merge};
use crate::cluster::state::{ShardState, never_begun, states};
use crate::cluster::{Assignment, Shard, ranges};
use crate::exit::Exit;
use crate::files::quoted;
use crate::look::{Table, row, short_hash};
use crate::plan::counted;

/// Merges databases into one
///
/// The rows depend neither on the order of the files nor on the number of merges. The most advanced copy of each trial is
/// kept; undamaged copies are preferred. Damage, disagreements and omissions are listed. Two copies of a trial are compared
/// bit by bit if they are of the same run or the same instruction set.
/// Inputs are not changed. Inputs that FILE already contains are not read again. `run SPEC --db FILE` runs missing trials.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Databases, also of other versions or of runs in progress; for a folder, each *.sqlite in it
    #[arg(required = true, value_name = "DB")]
    files: Vec<PathBuf>,
    /// The merged database; its earlier contents are kept
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    out: PathBuf,
    /// Merges only facts (settings, results, attempts: some kB per trial); steps, curves and arrays stay in the files of
    /// the shards
    #[arg(long)]
    facts: bool,
}

impl Args {
    /// Arguments that merge the databases of a folder.
    pub fn folder(folder: &Path, out: &Path) -> Self {
        Self { files: vec![folder.to_owned()], out: out.to_owned(), facts: false }
    }
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let extent = if args.facts { Extent::Facts } else { Extent::Whole };
    let summary = merge(extent, &args.files, &args.out).await?;
    if !summary.findings.is_empty() {
        let row = |f: &MergeFinding| {
            row![f.kind.name(), f.hash, f.what, f.kept.display().to_string(), f.other.display().to_string()]
        };
        let table = Table::new("finding trial what kept other", summary.findings.iter().map(row));
        print_rows(&table, Format::Table)?;
    }
    for (file, why) in &summary.refused {
        say!("refused: {}: {why}", file.display());
    }
    for (sweep, count, missing) in &summary.missing {
        say!("{sweep}: {} of its {count} shards have no database: {}", missing.len(), ranges(missing));
    }
    let remedy = match args.facts {
        false => format!("metasense run SPEC --db {}", quoted(&args.out)),
        true => "metasense cluster submit".to_owned(),
    };
    print_never_started(&never_begun(&args.files, &args.out).await?, &remedy);
    let Summary { read, known, trials, covered, not_compared, .. } = summary;
    let before = if known > 0 { format!(", {known} of them read before") } else { String::new() };
    say!("{} from {}{before}", counted(trials, "trial"), counted(read, "database"));
    if covered + not_compared > 0 {
        say!(
            "repeated copies: {covered} with nothing new, {not_compared} not compared, because their instruction sets \
             differ"
        );
    }
    say!("database: {}", args.out.display());
    let disagrees =
        summary.findings.iter().any(|f| [FindingKind::Damaged, FindingKind::Bits].contains(&f.kind));
    Ok(if disagrees || !summary.refused.is_empty() { Exit::Failed } else { Exit::Done })
}

/// Merges the shards of a folder if all have ended. The last shard finds this when it hands in.
pub(super) async fn merge_if_all_ended(folder: &Path, shard: Shard, out: &Path) -> Result<(), Error> {
    if attempts(folder).len() < shard.count() as usize {
        return Ok(());
    }
    let assignment = Assignment::in_folder(folder, &[], shard.count())?;
    if !states(folder, &assignment, &HashMap::new()).await.iter().all(ShardState::is_settled) {
        return Ok(());
    }
    if let Err(error) = execute(Args::folder(folder, out)).await {
        // the shard itself is complete; another shard may be merging the same files
        error.say();
        say!("to merge by hand: metasense cluster merge {} --out {}", quoted(folder), quoted(out));
    }
    Ok(())
}

/// Prints the trials that never started and the command that runs them.
pub(super) fn print_never_started(never: &[String], remedy: &str) {
    const MOST: usize = 8;
    if never.is_empty() {
        return;
    }
    let mut list = never.iter().take(MOST).map(|hash| short_hash(hash)).collect::<Vec<_>>().join(", ");
    if never.len() > MOST {
        list += &format!(" and {} more", never.len() - MOST);
    }
    say!("never started: {} ({list}); `{remedy}` runs them", counted(never.len(), "trial"));
}
