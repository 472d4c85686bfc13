//! Problems from specs: bodies of polygons, with a design that fits or with placed sensors.

use metasense_numerics::place;
use metasense_numerics::trial::Problem;
use metasense_schemas::spec::TrialSpec;
use metasense_worker::problem::external::polygons;
use metasense_worker::problem::problem;
use metasense_worker::run::{NoResult, Pool};
use metasense_worker::{design, memory};

/// Converts a spec to a problem.
///
/// # Errors
/// If the spec is invalid.
pub fn any_body(trial: &TrialSpec) -> Result<Problem, NoResult> {
    problem(trial).map_err(|invalid| NoResult::Rejected(invalid.to_string()))
}

/// Converts a spec of a body of polygons to a problem.
///
/// # Errors
/// If the spec is invalid, or its body is an external one.
pub fn prepared(trial: &TrialSpec) -> Result<Problem, NoResult> {
    polygons(&trial.body).map_err(|invalid| NoResult::Rejected(invalid.to_string()))?;
    any_body(trial)
}

/// Converts a spec to a problem, and checks that `design` fits its body.
///
/// # Errors
/// If the spec is invalid, or as [`check_design`].
pub fn with_design(trial: &TrialSpec, design: &[f64]) -> Result<Problem, NoResult> {
    let problem = prepared(trial)?;
    check_design(&problem, design)?;
    Ok(problem)
}

/// Checks that `design` fits the problem's body and gives its units mass.
///
/// # Errors
/// If the length is wrong, a number is not finite, or a unit has no mass, as inverted units do unless masses are given.
pub fn check_design(problem: &Problem, design: &[f64]) -> Result<(), NoResult> {
    design::check("the design", &[design.len()], design, problem.initial.len())
        .map_err(NoResult::Rejected)?;
    if problem.scene.layout.units() == 0 {
        return Ok(()); // an external body
    }
    let geometry = problem.scene.geometry(design);
    let has_mass = |unit: &usize| {
        let [area, mass, moment] = [&geometry.area, &geometry.mass, &geometry.moment].map(|of| of[*unit]);
        area != 0.0 && mass > 0.0 && moment >= 0.0
    };
    match (0..problem.scene.layout.units()).find(|unit| !has_mass(unit)) {
        None => Ok(()),
        Some(unit) => Err(NoResult::Rejected(format!(
            "the design: unit {unit} has an area of {:.3} mm² and can be neither cast nor simulated; `metasense body project` repairs a design",
            geometry.area[unit]
        ))),
    }
}

/// As [`with_design`], for callers that simulate all samples.
///
/// # Errors
/// As [`with_design`], or if this machine lacks the memory.
pub fn simulable(trial: &TrialSpec, design: &[f64]) -> Result<Problem, NoResult> {
    check_memory(trial)?;
    with_design(trial, design)
}

/// Checks that this machine has the memory for the samples of a trial.
///
/// # Errors
/// Names the key with the largest share.
fn check_memory(trial: &TrialSpec) -> Result<(), NoResult> {
    memory::check_here(trial).map_err(|invalid| NoResult::Rejected(invalid.to_string()))
}

/// Checks the length of an array.
pub fn check_length(what: &str, given: usize, expected: usize) -> Result<(), NoResult> {
    match given == expected {
        true => Ok(()),
        false => {
            Err(NoResult::Rejected(format!("the {what} has {given} numbers; the trial needs {expected}")))
        }
    }
}

/// Rejects NaN and infinity.
///
/// # Errors
/// Names the first number that is not finite, and its index.
pub fn finite(what: &str, values: &[f64]) -> Result<(), NoResult> {
    design::finite(what, values).map_err(NoResult::Rejected)
}

/// Converts a spec to a problem and places its sensors, by a search if the spec requires it.
///
/// # Errors
/// If the spec is invalid, this machine lacks the memory, or the search fails.
pub fn placed(trial: &TrialSpec, pool: &Pool) -> Result<Problem, NoResult> {
    check_memory(trial)?;
    Ok(place::placed(&prepared(trial)?, pool)?.0)
}

#[cfg(test)]
mod tests;
