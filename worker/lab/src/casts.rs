//! Errors of a design when it is cast, for any trial and any deviations.

use metasense_numerics::nested::evaluate_linear_on_casts;
use metasense_numerics::place::placed;
use metasense_numerics::trial::PreparedTrial;
use metasense_schemas::record::CastRecord;
use metasense_schemas::spec::{TrialSpec, Variation};
use metasense_worker::convert::cast_readings;
use metasense_worker::run::{NoResult, pool};

use crate::prepare::simulable;

/// End of the error message for a trial without `[variation]`.
pub const NO_VARIATION: &str =
    "no [variation] (a trial keeps it only with an objective over casts or evaluation.casts above 0)";

/// Errors of linear decoders on `count` casts of a design, the casts of the trial's own comparison first. `variation` replaces
/// that of the trial. Calls `progress` with the number of casts done.
///
/// # Errors
/// If the spec is invalid, the design has the wrong length, there is no variation, or the initial body cannot be simulated.
pub fn casts(
    trial: &TrialSpec,
    design: &[f64],
    count: usize,
    variation: Option<Variation>,
    threads: usize,
    progress: &mut dyn FnMut(usize),
) -> Result<Vec<CastRecord>, NoResult> {
    let mut trial = trial.clone();
    trial.variation = variation.or(trial.variation).and_then(Variation::resolved);
    trial.evaluation.casts = Some(count);
    if trial.variation.is_none() {
        return Err(NoResult::Rejected(format!("it has {NO_VARIATION}; pass --variation FILE")));
    }
    let (designed, pool) = (simulable(&trial, design)?, pool(threads)?);
    let (problem, _) = placed(&designed, &pool)?;
    Ok(cast_readings(&evaluate_linear_on_casts(
        &PreparedTrial::new(&problem, &pool)?,
        design,
        count,
        progress,
    )))
}
