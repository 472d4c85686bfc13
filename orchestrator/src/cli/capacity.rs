//! `capacity`: memory and nonlinearity of finished bodies.

use metasense_lab::capacity::{Measure, capacity, hold};
use serde_json::Value;

use super::named::Finished;
use super::tasks::{HEAD, head};
use super::{Error, Format, cores, print_rows};
use crate::analysis::capacity::{CapacityResult, table};
use crate::analysis::kinds::trained_with;
use crate::analysis::tasks::trained_for;
use crate::analysis::{BodyState, Trial};
use crate::exit::Exit;
use crate::look::{Table, row, short_hash};
use crate::reader::StoredTrial;

/// Computes memory and nonlinearity of finished bodies: capacities and NARMA errors
///
/// In 16 drives, the first panel receives a random force u, uniform between ± the largest force of the training samples, and new
/// after each hold: a quarter of the period of the initial body's first natural frequency, in whole instants. 50 holds of each
/// drive are the wash-out, 500 count. The state has N variables: the sensors' readings, with their noise, at up to eight instants
/// of the hold. Linear readouts estimate functions of u from it; a capacity is the sum of their R² over such functions.
/// `memory` (linear memory capacity): u up to 49 holds ago. `degree 2`, `degree 3`: products of Legendre polynomials of u up to 19
/// and 9 holds ago. `total`: their sum, at most N (column bound). An R² that could be chance counts as 0; the others are corrected
/// for the number of variables. `narma-2`, `narma-5`, `narma-10`: mean square error on the second half of the drives, divided by
/// the variance; readouts are fitted to the first half. The table has means over the trials of a setting, and the change by
/// training: the difference of capacities, the ratio initial / trained of errors, with 95 % intervals over seeds and placements.
/// Other formats have one row per trial, body and measure, with the length of a hold (ms).
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    trials: Finished,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let (mut rows, mut all) = (Vec::new(), Vec::new());
    args.trials.visit(|_| true, |stored, trial| of_trial(stored, trial, &mut rows, &mut all)).await?;
    let columns = format!("{HEAD} measure value bound hold");
    let table = if args.trials.format == Format::Table { table(&all) } else { Table::new(&columns, rows) };
    print_rows(&table, args.trials.format)?;
    Ok(Exit::Done)
}

/// Appends the measures of both bodies as rows and as pairs.
fn of_trial(
    stored: &StoredTrial,
    trial: &Trial,
    rows: &mut Vec<Vec<Value>>,
    all: &mut Vec<CapacityResult>,
) -> Result<(), Error> {
    let refused = |e| Error::Usage(format!("trial {}: {e}", short_hash(&trial.hash)));
    let (spec, time) = (stored.spec(), &stored.spec().time);
    let instants = hold(spec).map_err(refused)?;
    let milliseconds = 1e3 * instants as f64 * time.duration / time.samples as f64;
    let mut bodies = Vec::new();
    for body in BodyState::ALL {
        let of = body as usize;
        let found = capacity(&stored.specs[of], &stored.designs[of], instants, cores()).map_err(refused)?;
        rows.extend(found.iter().map(|Measure { name: measure, value, bound }| {
            [head(trial, body.name()), row![measure, value, bound, milliseconds]].concat()
        }));
        bodies.push(found);
    }
    all.extend(bodies[0].iter().zip(&bodies[1]).map(|(initial, trained)| CapacityResult {
        setting: format!("K = {}, M = {}, {}", trial.panels, trial.sensors, trained_with(&trial.setting)),
        cluster: trial.cluster,
        trained_for: trained_for(trial).to_owned(),
        measure: initial.name,
        values: [initial.value, trained.value],
        bound: initial.bound,
    }));
    Ok(())
}
