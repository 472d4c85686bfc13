//! `protocols`: held-out error of each protocol's body against CPU seconds of its training.
//!
//! Shows the best default of `optimise.protocol`. All bodies are evaluated with new networks from the same initial weights; the
//! time of evaluations does not count.

mod course;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use metasense::analysis::numbers::network_mean;
use metasense::cli::{Error, Format, print_rows, read_plan};
use metasense::exit::Exit;
use metasense::look::row;
use metasense::look::{Axis, Plot, SERIES, Scale, Table, file};
use metasense::say;
use metasense_lab::prepare::evaluate_designs;
use metasense_schemas::record::BodyRecord;
use metasense_schemas::spec::{Optimise, Protocol, TrialSpec};
use metasense_worker::run::NoResult;
use serde_json::{Value, json};

use crate::{append, file_name};
use course::course;

/// Held-out error against CPU seconds, one line per protocol
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Spec file (TOML); its first trial is the scene
    #[arg(required_unless_present = "redraw")]
    spec: Option<PathBuf>,
    /// Measure nothing; draw the rows of the file again
    #[arg(long, conflicts_with = "spec")]
    redraw: bool,
    /// Protocols, each at its own defaults; the protocol of the spec with the keys of the spec
    #[arg(long, value_delimiter = ',', default_values = ["paper", "joint"])]
    protocols: Vec<String>,
    /// CPU seconds at which the body is evaluated, ascending; the last ends a protocol
    #[arg(long, value_delimiter = ',', default_values_t = [15.0, 30.0, 60.0, 120.0, 240.0])]
    seconds: Vec<f64>,
    /// File to which the rows are appended as JSON lines; a plot of all rows is written beside it, as .svg
    #[arg(long, value_name = "FILE", default_value = "results/protocols.jsonl")]
    append: PathBuf,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

const COLUMNS: &str = "protocol cpu_seconds step fresh_samples error_percent holdout_error_percent";

pub fn execute(args: &Args) -> Result<Exit, Error> {
    if let Some(spec) = &args.spec {
        measure(args, spec)?;
    }
    let picture = args.append.with_extension("svg");
    let file = |doing, path: &Path, source| Error::Io { doing, path: path.into(), source };
    let rows = std::fs::read_to_string(&args.append).map_err(|e| file("reading", &args.append, e))?;
    std::fs::write(&picture, draw(&rows)).map_err(|e| file("writing", &picture, e))?;
    Ok(Exit::Done)
}

/// Runs the protocols, prints the rows and appends them to the file.
fn measure(args: &Args, path: &Path) -> Result<(), Error> {
    if args.seconds.is_empty() || !args.seconds.is_sorted() {
        return Err(Error::Usage(format!("--seconds {:?}: must ascend", args.seconds)));
    }
    let plan = read_plan(path)?;
    let spec = &plan.trials.first().ok_or_else(|| Error::Usage("the spec has no trial".into()))?.spec;
    let trials: Vec<TrialSpec> =
        args.protocols.iter().map(|name| with_protocol(spec, name)).collect::<Result<_, _>>()?;

    let mut table = Table::new(COLUMNS, []);
    let initial = evaluate_designs(spec, &[initial_design(spec)?], 1).map_err(failed)?;
    table.rows.push(row!["initial", 0, 0, 0, test(&initial[0]), holdout(&initial[0])]);
    for (trial, name) in trials.iter().zip(&args.protocols) {
        say!("{name}: {} steps or {} s", trial.optimise.steps(), args.seconds[args.seconds.len() - 1]);
        let milestones = course(trial, &args.seconds, 1).map_err(failed)?;
        let designs: Vec<Vec<f64>> = milestones.iter().map(|m| m.design.clone()).collect();
        for (m, body) in milestones.iter().zip(evaluate_designs(spec, &designs, 1).map_err(failed)?) {
            table.rows.push(row![name, m.seconds, m.step, m.fresh_samples, test(&body), holdout(&body)]);
        }
    }
    print_rows(&table, args.format)?;
    let head = json!({
        "bench": "protocols", "panels": spec.point.panels, "sensors": spec.point.sensors,
        "seed": spec.point.seed, "spec": file_name(path),
    });
    append(&args.append, &head, &table)
}

fn failed(failure: NoResult) -> Error {
    Error::Usage(failure.to_string())
}

/// The spec's trial with another protocol and its defaults.
fn with_protocol(spec: &TrialSpec, name: &str) -> Result<TrialSpec, Error> {
    let protocol: Protocol = serde_json::from_value(json!(name))
        .map_err(|_| Error::Usage(format!("--protocols {name}: must be paper or joint")))?;
    let optimise = match spec.optimise.protocol == protocol {
        true => spec.optimise.clone(),
        false => Optimise { protocol, ..Optimise::default() }.resolved(),
    };
    Ok(TrialSpec { optimise, ..spec.clone() })
}

fn initial_design(spec: &TrialSpec) -> Result<Vec<f64>, Error> {
    metasense_worker::problem::problem(spec)
        .map(|problem| problem.initial)
        .map_err(|invalid| Error::Usage(invalid.to_string()))
}

fn holdout(body: &BodyRecord) -> Option<f64> {
    network_mean(&body.networks, |network| network.error_holdout)
}

fn test(body: &BodyRecord) -> Option<f64> {
    network_mean(&body.networks, |network| network.error_test)
}

/// Plots JSON lines as an SVG file, one line per protocol.
fn draw(rows: &str) -> String {
    let (mut lines, mut initial) = (BTreeMap::<String, Vec<(f64, f64)>>::new(), None);
    for row in rows.lines().filter_map(|row| serde_json::from_str::<Value>(row).ok()) {
        let number = |key: &str| row[key].as_f64();
        match (row["protocol"].as_str(), number("cpu_seconds"), number("holdout_error_percent")) {
            (Some("initial"), _, error) => initial = error,
            (Some(name), Some(seconds), Some(error)) => {
                lines.entry(name.to_owned()).or_default().push((seconds, error));
            }
            _ => {}
        }
    }
    lines.values_mut().for_each(|points| points.sort_by(|a, b| a.0.total_cmp(&b.0)));
    let points = || lines.values().flatten().copied();
    let x = Axis::new("CPU seconds of the outer steps", Scale::Log, points().map(|p| p.0));
    let y = Axis::new("holdout error (%)", Scale::Log, points().map(|p| p.1).chain(initial));
    let names = lines.keys().map(String::as_str);
    let mut plot = Plot::new("Holdout error against CPU time", x, y).sized(560.0, 344.0).with_room(names);
    if let (Some(error), Some(end)) = (initial, points().map(|p| p.0).reduce(f64::max)) {
        let start = points().map(|p| p.0).fold(end, f64::min);
        plot.line("equal", [(start, error), (end, error)]);
        plot.note((start, error), "initial body");
    }
    for ((name, points), class) in lines.iter().zip(SERIES.iter().cycle()) {
        plot.line(class, points.iter().copied());
        plot.dots(class, points.iter().map(|&p| (p, format!("{name}: {:.0} s, {:.1} %", p.0, p.1))));
        if let Some(&end) = points.last() {
            plot.note(end, name);
        }
    }
    file(&[plot.picture()], 1, 560.0, &Vec::new())
}

#[cfg(test)]
mod tests;
