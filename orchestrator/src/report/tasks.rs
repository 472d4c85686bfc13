//! Sensing tasks: gain by training per task, transfer matrix, confusion of classes and errors of positions.

use std::collections::BTreeMap;

use metasense_schemas::record::TaskReading;

use super::casts::{CLASSES, MOST_SETTINGS, aside, distinct_names};
use super::words::left_out;
use crate::analysis::numbers::{distinct, in_order};
use crate::analysis::paired::Ratio;
use crate::analysis::tasks::{TaskResult, in_steps, ratio, results, trained_for};
use crate::analysis::{BodyState, DecisionTerms, Question, Trial};
use crate::look::grid::{Cell, grid};
use crate::look::{Answer, Axis, Figure, Picture, Plot, Scale, number};

/// Results of one setting and number of sensors, with the better known readout of each task: direct, of the forces decoded.
struct Setting<'a> {
    label: String,
    results: Vec<&'a TaskResult>,
    /// Tasks in the order of the results.
    tasks: Vec<&'a str>,
    /// Trainings: forces, all, then tasks.
    trainings: Vec<&'a str>,
}

fn settings(all: &[TaskResult]) -> Vec<Setting<'_>> {
    let shown =
        |read: &&TaskResult| read.readout == if read.task.0 == "forces" { "decoded" } else { "direct" };
    let setting = |(setting, sensors): (&String, u64)| {
        let own = |read: &&TaskResult| (&read.setting, read.sensors) == (setting, sensors);
        let results: Vec<&TaskResult> = all.iter().filter(shown).filter(own).collect();
        let mut trainings = distinct(results.iter().map(|read| &read.trained_for[..]));
        trainings.sort_by_key(|name| ["forces", "all"].iter().position(|first| first == name).unwrap_or(2));
        let tasks = in_order(results.iter().map(|read| &read.task.0[..]));
        Setting { label: format!("{setting}, M = {sensors}"), results, tasks, trainings }
    };
    distinct(all.iter().map(|read| (&read.setting, read.sensors))).into_iter().map(setting).collect()
}

impl Setting<'_> {
    fn ratio(&self, task: &str, training: &str) -> Option<Ratio> {
        let own = |read: &&&TaskResult| read.task.0 == task && read.trained_for == training;
        ratio(&self.results.iter().filter(own).copied().collect::<Vec<_>>())
    }

    /// Per task a dot at the gain of each training, and a line over its interval.
    fn gains(&self, names: &[&str]) -> Picture {
        let mut marks = Vec::new();
        for (n, name) in names.iter().enumerate() {
            for (i, task) in self.tasks.iter().enumerate() {
                let Some(found) = self.ratio(task, name) else { continue };
                let ends = found.interval.map_or([found.ratio; 2], |i| [i.low, i.high]);
                let (x, text) = (i as f64 + aside(n, names.len()), format!("{task}: {}", told(name, &found)));
                marks.push((CLASSES[n + 1], (x, found.ratio), ends, text));
            }
        }
        let count = self.tasks.len() as f64;
        let ticks = self.tasks.iter().enumerate().map(|(i, task)| (i as f64, (*task).to_owned())).collect();
        let ends = [-0.5, count - 0.5];
        let x = Axis::new("", Scale::Linear, ends).with_names(ticks);
        let values =
            marks.iter().flat_map(|(_, (_, ratio), [low, high], _)| [*ratio, *low, *high]).chain([1.0]);
        let y = Axis::new("error, initial / trained body", Scale::Log, values);
        let mut plot = Plot::new(&self.label, x, y).sized((45.0 + 85.0 * count).max(320.0), 300.0);
        plot.line("equal", ends.map(|x| (x, 1.0)));
        for (class, at, ends, text) in marks {
            plot.line(class, ends.map(|end| (at.0, end)));
            plot.dots(class, [(at, text)]);
        }
        plot.picture()
    }

    /// The transfer matrix: tasks down, trainings across.
    fn matrix(&self) -> Option<Picture> {
        if self.trainings.len() < 2 {
            return None;
        }
        let of = |task: &&str| self.trainings.iter().map(|training| self.ratio(task, training)).collect();
        let ratios: Vec<Vec<Option<Ratio>>> = self.tasks.iter().map(of).collect();
        let most = ratios.iter().flatten().flatten().map(|found| found.ratio.ln()).fold(1e-9, f64::max);
        let cell = |(found, training): (&Option<Ratio>, &&str)| {
            let Some(found) = found else { return Cell::default() };
            let part = (found.ratio.ln() / most).clamp(0.0, 1.0);
            Cell { text: number(found.ratio), part, title: told(training, found), to: None }
        };
        let cells: Vec<Vec<Cell>> =
            ratios.iter().map(|row| row.iter().zip(&self.trainings).map(cell).collect()).collect();
        let [tasks, trainings] = [&self.tasks, &self.trainings]
            .map(|names| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>());
        let title = format!("{}: error, initial / trained body", self.label);
        Some(grid(&title, ("trained for", &trainings), ("task", &tasks), &cells))
    }
}

fn told(training: &str, found: &Ratio) -> String {
    let range = found.interval.map(|i| format!(" (95 % interval {} to {})", number(i.low), number(i.high)));
    format!("trained for {training}: {} times{}", number(found.ratio), range.unwrap_or_default())
}

/// Gain per task and training, transfer matrix, confusion of classes, mean error of positions.
pub fn figure(trials: &[Trial]) -> Option<Figure> {
    let refs = in_steps(trials);
    let all = results(&refs);
    let found = settings(&all);
    let mut names = distinct_names(found.iter().flat_map(|setting| setting.trainings.iter().copied()));
    names.truncate(CLASSES.len() - 1);
    let shown = || found.iter().take(MOST_SETTINGS);
    let mut pictures: Vec<Picture> = shown().map(|setting| setting.gains(&names)).collect();
    pictures.extend(details(&refs));
    pictures.extend(shown().filter_map(Setting::matrix));
    Figure::some(
        "tasks",
        "What does training gain for other sensing tasks?",
        format!(
            "Held-out errors of readouts that are fitted to the signals; forces are decoded. Dots: error of the initial \
             body divided by that of the trained body, geometric means over trials; lines: 95 % intervals. Classes: percentage \
             of the samples of a true class with each estimate; frequency with which an estimated class is true, by its probability. \
             Position: mean error by the panel with the greatest force. All \
             pool the bodies of the first K and M (and the shortest window) that were trained for the task, or all of them if none was. Last: the ratio \
             of the dots by the task for which the body was trained, for all trainings.{}",
            left_out(found.len(), MOST_SETTINGS)
        ),
        names.iter().zip(&CLASSES[1..]).map(|(by, class)| (*class, format!("trained for {by}"))).collect(),
        pictures,
        || Question::Tasks.answer(trials, DecisionTerms::default()),
    )
}

/// Confusion of classes, and errors of positions, of direct readouts on both bodies, in the shortest window if there are several.
fn details(trials: &[&Trial]) -> Vec<Picture> {
    let Some(first) = trials.iter().find(|trial| !trial.tasks.is_empty()) else { return Vec::new() };
    let of_first = || trials.iter().filter(|t| (t.panels, t.sensors) == (first.panels, first.sensors));
    let window = |trial: &Trial| trial.setting.number("brain.window");
    let shortest = of_first().filter_map(|trial| window(trial)).min_by(f64::total_cmp);
    let words = shortest.map(|s| format!(", first {} ms", number(1e3 * s))).unwrap_or_default();
    let label = format!("K = {}, M = {}{words}", first.panels, first.sensors);
    let trials = || of_first().filter(|trial| window(trial) == shortest);
    let readings = || {
        let all = trials().flat_map(|trial| trial.tasks.iter().map(move |read| (*trial, read)));
        all.filter(|(_, read)| read.readout == "direct" && !read.detail.is_empty())
    };
    let of = |task: &str, body: BodyState| -> Vec<&TaskReading> {
        let is_own = |read: &TaskReading| read.task == task && read.body == body.name();
        // of bodies trained for this task, if there are any
        let specialised = readings().any(|(trial, read)| read.task == task && trained_for(trial) == task);
        let own = readings().filter(|(t, read)| is_own(read) && (!specialised || trained_for(t) == task));
        own.map(|(_, read)| read).collect()
    };
    let tasks = in_order(readings().map(|(_, read)| &read.task[..]));
    let picture = |task: &str| {
        let both = BodyState::ALL.map(|body| (body, of(task, body)));
        if task == "position" {
            let by_panel = |read: &TaskReading| {
                read.detail.iter().map(|[panel, mean, count]| (*panel as u32, *mean, *count)).collect()
            };
            let title = format!("{label}: position, mean error (mm)");
            return vec![means(&title, ("panel", u32::to_string), &both, by_panel)];
        }
        // a mean probability of 1 belongs to the last tenth
        let tenth = |[p, part, count]: &[f64; 3]| ((10.0 * p).min(9.0) as u32, 100.0 * part, *count);
        let by_tenth = |read: &TaskReading| read.reliability.iter().map(tenth).collect();
        let title = format!("{label}: {task}, frequency of a class with this probability (%)");
        let range = |tenth: &u32| format!("{} to {}", 10 * tenth, 10 * (tenth + 1));
        let reliability = means(&title, ("probability (%)", range), &both, by_tenth);
        let confusions = both.iter().map(|(body, readings)| confusion(&label, task, *body, readings));
        confusions.chain([reliability]).collect()
    };
    tasks.into_iter().flat_map(picture).collect()
}

fn confusion(label: &str, task: &str, body: BodyState, readings: &[&TaskReading]) -> Picture {
    let mut counts = BTreeMap::<[u32; 2], f64>::new();
    for [truth, said, count] in readings.iter().flat_map(|read| &read.detail) {
        *counts.entry([*truth as u32, *said as u32]).or_default() += count;
    }
    let classes = distinct(counts.keys().flatten().copied());
    let cells = classes.iter().map(|truth| {
        let all: f64 = classes.iter().filter_map(|said| counts.get(&[*truth, *said])).sum();
        let cell = |said: &u32| {
            let count = counts.get(&[*truth, *said]).copied().unwrap_or_default();
            let part = count / all.max(1.0);
            let title = format!("{task} {truth}, estimated as {said}: {count} of {all} samples");
            Cell { text: format!("{:.0}", 100.0 * part), part, title, to: None }
        };
        classes.iter().map(cell).collect()
    });
    let cells: Vec<Vec<Cell>> = cells.collect();
    let names: Vec<String> = classes.iter().map(u32::to_string).collect();
    let title = format!("{label}: {task}, {} body (%)", body.word());
    grid(&title, ("estimate", &names), ("truth", &names), &cells)
}

/// Grid of mean values: a row per body, a column per class. `rows` gives classes with their mean value and number of samples.
fn means(
    title: &str,
    (across, name): (&str, impl Fn(&u32) -> String),
    bodies: &[(BodyState, Vec<&TaskReading>); 2],
    rows: impl Fn(&TaskReading) -> Vec<(u32, f64, f64)>,
) -> Picture {
    let sums = bodies.each_ref().map(|(_, readings)| {
        let mut sums = BTreeMap::<u32, [f64; 2]>::new();
        for (class, value, count) in readings.iter().flat_map(|read| rows(read)) {
            let sum = sums.entry(class).or_default();
            *sum = [sum[0] + count, sum[1] + count * value];
        }
        sums
    });
    let classes = distinct(sums.iter().flat_map(|sums| sums.keys().copied()));
    let mean = |[count, sum]: &[f64; 2]| sum / count;
    let most = sums.iter().flat_map(BTreeMap::values).map(mean).fold(f64::MIN_POSITIVE, f64::max);
    let cell = |sum: &[f64; 2]| {
        let (text, part) = (number(mean(sum)), mean(sum) / most);
        Cell { title: format!("{text}, {} samples", sum[0]), text, part, to: None }
    };
    let row = |sums: &BTreeMap<u32, [f64; 2]>| {
        classes.iter().map(|class| sums.get(class).map(cell).unwrap_or_default()).collect()
    };
    let cells: Vec<Vec<Cell>> = sums.iter().map(row).collect();
    let names: Vec<String> = classes.iter().map(name).collect();
    let words = bodies.each_ref().map(|(body, _)| body.word().to_owned());
    grid(title, (across, &names), ("body", &words), &cells)
}

/// Per setting, the gain of each task by the first two trainings; the matrix has all.
pub fn answers(trials: &[Trial]) -> Vec<Answer> {
    let all = results(&in_steps(trials));
    let mut said = Vec::new();
    for setting in settings(&all) {
        for training in setting.trainings.iter().take(2) {
            let gain = |task: &&str| Some(format!("{task} {}", number(setting.ratio(task, training)?.ratio)));
            let gains: Vec<String> = setting.tasks.iter().filter_map(gain).collect();
            let text = format!(
                "{}, body trained for {training}, error of the initial body divided by that of the trained body, by task: {}.",
                setting.label,
                gains.join(", ")
            );
            said.push(Answer::new("tasks", None, text));
        }
    }
    said
}
