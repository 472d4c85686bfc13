//! The claims of arXiv:2605.23967, each tested on the trials that can test it, by decoder.
//!
//! The number of a claim is a ratio that is above 1 if the claim holds. Its 95 % interval gives the rating ([`Rating::of`]).
//! P-values are corrected for the number of findings ([`corrected`]). Claims of elbows are rated by votes, in % and in
//! logarithms. Test set, held-out set and its medians are rated separately. Summaries use the held-out set, and mark verdicts
//! that differ by medians.

mod list;
mod tables;

use std::collections::{BTreeMap, BTreeSet};

use super::data::{
    COMPLEXITY, FREEDOM, Grid, Group, Observation, SENSORS, WITH_SPACING, apart, clusters, groups,
    observations, places, without_repeats,
};
use super::elbow::{ErrorScale, elbow};
use super::kinds::brains;
use super::numbers::{distinct, geometric_mean};
use super::paired;
use super::paired::{Ratio, TrainingMeasure, error_ratio, long_ratio};
use super::random::{random, random_groups};
use super::resample::{Interval, Resampling, holm};
use super::sensors::spread;
use super::tables::verdict_text;
use super::trial::{BodyState, Cluster, Set, Trial};
pub use list::CLAIMS;
pub use tables::{claims_table, evidence_table, tried, tried_elsewhere};

/// Share of votes that decides a claim.
const SURE: f64 = 0.95;
/// Largest relative difference of errors that count as equal.
const ALIKE: f64 = 0.15;
/// Significance level.
const CHANCE: f64 = 0.05;

/// Rating of a claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rating {
    /// At least as large as in the paper.
    Holds,
    /// In the direction of the claim; the interval contains the paper's number.
    Compatible,
    /// In the direction of the claim, but smaller.
    InPart,
    /// No relevant difference.
    Alike,
    /// In the opposite direction, or an elbow elsewhere.
    Fails,
    /// Undecided.
    Open,
}

impl Rating {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        ["holds", "compatible", "in part", "no difference", "fails", "open"][self as usize]
    }

    /// Rates a ratio by its interval. `stated`: the paper's number, or 1 if the paper only claims a direction.
    pub fn of(interval: Option<Interval>, stated: f64) -> Self {
        let Some(Interval { low, high }) = interval else { return Self::Open };
        match (low > 1.0, high < 1.0) {
            (true, _) if low >= stated => Self::Holds,
            (true, _) if high >= stated => Self::Compatible,
            (true, _) => Self::InPart,
            (_, true) => Self::Fails,
            _ if low > 1.0 / (1.0 + ALIKE) && high < 1.0 + ALIKE => Self::Alike,
            _ => Self::Open,
        }
    }
}

/// Result of some trials for a claim.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Differences from other evidence for the claim, mainly the decoder.
    pub who: String,
    /// The set of samples, or the quantity.
    pub set: &'static str,
    /// Number of trials.
    pub trials: usize,
    /// Ratio of the claim; `None` for elbows.
    pub found: Option<f64>,
    /// Its 95 % interval.
    pub interval: Option<Interval>,
    /// Two-sided p-value of the ratio 1; adjusted for multiple tests by [`corrected`].
    pub chance: Option<f64>,
    /// True ratio that such trials would distinguish from 1 with a power of 80 %, without correction for other claims.
    pub tells: Option<f64>,
    /// Further remarks.
    pub note: String,
    /// Units of the interval or votes.
    pub over: String,
    /// The rating.
    pub rating: Rating,
}

/// A claim of the paper, or a further question.
pub struct Claim {
    /// The statement.
    pub says: &'static str,
    /// Figure or section of the paper.
    pub source: &'static str,
    /// Number in the paper: a factor, or 1 if it gives none; for an elbow M.
    pub stated: f64,
    /// Significance level; halved if the claim was tested a second time.
    pub chance: f64,
    /// Specs in `schemas` whose trials test the claim.
    pub specs: &'static [&'static str],
    /// Scene of the trials that `find` receives; `None`: all trials.
    scene: Option<Scene>,
    find: fn(f64, &[&Trial]) -> Vec<Evidence>,
}

/// Number and kind of forces on a planar body, and number of sensors if fixed.
#[derive(Debug, Clone, Copy)]
struct Scene {
    panels: u64,
    sensors: Option<u64>,
    stimuli: &'static str,
}

impl Claim {
    /// Returns the evidence in the trials of a database; empty without trials of the scene. Trials without the implicit term
    /// count only for the claim about this term.
    pub fn evidence(&self, trials: &[Trial]) -> Vec<Evidence> {
        let whole = |t: &Trial| matches!(t.setting.text("optimise.gradient"), None | Some("implicit"));
        let counts = |t: &&Trial| self.specs == list::GRADIENT || whole(t);
        let trials: Vec<&Trial> = trials.iter().filter(counts).collect();
        let own = |scene: Scene| {
            let planar = planar(&trials, scene.panels, scene.stimuli).into_iter();
            planar.filter(|t| scene.has(t)).collect()
        };
        (self.find)(self.stated, &self.scene.map_or(trials.clone(), own))
    }

    /// Returns the evidence in trials of another scene, for claims about smooth pulses on a planar body. Only the numbers of
    /// forces and sensors must agree.
    fn evidence_elsewhere(&self, trials: &[Trial]) -> Vec<Evidence> {
        let Some(scene) = self.scene.filter(|scene| scene.stimuli == "bell") else { return Vec::new() };
        let own: Vec<&Trial> = trials.iter().filter(|t| t.panels == scene.panels && scene.has(t)).collect();
        (self.find)(self.stated, &own)
    }
}

impl Scene {
    fn has(&self, trial: &Trial) -> bool {
        self.sensors.is_none_or(|sensors| trial.sensors == sensors)
    }
}

/// Adjusts the p-values of several claims within each set of samples. Findings that are no longer significant are rated open.
pub fn corrected(mut by_claims: Vec<Vec<Evidence>>) -> Vec<Vec<Evidence>> {
    for set in distinct(by_claims.iter().flatten().map(|e| e.set)) {
        let by_claim = CLAIMS.iter().zip(&mut by_claims);
        let mut of_set: Vec<(f64, &mut Evidence)> =
            by_claim.flat_map(|(claim, own)| own.iter_mut().map(|e| (claim.chance, e))).collect();
        of_set.retain(|(_, e)| e.set == set && e.chance.is_some());
        let chances = holm(&of_set.iter().filter_map(|(_, e)| e.chance).collect::<Vec<_>>());
        for ((none, evidence), chance) in of_set.into_iter().zip(chances) {
            evidence.chance = Some(chance);
            if chance > none && evidence.rating != Rating::Alike {
                evidence.rating = Rating::Open;
            }
        }
    }
    by_claims
}

/// Summarises evidence: the common rating, or the rating per decoder. Uses the held-out set if available, and no medians.
pub fn summary(evidence: &[Evidence]) -> (String, Option<Rating>) {
    let of_set = |set: &str| evidence.iter().any(|e| e.set == set);
    let counts = |e: &&Evidence| {
        e.set != Set::Median.name() && (e.set != Set::Test.name() || !of_set(Set::Holdout.name()))
    };
    summed(evidence.iter().filter(counts))
}

/// Returns the summary by medians over samples, if it differs from that by the means of the same trials.
pub fn by_medians(evidence: &[Evidence]) -> Option<String> {
    let of = |set: Set| evidence.iter().filter(move |e| e.set == set.name());
    let trials = |set| of(set).map(|e| (&e.who, e.trials)).collect::<Vec<_>>();
    let same = trials(Set::Holdout) == trials(Set::Median);
    let [means, medians] = [Set::Holdout, Set::Median].map(|set| summed(of(set)).0);
    (same && means != medians).then_some(medians)
}

/// Returns the rating that all evidence shares, or the rating per decoder.
fn summed<'a>(evidence: impl Iterator<Item = &'a Evidence>) -> (String, Option<Rating>) {
    let mut by: BTreeMap<Rating, Vec<&str>> = BTreeMap::new();
    for e in evidence {
        let list = by.entry(e.rating).or_default();
        if !list.contains(&&*e.who) {
            list.push(&e.who);
        }
    }
    match &by.iter().collect::<Vec<_>>()[..] {
        [] => ("not tested".into(), None),
        [(rating, _)] => (rating.name().into(), Some(**rating)),
        several => {
            let rated =
                several.iter().map(|(rating, who)| format!("{} with {}", rating.name(), who.join("; ")));
            (format!("depends on the decoder: {}", rated.collect::<Vec<_>>().join(" · ")), None)
        }
    }
}

/// Whether a trial has features that the paper's trials lack: another lattice, a body from a file, frozen shifts, pressed or
/// guided units, sensors that model chips or are not placed at random. Noise does not count.
pub fn is_other(trial: &Trial) -> bool {
    let extra = |path: &str| {
        ["optimise.frozen", "body.lattice"].contains(&path)
            || ["body.file", "body.compression", "body.guides"].iter().any(|key| path.starts_with(key))
            || path.starts_with("sensors.") && !["sensors.frame", "sensors.noise"].contains(&path)
    };
    trial.setting.leaves().keys().any(|path| extra(path))
}

/// Whether a trial is like the paper's: a body of squares at the initial angle, no frozen shifts, randomly placed sensors.
fn plain(trial: &Trial) -> bool {
    !trial.starts_from_design() && !is_other(trial)
}

fn tied(trial: &Trial) -> bool {
    trial.setting.contains_key("optimise.tie")
}

/// Returns the trials with this number and kind of forces on a planar body like the paper's, without tied shifts.
fn planar<'a>(trials: &[&'a Trial], panels: u64, stimuli: &str) -> Vec<&'a Trial> {
    let fits = |t: &&&Trial| {
        t.panels == panels
            && t.setting.text("stimuli.kind") == Some(stimuli)
            && t.setting.text("body.layout") == Some("planar")
            && plain(t)
            && !tied(t)
    };
    trials.iter().filter(fits).copied().collect()
}

/// Returns the trials with two forces of a kind and one sensor.
fn two_forces<'a>(trials: &[&'a Trial], stimuli: &str) -> Vec<&'a Trial> {
    planar(trials, 2, stimuli).into_iter().filter(|t| t.sensors == 1).collect()
}

/// Returns the differences of a group from others, or its decoder if there are none.
fn group_name(group: &Group) -> String {
    let parts = apart(&group.label);
    match parts.is_empty() {
        true => brains(&group.trials[0].setting)[0].clone(),
        false => parts.join(", "),
    }
}

fn ratio_evidence(who: String, set: &'static str, ratio: Ratio, stated: f64, note: String) -> Evidence {
    let Ratio { trials, ratio, interval, p_value: chance, detectable: tells, over, .. } = ratio;
    let (found, rating) = (Some(ratio), Rating::of(interval, stated));
    Evidence { who, set, trials, found, interval, chance, tells, note, over, rating }
}

/// Returns the evidence of each group and set.
fn by_set(groups: &[Group], mut say: impl FnMut(&Group, Set) -> Option<Evidence>) -> Vec<Evidence> {
    let of_sets =
        groups.iter().flat_map(|group| Set::with_errors(&group.trials).map(move |set| (group, set)));
    of_sets.filter_map(|(group, set)| say(group, set)).collect()
}

/// Returns a ratio per group and set.
fn ratio_by_set(trials: &[&Trial], stated: f64, ratio: fn(&[&Trial], Set) -> Option<Ratio>) -> Vec<Evidence> {
    by_set(&groups(trials, &[]), |group, set| {
        Some(ratio_evidence(group_name(group), set.name(), ratio(&group.trials, set)?, stated, String::new()))
    })
}

/// Returns the trials that have a text at a path.
fn of_text<'a>(trials: &[&'a Trial], path: &str, value: &str) -> Vec<&'a Trial> {
    trials.iter().filter(|t| t.setting.text(path) == Some(value)).copied().collect()
}

fn iterations(stated: f64, trials: &[&Trial]) -> Vec<Evidence> {
    let groups = groups(trials, &[]);
    let of_curve = |(group, by): (&Group, TrainingMeasure)| {
        let ratio = paired::iterations(&group.trials, by)?;
        Some(ratio_evidence(group_name(group), by.name(), ratio, stated, String::new()))
    };
    groups.iter().flat_map(|group| TrainingMeasure::ALL.map(|by| (group, by))).filter_map(of_curve).collect()
}

/// Returns the ratio of values in `first` to those in `second`, paired by cluster; geometric mean within a cluster.
fn paired_ratio(first: &[(Cluster, f64)], second: &[(Cluster, f64)]) -> Option<Ratio> {
    let mean = |of: &[(Cluster, f64)], cluster: Cluster| {
        let own: Vec<f64> = of.iter().filter(|(c, _)| *c == cluster).map(|(_, x)| *x).collect();
        (!own.is_empty()).then(|| geometric_mean(&own))
    };
    let clusters = distinct(first.iter().map(|(cluster, _)| *cluster));
    let ratio = |c: Cluster| Some((c, mean(first, c)? / mean(second, c)?));
    Ratio::of(clusters.into_iter().filter_map(ratio))
}

/// Returns cluster and number of each trial that has it.
fn each(trials: &[&Trial], number: impl Fn(&Trial) -> Option<f64>) -> Vec<(Cluster, f64)> {
    without_repeats(trials, number).map(|(t, number)| (t.cluster, number)).collect()
}

/// Error of the initial body divided by that of the trained body.
fn gain(trial: &Trial, set: Set) -> Option<f64> {
    Some(trial.error(BodyState::Initial, set)? / trial.error(BodyState::Optimised, set)?)
}

fn blows_more(stated: f64, trials: &[&Trial]) -> Vec<Evidence> {
    let both = [two_forces(trials, "irregular"), two_forces(trials, "bell")].concat();
    by_set(&groups(&both, &["stimuli."]), |group, set| {
        let gains =
            |kind: &str| each(&of_text(&group.trials, "stimuli.kind", kind), |trial| gain(trial, set));
        let ratio = paired_ratio(&gains("irregular"), &gains("bell"))?;
        Some(ratio_evidence(group_name(group), set.name(), ratio, stated, String::new()))
    })
}

fn random_bodies(stated: f64, trials: &[&Trial], than: BodyState) -> Vec<Evidence> {
    let joint = of_text(&of_text(trials, "stimuli.kind", "bell"), "optimise.protocol", "joint");
    let of_scene = |t: &&Trial| (t.panels, t.sensors) == (2, 1) && !tied(t);
    let trials: Vec<&Trial> = joint.into_iter().filter(of_scene).collect();
    by_set(&random_groups(&trials), |group, set| {
        let ratio = random(&group.trials, set)?.ratios[than as usize].take()?;
        let note = format!("{} of {} random bodies worse", ratio.above_one, ratio.trials);
        Some(ratio_evidence(group_name(group), set.name(), ratio, stated, note))
    })
}

/// The ratio over M with the lowest interval: if it is above 1, all are.
fn every_number(stated: f64, trials: &[&Trial]) -> Vec<Evidence> {
    by_set(&curves(trials, CURVE), |group, set| {
        let at = |m: f64| -> Option<(f64, Ratio)> {
            let of: Vec<&Trial> = group.trials.iter().filter(|t| t.sensors as f64 == m).copied().collect();
            Some((m, error_ratio(&of, set)?))
        };
        let numbers = places(&observations(&group.trials, BodyState::Initial, set, |t| t.sensors));
        let ratios: Vec<(f64, Ratio)> = numbers.into_iter().filter_map(at).collect();
        let low = |r: &Ratio| r.interval.map_or(0.0, |i| i.low);
        let (m, ratio) = ratios.iter().min_by(|a, b| low(&a.1).total_cmp(&low(&b.1)))?;
        let each = ratios.iter().map(|(m, r)| format!("M = {m}: {:.2}", r.ratio));
        let note = format!("lowest interval at M = {m} ({})", each.collect::<Vec<_>>().join(", "));
        Some(ratio_evidence(group_name(group), set.name(), ratio.clone(), stated, note))
    })
}

/// Numbers of sensors of a whole curve, as an elbow needs.
const CURVE: usize = 4;

/// Returns the groups in which M varies.
fn over_sensors<'a>(trials: &[&'a Trial]) -> Vec<Group<'a>> {
    groups(trials, SENSORS).into_iter().filter(|group| group.varies(|t| t.sensors)).collect()
}

/// The same, restricted to clusters with a common set of M, and to this set: of those with at least `points` M, if there are any,
/// the one that keeps the most trials.
fn curves<'a>(trials: &[&'a Trial], points: usize) -> Vec<Group<'a>> {
    let mut groups = over_sensors(trials);
    for group in &mut groups {
        let mut numbers: BTreeMap<Cluster, BTreeSet<u64>> = BTreeMap::new();
        group.trials.iter().for_each(|t| _ = numbers.entry(t.cluster).or_default().insert(t.sensors));
        let with = |grid: &BTreeSet<u64>| numbers.values().filter(|own| own.is_superset(grid)).count();
        let Some(grid) = numbers.values().max_by_key(|own| (own.len() >= points, own.len() * with(own)))
        else {
            continue;
        };
        group.trials.retain(|t| grid.contains(&t.sensors) && numbers[&t.cluster].is_superset(grid));
    }
    groups.retain(|group| group.varies(|t| t.sensors));
    groups
}

/// Returns the evidence of each group for both quantities of its curve, and for each set.
fn by_height(
    groups: &[Group],
    say: impl Fn(&Group, Set, ErrorScale, String) -> Option<Evidence>,
) -> Vec<Evidence> {
    let subject = |group: &Group, height: ErrorScale| format!("{}, {}", group_name(group), height.name());
    let of = |height| by_set(groups, |group, set| say(group, set, height, subject(group, height)));
    ErrorScale::ALL.into_iter().flat_map(of).collect()
}

fn elbow_at(stated: f64, trials: &[&Trial]) -> Vec<Evidence> {
    by_height(&curves(trials, CURVE), |group, set, height, who| {
        let points = observations(&group.trials, BodyState::Optimised, set, |t| t.sensors);
        let elbow = elbow(&points, height).ok()?;
        let votes: Vec<String> =
            elbow.votes.iter().map(|(m, share)| format!("M = {m}: {:.0} %", 100.0 * share)).collect();
        let (verdict, none) = (verdict_text(elbow.verdict), elbow.share(None));
        let rating = match elbow.share(Some(stated)).or(none.map(|_| 0.0)) {
            Some(share) if share > SURE => Rating::Holds,
            Some(share) if share < 1.0 - SURE => Rating::Fails,
            _ => Rating::Open,
        };
        let votes = none.map(|_| format!("; votes {}", votes.join(", "))).unwrap_or_default();
        let note = format!("{verdict}{votes}");
        let (set, trials, over) = (set.name(), points.len(), elbow.over);
        let (found, interval, chance, tells) = (None, None, None, None);
        Some(Evidence { who, set, trials, found, interval, chance, tells, note, over, rating })
    })
}

/// Error of the initial body with the most sensors divided by that of the trained body with `few`.
fn few_sensors_ratio(stated: f64, few: u64, trials: &[&Trial]) -> Vec<Evidence> {
    by_set(&curves(trials, 2), |group, set| {
        let most = group.trials.iter().map(|t| t.sensors).max()?;
        let of = |sensors: u64, body: BodyState| -> Vec<(Cluster, f64)> {
            let own: Vec<&Trial> = group.trials.iter().filter(|t| t.sensors == sensors).copied().collect();
            each(&own, |t| t.error(body, set))
        };
        let ratio = paired_ratio(&of(most, BodyState::Initial), &of(few, BodyState::Optimised))?;
        let note = format!("{few} sensors against {most}");
        Some(ratio_evidence(group_name(group), set.name(), ratio, stated, note))
    })
}

/// Standard deviation of the error over placements on the initial body divided by that on the trained body, all M together.
fn placements(stated: f64, trials: &[&Trial]) -> Vec<Evidence> {
    by_height(&over_sensors(trials), |group, set, height, who| {
        let points_by_body = BodyState::ALL.map(|body| observations(&group.trials, body, set, |t| t.sensors));
        let clusters = clusters(points_by_body.iter().flatten());
        let grids = [Grid::new(&points_by_body[0], &clusters), Grid::new(&points_by_body[1], &clusters)];
        let units = Resampling::new(&clusters);
        let statistic = |weights: &[f64]| {
            let [initial, trained] = [0, 1].map(|i| scatter(&grids[i], height, &clusters, weights));
            Some(0.5 * (initial? / trained?).ln())
        };
        let worst = |body: usize| -> Vec<String> {
            let at = |m: &f64| {
                let here: Vec<Observation> =
                    points_by_body[body].iter().filter(|o| o.at == *m).copied().collect();
                spread(&here).map(|s| format!("{:.2}", s.ratio))
            };
            places(&points_by_body[body]).iter().filter_map(at).collect()
        };
        let ratio = Ratio::by(&units, group.trials.len(), 0, statistic)?;
        let [initial, trained] = [0, 1].map(|body| worst(body).join(", "));
        let note = format!("largest / smallest error, per M: initial {initial} → trained {trained}");
        Some(ratio_evidence(who, set.name(), ratio, stated, note))
    })
}

/// Sum over M and seeds of the weighted variance of y; `None` if it is 0.
fn scatter(grid: &Grid, height: ErrorScale, clusters: &[Cluster], weights: &[f64]) -> Option<f64> {
    let mut cells: BTreeMap<(usize, u64), [f64; 3]> = BTreeMap::new();
    for &(cluster, place, log) in &grid.points {
        let [n, sum, squares] = cells.entry((place, clusters[cluster].seed)).or_default();
        let (w, y) = (weights[cluster], height.of(log));
        (*n, *sum, *squares) = (*n + w, *sum + w * y, *squares + w * y * y);
    }
    let of = |[n, sum, squares]: &[f64; 3]| {
        if *n > 0.0 { (squares - sum * sum / n) / (n - 1.0).max(1.0) } else { 0.0 }
    };
    let total: f64 = cells.values().map(of).sum();
    (total > 0.0).then_some(total)
}

/// Error of the trained body with the fewest parameters divided by that with the most: discs of one size with smaller units,
/// and discs with fewer tied shifts.
fn complexity(stated: f64, trials: &[&Trial]) -> Vec<Evidence> {
    let disc = |t: &&&Trial| t.setting.text("body.layout") == Some("circular") && plain(t);
    let disc: Vec<&Trial> = trials.iter().filter(disc).copied().collect();
    let free: Vec<&Trial> = disc.iter().filter(|t| !tied(t)).copied().collect();
    let mut found = Vec::new();
    for (variation_name, mut groups) in [
        ("smaller units, one size of body", groups(&free, COMPLEXITY)),
        ("fewer tied shifts, one size of body", groups(&disc, FREEDOM)),
    ] {
        groups.retain(|group| group.varies(|t| t.design_parameters));
        found.extend(by_set(&groups, |group, set| {
            let numbers = || group.trials.iter().map(|t| t.design_parameters);
            let (few, many) = (numbers().min()?, numbers().max()?);
            let at = |n: u64| -> Vec<&Trial> {
                group.trials.iter().filter(|t| t.design_parameters == n).copied().collect()
            };
            let errors = |n: u64, body: BodyState| each(&at(n), |t| t.error(body, set));
            let ratio_of_errors = |body: BodyState| paired_ratio(&errors(few, body), &errors(many, body));
            let ratio = ratio_of_errors(BodyState::Optimised)?;
            let initial = ratio_of_errors(BodyState::Initial)
                .map_or(String::new(), |r| format!("; initial body {:.3}", r.ratio));
            let note = format!("{few} → {many} parameters{initial}");
            let brain = &brains(&group.trials[0].setting)[0];
            let of_size = |part: &str| {
                let path = part.split(" = ").next().unwrap_or(part);
                part.ends_with(" units")
                    || part.ends_with(" units across")
                    || COMPLEXITY.contains(&path)
                    || WITH_SPACING.iter().any(|(with, _)| *with == path)
            };
            let own = |part: &&str| *part != brain && !of_size(part);
            let mut name = vec![brain.as_str()];
            name.extend(apart(&group.label).into_iter().filter(own));
            name.push(variation_name);
            Some(ratio_evidence(name.join(", "), set.name(), ratio, stated, note))
        }));
    }
    found
}

/// Error of the trained body without the implicit term divided by that with it.
fn implicit(stated: f64, trials: &[&Trial]) -> Vec<Evidence> {
    let has = |t: &&Trial| t.setting.contains_key("optimise.gradient");
    let paper: Vec<&Trial> = two_forces(trials, "bell").into_iter().filter(has).collect();
    by_set(&groups(&paper, &["optimise.gradient"]), |group, set| {
        let errors = |terms: &str| {
            each(&of_text(&group.trials, "optimise.gradient", terms), |t| t.error(BodyState::Optimised, set))
        };
        let ratio = paired_ratio(&errors("direct"), &errors("implicit"))?;
        Some(ratio_evidence(group_name(group), set.name(), ratio, stated, String::new()))
    })
}

#[cfg(test)]
mod tests;
