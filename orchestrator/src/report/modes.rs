//! Pictures of modes, which a page can animate, and curves of responses.

use metasense_lab::modes::{FrequencyResponse, Mode, slowest};
use metasense_lab::replay::drawing;
use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::NoResult;
use serde_json::Value;

use super::body::sketch;
use crate::analysis::BodyState;
use crate::look::body::{Sketch, ViewBox, frame};
use crate::look::{Axis, Figure, Legend, Picture, Plot, SERIES, Scale, Table, legend, number, row, wave};
use crate::reader::StoredTrial;

/// Number of modes per body in a report.
const SHOWN: usize = 4;
/// Legend of the pictures.
const LEGEND: [(&str, &str); 3] =
    [("speed", "motion of a unit"), ("arrow", "input panel"), ("dot sensor", "sensor")];

/// Number, frequency and damping ratio of a mode.
pub fn title(n: usize, mode: &Mode) -> String {
    let [hz, percent] = [mode.frequency(), 100.0 * mode.damping_ratio()].map(number);
    format!("{}: {hz}\u{a0}Hz, {percent}\u{a0}%", n + 1)
}

/// The row of a mode.
pub fn row(n: usize, mode: &Mode) -> Vec<Value> {
    row![n + 1, mode.frequency(), mode.damping_ratio(), mode.s.im / std::f64::consts::TAU, mode.decay_time()]
}

/// Columns of [`row()`]: |s|/2π (Hz), −Re s/|s|, Im s/2π (Hz) and −1/Re s (s), empty without damping.
pub const COLUMNS: &str = "mode frequency damping_ratio ringing_frequency decay_time";

/// The slowest modes of a trial's two bodies.
pub fn figure(stored: &StoredTrial, drawings: &[Sketch; 2], who: &str) -> Result<Figure, NoResult> {
    let frame = frame(drawings);
    let (mut pictures, mut rows) = (Vec::new(), Vec::new());
    for body in BodyState::ALL {
        let modes = slowest(&stored.specs[body as usize], &stored.designs[body as usize], SHOWN)?;
        for (n, mode) in modes.iter().enumerate() {
            let label = format!("{} {}", body.word(), title(n, mode));
            pictures.push(swinging(&drawings[body as usize], frame, mode, &label));
            rows.push([row![body.name()], row(n, mode)].concat());
        }
    }
    Ok(Figure::new(
        "modes",
        "Eigenmodes of the bodies",
        format!(
            "The slowest modes of small motions about rest of {who}: the initial body's above, the trained body's below. \
             Titles give frequency and damping relative to critical. Motion is drawn far out of scale; units are coloured \
             by amplitude, from pale to strong (square root)."
        ),
        legend(&LEGEND),
        pictures,
        Table::new(&format!("body {COLUMNS}"), rows),
    )
    .small(None))
}

fn swinging(sketch: &Sketch, frame: ViewBox, mode: &Mode, title: &str) -> Picture {
    let shape: Vec<[f64; 3]> = mode.shape.iter().map(|unit| unit.map(|c| c.re)).collect();
    let travel: Vec<f64> = mode.shape.iter().map(|unit| unit[0].norm().hypot(unit[1].norm())).collect();
    wave::mode(sketch, frame, &shape, &travel, title)
}

/// Pictures of modes of one body, with their legend.
pub fn shapes(trial: &TrialSpec, design: &[f64], modes: &[Mode]) -> Result<(Vec<Picture>, Legend), NoResult> {
    let sketch = sketch(&drawing(trial, design)?, &[]);
    let frame = frame([&sketch]);
    let shape = |(n, mode)| swinging(&sketch, frame, mode, &title(n, mode));
    Ok((modes.iter().enumerate().map(shape).collect(), legend(&LEGEND)))
}

/// Curves of a unit's responses at these frequencies (Hz), one per panel, with their legend.
pub fn responses(
    unit: usize,
    frequencies: &[f64],
    found: &[Vec<FrequencyResponse>],
) -> (Vec<Picture>, Legend) {
    let panels = found.first().map_or(0, Vec::len);
    let class = |k: usize| SERIES.get(k).copied().unwrap_or("thin");
    let size = |response: &FrequencyResponse, turn: bool| match turn {
        true => response[2].norm(),
        false => response[0].norm().hypot(response[1].norm()),
    };
    let plot = |turn: bool, name: &str| {
        let x = Axis::new("frequency (Hz)", Scale::Linear, frequencies.iter().copied());
        let values = found.iter().flatten().map(|response| size(response, turn));
        let y = Axis::new("per N", Scale::Log, values);
        let mut plot = Plot::new(&format!("unit {unit}: {name}"), x, y).sized(440.0, 250.0);
        for k in 0..panels {
            plot.line(class(k), frequencies.iter().zip(found).map(|(f, of)| (*f, size(&of[k], turn))));
        }
        plot.picture()
    };
    let plots = vec![plot(false, "acceleration (mm/s²)"), plot(true, "angular velocity (rad/s)")];
    (plots, (0..panels).map(|k| (class(k), format!("panel {k}"))).collect())
}
