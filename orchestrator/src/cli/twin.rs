//! `twin`: the cast of a body that best explains measured records of it.

use std::path::PathBuf;
use std::time::Instant;

use metasense_schemas::spec::TrialSpec;
use metasense_worker::identify::{Offset, Parameters};
use metasense_worker::run::{Failure, prepared};
use metasense_worker::twin::{self, Ending, Estimate, Fit, Unknown};
use serde_json::Value;

use super::identify::{DISCREPANCY, ends, name_of_start, starts, tell};
use super::named::{Designed, read_records};
use super::{Error, Format, duration, print_rows, write};
use crate::exit::Exit;
use crate::look::{Table, digits, row};

/// Fits a twin to measured records: material, chips and node positions of a cast
///
/// The unknowns are the quantities that [variation] of the spec varies; its standard deviations are the prior. Without
/// [variation]: stretch, shear and bend 5 %, damping 20 %, density 3 %, nodes 0.1 mm. The 95 % intervals include the error
/// of the model. Exit code 1 if the fit does not converge.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    one: Designed,
    /// The records (TOML; keys in schemas/README.md)
    #[arg(long, value_name = "TOML")]
    records: PathBuf,
    /// Writes the twin into this file (TOML), for `metasense lab evaluate --twin`
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Threads
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "Workers")]
    threads: u16,
    /// Format of the estimates
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let (_, trial, design) = &args.one.read().await?;
    let measured = read_records(&args.records, trial)?;
    let begun = Instant::now();
    let found = twin::fit(trial, design, &measured, args.threads.into());
    let found = found.map_err(|e| args.one.trial.failed(e))?;
    print_rows(&estimates(trial, &found).map_err(|e| args.one.trial.failed(e))?, args.format)?;
    let mut said = said(&found, measured.forces.samples);
    said.extend(starts(&measured, found.offsets.iter().copied()));
    tell(&said, args.format)?;
    say!("{}", duration(begun.elapsed().as_secs_f64()));
    if let Some(file) = &args.out {
        let text = toml::to_string(&twin::store(trial, design, &found.twin)).expect("a twin is TOML");
        write(file, text.into_bytes())?;
    }
    Ok(if found.ending == Ending::Converged { Exit::Done } else { Exit::Failed })
}

/// Digits of an estimate: material is found to a few thousandths.
const DIGITS: usize = 5;
/// Part of its scatter from which an unknown counts as not told: half of the variance is left.
const UNTOLD: f64 = std::f64::consts::FRAC_1_SQRT_2;

fn is_of_parts(estimate: &Estimate) -> bool {
    matches!(estimate.unknown, Unknown::Shift(_) | Unknown::Ligament(..) | Unknown::Unit(_))
}

/// A row for each unknown but those of nodes, ligaments and units.
fn estimates(trial: &TrialSpec, fit: &Fit) -> Result<Table, Failure> {
    let columns = "unknown unit start fitted lower upper scatter_left_percent outcome";
    let start = Parameters::of(&prepared(trial)?.scene).array();
    let row = |e: &Estimate| {
        let (name, unit, begun) = match e.unknown {
            Unknown::Material(p) => (p.name().to_owned(), p.unit(), start[p as usize]),
            Unknown::LigamentLength => ("ligament length".to_owned(), "mm", trial.body.lengths()[1]),
            Unknown::Gain(c) => (format!("gain of {}{}", ["ax", "ay", "ω"][c % 3], c / 3), "", 1.0),
            Unknown::Turn(chip) => (format!("turn of sensor {chip}"), "°", 0.0),
            Unknown::Shift(_) | Unknown::Ligament(..) | Unknown::Unit(_) => unreachable!("left out"),
        };
        let value = |z: f64| match e.unknown {
            Unknown::Turn(_) => (e.scatter * z).to_degrees(),
            _ => begun * (e.scatter * z).exp(),
        };
        let shown = |z: f64| Value::from(digits(value(z), DIGITS));
        let ends = [-1.0, 1.0].map(|way| e.half.map(|half| shown(e.found + way * half)));
        let outcome = if e.left > UNTOLD { "not identifiable" } else { fit.ending.name() };
        row![name, unit, begun, shown(e.found), ends[0], ends[1], 100.0 * e.left, outcome]
    };
    let of = |(n, offset): (usize, &Option<Offset>)| {
        let offset = offset.as_ref()?;
        let [value, lower, upper] = {
            let [lower, upper] = ends(offset);
            [Some(offset.value), lower, upper].map(|x| x.map(|x| Value::from(digits(x, DIGITS))))
        };
        let outcome = if offset.half.is_some() { fit.ending.name() } else { "at the bound" };
        Some(row![name_of_start(n), "s", 0.0, value, lower, upper, Value::Null, outcome])
    };
    let rows = fit.estimates.iter().filter(|e| !is_of_parts(e)).map(row);
    Ok(Table::new(columns, rows.chain(fit.offsets.iter().enumerate().filter_map(of))))
}

/// What there is to say beside.
fn said(fit: &Fit, records: usize) -> Vec<String> {
    let mut said = vec![format!(
        "{} after {} steps on {records} records; the residual of the signals is {:.2} times the noise of the chips, where the spec has some",
        fit.ending.name(),
        fit.steps,
        fit.twin.misfit
    )];
    if let Some(part) = fit.unmodelled.filter(|part| *part >= DISCREPANCY) {
        said.push(format!(
            "discrepancy: the motion explains {:.0} % of the residual, on records not used for this estimate; the intervals are wider for it",
            100.0 * part
        ));
    }
    let parts = [
        ("node shifts", "mm", Unknown::Shift(0)),
        ("stiffnesses of single ligaments", "of the logarithm", Unknown::Ligament(0, 0)),
        ("densities of single units", "of the logarithm", Unknown::Unit(0)),
    ];
    for (name, unit, kind) in parts {
        let alike = |e: &&Estimate| std::mem::discriminant(&e.unknown) == std::mem::discriminant(&kind);
        let of: Vec<&Estimate> = fit.estimates.iter().filter(alike).collect();
        let Some(first) = of.first() else { continue };
        let rms = |value: &dyn Fn(&Estimate) -> f64| {
            (of.iter().map(|e| value(e).powi(2)).sum::<f64>() / of.len() as f64).sqrt()
        };
        let untold = of.iter().filter(|e| e.left > UNTOLD).count();
        said.push(format!(
            "{name}: RMS {:.3} {unit}, {:.3} before; not determined by the records: {untold} of {}; remaining uncertainty of all: {:.3}",
            first.scatter * rms(&|e| e.found),
            first.scatter,
            of.len(),
            first.scatter * rms(&|e| e.left)
        ));
    }
    said
}
