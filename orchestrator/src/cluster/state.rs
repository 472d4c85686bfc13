//! How the shards of a folder are: by the databases that they have handed in, and by the queue.

use std::collections::HashMap;
use std::path::Path;
use std::time::SystemTime;

use super::Shard;
use super::home::attempts;
use crate::store::ask_unchanging;

/// A shard.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Which one.
    pub shard: Shard,
    /// `complete`, `partial` or `nothing` handed in, or what is wrong with it; what the queue says goes before.
    pub state: String,
    /// Trials, those done, and those that have failed, in what it has handed in.
    pub trials: Option<[u32; 3]>,
    /// Estimated and actual time of its last run (s), where it ran, and how that ended.
    pub run: Option<(f64, Option<f64>, String, Option<String>)>,
    /// Since it was handed in (s).
    pub age: Option<f64>,
}

/// The shards of a folder. `queued`: what the scheduler says of each.
pub async fn states(folder: &Path, shards: u32, queued: &HashMap<u32, String>) -> Vec<State> {
    let mut states = Vec::with_capacity(shards as usize);
    let mut attempts = attempts(folder);
    for shard in (1..=shards).filter_map(|index| Shard::new(index, shards)) {
        let mut state = State { shard, state: "nothing".into(), trials: None, run: None, age: None };
        let settled = |state: &State| state.trials.map(|[_, done, failed]| done + failed);
        for file in attempts.remove(&shard).unwrap_or_default() {
            let this = of_try(&file, shard).await;
            let age = [state.age, this.age].into_iter().flatten().reduce(f64::min);
            // The one that has come farthest; of several, the last.
            if settled(&this) >= settled(&state) {
                state = this;
            }
            state.age = age;
        }
        // A shard that has handed its last database in may still be in the queue for a moment.
        if let Some(queued) = queued.get(&shard.index()).filter(|_| state.state != "complete") {
            state.state.clone_from(queued);
        }
        states.push(state);
    }
    states
}

/// A shard by one of its files.
async fn of_try(file: &Path, shard: Shard) -> State {
    let mut state = State { shard, state: "nothing".into(), trials: None, run: None, age: None };
    let written = file.metadata().and_then(|m| m.modified()).ok();
    state.age = written.and_then(|at| SystemTime::now().duration_since(at).ok()).map(|age| age.as_secs_f64());
    match read(file, &mut state).await {
        Ok([trials, done, failed]) => {
            state.state = if done + failed == trials { "complete" } else { "partial" }.into();
            state.trials = Some([trials, done, failed]);
        }
        Err(error) => state.state = format!("unreadable: {error}"),
    }
    state
}

async fn read(file: &Path, state: &mut State) -> sqlx::Result<[u32; 3]> {
    let trials =
        "SELECT count(*), coalesce(sum(state = 'done'), 0), coalesce(sum(state = 'failed'), 0) FROM trial";
    let run = "SELECT estimated_seconds, seconds, host || coalesce(', ' || job, ''), outcome FROM v_run
        ORDER BY started_at DESC LIMIT 1";
    ask_unchanging(file, async |db| {
        let trials: (u32, u32, u32) = sqlx::query_as(trials).fetch_one(&mut *db).await?;
        state.run = sqlx::query_as(run).fetch_optional(db).await?;
        Ok(trials.into())
    })
    .await
}
