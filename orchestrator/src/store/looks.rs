//! How far trials have come, and with what errors: what a search for a design decides by.

use std::collections::{BTreeMap, HashMap};

use metasense_worker::FAILED;

use super::{Reader, StoreError, quoted};

/// What an outer step has told of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Outer step, from 0.
    pub step: u32,
    /// Test error (%), where it looked at the test set.
    pub test: Option<f64>,
    /// Training error (%).
    pub train: Option<f64>,
}

/// What is stored of a trial that a search may go on with.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Standing {
    /// `pending`, `running`, `done`, `failed`.
    pub state: String,
    /// Its outer steps.
    pub looks: Vec<Look>,
    /// Holdout error of the optimised body (%).
    pub holdout: Option<f64>,
    /// Errors (%) of its casts by reader and records.
    pub casts: HashMap<(String, u32), Vec<f64>>,
}

impl Reader {
    /// Outer steps and settled trials so far, counted together.
    ///
    /// # Errors
    /// Where SQLite fails.
    pub async fn progress(&mut self) -> Result<u64, StoreError> {
        let sql = "SELECT (SELECT count(*) FROM step)
            + (SELECT count(*) FROM trial WHERE state IN ('done', 'failed')) AS progress";
        let mut progress = 0;
        self.each(sql, |row| {
            progress = row.count("progress");
            Ok::<_, StoreError>(())
        })
        .await?;
        Ok(progress)
    }

    /// How all trials stand, by hash.
    ///
    /// # Errors
    /// Where SQLite fails.
    pub async fn standings(&mut self) -> Result<HashMap<String, Standing>, StoreError> {
        let mut found: HashMap<String, Standing> = HashMap::new();
        self.each("SELECT hash, state, holdout_error_optimised AS holdout FROM v_trial", |row| {
            let (state, holdout) = (row.text("state").to_owned(), row.number("holdout"));
            let standing = Standing { state, holdout, ..Standing::default() };
            found.insert(row.text("hash").to_owned(), standing);
            Ok::<_, StoreError>(())
        })
        .await?;
        let sql =
            "SELECT t.hash, p.step, p.error_test, p.error_train FROM step p JOIN trial t ON t.id = p.trial_id
             ORDER BY p.trial_id, p.step";
        self.each(sql, |row| {
            if let Some(standing) = found.get_mut(row.text("hash")) {
                let [test, train] = [row.number("error_test"), row.number("error_train")];
                standing.looks.push(Look { step: row.count("step") as u32, test, train });
            }
            Ok::<_, StoreError>(())
        })
        .await?;
        let sql = "SELECT t.hash, c.reader, c.records, c.error FROM cast_reading c JOIN trial t ON t.id = c.trial_id
             WHERE c.body = 'optimised' ORDER BY c.trial_id, c.casting";
        self.each(sql, |row| {
            if let Some(standing) = found.get_mut(row.text("hash")) {
                let reader = (row.text("reader").to_owned(), row.count("records") as u32);
                standing.casts.entry(reader).or_default().push(row.number("error").unwrap_or(FAILED));
            }
            Ok::<_, StoreError>(())
        })
        .await?;
        Ok(found)
    }

    /// CPU seconds of all attempts at each trial of a sweep with this text, by its hash, and of a finished one those that made its
    /// result, where they are known.
    ///
    /// # Errors
    /// Where SQLite fails.
    pub async fn spent(&mut self, text: &str) -> Result<BTreeMap<String, (f64, Option<f64>)>, StoreError> {
        let mut spent = BTreeMap::new();
        let sql = format!(
            "SELECT t.hash, sum(a.cpu_seconds) AS seconds,
               CASE t.state WHEN 'done' THEN sum(a.cpu_seconds) FILTER (WHERE NOT a.redone) END AS kept
             FROM sweep s JOIN sweep_trial x ON x.sweep_id = s.id JOIN trial t ON t.id = x.trial_id
               JOIN attempt a ON a.trial_id = t.id
             WHERE s.text = {} GROUP BY t.id",
            quoted(text)
        );
        self.each(&sql, |row| {
            let kept = row.number("kept").filter(|seconds| *seconds > 0.0);
            spent.insert(row.text("hash").to_owned(), (row.number("seconds").unwrap_or(0.0), kept));
            Ok::<_, StoreError>(())
        })
        .await?;
        Ok(spent)
    }
}

impl Standing {
    /// Whether so many outer steps are done, and what they have told by then (%): the best test error; of steps without one
    /// the training error of the last.
    #[must_use]
    pub fn after(&self, steps: u32) -> Option<Option<f64>> {
        let until: Vec<&Look> = self.looks.iter().take_while(|look| look.step < steps).collect();
        let reached = until.last().is_some_and(|look| look.step + 1 == steps);
        let test = || until.iter().filter_map(|look| look.test).min_by(f64::total_cmp);
        reached.then(|| test().or_else(|| until.iter().rev().find_map(|look| look.train)))
    }

    /// The error (%) of the body: the quantile over its casts by a reader, or where none is asked for that of the body as
    /// designed; `None` where there is none.
    #[must_use]
    pub fn error(&self, casts: Option<(&(String, u32), f64)>) -> Option<f64> {
        let Some((reader, quantile)) = casts else { return self.holdout };
        let mut errors = self.casts.get(reader)?.clone();
        errors.sort_by(f64::total_cmp);
        let rank = (quantile * errors.len() as f64 - 1e-9).ceil().max(1.0) as usize;
        errors.get(rank - 1).copied()
    }
}
