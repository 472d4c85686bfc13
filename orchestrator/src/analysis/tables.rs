//! The answers as tables, one a question.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use super::brains::reads;
use super::data::{
    BRAINS, COMPLEXITY, DESIGN, FREEDOM, Group, Level, SENSORS, TRAINING, groups, levels, observations,
};
use super::decision::{Decision, Terms, decide};
use super::elbow::{Verdict, elbow};
use super::numbers::{geometric_mean, mean};
use super::paired;
use super::paired::Ratio;
use super::placed::placed;
use super::random::random;
use super::resample::Interval;
use super::run_time::{Watched, mean_seconds, median_time, pareto, round_errors};
use super::scaling::scaling;
use super::sensors::{fewer, spread};
use super::trial::{Body, Set, Trial};
use crate::look::{Table, row};

/// A question to finished trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Question {
    /// Initial against optimised body, paired by trial: ratio of errors
    Paired,
    /// What the brain decides: error against what it remembers; bodies trained with one brain and read by another
    Brains,
    /// Iterations of training the initial body's network needs over those of the optimised body's, to equal error and loss
    Iterations,
    /// Initial against optimised body after long training (evaluation.long_iterations)
    Long,
    /// Error against the number of sensors M, votes for an elbow there, what the next sensor brings
    Sensors,
    /// The elbow of error against M, by three methods; the smallest M within 10 % of the best, the best at a price (--price)
    Elbow,
    /// The fewest sensors with which the optimised body beats the initial one with the most
    Fewer,
    /// Spread of the error over sensor placements
    Placements,
    /// What placing sensors well buys (sensors.search), and what training the body buys beyond it
    Placed,
    /// Random bodies (body.design = { random = SEED }) against the initial and the optimised one
    Random,
    /// What a linear model is worth: the part of the signals that the body's linearisation at rest does not give
    Nonlinear,
    /// Error against the number of design parameters N
    Sizes,
    /// The law L = a (N/N0)^(-b) + c
    Complexity,
    /// CPU seconds until a test error is reached
    TimeTo,
    /// What no other run beats in both CPU seconds and test error
    Front,
    /// Where the time went (CPU seconds)
    Seconds,
}

impl Question {
    /// All of them, in the order in which they are answered.
    pub const ALL: [Self; 16] = [
        Self::Paired,
        Self::Brains,
        Self::Iterations,
        Self::Long,
        Self::Sensors,
        Self::Elbow,
        Self::Fewer,
        Self::Placements,
        Self::Placed,
        Self::Random,
        Self::Nonlinear,
        Self::Sizes,
        Self::Complexity,
        Self::TimeTo,
        Self::Front,
        Self::Seconds,
    ];

    /// What the table shows, with its units.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::Paired => {
                "Initial over optimised error, paired by trial (above 1: the optimised body is better; 95 % interval)"
            }
            Self::Brains => {
                "Holdout error (%, geometric mean) by the brain that trained the optimised body, the one that reads it, and what that remembers (s before and after)"
            }
            Self::Iterations => {
                "Iterations on the initial over those on the optimised body, to equal holdout error and training loss"
            }
            Self::Long => "Initial over optimised error after long training, paired by trial (95 % interval)",
            Self::Sensors => "Error (%, geometric mean) against the number of sensors M",
            Self::Elbow => {
                "Elbow of error against M; the smallest M within --within of the best, and of least error + --price × M, each also without the largest M"
            }
            Self::Fewer => "Fewest sensors of the optimised body that beat the most of the initial one",
            Self::Placements => {
                "Spread of error over placements at equal M and seed (standard deviation of ln error)"
            }
            Self::Placed => {
                "Error (%, geometric mean) with sensors at random and placed by a search; by_placing: the first over the second on the initial body, by_training: initial over optimised body with sensors placed (95 % interval)"
            }
            Self::Random => {
                "Error (%, geometric mean) of random bodies beside the initial and the optimised one, and over theirs"
            }
            Self::Nonlinear => {
                "Part of the signals (%, mean over channels of squares) that the body's linearisation at rest does not give"
            }
            Self::Sizes => "Error (%, geometric mean) against the number of design parameters N",
            Self::Complexity => "Scaling law: error = a (N/N0)^(-b) + c (%, 95 % intervals)",
            Self::TimeTo => {
                "CPU seconds until half of the trials have reached a test error (%; Kaplan and Meier's median, 95 % interval, open above where too few get there)"
            }
            Self::Front => "Pareto front of best test error so far (%) against CPU seconds",
            Self::Seconds => "Where the time went (CPU seconds a trial)",
        }
    }

    /// Whether the trials differ in what the question is about, so that there is something to say on it.
    #[must_use]
    pub fn was_put(self, trials: &[Trial]) -> bool {
        let varies = |of: fn(&Trial) -> u64| trials.iter().any(|t| of(t) != of(&trials[0]));
        match self {
            Self::Sensors | Self::Elbow | Self::Fewer => varies(|t| t.sensors),
            Self::Sizes | Self::Complexity => varies(|t| t.design_parameters),
            _ => true,
        }
    }

    /// The answer; no rows where the trials cannot give one.
    #[must_use]
    pub fn answer(self, trials: &[Trial], terms: Terms) -> Table {
        let trials: Vec<&Trial> = trials.iter().collect();
        match self {
            Self::Paired => paired_table(&trials),
            Self::Brains => brains_table(&trials),
            Self::Iterations => iterations_table(&trials),
            Self::Long => long_table(&trials),
            Self::Sensors => sensors_table(&trials, terms),
            Self::Elbow => elbow_table(&trials, terms),
            Self::Fewer => fewer_table(&trials),
            Self::Placements => placements_table(&trials),
            Self::Placed => placed_table(&trials),
            Self::Random => random_table(&trials),
            Self::Nonlinear => nonlinear_table(&trials),
            Self::Sizes => sizes_table(&trials),
            Self::Complexity => complexity_table(&trials),
            Self::TimeTo => time_table(&trials),
            Self::Front => front_table(&trials),
            Self::Seconds => seconds_table(&trials),
        }
    }
}

/// Both ends of an interval, where there is one.
pub(crate) fn ends(interval: Option<Interval>) -> [Value; 2] {
    [json!(interval.map(|i| i.low)), json!(interval.map(|i| i.high))]
}

pub(super) fn ratio_cells(ratio: Ratio) -> Vec<Value> {
    let [low, high] = ends(ratio.interval);
    row![ratio.trials, ratio.above_one, ratio.ratio, low, high, ratio.over]
}

fn brains_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for group in groups(trials, BRAINS) {
        for read in reads(&group.trials) {
            let [before, after] = read.memory.map(|s| (1e6 * s).round() / 1e6);
            let [initial, optimised] = read.errors;
            let names = row![group.label, read.trained_with, read.by, before, after, initial, optimised];
            rows.push([names, ratio_cells(read.ratio)].concat());
        }
    }
    let columns = "setting trained_with read_by before after initial optimised trials improved ratio low \
        high over";
    Table::new(columns, rows)
}

fn paired_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for group in groups(trials, &[]) {
        for set in Set::ALL {
            if let Some(ratio) = paired::error_ratio(&group.trials, set) {
                rows.push(row![group.label, set.name(); ratio_cells(ratio)]);
            }
        }
    }
    Table::new("setting set trials improved ratio low high over", rows)
}

fn iterations_table(trials: &[&Trial]) -> Table {
    let rows = groups(trials, &[]).into_iter().flat_map(|group| {
        paired::Progress::ALL.into_iter().filter_map(move |by| {
            Some(row![group.label, by.name(); ratio_cells(paired::iterations(&group.trials, by)?)])
        })
    });
    Table::new("setting to_equal trials faster ratio low high over", rows)
}

fn long_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for group in groups(trials, &[]) {
        let lengths: BTreeSet<u64> = group.trials.iter().filter_map(|t| t.long_iterations()).collect();
        for (iterations, set) in lengths.into_iter().flat_map(|n| Set::ALL.map(|set| (n, set))) {
            let of_length = |t: &&&Trial| t.long_iterations() == Some(iterations);
            let trials: Vec<&Trial> = group.trials.iter().filter(of_length).copied().collect();
            if let Some(ratio) = paired::long_ratio(&trials, set) {
                let mut row = row![group.label, set.name(), iterations];
                row.extend(Body::ALL.map(|body| {
                    let errors: Vec<f64> = trials.iter().filter_map(|t| t.long_error(body, set)).collect();
                    json!(geometric_mean(&errors))
                }));
                row.extend(ratio_cells(ratio));
                rows.push(row);
            }
        }
    }
    let columns = "setting set iterations initial optimised trials improved ratio low high over";
    Table::new(columns, rows)
}

fn random_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for group in groups(trials, DESIGN) {
        for set in Set::ALL {
            let Some(found) = random(&group.trials, set) else { continue };
            let mean = |errors: &[f64]| json!((!errors.is_empty()).then(|| geometric_mean(errors)));
            let end = |pick: fn(f64, f64) -> f64| json!(found.errors.iter().copied().reduce(pick));
            let mut row = row![group.label, set.name(), found.errors.len()];
            row.extend([mean(&found.errors), end(f64::min), end(f64::max), json!(found.deviation())]);
            row.extend([mean(&found.others[0]), mean(&found.others[1]), mean(&found.trained)]);
            let over = found.ratios[1].as_ref().map(|r| r.over.clone());
            for ratio in found.ratios {
                let [low, high] = ends(ratio.as_ref().and_then(|r| r.interval));
                row.extend([
                    json!(ratio.as_ref().map(|r| r.above_one)),
                    json!(ratio.as_ref().map(|r| r.ratio)),
                ]);
                row.extend([low, high]);
            }
            row.push(json!(over));
            rows.push(row);
        }
    }
    let columns = "setting set bodies random least most deviation initial optimised random_trained \
        worse_than_initial over_initial over_initial_low over_initial_high worse_than_optimised \
        over_optimised over_optimised_low over_optimised_high over";
    Table::new(columns, rows)
}

/// The groups with a curve: at least two places on the axis; all groups where none has.
fn with_curves<'a>(groups: Vec<Group<'a>>, at: fn(&Trial) -> u64) -> Vec<Group<'a>> {
    let has = |group: &Group| group.varies(at);
    match groups.iter().any(has) {
        true => groups.into_iter().filter(has).collect(),
        false => groups,
    }
}

/// Every group's curve for each body and set.
fn each_curve(groups: &[Group], mut visit: impl FnMut(&Group, Body, Set)) {
    for group in groups {
        for body in Body::ALL {
            for set in Set::ALL {
                visit(group, body, set);
            }
        }
    }
}

/// What a curve is of, and one of its levels.
fn level_cells(group: &Group, body: Body, set: Set, level: &Level) -> Vec<Value> {
    row![
        group.label,
        body.name(),
        set.name(),
        level.at as u64,
        level.trials,
        level.mean,
        level.least,
        level.most
    ]
}

fn sensors_table(trials: &[&Trial], terms: Terms) -> Table {
    let mut rows = Vec::new();
    each_curve(&with_curves(groups(trials, SENSORS), |t| t.sensors), |group, body, set| {
        let points = observations(&group.trials, body, set, |t| t.sensors);
        let found = elbow(&points);
        let decided = decide(&points, terms);
        for level in levels(&points) {
            let found = found.as_ref().ok();
            let vote = found.and_then(|e| e.votes.iter().find(|v| v.0 == level.at)).map(|v| v.1);
            let gain = found.and_then(|e| e.gains.iter().find(|g| g.from == level.at));
            let [low, high] = ends(gain.and_then(|g| g.interval));
            let further = row![
                vote.filter(|_| found.is_some_and(has_votes)),
                decided.as_ref().and_then(|d| d.within.share(level.at)),
                decided.as_ref().and_then(|d| d.priced.as_ref()?.share(level.at)),
                gain.map(|g| g.ratio),
                low,
                high,
                decided.as_ref().map(|d| &d.over)
            ];
            rows.push([level_cells(group, body, set, &level), further].concat());
        }
    });
    let columns = "setting body set M trials error least most elbow_votes within_votes price_votes \
        gain_to_next gain_low gain_high over";
    Table::new(columns, rows)
}

fn has_votes(elbow: &super::Elbow) -> bool {
    !matches!(elbow.verdict, Verdict::WithoutVote(_))
}

/// A verdict in words.
#[must_use]
pub fn verdict_text(verdict: Verdict) -> String {
    match verdict {
        Verdict::At(m) => format!("elbow at M = {m}"),
        Verdict::NoElbow => "no elbow".into(),
        Verdict::Undecided(m) => format!("undecided, most votes for M = {m}"),
        Verdict::WithoutVote(Some(m)) => format!("elbow at M = {m} by the fit, units too few for votes"),
        Verdict::WithoutVote(None) => "no elbow by the fit, units too few for votes".into(),
    }
}

fn elbow_table(trials: &[&Trial], terms: Terms) -> Table {
    let mut rows = Vec::new();
    each_curve(&with_curves(groups(trials, SENSORS), |t| t.sensors), |group, body, set| {
        let points = observations(&group.trials, body, set, |t| t.sensors);
        let mut row = row![group.label, body.name(), set.name()];
        match elbow(&points) {
            Err(why) => {
                row.push(json!(why.to_string()));
                row.extend(std::iter::repeat_n(Value::Null, 5));
            }
            Ok(e) => row.extend([
                json!(verdict_text(e.verdict)),
                json!(e.broken_stick.map(|m| m as u64)),
                json!(has_votes(&e).then(|| 1.0 - e.votes.iter().map(|v| v.1).sum::<f64>())),
                e.without_largest.map_or(Value::Null, |m| m.map_or(json!("none"), |m| json!(m as u64))),
                json!(e.kneedle.map(|m| m as u64)),
                json!(e.chord.map(|m| m as u64)),
            ]),
        }
        let decided = decide(&points, terms);
        row.extend(decision_cells(decided.as_ref().map(|d| &d.within)));
        row.extend(decision_cells(decided.as_ref().and_then(|d| d.priced.as_ref())));
        row.push(json!(decided.map(|d| d.over)));
        rows.push(row);
    });
    let columns = "setting body set verdict broken_stick votes_for_none without_largest kneedle chord \
        within within_votes within_without_largest price price_votes price_without_largest over";
    Table::new(columns, rows)
}

/// M, the share of votes for it, and M without the largest.
fn decision_cells(decision: Option<&Decision>) -> [Value; 3] {
    [
        json!(decision.map(|d| d.at as u64)),
        json!(decision.and_then(|d| d.share(d.at))),
        json!(decision.map(|d| d.without_largest as u64)),
    ]
}

fn fewer_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for group in with_curves(groups(trials, SENSORS), |t| t.sensors) {
        for set in Set::ALL {
            let of = |body| observations(&group.trials, body, set, |t| t.sensors);
            if let Some(found) = fewer(&of(Body::Initial), &of(Body::Optimised)) {
                rows.push(row![
                    group.label,
                    set.name(),
                    found.most as u64,
                    found.initial_error,
                    found.fewest.map(|m| m as u64),
                    found.optimised_error,
                    found.share,
                    found.over
                ]);
            }
        }
    }
    let columns = "setting set initial_sensors initial_error optimised_sensors optimised_error votes over";
    Table::new(columns, rows)
}

fn placements_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    each_curve(&groups(trials, &[]), |group, body, set| {
        if let Some(found) = spread(&observations(&group.trials, body, set, |t| t.sensors)) {
            rows.push(row![
                group.label,
                body.name(),
                set.name(),
                found.placements,
                found.deviation,
                found.ratio
            ]);
        }
    });
    Table::new("setting body set placements deviation worst_over_best", rows)
}

fn placed_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for found in placed(trials) {
        for (set, level) in Set::ALL.into_iter().flat_map(|set| found.levels.iter().map(move |l| (set, l))) {
            let mut row = row![found.label, set.name(), level.sensors];
            for (searched, body) in [false, true].into_iter().flat_map(|s| Body::ALL.map(|body| (s, body))) {
                row.push(json!(level.error(searched, body, set)));
            }
            let [placing, training] = [level.by_placing(Body::Initial, set), level.by_training(set)];
            for ratio in [&placing, &training] {
                row.push(json!(ratio.as_ref().map(|r| r.ratio)));
                row.extend(ends(ratio.as_ref().and_then(|r| r.interval)));
            }
            row.push(json!(training.map(|r| r.over)));
            rows.push(row);
        }
    }
    let columns = "setting set M random_initial random_optimised placed_initial placed_optimised \
        by_placing by_placing_low by_placing_high by_training by_training_low by_training_high over";
    Table::new(columns, rows)
}

fn nonlinear_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for (group, body) in groups(trials, &[]).iter().flat_map(|group| Body::ALL.map(|body| (group, body))) {
        for (kind, name) in ["acceleration", "rotation"].into_iter().enumerate() {
            let shares = nonlinear(&group.trials, body, kind);
            let end = |pick: fn(f64, f64) -> f64| json!(shares.iter().copied().reduce(pick));
            if let Some(mean) = mean(&shares) {
                let names = [&group.label, body.name(), name].map(|name| json!(name));
                let found = [json!(shares.len()), json!(mean), end(f64::min), end(f64::max)];
                rows.push(names.into_iter().chain(found).collect());
            }
        }
    }
    Table::new("setting body signals trials nonlinear least most", rows)
}

/// Of a body's accelerations (kind 0) or angular velocities (1), of the trials that say it.
pub(crate) fn nonlinear(trials: &[&Trial], body: Body, kind: usize) -> Vec<f64> {
    trials.iter().filter_map(|t| t.nonlinear[body as usize][kind]).collect()
}

/// Trials that differ in size, and trials of one size that differ in freedom.
fn by_parameters<'a>(trials: &[&'a Trial]) -> Vec<Group<'a>> {
    [COMPLEXITY, FREEDOM].into_iter().flat_map(|but| groups(trials, but)).collect()
}

fn sizes_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    each_curve(&with_curves(by_parameters(trials), |t| t.design_parameters), |group, body, set| {
        for level in levels(&observations(&group.trials, body, set, |t| t.design_parameters)) {
            rows.push(level_cells(group, body, set, &level));
        }
    });
    Table::new("setting body set design_parameters trials error least most", rows)
}

fn complexity_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    each_curve(&with_curves(by_parameters(trials), |t| t.design_parameters), |group, body, set| {
        let points = observations(&group.trials, body, set, |t| t.design_parameters);
        let mut row = row![group.label, body.name(), set.name()];
        match scaling(&points) {
            Err(why) => {
                row.push(json!(why.to_string()));
                row.extend(std::iter::repeat_n(Value::Null, 14));
            }
            Ok(found) => {
                row.push(match &found.not_identifiable {
                    None => json!("identified"),
                    Some(why) => json!(format!("not identifiable: {why}")),
                });
                let ([b_low, b_high], [c_low, c_high]) = (ends(found.exponent), ends(found.floor));
                row.extend([json!(found.law.scale), json!(found.law.reference)]);
                row.extend([json!(found.law.exponent), b_low, b_high, json!(found.law.floor), c_low, c_high]);
                let held = found.held_out;
                let [low, high] = ends(held.and_then(|h| h.interval));
                row.extend([json!(held.map(|h| h.at as u64)), json!(held.map(|h| h.predicted))]);
                row.extend([json!(held.map(|h| h.observed)), low, high, json!(found.over)]);
            }
        }
        rows.push(row);
    });
    let columns = "setting body set verdict a N0 b b_low b_high c c_low c_high held_out_N predicted \
        observed predicted_over_observed_low predicted_over_observed_high over";
    Table::new(columns, rows)
}

/// The ways of training within a group, by what sets them apart.
fn trainings<'a>(group: &Group<'a>) -> Vec<Group<'a>> {
    let mut ways = groups(&group.trials, &[]);
    for way in &mut ways {
        let protocol = way.trials[0].protocol().to_owned();
        let apart: Vec<&str> = way
            .label
            .split(", ")
            .filter(|p| {
                !p.starts_with("K = ") && !p.starts_with("M = ") && !p.starts_with("optimise.protocol")
            })
            .collect();
        way.label = std::iter::once(protocol.as_str()).chain(apart).collect::<Vec<_>>().join(", ");
    }
    ways
}

fn time_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for group in groups(trials, TRAINING) {
        let histories: Vec<&[(f64, f64)]> = group.trials.iter().map(|t| t.history.as_slice()).collect();
        for error in round_errors(&histories) {
            for way in trainings(&group) {
                let runs: Vec<Watched> = way.trials.iter().filter_map(|t| Watched::new(t, error)).collect();
                let found = median_time(&runs);
                rows.push(row![
                    group.label,
                    way.label,
                    error,
                    runs.len(),
                    runs.iter().filter(|r| r.reached).count(),
                    found.median,
                    found.ends[0],
                    found.ends[1],
                    found.over
                ]);
            }
        }
    }
    let columns = "setting training error trials reached seconds low high over";
    Table::new(columns, rows)
}

fn front_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for group in groups(trials, TRAINING) {
        let ways = trainings(&group);
        let mut points = Vec::new();
        for way in &ways {
            for trial in &way.trials {
                points.extend(trial.history.iter().map(|&at| (at, way, *trial)));
            }
        }
        for i in pareto(&points.iter().map(|p| p.0).collect::<Vec<_>>()) {
            let ((seconds, error), way, trial) = points[i];
            rows.push(row![group.label, seconds, error, way.label, trial.hash]);
        }
    }
    Table::new("setting seconds error training hash", rows)
}

fn seconds_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    let mut columns = vec!["setting", "training", "all"];
    for group in groups(trials, TRAINING) {
        for way in trainings(&group) {
            let parts = mean_seconds(&way.trials);
            let total: f64 = parts.iter().map(|p| p.1).sum();
            let mut row = row![group.label, way.label, total];
            row.extend(parts.iter().map(|p| json!(p.1)));
            columns.truncate(3);
            columns.extend(parts.iter().map(|p| p.0));
            rows.push(row);
        }
    }
    Table { columns: columns.into_iter().map(str::to_owned).collect(), rows }
}
