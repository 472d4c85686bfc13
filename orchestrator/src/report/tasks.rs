//! Sensing tasks: gain by training per task, transfer matrix, confusion of classes and errors of positions.

use std::collections::BTreeMap;

use metasense_schemas::record::TaskReading;

use super::casts::{CLASSES, MOST_SETTINGS, aside, distinct_names};
use super::words::left_out;
use crate::analysis::numbers::{distinct, in_order};
use crate::analysis::paired::Ratio;
use crate::analysis::tasks::{TaskResult, in_steps, ratio, results, trained_for};
use crate::analysis::{Body, Question, Terms, Trial};
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
    let shown = |read: &&TaskResult| (read.task.0 == "forces") == (read.readout == "decoded");
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
                marks.push((
                    n,
                    i as f64 + aside(n, names.len()),
                    found.ratio,
                    ends,
                    format!("{task}: {}", told(name, &found)),
                ));
            }
        }
        let count = self.tasks.len() as f64;
        let ticks = self.tasks.iter().enumerate().map(|(i, task)| (i as f64, (*task).to_owned())).collect();
        let ends = [-0.5, count - 0.5];
        let x = Axis::new("", Scale::Linear, ends).with_names(ticks);
        let values =
            marks.iter().flat_map(|(_, _, ratio, [low, high], _)| [*ratio, *low, *high]).chain([1.0]);
        let y = Axis::new("error, initial / trained body", Scale::Log, values);
        let mut plot = Plot::new(&self.label, x, y).sized((45.0 + 85.0 * count).max(320.0), 300.0);
        plot.line("equal", ends.map(|x| (x, 1.0)));
        for (n, x, ratio, ends, text) in marks {
            plot.line(CLASSES[n + 1], ends.map(|end| (x, end)));
            plot.dots(CLASSES[n + 1], [((x, ratio), text)]);
        }
        plot.picture()
    }

    /// The transfer matrix: tasks down, trainings across.
    fn matrix(&self) -> Option<Picture> {
        if self.trainings.len() < 2 {
            return None;
        }
        let ratios: Vec<Vec<Option<Ratio>>> = self
            .tasks
            .iter()
            .map(|task| self.trainings.iter().map(|training| self.ratio(task, training)).collect())
            .collect();
        let most = ratios.iter().flatten().flatten().map(|found| found.ratio.ln()).fold(1e-9, f64::max);
        let cell = |(found, training): (&Option<Ratio>, &&str)| {
            let cell = |found: &Ratio| Cell {
                text: number(found.ratio),
                part: (found.ratio.ln() / most).clamp(0.0, 1.0),
                title: told(training, found),
                to: None,
            };
            found.as_ref().map(cell).unwrap_or_default()
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
    let interval =
        found.interval.map(|i| format!(" (95 % interval {} to {})", number(i.low), number(i.high)));
    format!("trained for {training}: {} times{}", number(found.ratio), interval.unwrap_or_default())
}

/// Gain per task and training, transfer matrix, confusion of classes, mean error of positions.
pub fn figure(trials: &[Trial]) -> Option<Figure> {
    let refs = in_steps(trials);
    let all = results(&refs);
    let found = settings(&all);
    let names: Vec<&str> = distinct_names(found.iter().flat_map(|setting| setting.trainings.iter().copied()))
        .into_iter()
        .take(CLASSES.len() - 1)
        .collect();
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
             of the samples of a true class with each estimate. Position: mean error by the panel with the greatest force. Both \
             pool the bodies of the first K and M that were trained for the task, or all of them if none was. Last: the ratio \
             of the dots by the task for which the body was trained, for all trainings.{}",
            left_out(found.len(), MOST_SETTINGS)
        ),
        names
            .iter()
            .zip(&CLASSES[1..])
            .map(|(name, class)| (*class, format!("trained for {name}")))
            .collect(),
        pictures,
        || Question::Tasks.answer(trials, Terms::default()),
    )
}

/// Confusion of classes, and errors of positions, of direct readouts on both bodies.
fn details(trials: &[&Trial]) -> Vec<Picture> {
    let Some(first) = trials.iter().find(|trial| !trial.tasks.is_empty()) else { return Vec::new() };
    let label = format!("K = {}, M = {}", first.panels, first.sensors);
    let trials = || trials.iter().filter(|t| (t.panels, t.sensors) == (first.panels, first.sensors));
    let readings = || {
        let all = trials().flat_map(|trial| trial.tasks.iter().map(move |read| (*trial, read)));
        all.filter(|(_, read)| read.readout == "direct" && !read.detail.is_empty())
    };
    let of = |task: &str, body: Body| -> Vec<&TaskReading> {
        let is_own = |read: &TaskReading| read.task == task && read.body == body.name();
        // of bodies trained for this task, if there are any
        let specialised = readings().any(|(trial, read)| read.task == task && trained_for(trial) == task);
        let own =
            readings().filter(|(trial, read)| is_own(read) && (!specialised || trained_for(trial) == task));
        own.map(|(_, read)| read).collect()
    };
    let tasks = in_order(readings().map(|(_, read)| &read.task[..]));
    let picture = |task: &str| match task {
        "position" => vec![positions(&label, Body::ALL.map(|body| (body, of(task, body))))],
        _ => Body::ALL.map(|body| confusion(&label, task, body, &of(task, body))).into(),
    };
    tasks.into_iter().flat_map(picture).collect()
}

/// Sum of counts, and sum of values weighted by counts, by class.
fn sums<'a>(
    readings: impl IntoIterator<Item = &'a &'a TaskReading>,
    class: impl Fn(&[f64; 3]) -> [u32; 2],
) -> BTreeMap<[u32; 2], [f64; 2]> {
    let mut sums = BTreeMap::<_, [f64; 2]>::new();
    for row in readings.into_iter().flat_map(|read| &read.detail) {
        let sum = sums.entry(class(row)).or_default();
        *sum = [sum[0] + row[2], sum[1] + row[2] * row[1]];
    }
    sums
}

fn confusion(label: &str, task: &str, body: Body, readings: &[&TaskReading]) -> Picture {
    let counts = sums(readings, |row| [row[0] as u32, row[1] as u32]);
    let classes = distinct(counts.keys().flatten().copied());
    let cells = classes.iter().map(|truth| {
        let all: f64 =
            classes.iter().filter_map(|said| counts.get(&[*truth, *said])).map(|[count, _]| count).sum();
        let cell = |said: &u32| {
            let count = counts.get(&[*truth, *said]).map_or(0.0, |[count, _]| *count);
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

fn positions(label: &str, bodies: [(Body, Vec<&TaskReading>); 2]) -> Picture {
    let sums = bodies.each_ref().map(|(_, readings)| sums(readings, |row| [row[0] as u32, 0]));
    let panels = distinct(sums.iter().flat_map(|sums| sums.keys().map(|[panel, _]| *panel)));
    let means = sums.map(|sums| {
        let mean = |panel: &u32| sums.get(&[*panel, 0]).map(|[count, sum]| sum / count);
        panels.iter().map(mean).collect::<Vec<_>>()
    });
    let most = means.iter().flatten().flatten().copied().fold(f64::MIN_POSITIVE, f64::max);
    let cell = |mean: &Option<f64>| {
        let cell = |mean: f64| Cell {
            text: number(mean),
            part: mean / most,
            title: format!("{} mm", number(mean)),
            to: None,
        };
        mean.map(cell).unwrap_or_default()
    };
    let cells: Vec<Vec<Cell>> = means.iter().map(|row| row.iter().map(cell).collect()).collect();
    let names: Vec<String> = panels.iter().map(u32::to_string).collect();
    let words = bodies.map(|(body, _)| body.word().to_owned());
    grid(&format!("{label}: position, mean error (mm)"), ("panel", &names), ("body", &words), &cells)
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
