//! `status`: state of trials and causes of failures, also during a run.

use std::path::{Path, PathBuf};

use metasense_schemas::reason::CANCELLED;
use metasense_schemas::spec::Sweep;
use serde_json::{Value, json};

use super::named::{Database, Named, word};
use super::point::point_in_words;
use super::{Error, Format, print_rows};
use crate::cluster::Assignment;
use crate::cluster::queue;
use crate::cluster::state::{self, ShardState};
use crate::control::is_held;
use crate::exit::Exit;
use crate::files;
use crate::look::{Table, row, short_hash};
use crate::plan::{PlannedTrial, counted};
use crate::progress::FAILED;
use crate::provenance;
use crate::reader::{Nearest, Reader, quoted};

/// Shows the state of trials and the causes of failures; or one trial, or shards
///
/// For a trial, named by DB HASH or SPEC HASH, prints its attempts and their log. If the database does not contain the
/// trial, prints the keys in which the nearest stored trial differs, and the code that computed it.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database, or the spec of the database; by default the most recently written database in results/
    #[arg(value_name = "DB|SPEC", conflicts_with = "folder")]
    source: Option<PathBuf>,
    /// A trial, by its hash or the beginning of it; after SPEC also values that replace those of the spec, as in `run`
    #[arg(value_name = "HASH|KEY=VALUE", value_parser = word)]
    words: Vec<String>,
    /// After SPEC: the database, if it is not results/NAME.sqlite
    #[arg(long, value_name = "FILE", conflicts_with = "folder")]
    db: Option<PathBuf>,
    /// Shows the shards of this folder: their state in the queue and their results so far; by default the only
    /// results/*.shards
    #[arg(long, value_name = "DIR", num_args = 0..=1, help_heading = "Shards")]
    folder: Option<Option<PathBuf>>,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let Args { source, words, db, folder, format } = args;
    if let Some(folder) = folder {
        return cluster(folder, format).await;
    }
    let source = source.map_or_else(|| newest("status"), Ok)?;
    let named = Named { source, words };
    let db = if named.is_database() {
        if db.is_some() {
            return usage!("--db: only for a SPEC; pass a database as the first argument");
        }
        if let Some(hash) = named.hash_argument()? {
            return Reader::with_reader(Database::at(&named.source).await?, async |reader| {
                let hash = reader.hash_of(hash).await?;
                print_trial(reader, &hash, format).await
            })
            .await;
        }
        named.source
    } else {
        let plan = named.plan()?;
        let db = db.unwrap_or_else(|| plan.default_database());
        if named.hash_argument()?.is_some() {
            return planned(&db, &named.find_trial(&plan, &plan.trials[0])?, format).await;
        }
        db
    };
    let (mut table, failed, made, unresolved) =
        Reader::with_reader(Database::at(&db).await?, async |reader| {
            Ok::<_, Error>((
                reader.query::<Table>(STATES).await?,
                reader.query::<Table>(FAILED).await?,
                reader.code_versions().await?,
                reader.unresolved().await?,
            ))
        })
        .await?;
    say!("{}", db.display());
    if format == Format::Table {
        table.leave_out_spread();
    }
    print_rows(&table, format)?;
    for row in failed.rows.iter().take(MOST_FAILURES) {
        let [reason, text, hash] = [0, 1, 2].map(|i| row[i].as_str().unwrap_or_default());
        let what = if text.is_empty() { reason } else { text };
        let count = counted(row[3].as_u64().unwrap_or_default() as usize, "trial");
        say!("failed: {count}: {what} (metasense status {} {})", files::quoted(&db), short_hash(hash));
    }
    let caveats = provenance::mixed(&made).into_iter().chain(provenance::unresolved_trials(&unresolved));
    caveats.for_each(|caveat| say!("{caveat}"));
    let state = table.columns.iter().position(|column| column == "state");
    if state.is_some_and(|state| table.rows.iter().any(|row| row[state] == "running")) && !is_held(&db) {
        say!("no run is active: trials in state running were interrupted, and `metasense run` resumes them");
    }
    Ok(if failed.rows.is_empty() { Exit::Done } else { Exit::Failed })
}

/// Prints a trial's state, attempts and log.
async fn print_trial(reader: &mut Reader, hash: &str, format: Format) -> Result<Exit, Error> {
    let named = quoted(hash);
    let state = format!("SELECT state, reason, solver FROM trial WHERE hash = {named}");
    let state = reader.query::<Table>(&state).await?.rows.swap_remove(0);
    let log =
        format!("SELECT attempt, at, level, text FROM v_log WHERE hash = {named} ORDER BY attempt, line");
    let [state, reason, solver] = [0, 1, 2].map(|i| state[i].as_str().unwrap_or_default().to_owned());
    say!("{}", format!("trial {hash}: {state} {reason}").trim_end());
    let sweep = format!(
        "SELECT t.spec, s.spec->'$.sweep' FROM trial t JOIN sweep_trial x ON x.trial_id = t.id JOIN sweep s ON s.id = x.sweep_id
         WHERE t.hash = {named} ORDER BY s.id DESC LIMIT 1"
    );
    for row in reader.query::<Table>(&sweep).await?.rows {
        let [spec, sweep] = [0, 1].map(|i| row[i].as_str().unwrap_or_default());
        if let (Ok(spec), Ok(sweep)) = (serde_json::from_str(spec), serde_json::from_str::<Sweep>(sweep)) {
            say!("  {}", point_in_words(&spec, &sweep.keys()));
        }
    }
    provenance::unresolved(&solver).iter().for_each(|caveat| say!("warning: {caveat}"));
    say_attempts(reader, hash).await?;
    print_rows(&reader.query(&log).await?, format)?;
    let failed = state == "failed" && reason != CANCELLED;
    Ok(if failed { Exit::Failed } else { Exit::Done })
}

/// Prints a trial of a spec, or the keys in which the nearest stored trial differs.
async fn planned(db: &Path, trial: &PlannedTrial, format: Format) -> Result<Exit, Error> {
    let spec = serde_json::to_value(&trial.spec).expect("a trial is JSON");
    Reader::with_reader(Database::at(db).await?, async |reader| {
        let Some(nearest) = reader.nearest(&spec).await? else {
            return usage!("{} contains no trials", db.display());
        };
        if nearest.hash == trial.hash {
            return print_trial(reader, &trial.hash, format).await;
        }
        let Nearest { hash, state, differs } = nearest;
        say!("trial {} is not in {}", trial.hash, db.display());
        say!("nearest stored trial: {hash} ({state}); it differs in {} keys", differs.len());
        say_attempts(reader, &hash).await?;
        let shown = |value: &Option<Value>| value.as_ref().map_or(Value::Null, |v| json!(v.to_string()));
        let rows = differs.iter().map(|(key, [there, here])| row![key, shown(here), shown(there)]);
        print_rows(&Table::new("key here nearest", rows), format)?;
        Ok(Exit::Done)
    })
    .await
}

/// Prints the attempts at a trial, and the code of this program.
async fn say_attempts(reader: &mut Reader, hash: &str) -> Result<(), Error> {
    let sql = format!("SELECT * FROM v_attempt WHERE hash = {} ORDER BY attempt", quoted(hash));
    reader
        .rows(&sql, |row| {
            let text = |column| Some(row.text(column)).filter(|text| !text.is_empty());
            let words = [
                text("reason").map(|reason| format!(" ({reason})")),
                (row.count("redone") > 0).then(|| ", discarded".to_owned()),
                Some(format!(", {}", counted(row.count("steps") as usize, "step"))),
                Some(format!("; code {}", text("code").unwrap_or("unknown"))),
                text("revision").map(|revision| format!(" ({revision})")),
                text("rustc").map(|rustc| format!(", {rustc}")),
                text("cpu").map(|cpu| format!("; {cpu}")),
                text("simd")
                    .map(|simd| format!(", {simd}, {}", counted(row.count("threads") as usize, "thread"))),
                text("host").map(|host| format!(", on {host}")),
            ];
            let words: String = words.into_iter().flatten().collect();
            say!("  attempt {}: {}{words}", row.count("attempt"), row.text("state"));
        })
        .await?;
    let revision = provenance::revision().map_or(String::new(), |r| format!(" ({r})"));
    say!("this program: code {}{revision}", provenance::code());
    Ok(())
}

/// Prints the shards of a folder.
async fn cluster(folder: Option<PathBuf>, format: Format) -> Result<Exit, Error> {
    let missing_folder = || {
        Error::Usage("pass the folder of the shards: metasense status --folder results/NAME.shards".into())
    };
    let folder = folder.or_else(|| only(Path::new("results"), "shards")).ok_or_else(missing_folder)?;
    let mut jobs = super::submit::submitted(&folder)?;
    let queued = queue::ask(&mut jobs)?.shards;
    let Some(last) = jobs.last() else {
        let path = folder.display();
        return usage!("{path} contains no shards that `cluster submit` has submitted; pass their folder");
    };
    let assignment = Assignment::in_folder(&folder, &[], last.shards)?;
    let states = state::states(&folder, &assignment, &queued).await;
    let columns = "shard state trials done failed estimated_seconds seconds outcome ran_on handed_in_ago";
    let row = |s: &ShardState| {
        let trials = |i: usize| s.trials.map(|trials| trials[i]);
        let run = s.run.as_ref();
        let tenths = |x: f64| (x * 10.0).round() / 10.0;
        row![
            s.shard.index(),
            s.state,
            trials(0),
            trials(1),
            trials(2),
            run.map(|r| tenths(r.estimated_seconds)),
            run.and_then(|r| r.seconds).map(tenths),
            run.and_then(|r| r.outcome.clone()),
            run.map(|r| r.place.clone()),
            s.age.map(f64::round)
        ]
    };
    let rows = states.iter().map(row);
    print_rows(&Table::new(columns, rows), format)?;
    let complete = states.iter().filter(|s| s.state == "complete").count();
    let (waiting, ended): (Vec<&ShardState>, Vec<&ShardState>) =
        states.iter().filter(|s| !s.is_settled()).partition(|s| queued.contains_key(&s.shard.index()));
    let (path, all, waiting) = (folder.display(), states.len(), waiting.len());
    say!("{path}: {complete} of {all} shards complete, {waiting} in the queue");
    if queue::is_held(&folder) {
        say!("`cluster submit` is running them now");
        return Ok(Exit::Done);
    }
    if !ended.is_empty() {
        say!("{} ended with unfinished trials: `metasense cluster submit` resumes them", ended.len());
    }
    let never: Vec<String> = ended.iter().flat_map(|s| s.never.iter().cloned()).collect();
    super::merge::print_never_started(&never, "metasense cluster submit");
    let failed: usize = states.iter().map(|s| s.failures.len()).sum();
    if failed > 0 {
        let trials = counted(failed, "trial");
        say!("{trials} failed: `metasense cluster submit` with --retry-failed resumes them");
    }
    Ok(if failed > 0 { Exit::Failed } else { Exit::Done })
}

/// The only entry of a folder with this extension.
fn only(folder: &Path, ending: &str) -> Option<PathBuf> {
    let entries = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path());
    let mut found = entries.filter(|path| path.extension().is_some_and(|e| e == ending));
    found.next().filter(|_| found.next().is_none())
}

/// The most recently written database in results/, for a command that names none.
pub(super) fn newest(command: &str) -> Result<PathBuf, Error> {
    let written = |path: &PathBuf| path.metadata().and_then(|m| m.modified()).ok();
    let entries = std::fs::read_dir("results").into_iter().flatten().flatten().map(|entry| entry.path());
    let newest = entries.filter(|path| path.extension().is_some_and(|e| e == "sqlite")).max_by_key(written);
    newest.ok_or_else(|| Error::Usage(format!("no database in results/; pass one: metasense {command} DB")))
}

/// Maximum number of kinds of failures to print.
const MOST_FAILURES: usize = 20;

/// Counts trials by sweep, state and reason in one pass. Steps are those recorded by attempts; sweeps are named once per group.
const STATES: &str = "WITH of_trial AS (
    SELECT (SELECT group_concat(x.sweep_id) FROM sweep_trial x WHERE x.trial_id = t.id) AS sweeps, t.state,
      CASE WHEN t.state <> 'done' THEN coalesce(t.reason, '') ELSE '' END AS reason,
      count(a.number) AS attempts, sum(CASE WHEN a.redone THEN 0 ELSE a.steps END) AS steps,
      (SELECT sum(s.seconds) FROM spent s WHERE s.trial_id = t.id AND NOT s.redone) AS seconds,
      t.holdout_error_initial, t.holdout_error_optimised, t.holdout_median_initial, t.holdout_median_optimised,
      t.holdout_above_initial, t.holdout_above_optimised
    FROM trial t LEFT JOIN attempt a ON a.trial_id = t.id GROUP BY t.id)
  SELECT (SELECT group_concat(name, ', ') FROM
      (SELECT name FROM sweep WHERE instr(',' || sweeps || ',', ',' || id || ',') GROUP BY name ORDER BY min(created_at), name))
      AS sweep, state, reason, count(*) AS trials, coalesce(sum(steps), 0) AS steps, sum(attempts) AS attempts,
    round(sum(seconds), 1) AS seconds, avg(holdout_error_initial) AS holdout_error_initial,
    avg(holdout_error_optimised) AS holdout_error_optimised, avg(holdout_median_initial) AS holdout_median_initial,
    avg(holdout_median_optimised) AS holdout_median_optimised, sum(holdout_above_initial) AS holdout_above_initial,
    sum(holdout_above_optimised) AS holdout_above_optimised
  FROM of_trial GROUP BY sweeps, state, reason ORDER BY 1, 2, 3";
