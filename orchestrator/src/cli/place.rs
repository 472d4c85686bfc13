//! `place`: where a body's sensors are best.

use std::path::PathBuf;

use metasense_worker::place::{Looked, look};
use metasense_worker::replay::Drawing;

use super::named::Designed;
use super::{Error, Format, cores, print_rows, write};
use crate::exit::Exit;
use crate::look::body::{Unit, frame};
use crate::look::{Table, file, level, row};
use crate::plan::{Plan, Trial};
use crate::report::body::sketch;

/// Searches for the units that carry sensors best, and compares with random placements
///
/// Errors are those of a linear brain on training samples that it has not seen; test set and holdout are not used. A sweep with
/// sensors.search searches in the same way by itself. Without HASH: the first trial with the most sensors.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    one: Designed,
    /// Draws the body: units coloured by the error with a sensor on them, the units chosen numbered
    #[arg(long, value_name = "FILE.svg", help_heading = "Output")]
    out: Option<PathBuf>,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let (_, spec, design) = &args.one.read_or(most_sensors).await?;
    let found = look(spec, design, 0, cores()).map_err(|e| args.one.trial.failed(e))?;
    print_rows(&table(&found), args.format)?;
    if found.placed.iter().any(|placed| placed.energies) {
        say!("read by a linear brain that sees |signal|² of each unit, too: it reads these forces better");
    }
    if let Some(out) = &args.out {
        let drawn = metasense_worker::replay::drawing(spec, design).map_err(|e| args.one.trial.failed(e))?;
        let sensors = found.placed.last().map_or(Vec::new(), |placed| placed.units.clone());
        let drawn = sketch(&Drawing { sensors, active: Vec::new(), ..drawn }, &[]);
        let caption = format!(
            "Error with a sensor there alone: {:.1} % (strong) … {:.1} % (pale)",
            found.worth.first().map_or(0.0, |best| best.1),
            found.worth.last().map_or(0.0, |worst| worst.1),
        );
        // by rank: errors of a few units far from all others would leave those alike
        let shade = |u: usize| {
            let rank = found.worth.iter().position(|(unit, _)| *unit == u)?;
            let part = 1.0 - rank as f64 / (found.worth.len() - 1).max(1) as f64;
            Some(format!("unit {}", level(part * part)))
        };
        let mut key = drawn.legend();
        key.push(("speed", "what a sensor there is worth".to_owned()));
        let unit = |u| Unit { class: shade(u), ..Unit::default() };
        let picture = drawn.drawn(frame([&drawn]), &caption, true, unit);
        let text = file(&[picture], 1, 640.0, &key);
        write(out, text)?;
        say!("written {}", out.display());
    }
    Ok(Exit::Done)
}

/// The first trial with the most sensors.
fn most_sensors(plan: &Plan) -> &Trial {
    let trials = plan.trials.iter().rev();
    trials.max_by_key(|trial| trial.spec.point.sensors).expect("a plan has a trial")
}

fn table(found: &Looked) -> Table {
    let columns = "sensors units error next_best random_best random_median random_worst";
    let rows = found.placed.iter().enumerate().map(|(m, placed)| {
        let [best, median, worst] = found.random[m];
        let units = placed.units.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ");
        row![m + 1, units, placed.errors[m], placed.runner_up_error, best, median, worst]
    });
    Table::new(columns, rows)
}
