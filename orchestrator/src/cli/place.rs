//! `place`: searches for the best units for sensors.

use std::path::PathBuf;

use metasense_lab::place::{PlacementReport, search_placements};
use metasense_lab::replay::Drawing;

use super::named::Designed;
use super::{Error, Format, cores, print_rows, write};
use crate::exit::Exit;
use crate::look::body::{Numbering, UnitStyle, frame};
use crate::look::{Table, file, level, row};
use crate::plan::{Plan, PlannedTrial};
use crate::report::body::sketch;

/// Searches for the best units for sensors, and compares them with random placements
///
/// Errors are those of a linear decoder on training samples to which it was not fitted. The test and held-out sets are not
/// used. A sweep with sensors.search runs the same search. Without HASH: the first trial with the most sensors.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    one: Designed,
    /// Draws the body: units coloured by the error with a sensor on them; the chosen units are numbered
    #[arg(long, value_name = "FILE.svg", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let (_, spec, design) = &args.one.read_or(most_sensors).await?;
    let found = search_placements(spec, design, 0, cores()).map_err(|e| args.one.trial.failed(e))?;
    print_rows(&table(&found), args.format)?;
    if found.placed.iter().any(|placed| placed.energies) {
        say!("the linear decoder also uses |signal|² of each unit, which lowers its error for these forces");
    }
    if let Some(out) = &args.out {
        let drawn = metasense_lab::replay::drawing(spec, design).map_err(|e| args.one.trial.failed(e))?;
        let sensors = found.placed.last().map_or(Vec::new(), |placed| placed.units.clone());
        let drawn = sketch(&Drawing { sensors, active: Vec::new(), ..drawn }, &[]);
        let ends = [found.worth.first(), found.worth.last()];
        let [best, worst] = ends.map(|unit| unit.map_or(0.0, |(_, error)| *error));
        let caption =
            format!("Error with a sensor on this unit only: {best:.1} % (strong) … {worst:.1} % (pale)");
        // by rank: with outliers, shades by error would be nearly equal
        let shade = |u: usize| {
            let rank = found.worth.iter().position(|(unit, _)| *unit == u)?;
            let part = 1.0 - rank as f64 / (found.worth.len() - 1).max(1) as f64;
            Some(format!("unit {}", level(part * part)))
        };
        let mut key = drawn.legend();
        key.push(("speed", "rank of the error with a sensor on the unit".to_owned()));
        let unit = |u| UnitStyle { class: shade(u), ..UnitStyle::default() };
        let picture = drawn.drawn(frame([&drawn]), &caption, Numbering::All, unit);
        write(out, file(&[picture], 1, 640.0, &key))?;
        say!("written {}", out.display());
    }
    Ok(Exit::Done)
}

/// The first trial with the most sensors.
fn most_sensors(plan: &Plan) -> &PlannedTrial {
    let trials = plan.trials.iter().rev();
    trials.max_by_key(|trial| trial.spec.point.sensors).expect("a plan has a trial")
}

fn table(found: &PlacementReport) -> Table {
    let columns = "sensors units error next_best random_best random_median random_worst";
    let rows = found.placed.iter().enumerate().map(|(m, placed)| {
        let [best, median, worst] = found.random[m];
        let units = placed.units.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ");
        row![m + 1, units, placed.errors[m], placed.runner_up_error, best, median, worst]
    });
    Table::new(columns, rows)
}
