//! What is left of a design once it is cast, for any trial and any scatter.

use metasense_numerics::nested::casts_of;
use metasense_numerics::place::placed;
use metasense_numerics::trial::Trial;
use metasense_schemas::record::CastReading;
use metasense_schemas::spec::{TrialSpec, Variation};

use crate::convert::cast_readings;
use crate::run::{Failure, pool, simulable};

/// What a trial has whose casts cannot be asked for.
pub const NO_VARIATION: &str =
    "no [variation] (a trial keeps it only with an objective over casts or evaluation.casts above 0)";

/// How `count` casts of a design are read by linear brains, those of the trial's own comparison first, or of another scatter.
/// `progress` is told how many have been.
///
/// # Errors
/// If the spec stands for no trial, the design is of another length, nothing scatters, or the initial body cannot be simulated.
pub fn casts(
    trial: &TrialSpec,
    design: &[f64],
    count: usize,
    variation: Option<Variation>,
    threads: usize,
    progress: &mut dyn FnMut(usize),
) -> Result<Vec<CastReading>, Failure> {
    let mut trial = trial.clone();
    trial.variation = variation.or(trial.variation).and_then(Variation::resolved);
    trial.evaluation.casts = Some(count);
    if trial.variation.is_none() {
        return Err(Failure::Rejected(format!("it has {NO_VARIATION}; pass --variation FILE")));
    }
    let (designed, pool) = (simulable(&trial, design)?, pool(threads)?);
    let (problem, _) = placed(&designed, &pool)?;
    Ok(cast_readings(&casts_of(&Trial::new(&problem, &pool)?, design, count, progress)))
}
