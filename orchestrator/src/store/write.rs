//! The writer's methods: batches, attempts, steps with their checkpoints. Records of an attempt that is not the current one fail
//! with `Stale`.

use std::time::Instant;

use metasense_schemas::record::{Checkpoint, StepRecord, TrialResult};
use sqlx::Executor;

use super::digest::{check, digest};
use super::result::finite;
use super::{Result, Store, StoreError, is_no_json};

/// Version of this program, recorded with attempts and sweeps.
pub(super) const VERSION: &str = env!("CARGO_PKG_VERSION");

/// An array of a trial to store.
#[derive(Debug, Clone, Copy)]
pub struct StoredArray<'a> {
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
pub(crate) fn read_checkpoint(hash: &str, stored: (Vec<u8>, Option<Vec<u8>>)) -> Result<Checkpoint> {
    let (bytes, checksum) = stored;
    check(hash, "checkpoint", &bytes, &checksum.unwrap_or_default())?;
    Checkpoint::from_bytes(&bytes).map_err(|error| StoreError::unreadable(hash, "checkpoint", error))
}

impl Store {
    /// Starts a batch: records share one transaction until `commit_batch`, and are durable only after it.
    pub async fn begin_batch(&mut self) -> Result<()> {
        assert!(!self.in_batch, "batches do not nest");
        self.execute("BEGIN IMMEDIATE", "beginning to write to").await?;
        self.in_batch = true;
        Ok(())
    }

    /// Commits the batch: on return it is on disk. After an error, nothing of it was recorded.
    pub async fn commit_batch(&mut self) -> Result<()> {
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

    async fn execute(&mut self, sql: &'static str, doing: &'static str) -> Result<()> {
        self.connection.execute(sql).await.map(drop).map_err(self.at(doing))
    }

    /// Last checkpoint of a trial; `None` without one. Fails with `Damaged`, or with `Unreadable` if it is of another version.
    pub async fn checkpoint(&mut self, hash: &str) -> Result<Option<Checkpoint>> {
        let id = self.id(hash)?;
        let query = bound!(sqlx::query_as("SELECT bytes, digest FROM checkpoint WHERE trial_id = ?"); id);
        let stored = query.fetch_optional(&mut self.connection).await;
        let stored = stored.map_err(self.at("reading a checkpoint from"))?;
        stored.map(|stored| read_checkpoint(hash, stored)).transpose()
    }

    /// Begins an attempt at a trial and returns its number, from 1.
    pub async fn begin_attempt(&mut self, hash: &str) -> Result<u32> {
        let id = self.id(hash)?;
        self.in_transaction("beginning an attempt in", async |store| {
            let made = store.provenance.as_ref();
            // A new attempt supersedes one that is still running.
            run!(store, "UPDATE attempt SET state = 'failed', reason = coalesce(reason, 'superseded'),
                   ended_at = max(started_at, strftime('%Y-%m-%dT%H:%M:%fZ'))
                 WHERE trial_id = ? AND state = 'running'"; id)?;
            run!(store, "UPDATE trial SET state = 'running', reason = NULL WHERE id = ?"; id)?;
            let number = bound!(sqlx::query_scalar(
                "INSERT INTO attempt (trial_id, number, version, started_at, code, revision, rustc, host, cpu, simd, threads)
                 SELECT ?1, 1 + coalesce(max(number), 0), ?2, strftime('%Y-%m-%dT%H:%M:%fZ'), ?3, ?4, ?5, ?6, ?7, ?8, ?9
                 FROM attempt WHERE trial_id = ?1 RETURNING number");
                id, VERSION, made.map(|made| &made.code), made.and_then(|made| made.revision.as_ref()),
                made.map(|made| &made.rustc), made.map(|made| &made.host), made.and_then(|made| made.cpu.as_ref()),
                made.map(|made| &made.simd), made.map(|made| made.threads))
            .fetch_one(&mut store.connection)
            .await?;
            store.begun.insert((id, number), Instant::now());
            Ok(number)
        })
        .await
    }

    /// Records an outer step and the checkpoint after it in one transaction. The designs of some steps are kept.
    pub async fn record_step(
        &mut self,
        hash: &str,
        attempt: u32,
        step: &StepRecord,
        checkpoint: &Checkpoint,
    ) -> Result<()> {
        self.for_current_attempt(hash, attempt, "recording a step in", async |store, id| {
            store.count_progress(id, attempt, 1, 0).await?;
            store.insert_step(id, attempt, step, checkpoint).await
        })
        .await
    }

    /// Records the CPU seconds of the current attempt so far.
    pub async fn record_cpu_seconds(&mut self, hash: &str, attempt: u32, seconds: f64) -> Result<()> {
        let id = self.id(hash)?;
        run!(self, "UPDATE attempt SET cpu_seconds = ? WHERE trial_id = ? AND number = ? AND state = 'running'";
            seconds, id, attempt)
        .map_err(self.at("recording the seconds of an attempt in"))?;
        Ok(())
    }

    /// Records a checkpoint of the final evaluation.
    pub async fn record_checkpoint(
        &mut self,
        hash: &str,
        attempt: u32,
        checkpoint: &Checkpoint,
    ) -> Result<()> {
        self.for_current_attempt(hash, attempt, "recording a checkpoint in", async |store, id| {
            store.count_progress(id, attempt, 0, 1).await?;
            store.insert_checkpoint(id, checkpoint).await
        })
        .await
    }

    /// Adds to the numbers of steps and of evaluation checkpoints of the current attempt.
    pub(super) async fn count_progress(
        &mut self,
        id: i64,
        attempt: u32,
        steps: u32,
        saves: u32,
    ) -> sqlx::Result<()> {
        run!(self, "UPDATE attempt SET steps = steps + ?, saves = saves + ?
             WHERE trial_id = ? AND number = ? AND state = 'running'"; steps, saves, id, attempt)?;
        Ok(())
    }

    async fn insert_step(
        &mut self,
        id: i64,
        attempt: u32,
        step: &StepRecord,
        checkpoint: &Checkpoint,
    ) -> sqlx::Result<()> {
        let StepRecord { step: number, counters, seconds, .. } = step;
        let implicit = step.implicit.as_ref();
        run!(self, "INSERT OR REPLACE INTO step VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?,
             ?, ?, ?, ?, ?, strftime('%Y-%m-%dT%H:%M:%fZ'), ?)";
            id, number, attempt, finite(step.loss_test), finite(step.loss_train), finite(step.error_test),
            finite(step.error_train), finite(step.gradient_norm), finite(step.step_length), &step.projection,
            finite(step.projection_distance), implicit.map(|i| i.iterations), finite(implicit.map(|i| i.residual)),
            finite(implicit.map(|i| i.smallest_curvature)), implicit.map(|i| &i.outcome), &step.outcome,
            step.fresh_samples as i64, counters.force_evaluations as i64, counters.steps as i64,
            counters.rejected as i64, counters.brain_iterations as i64, counters.hessian_products as i64,
            counters.projection_iterations as i64, seconds.simulate, seconds.train, seconds.differentiate,
            seconds.implicit, seconds.project, seconds.store, finite(step.ridge))?;
        self.insert_design(id, checkpoint).await?;
        self.insert_checkpoint(id, checkpoint).await
    }

    pub(super) async fn insert_checkpoint(&mut self, id: i64, checkpoint: &Checkpoint) -> sqlx::Result<()> {
        let bytes = checkpoint.to_bytes();
        run!(self, "INSERT OR REPLACE INTO checkpoint (trial_id, step, digest, bytes) VALUES (?, ?, ?, ?)";
            id, checkpoint.step, digest(&bytes), bytes)?;
        Ok(())
    }

    /// Records the result of a trial with its arrays, sets it to done and deletes its checkpoint. Designs, weights and losses
    /// may be in the result or, under their names in the database, among the arrays.
    pub async fn finish(
        &mut self,
        hash: &str,
        attempt: u32,
        result: &TrialResult,
        arrays: &[StoredArray<'_>],
    ) -> Result<()> {
        self.for_current_attempt(hash, attempt, "recording a result in", async |store, id| {
            store.end_attempt(id, attempt, "done", None).await?;
            store.insert_result(id, result, arrays).await
        })
        .await
    }

    /// Ends an attempt without a result. `settled`: its trial has failed; otherwise, the trial is pending again.
    pub async fn fail(&mut self, hash: &str, attempt: u32, reason: &str, settled: bool) -> Result<()> {
        let state = if settled { "failed" } else { "pending" };
        self.for_current_attempt(hash, attempt, "recording the end of an attempt in", async |store, id| {
            store.end_attempt(id, attempt, "failed", Some(reason)).await?;
            run!(store, "UPDATE trial SET state = ?1, reason = ?2,
                   finished_at = CASE ?1 WHEN 'failed' THEN strftime('%Y-%m-%dT%H:%M:%fZ') END WHERE id = ?3";
                state, reason, id)?;
            Ok(())
        })
        .await
    }

    /// Sets a pending trial to `failed`; its data stays. Records an attempt, so that a merge recognises the later of two
    /// copies.
    pub async fn fail_pending(&mut self, hash: &str, reason: &str) -> Result<()> {
        let attempt = self.begin_attempt(hash).await?;
        self.fail(hash, attempt, reason, true).await
    }

    /// Ends the current attempt. The clock may have been set back, but times never decrease.
    async fn end_attempt(
        &mut self,
        id: i64,
        attempt: u32,
        state: &str,
        reason: Option<&str>,
    ) -> sqlx::Result<()> {
        let seconds = self.begun.remove(&(id, attempt)).map(|begun| begun.elapsed().as_secs_f64());
        run!(self, "UPDATE attempt SET state = ?, reason = ?, seconds = ?,
               ended_at = max(started_at, strftime('%Y-%m-%dT%H:%M:%fZ'))
             WHERE trial_id = ? AND number = ?"; state, reason, seconds, id, attempt)?;
        Ok(())
    }

    /// Ends attempts that a killed run left `running`; the lock ensures that none of them still runs.
    pub(super) async fn release_orphans(&mut self) -> Result<()> {
        self.in_transaction("tidying", async |store| store.execute_all(RELEASE_ORPHANS).await).await
    }

    pub(super) fn id(&self, hash: &str) -> Result<i64> {
        let known = self.ids.get(hash).copied();
        known.ok_or_else(|| StoreError::UnknownTrial(self.path.clone(), hash.to_owned()))
    }

    /// Does all of `work` or nothing: within the batch, or in its own transaction.
    pub(super) async fn in_transaction<T>(
        &mut self,
        doing: &'static str,
        work: impl AsyncFnOnce(&mut Self) -> sqlx::Result<T>,
    ) -> Result<T> {
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

    /// Runs `work` with the id of the trial if this attempt at it is the current one.
    async fn for_current_attempt(
        &mut self,
        hash: &str,
        attempt: u32,
        doing: &'static str,
        work: impl AsyncFnOnce(&mut Self, i64) -> sqlx::Result<()>,
    ) -> Result<()> {
        const CURRENT: &str =
            "SELECT EXISTS (SELECT 1 FROM attempt WHERE trial_id = ? AND number = ? AND state = 'running')";
        let id = self.id(hash)?;
        let done = self.in_transaction(doing, async |store| {
            let current =
                bound!(sqlx::query_scalar(CURRENT); id, attempt).fetch_one(&mut store.connection).await?;
            if current {
                work(store, id).await?;
            }
            Ok(current)
        });
        match done.await {
            Err(StoreError::Sql { source, .. }) if is_no_json(&source) => {
                Err(StoreError::unreadable(hash, "spec", "it is not JSON"))
            }
            Err(error) => Err(error),
            Ok(true) => Ok(()),
            Ok(false) => Err(StoreError::Stale(hash.to_owned(), attempt)),
        }
    }

    /// Converts errors of SQLite during an operation.
    pub(super) fn at(&self, doing: &'static str) -> impl Fn(sqlx::Error) -> StoreError + use<> {
        let path = self.path.clone();
        move |source| StoreError::sql(&path, doing, source)
    }
}
