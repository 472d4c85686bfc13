//! Error over casts by body and decoder: a figure, and sentences per setting.

use metasense_worker::problem::INVERTED_PER_CAST;

use super::words::left_out;
use crate::analysis::bodies::BodyTrials;
use crate::analysis::casts::{CastErrors, Setting, settings};
use crate::analysis::numbers::{distinct, in_order};
use crate::analysis::trial::CastDecoder;
use crate::analysis::{DecisionTerms, Question, Trial};
use crate::look::{Answer, Axis, Figure, Picture, Plot, Scale, number};

/// Maximum number of settings in the figure; the data contain all.
pub(super) const MOST_SETTINGS: usize = 4;

/// Classes of the bodies' marks, the initial body first. Further bodies are only in the data.
pub(super) const CLASSES: [&str; 5] = ["initial", "optimised", "front", "fourth", "fifth"];

/// One position per decoder with the bodies side by side: dots at the median, lines up to the 90th percentile.
pub fn figure(trials: &[Trial]) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let found = settings(&refs);
    let is_read = |body: &&BodyTrials| body.brains().into_iter().any(|by| body.errors_of(by).is_some());
    let read = found.iter().flat_map(|setting| &setting.bodies).filter(is_read);
    let names = distinct_names(read.map(|body| &body.name[..]));
    Figure::some(
        "casts",
        "How does casting affect the error?",
        format!(
            "Held-out error on casts that were not used in training and vary according to [variation]. Dots: \
             the median cast; lines: up to the 90th percentile; geometric means over trials. First position: the body \
             as designed. Others: decoders fitted to the body as designed (for design), to other casts (for casts), and \
             to these casts and records of each cast. Trained: for the body as designed (nominal), or over casts, by \
             objective.{}",
            left_out(found.len(), MOST_SETTINGS)
        ),
        legend(&names),
        found.iter().take(MOST_SETTINGS).map(|setting| picture(setting, &names)).collect(),
        || Question::Casts.answer(trials, DecisionTerms::default()),
    )
}

fn picture(setting: &Setting, names: &[&str]) -> Picture {
    let brains = brains(setting);
    let mut marks = Vec::new();
    for (n, name) in names.iter().enumerate() {
        let Some(body) = setting.bodies.iter().find(|body| body.name == *name) else { continue };
        let aside = aside(n, names.len());
        let read: Vec<Option<CastErrors>> = brains.iter().map(|by| body.errors_of(*by)).collect();
        // with the trial's own kind of decoder: networks come first
        let designed = read.iter().flatten().find_map(|left| left.designed.as_ref());
        let designed = designed.map(|error| {
            (aside, [error.ratio; 2], format!("{name}, as designed: {} %", number(error.ratio)))
        });
        let cast = read.iter().zip(&brains).enumerate().filter_map(|(i, (left, by))| {
            let [median, most] = left.as_ref()?.errors.each_ref().map(|error| error.ratio);
            let text = format!("{name}, {}: {} [{}] %", brain(*by), number(median), number(most));
            Some(((i + 1) as f64 + aside, [median, most], text))
        });
        let all: Vec<_> = designed.into_iter().chain(cast).collect();
        marks.push((CLASSES[n], all));
    }
    let places = std::iter::once("as designed".to_owned()).chain(brains.iter().map(|by| tick(*by)));
    side_by_side(&setting.label, places.collect(), marks)
}

/// Position on the axis, two errors (%) and text of a dot at the first error; a line leads to the second.
pub(super) type CastMark = (f64, [f64; 2], String);

/// A plot of the marks of each class at named positions.
pub(super) fn side_by_side(label: &str, places: Vec<String>, marks: Vec<(&str, Vec<CastMark>)>) -> Picture {
    let count = places.len() as f64;
    let places = places.into_iter().enumerate().map(|(i, name)| (i as f64, name)).collect();
    let x = Axis::new("", Scale::Linear, [-0.5, count - 0.5]).with_names(places);
    let errors: Vec<f64> = marks.iter().flat_map(|(_, marks)| marks.iter().flat_map(|mark| mark.1)).collect();
    let y = Axis::new("held-out error (%)", Scale::Log, errors);
    let mut plot = Plot::new(label, x, y).sized((45.0 + 85.0 * count).max(320.0), 300.0);
    for (class, marks) in marks {
        for (x, ends, _) in &marks {
            plot.line(class, ends.map(|error| (*x, error)));
        }
        plot.dots(class, marks.into_iter().map(|(x, [first, _], text)| ((x, first), text)));
    }
    plot.picture()
}

/// Offset of the n-th of `bodies` within its position.
pub(super) fn aside(n: usize, bodies: usize) -> f64 {
    0.7 * ((n as f64 + 0.5) / bodies as f64 - 0.5)
}

/// Distinct names of bodies, at most one per class.
pub(super) fn distinct_names<'a>(bodies: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut names = in_order(bodies);
    names.truncate(CLASSES.len());
    names
}

/// Legend entries of these bodies.
pub(super) fn legend(names: &[&str]) -> Vec<(&'static str, String)> {
    let entry = |(name, class): (&&str, &'static str)| {
        let text = if *name == "initial" { "initial body".to_owned() } else { format!("trained: {name}") };
        (class, text)
    };
    names.iter().zip(CLASSES).map(entry).collect()
}

/// All decoders of a setting's bodies.
fn brains(setting: &Setting) -> Vec<CastDecoder> {
    distinct(setting.bodies.iter().flat_map(BodyTrials::brains))
}

fn brain(by: CastDecoder) -> String {
    match by {
        CastDecoder::Network => "the network of the body as designed".into(),
        CastDecoder::NetworkCasts => "one network for all casts".into(),
        CastDecoder::Nominal => "the linear decoder of the body as designed".into(),
        CastDecoder::Casts => "one linear decoder for all casts".into(),
        CastDecoder::Records(n) => format!("a linear decoder fitted to {n} records of each cast"),
        CastDecoder::Inverse => format!("the model of the design, inverted ({})", subset_note()),
        CastDecoder::TwinLinear(n) => {
            format!("a linear decoder fitted to a twin, calibrated on {n} records of each cast")
        }
        CastDecoder::Twin(n) => {
            format!("a twin calibrated on {n} records of each cast, inverted ({})", subset_note())
        }
    }
}

/// Inverse decoders estimate only part of a cast's held-out set.
fn subset_note() -> String {
    format!("at most {INVERTED_PER_CAST} held-out samples")
}

fn tick(by: CastDecoder) -> String {
    match by {
        CastDecoder::Network => "network, design".into(),
        CastDecoder::NetworkCasts => "network, casts".into(),
        CastDecoder::Nominal => "for design".into(),
        CastDecoder::Casts => "for casts".into(),
        CastDecoder::Records(records) => format!("{records} records"),
        CastDecoder::Inverse => "model".into(),
        CastDecoder::TwinLinear(records) => format!("linear, twin of {records}"),
        CastDecoder::Twin(records) => format!("twin of {records}"),
    }
}

/// Per setting one sentence about the linear decoder for all casts, and one about the last decoder after it.
pub fn answers(trials: &[Trial]) -> Vec<Answer> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let mut said = Vec::new();
    for setting in settings(&refs) {
        let brains = brains(&setting);
        let most = brains.last().copied().filter(|by| *by > CastDecoder::Casts);
        for by in brains.iter().copied().filter(|by| *by == CastDecoder::Casts).chain(most) {
            let told = |body: &BodyTrials| {
                let left = body.errors_of(by)?;
                let [median, most] = left.errors.map(|error| number(error.ratio));
                let kept = left.kept[0].map_or(String::new(), |kept| {
                    format!(", keeps {:.0} % of its gain as designed", 100.0 * kept.part)
                });
                Some(format!("{} {median} [{most}] %{kept}", body.name))
            };
            let told: Vec<String> = setting.bodies.iter().filter_map(told).collect();
            let (label, by, told) = (&setting.label, brain(by), told.join("; "));
            let text = format!("{label}, error on the median cast [90th percentile] with {by}: {told}.");
            said.push(Answer::new("casts", None, text));
        }
    }
    said
}
