//! Error over casts, by body and brain: a figure, and a sentence a setting.

use crate::analysis::casts::{Cast, Left, Setting, settings};
use crate::analysis::numbers::distinct;
use crate::analysis::trial::CastBrain;
use crate::analysis::{Question, Terms, Trial};
use crate::look::{Answer, Axis, Figure, Plot, Scale, number};

/// At most so many settings are drawn; the data hold all.
const MOST_SETTINGS: usize = 4;

/// Classes of the bodies' marks, the initial one first; the data hold the bodies beyond.
const CLASSES: [&str; 5] = ["initial", "optimised", "front", "fourth", "fifth"];

/// A place for each brain, and in it one for each body side by side: a dot at the median, a line up to the 90th percentile.
pub fn figure(trials: &[Trial]) -> Option<Figure> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let found = settings(&refs);
    let mut names: Vec<&str> = Vec::new();
    for body in found.iter().flat_map(|setting| &setting.bodies) {
        if !names.contains(&&body.name[..]) {
            names.push(&body.name);
        }
    }
    names.truncate(CLASSES.len());
    let entries = names.iter().zip(CLASSES).map(|(name, class)| {
        let text = if *name == "initial" { "initial body".to_owned() } else { format!("trained: {name}") };
        (class, text)
    });
    Figure::some(
        "casts",
        "What is left once the body is cast?",
        "Prediction error on the holdout over casts that no training has seen, which scatter as [variation] says. Dots: the \
         median cast; lines: from there up to the 90th percentile; geometric means over trials. First place: the body as \
         designed. Then the brains that read the casts: one fitted to the body as designed, one to other casts, and one \
         to so many records of each cast beside those. Trained: for the body as designed (nominal), or over casts by objective and by \
         whether one brain reads all or each its own.",
        entries.collect(),
        found.iter().take(MOST_SETTINGS).map(|setting| picture(setting, &names)).collect(),
        || Question::Casts.answer(trials, Terms::default()),
    )
}

fn picture(setting: &Setting, names: &[&str]) -> crate::look::Picture {
    let brains = brains(setting);
    let mut errors = Vec::new();
    let mut marks = Vec::new();
    for (n, name) in names.iter().enumerate() {
        let Some(body) = setting.bodies.iter().find(|body| body.name == *name) else { continue };
        let aside = 0.7 * ((n as f64 + 0.5) / names.len() as f64 - 0.5);
        let read: Vec<Option<Left>> = brains.iter().map(|by| body.left(*by)).collect();
        // by the trial's own kind of brain: networks come first
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
        errors.extend(all.iter().flat_map(|mark| mark.1));
        marks.push((CLASSES[n], all));
    }
    let places = std::iter::once("as designed".to_owned()).chain(brains.iter().map(|by| tick(*by)));
    let places = places.enumerate().map(|(i, name)| (i as f64, name)).collect();
    let x = Axis::new("", Scale::Linear, [-0.5, brains.len() as f64 + 0.5]).with_names(places);
    let y = Axis::new("holdout error (%)", Scale::Log, errors);
    let mut plot = Plot::new(&setting.label, x, y).sized(130.0 + 85.0 * brains.len() as f64, 300.0);
    for (class, marks) in marks {
        for (x, ends, _) in &marks {
            plot.line(class, ends.map(|error| (*x, error)));
        }
        plot.dots(class, marks.into_iter().map(|(x, [median, _], text)| ((x, median), text)));
    }
    plot.picture()
}

/// All that read one of a setting's bodies.
fn brains(setting: &Setting) -> Vec<CastBrain> {
    distinct(setting.bodies.iter().flat_map(Cast::brains))
}

fn brain(by: CastBrain) -> String {
    match by {
        CastBrain::Network => "the network of the body as designed".into(),
        CastBrain::NetworkCasts => "one network for all casts".into(),
        CastBrain::Nominal => "the linear brain of the body as designed".into(),
        CastBrain::Casts => "one linear brain for all casts".into(),
        CastBrain::Records(records) => {
            format!("a linear brain fitted to {records} records of each cast")
        }
    }
}

fn tick(by: CastBrain) -> String {
    match by {
        CastBrain::Network => "its network".into(),
        CastBrain::NetworkCasts => "network for all".into(),
        CastBrain::Nominal => "its linear".into(),
        CastBrain::Casts => "linear for all".into(),
        CastBrain::Records(records) => format!("{records} records"),
    }
}

/// Errors by one brain for all casts, and by those fitted to all records of each, a sentence for either.
pub fn answers(trials: &[Trial]) -> Vec<Answer> {
    let refs: Vec<&Trial> = trials.iter().collect();
    let mut said = Vec::new();
    for setting in settings(&refs) {
        let brains = brains(&setting);
        let most = brains.last().copied().filter(|by| *by > CastBrain::Casts);
        for by in brains.iter().copied().filter(|by| *by == CastBrain::Casts).chain(most) {
            let told = |body: &Cast| {
                let left = body.left(by)?;
                let [median, most] = left.errors.map(|error| number(error.ratio));
                let kept = left.kept[0]
                    .map_or(String::new(), |kept| format!(", {:.0} % of its gain kept", 100.0 * kept.part));
                Some(format!("{} {median} [{most}] %{kept}", body.name))
            };
            let told: Vec<String> = setting.bodies.iter().filter_map(told).collect();
            let text = format!(
                "{}, error on the median cast [on the 90th percentile] by {}: {}.",
                setting.label,
                brain(by),
                told.join("; ")
            );
            said.push(Answer::new("casts", None, text));
        }
    }
    said
}
