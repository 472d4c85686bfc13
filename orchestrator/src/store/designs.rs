//! Designs that are kept during the training of a trial.

use metasense_schemas::record::Checkpoint;
use metasense_schemas::spec::Optimise;

use super::Store;

/// Most designs kept per trial.
const KEPT: usize = 20;

/// Prefix of the array names; the number of outer steps follows.
pub(crate) const NAME: &str = "design_step_";

impl Store {
    /// Keeps a checkpoint's design if its step is due: the last step, and every n-th step counted back from it, n = steps /
    /// `KEPT` rounded up. The choice does not depend on interruptions.
    pub(super) async fn insert_design(&mut self, id: i64, checkpoint: &Checkpoint) -> sqlx::Result<()> {
        let (steps, step) = (self.optimise(id).await?.steps(), checkpoint.step);
        let apart = steps.div_ceil(KEPT).max(1);
        if !steps.abs_diff(step as usize).is_multiple_of(apart) {
            return Ok(());
        }
        // for inspection, not for resuming: 32 bits suffice
        let design: Vec<f32> = checkpoint.design.iter().map(|x| *x as f32).collect();
        self.insert_values(id, &format!("{NAME}{step}"), &design).await
    }

    /// The `[optimise]` settings of a trial.
    pub(super) async fn optimise(&mut self, id: i64) -> sqlx::Result<Optimise> {
        let optimise: String =
            bound!(sqlx::query_scalar("SELECT spec->'$.optimise' FROM trial WHERE id = ?"); id)
                .fetch_one(&mut self.connection)
                .await?;
        serde_json::from_str(&optimise).map_err(|e| sqlx::Error::Decode(e.into()))
    }

    /// Copies the kept designs of another trial with the same body to this one.
    pub(super) async fn take_over_designs(&mut self, other: i64, id: i64) -> sqlx::Result<()> {
        run!(self, "INSERT OR IGNORE INTO artifact (trial_id, name, shape, digest, bytes)
             SELECT ?, name, shape, digest, bytes FROM artifact WHERE trial_id = ? AND substr(name, 1, length(?3)) = ?3";
            id, other, NAME)?;
        Ok(())
    }
}
