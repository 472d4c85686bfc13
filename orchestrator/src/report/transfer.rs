//! Bodies under forces other than their training forces: a figure, and one sentence per setting.

use super::casts::{CLASSES, CastMark, MOST_SETTINGS, aside, distinct_names, legend, side_by_side};
use super::words::left_out;
use crate::analysis::bodies::BodyTrials;
use crate::analysis::transfer::{Setting, settings};
use crate::analysis::{DecisionTerms, Question, Trial};
use crate::look::{Answer, Figure, Picture, number};

/// One position per kind of forces with bodies side by side: dots for decoders fitted under these forces, lines to decoders fitted
/// under the body's training forces.
pub fn figure(trials: &[Trial]) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let found = settings(&refs);
    let names = distinct_names(found.iter().flat_map(|setting| &setting.bodies).map(|body| &body.name[..]));
    Figure::some(
        "transfer",
        "How well does a body work under forces that it was not trained for?",
        format!(
            "Held-out error of linear decoders under each kind of forces, geometric means over trials. Dots: \
             decoders fitted under these forces; lines: up to decoders fitted under the training forces of the body. \
             Trained: the training forces.{}",
            left_out(found.len(), MOST_SETTINGS)
        ),
        legend(&names),
        found.iter().take(MOST_SETTINGS).map(|setting| picture(setting, &names)).collect(),
        || Question::Transfer.answer(trials, DecisionTerms::default()),
    )
}

fn picture(setting: &Setting, names: &[&str]) -> Picture {
    let marks = names.iter().zip(CLASSES).enumerate().filter_map(|(n, (name, class))| {
        let body = setting.bodies.iter().find(|body| body.name == *name)?;
        let mark = |(i, kind): (usize, &String)| -> Option<CastMark> {
            let read = setting.read(body, kind)?;
            let (own, carried) = (read.own.ratio, read.carried.map(|carried| carried.ratio));
            let carried = carried.unwrap_or(own);
            let [at, to] = [own, carried].map(number);
            let text = format!("{name}, under {kind}: {at} % (decoder of the training forces: {to} %)");
            Some((i as f64 + aside(n, names.len()), [own, carried], text))
        };
        Some((class, setting.kinds.iter().enumerate().filter_map(mark).collect()))
    });
    side_by_side(&setting.label, setting.kinds.clone(), marks.collect())
}

/// Errors of each body under each kind of forces, and the forces under which trained bodies keep least of the gain.
pub fn answers(trials: &[Trial]) -> Vec<Answer> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let told = |setting: &Setting, body: &BodyTrials| {
        let errors = setting.kinds.iter().filter_map(|kind| {
            Some(format!("{} % under {kind}", number(setting.read(body, kind)?.own.ratio)))
        });
        let errors = errors.collect::<Vec<_>>().join(", ");
        let worst = setting.worst(body).map(|(kind, kept)| {
            format!(", least under {kind}: {:.0} % of the gain of a body trained for it", 100.0 * kept)
        });
        format!("{} {errors}{}", body.name, worst.unwrap_or_default())
    };
    let said = settings(&refs).into_iter().map(|setting| {
        let bodies: Vec<String> = setting.bodies.iter().map(|body| told(&setting, body)).collect();
        let text = format!(
            "{}, error of a linear decoder fitted under the same forces, by the training forces of the body: {}.",
            setting.label,
            bodies.join("; ")
        );
        Answer::new("transfer", None, text)
    });
    said.collect()
}
