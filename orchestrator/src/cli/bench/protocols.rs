//! `bench protocols`: the holdout error that each protocol's body has reached against the CPU seconds that it took.
//!
//! It decides the default of `optimise.protocol`. All bodies meet fresh networks of the same initial weights; these
//! evaluations are not counted.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use metasense_schemas::record::BodyEvaluation;
use metasense_schemas::spec::{Optimise, Protocol, TrialSpec};
use metasense_worker::course::{course, evaluate};
use serde_json::json;

use super::super::{Error, Format, print_rows, read_plan};
use crate::exit::Exit;
use crate::report::plot::{Axis, Plot, Scale};
use crate::store::Table;

/// Holdout error against CPU seconds, a line a protocol
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Args {
    /// The spec file (TOML), whose first trial is the scene
    spec: PathBuf,
    /// Protocols, each at its own defaults; that of the spec as the spec says
    #[arg(long, value_delimiter = ',', default_values = ["paper", "warm", "envelope", "joint"])]
    protocols: Vec<String>,
    /// CPU seconds at which a body is kept, ascending; the last one ends a protocol
    #[arg(long, value_delimiter = ',', default_values_t = [15.0, 30.0, 60.0, 120.0, 240.0])]
    seconds: Vec<f64>,
    /// Where the rows are appended as JSON lines, and the plot is drawn with `.svg` instead
    #[arg(long, value_name = "FILE", default_value = "results/protocols.jsonl")]
    append: PathBuf,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

const COLUMNS: [&str; 6] =
    ["protocol", "cpu_seconds", "step", "fresh_samples", "error_percent", "holdout_error_percent"];

/// A protocol's name and its points: CPU seconds, holdout error (%).
type Line = (String, Vec<(f64, f64)>);

pub(in crate::cli) fn execute(args: &Args) -> Result<Exit, Error> {
    if args.seconds.is_empty() || !args.seconds.is_sorted() {
        return Err(Error::Usage(format!("--seconds {:?}: must ascend", args.seconds)));
    }
    let plan = read_plan(&args.spec)?;
    let spec = &plan.trials.first().ok_or_else(|| Error::Usage("the spec has no trial".into()))?.spec;
    let trials: Vec<TrialSpec> =
        args.protocols.iter().map(|name| with_protocol(spec, name)).collect::<Result<_, _>>()?;

    let mut table = Table { columns: COLUMNS.map(String::from).to_vec(), rows: Vec::new() };
    let mut lines: Vec<Line> = Vec::new();
    let initial = evaluate(spec, &[initial_design(spec)?], 1).map_err(failed)?;
    let start = holdout(&initial[0]);
    table.rows.push(vec![
        json!("initial"),
        json!(0),
        json!(0),
        json!(0),
        json!(test(&initial[0])),
        json!(start),
    ]);
    for (trial, name) in trials.iter().zip(&args.protocols) {
        eprintln!("{name}: {} steps or {} s", trial.optimise.steps(), args.seconds[args.seconds.len() - 1]);
        let milestones = course(trial, &args.seconds, 1).map_err(failed)?;
        let designs: Vec<Vec<f64>> = milestones.iter().map(|m| m.design.clone()).collect();
        let mut line = Vec::new();
        for (m, body) in milestones.iter().zip(evaluate(spec, &designs, 1).map_err(failed)?) {
            let error = holdout(&body);
            line.extend(error.map(|error| (m.seconds, error)));
            let (seconds, step, fresh) = (json!(m.seconds), json!(m.step), json!(m.fresh_samples));
            table.rows.push(vec![json!(name), seconds, step, fresh, json!(test(&body)), json!(error)]);
        }
        lines.push((name.clone(), line));
    }
    print_rows(&table, args.format)?;
    append(args, spec, &table)?;
    let picture = args.append.with_extension("svg");
    std::fs::write(&picture, draw(&lines, start)).map_err(|source| Error::Io {
        doing: "writing",
        path: picture,
        source,
    })?;
    Ok(Exit::Done)
}

fn failed(failure: metasense_worker::run::Failure) -> Error {
    Error::Usage(failure.to_string())
}

/// The spec's trial under another protocol, at that one's defaults.
fn with_protocol(spec: &TrialSpec, name: &str) -> Result<TrialSpec, Error> {
    let protocol: Protocol = serde_json::from_value(json!(name))
        .map_err(|_| Error::Usage(format!("--protocols {name}: must be paper, warm, envelope or joint")))?;
    let optimise = match spec.optimise.protocol == protocol {
        true => spec.optimise,
        false => Optimise { protocol, ..Optimise::default() }.resolved(),
    };
    Ok(TrialSpec { optimise, ..spec.clone() })
}

fn initial_design(spec: &TrialSpec) -> Result<Vec<f64>, Error> {
    metasense_worker::problem::problem(spec)
        .map(|problem| problem.initial)
        .map_err(|invalid| Error::Usage(invalid.to_string()))
}

fn mean(errors: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let errors: Vec<f64> = errors.flatten().collect();
    (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
}

fn holdout(body: &BodyEvaluation) -> Option<f64> {
    mean(body.networks.iter().map(|network| network.error_holdout))
}

fn test(body: &BodyEvaluation) -> Option<f64> {
    mean(body.networks.iter().map(|network| network.error_test))
}

fn append(args: &Args, spec: &TrialSpec, table: &Table) -> Result<(), Error> {
    let failed = |source| Error::Io { doing: "appending to", path: args.append.clone(), source };
    if let Some(folder) = args.append.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    let mut file = OpenOptions::new().create(true).append(true).open(&args.append).map_err(failed)?;
    for values in &table.rows {
        let mut line = json!({
            "bench": "protocols", "version": env!("CARGO_PKG_VERSION"), "panels": spec.point.panels,
            "sensors": spec.point.sensors, "seed": spec.point.seed, "spec": file_name(&args.spec),
        });
        let fields = line.as_object_mut().expect("an object");
        fields.extend(table.columns.iter().cloned().zip(values.iter().cloned()));
        writeln!(file, "{line}").map_err(failed)?;
    }
    Ok(())
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The plot as a file of its own, with the little style that it needs.
fn draw(lines: &[Line], initial: Option<f64>) -> String {
    let points = || lines.iter().flat_map(|(_, points)| points.iter().copied());
    let x = Axis::new("CPU seconds of the outer steps", Scale::Log, points().map(|p| p.0));
    let y = Axis::new("holdout error (%)", Scale::Log, points().map(|p| p.1).chain(initial));
    let mut plot = Plot::new("Holdout error against CPU time", x, y).sized(560.0, 360.0);
    for (n, (name, points)) in lines.iter().enumerate() {
        let class = format!("c{}", n % 4);
        plot.line(&class, points.iter().copied());
        plot.dots(&class, points.iter().map(|&p| (p, format!("{name}: {:.0} s, {:.1} %", p.0, p.1))));
        if let Some(&end) = points.last() {
            plot.note(end, name);
        }
    }
    const STYLE: &str = "<style>text{font:11px sans-serif;fill:#333}.title{font-weight:bold}\
        .grid{stroke:#ddd;fill:none}.axis{stroke:#333;fill:none}.line{fill:none;stroke-width:2}\
        .line.c0{stroke:#c44}.line.c1{stroke:#48a}.line.c2{stroke:#a80}.line.c3{stroke:#283}\
        .dot.c0{fill:#c44}.dot.c1{fill:#48a}.dot.c2{fill:#a80}.dot.c3{fill:#283}</style>";
    plot.svg().replacen('>', &format!(">{STYLE}"), 1)
}
