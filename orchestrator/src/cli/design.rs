//! `design`: the cheapest body, sensors and brain that meet a requirement.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::named::Spec;
use super::run::{How, Running, Runs, run, stopped_between};
use super::{Error, Format, log, print_rows};
use crate::analysis::goal::{Decision, LEVELS, Work, confirming, fresh_after, most_fresh};
use crate::engine::{Again, Signals};
use crate::exit::Exit;
use crate::look::number;
use crate::plan::goal::{Space, on_fresh_seeds, rungs};
use crate::plan::{Plan, Trial, counted};
use crate::report::search::{Bodies, COLUMNS, Known, Sought, begun};
use crate::scheduler::Outcome;
use crate::store::Reader;
use tokio::sync::Notify;

/// Searches a sweep for the cheapest design that meets the requirement in its [goal]
///
/// The search trains the candidates that are likeliest to meet the requirement and pauses the others, so that most of the sweep is
/// never run. The chosen design is confirmed on fresh seeds that had no part in its choice. After Ctrl-C or `kill -9` the same command
/// resumes the search and ends at the same design. A legend below the table explains its columns.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    spec: Spec,
    #[command(flatten)]
    running: Running,
}

/// Why the spec is not read again during a search.
const FIXED: &str = "[goal] decides which trials are run: stop the search; the same command then resumes it with the edited spec";

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    args.running.simd.choose()?;
    let mut signals = Signals::new()?;
    let plan = args.spec.plan()?;
    let space = space(&plan)?;
    let db: PathBuf = args.running.db.clone().unwrap_or_else(|| plan.default_database());
    let asked = Notify::new();
    let how =
        How { spec: &args.spec, running: &args.running, shard: None, fixed: Some(FIXED), asked: &asked };
    let (outcome, plan) = run(plan, &how, &db, &log::path(&db)?, &mut signals, async |round, again| {
        search(round, &space, again).await
    })
    .await?;
    end(&db, plan, space, args.running.format, outcome).await
}

/// What is searched, and what is not.
pub(super) fn space(plan: &Plan) -> Result<Space, Error> {
    let space = Space::new(plan)?;
    for out in &space.left_out {
        say!("{} excludes {}; the smallest value is {}", out.key, counted(out.trials, "trial"), out.least);
    }
    Ok(space)
}

/// The table and the words at the end.
pub(super) async fn end(
    db: &Path,
    plan: Plan,
    space: Space,
    format: Format,
    outcome: Outcome,
) -> Result<Exit, Error> {
    let found = Reader::asked(db, async |reader| Sought::of(reader, plan, space).await).await?;
    print_rows(&found.table(), format)?;
    if format == Format::Table {
        COLUMNS.iter().for_each(|line| say!("  {line}"));
    }
    found.verdict().iter().for_each(|line| say!("{line}"));
    let chosen = found.chosen();
    if let Some((trial, _)) = chosen {
        let reader = if found.reads_all_casts() { " --reader casts" } else { "" };
        say!("  metasense export {} {} --format device{reader} --out device", db.display(), trial.hash);
    }
    Ok(match (outcome, chosen) {
        (Outcome::Interrupted, _) => Exit::Interrupted,
        (Outcome::Unfit(_), _) => Exit::Unfit,
        (_, None) => Exit::Failed,
        _ => Exit::Done,
    })
}

/// Runs what the search asks for, until it is over.
pub(super) async fn search(
    mut round: impl Runs,
    space: &Space,
    again: Again,
) -> Result<Option<Outcome>, Error> {
    let (mut bodies, mut search) = (Bodies::new(), begun(space));
    let own: Vec<String> = round.plan().trials.iter().map(|trial| trial.hash.clone()).collect();
    round.reopen(&own.iter().map(String::as_str).collect::<Vec<_>>(), again).await?;
    let mut opened = HashSet::new();
    loop {
        let known = Reader::asked(round.database(), async |reader| {
            Known::of(reader, space, round.plan(), &mut bodies).await
        })
        .await?;
        // what has judged a body is opened once the body is there, each once
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
            say!("the search is not finished: goal.hours are spent");
            return Ok(None);
        }
        say!("{}", intent(space, &decision));
        let trials: Vec<Trial> = decision
            .work
            .iter()
            .flat_map(|&(i, work)| ordered(space, round.plan(), &bodies, i, work))
            .collect();
        match round.run(&trials, Again::default()).await? {
            Some(Outcome::Complete) if round.is_stopping() => return Ok(Some(stopped_between())),
            Some(Outcome::Complete) => {}
            ended => return Ok(ended),
        }
    }
}

/// The trials that judge the bodies that are there, or may.
fn fresh(space: &Space, plan: &Plan, bodies: &Bodies) -> Vec<String> {
    let trained = space.places.iter().filter_map(|place| {
        let trial = &plan.trials[place.trial];
        bodies.get(&trial.hash).map(|body| on_fresh_seeds(plan, trial, body, most_fresh(&space.goal)))
    });
    trained.flatten().map(|judge| judge.hash).collect()
}

/// The trials that some work is.
fn ordered(space: &Space, plan: &Plan, bodies: &Bodies, candidate: usize, work: Work) -> Vec<Trial> {
    let trial = &plan.trials[space.places[candidate].trial];
    match work {
        Work::Level(level) => {
            let pause = rungs(&trial.spec).get(level).copied().flatten();
            vec![Trial { pause, ..trial.clone() }]
        }
        Work::Screen | Work::Confirm(_) => {
            let seeds = fresh_after(&space.goal, work);
            on_fresh_seeds(plan, trial, &bodies[&trial.hash], seeds).collect()
        }
    }
}

/// What is done next, in a line.
fn intent(space: &Space, decision: &Decision) -> String {
    let count = |of: fn(&Work) -> bool| decision.work.iter().filter(|(_, work)| of(work)).count();
    let goal = &space.goal;
    let parts = [
        (count(|w| matches!(w, Work::Level(level) if level + 1 < LEVELS)), "train in part".to_owned()),
        (count(|w| matches!(w, Work::Level(level) if level + 1 == LEVELS)), "train to the end".to_owned()),
        (count(|w| *w == Work::Screen), format!("screen on {} fresh seeds", goal.fresh)),
        (count(|w| matches!(w, Work::Confirm(_))), format!("confirm on {} other seeds", confirming(goal))),
    ];
    let parts: Vec<String> = parts
        .iter()
        .filter(|(n, _)| *n > 0)
        .map(|(n, what)| format!("{what}: {n} {}", if *n == 1 { "body" } else { "bodies" }))
        .collect();
    format!(
        "{} (probability that the cheapest class of these has a design for {} %: {:.0} %)",
        parts.join("; "),
        number(goal.error),
        100.0 * decision.open
    )
}
