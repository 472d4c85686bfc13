//! Answers in sentences, the strongest evidence first.

use super::words::interval;
use crate::analysis::data::{Group, SENSORS, groups, observations, without_repeats};
use crate::analysis::decision::{Decision, Decisions, decisions};
use crate::analysis::kinds::brains_by_trial;
use crate::analysis::numbers::{distinct, geometric_mean, mean as mean_of};
use crate::analysis::paired::Ratio;
use crate::analysis::placed::{PlacementComparison, placed};
use crate::analysis::random::{random, random_groups};
use crate::analysis::sensors::fewer;
use crate::analysis::tables::{nonlinear, verdict_text};
use crate::analysis::{BodyState, DecisionTerms, ErrorScale, Interval, Set, Trial, Verdict, elbow, paired};
use crate::look::{Answer, number};
use crate::plan::counted;

/// Fraction of votes from which an answer counts as good news.
const SURE: f64 = 0.95;

/// Answers of the trials to the questions of a report.
pub fn answers(trials: &[Trial], terms: DecisionTerms) -> Vec<Answer> {
    let refs: Vec<&Trial> = trials.iter().filter(|t| !t.starts_random()).collect();
    let mut said = Vec::new();
    let of_trials = brains_by_trial(&refs);
    let kinds = distinct(of_trials.clone());
    let sets = [(Set::Holdout, "the held-out set"), (Set::Test, "the test set, which selected the body")];
    for kind in &kinds {
        let trials_of_kind = refs.iter().zip(&of_trials).filter(|(_, of)| *of == kind);
        let refs: Vec<&Trial> = trials_of_kind.map(|(trial, _)| *trial).collect();
        let subject = match (&kind[0], &kind[1]) {
            _ if kinds.len() == 1 => String::new(),
            (by, with) => format!("Body trained with {with}, decoder {by}. "),
        };
        let settings = groups(&refs, &[]).len();
        let pooled = match settings {
            1 => String::new(),
            _ => format!(
                " This pools {settings} settings; `metasense analyse --question paired` lists them separately."
            ),
        };
        for (set, what) in sets {
            let Some(r) = paired::error_ratio(&refs, set) else { continue };
            let [initial, optimised] = means(&refs, |t, body| t.error(body, set));
            // held-out results come first; results on the test set, which selected the body, stand beside the figure
            let figure = if set == Set::Holdout { "" } else { "pairs" };
            let medians = match set {
                Set::Holdout => by_medians(|set| paired::error_ratio(&refs, set)),
                _ => String::new(),
            };
            said.push(Answer::new(
                figure,
                verdict(&r),
                format!(
                    "{subject}On {what}, the error of the initial body is {} times that of the trained body ({initial} % against \
                     {optimised} %, {}); the trained body is better in {} of {}.{medians}{pooled}",
                    number(r.ratio),
                    interval(&r),
                    r.above_one,
                    counted(r.trials, "trial")
                ),
            ));
        }
    }
    said.extend(super::brains::answers(trials));
    said.extend(super::casts::answers(trials));
    said.extend(super::transfer::answers(trials));
    said.extend(super::tasks::answers(trials));
    said.extend(long_answer(&refs));
    for group in groups(&refs, SENSORS).iter().filter(|g| g.varies(|t| t.sensors)) {
        said.extend(sensors(group, terms));
    }
    said.extend(placed(&refs).iter().filter_map(placing));
    said.extend(linear_model(&refs));
    let all: Vec<&Trial> = trials.iter().collect();
    said.extend(random_groups(&all).iter().filter_map(random_bodies));
    said
}

/// The part of the signals that a linear model of the bodies does not explain.
fn linear_model(trials: &[&Trial]) -> Option<Answer> {
    let mean = |body, kind| mean_of(&nonlinear(trials, body, kind)).map(number);
    let [initial, optimised] = BodyState::ALL.map(|body| Some([mean(body, 0)?, mean(body, 1)?]));
    let ([a, w], [b, v]) = (initial?, optimised?);
    Some(Answer::new(
        "modes",
        None,
        format!(
            "A linear model of the body at rest does not explain {a} % of the accelerations and {w} % of the angular velocities \
             of the initial body; for the trained body, {b} % and {v} % (means over trials)."
        ),
    ))
}

fn verdict(ratio: &Ratio) -> Option<bool> {
    ratio.interval.and_then(Interval::is_above_one)
}

/// A sentence if medians over samples lead to another verdict than means; else empty.
fn by_medians(ratio: impl Fn(Set) -> Option<Ratio>) -> String {
    let said = |(ratio, verdicts): (Ratio, String)| {
        format!(
            " Means and medians over samples disagree ({verdicts}): by medians the ratio is {} ({}).",
            number(ratio.ratio),
            interval(&ratio)
        )
    };
    paired::disagreement(ratio).map_or(String::new(), said)
}

/// Geometric mean errors of both bodies over the trials that have both.
fn means(trials: &[&Trial], error: impl Fn(&Trial, BodyState) -> Option<f64>) -> [String; 2] {
    let both = |t: &Trial| Some([error(t, BodyState::Initial)?, error(t, BodyState::Optimised)?]);
    let errors: Vec<[f64; 2]> = without_repeats(trials, both).map(|(_, errors)| errors).collect();
    [0, 1].map(|b| number(geometric_mean(&errors.iter().map(|of| of[b]).collect::<Vec<_>>())))
}

fn long_answer(trials: &[&Trial]) -> Option<Answer> {
    let iterations = trials.iter().filter_map(|t| t.long_iterations()).max()?;
    let trials: Vec<_> = trials.iter().filter(|t| t.long_iterations() == Some(iterations)).copied().collect();
    let ratio = paired::long_ratio(&trials, Set::Holdout)?;
    let [initial, optimised] = means(&trials, |t, body| t.long_error(body, Set::Holdout));
    Some(Answer::new(
        "losses",
        verdict(&ratio),
        format!(
            "After {iterations} iterations of the decoder, the held-out error of the initial body is still {} times that of the trained \
             body ({initial} % against {optimised} %, {}).{}",
            number(ratio.ratio),
            interval(&ratio),
            by_medians(|set| paired::long_ratio(&trials, set))
        ),
    ))
}

/// Gain from training beyond that from placing sensors, at the largest M for which trials have both.
fn placing(found: &PlacementComparison) -> Option<Answer> {
    let level = found.levels.last()?;
    let set = Set::Holdout;
    let [by_placing, by_training] = [level.gain_from_placing(set)?, level.gain_from_training(set)?];
    let error = |searched, body| level.error(searched, body, set).map(number);
    let needed = |searched, body| {
        let of = |error| found.needed(searched, body, set, error).to_string();
        [20.0, 10.0, 5.0].map(of).join(", ")
    };
    Some(Answer::new(
        "placed",
        verdict(&by_training),
        format!(
            "{}, M = {}: sensors placed by a search instead of at random reduce the error of the initial body from {} to {} % (factor \
             {}, {}). Training the body reduces it further to {} % (factor {}, {}).{} Sensors needed for an error \
             of 20, 10 and 5 % (95 % interval): initial body {} at random, {} placed; trained body {} at random, {} placed.",
            found.label,
            level.sensors,
            error(false, BodyState::Initial)?,
            error(true, BodyState::Initial)?,
            number(by_placing.ratio),
            interval(&by_placing),
            error(true, BodyState::Optimised)?,
            number(by_training.ratio),
            interval(&by_training),
            by_medians(|set| level.gain_from_training(set)),
            needed(false, BodyState::Initial),
            needed(true, BodyState::Initial),
            needed(false, BodyState::Optimised),
            needed(true, BodyState::Optimised),
        ),
    ))
}

/// The elbow of error against M, and the smallest sufficient M on the trained body.
fn sensors(group: &Group, terms: DecisionTerms) -> Vec<Answer> {
    let by = |body, set| observations(&group.trials, body, set, |t| t.sensors);
    let curve = |body| by(body, Set::Holdout);
    let told = |body, height| match elbow(&curve(body), height) {
        Err(why) => why.to_string(),
        Ok(found) => {
            let share = match found.verdict {
                Verdict::At(m) => found.share(Some(m)),
                Verdict::Undecided(place) => found.share(place),
                Verdict::NoElbow | Verdict::WithoutVote(_) => found.share(None),
            };
            let votes = share.map(|share| format!("{:.0} % of votes", 100.0 * share));
            let mut told = Vec::from_iter(votes);
            told.extend(found.without_largest.map(|m| match m {
                m if m == found.broken_stick => "the same without the largest M".into(),
                Some(m) => format!("M = {m} without the largest M"),
                None => "none without the largest M".into(),
            }));
            let verdict = verdict_text(found.verdict);
            if told.is_empty() { verdict } else { format!("{verdict} ({})", told.join("; ")) }
        }
    };
    let [initial, optimised] = BodyState::ALL.map(|body| {
        let [percent, logarithm] = ErrorScale::ALL.map(|height| told(body, height));
        match percent == logarithm {
            true => percent,
            false => format!("of the error in %: {percent}; in logarithms: {logarithm}"),
        }
    });
    let text = match initial == optimised {
        true => format!("{}: both bodies: {initial}.", group.label),
        false => format!("{}: trained body: {optimised}. Initial body: {initial}.", group.label),
    };
    let mut said = vec![Answer::new("sensors", None, text)];
    for (body, height) in
        BodyState::ALL.into_iter().flat_map(|body| ErrorScale::ALL.map(|height| (body, height)))
    {
        let [mean, median] = [Set::Holdout, Set::Median].map(|set| by(body, set));
        let same = mean.len() == median.len();
        if let (true, Ok(mean), Ok(median)) = (same, elbow(&mean, height), elbow(&median, height))
            && mean.verdict != median.verdict
        {
            let (who, of) = (format!("{} body", body.word()), height.name());
            let [mean, median] = [mean, median].map(|elbow| verdict_text(elbow.verdict));
            let text = format!("disagree on the {who} ({of}): {mean} by means, {median} by medians.");
            let text = format!("{}: means and medians over samples {text}", group.label);
            said.push(Answer::new("sensors", Some(false), text));
        }
    }
    let [initial, optimised] = BodyState::ALL.map(|body| decisions(&curve(body), terms));
    let price = terms.price.map_or(String::new(), |p| format!("smallest error + {} % × M", number(p)));
    let within = format!("smallest M within {} % of the best", number(100.0 * terms.within));
    for (what, of) in [
        (within, (|d| Some(&d.within)) as fn(&Decisions) -> Option<&Decision>),
        (price, |d| d.priced.as_ref()),
    ] {
        let told = |decided: &Option<Decisions>| decided.as_ref().and_then(of).map(decision);
        if let (Some(initial), Some(optimised)) = (told(&initial), told(&optimised)) {
            said.push(Answer::new(
                "sensors",
                None,
                format!("{}: {what}: trained body M = {optimised}; initial body M = {initial}.", group.label),
            ));
        }
    }
    if let Some(f) = fewer(&curve(BodyState::Initial), &curve(BodyState::Optimised)) {
        let initial = format!("the initial body with M = {} ({} %)", f.most, number(f.initial_error));
        let text = match (f.fewest, f.optimised_error) {
            (Some(m), Some(error)) => {
                let least = if m == f.most { ", but not with fewer" } else { "" };
                let votes = f.share.map_or(f.over.clone(), |part| format!("{:.0} % of votes", 100.0 * part));
                format!(
                    "the trained body with M = {m} ({} %) has less error than {initial}{least} ({votes})",
                    number(error)
                )
            }
            _ => format!(
                "the trained body has less error than {initial} for none of the tried numbers of sensors"
            ),
        };
        let verdict = match f.fewest {
            Some(_) => f.share.is_some_and(|share| share >= SURE).then_some(true),
            None => Some(false),
        };
        // verdicts come first, other answers stand beside the figure
        let figure = if verdict.is_some() { "" } else { "sensors" };
        said.push(Answer::new(figure, verdict, format!("{}: {text}.", group.label)));
    }
    said
}

fn decision(decision: &Decision) -> String {
    let votes = decision.share(decision.at).map_or("too few placements or seeds to vote".into(), |share| {
        format!("{:.0} % of votes", 100.0 * share)
    });
    let hangs = match decision.without_largest == decision.at {
        true => "the same without the largest M".into(),
        false => format!("{} without the largest M", decision.without_largest),
    };
    format!("{} ({votes}; {hangs})", decision.at)
}

fn random_bodies(group: &Group) -> Option<Answer> {
    let found = random(&group.trials, Set::Holdout)?;
    let [initial, optimised] = found.ratios;
    let (initial, optimised) = (initial?, optimised?);
    Some(Answer::new(
        "random",
        verdict(&optimised),
        format!(
            "{}: the held-out error of {} random bodies is {} times that of the initial body ({} of {} are worse) and {} times that of \
             the trained body ({}).{}",
            group.label,
            found.errors.len(),
            number(initial.ratio),
            initial.above_one,
            initial.trials,
            number(optimised.ratio),
            interval(&optimised),
            by_medians(|set| random(&group.trials, set)?.ratios[BodyState::Optimised as usize].take())
        ),
    ))
}
