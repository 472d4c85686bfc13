//! Progress of a run, without a request to the run: trials and steps from its database, its process from its socket, its
//! workers from /proc.

use std::collections::HashMap;
use std::path::Path;
use std::time::Instant;

use metasense_worker::process::IDLE;
use serde_json::{Value, json};

use crate::control::run_of;
use crate::look::{Table, duration, short_hash};
use crate::processes::{WorkerProcess, workers_of};
use crate::reader::Reader;
use crate::store::StoreError;

/// Running trials with their last step and the seconds since it was recorded.
const RUNNING: &str = "
SELECT t.hash, t.panels AS K, t.sensors AS M, t.placement, t.seed, t.units, 1 + p.step AS step,
  json_extract(t.spec, '$.optimise.iterations') AS steps,
  (SELECT round(e.error_test, 2) FROM step e WHERE e.trial_id = t.id AND e.error_test IS NOT NULL
   ORDER BY e.step DESC LIMIT 1) AS test_error,
  (SELECT round(min(b.error_test), 2) FROM step b WHERE b.trial_id = t.id) AS test_error_best,
  CAST(round((julianday('now') - julianday(max(a.started_at, coalesce(p.recorded_at, '')))) * 86400) AS INTEGER) AS seconds_since_step,
  a.number AS attempt
FROM trial t JOIN attempt a ON a.trial_id = t.id AND a.state = 'running'
LEFT JOIN step p ON p.trial_id = t.id AND p.step = (SELECT max(step) FROM step m WHERE m.trial_id = t.id)
WHERE t.state = 'running' ORDER BY 2, 3, 4, 5, 6";

/// One row: trials by state; estimated seconds of open trials less what checkpoints cover; steps; attempts; seconds of attempts
/// over their estimate; mean held-out errors of finished trials; estimated seconds of all trials; cancelled trials; mean median
/// errors.
const WHOLE: &str = "
SELECT count(*), sum(state = 'done'), sum(state = 'failed' AND reason <> 'cancelled'), sum(state = 'running'),
  sum(CASE WHEN state IN ('pending', 'running') THEN cost ELSE 0 END)
    - (SELECT coalesce(sum(t.cost * c.step / json_extract(t.spec, '$.optimise.iterations')), 0)
       FROM checkpoint c JOIN trial t ON t.id = c.trial_id WHERE t.state IN ('pending', 'running')
         AND EXISTS (SELECT 1 FROM attempt a WHERE a.trial_id = t.id AND a.steps > 0)),
  (SELECT sum(steps) FROM attempt WHERE NOT redone), (SELECT count(*) FROM attempt),
  (SELECT sum(coalesce(a.seconds, (julianday(coalesce(a.ended_at, 'now')) - julianday(a.started_at)) * 86400))
     / nullif(sum(CASE a.state WHEN 'done' THEN t.cost
        ELSE t.cost * a.steps / json_extract(t.spec, '$.optimise.iterations') END), 0)
   FROM attempt a JOIN trial t ON t.id = a.trial_id WHERE a.steps > 0 OR a.state = 'done'),
  avg(holdout_error_initial), avg(holdout_error_optimised), sum(cost),
  sum(state = 'failed' AND reason = 'cancelled'), avg(holdout_median_initial), avg(holdout_median_optimised)
FROM trial";

/// Failures by reason and last error message, each with one of their trials and their number.
pub const FAILED: &str = "SELECT reason, text, min(hash), count(*) FROM
    (SELECT t.hash, t.reason, (SELECT l.text FROM log l WHERE l.trial_id = t.id AND l.level = 'error'
       ORDER BY l.attempt DESC, l.line DESC LIMIT 1) AS text FROM trial t
     WHERE t.state = 'failed' AND t.reason IS NOT 'cancelled') GROUP BY 1, 2 ORDER BY 4 DESC, 1, 2";

/// Progress of a run at one time.
#[derive(Debug, Clone, Default)]
pub struct Progress {
    /// One sentence for people.
    pub summary: String,
    /// Numbers of trials: all, done, failed (without cancelled ones), running.
    pub trials: [u64; 4],
    /// Fraction of the estimated work that is done; `None` without estimates.
    pub part: Option<f64>,
    /// Time that attempts took over the time estimated for their work.
    pub correction: Option<f64>,
    /// One row per worker, with its trial if it has one; then trials whose worker is not visible on this machine.
    pub workers: Table,
    /// Process id of the run.
    pub run: Option<u32>,
}

/// Observes a run repeatedly. Step rates count from the first look, CPU use from the previous look.
#[derive(Debug, Default)]
pub struct Observer {
    first: Option<(Instant, f64)>,
    before: HashMap<u32, (Instant, u64)>,
}

impl Observer {
    /// Records the CPU time of the workers, as a reference for the next look. Returns whether a run exists.
    pub async fn begin(&mut self, db: &Path) -> bool {
        let run = run_of(db).await;
        run.inspect(|run| drop(look(*run, &mut self.before))).is_some()
    }

    /// Reads the progress now.
    ///
    /// # Errors
    /// If the database cannot be read.
    pub async fn look(&mut self, reader: &mut Reader) -> Result<Progress, StoreError> {
        let (whole, running) = (reader.query::<Table>(WHOLE).await?, reader.query::<Table>(RUNNING).await?);
        let run = run_of(reader.path()).await;
        let workers = run.map(|run| look(run, &mut self.before)).unwrap_or_default();
        let number = |i: usize| whole.rows[0][i].as_f64();
        let (left, all) = (number(4).unwrap_or(0.0), number(10).unwrap_or(0.0));
        Ok(Progress {
            summary: summary(&whole, &mut self.first),
            trials: [0, 1, 2, 3].map(|i| number(i).unwrap_or(0.0) as u64),
            part: (all > 0.0).then(|| (1.0 - left / all).clamp(0.0, 1.0)),
            correction: number(7),
            workers: by_worker(&running, &workers),
            run,
        })
    }
}

/// The workers of a run with the CPU use of each since the previous look (% of a core).
fn look(run: u32, before: &mut HashMap<u32, (Instant, u64)>) -> Vec<(WorkerProcess, Option<f64>)> {
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

/// One row per worker, with its trial if it has one; then trials without a visible worker.
fn by_worker(running: &Table, workers: &[(WorkerProcess, Option<f64>)]) -> Table {
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
                row.push(short_hash(&hash(trial)).into());
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

/// `first`: time and number of steps at the first look.
fn summary(whole: &Table, first: &mut Option<(Instant, f64)>) -> String {
    let row = &whole.rows[0];
    let number = |i: usize| row[i].as_f64().unwrap_or(0.0);
    let (total, done, failed, running) = (number(0), number(1), number(2), number(3));
    let mut text = format!(
        "{done} of {total} trials done, {failed} failed, {running} running, {} pending; {} steps in {} attempts",
        total - done - failed - running - number(11),
        number(5),
        number(6),
    );
    let (began, steps) = *first.get_or_insert((Instant::now(), number(5)));
    if number(5) > steps {
        text += &format!(", {:.1} per minute", 60.0 * (number(5) - steps) / began.elapsed().as_secs_f64());
    }
    if number(11) > 0.0 {
        text += &format!("; {} cancelled", number(11));
    }
    let (left, correction) = (number(4), number(7));
    if correction > 0.0 && running > 0.0 {
        text += &format!("; about {} left", duration(left * correction / running));
    }
    if done > 0.0 {
        text += &format!("; mean held-out error so far {:.2} -> {:.2} %", number(8), number(9));
        if number(13) > 0.0 {
            text += &format!(" (medians {:.2} -> {:.2} %)", number(12), number(13));
        }
    }
    text
}
