//! Figures of an identification: records with fitted signals, and convergence.

use maud::html;
use metasense_lab::identify::Fit;
use metasense_schemas::spec::{Channel, TrialSpec};

use super::strips::least_median_greatest;
use crate::look::{Axis, Figure, Plot, Scale, Table, number, page, row};

/// Figures of a fit to `signals` (N, T, channels).
pub fn figures(trial: &TrialSpec, signals: &[f64], fit: &Fit) -> Vec<Figure> {
    let followed = (!fit.measured.signals[1].is_empty()).then(|| records(trial, signals, fit));
    followed.into_iter().chain([course(fit)]).collect()
}

/// The page: estimates, notes, figures.
pub fn html(title: &str, found: &Table, notes: &[String], figures: &[Figure]) -> String {
    let content = html! {
        (found.html(None))
        @for note in notes { pre { (note) } }
        @for figure in figures { (figure.html(&[])) }
    };
    page(title, "Which material explains these records?", content)
}

/// Records of least, median and greatest misfit: the acceleration and the rotation rate that move most.
fn records(trial: &TrialSpec, signals: &[f64], fit: &Fit) -> Figure {
    let (instants, width, read) = (trial.time.samples, trial.signals(), trial.sensors.read());
    let len = instants * width;
    let count = signals.len() / len;
    let dt = trial.time.duration / instants as f64;
    let [before, after] = &fit.measured.signals;
    let of = |values: &[f64], r: usize, c: usize| -> Vec<f64> {
        (0..instants).map(|n| values[r * len + n * width + c]).collect()
    };
    let size = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
    let is_rate = |c: usize| read[c % read.len()] == Channel::Omega;
    let channel = |rate: bool| {
        let energy = |c: &usize| (0..count).map(|r| size(&of(signals, r, *c))).sum::<f64>();
        (0..width).filter(|c| is_rate(*c) == rate).max_by(|a, b| energy(a).total_cmp(&energy(b)))
    };
    let shown: Vec<usize> = [false, true].into_iter().filter_map(channel).collect();
    let misfit = |r: usize| -> f64 {
        let off = |c: usize| {
            let (measured, fitted) = (of(signals, r, c), of(after, r, c));
            let rest: Vec<f64> = measured.iter().zip(&fitted).map(|(y, a)| y - a).collect();
            (size(&rest) / size(&measured).max(f64::MIN_POSITIVE)).sqrt()
        };
        100.0 * (shown.iter().map(|c| off(*c).powi(2)).sum::<f64>() / shown.len() as f64).sqrt()
    };
    let (mut pictures, mut rows) = (Vec::new(), Vec::new());
    for r in least_median_greatest(count, misfit) {
        for &c in &shown {
            let [measured, started, fitted] = [signals, before, after].map(|v| of(v, r, c));
            let unit = trial.sensor_units[c / read.len()];
            let name = read[c % read.len()].symbol();
            let (scale, units) = if is_rate(c) { (1.0, "rad/s") } else { (1e-3, "m/s²") };
            let label = format!("{name} of unit {unit} ({units})");
            let time = |n: usize| (n + 1) as f64 * dt;
            // Curves of a bad start are cut at the frame, so that they do not set its scale.
            let most = measured.iter().chain(&fitted).fold(0.0f64, |m, y| m.max(y.abs()));
            let (title, reach) = (format!("Record {r}: misfit {} %", number(misfit(r))), 1.15 * scale * most);
            let x = Axis::new("time (s)", Scale::Linear, [0.0, trial.time.duration]);
            let y = Axis::new(&label, Scale::Linear, [-reach, reach]);
            let mut plot = Plot::new(&title, x, y).sized(560.0, 260.0);
            let points = |v: &[f64]| -> Vec<(f64, f64)> {
                v.iter().enumerate().map(|(n, y)| (time(n), (scale * y).clamp(-reach, reach))).collect()
            };
            let rest: Vec<f64> = measured.iter().zip(&fitted).map(|(y, a)| y - a).collect();
            plot.line("initial fine", points(&started));
            plot.line("optimised", points(&fitted));
            plot.line("front fine", points(&rest));
            // Thin on wide: both lines are visible where they agree.
            plot.line("truth", points(&measured));
            pictures.push(plot.picture());
            let row = |n: usize| row![r, unit, name, time(n), measured[n], started[n], fitted[n]];
            rows.extend((0..instants).map(row));
        }
    }
    Figure::new(
        "fit",
        "Do the simulated signals follow the records?",
        format!(
            "The records of least, median and greatest misfit of {count}, each with the channel of acceleration and of \
             rotation rate that moves most. Curves for the start values are clipped at the frame. Misfit over all records: {} % of the \
             accelerations' RMS and {} % of the rotation rates'; at the start {} % and {} %.",
            number(fit.measured.misfit[1][0]),
            number(fit.measured.misfit[1][1]),
            number(fit.measured.misfit[0][0]),
            number(fit.measured.misfit[0][1]),
        ),
        vec![
            ("truth", "measured".into()),
            ("optimised", "fitted".into()),
            ("initial", "start".into()),
            ("front", "measured − fitted".into()),
        ],
        pictures,
        Table::new("record unit channel seconds measured start fitted", rows),
    )
}

/// Misfit and parameters against iterations.
fn course(fit: &Fit) -> Figure {
    let steps: Vec<f64> = (1..=fit.measured.iterations.len()).map(|i| i as f64).collect();
    let axis = || Axis::new("iteration", Scale::Linear, [0.0, steps.len() as f64]);
    let misfits = fit.measured.iterations.iter().flat_map(|i| i.misfit);
    let label = "misfit in the window (%)";
    let mut off = Plot::new("Misfit", axis(), Axis::new(label, Scale::Log, misfits)).sized(560.0, 280.0);
    for (kind, class) in [(0, "truth"), (1, "front")] {
        off.line(class, steps.iter().zip(&fit.measured.iterations).map(|(n, i)| (*n, i.misfit[kind])));
    }
    let mut pictures = vec![off.picture()];
    let fitted: Vec<_> = fit.estimates.iter().filter_map(|e| e.unknown.parameter()).collect();
    for &parameter in &fitted {
        let way = fit.measured.iterations.iter().map(|i| i.parameters.array()[parameter as usize]);
        let unit =
            if parameter.unit().is_empty() { String::new() } else { format!(" ({})", parameter.unit()) };
        let label = format!("{}{unit}", parameter.name());
        let value = way.clone().next_back().unwrap_or(1.0);
        let span = way.clone().chain([0.8 * value, 1.25 * value]);
        let title = format!("{}: {}", parameter.name(), number(value));
        let mut plot = Plot::new(&title, axis(), Axis::new(&label, Scale::Log, span)).sized(560.0, 280.0);
        plot.line("optimised", steps.iter().copied().zip(way));
        pictures.push(plot.picture());
    }
    let rows = fit.measured.iterations.iter().enumerate().map(|(n, i)| {
        let found = fitted.iter().map(|parameter| i.parameters.array()[*parameter as usize]);
        row![n + 1, i.window, i.misfit[0], i.misfit[1]; found]
    });
    let names: String = fitted.iter().map(|parameter| format!(" {}", parameter.name())).collect();
    let columns = format!("iteration window_seconds misfit_acceleration misfit_rotation{names}");
    Figure::new(
        "convergence",
        "How did the fit converge?",
        "Misfit within a window that starts at each record's first force and grows. Where the fit fails in a window, it \
         starts again from other values.",
        vec![("truth", "accelerations".into()), ("front", "rotation rates".into())],
        pictures,
        Table::new(&columns, rows),
    )
}
