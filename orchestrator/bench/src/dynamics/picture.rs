//! Draws the work-precision diagram from JSON lines: log-log panels, one column per scene, signals above dα.

use std::path::Path;

use serde_json::Value;

use metasense::cli::Error;
use metasense::look::{Axis, Legend, Picture, Plot, SERIES, Scale, file};

/// A panel's size (px).
const PANEL: [f64; 2] = [310.0, 250.0];

/// Scenes and titles of their panels.
pub(super) const SCENES: [(&str, &str); 4] = [
    ("reference", "reference scene, 6 × 6"),
    ("contact", "contact, 8 × 4"),
    ("stretch100", "k_stretch × 100"),
    ("stretch10000", "k_stretch × 10 000"),
];
pub(super) const METHODS: [&str; 5] = ["tsit5", "leapfrog", "nystrom4", "nystrom6", "nystrom4_f32"];

/// One measured run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MeasuredRun {
    pub scene: String,
    pub method: String,
    pub setting: String,
    pub auto: bool,
    /// Milliseconds per sample and error: of the signals (forward), of dα (forward and gradient).
    pub points: [Option<(f64, f64)>; 2],
}

fn mark(row: &Value) -> Option<MeasuredRun> {
    let text = |key: &str| row[key].as_str().map(str::to_owned);
    // A zero error, of a run with the steps of the reference, has no logarithm.
    let point = |cost: &str, error: &str| {
        let error = row[error].as_f64().filter(|e| *e > 0.0)?;
        Some((row[cost].as_f64()?, error))
    };
    Some(MeasuredRun {
        scene: text("scene")?,
        method: text("method")?,
        setting: text("setting")?,
        auto: row["auto"].as_bool()?,
        points: [point("forward_ms", "signals_error"), point("gradient_ms", "gradient_error")],
    })
}

/// The newest row of each setting with this number of instants.
fn newest(lines: &str, instants: u16) -> Vec<MeasuredRun> {
    let mut marks: Vec<MeasuredRun> = Vec::new();
    for line in lines.lines() {
        let Ok(row) = serde_json::from_str::<Value>(line) else { continue };
        if row["bench"] != "dynamics" || row["instants"] != instants {
            continue;
        }
        let Some(new) = mark(&row) else { continue };
        let same = |old: &MeasuredRun| {
            (&old.scene, &old.method, &old.setting) == (&new.scene, &new.method, &new.setting)
        };
        marks.retain(|old| !same(old));
        marks.push(new);
    }
    marks
}

/// Draws the rows of file `rows` into file `picture` and returns them.
///
/// # Errors
/// If reading or writing fails.
pub(super) fn write(rows: &Path, picture: &Path, instants: u16) -> Result<Vec<MeasuredRun>, Error> {
    let failed = |doing, path: &Path| {
        let path = path.to_owned();
        move |source| Error::Io { doing, path, source }
    };
    let lines = std::fs::read_to_string(rows).map_err(failed("reading", rows))?;
    if let Some(folder) = picture.parent() {
        std::fs::create_dir_all(folder).map_err(failed("making", folder))?;
    }
    let marks = newest(&lines, instants);
    std::fs::write(picture, draw(&marks)).map_err(failed("writing", picture))?;
    Ok(marks)
}

fn draw(marks: &[MeasuredRun]) -> String {
    let scenes: Vec<_> = SCENES.iter().filter(|(name, _)| marks.iter().any(|m| m.scene == *name)).collect();
    let panel = |row: usize, (scene, title): &(&str, &str)| {
        let of: Vec<&MeasuredRun> = marks.iter().filter(|m| m.scene == *scene).collect();
        panel(title, &of, row)
    };
    let rows = (0..2).flat_map(|row| scenes.iter().map(move |scene| panel(row, scene)));
    let mut legend: Legend =
        METHODS.iter().zip(SERIES).map(|(name, class)| (class, (*name).to_owned())).collect();
    legend.push(("ring", "auto".into()));
    let columns = scenes.len().max(2);
    file(&rows.collect::<Vec<_>>(), columns, PANEL[0] * columns as f64, &legend)
}

fn panel(title: &str, marks: &[&MeasuredRun], row: usize) -> Picture {
    let what = ["relative error of the signals", "relative error of dα"][row];
    let cost = ["forward (CPU ms per sample)", "forward and gradient (CPU ms per sample)"][row];
    // clip errors at 1
    let points = |m: &MeasuredRun| m.points[row].map(|p| (p.0, p.1.min(1.0)));
    let errors = || marks.iter().filter_map(|m| Some(points(m)?.1)).chain([1e-4, 1.0]);
    let decades = |low: f64| (low.log10().ceil() as i32..=0).map(|p| 10f64.powi(p)).collect::<Vec<f64>>();
    let x = Axis::new(cost, Scale::Log, marks.iter().filter_map(|m| Some(points(m)?.0)));
    let y = Axis::new(what, Scale::Log, errors()).with_ticks(decades(errors().fold(1.0, f64::min)));
    let mut plot = Plot::new(title, x, y).sized(PANEL[0], PANEL[1]);
    let told = |m: &&MeasuredRun| {
        let p = points(m)?;
        Some((p, format!("{} {}: {:.3} ms, {:.1e}", m.method, m.setting, p.0, p.1)))
    };
    for (name, class) in METHODS.iter().zip(SERIES) {
        let own = marks.iter().filter(|m| m.method == *name && !m.auto);
        let mut line: Vec<((f64, f64), String)> = own.filter_map(told).collect();
        line.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
        plot.line(class, line.iter().map(|l| l.0));
        plot.dots(class, line);
    }
    plot.rings(marks.iter().filter(|m| m.auto).filter_map(told));
    plot.picture()
}

#[cfg(test)]
mod tests;
