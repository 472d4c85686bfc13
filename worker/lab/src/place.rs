//! The best placements of a trial's sensors, compared with others.

use metasense_numerics::place::Candidates;
use metasense_numerics::trial::Placing;
use metasense_schemas::reason::Cause;
use metasense_schemas::record::PlacedRecord;
use metasense_schemas::spec::{self, TrialSpec};
use metasense_worker::convert;
use metasense_worker::run::{NoResult, pool};

use crate::prepare::simulable;

/// Placements found for m = 1 … M sensors, compared with random ones. Errors (%) are cross-validated on the training samples with
/// a linear decoder.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacementReport {
    /// Placements found.
    pub placed: Vec<PlacedRecord>,
    /// Each candidate together with the first `given` of the M units, and the error, best first.
    pub worth: Vec<(usize, f64)>,
    /// Errors of random placements per m: best, median, worst.
    pub random: Vec<[f64; 3]>,
}

/// Number of random placements.
pub const RANDOM: u64 = 30;

/// Searches for the best placements of a trial's sensors on a design.
///
/// # Errors
/// If the spec is invalid, the design has the wrong length or cannot be simulated, or no placement exists.
pub fn search_placements(
    trial: &TrialSpec,
    design: &[f64],
    given: usize,
    threads: usize,
) -> Result<PlacementReport, NoResult> {
    let mut trial = trial.clone();
    trial.sensor_units.clear();
    trial.sensors.search = Some(spec::Search::Greedy);
    let problem = simulable(&trial, design)?;
    let search = problem.search.as_ref().expect("asked for");
    let pool = pool(threads)?;
    let cause = Cause::NowhereToSense;
    let to_failure = |_| NoResult::Numerical { cause, detail: cause.name().to_owned() };
    let all = Candidates::new(&problem, search, design, &pool)?;
    let best = all.clone().limit_candidates(&problem, &pool);
    let scores = best.scores(&problem, &pool);
    let of = |sensors| Placing { sensors, candidates: best.units.clone(), ..search.clone() };
    let placed: Vec<_> = (1..=search.sensors)
        .map(|m| scores.search(&of(m)).map_err(to_failure))
        .collect::<Result<_, NoResult>>()?;

    // Errors of the first m units of each random placement.
    let of_order = |p: u64| -> Option<Vec<f64>> {
        let order = problem.scene.layout.placement(p, &problem.scene.clamped);
        let order: Vec<usize> = order.into_iter().filter(|unit| all.units.contains(unit)).collect();
        let some = all.select_units(order.get(..search.sensors)?);
        let scores = some.scores(&problem, &pool);
        Some((1..=search.sensors).map(|m| scores.error(&order[..m], placed[m - 1].ridge)).collect())
    };
    let orders: Vec<Vec<f64>> = (0..RANDOM).filter_map(of_order).collect();
    let spread = |m: usize| {
        let mut errors: Vec<f64> = orders.iter().map(|order| order[m]).collect();
        errors.sort_by(f64::total_cmp);
        let at = |i: usize| errors.get(i).copied().unwrap_or(f64::NAN);
        [at(0), at(errors.len() / 2), at(errors.len().saturating_sub(1))]
    };
    let random = (0..search.sensors).map(spread).collect();

    let last = &placed[search.sensors - 1];
    let worth = all.rank_additions(&last.units[..given.min(search.sensors)], last.ridge, &problem, &pool);
    Ok(PlacementReport { worth, random, placed: placed.into_iter().map(convert::placed).collect() })
}
