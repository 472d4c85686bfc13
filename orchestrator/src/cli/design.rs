//! `design`: the cheapest body, sensors and brain that meet a requirement.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use metasense_schemas::spec::TrialSpec;
use metasense_worker::FAILED;
use serde_json::Value;

use super::named::Spec;
use super::run::{How, Round, Running, run};
use super::{Error, log, print_rows};
use crate::analysis::goal::{Candidate, Class, Decision, LEVELS, Search, Stage, Work};
use crate::analysis::setting::flatten;
use crate::engine::{Again, Signals};
use crate::exit::Exit;
use crate::look::{Table, number};
use crate::plan::goal::{Place, Space, on_fresh_seed, rungs};
use crate::plan::{Plan, Trial, counted};
use crate::scheduler::Outcome;
use crate::store::{Reader, Standing, StoreError};

/// Searches a sweep for the cheapest design that meets the requirement in its [goal]
///
/// Trials are begun, paused and gone on with as their prospects say; most of the sweep is never run. The design that is chosen
/// stands on fresh seeds. After Ctrl-C or `kill -9` the same command goes on, to the same design.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    spec: Spec,
    #[command(flatten)]
    running: Running,
}

/// Why the spec is not read again during a search.
const FIXED: &str = "[goal] decides which trials are run: stop, the same command goes on by the edited spec";

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    args.running.simd.choose()?;
    let mut signals = Signals::new()?;
    let plan = args.spec.plan()?;
    let space = Space::new(&plan)?;
    for out in &space.left_out {
        say!("{} leaves out {}; the least one needs {}", out.key, counted(out.trials, "trial"), out.least);
    }
    let db: PathBuf = args.running.db.clone().unwrap_or_else(|| plan.default_database());
    let how = How { spec: &args.spec, running: &args.running, shard: None, fixed: Some(FIXED) };
    let drive = async |round: Round<'_>, again| search(round, &space, again).await;
    let (outcome, plan) = run(plan, &how, &db, &log::path(&db), &mut signals, drive).await?;
    let known = Known::read(&db, &space, &plan, &mut HashMap::new()).await?;
    let decision = begun(&space).follow(&known.candidates);
    print_rows(&table(&plan, &space, &decision), args.running.format)?;
    say_verdict(&db, &plan, &space, &decision, &known);
    Ok(match (outcome, decision.chosen) {
        (Outcome::Interrupted, _) => Exit::Interrupted,
        (Outcome::Unfit(_), _) => Exit::Unfit,
        (_, None) => Exit::Failed,
        _ => Exit::Done,
    })
}

/// Bodies with their sensors, by the hash of the trial that has trained them.
type Bodies = HashMap<String, (TrialSpec, Vec<f64>)>;

/// What is stored of the space.
struct Known {
    candidates: Vec<Candidate>,
    /// CPU seconds of all trials.
    seconds: f64,
    /// CPU seconds that the whole grid would take, as estimated.
    whole: f64,
}

impl Known {
    async fn read(db: &Path, space: &Space, plan: &Plan, bodies: &mut Bodies) -> Result<Self, Error> {
        Reader::asked(db, async |reader| {
            let standings = reader.standings().await?;
            let mut candidates = Vec::with_capacity(space.places.len());
            for place in &space.places {
                let trial = &plan.trials[place.trial];
                let mut candidate = place.candidate.clone();
                if let Some(standing) = standings.get(&trial.hash) {
                    candidate = known(space, place, trial, standing);
                    if candidate.reached.len() == LEVELS {
                        body(bodies, reader, &trial.hash).await?;
                        candidate.fresh = fresh(space, plan, place, &bodies[&trial.hash], &standings);
                    }
                }
                candidates.push(candidate);
            }
            let whole = plan.trials.iter().map(|trial| trial.cost).sum();
            Ok(Self { candidates, seconds: reader.spent().await?, whole })
        })
        .await
    }
}

/// The error that counts of what is stored of a trial (%).
fn error(space: &Space, place: &Place, standing: &Standing) -> Option<f64> {
    let reader = place.reader.map(|by| (by.name().to_owned(), by.records().unwrap_or(0) as u32));
    let error = standing.error(reader.as_ref().zip(space.goal.quantile));
    error.filter(|e| e.is_finite() && *e > 0.0)
}

/// How far a trial has come, rung by rung.
fn known(space: &Space, place: &Place, trial: &Trial, standing: &Standing) -> Candidate {
    let mut candidate = place.candidate.clone();
    let done = standing.state == "done";
    let result = if done { error(space, place, standing) } else { None };
    for rung in rungs(&trial.spec) {
        let told = match rung {
            Some(steps) => standing.after(steps),
            // of so few steps the result is the next level
            None => done.then_some(None),
        };
        let Some(told) = told else { break };
        candidate.reached.push(told);
    }
    if candidate.reached.len() + 1 == LEVELS && result.is_some() {
        candidate.reached.push(result);
    }
    candidate.failed = standing.state == "failed" || done && result.is_none();
    candidate
}

/// Takes the body of a trial that is done.
async fn body(bodies: &mut Bodies, reader: &mut Reader, hash: &str) -> Result<(), StoreError> {
    if !bodies.contains_key(hash)
        && let Some(stored) = reader.stored(hash).await?
    {
        let ([_, spec], [_, design]) = (stored.specs, stored.designs);
        bodies.insert(hash.to_owned(), (spec, design));
    }
    Ok(())
}

/// Errors (%) of a body on fresh seeds, as many in a row as are known.
fn fresh(
    space: &Space,
    plan: &Plan,
    place: &Place,
    (spec, design): &(TrialSpec, Vec<f64>),
    standings: &HashMap<String, Standing>,
) -> Vec<f64> {
    let told = (0..2 * space.goal.fresh).map_while(|n| {
        let judged = on_fresh_seed(plan, &plan.trials[place.trial], spec, design, n);
        let standing = standings.get(&judged.hash)?;
        match standing.state.as_str() {
            "done" => Some(error(space, place, standing).unwrap_or(FAILED)),
            "failed" => Some(FAILED),
            _ => None,
        }
    });
    told.collect()
}

/// The search at its beginning.
fn begun(space: &Space) -> Search {
    Search::new(&space.goal, space.places.iter().map(|place| place.candidate.clone()))
}

/// Runs what the search asks for, until it is over.
async fn search(mut round: Round<'_>, space: &Space, mut again: Again) -> Result<Option<Outcome>, Error> {
    let (mut bodies, mut search) = (Bodies::new(), begun(space));
    loop {
        let path = round.store.path().to_owned();
        let known = Known::read(&path, space, round.plan, &mut bodies).await?;
        let decision = search.follow(&known.candidates);
        if decision.work.is_empty() {
            return Ok(None);
        }
        if space.goal.hours.is_some_and(|hours| known.seconds >= 3600.0 * hours) {
            say!("the search is not over: goal.hours are spent");
            return Ok(None);
        }
        say!("{}", intent(space, &decision));
        let trials: Vec<Trial> = decision
            .work
            .iter()
            .flat_map(|&(i, work)| ordered(space, round.plan, &bodies, i, work))
            .collect();
        match round.run(&trials, again).await? {
            Some(Outcome::Complete) => again = Again::default(),
            ended => return Ok(ended),
        }
    }
}

/// The trials that some work is.
fn ordered(space: &Space, plan: &Plan, bodies: &Bodies, candidate: usize, work: Work) -> Vec<Trial> {
    let trial = &plan.trials[space.places[candidate].trial];
    match work {
        Work::Level(level) => {
            let pause = rungs(&trial.spec).get(level).copied().flatten();
            vec![Trial { pause, ..trial.clone() }]
        }
        Work::Fresh(seeds) => {
            let (spec, design) = &bodies[&trial.hash];
            (0..seeds).map(|n| on_fresh_seed(plan, trial, spec, design, n)).collect()
        }
    }
}

/// What is done next, in a line.
fn intent(space: &Space, decision: &Decision) -> String {
    let count = |of: fn(&Work) -> bool| decision.work.iter().filter(|(_, work)| of(work)).count();
    let [looks, trains, judges] = [
        count(|w| matches!(w, Work::Level(level) if level + 1 < LEVELS)),
        count(|w| matches!(w, Work::Level(level) if level + 1 == LEVELS)),
        count(|w| matches!(w, Work::Fresh(_))),
    ];
    let parts = [(looks, "a look at"), (trains, "to the end:"), (judges, "on fresh seeds:")];
    let parts: Vec<String> = parts
        .iter()
        .filter(|(n, _)| *n > 0)
        .map(|(n, what)| format!("{what} {n} {}", if *n == 1 { "body" } else { "bodies" }))
        .collect();
    let open = decision.classes.iter().map(|class| class.any).find(|any| *any > 0.0).unwrap_or(0.0);
    format!(
        "{} (the cheapest that may still meet {} %: {:.0} % likely)",
        parts.join(", "),
        number(space.goal.error),
        100.0 * open
    )
}

/// How all classes of equal cost stand.
fn table(plan: &Plan, space: &Space, decision: &Decision) -> Table {
    let columns = [
        "M",
        "operations",
        "units",
        "error",
        "keeps_to",
        "meets",
        "any_meets",
        "stage",
        "begun",
        "candidates",
        "chosen",
        "setting",
        "hash",
    ];
    let row = |class: &Class| -> Vec<Value> {
        let place = &space.places[class.best];
        let trial = &plan.trials[place.trial];
        let stage = match class.stage {
            Stage::Predicted => "predicted".to_owned(),
            Stage::Looked => "looked at".to_owned(),
            Stage::Trained => "trained".to_owned(),
            Stage::Judged(seeds) => format!("judged on {seeds} seeds"),
        };
        vec![
            trial.spec.point.sensors.into(),
            place.demands.map(|d| d.operations).into(),
            trial.units.into(),
            class.error[0].into(),
            class.error[1].into(),
            class.meets.into(),
            class.any.into(),
            stage.into(),
            class.candidates[1].into(),
            class.candidates[0].into(),
            (decision.chosen == Some(class.best)).into(),
            setting(space, &trial.spec).into(),
            trial.hash.clone().into(),
        ]
    };
    Table {
        columns: columns.iter().map(|name| (*name).to_owned()).collect(),
        rows: decision.classes.iter().map(row).collect(),
    }
}

/// In what a trial differs from others of the space.
fn setting(space: &Space, spec: &TrialSpec) -> String {
    let leaves = flatten(&serde_json::to_value(spec).expect("a trial is JSON"));
    let told = space.axes.iter().filter(|path| *path != "point.sensors");
    let told = told.filter_map(|path| Some(format!("{path} = {}", leaves.get(path.as_str())?)));
    told.collect::<Vec<_>>().join(", ")
}

fn say_verdict(db: &Path, plan: &Plan, space: &Space, decision: &Decision, known: &Known) {
    let (goal, db) = (&space.goal, db.display());
    let part = 100.0 * known.seconds / known.whole.max(f64::MIN_POSITIVE);
    say!(
        "{:.0} CPU s, {part:.0} % of what the whole sweep is estimated to take{}",
        known.seconds,
        decision
            .kinship
            .map_or(String::new(), |r| format!("; a first look tells a result with correlation {r:.2}"))
    );
    if let Some(chosen) = decision.chosen {
        let trial = &plan.trials[space.places[chosen].trial];
        let class =
            decision.classes.iter().find(|class| class.best == chosen).expect("it is the best of its class");
        say!(
            "the cheapest design that meets {} %: {}; with {:.0} % probability on a further seed",
            number(goal.error),
            trial.hash,
            100.0 * class.meets
        );
        for format in ["stl --out mould.stl", "c --out brain.c"] {
            say!("  metasense export {db} {} --format {format}", trial.hash);
        }
        return;
    }
    if !decision.work.is_empty() {
        say!("the search is not over; the same command goes on");
        return;
    }
    say!(
        "no design of the sweep meets {} % with {:.0} % probability",
        number(goal.error),
        100.0 * goal.confidence
    );
    let nearest = decision.classes.iter().min_by(|a, b| a.error[1].total_cmp(&b.error[1]));
    if let Some(nearest) = nearest {
        let trial = &plan.trials[space.places[nearest.best].trial];
        say!("what would have to be relaxed: goal.error to {} % ({})", number(nearest.error[1]), trial.hash);
    }
    for out in &space.left_out {
        say!("  or {} to {}, which lets in up to {} more", out.key, out.least, counted(out.trials, "trial"));
    }
}
