//! `draw`: draws a design as SVG.

use std::path::PathBuf;

use metasense_lab::replay::{Drawing, Panel};
use metasense_worker::design::{self, FeasibleSet, overlaps};
use metasense_worker::problem::external::body as external_body;

use super::named::Named;
use super::{Error, write};
use crate::exit::Exit;
use crate::look::body::{Numbering, frame, middle};
use crate::look::file;
use crate::report::body::sketch;

/// Draws a design as SVG; by default the initial body
///
/// Constraints at their limit are amber, violated ones red. Without a hash: the body of all trials of the spec, with its
/// first panels and sensors.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    trial: Named,
    /// The design to draw (NPY of α, or CSV of nodes)
    #[arg(long, value_name = "FILE")]
    design: Option<PathBuf>,
    /// File to write
    #[arg(long, value_name = "FILE.svg", help_heading = "Output")]
    out: PathBuf,
    /// Also writes the design that was drawn (.npy or .csv)
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    design_out: Option<PathBuf>,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    if !args.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("svg")) {
        let named = args.out.with_extension("svg");
        return usage!("--out {}: a drawing is an SVG file; use {}", args.out.display(), named.display());
    }
    if let Some(spec) = args.trial.external().await? {
        let (initial, body) = external_body(&spec).map_err(|e| args.trial.refused(e))?;
        let drawn = match &args.design {
            Some(file) => design::read_array(file, initial.len())?,
            None => initial,
        };
        let svg = body.draw(&drawn).map_err(|fault| args.trial.refused(fault.detail))?;
        write(&args.out, svg)?;
        print_line!("{}: {} numbers", args.out.display(), drawn.len())?;
        return Ok(Exit::Done);
    }
    let body = args.trial.body().await?;
    let drawn = match &args.design {
        Some(file) => design::read(file, &body.layout)?,
        None => body.initial.clone(),
    };
    let feasible = FeasibleSet::new(&body.layout, body.limits, &[]);
    let violations = feasible.violations(&drawn);
    let active = feasible.active(&drawn);
    let verdict = match violations.is_empty() {
        true if !body.limits.enforced => overlaps(&body.layout, &drawn).to_string(),
        true => "feasible".to_owned(),
        false => "not feasible".to_owned(),
    };
    let (units, shifts) = (body.layout.units(), body.layout.groups.count());
    let caption = format!("{units} units, {shifts} shifts: {verdict}");
    let finite = |x: f64| if x.is_finite() { x } else { 0.0 };
    let finite = |corners: Vec<[f64; 2]>| corners.into_iter().map(|c| c.map(finite)).collect();
    let units: Vec<Vec<[f64; 2]>> = body.layout.vertices(&drawn).into_iter().map(finite).collect();
    let ligaments = body.layout.ligaments.iter();
    let foot = |panel: &Panel| panel.foot(middle(&units[panel.unit]), &units[panel.unit]);
    let drawing = Drawing {
        panels: body.panels.iter().map(|panel| (*panel, foot(panel))).collect(),
        centroids: units.iter().map(|corners| middle(corners)).collect(),
        ligaments: ligaments.map(|l| [units[l.a.unit][l.a.node], units[l.b.unit][l.b.node]]).collect(),
        joints: Vec::new(),
        sensors: body.sensors,
        clamped: body.clamped,
        guided: body.guided,
        // a constraint with negative slack is violated, not active
        active: active.iter().copied().filter(|a| a.slack >= 0.0).collect(),
        spacing: body.layout.spacing,
        clock: Vec::new(),
        units,
    };
    let sketch = sketch(&drawing, &violations);
    let picture = sketch.picture(frame([&sketch]), &caption, Numbering::All);
    write(&args.out, file(&[picture], 1, 640.0, &sketch.legend()))?;
    if let Some(file) = &args.design_out {
        write(file, design::bytes(file, &body.layout, &drawn)?)?;
    }
    let (out, active, violated) = (args.out.display(), active.len(), violations.len());
    print_line!("{out}: {caption}, {active} constraints at their limit, {violated} violated")?;
    for violation in &violations {
        print_line!("  {violation}")?;
    }
    Ok(Exit::Done)
}
