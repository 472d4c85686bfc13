//! The writer's methods: attempts, steps with their checkpoints, results.

use std::borrow::Cow;
use std::time::Instant;

use metasense_schemas::record::{
    Band, BodyEvaluation, CastReading, Checkpoint, Counters, NetworkEvaluation, Seconds, StepRecord,
    TrialResult, mean, most_above,
};
use metasense_worker::milestones;
use sqlx::Executor;

use super::digest::{check, digest};
use super::error::is_no_json;
use super::{Store, StoreError, npy_bytes, npy_values};

/// Version of this program, recorded with attempts and sweeps.
pub(super) const VERSION: &str = env!("CARGO_PKG_VERSION");

/// An array of a trial to store.
#[derive(Debug, Clone, Copy)]
pub struct Array<'a> {
    /// Name within the trial, for instance `signals_initial`.
    pub name: &'a str,
    /// Shape, outermost index first.
    pub shape: &'a [usize],
    /// The array as an NPY file.
    pub npy: &'a [u8],
}

/// Ends attempts that a dead run left running, at the time of their last recorded step. Gives the same result whenever it runs.
pub(crate) const RELEASE_ORPHANS: &str = "
    UPDATE main.attempt AS a SET state = 'failed', reason = 'orchestrator_lost',
      ended_at = coalesce(a.ended_at, (SELECT max(p.recorded_at) FROM main.step p
        WHERE p.trial_id = a.trial_id AND p.attempt = a.number), a.started_at) WHERE state = 'running';
    UPDATE main.trial SET state = 'pending', reason = 'orchestrator_lost' WHERE state = 'running';";

/// Decodes a trial's checkpoint and verifies its checksum.
pub(crate) fn read_checkpoint(
    hash: &str,
    (bytes, checksum): (Vec<u8>, Option<Vec<u8>>),
) -> Result<Checkpoint, StoreError> {
    check(hash, "checkpoint", &bytes, &checksum.unwrap_or_default())?;
    Checkpoint::from_bytes(&bytes).map_err(|error| StoreError::Unreadable {
        hash: hash.to_owned(),
        what: "checkpoint",
        message: error.to_string(),
    })
}

impl Store {
    /// Starts a batch: records share one transaction until `commit_batch`, and are durable only after it.
    pub async fn begin_batch(&mut self) -> Result<(), StoreError> {
        assert!(!self.in_batch, "batches do not nest");
        self.execute("BEGIN IMMEDIATE", "beginning to write to").await?;
        self.in_batch = true;
        Ok(())
    }

    /// Commits the batch: on return it is on disk.
    ///
    /// # Errors
    /// If SQLite fails, for instance on a full disk: nothing of the batch was recorded.
    pub async fn commit_batch(&mut self) -> Result<(), StoreError> {
        assert!(self.in_batch, "no batch was begun");
        self.in_batch = false;
        let done = self.execute("COMMIT", "committing to").await;
        if done.is_err() {
            // A failed COMMIT may leave the transaction open; if it does not, ROLLBACK fails, too.
            let _ = self.connection.execute("ROLLBACK").await;
        }
        done
    }

    /// Rolls back a batch after an error: nothing of it is recorded.
    pub async fn drop_batch(&mut self) {
        if std::mem::take(&mut self.in_batch) {
            let _ = self.connection.execute("ROLLBACK").await;
        }
    }

    async fn execute(&mut self, sql: &'static str, doing: &'static str) -> Result<(), StoreError> {
        let done = self.connection.execute(sql).await;
        done.map(|_| ()).map_err(self.at(doing))
    }

    /// Last checkpoint of a trial; `None` without one.
    ///
    /// # Errors
    /// If SQLite fails, or the checkpoint is damaged or of another version.
    pub async fn checkpoint(&mut self, hash: &str) -> Result<Option<Checkpoint>, StoreError> {
        let id = self.id(hash)?;
        let stored = sqlx::query_as("SELECT bytes, digest FROM checkpoint WHERE trial_id = ?")
            .bind(id)
            .fetch_optional(&mut self.connection)
            .await
            .map_err(self.at("reading a checkpoint from"))?;
        stored.map(|stored| read_checkpoint(hash, stored)).transpose()
    }

    /// Begins an attempt at a trial and returns its number, from 1.
    pub async fn begin_attempt(&mut self, hash: &str) -> Result<u32, StoreError> {
        let id = self.id(hash)?;
        self.in_transaction("beginning an attempt in", async |store| store.insert_attempt(id).await).await
    }

    async fn insert_attempt(&mut self, id: i64) -> sqlx::Result<u32> {
        let made = self.provenance.as_ref();
        // A new attempt supersedes one that is still running.
        sqlx::query(
            "UPDATE attempt SET state = 'failed', reason = coalesce(reason, 'superseded'),
               ended_at = max(started_at, strftime('%Y-%m-%dT%H:%M:%fZ'))
             WHERE trial_id = ? AND state = 'running'",
        )
        .bind(id)
        .execute(&mut self.connection)
        .await?;
        sqlx::query("UPDATE trial SET state = 'running', reason = NULL WHERE id = ?")
            .bind(id)
            .execute(&mut self.connection)
            .await?;
        let number = sqlx::query_scalar(
            "INSERT INTO attempt (trial_id, number, version, started_at, code, revision, rustc, host, cpu, simd, threads)
             SELECT ?1, 1 + coalesce(max(number), 0), ?2, strftime('%Y-%m-%dT%H:%M:%fZ'), ?3, ?4, ?5, ?6, ?7, ?8, ?9
             FROM attempt WHERE trial_id = ?1 RETURNING number",
        )
        .bind(id)
        .bind(VERSION)
        .bind(made.map(|made| &made.code))
        .bind(made.and_then(|made| made.revision.as_ref()))
        .bind(made.map(|made| &made.rustc))
        .bind(made.map(|made| &made.host))
        .bind(made.and_then(|made| made.cpu.as_ref()))
        .bind(made.map(|made| &made.simd))
        .bind(made.map(|made| made.threads))
        .fetch_one(&mut self.connection)
        .await?;
        self.begun.insert((id, number), Instant::now());
        Ok(number)
    }

    /// Records an outer step and the checkpoint after it in one transaction. The designs of some steps are kept.
    ///
    /// # Errors
    /// `Stale` if the attempt is not the current one.
    pub async fn record_step(
        &mut self,
        hash: &str,
        attempt: u32,
        step: &StepRecord,
        checkpoint: &Checkpoint,
    ) -> Result<(), StoreError> {
        self.for_current_attempt(hash, attempt, "recording a step in", async |store, id| {
            let current = store.count_progress(id, attempt, 1, 0).await?;
            if current {
                store.insert_step(id, attempt, step, checkpoint).await?;
            }
            Ok(current)
        })
        .await
    }

    /// Records the CPU seconds of the current attempt so far.
    pub async fn record_cpu_seconds(
        &mut self,
        hash: &str,
        attempt: u32,
        seconds: f64,
    ) -> Result<(), StoreError> {
        let id = self.id(hash)?;
        sqlx::query(
            "UPDATE attempt SET cpu_seconds = ? WHERE trial_id = ? AND number = ? AND state = 'running'",
        )
        .bind(seconds)
        .bind(id)
        .bind(attempt)
        .execute(&mut self.connection)
        .await
        .map_err(self.at("recording the seconds of an attempt in"))?;
        Ok(())
    }

    /// Records a checkpoint of the final evaluation.
    ///
    /// # Errors
    /// `Stale` if the attempt is not the current one.
    pub async fn record_checkpoint(
        &mut self,
        hash: &str,
        attempt: u32,
        checkpoint: &Checkpoint,
    ) -> Result<(), StoreError> {
        self.for_current_attempt(hash, attempt, "recording a checkpoint in", async |store, id| {
            let current = store.count_progress(id, attempt, 0, 1).await?;
            if current {
                store.insert_checkpoint(id, checkpoint).await?;
            }
            Ok(current)
        })
        .await
    }

    /// Adds to the numbers of steps and of evaluation checkpoints of an attempt; false if it is not the current one.
    pub(super) async fn count_progress(
        &mut self,
        id: i64,
        attempt: u32,
        steps: i64,
        saves: i64,
    ) -> sqlx::Result<bool> {
        let done = sqlx::query(
            "UPDATE attempt SET steps = steps + ?, saves = saves + ?
             WHERE trial_id = ? AND number = ? AND state = 'running'",
        )
        .bind(steps)
        .bind(saves)
        .bind(id)
        .bind(attempt)
        .execute(&mut self.connection)
        .await?;
        Ok(done.rows_affected() == 1)
    }

    async fn insert_step(
        &mut self,
        id: i64,
        attempt: u32,
        step: &StepRecord,
        checkpoint: &Checkpoint,
    ) -> sqlx::Result<()> {
        let StepRecord { error_test, error_train, gradient_norm, step_length, counters, seconds, .. } = step;
        let implicit = step.implicit.as_ref();
        let mut query = sqlx::query(
            "INSERT OR REPLACE INTO step VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?,
             ?, ?, ?, ?, ?, strftime('%Y-%m-%dT%H:%M:%fZ'), ?)",
        );
        query = query.bind(id).bind(step.step).bind(attempt);
        query = query.bind(finite(step.loss_test)).bind(finite(step.loss_train));
        for number in [error_test, error_train, gradient_norm, step_length] {
            query = query.bind(finite(*number));
        }
        query = query
            .bind(&step.projection)
            .bind(finite(step.projection_distance))
            .bind(implicit.map(|i| i.iterations))
            .bind(finite(implicit.map(|i| i.residual)))
            .bind(finite(implicit.map(|i| i.smallest_curvature)))
            .bind(implicit.map(|i| &i.outcome))
            .bind(&step.outcome)
            .bind(step.fresh_samples as i64);
        let Counters { force_evaluations, steps, rejected, .. } = counters;
        let Counters { brain_iterations, hessian_products, projection_iterations, .. } = counters;
        for count in
            [force_evaluations, steps, rejected, brain_iterations, hessian_products, projection_iterations]
        {
            query = query.bind(*count as i64);
        }
        let Seconds { simulate, train, differentiate, implicit, project, store } = seconds;
        for part in [simulate, train, differentiate, implicit, project, store] {
            query = query.bind(*part);
        }
        query.bind(finite(step.ridge)).execute(&mut self.connection).await?;
        self.insert_design(id, checkpoint).await?;
        self.insert_checkpoint(id, checkpoint).await
    }

    pub(super) async fn insert_checkpoint(&mut self, id: i64, checkpoint: &Checkpoint) -> sqlx::Result<()> {
        let bytes = checkpoint.to_bytes();
        sqlx::query("INSERT OR REPLACE INTO checkpoint (trial_id, step, digest, bytes) VALUES (?, ?, ?, ?)")
            .bind(id)
            .bind(checkpoint.step)
            .bind(digest(&bytes))
            .bind(bytes)
            .execute(&mut self.connection)
            .await?;
        Ok(())
    }

    /// Records the result of a trial with its arrays, sets it to done and deletes its checkpoint. Designs, weights and losses
    /// may be in the result or, under their names in the database, among the arrays.
    ///
    /// # Errors
    /// `Stale` if the attempt is not the current one.
    pub async fn finish(
        &mut self,
        hash: &str,
        attempt: u32,
        result: &TrialResult,
        arrays: &[Array<'_>],
    ) -> Result<(), StoreError> {
        self.for_current_attempt(hash, attempt, "recording a result in", async |store, id| {
            let current = store.end_attempt(id, attempt, "done", None).await?;
            if current {
                store.insert_result(id, result, arrays).await?;
            }
            Ok(current)
        })
        .await
    }

    async fn insert_result(
        &mut self,
        id: i64,
        result: &TrialResult,
        arrays: &[Array<'_>],
    ) -> sqlx::Result<()> {
        let mut query = sqlx::query(
            "UPDATE trial SET state = 'done', reason = NULL, error_initial = ?, error_optimised = ?,
               train_error_initial = ?, train_error_optimised = ?, holdout_error_initial = ?,
               holdout_error_optimised = ?, holdout_median_initial = ?, holdout_median_optimised = ?,
               holdout_p90_initial = ?, holdout_p90_optimised = ?, holdout_above_initial = ?,
               holdout_above_optimised = ?, best_step = ?, seconds_evaluation = ?, simd = ?, solver = ?, result = ?,
               finished_at = strftime('%Y-%m-%dT%H:%M:%fZ')
             WHERE id = ?",
        );
        let errors: [fn(&NetworkEvaluation) -> Option<f64>; 5] = [
            |n| n.error_test,
            |n| n.error_train,
            |n| n.error_holdout,
            |n| n.spread?.median,
            |n| n.spread?.p90,
        ];
        for error in errors {
            query = query.bind(mean(&result.initial.networks, error));
            query = query.bind(mean(&result.optimised.networks, error));
        }
        for body in [&result.initial, &result.optimised] {
            query = query.bind(most_above(&body.networks));
        }
        query
            .bind(result.best_step)
            .bind(finite(Some(result.seconds_evaluation)))
            .bind(&result.simd)
            .bind(&result.solver)
            .bind(without_bulk(result))
            .bind(id)
            .execute(&mut self.connection)
            .await?;
        for (body, evaluation) in [("initial", &result.initial), ("optimised", &result.optimised)] {
            self.insert_evaluation(id, body, evaluation, arrays).await?;
        }
        for (body, casts) in ["initial", "optimised"].into_iter().zip(&result.casts) {
            self.insert_casts(id, body, casts).await?;
        }
        for (body, bands) in ["initial", "optimised"].into_iter().zip(&result.bands) {
            self.insert_bands(id, body, bands).await?;
        }
        for array in arrays {
            self.insert_artifact(id, array.name, array.shape, array.npy.to_vec()).await?;
        }
        sqlx::query("DELETE FROM checkpoint WHERE trial_id = ?")
            .bind(id)
            .execute(&mut self.connection)
            .await?;
        Ok(())
    }

    async fn insert_evaluation(
        &mut self,
        id: i64,
        body: &str,
        evaluation: &BodyEvaluation,
        arrays: &[Array<'_>],
    ) -> sqlx::Result<()> {
        // networks with long training get the next numbers; their iterations distinguish them
        let (ordinary, long) = (&evaluation.networks, &evaluation.long);
        for (seed, network) in ordinary.iter().chain(long).enumerate() {
            let kind = if seed < ordinary.len() { "losses" } else { "long_losses" };
            let name = format!("{kind}_{body}_{seed}");
            let apart = arrays.iter().find(|array| array.name == name);
            let losses = match apart {
                Some(array) => Cow::Owned(npy_values::<f32>(array.npy).map_err(sqlx::Error::Io)?),
                None => Cow::Borrowed(&network.losses[..]),
            };
            sqlx::query("INSERT OR REPLACE INTO network VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)")
                .bind(id)
                .bind(body)
                .bind(seed as i64)
                .bind(finite(network.error_train))
                .bind(finite(network.error_test))
                .bind(finite(network.error_holdout))
                .bind(losses.len() as i64)
                .bind(&network.outcome)
                .bind(finite(network.spread.and_then(|s| s.median)))
                .bind(finite(network.spread.and_then(|s| s.p90)))
                .bind(network.spread.map(|s| s.above))
                .execute(&mut self.connection)
                .await?;
            for iteration in milestones(losses.len()) {
                let at = network.errors.iter().find(|(n, _)| *n as usize == iteration);
                sqlx::query("INSERT OR REPLACE INTO curve VALUES (?, ?, ?, ?, ?, ?)")
                    .bind(id)
                    .bind(body)
                    .bind(seed as i64)
                    .bind(iteration as i64)
                    .bind(finite(Some(losses[iteration - 1].into())))
                    .bind(finite(at.map(|(_, error)| *error)))
                    .execute(&mut self.connection)
                    .await?;
            }
            if !network.weights.is_empty() {
                let (name, shape) = (format!("weights_{body}_{seed}"), [network.weights.len()]);
                self.insert_artifact(id, &name, &shape, npy_bytes(&shape, &network.weights)).await?;
            }
            if apart.is_none() && !losses.is_empty() {
                let shape = [losses.len()];
                self.insert_artifact(id, &name, &shape, npy_bytes(&shape, &losses)).await?;
            }
        }
        for (n, reading) in evaluation.readings.iter().enumerate() {
            sqlx::query("INSERT OR REPLACE INTO reading VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)")
                .bind(id)
                .bind(body)
                .bind(reading.before)
                .bind(reading.after)
                .bind(i64::from(n == 0))
                .bind(reading.ridge)
                .bind(finite(reading.error_train))
                .bind(finite(reading.error_test))
                .bind(finite(reading.error_holdout))
                .bind(finite(reading.spread.and_then(|s| s.median)))
                .bind(finite(reading.spread.and_then(|s| s.p90)))
                .bind(reading.spread.map(|s| s.above))
                .execute(&mut self.connection)
                .await?;
        }
        let (design, shape) = (&evaluation.design, [evaluation.design.len()]);
        if !design.is_empty() {
            let bytes = npy_bytes(&shape, design);
            self.insert_artifact(id, &format!("alpha_{body}"), &shape, bytes).await?;
        }
        Ok(())
    }

    async fn insert_bands(&mut self, id: i64, body: &str, bands: &[Band]) -> sqlx::Result<()> {
        for band in bands {
            sqlx::query("INSERT OR REPLACE INTO band VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)")
                .bind(id)
                .bind(body)
                .bind(band.cast.map_or(-1, i64::from))
                .bind(&band.reader)
                .bind(band.records)
                .bind(&band.method)
                .bind(&band.kind)
                .bind(band.level)
                .bind(band.samples)
                .bind(finite(band.coverage))
                .bind(finite(band.width))
                .bind(&band.outcome)
                .execute(&mut self.connection)
                .await?;
            if !band.half_width.is_empty() {
                let (name, shape) = (format!("band_{}_{body}", band.kind), [band.half_width.len()]);
                self.insert_artifact(id, &name, &shape, npy_bytes(&shape, &band.half_width)).await?;
            }
        }
        Ok(())
    }

    async fn insert_casts(&mut self, id: i64, body: &str, casts: &[CastReading]) -> sqlx::Result<()> {
        for reading in casts {
            sqlx::query("INSERT OR REPLACE INTO cast_reading VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)")
                .bind(id)
                .bind(body)
                .bind(reading.cast)
                .bind(&reading.reader)
                .bind(reading.records)
                .bind(finite(reading.error))
                .bind(&reading.outcome)
                .bind(finite(reading.spread.and_then(|s| s.median)))
                .bind(finite(reading.spread.and_then(|s| s.p90)))
                .bind(reading.spread.map(|s| s.above))
                .bind(finite(reading.ridge))
                .bind(finite(reading.share))
                .execute(&mut self.connection)
                .await?;
        }
        Ok(())
    }

    pub(super) async fn insert_artifact(
        &mut self,
        id: i64,
        name: &str,
        shape: &[usize],
        npy: Vec<u8>,
    ) -> sqlx::Result<()> {
        sqlx::query(
            "INSERT OR REPLACE INTO artifact (trial_id, name, shape, digest, bytes) VALUES (?, ?, ?, ?, ?)",
        )
        .bind(id)
        .bind(name)
        .bind(serde_json::to_string(shape).expect("numbers are JSON"))
        .bind(digest(&npy))
        .bind(npy)
        .execute(&mut self.connection)
        .await?;
        Ok(())
    }

    /// Ends an attempt and sets its trial to `pending`.
    ///
    /// # Errors
    /// `Stale` if the attempt is not the current one.
    pub async fn give_up_attempt(
        &mut self,
        hash: &str,
        attempt: u32,
        reason: &str,
    ) -> Result<(), StoreError> {
        self.end(hash, attempt, reason, "pending").await
    }

    /// Ends an attempt and sets its trial to `failed`.
    ///
    /// # Errors
    /// `Stale` if the attempt is not the current one.
    pub async fn fail(&mut self, hash: &str, attempt: u32, reason: &str) -> Result<(), StoreError> {
        self.end(hash, attempt, reason, "failed").await
    }

    /// Sets a pending trial to `failed`; its data stays. Records an attempt, so that a merge recognises the later of two
    /// copies.
    pub async fn fail_pending(&mut self, hash: &str, reason: &str) -> Result<(), StoreError> {
        let attempt = self.begin_attempt(hash).await?;
        self.fail(hash, attempt, reason).await
    }

    async fn end(&mut self, hash: &str, attempt: u32, reason: &str, state: &str) -> Result<(), StoreError> {
        self.for_current_attempt(hash, attempt, "recording the end of an attempt in", async |store, id| {
            let current = store.end_attempt(id, attempt, "failed", Some(reason)).await?;
            if current {
                sqlx::query(
                    "UPDATE trial SET state = ?1, reason = ?2,
                       finished_at = CASE ?1 WHEN 'failed' THEN strftime('%Y-%m-%dT%H:%M:%fZ') END WHERE id = ?3",
                )
                .bind(state)
                .bind(reason)
                .bind(id)
                .execute(&mut store.connection)
                .await?;
            }
            Ok(current)
        })
        .await
    }

    /// Ends the current attempt; false if it is not current. The clock may have been set back, but times never decrease.
    async fn end_attempt(
        &mut self,
        id: i64,
        attempt: u32,
        state: &str,
        reason: Option<&str>,
    ) -> sqlx::Result<bool> {
        let seconds = self.begun.remove(&(id, attempt)).map(|begun| begun.elapsed().as_secs_f64());
        let done = sqlx::query(
            "UPDATE attempt SET state = ?, reason = ?, seconds = ?,
               ended_at = max(started_at, strftime('%Y-%m-%dT%H:%M:%fZ'))
             WHERE trial_id = ? AND number = ? AND state = 'running'",
        )
        .bind(state)
        .bind(reason)
        .bind(seconds)
        .bind(id)
        .bind(attempt)
        .execute(&mut self.connection)
        .await?;
        Ok(done.rows_affected() == 1)
    }

    /// Ends attempts that a killed run left `running`; the lock ensures that none of them still runs.
    pub(super) async fn release_orphans(&mut self) -> Result<(), StoreError> {
        self.in_transaction("tidying", async |store| {
            sqlx::raw_sql(RELEASE_ORPHANS).execute(&mut store.connection).await
        })
        .await?;
        Ok(())
    }

    pub(super) fn id(&self, hash: &str) -> Result<i64, StoreError> {
        self.ids
            .get(hash)
            .copied()
            .ok_or_else(|| StoreError::UnknownTrial { path: self.path.clone(), hash: hash.to_owned() })
    }

    /// Does all of `work` or nothing: within the batch, or in its own transaction.
    pub(super) async fn in_transaction<T>(
        &mut self,
        doing: &'static str,
        work: impl AsyncFnOnce(&mut Self) -> sqlx::Result<T>,
    ) -> Result<T, StoreError> {
        let own = !self.in_batch;
        if own {
            self.execute("BEGIN IMMEDIATE", doing).await?;
        }
        let done = match work(self).await {
            Ok(value) if own => self.connection.execute("COMMIT").await.map(|_| value),
            other => other,
        };
        if own && done.is_err() {
            let _ = self.connection.execute("ROLLBACK").await;
        }
        done.map_err(self.at(doing))
    }

    /// Runs `work` for an attempt. `work` gets the id of the trial and returns whether the attempt is the current one.
    async fn for_current_attempt(
        &mut self,
        hash: &str,
        attempt: u32,
        doing: &'static str,
        work: impl AsyncFnOnce(&mut Self, i64) -> sqlx::Result<bool>,
    ) -> Result<(), StoreError> {
        let id = self.id(hash)?;
        let done = self.in_transaction(doing, async |store| work(store, id).await).await;
        match done {
            Err(StoreError::Sql { source, .. }) if is_no_json(&source) => Err(StoreError::Unreadable {
                hash: hash.to_owned(),
                what: "spec",
                message: "it is not JSON".into(),
            }),
            Err(error) => Err(error),
            Ok(true) => Ok(()),
            Ok(false) => Err(StoreError::Stale { hash: hash.to_owned(), attempt: attempt.into() }),
        }
    }

    /// Converts errors of SQLite during an operation.
    pub(super) fn at(&self, doing: &'static str) -> impl Fn(sqlx::Error) -> StoreError + use<> {
        let path = self.path.clone();
        move |source| StoreError::sql(&path, doing, source)
    }
}

/// Non-finite numbers are stored as NULL; the outcome column gives the reason.
fn finite(value: Option<f64>) -> Option<f64> {
    value.filter(|v| v.is_finite())
}

/// The result as JSON, without the data that is stored elsewhere.
fn without_bulk(result: &TrialResult) -> String {
    let mut small = result.clone();
    small.casts = Default::default();
    small.bands = Default::default();
    for body in [&mut small.initial, &mut small.optimised] {
        body.design.clear();
        body.readings.clear();
        for network in body.networks.iter_mut().chain(&mut body.long) {
            network.losses.clear();
            network.errors.clear();
            network.weights.clear();
        }
    }
    serde_json::to_string(&small).expect("a result is JSON")
}
