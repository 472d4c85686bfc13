//! `identify`: fits material parameters and a twin to measured records of a body.

use std::path::PathBuf;
use std::time::Instant;

use indicatif::ProgressBar;
use metasense_lab::identify::{
    BOX, Ending, Estimate, Fit, FitIteration, Iteration, Offset, Parameter, Parameters, UNEXPLAINED, Unknown,
    identify,
};
use metasense_lab::measured::Measured;
use metasense_lab::prepare::prepared;
use metasense_lab::twin;
use metasense_schemas::spec::TrialSpec;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::named::{Designed, read_records};
use super::report::write_figures;
use super::unfinished::Unfinished;
use super::{Error, Format, duration, end_on_signal, print_rows, write};
use crate::exit::Exit;
use crate::look::{Table, digits, row};
use crate::report::fit as pictures;
use crate::store::npy_bytes;

/// Fits material and twins to measured records, with 95 % intervals
///
/// Starts from the values of the spec. A TOML file describes the records: forces, and the signals of the sensors under
/// these forces. The other quantities in [variation] are also fitted; their standard deviations are the prior.
/// Without [variation]: nodes 0.1 mm. Exit code 1 if the fit does not converge, or if the records do not determine all
/// fitted parameters.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    one: Designed,
    /// The records (TOML; keys in docs/reference/measured.md)
    #[arg(long, value_name = "TOML")]
    records: PathBuf,
    /// The parameters to fit; the others keep the values of the spec. `variation` fits those that [variation] varies, with its
    /// standard deviations as the prior, which few records need (without [variation]: stiffnesses 5 %, damping 20 %,
    /// density 3 %)
    #[arg(long, value_enum, value_delimiter = ',', default_value = "stretch,shear,bend,damping,density")]
    fit: Vec<Fitted>,
    /// Writes the twin, a model of the measured body, into this file (TOML), for `metasense lab evaluate --twin`
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Threads
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "Workers")]
    threads: u16,
    /// Writes a page (index.html), its figures (SVG) with their data, and the fitted signals (NPY) into this folder. During
    /// the fit, the folder keeps the finished iterations; the same command resumes from there
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out_dir: Option<PathBuf>,
    /// Format of the estimates
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Fitted {
    Stretch,
    Shear,
    Bend,
    Damping,
    Density,
    Contact,
    Variation,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    end_on_signal(args.out_dir.as_deref());
    let (_, trial, design) = &args.one.read().await?;
    let measured = read_records(&args.records, trial)?;
    let free: Vec<_> = args.fit.iter().filter_map(|&f| Parameter::ALL.get(f as usize)).copied().collect();
    if !free.is_empty() && free.len() < args.fit.len() {
        return usage!("--fit variation: must stand alone; leave out the other parameters");
    }
    let started_at = Instant::now();
    let bar = ProgressBar::new_spinner();
    let forces = (measured.forces.instants, &measured.forces.values);
    let names: Vec<&str> = free.iter().map(|parameter| parameter.name()).collect();
    let spec = serde_json::to_string(trial).expect("a trial is JSON");
    let signals = (&measured.signals, measured.start_deviation);
    let inputs = (spec, design, forces, signals, measured.low_pass, names);
    let (unfinished, kept) = Unfinished::new(args.out_dir.as_deref(), "identify", &inputs)?;
    let mut kept: Vec<StoredIteration> = kept.unwrap_or_default();
    let prior_turns: Vec<FitIteration> = kept.iter().map(StoredIteration::turn).collect();
    if !prior_turns.is_empty() {
        say!("resumed after {} iterations", prior_turns.len());
    }
    let mut watch = |turn: &FitIteration| {
        kept.push(StoredIteration::of(turn));
        unfinished.keep(&kept);
        let i = turn.iteration;
        bar.set_message(format!(
            "first {:.3} s of the records: misfit {:.1} % of the accelerations and {:.1} % of the rotation rates",
            i.window, i.misfit[0], i.misfit[1]
        ));
        bar.tick();
    };
    let fit = identify(trial, design, &measured, &free, args.threads.into(), &prior_turns, &mut watch);
    let fit = fit.map_err(|e| args.one.trial.failed(e))?;
    bar.finish_and_clear();
    let start = prepared(trial).map_err(|e| args.one.trial.failed(e))?;
    let start = Parameters::of(&start.scene);
    let found = estimates(trial, &start, &fit);
    let shown = readable(&found);
    print_rows(if args.format == Format::Table { &shown } else { &found }, args.format)?;
    let records = measured.forces.samples;
    let mut messages = fit_messages(trial, &start, &fit, records);
    if fit.ending != Ending::NotExplained {
        messages.extend(fitted_starts(&measured, &fit.offsets));
    }
    if args.format == Format::Table && !fit.correlation.is_empty() {
        print_rows(&correlations(&fit), args.format)?;
    }
    for line in &messages {
        match args.format {
            Format::Table => print_line!("{line}")?,
            _ => say!("{line}"),
        }
    }
    say!("{}, {}", duration(started_at.elapsed().as_secs_f64()), fit.measured.solver);
    if let Some(folder) = &args.out_dir {
        let name = args.one.trial.source.file_stem().unwrap_or_default().display();
        let title = format!("{name}: parameters from {records} records");
        let drawn = pictures::figures(trial, &measured.signals, &fit);
        write_figures(folder, &drawn)?;
        write(&folder.join("estimates.csv"), found.csv())?;
        write(&folder.join("index.html"), pictures::html(&title, &shown, &messages, &drawn))?;
        if !fit.measured.signals[1].is_empty() {
            let shape = [records, trial.time.samples, trial.signals()];
            write(&folder.join("signals.npy"), npy_bytes(&shape, &fit.measured.signals[1]))?;
        }
    }
    if let Some(file) = &args.out {
        let text = toml::to_string(&twin::store(trial, design, &fit.twin)).expect("a twin is TOML");
        write(file, text.into_bytes())?;
    }
    unfinished.done()?;
    Ok(if fit.ending == Ending::Converged { Exit::Done } else { Exit::Failed })
}

/// An iteration of the fit on disk.
#[derive(Serialize, Deserialize)]
struct StoredIteration {
    window: f64,
    misfit: [f64; 2],
    parameters: [f64; 6],
    z: Vec<f64>,
    ending: usize,
    steps: usize,
}

impl StoredIteration {
    fn of(turn: &FitIteration) -> Self {
        let Iteration { window, misfit, parameters } = turn.iteration;
        let (z, ending, steps) = (turn.z.clone(), turn.ending as usize, turn.steps);
        Self { window, misfit, parameters: parameters.array(), z, ending, steps }
    }

    fn turn(&self) -> FitIteration {
        let &Self { window, misfit, parameters, ending, steps, .. } = self;
        let iteration = Iteration { window, misfit, parameters: Parameters::from_array(parameters) };
        FitIteration { iteration, z: self.z.clone(), ending: Ending::ALL[ending], steps }
    }
}

/// Remaining fraction of the prior standard deviation above which an unknown counts as not determined (half of the variance).
const UNDETERMINED: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Number of free parameters; their estimates come first.
fn free(fit: &Fit) -> usize {
    fit.correlation.len()
}

/// One row per unknown of the whole cast and per clock.
fn estimates(trial: &TrialSpec, start: &Parameters, fit: &Fit) -> Table {
    let columns = "parameter unit start fitted lower upper interval_percent outcome";
    // outcome of rows with an interval, even if others have none
    let determined = match fit.ending {
        Ending::NotIdentifiable | Ending::AtTheBound => Ending::Converged,
        outcome => outcome,
    };
    let row = |(k, e): (usize, &Estimate)| {
        let (name, unit, start) = match e.unknown {
            Unknown::Material(p) => (p.name().to_owned(), p.unit(), start.array()[p as usize]),
            Unknown::LigamentLength => ("ligament length".to_owned(), "mm", trial.body.lengths()[1]),
            Unknown::Gain(c) => (format!("gain of {}{}", ["ax", "ay", "ω"][c % 3], c / 3), "", 1.0),
            Unknown::Turn(chip) => (format!("misalignment of sensor {chip}"), "°", 0.0),
            Unknown::Sharpness | Unknown::Shift(_) | Unknown::Ligament(..) | Unknown::Unit(_) => return None,
        };
        let value = |z: f64| match e.unknown {
            Unknown::Turn(_) => (e.scatter * z).to_degrees(),
            _ => start * (e.scatter * z).exp(),
        };
        let ends = [-1.0, 1.0].map(|way| e.half.map(|half| value(e.found + way * half)));
        let shown = (k >= free(fit) || e.at_the_bound || e.half.is_some()).then(|| value(e.found));
        let half = match (shown, ends) {
            (Some(value), [Some(low), Some(high)]) if start > 0.0 => Some(50.0 * (high - low) / value),
            _ => None,
        };
        let outcome = match e.half {
            _ if e.at_the_bound => Ending::AtTheBound,
            None => Ending::NotIdentifiable,
            Some(_) if k >= free(fit) && e.left > UNDETERMINED => Ending::NotIdentifiable,
            Some(_) => determined,
        };
        Some(row![name, unit, start, shown, ends[0], ends[1], half, outcome.name()])
    };
    let of = |(n, offset): (usize, &Option<Offset>)| {
        let offset = offset.as_ref()?;
        let [lower, upper] = [-1.0, 1.0].map(|way| offset.half.map(|half| offset.value + way * half));
        let outcome = if offset.half.is_some() { determined } else { Ending::AtTheBound };
        let name = format!("start of record {n}");
        Some(row![name, "s", 0.0, offset.value, lower, upper, Value::Null, outcome.name()])
    };
    let rows = fit.estimates.iter().enumerate().filter_map(row);
    Table::new(columns, rows.chain(fit.offsets.iter().enumerate().filter_map(of)))
}

/// The fitted `signals.start` for the file of records, after a warning about clocks at their bound.
fn fitted_starts(measured: &Measured, offsets: &[Option<Offset>]) -> Vec<String> {
    let all: Vec<_> = measured.starts.iter().copied().zip(offsets.iter().copied()).collect();
    if all.is_empty() {
        return Vec::new();
    }
    // nine decimals: nanoseconds, whatever the start
    let fitted = all.iter().map(|(start, offset)| format!("{:.9}", start + offset.map_or(0.0, |o| o.value)));
    let lines = format!(
        "for the file of the records, without start_deviation:\n[signals]\nstart = [{}]",
        fitted.collect::<Vec<_>>().join(", ")
    );
    let bound = all.iter().enumerate().filter(|(_, (_, o))| o.is_some_and(|o| o.half.is_none()));
    let bound: Vec<String> = bound.map(|(n, _)| n.to_string()).collect();
    let warning = (!bound.is_empty()).then(|| {
        format!(
            "at the bound: the start of record {} is off by three times signals.start_deviation = {}; correct signals.start or raise \
             start_deviation",
            bound.join(", "),
            measured.start_deviation
        )
    });
    warning.into_iter().chain([lines]).collect()
}

/// Rounds each row to the digits that distinguish the ends of its interval.
fn readable(found: &Table) -> Table {
    let mut shown = found.clone();
    for row in &mut shown.rows {
        let [Some(fitted), Some(low), Some(high)] = [3, 4, 5].map(|i| row[i].as_f64()) else { continue };
        let log_precision = (fitted.abs() / (high - low)).max(1.0).log10();
        let count = (log_precision.ceil().min(11.0) as usize + 2).max(4); // equal ends: all digits
        for value in &mut row[2..=5] {
            *value = value.as_f64().map_or(Value::Null, |x| json!(digits(x, count)));
        }
    }
    shown
}

fn correlations(fit: &Fit) -> Table {
    let name = |e: &Estimate| e.unknown.parameter().expect("it is free").name();
    let names: String = fit.estimates[..free(fit)].iter().map(|e| format!(" {}", name(e))).collect();
    let columns = format!("correlation{names}");
    let row = |(e, row): (&Estimate, &Vec<f64>)| row![name(e); row];
    Table::new(&columns, fit.estimates.iter().zip(&fit.correlation).map(row))
}

/// Fraction of the residual explained by the motion, and misfit (%), from which a discrepancy is reported.
const DISCREPANCY: f64 = 0.1;
const MISFIT_MIN: f64 = 1.0;

/// Messages about the fit, and the lines for a spec.
fn fit_messages(trial: &TrialSpec, begun: &Parameters, fit: &Fit, records: usize) -> Vec<String> {
    let ([start, end], body) = (fit.measured.misfit, &trial.body);
    let mut said = vec![
        format!("{} after {} steps on {records} records", fit.ending.name(), fit.steps),
        format!(
            "misfit relative to the signals' RMS: accelerations {:.2} -> {:.2} % ({:.4} mm/s²), rotation rates {:.2} -> {:.2} % ({:.4} rad/s)",
            start[0], end[0], fit.measured.residual[0], start[1], end[1], fit.measured.residual[1]
        ),
    ];
    if fit.twin.misfit.is_finite() && fit.twin.misfit != 1.0 {
        let misfit = fit.twin.misfit;
        said.push(format!("the residual of the signals is {misfit:.2} times the noise of the chips"));
    }
    if let Some(part) = fit.unmodelled.filter(|part| *part >= DISCREPANCY && end[0].max(end[1]) >= MISFIT_MIN)
    {
        said.push(format!(
            "discrepancy: the motion explains {:.0} % of the residual on other records than those of this estimate; the model does not contain \
             this behaviour of the body; the intervals are wider for it",
            100.0 * part
        ));
    }
    let named = |k: usize| fit.estimates[k].unknown.parameter().map_or("", Parameter::name);
    for (k, e) in fit.estimates.iter().enumerate().filter(|(_, e)| e.at_the_bound) {
        said.push(format!(
            "at the bound: {} is {} times the value of the spec, the limit of a fit; start from a spec with a value \
             beyond it",
            named(k),
            if e.found > 0.0 { BOX } else { 1.0 / BOX }
        ));
    }
    for direction in &fit.undetermined {
        let factors = direction.exponents.iter().enumerate().filter(|(_, x)| x.abs() > 0.05);
        let parts: Vec<String> = factors.map(|(k, x)| format!("{}^{x:.2}", named(k))).collect();
        let factor = match direction.factor {
            f if f.is_finite() && f < 1e6 => format!("it may be {f:.1} times larger or smaller"),
            _ => "it has no effect".to_owned(),
        };
        said.push(format!("not identifiable: {}; {factor}", parts.join("·")));
    }
    said.extend(parts(fit));
    if fit.ending == Ending::NotExplained {
        said.push(format!(
            "not explained: more than {UNEXPLAINED} % of the signals remain, so the values above are meaningless. Check the clock of the \
             signals (signals.start), their units and the order of channels"
        ));
    } else if free(fit) > 0 {
        let mut own = begun.array();
        own.iter_mut().zip(fit.twin.cast.material.array()).for_each(|(own, by)| *own *= by);
        let p = Parameters::from_array(own);
        // size or material in a spec would scale or replace the fitted values
        let lengths = [("spacing", body.spacing), ("ligament_length", body.ligament_length)];
        let lengths = lengths
            .map(|(key, mm)| mm.map_or(String::new(), |mm| format!("{key} = {}\n", format_toml_number(mm))));
        said.push(format!(
            "for a spec without body.diameter, body.width and body.material, which would change these:\n[body]\n{}density = {}\nstiffness = {{ stretch = {}, shear = {}, bend = {} }}\n{}",
            lengths.concat(),
            format_toml_number(p.density),
            format_toml_number(p.stretch),
            format_toml_number(p.shear),
            format_toml_number(p.bend),
            match body.damping {
                Some(given) => format!("damping = [{}]", given.map(|c| format_toml_number(c * p.damping_ratio)).join(", ")),
                None => format!("damping_ratio = {}", format_toml_number(p.damping_ratio)),
            },
        ));
        if fit.estimates.iter().any(|e| e.unknown.parameter() == Some(Parameter::Contact)) {
            said.push(format!("contact.stiffness = {}", format_toml_number(p.contact)));
        }
    }
    said
}

/// Messages about node shifts, and about single ligaments and units.
fn parts(fit: &Fit) -> impl Iterator<Item = String> {
    let kinds = [
        ("node shifts", "mm", Unknown::Shift(0)),
        ("stiffnesses of single ligaments", "of the logarithm", Unknown::Ligament(0, 0)),
        ("densities of single units", "of the logarithm", Unknown::Unit(0)),
    ];
    kinds.into_iter().filter_map(|(name, unit, kind)| {
        let alike = |e: &&Estimate| std::mem::discriminant(&e.unknown) == std::mem::discriminant(&kind);
        let same_kind: Vec<&Estimate> = fit.estimates.iter().filter(alike).collect();
        let first = same_kind.first()?;
        let rms = |value: &dyn Fn(&Estimate) -> f64| {
            (same_kind.iter().map(|e| value(e).powi(2)).sum::<f64>() / same_kind.len() as f64).sqrt()
        };
        let untold = same_kind.iter().filter(|e| e.left > UNDETERMINED).count();
        Some(format!(
            "{name}: fitted RMS {:.3} {unit}, prior standard deviation {:.3}; not determined by the records: {untold} of {}; posterior standard deviation (RMS): {:.3}",
            first.scatter * rms(&|e| e.found),
            first.scatter,
            same_kind.len(),
            first.scatter * rms(&|e| e.left)
        ))
    })
}

/// Six significant digits in TOML syntax.
fn format_toml_number(value: f64) -> String {
    let rounded: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    if (1e-3..1e6).contains(&rounded) { format!("{rounded:?}") } else { format!("{rounded:e}") }
}

#[cfg(test)]
mod tests;
