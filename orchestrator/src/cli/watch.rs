//! `watch`: a run as it goes on, seen from its database, from any terminal.

use std::collections::HashMap;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use metasense_worker::process::IDLE;
use serde_json::{Value, json};

use super::status::newest;
use super::{Error, Format, duration, print_rows};
use crate::exit::Exit;
use crate::fleet::{Seen, workers_of, writer_of};
use crate::look::Table;
use crate::store::Reader;

/// Watches a run from another terminal: its workers with their trials, steps and errors, rate and time to go
///
/// Trials come from the database, workers from /proc, the run itself is not asked. Ends with the run. `silent_s` is
/// the time since the last record of a trial, `cpu_%` its part of a core since the look before.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database; by default the one under results/ that was written last
    db: Option<PathBuf>,
    /// Time between two looks (s)
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    every: f64,
    /// Look once
    #[arg(long)]
    once: bool,
}

/// The trials that run, with their last step, and the seconds since it was recorded.
const RUNNING: &str = "
SELECT t.hash, t.panels AS K, t.sensors AS M, t.placement, t.seed, t.units, 1 + p.step AS step,
  json_extract(t.spec, '$.optimise.iterations') AS of,
  (SELECT round(e.error_test, 2) FROM step e WHERE e.trial_id = t.id AND e.error_test IS NOT NULL
   ORDER BY e.step DESC LIMIT 1) AS test_error,
  (SELECT round(min(b.error_test), 2) FROM step b WHERE b.trial_id = t.id) AS test_error_best,
  CAST(round((julianday('now') - julianday(max(a.started_at, coalesce(p.recorded_at, '')))) * 86400) AS INTEGER) AS silent_s,
  a.number AS attempt
FROM trial t JOIN attempt a ON a.trial_id = t.id AND a.state = 'running'
LEFT JOIN step p ON p.trial_id = t.id AND p.step = (SELECT max(step) FROM step m WHERE m.trial_id = t.id)
WHERE t.state = 'running' ORDER BY 2, 3, 4, 5, 6";

/// All trials by state; the estimated seconds of what is left of those that are open; steps, attempts; and how long
/// attempts have taken against what was estimated for what they did; mean errors of what is done.
const WHOLE: &str = "
SELECT count(*), sum(state = 'done'), sum(state = 'failed' AND reason <> 'pruned'), sum(state = 'running'),
  sum(CASE WHEN state IN ('pending', 'running') THEN cost ELSE 0 END)
    - (SELECT coalesce(sum(t.cost * c.step / json_extract(t.spec, '$.optimise.iterations')), 0)
       FROM checkpoint c JOIN trial t ON t.id = c.trial_id WHERE t.state IN ('pending', 'running')),
  (SELECT sum(steps) FROM attempt), (SELECT count(*) FROM attempt),
  (SELECT sum((julianday(coalesce(a.ended_at, 'now')) - julianday(a.started_at)) * 86400)
     / nullif(sum(CASE a.state WHEN 'done' THEN t.cost
        ELSE t.cost * a.steps / json_extract(t.spec, '$.optimise.iterations') END), 0)
   FROM attempt a JOIN trial t ON t.id = a.trial_id WHERE a.steps > 0 OR a.state = 'done'),
  avg(holdout_error_initial), avg(holdout_error_optimised), sum(state = 'failed' AND reason = 'pruned')
FROM trial";

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let db = args.db.or_else(|| newest(Path::new("results")));
    let db = db.ok_or_else(|| {
        Error::Usage("there is no database under results/; name one: metasense watch DB".into())
    })?;
    if !(0.1..=3600.0).contains(&args.every) {
        return Err(Error::Usage(format!("--every {} is not between 0.1 and 3600 s", args.every)));
    }
    let live = std::io::stdout().is_terminal() && !args.once;
    let mut first: Option<(Instant, f64)> = None;
    let mut before: HashMap<u32, (Instant, u64)> = HashMap::new();
    if let Some(run) = writer_of(&db) {
        // The first look at what workers compute needs one before it.
        look(run, &mut before);
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    loop {
        let (whole, running) = Reader::asked(&db, async |reader| {
            Ok::<_, Error>((reader.query(WHOLE).await?, reader.query(RUNNING).await?))
        })
        .await?;
        let run = writer_of(&db);
        let workers = run.map(|run| look(run, &mut before)).unwrap_or_default();
        let table = by_worker(&running, &workers);
        if live {
            // Home, and clear to the end of the screen.
            write!(std::io::stdout(), "\x1b[H\x1b[2J")?;
        }
        print_line!("{}: {}", db.display(), summary(&whole, &mut first))?;
        if !table.rows.is_empty() {
            print_rows(&table, Format::Table)?;
        }
        std::io::stdout().flush()?;
        if run.is_none() && !args.once {
            print_line!("no run is at work on it")?;
        }
        if args.once || run.is_none() {
            return Ok(Exit::Done);
        }
        tokio::time::sleep(Duration::from_secs_f64(args.every)).await;
    }
}

/// The workers of a run, with the part of a core (%) that each has used since the look before.
fn look(run: u32, before: &mut HashMap<u32, (Instant, u64)>) -> Vec<(Seen, Option<f64>)> {
    let now = Instant::now();
    let seen = workers_of(run).into_iter().map(|worker| {
        let earlier = before.insert(worker.pid, (now, worker.ticks));
        let share = earlier.map(|(then, ticks)| {
            worker.ticks.saturating_sub(ticks) as f64 / now.duration_since(then).as_secs_f64().max(0.01)
        });
        (worker, share)
    });
    seen.collect()
}

/// A row a worker, with its trial if it has one; then the trials whose worker is not seen from here.
fn by_worker(running: &Table, workers: &[(Seen, Option<f64>)]) -> Table {
    let hash = |row: &[Value]| row[0].as_str().unwrap_or_default().to_owned();
    let mut columns: Vec<String> = ["worker", "pid", "state", "cpu_%"].map(String::from).into();
    columns.extend(running.columns[1..].iter().cloned());
    columns.push("trial".into());
    let mut left: Vec<&Vec<Value>> = running.rows.iter().collect();
    let line = |worker: [Value; 4], trial: Option<&Vec<Value>>| {
        let mut row: Vec<Value> = worker.into();
        match trial {
            Some(trial) => {
                row.extend(trial[1..].iter().cloned());
                row.push(hash(trial).chars().take(8).collect::<String>().into());
            }
            None => row.resize(columns.len(), Value::Null),
        }
        row
    };
    let mut rows = Vec::new();
    for (worker, share) in workers {
        let trial = left.iter().position(|row| hash(row).starts_with(&worker.name)).map(|at| left.remove(at));
        let state = match (worker.state, trial) {
            ('T', _) => "stopped",
            ('Z', _) => "ended",
            (_, Some(_)) => "busy",
            (_, None) if worker.name == IDLE => "idle",
            (_, None) => "between trials",
        };
        let share = share.map_or(Value::Null, |share| json!(share.round() as u64));
        rows.push(line([json!(worker.worker), json!(worker.pid), json!(state), share], trial));
    }
    rows.extend(
        left.into_iter().map(|trial| line([Value::Null, Value::Null, Value::Null, Value::Null], Some(trial))),
    );
    Table { rows, columns: columns.clone() }
}

/// `first`: when the watch began, and the steps there were then.
fn summary(whole: &Table, first: &mut Option<(Instant, f64)>) -> String {
    let row = &whole.rows[0];
    let number = |i: usize| row[i].as_f64().unwrap_or(0.0);
    let (total, done, failed, running) = (number(0), number(1), number(2), number(3));
    let mut text = format!(
        "{done} of {total} trials done, {failed} failed, {running} running, {} waiting; {} steps in {} attempts",
        total - done - failed - running - number(10),
        number(5),
        number(6),
    );
    if number(10) > 0.0 {
        text += &format!("; {} given up as hopeless", number(10));
    }
    let (began, steps) = *first.get_or_insert((Instant::now(), number(5)));
    if number(5) > steps {
        text += &format!(", {:.1} a minute", 60.0 * (number(5) - steps) / began.elapsed().as_secs_f64());
    }
    let (left, correction) = (number(4), number(7));
    if correction > 0.0 && running > 0.0 {
        text += &format!("; some {} to go", duration(left * correction / running));
    }
    if done > 0.0 {
        text += &format!("; mean holdout error so far {:.2} -> {:.2} %", number(8), number(9));
    }
    text
}
