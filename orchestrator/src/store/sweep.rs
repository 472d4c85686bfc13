//! The writer's methods for sweeps: record their trials, and list those that have ended.

use metasense_schemas::record::PlannedTrial;
use metasense_schemas::spec::SweepSpec;
use serde_json::json;

use super::write::VERSION;
use super::{Result, Store, StoreError};
use crate::analysis::until::TrialErrors;

impl Store {
    /// Records a sweep and its new trials. If nothing is new, changes nothing, except that it updates changed paths of recorded
    /// forces and replaces damaged specs.
    /// Fails with `FactsAlone` if the database contains only facts, from which trials cannot resume.
    pub async fn begin_sweep(&mut self, spec: &SweepSpec, text: &str, trials: &[PlannedTrial]) -> Result<()> {
        let at = self.at("recording the sweep in");
        let facts = "SELECT EXISTS (SELECT 1 FROM elsewhere)";
        if sqlx::query_scalar(facts).fetch_one(&mut self.connection).await.map_err(&at)? {
            return Err(StoreError::FactsAlone(self.path.clone()));
        }
        // Recorded forces of all trials move together, so the first trial represents all.
        let first = trials.first().map(|t| serde_json::to_string(&t.spec).expect("a trial is JSON"));
        let hashes: Vec<&str> = trials.iter().map(|t| t.hash.as_str()).collect();
        let known: Option<i64> = bound!(sqlx::query_scalar(
            "SELECT s.id FROM sweep s WHERE s.name = ?1 AND s.text = ?2
             AND coalesce(?3, '') IN (SELECT '' UNION ALL SELECT spec FROM trial WHERE hash = ?4)
             AND ?5 = (SELECT count(*) FROM sweep_trial x WHERE x.sweep_id = s.id)
             AND ?5 = (SELECT count(*) FROM json_each(?6) j JOIN trial t ON t.hash = j.value AND t.training IS NOT NULL
                       JOIN sweep_trial x ON x.trial_id = t.id AND x.sweep_id = s.id AND json_valid(t.spec))");
            &spec.name, text, &first, trials.first().map(|t| &t.hash), trials.len() as i64,
            serde_json::to_string(&hashes).expect("texts are JSON"))
        .fetch_optional(&mut self.connection)
        .await
        .map_err(&at)?;
        self.sweep = match known {
            Some(id) => Some(id),
            None => Some(self.insert_sweep(spec, text, trials).await?),
        };
        let ids = sqlx::query_as::<_, (String, i64)>("SELECT hash, id FROM trial");
        self.ids = ids.fetch_all(&mut self.connection).await.map_err(&at)?.into_iter().collect();
        Ok(())
    }

    /// Records a sweep with its trials. Ids decrease: `v_trial` shows the sweep with the highest id, which is the first with the
    /// trial.
    async fn insert_sweep(&mut self, spec: &SweepSpec, text: &str, trials: &[PlannedTrial]) -> Result<i64> {
        let resolved = serde_json::to_string(spec).expect("a spec is JSON");
        self.in_transaction("recording the sweep in", async |store| {
            let id: i64 = bound!(sqlx::query_scalar(
                "INSERT INTO sweep (id, name, text, spec, version, created_at)
                 VALUES ((SELECT coalesce(min(id), 1) - 1 FROM sweep), ?, ?, ?, ?, strftime('%Y-%m-%dT%H:%M:%fZ'))
                 ON CONFLICT DO UPDATE SET spec = excluded.spec, version = excluded.version RETURNING id");
                &spec.name, text, resolved, VERSION)
            .fetch_one(&mut store.connection)
            .await?;
            for chunk in trials.chunks(CHUNK) {
                let rows = serde_json::Value::from_iter(chunk.iter().map(row)).to_string();
                for sql in [INSERT_TRIALS, INSERT_SWEEP_TRIALS] {
                    run!(store, sql; &rows, id)?;
                }
            }
            Ok(id)
        })
        .await
    }

    /// Reopens the failed and cancelled trials among these; they resume from their last steps. Returns their number.
    pub async fn reopen(&mut self, hashes: &[&str]) -> Result<u64> {
        let done = run!(self,
            "UPDATE trial SET state = 'pending', reason = NULL, finished_at = NULL WHERE state = 'failed'
               AND hash IN (SELECT value FROM json_each(?))";
            serde_json::to_string(hashes).expect("texts are JSON"))
        .map_err(self.at("reopening trials in"))?;
        Ok(done.rows_affected())
    }

    /// Hashes of the trials that are done or failed.
    pub async fn settled(&mut self) -> Result<Vec<String>> {
        let hashes = sqlx::query_scalar("SELECT hash FROM trial WHERE state IN ('done', 'failed')");
        hashes.fetch_all(&mut self.connection).await.map_err(self.at("reading"))
    }

    /// Errors and CPU seconds of all trials that are done or failed.
    pub async fn trial_errors(&mut self) -> Result<Vec<TrialErrors>> {
        let sql = "SELECT hash, holdout_error_initial, holdout_error_optimised,
               CAST(coalesce(seconds, 0) AS REAL) FROM v_trial WHERE state IN ('done', 'failed')";
        let errors =
            |(hash, initial, optimised, seconds)| TrialErrors { hash, errors: [initial, optimised], seconds };
        let rows = sqlx::query_as(sql).fetch_all(&mut self.connection).await.map_err(self.at("reading"))?;
        Ok(rows.into_iter().map(errors).collect())
    }
}

/// Trials per INSERT statement, as a JSON list; this is five times faster than one statement per trial.
const CHUNK: usize = 500;

const INSERT_TRIALS: &str = "
    INSERT INTO trial (hash, spec, layout, columns, rows, units, panels, sensors, placement, seed, protocol,
      design_parameters, brain_parameters, cost, training, created_at)
    SELECT value->>0, value->>1, value->>2, value->>3, value->>4, value->>5, value->>6, value->>7, value->>8, value->>9,
      value->>10, value->>11, value->>12, value->>13, value->>15, strftime('%Y-%m-%dT%H:%M:%fZ')
    FROM json_each(?1) WHERE ?2 IS NOT NULL
    ON CONFLICT (hash) DO UPDATE SET spec = excluded.spec, training = excluded.training
      WHERE spec <> excluded.spec OR training IS NULL";

const INSERT_SWEEP_TRIALS: &str = "
    INSERT INTO sweep_trial (sweep_id, trial_id, position)
    SELECT ?2, t.id, value->>14 FROM json_each(?1) JOIN trial t ON t.hash = value->>0 WHERE true
    ON CONFLICT (sweep_id, trial_id) DO UPDATE SET position = excluded.position";

/// The row of a trial for the statements above.
fn row(trial: &PlannedTrial) -> serde_json::Value {
    let spec = &trial.spec;
    json!([
        trial.hash,
        serde_json::to_string(spec).expect("a trial is JSON"),
        if spec.body.kind.is_polygons() { json!(spec.body.layout) } else { json!(spec.body.kind) },
        spec.body.columns(),
        spec.body.rows(),
        trial.units,
        spec.point.panels,
        spec.point.sensors,
        spec.point.placement,
        spec.point.seed,
        spec.optimise.protocol,
        trial.design_parameters,
        trial.brain_parameters,
        trial.seconds(),
        trial.order,
        trial.training,
    ])
}
