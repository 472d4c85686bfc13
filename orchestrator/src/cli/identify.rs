//! `identify`: material parameters fitted to measured records.

use std::path::PathBuf;
use std::time::Instant;

use indicatif::ProgressBar;
use metasense_schemas::spec::Body;
use metasense_worker::identify::{
    BOX, Estimate, Identified, Iteration, Offset, Parameter, Parameters, Turn, UNEXPLAINED, Verdict, identify,
};
use metasense_worker::measured::Measured;
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

/// Fits stiffness, damping and density to measured records, with 95 % intervals
///
/// Starts from the values of the spec. A TOML file describes the records: forces, and the signals of the sensors under
/// these forces. Exit code 1 if the fit does not converge, or if the records do not determine all fitted parameters.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    one: Designed,
    /// The records (TOML; keys in schemas/README.md)
    #[arg(long, value_name = "TOML")]
    records: PathBuf,
    /// The parameters to fit; the others keep the values of the spec
    #[arg(long, value_enum, value_delimiter = ',', default_value = "stretch,shear,bend,damping,density")]
    fit: Vec<Fitted>,
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
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    end_on_signal(args.out_dir.as_deref());
    let (_, trial, design) = &args.one.read().await?;
    if let Some(key) = trial.sensors.changed_by() {
        let remedy = "must be left out: a fit compares all three signals of each sensor unchanged; use `metasense lab twin` for other \
                      readings";
        return Err(args.one.trial.refused_key(key, remedy));
    }
    let measured = read_records(&args.records, trial)?;
    let free: Vec<Parameter> = args.fit.iter().map(|&f| Parameter::ALL[f as usize]).collect();
    let begun = Instant::now();
    let bar = ProgressBar::new_spinner();
    let forces = (measured.forces.instants, &measured.forces.values);
    let names: Vec<&str> = free.iter().map(|parameter| parameter.name()).collect();
    let spec = serde_json::to_string(trial).expect("a trial is JSON");
    let signals = (&measured.signals, measured.start_deviation);
    let inputs = (spec, design, forces, signals, measured.low_pass, names);
    let (unfinished, kept) = Unfinished::new(args.out_dir.as_deref(), "identify", &inputs)?;
    let mut kept: Vec<Kept> = kept.unwrap_or_default();
    let known: Vec<Turn> = kept.iter().map(Kept::turn).collect();
    if !known.is_empty() {
        say!("resumed after {} iterations", known.len());
    }
    let mut watch = |turn: &Turn| {
        kept.push(Kept::of(turn));
        unfinished.keep(&kept);
        let i = turn.iteration;
        bar.set_message(format!(
            "first {:.3} s of the records: {:.1} % of the accelerations and {:.1} % of the rotation rates left",
            i.window, i.misfit[0], i.misfit[1]
        ));
        bar.tick();
    };
    let fit = identify(trial, design, &measured, &free, args.threads.into(), &known, &mut watch);
    let fit = fit.map_err(|e| args.one.trial.failed(e))?;
    bar.finish_and_clear();
    let found = estimates(&fit);
    let shown = readable(&found);
    match args.format {
        Format::Table => print_rows(&shown, args.format)?,
        _ => print_rows(&found, args.format)?,
    }
    let records = measured.forces.samples;
    let mut said = said(&fit, &trial.body, records);
    if fit.outcome != Verdict::NotExplained {
        said.extend(starts(&measured, fit.offsets.iter().copied().map(Some)));
    }
    if args.format == Format::Table {
        print_rows(&correlations(&fit), args.format)?;
    }
    tell(&said, args.format)?;
    say!("{}, {}", duration(begun.elapsed().as_secs_f64()), fit.solver);
    if let Some(folder) = &args.out_dir {
        let title = format!(
            "{}: parameters from {records} records",
            args.one.trial.source.file_stem().unwrap_or_default().display()
        );
        let drawn = pictures::figures(trial, &measured.signals, &fit);
        write_figures(folder, &drawn)?;
        write(&folder.join("estimates.csv"), found.csv())?;
        write(&folder.join("index.html"), pictures::html(&title, &shown, &said, &drawn))?;
        if !fit.signals[1].is_empty() {
            let shape = [records, trial.time.samples, 3 * trial.sensor_units.len()];
            write(&folder.join("signals.npy"), npy_bytes(&shape, &fit.signals[1]))?;
        }
    }
    unfinished.done()?;
    Ok(if fit.outcome == Verdict::Converged { Exit::Done } else { Exit::Failed })
}

/// Lines that stand beside rows: below a table, else among the messages.
pub(super) fn tell(lines: &[String], format: Format) -> Result<(), Error> {
    match format {
        Format::Table => lines.iter().try_for_each(|line| Ok(print_line!("{line}")?)),
        _ => {
            lines.iter().for_each(|line| say!("{line}"));
            Ok(())
        }
    }
}

/// A turn on disk.
#[derive(Serialize, Deserialize)]
struct Kept {
    window: f64,
    misfit: [f64; 2],
    parameters: [f64; 6],
    next: Option<([f64; 6], f64)>,
}

impl Kept {
    fn of(turn: &Turn) -> Self {
        let Iteration { window, misfit, parameters } = turn.iteration;
        Self { window, misfit, parameters: parameters.array(), next: turn.next }
    }

    fn turn(&self) -> Turn {
        let Self { window, misfit, parameters, next } = *self;
        let iteration = Iteration { window, misfit, parameters: Parameters::from_array(parameters) };
        Turn { iteration, next }
    }
}

/// A row a parameter.
fn estimates(fit: &Identified) -> Table {
    let columns = "parameter unit start fitted lower upper interval_percent outcome";
    // of what has an interval, whatever others lack
    let determined = match fit.outcome {
        Verdict::NotIdentifiable | Verdict::AtTheBound => Verdict::Converged,
        outcome => outcome,
    };
    let row = |e: &Estimate| {
        let [lower, upper] = e.interval.map_or([None; 2], |i| i.map(Some));
        let half = e.interval.map(|[low, high]| 50.0 * (high - low) / e.value);
        let bound = e.at_the_bound;
        let value = (bound || e.interval.is_some()).then_some(e.value);
        let outcome = match e.interval {
            _ if bound => Verdict::AtTheBound,
            None => Verdict::NotIdentifiable,
            Some(_) => determined,
        };
        row![e.parameter.name(), e.parameter.unit(), e.start, value, lower, upper, half, outcome.name()]
    };
    let of = |(n, offset): (usize, &Offset)| {
        let [lower, upper] = ends(offset);
        let outcome = if offset.half.is_some() { determined } else { Verdict::AtTheBound };
        row![name_of_start(n), "s", 0.0, offset.value, lower, upper, Value::Null, outcome.name()]
    };
    let rows = fit.estimates.iter().map(row);
    Table::new(columns, rows.chain(fit.offsets.iter().enumerate().map(of)))
}

/// How the error of a record's `signals.start` is called.
pub(super) fn name_of_start(record: usize) -> String {
    format!("start of record {record}")
}

/// The 95 % interval of an offset.
pub(super) fn ends(offset: &Offset) -> [Option<f64>; 2] {
    [-1.0, 1.0].map(|way| offset.half.map(|half| offset.value + way * half))
}

/// The line of the records' file with the fitted clocks, and which of them are at their bound.
pub(super) fn starts(measured: &Measured, offsets: impl Iterator<Item = Option<Offset>>) -> Vec<String> {
    let all: Vec<(f64, Option<Offset>)> = measured.starts.iter().copied().zip(offsets).collect();
    if all.is_empty() {
        return Vec::new();
    }
    // to the nanosecond, wherever a clock begins
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

/// With as many digits as tell the ends of an interval apart.
fn readable(found: &Table) -> Table {
    let mut shown = found.clone();
    for row in &mut shown.rows {
        let [Some(fitted), Some(low), Some(high)] = [3, 4, 5].map(|i| row[i].as_f64()) else { continue };
        let parts = (fitted.abs() / (high - low)).max(1.0).log10();
        let count = (parts.ceil().min(11.0) as usize + 2).max(4); // equal ends: all digits
        for value in &mut row[2..=5] {
            *value = value.as_f64().map_or(Value::Null, |x| json!(digits(x, count)));
        }
    }
    shown
}

fn correlations(fit: &Identified) -> Table {
    let names: String = fit.estimates.iter().map(|e| format!(" {}", e.parameter.name())).collect();
    let columns = format!("correlation{names}");
    let row = |(e, row): (&Estimate, &Vec<f64>)| row![e.parameter.name(); row];
    Table::new(&columns, fit.estimates.iter().zip(&fit.correlation).map(row))
}

/// Part of the residual that must follow from the motion for it to be called a discrepancy, and the misfit (%) from which it counts.
pub(super) const DISCREPANCY: f64 = 0.1;
const LEFT: f64 = 1.0;

/// What there is to say beside the estimates, and the lines for a spec.
fn said(fit: &Identified, body: &Body, records: usize) -> Vec<String> {
    let [start, end] = fit.misfit;
    let mut said = vec![
        format!("{} after {} iterations on {records} records", fit.outcome.name(), fit.iterations.len()),
        format!(
            "left of the signals' RMS: accelerations {:.2} -> {:.2} % ({:.4} mm/s²), rotation rates {:.2} -> {:.2} % ({:.4} rad/s)",
            start[0], end[0], fit.noise[0], start[1], end[1], fit.noise[1]
        ),
    ];
    if let Some(part) = fit.unmodelled.filter(|part| *part >= DISCREPANCY && end[0].max(end[1]) >= LEFT) {
        said.push(format!(
            "discrepancy: the motion explains {:.0} % of the residual, on records not used for this estimate; the model does not contain \
             this behaviour of the body; the intervals are wider for it",
            100.0 * part
        ));
    }
    for e in fit.estimates.iter().filter(|e| e.at_the_bound) {
        said.push(format!(
            "at the bound: {} is {} times the value of the spec, the limit of a fit; start from a spec with a value \
             beyond it",
            e.parameter.name(),
            if e.value > e.start { BOX } else { 1.0 / BOX }
        ));
    }
    for direction in &fit.undetermined {
        let parts = direction.exponents.iter().zip(&fit.estimates).filter(|(x, _)| x.abs() > 0.05);
        let parts: Vec<String> = parts.map(|(x, e)| format!("{}^{x:.2}", e.parameter.name())).collect();
        let factor = match direction.factor {
            f if f.is_finite() && f < 1e6 => format!("it may be {f:.1} times larger or smaller"),
            _ => "it has no effect".to_owned(),
        };
        said.push(format!("not identifiable: {}; {factor}", parts.join("·")));
    }
    if fit.outcome == Verdict::NotExplained {
        said.push(format!(
            "not explained: more than {UNEXPLAINED} % of the signals remain, so the values above are meaningless. Check the clock of the \
             signals (signals.start), their units and the order of channels"
        ));
    } else if !fit.estimates.is_empty() {
        let p = fit.parameters;
        // a spec with a size or a material would scale or replace what is fitted
        let lengths = [("spacing", body.spacing), ("ligament_length", body.ligament_length)];
        let lengths =
            lengths.map(|(key, mm)| mm.map_or(String::new(), |mm| format!("{key} = {}\n", exact(mm))));
        said.push(format!(
            "for a spec without body.diameter, body.width and body.material, which would change these:\n[body]\n{}density = {}\nstiffness = {{ stretch = {}, shear = {}, bend = {} }}\n{}",
            lengths.concat(),
            exact(p.density),
            exact(p.stretch),
            exact(p.shear),
            exact(p.bend),
            match body.damping {
                Some(given) => format!("damping = [{}]", given.map(|c| exact(c * p.damping_ratio)).join(", ")),
                None => format!("damping_ratio = {}", exact(p.damping_ratio)),
            },
        ));
        if fit.estimates.iter().any(|e| e.parameter == Parameter::Contact) {
            said.push(format!("contact.stiffness = {}", exact(p.contact)));
        }
    }
    said
}

/// Six significant digits, as TOML reads them.
fn exact(value: f64) -> String {
    let rounded: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    if (1e-3..1e6).contains(&rounded) { format!("{rounded:?}") } else { format!("{rounded:e}") }
}

#[cfg(test)]
mod tests;
