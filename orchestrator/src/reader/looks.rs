//! Progress and errors of trials, for searches.

use std::collections::{BTreeMap, HashMap};

use metasense_worker::FAILED;

use super::{Reader, quoted};
use crate::store::StoreError;

/// Errors at an outer step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepErrors {
    /// Outer step, from 0.
    pub step: u32,
    /// Test error (%), if the step evaluated the test set.
    pub test: Option<f64>,
    /// Training error (%).
    pub train: Option<f64>,
}

/// Stored state of a trial in a search.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrialProgress {
    /// `pending`, `running`, `done`, `failed`.
    pub state: String,
    /// Its outer steps, in order.
    pub looks: Vec<StepErrors>,
    /// Held-out error of the optimised body (%).
    pub holdout: Option<f64>,
    /// Errors (%) on casts, by decoder and number of calibration records.
    pub casts: HashMap<(String, u32), Vec<f64>>,
    /// Held-out error of the optimised body by task, with the better readout, direct or decoded.
    pub tasks: HashMap<String, f64>,
}

impl Reader {
    /// Number of outer steps plus number of finished trials so far.
    ///
    /// # Errors
    /// If SQLite fails.
    pub async fn progress(&mut self) -> Result<u64, StoreError> {
        let sql = "SELECT (SELECT count(*) FROM step)
            + (SELECT count(*) FROM trial WHERE state IN ('done', 'failed')) AS progress";
        Ok(self.rows(sql, |row| row.count("progress")).await?[0])
    }

    /// The state of all trials, by hash.
    ///
    /// # Errors
    /// If SQLite fails.
    pub async fn standings(&mut self) -> Result<HashMap<String, TrialProgress>, StoreError> {
        let rows = self.rows("SELECT hash, state, holdout_error_optimised AS holdout FROM v_trial", |row| {
            let (state, holdout) = (row.text("state").to_owned(), row.number("holdout"));
            (row.text("hash").to_owned(), TrialProgress { state, holdout, ..TrialProgress::default() })
        });
        let mut found: HashMap<String, TrialProgress> = rows.await?.into_iter().collect();
        let sql =
            "SELECT t.hash, p.step, p.error_test, p.error_train FROM step p JOIN trial t ON t.id = p.trial_id
             ORDER BY p.trial_id, p.step";
        self.rows(sql, |row| {
            if let Some(standing) = found.get_mut(row.text("hash")) {
                let [test, train] = [row.number("error_test"), row.number("error_train")];
                standing.looks.push(StepErrors { step: row.count("step") as u32, test, train });
            }
        })
        .await?;
        let sql = "SELECT t.hash, c.reader, c.records, c.error FROM cast_reading c JOIN trial t ON t.id = c.trial_id
             WHERE c.body = 'optimised' ORDER BY c.trial_id, c.casting";
        self.rows(sql, |row| {
            if let Some(standing) = found.get_mut(row.text("hash")) {
                let reader = (row.text("reader").to_owned(), row.count("records") as u32);
                standing.casts.entry(reader).or_default().push(row.number("error").unwrap_or(FAILED));
            }
        })
        .await?;
        // networks of tasks are not exported to devices
        let sql = "SELECT hash, task, min(error) AS error FROM v_task WHERE body = 'optimised' AND readout <> 'network'
             GROUP BY hash, task";
        self.rows(sql, |row| {
            if let (Some(standing), Some(error)) = (found.get_mut(row.text("hash")), row.number("error")) {
                standing.tasks.insert(row.text("task").to_owned(), error);
            }
        })
        .await?;
        Ok(found)
    }

    /// CPU seconds per trial of the sweep with this text, by hash: of all attempts, and of those that made the result, if the
    /// trial is done and they are known.
    ///
    /// # Errors
    /// If SQLite fails.
    pub async fn spent(&mut self, text: &str) -> Result<BTreeMap<String, (f64, Option<f64>)>, StoreError> {
        let sql = format!(
            "SELECT t.hash, sum(a.cpu_seconds) AS seconds,
               CASE t.state WHEN 'done' THEN sum(a.cpu_seconds) FILTER (WHERE NOT a.redone) END AS kept
             FROM sweep s JOIN sweep_trial x ON x.sweep_id = s.id JOIN trial t ON t.id = x.trial_id
               JOIN attempt a ON a.trial_id = t.id
             WHERE s.text = {} GROUP BY t.id",
            quoted(text)
        );
        let rows = self.rows(&sql, |row| {
            let kept = row.number("kept").filter(|seconds| *seconds > 0.0);
            (row.text("hash").to_owned(), (row.number("seconds").unwrap_or(0.0), kept))
        });
        Ok(rows.await?.into_iter().collect())
    }
}

impl TrialProgress {
    /// After `steps` outer steps: the best test error (%), or the last training error without any test; the inner `None`
    /// without both. The outer `None`: fewer steps are done.
    pub fn after(&self, steps: u32) -> Option<Option<f64>> {
        let until: Vec<&StepErrors> = self.looks.iter().take_while(|look| look.step < steps).collect();
        let reached = until.last().is_some_and(|look| look.step + 1 == steps);
        let test = || until.iter().filter_map(|look| look.test).min_by(f64::total_cmp);
        reached.then(|| test().or_else(|| until.iter().rev().find_map(|look| look.train)))
    }

    /// Error (%) of the body as designed, or the given quantile over its casts with a decoder; `None` if not stored.
    pub fn error(&self, casts: Option<(&(String, u32), f64)>) -> Option<f64> {
        let Some((reader, quantile)) = casts else { return self.holdout };
        let mut errors = self.casts.get(reader)?.clone();
        errors.sort_by(f64::total_cmp);
        let rank = (quantile * errors.len() as f64 - 1e-9).ceil().max(1.0) as usize;
        errors.get(rank - 1).copied()
    }
}
