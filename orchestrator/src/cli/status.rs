//! `status`: what is done, running, failed and why; also while a run goes on.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde_json::json;

use super::{Error, Format, print_rows};
use crate::cluster::queue;
use crate::cluster::state::{self, State};
use crate::exit::Exit;
use crate::store::{Reader, Table};

/// Shows what is done, running, pending and failed, and why; also while a run goes on
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database; by default the one under results/ that was written last
    db: Option<PathBuf>,
    /// Shows shards: by the queue, and by what they have handed in; DB is their folder, by default the only
    /// results/*.shards
    #[arg(long)]
    cluster: bool,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    if args.cluster {
        return cluster(args.db, args.format).await;
    }
    let db = match args.db {
        Some(db) => db,
        None => newest(Path::new("results")).ok_or_else(|| {
            Error::Usage("there is no database under results/; name one: metasense status DB".into())
        })?,
    };
    let (table, failed) = Reader::asked(&db, async |reader| {
        let failed = "SELECT count(*) FROM trial WHERE state = 'failed' AND reason <> 'pruned'";
        Ok::<_, Error>((reader.query(STATES).await?, reader.query(failed).await?))
    })
    .await?;
    say!("{}", db.display());
    print_rows(&table, args.format)?;
    Ok(if failed.rows[0][0] == 0 { Exit::Done } else { Exit::Failed })
}

/// The shards of a folder.
async fn cluster(folder: Option<PathBuf>, format: Format) -> Result<Exit, Error> {
    let none = || {
        Error::Usage("name the folder of the shards: metasense status --cluster results/NAME.shards".into())
    };
    let folder = folder.or_else(|| only(Path::new("results"), "shards")).ok_or_else(none)?;
    let jobs = super::submit::submitted(&folder)?;
    let Some(last) = jobs.last() else {
        let path = folder.display();
        return Err(Error::Usage(format!(
            "{path} holds no shards that `submit` has submitted; name their folder"
        )));
    };
    let queued = queue::ask(&jobs)?.shards;
    let states = state::states(&folder, last.shards, &queued).await;
    let columns = [
        "shard",
        "state",
        "trials",
        "done",
        "failed",
        "estimated_seconds",
        "seconds",
        "outcome",
        "ran_on",
        "handed_in_ago",
    ];
    let row = |s: &State| {
        let trials = |i: usize| json!(s.trials.map(|trials| trials[i]));
        let run = s.run.as_ref();
        let tenths = |x: f64| (x * 10.0).round() / 10.0;
        vec![
            json!(s.shard.index()),
            json!(s.state),
            trials(0),
            trials(1),
            trials(2),
            json!(run.map(|r| tenths(r.0))),
            json!(run.and_then(|r| r.1).map(tenths)),
            json!(run.and_then(|r| r.3.clone())),
            json!(run.map(|r| r.2.clone())),
            json!(s.age.map(f64::round)),
        ]
    };
    let rows = states.iter().map(row).collect();
    print_rows(&Table { columns: columns.map(str::to_owned).to_vec(), rows }, format)?;
    let complete = states.iter().filter(|s| s.state == "complete").count();
    let waiting =
        states.iter().filter(|s| queued.contains_key(&s.shard.index()) && s.state != "complete").count();
    let rest = states.len() - complete - waiting;
    say!("{}: {complete} of {} shards complete, {waiting} in the queue", folder.display(), states.len());
    if rest > 0 {
        say!("{rest} have ended before their trials had: `metasense submit` goes on with them");
    }
    let failed = states.iter().any(|s| s.trials.is_some_and(|trials| trials[2] > 0));
    Ok(if failed { Exit::Failed } else { Exit::Done })
}

/// The only entry of a folder with this ending.
fn only(folder: &Path, ending: &str) -> Option<PathBuf> {
    let entries = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    let mut found = entries.filter(|path| path.extension().is_some_and(|e| e == ending));
    found.next().filter(|_| found.next().is_none())
}

/// The database written last.
pub(super) fn newest(folder: &Path) -> Option<PathBuf> {
    let written =
        |path: &PathBuf| path.metadata().and_then(|m| m.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    let entries = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    entries.filter(|path| path.extension().is_some_and(|e| e == "sqlite")).max_by_key(written)
}

/// Trials by sweep, state and reason.
const STATES: &str = "SELECT (SELECT group_concat(name, ', ') FROM (SELECT name FROM sweep_trial JOIN sweep ON sweep.id = sweep_id
                 JOIN trial ON trial.id = trial_id WHERE hash = v.hash GROUP BY name ORDER BY min(sweep.created_at), name))
               AS sweep, state, CASE WHEN state <> 'done' THEN coalesce(reason, '') ELSE '' END AS reason,
               count(*) AS trials, sum(steps) AS steps, sum(attempts) AS attempts,
               round(sum(seconds), 1) AS seconds, avg(holdout_error_initial) AS holdout_error_initial,
               avg(holdout_error_optimised) AS holdout_error_optimised
             FROM v_trial v GROUP BY 1, 2, 3 ORDER BY 1, 2, 3";
