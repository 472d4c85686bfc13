//! Error by decoder: a figure, and one sentence per setting.

use super::casts::MOST_SETTINGS;
use super::words::left_out;
use crate::analysis::brains::{DecoderErrors, errors_by_decoder};
use crate::analysis::data::{BRAINS, Group, groups};
use crate::analysis::numbers::distinct;
use crate::analysis::{BodyState, DecisionTerms, Question, Trial};
use crate::look::{Answer, Axis, Figure, Plot, Scale, number};

/// Classes of the trained bodies' lines, by the decoder in training.
const TRAINED: [&str; 5] = ["optimised", "front", "fourth", "fifth", "truth"];

/// Errors of linear decoders against memory, and against delay after the instant; dots: networks.
pub fn figure(trials: &[Trial]) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().filter(|t| !t.starts_random()).collect();
    let all = groups(&refs, BRAINS).into_iter().map(|group| (group.label, errors_by_decoder(&group.trials)));
    let drawn: Vec<_> = all.filter(|(_, reads)| reads.iter().any(|read| read.whole)).collect();
    let mut pictures = Vec::new();
    let mut trained_names =
        distinct(drawn.iter().flat_map(|(_, reads)| reads).map(|read| read.trained_with.as_str()));
    trained_names.truncate(TRAINED.len());
    let shown = |read: &&DecoderErrors| trained_names.contains(&read.trained_with.as_str());
    for (label, reads) in drawn.iter().take(MOST_SETTINGS) {
        let linear: Vec<&DecoderErrors> = reads.iter().filter(|read| !read.own && shown(read)).collect();
        let networks: Vec<_> = reads.iter().filter(|r| r.own && r.decoder != "linear" && shown(r)).collect();
        let errors = |reads: &[&DecoderErrors]| reads.iter().flat_map(|r| r.errors).collect::<Vec<f64>>();
        let even: Vec<_> = linear.iter().filter(|r| r.memory[0] == r.memory[1]).copied().collect();
        let past: Vec<_> = linear.iter().filter(|r| r.memory[0] > r.memory[1] || r.whole).copied().collect();
        let reach = |r: &DecoderErrors| r.memory[0].max(r.memory[1]).max(1e-4);
        let all = [even.clone(), networks.clone()].concat();
        let x = Axis::new("memory, each way (s)", Scale::Log, all.iter().map(|r| reach(r)));
        let mut memory = Plot::new(label, x, Axis::new("held-out error (%)", Scale::Log, errors(&all)));
        curves(&mut memory, &even, &trained_names, reach);
        for read in &networks {
            let class = class(&trained_names, &read.trained_with);
            let text = |body: BodyState| {
                let error = number(read.errors[body as usize]);
                format!("{}, error of {}: {error} %", whose(body, &read.trained_with), read.decoder)
            };
            let at = |body: BodyState| ((reach(read), read.errors[body as usize]), text(body));
            memory.dots("initial", [at(BodyState::Initial)]);
            memory.dots(class, [at(BodyState::Optimised)]);
        }
        pictures.push(memory.picture());
        // the whole past, with increasing delay
        let waits = past.iter().map(|r| r.memory[1]);
        let x = Axis::new("delay after the instant, with the whole past (s)", Scale::Linear, waits);
        let mut delay = Plot::new(label, x, Axis::new("held-out error (%)", Scale::Log, errors(&past)));
        curves(&mut delay, &past, &trained_names, |r| r.memory[1]);
        pictures.push(delay.picture());
    }
    let mut entries = vec![("initial", "initial body".to_owned())];
    let entry = |name: &&str| (class(&trained_names, name), format!("body trained with {name}"));
    entries.extend(trained_names.iter().map(entry));
    Figure::some(
        "brains",
        "Body or decoder?",
        format!(
            "Lines: held-out error of a linear decoder, fitted by least squares to the signals around each \
             instant. Left: against its memory before and after the instant. Right: with the whole past, against its \
             delay after the instant. Dots: networks, at the memory given by their shape.{}",
            left_out(drawn.len(), MOST_SETTINGS)
        ),
        entries,
        pictures,
        || Question::Brains.answer(trials, DecisionTerms::default()),
    )
}

fn curves(plot: &mut Plot, reads: &[&DecoderErrors], with: &[&str], x: impl Fn(&DecoderErrors) -> f64) {
    for (n, trained_with) in with.iter().enumerate() {
        let mut own: Vec<_> = reads.iter().filter(|r| r.trained_with == *trained_with).collect();
        own.sort_by(|a, b| x(a).total_cmp(&x(b)));
        for body in BodyState::ALL {
            // the initial body does not depend on the decoder in training
            if body == BodyState::Initial && n > 0 {
                continue;
            }
            let class = if body == BodyState::Initial { "initial" } else { class(with, trained_with) };
            plot.line(class, own.iter().map(|r| (x(r), r.errors[body as usize])));
            let dot = |r: &&&DecoderErrors| {
                let (error, [before, after]) = (r.errors[body as usize], r.memory.map(number));
                let who = whose(body, trained_with);
                ((x(r), error), format!("{who}, {before} s before and {after} s after: {} %", number(error)))
            };
            plot.dots(class, own.iter().map(dot));
        }
    }
}

fn whose(body: BodyState, trained_with: &str) -> String {
    match body {
        BodyState::Initial => "initial body".into(),
        BodyState::Optimised => format!("body trained with {trained_with}"),
    }
}

fn class(with: &[&str], trained_with: &str) -> &'static str {
    let at = with.iter().position(|w| *w == trained_with).unwrap_or(0);
    TRAINED[at.min(TRAINED.len() - 1)]
}

/// Compares a linear decoder of the whole sample with the trials' own decoders; one sentence per setting.
pub fn answers(trials: &[Trial]) -> Vec<Answer> {
    let refs: Vec<&Trial> = trials.iter().filter(|t| !t.starts_random()).collect();
    let said = |group: &Group| {
        Some(Answer::new("brains", None, sentence(&group.label, &errors_by_decoder(&group.trials))?))
    };
    groups(&refs, BRAINS).iter().filter_map(said).collect()
}

fn sentence(label: &str, reads: &[DecoderErrors]) -> Option<String> {
    let begins = |with: &str| reads.iter().find(|r| r.whole && r.trained_with.starts_with(with));
    let whole =
        |with: &str| reads.iter().find(|r| r.whole && r.trained_with == with).or_else(|| begins(with));
    let own = reads.iter().filter(|r| r.own && r.decoder != "linear");
    let best = own.min_by(|a, b| a.errors[1].total_cmp(&b.errors[1]));
    let text = match (best, whole("linear")) {
        (Some(best), trained) => {
            let untouched = whole(&best.trained_with).or(trained)?.errors[0];
            let than = if untouched < best.errors[1] { "less" } else { "more" };
            let mut text = format!(
                "the error of a linear decoder of the whole sample is {} % on the initial body, {than} than that of {} on the \
                 body trained with {} ({} %)",
                number(untouched),
                best.decoder,
                best.trained_with,
                number(best.errors[1])
            );
            if let Some(own) = whole(&best.trained_with) {
                text += &format!(". On that body it is {} %", number(own.errors[1]));
            }
            if let Some(other) = trained.filter(|_| best.trained_with != "linear") {
                let error = number(other.errors[1]);
                text += &format!(". On the body trained with the linear decoder it is {error} %");
            }
            text
        }
        (None, Some(read)) => {
            let [initial, optimised] = read.errors.map(number);
            format!(
                "the error of a linear decoder of the whole sample is {initial} % on the initial body and {optimised} % on the \
                 body trained with it"
            )
        }
        (None, None) => return None,
    };
    Some(format!("{label}: {text}."))
}
