//! State of the trials of a sweep after earlier runs.

use std::collections::HashMap;

use metasense_schemas::record::Checkpoint;
use sqlx::AssertSqlSafe;

use super::{LogLevel, Result, Store, StoreError, check, npy_values};

/// Progress of a trial in earlier runs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PriorProgress {
    /// Number of attempts.
    pub attempts: u32,
    /// Steps up to its checkpoint, if any.
    pub steps: Option<u32>,
}

/// Trials `m` whose steps other trials with the same body can take over, and the number of these steps. All work on `m` must be
/// by this program's code (`?2`) and instruction set (`?3`). Finished trials have all their steps.
const TRAINERS: &str = "
    SELECT m.id, m.hash, m.training, m.best_step,
      CASE m.state WHEN 'done' THEN CAST(m.spec->>'$.optimise.iterations' AS INTEGER) ELSE c.step END AS reached
    FROM trial m LEFT JOIN checkpoint c ON c.trial_id = m.id
    WHERE m.training IN (SELECT t.training FROM trial t WHERE t.id = ?1 OR ?1 IS NULL AND t.state IN ('pending', 'running'))
      AND (m.state = 'done' OR c.step > 0) AND NOT EXISTS (SELECT 1 FROM attempt a WHERE a.trial_id = m.id
        AND NOT a.redone AND (a.code IS NOT ?2 OR a.simd IS NOT ?3) AND (a.steps > 0 OR a.saves > 0 OR a.state = 'done'))";

/// Id, hash, steps and best step of such a trial.
type Trainer = (i64, String, u32, u32);

/// Separates stored data that cannot be used (inner error) from a failing database.
fn usable<T>(read: Result<T>) -> Result<Result<T>> {
    match read {
        Err(error @ (StoreError::Damaged(..) | StoreError::Unreadable { .. })) => Ok(Err(error)),
        read => read.map(Ok),
    }
}

impl Store {
    /// Most outer steps per body of open trials, over all trials that train it, by [`TrialSpec::training`].
    ///
    /// [`TrialSpec::training`]: metasense_schemas::spec::TrialSpec::training
    pub async fn bodies(&mut self) -> Result<HashMap<String, u32>> {
        // Safe: contains only our own SQL.
        let sql = format!("SELECT training, max(reached) FROM ({TRAINERS}) GROUP BY training");
        let (code, simd) = self.provenance.as_ref().map(|made| (&made.code, &made.simd)).unzip();
        let query = bound!(sqlx::query_as::<_, (String, u32)>(AssertSqlSafe(sql)); None::<i64>, code, simd);
        let rows = query.fetch_all(&mut self.connection).await.map_err(self.at("reading"))?;
        Ok(rows.into_iter().collect())
    }

    /// The checkpoint from which an attempt resumes: its own, or that of a trial that has trained the same body further, whose
    /// steps it takes over; at most `pause` steps. `None`: it starts from the beginning.
    /// Fails if its own checkpoint is damaged or of another version, and no other trial has a usable one.
    pub async fn resume_checkpoint(
        &mut self,
        hash: &str,
        attempt: u32,
        pause: Option<u32>,
    ) -> Result<Option<Checkpoint>> {
        let own = usable(self.checkpoint(hash).await)?;
        let behind = own.as_ref().ok().and_then(Option::as_ref).map_or(0, |own| own.step);
        let (id, at) = (self.id(hash)?, self.at("reading the body of another trial from"));
        let sql = format!(
            "SELECT m.id, m.hash, m.reached, coalesce(m.best_step, 0) FROM ({TRAINERS}) m
             WHERE m.id <> ?1 AND m.reached > ?4 AND m.reached <= ?5 ORDER BY m.reached DESC, m.id"
        );
        let (code, simd) = self.provenance.as_ref().map(|made| (&made.code, &made.simd)).unzip();
        let query =
            bound!(sqlx::query_as(AssertSqlSafe(sql)); id, code, simd, behind, pause.unwrap_or(u32::MAX));
        let trainers: Vec<Trainer> = query.fetch_all(&mut self.connection).await.map_err(&at)?;
        if trainers.is_empty() {
            return own;
        }
        let by_network = !self.optimise(id).await.map_err(&at)?.linear();
        let mut found = None;
        for trainer in trainers {
            match self.body_of(&trainer, by_network).await? {
                Ok(Some(body)) => {
                    found = Some((trainer, body));
                    break;
                }
                Ok(None) => {}
                Err(why) => self.log(hash, attempt, LogLevel::Warn, &why.to_string()).await?,
            }
        }
        // without a usable body of another trial, this trial uses its own checkpoint
        let Some(((other, name, reached, _), body)) = found else { return own };
        if let Err(why) = own {
            self.log(hash, attempt, LogLevel::Warn, &why.to_string()).await?;
        }
        self.in_transaction("taking over a body in", async |store| {
            store.take_over_steps(other, reached, id).await?;
            store.take_over_designs(other, id).await?;
            store.insert_checkpoint(id, &body).await?;
            // counts as work of this attempt, by its own code
            store.count_progress(id, attempt, 0, 1).await
        })
        .await?;
        let said = format!("resumes after step {reached} of trial {name}, which trains the same body");
        self.log(hash, attempt, LogLevel::Info, &said).await?;
        Ok(Some(body))
    }

    /// The body that a trial has trained: from its checkpoint, or from its result if it is done. The inner error: the stored data
    /// cannot be used.
    async fn body_of(&mut self, trainer: &Trainer, by_network: bool) -> Result<Result<Option<Checkpoint>>> {
        let (id, name, reached, best_step) = trainer;
        match usable(self.checkpoint(name).await)? {
            Ok(None) => {}
            stored => return Ok(stored.map(|stored| stored.map(|there| there.of_body(by_network)))),
        }
        let sql = "SELECT bytes, coalesce(digest, x'') FROM artifact WHERE trial_id = ? AND name = 'alpha_optimised'";
        let stored = sqlx::query_as(sql).bind(id).fetch_optional(&mut self.connection).await;
        let stored: Option<(Vec<u8>, Vec<u8>)> =
            stored.map_err(self.at("reading the body of another trial from"))?;
        let Some((bytes, checksum)) = stored else { return Ok(Ok(None)) };
        let checked = check(name, "array alpha_optimised", &bytes, &checksum);
        let best = npy_values(&bytes).ok();
        Ok(checked.map(|()| best.map(|best| Checkpoint::after_training(*reached, best, *best_step))))
    }

    /// Copies the steps of another trial before step `before` that this trial lacks, with attempt 0.
    async fn take_over_steps(&mut self, other: i64, before: u32, id: i64) -> sqlx::Result<()> {
        let columns = "SELECT group_concat(name, ', ') FROM pragma_table_info('step')
            WHERE name NOT IN ('trial_id', 'attempt', 'recorded_at')";
        let columns: String = sqlx::query_scalar(columns).fetch_one(&mut self.connection).await?;
        // Safe: contains only names of our own schema.
        let sql = format!(
            "INSERT OR IGNORE INTO step (trial_id, attempt, recorded_at, {columns})
             SELECT ?, 0, strftime('%Y-%m-%dT%H:%M:%fZ'), {columns} FROM step WHERE trial_id = ? AND step < ?"
        );
        run!(self, AssertSqlSafe(sql); id, other, before)?;
        Ok(())
    }

    /// Progress of each open trial that was attempted, by hash.
    pub async fn attempted(&mut self) -> Result<HashMap<String, PriorProgress>> {
        let sql = "SELECT t.hash, max(a.number), (SELECT c.step FROM checkpoint c WHERE c.trial_id = t.id)
             FROM trial t JOIN attempt a ON a.trial_id = t.id
             WHERE t.state IN ('pending', 'running') GROUP BY t.id";
        let progress = |(hash, attempts, steps): (String, _, _)| (hash, PriorProgress { attempts, steps });
        let rows = sqlx::query_as(sql).fetch_all(&mut self.connection).await.map_err(self.at("reading"))?;
        Ok(rows.into_iter().map(progress).collect())
    }
}
