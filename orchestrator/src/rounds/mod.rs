//! Sweeps whose trials depend on earlier results: rounds of trials that answer the questions of [until], or that a search for the
//! design of [goal] asks for. Whoever runs trials implements [`Runs`]: the workers of this process, or shards.

mod search;

use std::path::Path;

use metasense_schemas::record::Found;

use crate::engine::Again;
use crate::plan::{Plan, Trial};
use crate::scheduler::Outcome;
use crate::store::StoreError;

pub use search::search;

/// Who runs trials, round by round: the workers of this process, or shards.
pub trait Runs {
    /// Why a round could not be run.
    type Error: From<StoreError>;

    /// All trials of the sweep.
    fn plan(&self) -> &Plan;

    /// What the results of earlier rounds are in.
    fn database(&self) -> &Path;

    /// Trials at a time.
    fn workers(&self) -> u32;

    /// What trials have come to.
    fn found(&mut self) -> impl Future<Output = Result<Vec<Found>, Self::Error>>;

    /// Opens settled ones of these trials before a search looks at what they have come to.
    fn reopen(&mut self, hashes: &[&str], again: Again) -> impl Future<Output = Result<(), Self::Error>>;

    /// Runs those of some trials that are open; `None` where there are none.
    fn run(
        &mut self,
        trials: &[Trial],
        again: Again,
    ) -> impl Future<Output = Result<Option<Outcome>, Self::Error>>;

    /// Whether somebody has asked for the end while the last open trial of a round came to its own.
    fn is_stopping(&self) -> bool;

    /// Tells people.
    fn say(&self, line: &str);
}

/// Runs the trials that the sweep's questions need, until they are settled.
///
/// # Errors
/// If a round cannot be run.
///
/// # Panics
/// If the sweep has no questions.
pub async fn rounds<R: Runs>(mut round: R, mut again: Again) -> Result<Option<Outcome>, R::Error> {
    let mut said = Vec::new();
    loop {
        let found = round.found().await?;
        let (decision, wanted) = round.plan().decide(&found, round.workers()).expect("it has questions");
        for line in decision.standings.iter().map(ToString::to_string) {
            if !said.contains(&line) {
                round.say(&line);
                said.push(line);
            }
        }
        match round.run(&wanted, again).await? {
            Some(Outcome::Complete) if round.is_stopping() => return Ok(Some(stopped_between(&round))),
            // what later rounds want may be by other code, too
            Some(Outcome::Complete) => again = Again { other_code: again.other_code, ..Again::default() },
            None if !decision.is_settled() => {
                round.say("some questions are still open: all trials that [until] allows have been run");
                return Ok(None);
            }
            ended => return Ok(ended),
        }
    }
}

/// Somebody has asked for the end, and nothing is open.
fn stopped_between(round: &impl Runs) -> Outcome {
    round.say("stopped between two rounds; the same command resumes the run");
    Outcome::Interrupted
}
