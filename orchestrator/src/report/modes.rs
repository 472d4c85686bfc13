//! Modes as pictures: units displaced as far as a mode takes them, which a page lets swing; responses as curves.

use std::fmt::Write as _;

use metasense_worker::modes::{Mode, Response, slowest};
use metasense_worker::replay::{Drawing, drawing};
use metasense_worker::run::Failure;
use serde_json::Value;

use super::body::{Frame, marks, points};
use super::figures::{Figure, legend};
use super::plot::{Axis, Plot, Scale, escape};
use super::samples::colour;
use crate::analysis::Body;
use crate::look::{Table, number, row};
use crate::store::Stored;

/// How far a mode moves the corner that it moves most, by the pitch of the grid.
const REACH: f64 = 0.4;
/// Modes of each body in a report.
const SHOWN: usize = 4;
/// Width of a sheet (px), and height of a line of text.
const SHEET: f64 = 440.0;
const LINE: f64 = 15.0;
/// Classes of the panels' lines; those beyond are thin.
const PANELS: [&str; 5] = ["truth", "optimised", "front", "initial", "fine"];

/// Number, frequency and damping in words.
#[must_use]
pub fn title(n: usize, mode: &Mode) -> String {
    format!("{}: {} Hz, {} %", n + 1, number(mode.frequency()), number(100.0 * mode.damping_ratio()))
}

/// A row a mode.
#[must_use]
pub fn row(n: usize, mode: &Mode) -> Vec<Value> {
    row![n + 1, mode.frequency(), mode.damping_ratio(), mode.s.im / std::f64::consts::TAU, -1.0 / mode.s.re]
}

/// Its columns: |s|/2π (Hz), −Re s/|s|, Im s/2π (Hz) and −1/Re s (s).
pub const COLUMNS: &str = "mode frequency damping_ratio ringing_frequency decay_time";

/// A mode of a body: units where it takes them, and coloured by how far it moves their centroids.
#[must_use]
pub fn shape(drawing: &Drawing, frame: &Frame, mode: &Mode, label: &str) -> String {
    let moved = |u: usize, corner: &[f64; 2]| {
        let ([x, y], [du, dv, turn]) = (drawing.centroids[u], mode.shape[u].map(|c| c.re));
        (du - turn * (corner[1] - y)).hypot(dv + turn * (corner[0] - x))
    };
    let corners = drawing.units.iter().enumerate().flat_map(|(u, unit)| unit.iter().map(move |c| (u, c)));
    let most = corners.map(|(u, corner)| moved(u, corner)).fold(f64::MIN_POSITIVE, f64::max);
    let scale = REACH * drawing.spacing / most;
    let travel = |u: usize| mode.shape[u][0].norm().hypot(mode.shape[u][1].norm());
    let farthest = (0..drawing.units.len()).map(travel).fold(f64::MIN_POSITIVE, f64::max);
    let mut svg = frame.open(label).replace("class=\"body\"", "class=\"body mode\"");
    for (u, corners) in drawing.units.iter().enumerate() {
        let ([x, y], [du, dv, turn]) = (drawing.centroids[u], mode.shape[u].map(|c| scale * c.re));
        let (dx, dy, turn) = (du, -dv, -turn.to_degrees());
        // the attribute for what stands still; a page's own style takes it from the variables
        let _ = write!(
            svg,
            "<polygon class=\"unit\" transform=\"translate({dx:.2} {dy:.2}) rotate({turn:.2} {x:.2} {:.2})\" \
             style=\"{};--c:{x:.2}px {:.2}px;--x:{dx:.2}px;--y:{dy:.2}px;--t:{turn:.2}deg\" points=\"{}\"/>",
            -y,
            colour(travel(u) / farthest),
            -y,
            points(corners)
        );
    }
    svg + &marks(drawing) + "</svg>"
}

/// The slowest modes of a trial's two bodies.
///
/// # Errors
/// If nothing holds them.
pub fn figure(stored: &Stored, drawings: &[Drawing; 2], who: &str) -> Result<Figure, Failure> {
    let frame = Frame::around(&[&drawings[0], &drawings[1]]);
    let (mut plots, mut rows) = (Vec::new(), Vec::new());
    for body in Body::ALL {
        let modes = slowest(&stored.specs[body as usize], &stored.designs[body as usize], SHOWN)?;
        for (n, mode) in modes.iter().enumerate() {
            let label = format!("{} {}", body.name(), title(n, mode));
            let drawn = shape(&drawings[body as usize], &frame, mode, &label);
            plots.push(format!("<h3>{}</h3>{drawn}", escape(&label)));
            rows.push([row![body.name()], row(n, mode)].concat());
        }
    }
    Ok(Figure {
        name: "modes",
        title: "How the bodies ring".into(),
        caption: format!(
            "The slowest modes of small motions about rest of {who}, the initial body's above the optimised one's: \
             frequency, and damping relative to critical. Units are drawn far out of scale, coloured by how far they move \
             (by its root from pale to strong)."
        ),
        legend: legend(&[("speed", "motion of a unit")]),
        plots,
        small: true,
        data: Table::new(&format!("body {COLUMNS}"), rows),
    })
}

/// Modes of one body side by side, as one SVG.
///
/// # Errors
/// If the spec stands for no trial.
pub fn shapes(
    trial: &metasense_schemas::spec::TrialSpec,
    design: &[f64],
    modes: &[Mode],
) -> Result<String, Failure> {
    let drawing = drawing(trial, design)?;
    let frame = Frame::around(&[&drawing]);
    let [_, _, width, height] = frame.view;
    let columns = modes.len().clamp(1, 4);
    let wide = SHEET / columns as f64;
    let tall = wide * height / width;
    let plots: Vec<(String, String)> = modes
        .iter()
        .enumerate()
        .map(|(n, mode)| (title(n, mode), shape(&drawing, &frame, mode, &title(n, mode))))
        .collect();
    Ok(sheet(&plots, columns, tall))
}

/// Responses of a unit at these frequencies (Hz), as curves by panel, as one SVG and with its legend.
#[must_use]
pub fn responses(
    unit: usize,
    frequencies: &[f64],
    found: &[Vec<Response>],
) -> (String, Vec<(&'static str, String)>) {
    let panels = found.first().map_or(0, Vec::len);
    let class = |k: usize| PANELS.get(k).copied().unwrap_or("thin");
    let size = |response: &Response, turn: bool| match turn {
        true => response[2].norm(),
        false => response[0].norm().hypot(response[1].norm()),
    };
    let plot = |turn: bool, name: &str| {
        let x = Axis::new("frequency (Hz)", Scale::Linear, frequencies.iter().copied());
        let values = found.iter().flatten().map(|response| size(response, turn));
        let mut plot = Plot::new(&format!("unit {unit}: {name}"), x, Axis::new("per N", Scale::Log, values))
            .sized(SHEET, 250.0);
        for k in 0..panels {
            plot.line(class(k), frequencies.iter().zip(found).map(|(f, of)| (*f, size(&of[k], turn))));
        }
        (String::new(), plot.svg())
    };
    let plots = [plot(false, "acceleration (mm/s²)"), plot(true, "angular velocity (rad/s)")];
    let legend = (0..panels).map(|k| (class(k), format!("panel {k}"))).collect();
    (sheet(&plots, 1, 250.0), legend)
}

/// Pictures (heading, SVG) in rows of so many, each this tall (px), as one.
fn sheet(plots: &[(String, String)], columns: usize, tall: f64) -> String {
    let wide = SHEET / columns as f64;
    let pitch = tall + LINE;
    let height = pitch * plots.len().div_ceil(columns) as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {SHEET} {height:.1}\" role=\"img\" aria-label=\"{}\">",
        escape(&plots.iter().map(|p| p.0.as_str()).collect::<Vec<_>>().join("; "))
    );
    for (i, (heading, plot)) in plots.iter().enumerate() {
        let (x, y) = ((i % columns) as f64 * wide, (i / columns) as f64 * pitch);
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\">{}</text>{}",
            x + 4.0,
            y + LINE - 3.0,
            escape(heading),
            plot.replacen(
                "<svg ",
                &format!("<svg x=\"{x:.1}\" y=\"{:.1}\" width=\"{wide:.1}\" height=\"{tall:.1}\" ", y + LINE),
                1
            )
        );
    }
    svg + "</svg>"
}
