//! Calls of `run`: plan and outcome.

use std::time::Instant;

use super::write::VERSION;
use super::{Result, Store};
use crate::provenance;

/// Plan of a run at its start.
#[derive(Debug, Clone, Copy)]
pub struct RunPlan {
    /// Number of the shard and of shards; (1, 1) is the whole sweep.
    pub shard: (u32, u32),
    /// Number of workers, and threads per worker.
    pub workers: (u32, u32),
    /// Number of trials to run.
    pub trials: usize,
    /// Estimated time (s).
    pub estimated_seconds: f64,
}

/// Identifies a run in the database until its end.
#[derive(Debug, Clone)]
pub struct RunKey {
    sweep: i64,
    started_at: String,
    host: String,
    shard: (u32, u32),
    begun: Instant,
}

impl Store {
    /// Records the start of a run of the current sweep.
    pub async fn begin_run(&mut self, plan: &RunPlan) -> Result<RunKey> {
        let host = self.provenance.as_ref().map_or(String::new(), |made| made.host.clone());
        let (sweep, started_at): (i64, String) = bound!(sqlx::query_as(
            "INSERT INTO run (sweep_id, started_at, host, shard, shards, job, version, workers, threads, trials,
               estimated_seconds)
             VALUES (?, strftime('%Y-%m-%dT%H:%M:%fZ'), ?, ?, ?, ?, ?, ?, ?, ?, ?) RETURNING sweep_id, started_at");
            self.sweep, &host, plan.shard.0, plan.shard.1, provenance::job(), VERSION, plan.workers.0, plan.workers.1,
            plan.trials as i64, plan.estimated_seconds)
        .fetch_one(&mut self.connection)
        .await
        .map_err(self.at("recording a run in"))?;
        Ok(RunKey { sweep, started_at, host, shard: plan.shard, begun: Instant::now() })
    }

    /// Records the end of a run.
    pub async fn end_run(&mut self, key: &RunKey, outcome: &str, done: usize, failed: usize) -> Result<()> {
        run!(self,
            "UPDATE run SET ended_at = max(started_at, strftime('%Y-%m-%dT%H:%M:%fZ')), seconds = ?, outcome = ?, done = ?,
               failed = ? WHERE sweep_id = ? AND started_at = ? AND host = ? AND shard = ? AND shards = ?";
            key.begun.elapsed().as_secs_f64(), outcome, done as i64, failed as i64, key.sweep, &key.started_at,
            &key.host, key.shard.0, key.shard.1)
        .map_err(self.at("recording a run in"))?;
        Ok(())
    }
}
