//! Tables and figures of `check`.

use std::path::Path;

use maud::html;
use metasense_lab::check::{Checked, Looked, Severity};
use metasense_lab::modes::{Mode, responses};
use metasense_schemas::spec::TrialSpec;
use serde_json::Value;

use super::strips::least_median_greatest;
use crate::look::{
    Answer, Axis, Figure, Plot, SERIES, Scale, Table, answers, digits, legend, number, page, row,
};

/// One row per finding.
pub fn findings(checked: &Checked) -> Table {
    let rows = checked.findings.iter().map(|f| row![f.check, f.level.name(), f.place, f.found, f.remedy]);
    Table::new("check outcome place found remedy", rows)
}

/// One row per record: force (N, N·s), readings (1/s), noise before the blow (mm/s², rad/s), correlation with the model and lag.
pub fn records(checked: &Checked) -> Table {
    let columns = "record file panel peak impulse blows readings rate jitter_percent clipped noise_acceleration noise_rotation \
                   correlation lag_ms";
    let row = |(i, of): (usize, &Looked)| {
        let Looked { record, instruments, .. } = of;
        let turns = |c: usize| checked.channels[c].starts_with('ω');
        let noise = |turning: bool| {
            let quiet = instruments.quiet.iter().flatten().enumerate().filter(|(c, _)| turns(*c) == turning);
            quiet.map(|(_, quiet)| quiet[1]).reduce(f64::max).map(|noise| digits(noise, 3))
        };
        let agreement = checked.found.as_ref().map(|found| &found.records[i]);
        let clipped: usize = of.clipped.iter().flatten().sum();
        row![
            of.number,
            of.place,
            record.panel,
            digits(instruments.peak, 3),
            digits(instruments.impulse, 3),
            instruments.blows,
            record.signals.entries(),
            digits(record.signals.dt.recip(), 5),
            digits(100.0 * of.jitter, 2),
            clipped,
            noise(false),
            noise(true),
            agreement.map(|agreement| format!("{:.2}", agreement.correlation)),
            agreement.map(|agreement| format!("{:.1}", 1e3 * agreement.lag)),
        ]
    };
    Table::new(columns, checked.records.iter().enumerate().map(row))
}

/// One row per resonance of the records (Hz, s), with the design's mode that is nearest in frequency.
pub fn rings(checked: &Checked) -> Table {
    let row = |[frequency, damping, decay]: &[f64; 3]| {
        let far = |hertz: f64| (hertz / frequency).ln().abs();
        let modes = checked.modes.iter().enumerate();
        let near = modes.min_by(|a, b| far(a.1.frequency()).total_cmp(&far(b.1.frequency())));
        let near = near.filter(|(_, mode)| far(mode.frequency()) < NEAR);
        let shown = |value: Option<f64>| value.map_or(Value::Null, |value| digits(value, 3).into());
        let mode_value = |value: fn(&Mode) -> Option<f64>| shown(near.and_then(|(_, mode)| value(mode)));
        row![
            shown(Some(*frequency)),
            shown(Some(*damping)),
            shown(Some(*decay)),
            near.map(|(n, _)| n + 1),
            mode_value(|mode| Some(mode.frequency())),
            mode_value(|mode| Some(mode.damping_ratio())),
            mode_value(Mode::decay_time),
            shown(near.map(|(_, mode)| frequency / mode.frequency())),
        ]
    };
    let rings = checked.spectra.iter().flat_map(|spectra| &spectra.rings);
    let columns =
        "resonance damping_ratio decay_time mode design_frequency design_damping design_decay ratio";
    Table::new(columns, rings.map(row))
}

/// Largest |ln| of the ratio of a mode's frequency to a resonance.
const NEAR: f64 = 0.25;
/// Classes of the lines of median and least coherence.
const COHERENCE: [&str; 2] = ["truth", "front"];

/// The page of `check`.
pub fn html(file: &Path, checked: &Checked, figures: &[Figure]) -> String {
    let answer = |f: &metasense_lab::check::Finding| {
        let place = if f.place.is_empty() { String::new() } else { format!("{}: ", f.place) };
        let verdict = (f.level == Severity::Fault).then_some(false);
        Answer::new("", verdict, format!("{place}{}. Remedy: {}.", f.found, f.remedy))
    };
    let said: Vec<Answer> = checked.findings.iter().filter(|f| f.level != Severity::Ok).map(answer).collect();
    let good = [Answer::new("", Some(true), "No fault found.".into())];
    let content = html! {
        (answers(if said.is_empty() { &good[..] } else { &said }))
        @for figure in figures { (figure.html(&[])) }
        h2 { "Records" } (records(checked).html(Some("records")))
        h2 { "Resonances and modes of the design" } (rings(checked).html(Some("rings")))
        h2 { "All checks" } (findings(checked).html(Some("findings")))
    };
    let title = format!("{}: checks before any fit", file.file_name().unwrap_or_default().display());
    page(&title, "Do these records agree with the description in their file?", content)
}

/// Figures of records with the model, and of responses.
pub fn figures(trial: &TrialSpec, design: &[f64], checked: &Checked) -> Vec<Figure> {
    followed(checked).into_iter().chain(response(trial, design, checked)).collect()
}

/// The records of least, median and greatest correlation with the model.
fn followed(checked: &Checked) -> Option<Figure> {
    let found = checked.found.as_ref()?;
    let chosen = least_median_greatest(found.records.len(), |i| found.records[i].correlation);
    let (mut pictures, mut rows) = (Vec::new(), Vec::new());
    for i in chosen {
        let (signals, model) = (&checked.records[i].record.signals, &found.simulated[i]);
        let (number_of, end) = (checked.records[i].number, model.time(model.entries()));
        for turning in [false, true] {
            let size = |c: &usize| signals.values[*c].iter().map(|x| x * x).sum::<f64>();
            let channels =
                (0..checked.channels.len()).filter(|c| checked.channels[*c].starts_with('ω') == turning);
            let Some(c) = channels.max_by(|a, b| size(a).total_cmp(&size(b))) else { continue };
            let measured =
                (0..signals.entries()).map(|n| (signals.time(n) + found.lags[i], signals.values[c][n]));
            let measured: Vec<(f64, f64)> = measured.filter(|(t, _)| (0.0..=end).contains(t)).collect();
            let (d, sign) = found.source[c];
            let simulated: Vec<(f64, f64)> =
                (0..model.entries()).map(|n| (model.time(n), sign * model.values[d][n])).collect();
            let scale = |of: &[(f64, f64)]| of.iter().fold(f64::MIN_POSITIVE, |m, (_, y)| m.max(y.abs()));
            let scales = [scale(&measured), scale(&simulated)];
            let name = checked.channels[c].split(" (").next().unwrap_or_default();
            let correlation = found.records[i].correlation;
            let title = format!("Record {number_of}, {name}: correlation {correlation:.2}");
            let x = Axis::new("time (s)", Scale::Linear, [0.0, end]);
            let y = Axis::new("relative to its largest value", Scale::Linear, [-1.1, 1.1]);
            let mut plot = Plot::new(&title, x, y);
            for (class, line, scale) in
                [("optimised", &simulated, scales[1]), ("truth", &measured, scales[0])]
            {
                plot.line(class, line.iter().map(|(t, y)| (*t, y / scale)));
                rows.extend(line.iter().map(|(t, y)| {
                    row![number_of, name, if class == "truth" { "measured" } else { "simulated" }, t, y]
                }));
            }
            pictures.push(plot.picture());
        }
    }
    let caption = format!(
        "The records with the lowest, median and highest correlation, each with its strongest acceleration and rotation rate. The \
         model has {} times the stiffness of the design, is smoothed as in the comparison, and uses the fitted clocks and axes.",
        number(found.stiffness)
    );
    let marks = [("truth", "measured"), ("optimised", "model")];
    let data = Table::new("record channel signal seconds value", rows);
    Some(Figure::new("followed", "Do the records follow the model?", caption, legend(&marks), pictures, data))
}

/// H₁ of each channel with that of the design, and the coherence.
fn response(trial: &TrialSpec, design: &[f64], checked: &Checked) -> Option<Figure> {
    let spectra = checked.spectra.as_ref()?;
    let frequencies = &spectra.frequencies;
    let hertz = || Axis::new("frequency (Hz)", Scale::Linear, [0.0, frequencies[frequencies.len() - 1]]);
    let read = trial.sensors.read();
    let (mut pictures, mut rows) = (Vec::new(), Vec::new());
    for (c, panels) in spectra.response.iter().enumerate() {
        let unit = trial.sensor_units.get(c / read.len());
        let kind = read[c % read.len()] as usize;
        let model = unit.and_then(|unit| responses(trial, design, *unit, frequencies).ok());
        let of_model = |n: usize, k: usize| model.as_ref().map(|model| model[n][k][kind].norm());
        let all = panels.iter().flatten().copied();
        let points = (0..frequencies.len()).flat_map(|n| (0..panels.len()).map(move |k| (n, k)));
        let name = checked.channels[c].split(" (").next().unwrap_or_default();
        let label = if kind == 2 { "rad/s per N" } else { "mm/s² per N" };
        let drawn = all.chain(points.filter_map(|(n, k)| of_model(n, k)));
        let mut plot = Plot::new(name, hertz(), Axis::new(label, Scale::Log, drawn));
        for (k, of) in panels.iter().enumerate() {
            let line = |of: &dyn Fn(usize) -> Option<f64>| -> Vec<(f64, f64)> {
                (0..frequencies.len()).filter_map(|n| Some((frequencies[n], of(n)?))).collect()
            };
            plot.line(&format!("{} dashed", SERIES[k % SERIES.len()]), line(&|n| of_model(n, k)));
            plot.line(SERIES[k % SERIES.len()], line(&|n| of.get(n).copied()));
            let coherent = |n: usize| spectra.coherence.as_ref().and_then(|of| of[c].get(n).copied());
            let row = |n: usize| row![name, k, frequencies[n], of[n], of_model(n, k), coherent(n)];
            rows.extend((0..of.len()).map(row));
        }
        pictures.push(plot.picture());
    }
    if let Some(coherence) = &spectra.coherence {
        let y = Axis::new("γ²", Scale::Linear, [0.0, 1.0]);
        let mut plot = Plot::new("Coherence: least and median of the channels", hertz(), y);
        for (class, part) in COHERENCE.into_iter().zip([0.5, 0.0]) {
            let at = |n: usize| {
                let mut all: Vec<f64> = coherence.iter().filter_map(|of| of.get(n).copied()).collect();
                all.sort_by(f64::total_cmp);
                all.get((part * all.len() as f64) as usize).copied()
            };
            plot.line(class, (0..frequencies.len()).filter_map(|n| Some((frequencies[n], at(n)?))));
        }
        pictures.push(plot.picture());
    }
    let panels = spectra.response.first().map_or(0, Vec::len);
    let mut marks: Vec<(&str, String)> =
        (0..panels).map(|k| (SERIES[k % SERIES.len()], format!("panel {k}; dashed: the design"))).collect();
    marks.extend([("truth", "median coherence".to_owned()), ("front", "least coherence".to_owned())]);
    let caption = "Frequency responses H₁ over all records, compared with those of small motions of the design. Readings above half the rate of \
                   the chip appear at lower frequencies. A low coherence at resonances and zeros of the force is usual.";
    let data = Table::new("channel panel frequency response design coherence", rows);
    Some(Figure::new("response", "How does the body respond?", caption, marks, pictures, data))
}
