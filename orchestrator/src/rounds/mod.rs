//! Sweeps whose trials depend on earlier results: rounds of trials for the questions of [until], or for the search of [goal].
//! [`Runs`] is implemented by whatever runs trials: the workers of this process, or shards.

mod search;
pub mod space;

use std::path::Path;

use crate::analysis::until::{self, KnownLooks, TrialErrors};
use crate::engine::RerunPolicy;
use crate::plan::{Plan, PlannedTrial};
use crate::scheduler::RunOutcome;
use crate::store::StoreError;

pub use search::search;

/// Runs trials round by round: with workers of this process, or with shards.
pub trait Runs {
    /// Error of a round.
    type Error: From<StoreError>;

    /// All trials of the sweep.
    fn plan(&self) -> &Plan;

    /// Database with the results of earlier rounds.
    fn database(&self) -> &Path;

    /// Number of trials that run at the same time.
    fn workers(&self) -> u32;

    /// Results of the trials so far.
    fn trial_results(&mut self) -> impl Future<Output = Result<Vec<TrialErrors>, Self::Error>>;

    /// Reopens finished trials among these, before a search reads their results.
    fn reopen(
        &mut self,
        hashes: &[&str],
        again: RerunPolicy,
    ) -> impl Future<Output = Result<(), Self::Error>>;

    /// Runs the open trials among these; `None` if there are none.
    fn run(
        &mut self,
        trials: &[PlannedTrial],
        again: RerunPolicy,
    ) -> impl Future<Output = Result<Option<RunOutcome>, Self::Error>>;

    /// Whether a stop was requested while the last open trial of a round ended.
    fn is_stopping(&self) -> bool;

    /// Prints a line for people.
    fn say(&self, line: &str);
}

/// Runs rounds of trials until the sweep's questions are answered.
///
/// # Errors
/// If a round cannot be run.
///
/// # Panics
/// If the sweep has no [until].
pub async fn rounds<R: Runs>(mut round: R, mut again: RerunPolicy) -> Result<Option<RunOutcome>, R::Error> {
    let (mut said, mut looks) = (Vec::new(), KnownLooks::default());
    loop {
        let found = round.trial_results().await?;
        let plan = round.plan();
        let questions = plan.spec.until.as_ref().expect("the sweep has questions");
        let decision = until::of_plan(questions, &plan.trials, &found, round.workers(), &mut looks);
        let wanted: Vec<PlannedTrial> =
            decision.wanted.iter().map(|&place| plan.trials[place].clone()).collect();
        for line in decision.standings.iter().map(ToString::to_string) {
            if !said.contains(&line) {
                round.say(&line);
                said.push(line);
            }
        }
        match round.run(&wanted, again).await? {
            Some(RunOutcome::Complete) if round.is_stopping() => return Ok(Some(stopped_between(&round))),
            // trials of later rounds may also have results of other code
            Some(RunOutcome::Complete) => {
                again = RerunPolicy { other_code: again.other_code, ..RerunPolicy::default() }
            }
            None if !decision.is_settled() => {
                round.say("some questions are still open: all trials that [until] allows have been run");
                return Ok(None);
            }
            ended => return Ok(ended),
        }
    }
}

/// Reports a stop between two rounds, when no trial is open.
fn stopped_between(round: &impl Runs) -> RunOutcome {
    round.say("stopped between two rounds; the same command resumes the run");
    RunOutcome::Interrupted
}
