//! The search for the design of [goal], round by round.

use std::collections::HashSet;

use super::space::{Space, on_fresh_seeds, rungs};
use super::{Runs, stopped_between};
use crate::analysis::goal::{Decision, LEVELS, Work, confirming, fresh_after, most_fresh};
use crate::engine::RerunPolicy;
use crate::look::number;
use crate::plan::{Plan, PlannedTrial};
use crate::reader::Reader;
use crate::report::search::{Bodies, SearchData, begun};
use crate::scheduler::RunOutcome;

/// Runs the trials that the search requests until it ends.
///
/// # Errors
/// If a round cannot be run.
pub async fn search<R: Runs>(
    mut round: R,
    space: &Space,
    again: RerunPolicy,
) -> Result<Option<RunOutcome>, R::Error> {
    let (mut bodies, mut search) = (Bodies::new(), begun(space));
    let own: Vec<String> = round.plan().trials.iter().map(|trial| trial.hash.clone()).collect();
    round.reopen(&own.iter().map(String::as_str).collect::<Vec<_>>(), again).await?;
    let mut opened = HashSet::new();
    loop {
        let known = Reader::with_reader(round.database(), async |reader| {
            SearchData::of(reader, space, round.plan(), &mut bodies).await
        })
        .await?;
        // trials that evaluate a body are reopened once each, when the body exists
        if again.failed || again.other_code {
            let mut fresh = fresh(space, round.plan(), &bodies);
            fresh.retain(|hash| opened.insert(hash.clone()));
            if !fresh.is_empty() {
                round.reopen(&fresh.iter().map(String::as_str).collect::<Vec<_>>(), again).await?;
                continue;
            }
        }
        let decision = search.follow(&known.candidates);
        if decision.work.is_empty() {
            return Ok(None);
        }
        if space.goal.hours.is_some_and(|hours| known.seconds >= 3600.0 * hours) {
            round.say("the search stopped early: goal.hours is used up");
            return Ok(None);
        }
        round.say(&intent(space, &decision));
        let work = decision.work.iter();
        let trials = work.flat_map(|&(i, work)| ordered(space, round.plan(), &bodies, i, work));
        let trials: Vec<PlannedTrial> = trials.collect();
        match round.run(&trials, RerunPolicy::default()).await? {
            Some(RunOutcome::Complete) if round.is_stopping() => return Ok(Some(stopped_between(&round))),
            Some(RunOutcome::Complete) => {}
            ended => return Ok(ended),
        }
    }
}

/// Hashes of the trials that may evaluate the existing bodies on fresh seeds.
fn fresh(space: &Space, plan: &Plan, bodies: &Bodies) -> Vec<String> {
    let trained = space.places.iter().filter_map(|place| {
        let trial = &plan.trials[place.trial];
        bodies.get(&trial.hash).map(|body| on_fresh_seeds(plan, trial, body, most_fresh(&space.goal)))
    });
    trained.flatten().map(|judge| judge.hash).collect()
}

/// The trials of a piece of work.
fn ordered(space: &Space, plan: &Plan, bodies: &Bodies, candidate: usize, work: Work) -> Vec<PlannedTrial> {
    let trial = &plan.trials[space.places[candidate].trial];
    match work {
        Work::Level(level) => {
            let pause = rungs(&trial.spec).get(level).copied().flatten();
            vec![PlannedTrial { pause, ..trial.clone() }]
        }
        Work::Screen | Work::Confirm(_) => {
            let seeds = fresh_after(&space.goal, work);
            on_fresh_seeds(plan, trial, &bodies[&trial.hash], seeds).collect()
        }
    }
}

/// One line that describes the next round.
fn intent(space: &Space, decision: &Decision) -> String {
    let count = |of: fn(&Work) -> bool| decision.work.iter().filter(|(_, work)| of(work)).count();
    let goal = &space.goal;
    let parts = [
        (count(|w| matches!(w, Work::Level(level) if level + 1 < LEVELS)), "train partially".to_owned()),
        (count(|w| matches!(w, Work::Level(level) if level + 1 == LEVELS)), "train to the end".to_owned()),
        (count(|w| *w == Work::Screen), format!("screen on {} fresh seeds", goal.fresh)),
        (count(|w| matches!(w, Work::Confirm(_))), format!("confirm on {} other seeds", confirming(goal))),
    ];
    let parts = parts.iter().filter(|(n, _)| *n > 0);
    let parts = parts.map(|(n, what)| format!("{what}: {n} {}", if *n == 1 { "body" } else { "bodies" }));
    format!(
        "{} (probability that the cheapest class among them contains a design with an error of at most {} %: {:.0} %)",
        parts.collect::<Vec<_>>().join("; "),
        number(goal.error),
        100.0 * decision.open
    )
}
