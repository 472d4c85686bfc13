//! `project`: projects a design onto the nearest feasible design.

use std::path::PathBuf;

use metasense_worker::design::{self, Projection, Status};

use super::named::Named;
use super::{Error, Format, print_rows, write};
use crate::exit::Exit;
use crate::look::{Table, row};

/// Projects a design onto the nearest design that can be cast
///
/// Units kept by `optimise.frozen` or `[feasible]` retain their initial shape; shifts that `optimise.tie` ties move
/// together. If no feasible design is found, the result is the initial body. Without a hash: the body of all trials of the
/// spec. Prints status, distance and the constraints at their limit. Exit code 1, and no file, if the initial body cannot be
/// cast either.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    trial: Named,
    /// The design to project (NPY of α, or CSV of nodes)
    #[arg(long, value_name = "FILE")]
    design: PathBuf,
    /// The file to write (.npy or .csv)
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    out: PathBuf,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let mut body = args.trial.body().await?;
    let target = design::read(&args.design, &body.layout)?;
    let previous = body.initial.clone();
    let several = "optimise.tie or optimise.frozen differ between trials: name a trial, SPEC HASH";
    let feasible = body.castable.as_mut().ok_or_else(|| args.trial.refused(several))?;
    let found = feasible.project(&previous, &target, None);
    let broken = feasible.violations(&target);
    let mut summary = summary(&found, &previous, broken.len());
    if found.status.is_feasible() {
        write(&args.out, design::bytes(&args.out, &body.layout, &found.design)?)?;
        summary.push(format!("written   {}", args.out.display()));
    }
    for line in summary {
        print_line!("{line}")?;
    }
    if !found.status.is_feasible() {
        for violation in feasible.violations(&found.design) {
            say!("  {violation}");
        }
        return Ok(Exit::Failed);
    }
    let rows = found.active.iter().map(|a| {
        let other = (a.units[0] != a.units[1]).then_some(a.units[1]);
        row![a.kind.name(), a.units[0], a.node, other, a.slack]
    });
    print_rows(&Table::new("constraint unit node other_unit slack_mm", rows), Format::Table)?;
    Ok(Exit::Done)
}

fn summary(found: &Projection, previous: &[f64], broken: usize) -> Vec<String> {
    let meaning = match found.status {
        Status::Untouched => "the design is feasible and is returned unchanged",
        Status::Projected => "the nearest feasible design found",
        Status::Kept => "no feasible design was found; the initial body is kept",
        Status::NotFinite => "the design is not finite; the initial body is kept",
        Status::Infeasible => {
            "no feasible design was found, and the initial body violates the constraints below"
        }
    };
    let moved = found.design.iter().zip(previous).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    vec![
        format!("status    {}: {meaning}", found.status.name()),
        format!("input     violates {broken} constraints"),
        format!("distance  {:.6} mm from the input, {moved:.6} mm from the initial body", found.distance),
        format!("work      {} programs, {} interior-point iterations", found.programs, found.iterations),
        format!("active    {} constraints at their limit", found.active.len()),
    ]
}
