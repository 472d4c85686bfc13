//! State of a search for a design, from its database: stages of candidates, classes of equal cost, a figure.

use std::collections::HashMap;

use metasense_lab::{cost, tasks};
use metasense_schemas::spec::{Goal, GoalReader, GoalReaderName, TrialSpec};
use metasense_worker::FAILED;

use super::StoredSweep;
use crate::analysis::goal::{
    Candidate, CandidateStage, Class, Decision, DesignSearch, LEVELS, confirming, most_fresh,
};
use crate::analysis::setting::flatten;
use crate::cell::brief;
use crate::look::{Answer, Axis, Figure, Picture, Plot, Scale, Table, legend, number, row};
use crate::plan::{Plan, PlannedTrial, counted};
use crate::reader::{Reader, TrialProgress};
use crate::rounds::space::{SearchTrial, Space, on_fresh_seeds, rungs};
use crate::store::StoreError;

/// The state of a search.
#[derive(Debug)]
pub struct SearchState {
    plan: Plan,
    space: Space,
    decision: Decision,
    classes: Vec<Class>,
    /// Number of failed candidates.
    failed: usize,
    /// CPU seconds of the search's trials, and estimated CPU seconds of the whole sweep at the pace of finished trials.
    seconds: [f64; 2],
}

/// Classes of marks by the stage of a class's best candidate, with legend texts.
const STAGES: [(&str, &str); 4] = [
    ("initial", "predicted, not started"),
    ("fourth", "partly trained"),
    ("front", "trained"),
    ("optimised", "evaluated on fresh seeds"),
];

/// Legend of the table's columns, one line each.
pub const COLUMNS: [&str; 6] = [
    "one row per class of candidates of equal cost, the cheapest first; hash, setting, stage and errors are those of its best candidate",
    "error: expected error on a further seed (%), from its fresh seeds or predicted from other trials; with goal.tasks, goal.error times \
     the greatest ratio of an error to its requirement",
    "keeps_to: error (%) that it does not exceed on a further seed with the probability goal.confidence",
    "meets: of a confirmed design the probability that its error on a further seed is at most goal.error; of others the probability that \
     they will be confirmed",
    "any_meets: the same for any candidate of the class",
    "begun: number of candidates of the class that are at least partly trained",
];

impl SearchState {
    /// Reads the state of a search.
    pub async fn of(reader: &mut Reader, plan: Plan, space: Space) -> Result<Self, StoreError> {
        let data = SearchData::of(reader, &space, &plan, &mut HashMap::new()).await?;
        let mut search = begun(&space);
        let (decision, classes) = (search.follow(&data.candidates), search.classes());
        let whole = data.pace * cost::total(&plan.trials);
        let failed = data.candidates.iter().filter(|candidate| candidate.failed).count();
        Ok(Self { plan, space, decision, classes, failed, seconds: [data.seconds, whole] })
    }

    /// The searches among sweeps, or why a search cannot be evaluated, such as missing files of its spec.
    pub(super) async fn all(reader: &mut Reader, sweeps: &[StoredSweep]) -> Vec<Result<Self, String>> {
        let mut found = Vec::new();
        for sweep in sweeps.iter().filter(|sweep| sweep.searched) {
            let plan = Plan::new(format!("{}.toml", sweep.name), sweep.text.clone());
            let followed = match plan.and_then(|plan| Ok((Space::new(&plan)?, plan))) {
                Ok((space, plan)) => Self::of(reader, plan, space).await.map_err(|e| e.to_string()),
                Err(e) => Err(e.to_string()),
            };
            found.push(
                followed.map_err(|e| format!("The search of {} cannot be evaluated: {e}.", sweep.name)),
            );
        }
        found
    }

    fn trial(&self, class: &Class) -> &PlannedTrial {
        &self.plan.trials[self.space.places[class.best].trial]
    }

    /// The chosen design, with the probability that it meets the requirement on a further seed.
    pub fn chosen(&self) -> Option<(&PlannedTrial, f64)> {
        let chosen = self.decision.chosen?;
        let class = self.classes.iter().find(|class| class.best == chosen);
        let class = class.expect("it is the best of its class");
        Some((self.trial(class), class.meets))
    }

    /// Whether the design has one decoder for all casts, and a device can run it.
    pub fn reads_all_casts(&self) -> bool {
        let on_a_device = |i: usize| self.space.places[i].demands.is_some();
        let reader = self.space.goal.reader.unwrap_or(GoalReader::Named(GoalReaderName::Casts));
        let casts = self.space.goal.quantile.is_some() && reader == GoalReader::Named(GoalReaderName::Casts);
        casts && self.decision.chosen.is_some_and(on_a_device)
    }

    /// The requirement in words.
    fn requirement(&self) -> String {
        let goal = &self.space.goal;
        let of_casts = |q: f64| format!(" at the {:.0}th percentile of casts", 100.0 * q);
        let of = goal.quantile.map_or(String::new(), of_casts);
        let unit = |name: &str| {
            let mut known = tasks::SensingTask::ALL.into_iter().map(tasks::SensingTask::name);
            known.find(|(task, _)| *task == name).map_or("", |(_, unit)| unit)
        };
        let tasks = goal.tasks.iter().flatten().map(|(task, most)| (task.name(), *most));
        let tasks = tasks.map(|(name, most)| format!(", {name}: {} {}", number(most), unit(name)));
        format!("{} %{of}{}", number(goal.error), tasks.collect::<String>())
    }

    /// The outcome, one sentence per line.
    pub fn verdict(&self) -> Vec<String> {
        let Self { space, decision, seconds: [seconds, whole], .. } = self;
        let part = 100.0 * seconds / whole.max(f64::MIN_POSITIVE);
        let kinship = decision.kinship;
        let looks = kinship.map_or(String::new(), |r| {
            format!("; estimated correlation of errors early in training with final errors: {r:.2}")
        });
        let mut lines = vec![format!(
            "{seconds:.0} CPU s, {part:.0} % of the estimated CPU time of the whole sweep{looks}"
        )];
        if self.failed > 0 {
            let failed = counted(self.failed, "trial");
            lines.push(format!("{failed} failed and cannot be chosen; --retry-failed resumes them"));
        }
        let needed = self.requirement();
        let is_over = decision.work.is_empty();
        if let Some((trial, meets)) = self.chosen() {
            let so_far = if is_over { "" } else { "so far, " };
            // a lower bound is rounded down
            let least = (100.0 * meets + 1e-9).floor().min(99.0);
            lines.push(format!("{so_far}the cheapest design that meets {needed}: {}", trial.hash));
            lines.push(format!(
                "it meets this on a further seed with a probability of at least {least} %, from {} seeds not used in its choice, \
                 corrected for all attempts to confirm a design",
                confirming(&space.goal)
            ));
            lines.push(format!(
                "probability that a cheaper design of the sweep would be confirmed: {:.0} %",
                100.0 * decision.cheaper
            ));
        }
        if !is_over {
            lines.push("the search is not finished; `metasense design` resumes it".into());
        }
        if !is_over || decision.chosen.is_some() {
            return lines;
        }
        let confidence = 100.0 * space.goal.confidence;
        lines.push(format!(
            "no design was confirmed to meet {needed} with a probability of {confidence:.0} %"
        ));
        if let Some(nearest) = self.classes.iter().min_by(|a, b| a.error[1].total_cmp(&b.error[1])) {
            let (error, hash) = (number(nearest.error[1]), &self.trial(nearest).hash);
            lines.push(format!("nearest design: {hash}; it would meet goal.error = {error} %"));
        }
        for out in &space.left_out {
            let more = counted(out.trials, "trial");
            lines.push(format!("  {} = {} admits up to {more} more", out.key, out.least));
        }
        lines
    }

    /// The outcome as an answer of a report.
    fn answer(&self) -> Answer {
        let verdict = self.decision.work.is_empty().then_some(self.decision.chosen.is_some());
        let lines = self.verdict();
        let lines: Vec<&str> = lines[1..].iter().chain(&lines[..1]).map(|line| line.trim()).collect();
        Answer::new("search", verdict, format!("{}: {}.", self.plan.spec.name, lines.join("; ")))
    }

    /// One position per class, the cheapest first: a dot at the expected error of its best candidate, a line up to its `keeps_to`.
    fn picture(&self) -> Picture {
        let (classes, limit) = (&self.classes, self.space.goal.error);
        let sensors = |class: &Class| self.trial(class).spec.point.sensors;
        let begins = |i: &usize| *i == 0 || sensors(&classes[i - 1]) != sensors(&classes[*i]);
        let ticks =
            (0..classes.len()).filter(begins).map(|i| (i as f64, format!("M = {}", sensors(&classes[i]))));
        let ends = [-0.5, classes.len() as f64 - 0.5];
        let x = Axis::new("designs of equal cost, the cheapest first", Scale::Linear, ends)
            .with_names(ticks.collect());
        let errors = classes.iter().flat_map(|class| class.error).chain([limit]);
        let title = format!("{}: at most {}", self.plan.spec.name, self.requirement());
        let mut plot = Plot::new(&title, x, Axis::new("error (%)", Scale::Log, errors)).sized(640.0, 300.0);
        plot.line("equal", ends.map(|x| (x, limit)));
        for (i, class) in classes.iter().enumerate() {
            let (mark, _) = STAGES[place(class.stage)];
            let [expected, kept] = class.error;
            plot.line(&format!("{mark} fine"), [(i as f64, expected), (i as f64, kept)]);
            let (hash, stage, meets) = (&self.trial(class).hash, self.said(class.stage), 100.0 * class.meets);
            let [error, most] = class.error.map(number);
            let text = format!(
                "{hash}, {stage}: {error} % expected, keeps to {most} %, probability of meeting it: {meets:.0} %"
            );
            plot.dots(mark, [((i as f64, expected), text.clone())]);
            if self.decision.chosen == Some(class.best) {
                plot.rings([((i as f64, expected), text)]);
            }
        }
        plot.picture()
    }

    /// The stage of a class in words.
    fn said(&self, stage: CandidateStage) -> String {
        let seeds = confirming(&self.space.goal);
        match stage {
            CandidateStage::Screened => format!("screened on {} seeds", self.space.goal.fresh),
            CandidateStage::Judged(true) => format!("confirmed on {seeds} seeds"),
            CandidateStage::Judged(false) => format!("not confirmed on {seeds} seeds"),
            _ => STAGES[place(stage)].1.to_owned(),
        }
    }

    /// One row per class of candidates of equal cost.
    pub fn table(&self) -> Table {
        let Self { space, decision, .. } = self;
        let row_of = |class: &Class| {
            let place = &space.places[class.best];
            let trial = self.trial(class);
            row![
                trial.spec.point.sensors,
                place.demands.map(|d| d.operations),
                trial.units,
                class.error[0],
                class.error[1],
                class.meets,
                class.any,
                self.said(class.stage),
                class.candidates[1],
                class.candidates[0],
                decision.chosen == Some(class.best),
                setting(space, &trial.spec),
                trial.hash,
            ]
        };
        Table::new(
            "M operations units error keeps_to meets any_meets stage begun candidates chosen setting hash",
            self.classes.iter().map(row_of),
        )
    }
}

/// The keys in which a trial differs from others of the space, with values.
fn setting(space: &Space, spec: &TrialSpec) -> String {
    let leaves = flatten(&serde_json::to_value(spec).expect("a trial is JSON"));
    let told = space.axes.iter().filter(|path| *path != "point.sensors");
    let told = told.filter_map(|path| Some(format!("{path} = {}", brief(leaves.get(path.as_str())?))));
    told.collect::<Vec<_>>().join(", ")
}

/// Index of a stage in [`STAGES`].
fn place(stage: CandidateStage) -> usize {
    match stage {
        CandidateStage::Predicted => 0,
        CandidateStage::Looked => 1,
        CandidateStage::Trained => 2,
        CandidateStage::Screened | CandidateStage::Judged(_) => 3,
    }
}

/// One picture per search that can be evaluated.
pub(super) fn figure(searches: &[Result<SearchState, String>]) -> Option<Figure> {
    let found: Vec<&SearchState> = searches.iter().flatten().collect();
    let tables = || {
        let mut tables = found.iter().map(|search| {
            let mut table = search.table();
            if found.len() > 1 {
                table.columns.insert(0, "requirement".into());
                table.rows.iter_mut().for_each(|row| row.insert(0, search.requirement().into()));
            }
            table
        });
        let mut all = tables.next().expect("one is drawn");
        tables.for_each(|table| all.rows.extend(table.rows));
        all
    };
    Figure::some(
        "search",
        "Which design meets the requirement?",
        "One position per class of designs of equal cost, the cheapest first. Dots: expected error of its best candidate, predicted from other \
         trials or measured on fresh seeds. Lines: up to the error that it does not exceed on a further seed with the probability \
         goal.confidence. Dotted: the required error. Ringed: the chosen design.",
        legend(&STAGES),
        found.iter().map(|found| found.picture()).collect(),
        tables,
    )
}

/// The outcome of each search.
pub(super) fn answers(searches: &[Result<SearchState, String>]) -> Vec<Answer> {
    let said = |search: &Result<SearchState, String>| match search {
        Ok(found) => found.answer(),
        Err(why) => Answer::new("", None, why.clone()),
    };
    searches.iter().map(said).collect()
}

/// Trained bodies with their sensors, by hash of the trial.
pub type Bodies = HashMap<String, (TrialSpec, Vec<f64>)>;

/// Stored data of a search space.
#[derive(Debug)]
pub struct SearchData {
    /// State of each candidate.
    pub candidates: Vec<Candidate>,
    /// CPU seconds of the search's trials.
    pub seconds: f64,
    /// Actual over estimated seconds of finished trials.
    pace: f64,
}

impl SearchData {
    /// Reads the data; adds trained bodies to `bodies` for later calls.
    pub async fn of(
        reader: &mut Reader,
        space: &Space,
        plan: &Plan,
        bodies: &mut Bodies,
    ) -> Result<Self, StoreError> {
        let standings = reader.standings().await?;
        let mut candidates = Vec::with_capacity(space.places.len());
        for place in &space.places {
            let trial = &plan.trials[place.trial];
            let mut candidate = place.candidate.clone();
            if let Some(standing) = standings.get(&trial.hash) {
                candidate = stored_candidate(space, place, trial, standing);
                if candidate.reached.len() == LEVELS {
                    body(bodies, reader, &trial.hash).await?;
                    // absent if the trial has been reopened
                    if let Some(body) = bodies.get(&trial.hash) {
                        candidate.fresh = fresh(space, plan, place, body, &standings);
                    }
                }
            }
            candidates.push(candidate);
        }
        let spent = reader.spent(&plan.source.text).await?;
        let taken = |trial: &PlannedTrial| spent.get(&trial.hash).and_then(|(_, kept)| *kept);
        let finished: Vec<_> = plan.trials.iter().filter(|trial| taken(trial).is_some()).collect();
        let seconds: f64 = finished.iter().filter_map(|trial| taken(trial)).sum();
        let pace = if finished.is_empty() { 1.0 } else { seconds / cost::total(finished) };
        let seconds = spent.values().fold(0.0, |all, (seconds, _)| all + seconds);
        Ok(Self { candidates, seconds, pace })
    }
}

/// The error (%) of a stored trial to which the requirement applies. If tasks are required, too, an error of a task counts as the
/// same multiple of `goal.error` as it is of its own requirement.
fn error(space: &Space, place: &SearchTrial, standing: &TrialProgress) -> Option<f64> {
    let reader = place.reader.map(|by| (by.name().to_owned(), by.records().unwrap_or(0)));
    let error = standing.error(reader.as_ref().zip(space.goal.quantile));
    let error = error.filter(|e| e.is_finite() && *e > 0.0)?;
    let Some(tasks) = &space.goal.tasks else { return Some(error) };
    let multiples = tasks.iter().map(|(task, most)| Some(standing.tasks.get(task.name())? / most));
    let worst = multiples.reduce(|a, b| Some(a?.max(b?))).unwrap_or(Some(0.0))?;
    Some(error.max(space.goal.error * worst))
}

/// Error (%) of a body that failed, above the requirement.
fn missed(goal: &Goal) -> f64 {
    if goal.tasks.is_none() { FAILED } else { FAILED.max(2.0 * goal.error) }
}

/// A candidate with the results of its trial at each level.
fn stored_candidate(
    space: &Space,
    place: &SearchTrial,
    trial: &PlannedTrial,
    standing: &TrialProgress,
) -> Candidate {
    let mut candidate = place.candidate.clone();
    let done = standing.state == "done";
    let result = if done { error(space, place, standing) } else { None };
    for rung in rungs(&trial.spec) {
        let told = match rung {
            Some(steps) => standing.after(steps),
            // with so few steps, the result is the next level
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

/// Adds the body of a finished trial.
async fn body(bodies: &mut Bodies, reader: &mut Reader, hash: &str) -> Result<(), StoreError> {
    if !bodies.contains_key(hash)
        && let Some(stored) = reader.stored(hash).await?
    {
        let ([_, spec], [_, design]) = (stored.specs, stored.designs);
        bodies.insert(hash.to_owned(), (spec, design));
    }
    Ok(())
}

/// Errors (%) of a body on fresh seeds, up to the first unknown one.
fn fresh(
    space: &Space,
    plan: &Plan,
    place: &SearchTrial,
    body: &(TrialSpec, Vec<f64>),
    standings: &HashMap<String, TrialProgress>,
) -> Vec<f64> {
    let judges = on_fresh_seeds(plan, &plan.trials[place.trial], body, most_fresh(&space.goal));
    let told = judges.map_while(|judged| {
        let standing = standings.get(&judged.hash)?;
        match standing.state.as_str() {
            "done" => Some(error(space, place, standing).unwrap_or(missed(&space.goal))),
            "failed" => Some(missed(&space.goal)),
            _ => None,
        }
    });
    told.collect()
}

/// A search without results.
pub fn begun(space: &Space) -> DesignSearch {
    DesignSearch::new(&space.goal, space.places.iter().map(|place| place.candidate.clone()))
}
