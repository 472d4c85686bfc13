//! Answers to questions, one table per question.

use clap::ValueEnum;
use serde_json::{Value, json};

use super::brains::{DecoderErrors, errors_by_decoder};
use super::casts;
use super::claims::{claims_table, evidence_table, tried};
use super::data::{
    BRAINS, COMPLEXITY, FREEDOM, Group, Level, Observation, SENSORS, TRAINING, apart, groups,
    groups_by_objective, levels, observations,
};
use super::decision::{Decision, DecisionTerms, decisions};
use super::elbow::{ErrorScale, Verdict, elbow};
use super::numbers::{distinct, geometric_mean, mean};
use super::paired::{self, Ratio};
use super::placed::placed;
use super::random::{random, random_groups};
use super::resample::Interval;
use super::run_time::{CensoredTime, mean_seconds, median_time, pareto, parts, round_errors};
use super::scaling::{FittedLaw, scaling};
use super::sensors::{PlacementSpread, fewer, spread};
use super::tasks;
use super::transfer;
use super::trial::{BodyState, Set, Trial};
use metasense_render::{Table, row};

/// A question about finished trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Question {
    /// Initial against trained body, paired by trial: ratio of errors
    Paired,
    /// Error by decoder and memory, also with other decoders in training and evaluation
    Brains,
    /// Error over virtual casts by body and decoder, and the part of the gain that is kept ([variation])
    Casts,
    /// Bodies trained under one kind of forces and evaluated under others (evaluation.under): error, and the kept part of the specialist's gain
    Transfer,
    /// Error of readouts of sensing tasks by the task of the training (evaluation.tasks), gain by training, elbow of the error against M
    Tasks,
    /// Ratio of training iterations on the initial and on the trained body, to equal error and loss
    Iterations,
    /// Initial against trained body after long training (evaluation.long_iterations)
    Long,
    /// Error against the number of sensors M, votes for an elbow of its logarithm, gain from the next sensor
    Sensors,
    /// The elbow of error against M, by three methods; the smallest M with 90 % of the fall from 100 %, the smallest within 10 % of the least error, the best at a price per sensor (--price)
    Elbow,
    /// The fewest sensors with which the trained body has less error than the initial body with the most sensors
    Fewer,
    /// Spread of the error over sensor placements
    Placements,
    /// Gain from a search for sensor places (sensors.search), and further gain from training the body
    Placed,
    /// Random bodies (body.design = { random = SEED }) against the initial and the trained body
    Random,
    /// Part of the signals that a linear model of the body at rest does not explain
    Nonlinear,
    /// Error against the number of design parameters N
    Sizes,
    /// The law L = a (N/N0)^(-b) + c
    Complexity,
    /// CPU seconds until a test error is reached, as if each trial had trained its body itself
    TimeTo,
    /// Pareto front of CPU seconds and test error, as if each trial had trained its body itself
    Front,
    /// CPU seconds by part of the computation (as in `v_trial`: a shared body counts for the trial that trained it)
    Seconds,
    /// The claims of arXiv:2605.23967, each rated by the trials that can test it, with the specs of these trials; only on request
    Claims,
    /// The evidence for each claim, one row per decoder and set: ratio, interval and votes; only on request
    Evidence,
}

impl Question {
    /// Returns all questions, in the order of their answers.
    pub fn all() -> &'static [Self] {
        Self::value_variants()
    }

    /// Title of the table, with units.
    pub fn title(self) -> &'static str {
        match self {
            Self::Paired => {
                "Error of the initial body divided by error of the trained body, paired by trial (above 1: the trained body is better; 95 % interval)"
            }
            Self::Brains => {
                "Held-out error (%, geometric mean) by the decoder in training, the decoder in evaluation, and its memory (s before and after)"
            }
            Self::Casts => {
                "Error (%) on casts not used in training, by body and decoder (fitted to the body as designed, to other casts, or to records of each cast): median and 90th percentile over casts, geometric means over trials; inverse and twin: over the first 16 held-out samples, others over all; kept: gain on casts as a fraction of the gain as designed, in logarithms (95 % intervals)"
            }
            Self::Transfer => {
                "Held-out error (%, geometric mean) under a kind of forces, by body and decoder: fitted under these forces (own), or under the training forces of the body (carried); kept: the gain as a fraction of that of the body trained under this kind, in logarithms, with decoders fitted under it (95 % intervals)"
            }
            Self::Tasks => {
                "Held-out error of sensing tasks in their units (means over trials), by the task for which the body was trained; trivial: of the best estimate without signals; ratio: initial / trained body (95 % interval); elbow: of the trained body's error against M, in logarithms"
            }
            Self::Iterations => {
                "Iterations on the initial body divided by iterations on the trained body, to equal held-out error and training loss"
            }
            Self::Long => {
                "Error of the initial body divided by error of the trained body after long training, paired by trial (95 % interval)"
            }
            Self::Sensors => "Error (%, geometric mean) against the number of sensors M",
            Self::Elbow => {
                "Elbow of error against M; the smallest M with the fraction --fall of the fall from 100 %, within --within of the best, and with the smallest error + --price × M, each also without the largest M"
            }
            Self::Fewer => {
                "Fewest sensors with which the trained body has less error than the initial body with the most sensors"
            }
            Self::Placements => {
                "Spread of error over placements at equal M and seed (standard deviation of ln error)"
            }
            Self::Placed => {
                "Error (%, geometric mean) with sensors at random and placed by a search; by_placing: random / placed on the initial body, by_training: initial / trained body with placed sensors (95 % interval)"
            }
            Self::Random => {
                "Error (%, geometric mean) of random bodies, and its ratio to that of the initial and of the trained body"
            }
            Self::Nonlinear => {
                "Share of the signals' energy (%, mean over channels) not explained by a linear model of the body at rest"
            }
            Self::Sizes => "Error (%, geometric mean) against the number of design parameters N",
            Self::Complexity => "Scaling law: error = a (N/N0)^(-b) + c (%, 95 % intervals)",
            Self::TimeTo => {
                "CPU seconds until half of the trials have reached a test error (%; Kaplan–Meier median, 95 % interval, open above if too few trials reach it)"
            }
            Self::Front => "Pareto front of best test error so far (%) against CPU seconds",
            Self::Seconds => "CPU seconds per trial by part of the computation",
            Self::Claims => "The claims of arXiv:2605.23967, rated by finished trials",
            Self::Evidence => {
                "The evidence for the claims of arXiv:2605.23967 (ratios above 1: as claimed; 95 % intervals)"
            }
        }
    }

    /// Whether the trials vary in the subject of the question. False for questions that are answered only on request.
    pub fn was_put(self, trials: &[Trial]) -> bool {
        let varies = |of: fn(&Trial) -> u64| trials.iter().any(|t| of(t) != of(&trials[0]));
        let ways = || trainings(&trials.iter().collect::<Vec<_>>());
        match self {
            Self::Sensors | Self::Elbow | Self::Fewer => varies(|t| t.sensors),
            Self::Sizes | Self::Complexity => varies(|t| t.design_parameters),
            Self::Placements => varies(|t| t.cluster.placement),
            Self::TimeTo | Self::Front => ways().iter().any(|(_, ways)| ways.len() > 1),
            Self::Claims | Self::Evidence => false,
            _ => true,
        }
    }

    /// Returns the answer; no rows if the trials cannot answer.
    pub fn answer(self, all: &[Trial], terms: DecisionTerms) -> Table {
        let trials: Vec<&Trial> = all.iter().collect();
        match self {
            Self::Paired => paired_table(&trials),
            Self::Brains => brains_table(&trials),
            Self::Casts => casts_table(&trials),
            Self::Transfer => transfer_table(&trials),
            Self::Tasks => tasks::table(&tasks::results(&tasks::in_steps(trials.iter().copied()))),
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
            Self::Claims => claims_table(&tried(all)),
            Self::Evidence => evidence_table(&tried(all)),
        }
    }
}

/// Returns both ends of an interval, or nulls.
pub(crate) fn ends(interval: Option<Interval>) -> [Value; 2] {
    [json!(interval.map(|i| i.low)), json!(interval.map(|i| i.high))]
}

pub(super) fn ratio_cells(ratio: Ratio) -> Vec<Value> {
    let [low, high] = ends(ratio.interval);
    row![ratio.trials, ratio.above_one, ratio.ratio, low, high, ratio.over]
}

/// For a ratio by medians: the verdicts, if they differ from those by means.
fn note_cells(set: Set, ratio: impl Fn(Set) -> Option<Ratio>) -> Vec<Value> {
    let found = (set == Set::Median).then(|| paired::disagreement(ratio)).flatten();
    row![found.map(|(_, verdicts)| verdicts)]
}

/// Returns a ratio and its interval, or nulls.
pub(super) fn interval_cells(ratio: Option<&Ratio>) -> Vec<Value> {
    row![ratio.map(|r| r.ratio); ends(ratio.and_then(|r| r.interval))]
}

/// Returns one row per group and set for which `say` returns cells.
fn by_set(columns: &str, groups: &[Group], say: impl Fn(&Group, Set) -> Option<Vec<Value>>) -> Table {
    let all = groups.iter().flat_map(|group| Set::with_errors(&group.trials).map(move |set| (group, set)));
    let row = |(group, set): (&Group, Set)| Some([row![group.label, set.name()], say(group, set)?].concat());
    Table::new(&format!("setting set {columns}"), all.filter_map(row))
}

/// Groups with a curve of errors each, and the quantity of the axis.
type Curves<'a> = (Vec<Group<'a>>, fn(&Trial) -> u64);

/// Returns the rows of the curve of every group, body and set.
fn by_curve(columns: &str, (groups, at): Curves, rows: impl Fn(&[Observation]) -> Vec<Vec<Value>>) -> Table {
    let bodies = groups.iter().flat_map(|group| BodyState::ALL.map(|body| (group, body)));
    let all =
        bodies.flat_map(|(group, body)| Set::with_errors(&group.trials).map(move |set| (group, body, set)));
    let told = all.flat_map(|(group, body, set)| {
        let names = row![group.label, body.name(), set.name()];
        let found = rows(&observations(&group.trials, body, set, at));
        found.into_iter().map(move |row| [names.clone(), row].concat())
    });
    Table::new(&format!("setting body set {columns}"), told)
}

fn brains_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for group in groups(trials, BRAINS) {
        let found = errors_by_decoder(&group.trials);
        let what = |read: &DecoderErrors| (read.trained_with.clone(), read.decoder.clone(), read.errors);
        // a linear decoder of the trial appears also among the linear decoders
        let twice = |read: &&DecoderErrors| {
            !read.own && found.iter().any(|other| other.own && what(other) == what(read))
        };
        for read in found.iter().filter(|read| !twice(read)) {
            let [before, after] = read.memory.map(|s| (1e6 * s).round() / 1e6);
            let [initial, optimised] = read.errors;
            let names = row![group.label, read.trained_with, read.decoder, before, after, initial, optimised];
            rows.push([names, ratio_cells(read.ratio.clone()), row![read.note]].concat());
        }
    }
    let columns = "setting trained_with read_by before after initial optimised trials improved ratio low \
        high over note";
    Table::new(columns, rows)
}

fn casts_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for setting in casts::settings(trials) {
        for (body, by) in
            setting.bodies.iter().flat_map(|body| body.brains().into_iter().map(move |by| (body, by)))
        {
            let Some(found) = body.errors_of(by) else { continue };
            let names = row![setting.label, body.name, by.name(), by.records()];
            let [median, most] = &found.errors;
            let designed = found.designed.map(|designed| designed.ratio);
            let counts = row![median.trials, found.casts[0], found.casts[1], designed];
            let [kept, kept_most] = found.kept.map(|kept| {
                let [low, high] = ends(kept.and_then(|kept| kept.interval));
                row![kept.map(|kept| kept.part), low, high]
            });
            let errors = [interval_cells(Some(median)), interval_cells(Some(most))].concat();
            rows.push([names, counts, errors, kept, kept_most, row![median.over, found.note]].concat());
        }
    }
    let columns = "setting body read_by records trials casts failed designed median median_low median_high \
        percentile_90 percentile_90_low percentile_90_high kept kept_low kept_high kept_90 kept_90_low kept_90_high over note";
    Table::new(columns, rows)
}

fn transfer_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for setting in transfer::settings(trials) {
        for (body, kind) in
            setting.bodies.iter().flat_map(|body| setting.kinds.iter().map(move |kind| (body, kind)))
        {
            let Some(read) = setting.read(body, kind) else { continue };
            let kept = row![read.kept.map(|kept| kept.part); ends(read.kept.and_then(|kept| kept.interval))];
            let errors = [interval_cells(Some(&read.own)), interval_cells(read.carried.as_ref())].concat();
            let names = row![setting.label, body.name, kind, read.own.trials];
            rows.push([names, errors, kept, row![read.own.over, read.note]].concat());
        }
    }
    let columns = "setting body under trials own own_low own_high carried carried_low carried_high kept kept_low \
        kept_high over note";
    Table::new(columns, rows)
}

fn paired_table(trials: &[&Trial]) -> Table {
    by_set("trials improved ratio low high over note", &groups(trials, &[]), |group, set| {
        let ratio = |set| paired::error_ratio(&group.trials, set);
        Some([ratio_cells(ratio(set)?), note_cells(set, ratio)].concat())
    })
}

fn iterations_table(trials: &[&Trial]) -> Table {
    let rows = groups(trials, &[]).into_iter().flat_map(|group| {
        paired::TrainingMeasure::ALL.into_iter().filter_map(move |by| {
            Some(row![group.label, by.name(); ratio_cells(paired::iterations(&group.trials, by)?)])
        })
    });
    Table::new("setting to_equal trials faster ratio low high over", rows)
}

fn long_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for group in groups(trials, &[]) {
        let lengths = distinct(group.trials.iter().filter_map(|t| t.long_iterations()));
        for (iterations, set) in
            lengths.into_iter().flat_map(|n| Set::with_errors(&group.trials).map(move |set| (n, set)))
        {
            let of_length = |t: &&&Trial| t.long_iterations() == Some(iterations);
            let trials: Vec<&Trial> = group.trials.iter().filter(of_length).copied().collect();
            if let Some(ratio) = paired::long_ratio(&trials, set) {
                let mean = |body| {
                    let errors: Vec<f64> = trials.iter().filter_map(|t| t.long_error(body, set)).collect();
                    geometric_mean(&errors)
                };
                let [initial, optimised] = BodyState::ALL.map(mean);
                let names = row![group.label, set.name(), iterations, initial, optimised];
                let note = note_cells(set, |set| paired::long_ratio(&trials, set));
                rows.push([names, ratio_cells(ratio), note].concat());
            }
        }
    }
    let columns = "setting set iterations initial optimised trials improved ratio low high over note";
    Table::new(columns, rows)
}

fn random_table(trials: &[&Trial]) -> Table {
    let columns = "bodies random least most deviation initial optimised random_trained \
        worse_than_initial over_initial over_initial_low over_initial_high worse_than_optimised \
        over_optimised over_optimised_low over_optimised_high over";
    by_set(columns, &random_groups(trials), |group, set| {
        let found = random(&group.trials, set)?;
        let mean = |errors: &[f64]| (!errors.is_empty()).then(|| geometric_mean(errors));
        let end = |pick: fn(f64, f64) -> f64| found.errors.iter().copied().reduce(pick);
        let (count, average) = (found.errors.len(), mean(&found.errors));
        let own = row![count, average, end(f64::min), end(f64::max), found.deviation()];
        let others = row![mean(&found.others[0]), mean(&found.others[1]), mean(&found.trained)];
        let over =
            |ratio: &Option<Ratio>| row![ratio.as_ref().map(|r| r.above_one); interval_cells(ratio.as_ref())];
        let [initial, optimised] = &found.ratios;
        let units = row![optimised.as_ref().map(|r| &r.over)];
        Some([own, others, over(initial), over(optimised), units].concat())
    })
}

/// Keeps groups with at least two values on the axis; all groups if there are none.
fn with_curves<'a>(mut groups: Vec<Group<'a>>, at: fn(&Trial) -> u64) -> Curves<'a> {
    if groups.iter().any(|group| group.varies(at)) {
        groups.retain(|group| group.varies(at));
    }
    (groups, at)
}

fn by_sensors<'a>(trials: &[&'a Trial]) -> Curves<'a> {
    with_curves(groups(trials, SENSORS), |t| t.sensors)
}

/// Cells of one value of the axis.
fn level_cells(level: &Level) -> Vec<Value> {
    row![level.at as u64, level.trials, level.mean, level.least, level.most]
}

fn sensors_table(trials: &[&Trial], terms: DecisionTerms) -> Table {
    let columns = "M trials error least most elbow_votes within_votes price_votes gain_to_next gain_low \
        gain_high over";
    by_curve(columns, by_sensors(trials), |points| {
        let (found, decided) = (elbow(points, ErrorScale::Logarithm).ok(), decisions(points, terms));
        let (found, decided) = (found.as_ref(), decided.as_ref());
        let row = |level: Level| {
            let gain = found.and_then(|e| e.gains.iter().find(|g| g.from == level.at));
            let [low, high] = ends(gain.and_then(|g| g.interval));
            let within = decided.and_then(|d| d.within.share(level.at));
            let price = decided.and_then(|d| d.priced.as_ref()?.share(level.at));
            let votes = row![found.and_then(|e| e.share(Some(level.at))), within, price];
            let gain = row![gain.map(|g| g.ratio), low, high, decided.map(|d| &d.over)];
            [level_cells(&level), votes, gain].concat()
        };
        levels(points).into_iter().map(row).collect()
    })
}

/// Formats a verdict.
pub fn verdict_text(verdict: Verdict) -> String {
    match verdict {
        Verdict::At(m) => format!("elbow at M = {m}"),
        Verdict::NoElbow => "no elbow".into(),
        Verdict::Undecided(Some(m)) => format!("undecided, most votes for M = {m}"),
        Verdict::Undecided(None) => "undecided, most votes for no elbow".into(),
        Verdict::WithoutVote(Some(m)) => {
            format!("elbow at M = {m} by the fit; too few placements or seeds for votes")
        }
        Verdict::WithoutVote(None) => "no elbow by the fit; too few placements or seeds for votes".into(),
    }
}

fn elbow_table(trials: &[&Trial], terms: DecisionTerms) -> Table {
    let columns = "height verdict broken_stick votes_for_none without_largest any_decay kneedle chord fall fall_votes \
        fall_without_largest within within_votes within_without_largest price price_votes price_without_largest over";
    let whole = |m: f64| m as u64;
    by_curve(columns, by_sensors(trials), |points| {
        let without = |m: Option<f64>| m.map_or(json!("none"), |m| json!(whole(m)));
        let decided = decisions(points, terms);
        let fall = decision_cells(decided.as_ref().map(|d| &d.fall));
        let within = decision_cells(decided.as_ref().map(|d| &d.within));
        let price = decision_cells(decided.as_ref().and_then(|d| d.priced.as_ref()));
        let over = row![decided.map(|d| d.over)];
        let row = |height: ErrorScale| {
            let found = elbow(points, height);
            let e = found.as_ref().ok();
            let verdict = found.as_ref().map_or_else(ToString::to_string, |e| verdict_text(e.verdict));
            let stick = row![e.and_then(|e| e.broken_stick).map(whole), e.and_then(|e| e.share(None))];
            let without_largest = e.and_then(|e| e.without_largest).map(without);
            let others = row![without_largest, e.map(|e| without(e.any_decay))];
            let [kneedle, chord] = [e.and_then(|e| e.kneedle), e.and_then(|e| e.chord)].map(|m| m.map(whole));
            let by_elbow = [row![height.name(), verdict], stick, others, row![kneedle, chord]].concat();
            [by_elbow, fall.clone(), within.clone(), price.clone(), over.clone()].concat()
        };
        ErrorScale::ALL.map(row).into()
    })
}

/// M, its share of votes, and M without the largest.
fn decision_cells(decision: Option<&Decision>) -> Vec<Value> {
    let [at, without] = [decision.map(|d| d.at), decision.map(|d| d.without_largest)];
    row![at.map(|m| m as u64), decision.and_then(|d| d.share(d.at)), without.map(|m| m as u64)]
}

fn fewer_table(trials: &[&Trial]) -> Table {
    let columns = "initial_sensors initial_error optimised_sensors optimised_error votes over";
    by_set(columns, &by_sensors(trials).0, |group, set| {
        let of = |body| observations(&group.trials, body, set, |t| t.sensors);
        let found = fewer(&of(BodyState::Initial), &of(BodyState::Optimised))?;
        let sensors = [Some(found.most), found.fewest].map(|m| m.map(|m| m as u64));
        let errors = (found.initial_error, found.optimised_error);
        Some(row![sensors[0], errors.0, sensors[1], errors.1, found.share, found.over])
    })
}

fn placements_table(trials: &[&Trial]) -> Table {
    by_curve("placements deviation worst_over_best", (groups(trials, &[]), |t| t.sensors), |points| {
        let row = |found: PlacementSpread| row![found.placements, found.deviation, found.ratio];
        spread(points).map(row).into_iter().collect()
    })
}

fn placed_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for found in placed(trials) {
        for (set, level) in
            Set::with_errors(trials).flat_map(|set| found.levels.iter().map(move |l| (set, l)))
        {
            let ways = [false, true].into_iter().flat_map(|s| BodyState::ALL.map(|body| (s, body)));
            let errors = ways.map(|(searched, body)| json!(level.error(searched, body, set))).collect();
            let [placing, training] = [level.gain_from_placing(set), level.gain_from_training(set)];
            let [placing_cells, training_cells] = [&placing, &training].map(|r| interval_cells(r.as_ref()));
            let names = row![found.label, set.name(), level.sensors];
            let over = row![training.map(|r| r.over)];
            rows.push([names, errors, placing_cells, training_cells, over].concat());
        }
    }
    let columns = "setting set M random_initial random_optimised placed_initial placed_optimised \
        by_placing by_placing_low by_placing_high by_training by_training_low by_training_high over";
    Table::new(columns, rows)
}

fn nonlinear_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for (group, body) in groups(trials, &[]).iter().flat_map(|group| BodyState::ALL.map(|body| (group, body)))
    {
        for (kind, name) in ["acceleration", "rotation"].into_iter().enumerate() {
            let shares = nonlinear(&group.trials, body, kind);
            let end = |pick: fn(f64, f64) -> f64| shares.iter().copied().reduce(pick);
            let row = |mean: f64| {
                row![group.label, body.name(), name, shares.len(), mean, end(f64::min), end(f64::max)]
            };
            rows.extend(mean(&shares).map(row));
        }
    }
    Table::new("setting body signals trials nonlinear least most", rows)
}

/// Returns the nonlinear part (%) of accelerations (kind 0) or angular velocities (1) of a body, per trial that has it.
pub fn nonlinear(trials: &[&Trial], body: BodyState, kind: usize) -> Vec<f64> {
    trials.iter().filter_map(|t| t.nonlinear[body as usize][kind]).collect()
}

/// Groups in which the size of the body varies, then groups of one size in which the number of tied or frozen shifts varies.
fn by_parameters<'a>(trials: &[&'a Trial]) -> Curves<'a> {
    let mut found = groups(trials, COMPLEXITY);
    // groups in which it does not vary are already present
    found.extend(groups(trials, FREEDOM).into_iter().filter(|group| group.varies(|t| t.design_parameters)));
    with_curves(found, |t| t.design_parameters)
}

fn sizes_table(trials: &[&Trial]) -> Table {
    let columns = "design_parameters trials error least most";
    by_curve(columns, by_parameters(trials), |points| levels(points).iter().map(level_cells).collect())
}

fn complexity_table(trials: &[&Trial]) -> Table {
    let columns = "verdict a N0 b b_low b_high c c_low c_high held_out_N predicted observed \
        predicted_over_observed_low predicted_over_observed_high over";
    by_curve(columns, by_parameters(trials), |points| {
        let found = scaling(points);
        let verdict = match &found {
            Err(why) => why.to_string(),
            Ok(FittedLaw { not_identifiable: None, .. }) => "identified".into(),
            Ok(FittedLaw { not_identifiable: Some(why), .. }) => format!("not identifiable: {why}"),
        };
        let found = found.as_ref().ok();
        let law = found.map(|f| f.law);
        let [b_low, b_high] = ends(found.and_then(|f| f.exponent));
        let [c_low, c_high] = ends(found.and_then(|f| f.floor));
        let held_out = found.and_then(|f| f.held_out);
        let [low, high] = ends(held_out.and_then(|h| h.interval));
        let curve =
            row![law.map(|l| l.scale), law.map(|l| l.reference), law.map(|l| l.exponent), b_low, b_high];
        let floor = row![law.map(|l| l.floor), c_low, c_high, held_out.map(|h| h.at as u64)];
        let errors = row![held_out.map(|h| h.predicted), held_out.map(|h| h.observed), low, high];
        vec![[row![verdict], curve, floor, errors, row![found.map(|f| &f.over)]].concat()]
    })
}

/// Returns groups of trials that differ only in training, each with its ways of training, labelled by protocol and differences.
fn trainings<'a>(trials: &[&'a Trial]) -> Vec<(Group<'a>, Vec<Group<'a>>)> {
    let named = |mut way: Group<'a>| {
        let protocol = way.trials[0].protocol();
        let rest = apart(&way.label).into_iter().filter(|part| !part.starts_with("optimise.protocol"));
        way.label = std::iter::once(protocol).chain(rest).collect::<Vec<_>>().join(", ");
        way
    };
    let ways = |group: &Group<'a>| groups(&group.trials, &[]).into_iter().map(named).collect::<Vec<_>>();
    let with_ways = |group| {
        let ways = ways(&group);
        (group, ways)
    };
    groups_by_objective(trials, TRAINING).into_iter().map(with_ways).collect()
}

fn time_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for (group, ways) in trainings(trials) {
        let histories: Vec<&[(f64, f64)]> = group.trials.iter().map(|t| t.history.as_slice()).collect();
        for (error, way) in
            round_errors(&histories).into_iter().flat_map(|e| ways.iter().map(move |w| (e, w)))
        {
            let runs: Vec<CensoredTime> =
                way.trials.iter().filter_map(|t| CensoredTime::new(t, error)).collect();
            let (found, reached) = (median_time(&runs), runs.iter().filter(|r| r.reached).count());
            let [low, high] = found.ends;
            let names = row![group.label, way.label, error, runs.len(), reached];
            rows.push([names, row![found.median, low, high, found.over]].concat());
        }
    }
    let columns = "setting training error trials reached seconds low high over";
    Table::new(columns, rows)
}

fn front_table(trials: &[&Trial]) -> Table {
    let mut rows = Vec::new();
    for (group, ways) in trainings(trials) {
        let runs = ways.iter().flat_map(|way| way.trials.iter().map(move |trial| (way, trial)));
        let points: Vec<_> =
            runs.flat_map(|(way, trial)| trial.history.iter().map(move |&at| (at, way, trial))).collect();
        for i in pareto(&points.iter().map(|p| p.0).collect::<Vec<_>>()) {
            let ((seconds, error), way, trial) = points[i];
            rows.push(row![group.label, seconds, error, way.label, trial.hash]);
        }
    }
    Table::new("setting seconds error training hash", rows)
}

fn seconds_table(trials: &[&Trial]) -> Table {
    let (all, mut rows) = (parts(trials), Vec::new());
    for (group, way) in
        trainings(trials).iter().flat_map(|(group, ways)| ways.iter().map(move |w| (group, w)))
    {
        let seconds = mean_seconds(&way.trials, &all);
        let spent = way.trials.iter().map(|trial| trial.spent).sum::<f64>() / way.trials.len() as f64;
        rows.push(row![group.label, way.label, spent; seconds]);
    }
    let columns = ["setting", "training", "all"].into_iter().chain(all);
    Table { columns: columns.map(str::to_owned).collect(), rows }
}
