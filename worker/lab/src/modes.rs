//! Modes of a trial's body at rest, and responses of its units to its panels.

use metasense_numerics::dynamics::{Outcome, Rest, Scene, highest_frequency, start, touches};
use metasense_numerics::place::placed;
use metasense_numerics::trial::Problem;
use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::{NoResult, pool};

use crate::prepare::{prepared, with_design};
use crate::questions::modes::{self, NoModes};
pub use crate::questions::modes::{FrequencyResponse, Mode};

/// The `count` slowest modes of a body, or all if it has fewer.
///
/// # Errors
/// If the spec is invalid, the design has the wrong length, or the body has no modes.
pub fn slowest(trial: &TrialSpec, design: &[f64], count: usize) -> Result<Vec<Mode>, NoResult> {
    let problem = weighed(trial, design)?;
    let scene = &problem.scene;
    check_rest(scene, design)?;
    modes::modes(&Rest::new(scene, design), scene.layout.units(), count).map_err(|none| match none {
        NoModes::Loose => NoResult::Rejected(
            "body: some motion has neither stiffness nor damping; hold a unit with body.clamp, or set body.damping_ratio above 0"
                .to_owned(),
        ),
        NoModes::NotFinite => NoResult::Rejected(
            "body: its modes are not finite; check body.density, body.stiffness and body.damping_ratio".to_owned(),
        ),
    })
}

/// Natural frequencies of a body.
pub struct Natural {
    /// The lowest above 0 (Hz).
    pub first: f64,
    /// Modal damping ratio at the first.
    pub damping: f64,
    /// The highest (Hz).
    pub highest: f64,
}

/// Natural frequencies of the initial body of a trial.
///
/// # Errors
/// If the spec is invalid, or the body has no such modes.
pub fn natural_frequencies(trial: &TrialSpec) -> Result<Natural, NoResult> {
    let Problem { scene, initial, .. } = &prepared(trial)?;
    check_rest(scene, initial)?;
    let none = || NoResult::Rejected("body: has no modes".to_owned());
    let modes =
        modes::modes(&Rest::new(scene, initial), scene.layout.units(), SLOWEST).map_err(|_| none())?;
    let highest = highest_frequency(scene, initial) / std::f64::consts::TAU;
    let first = modes.iter().find(|mode| mode.frequency() > STILL * highest).ok_or_else(none)?;
    Ok(Natural { first: first.frequency(), damping: first.damping_ratio(), highest })
}

/// Number of slowest modes that include the first elastic one: an unsupported body has three rigid ones.
const SLOWEST: usize = 6;
/// Frequency, relative to the highest, below which a mode counts as rigid.
const STILL: f64 = 1e-9;

/// Responses of a unit to each panel at these frequencies (Hz): (frequencies, panels).
///
/// # Errors
/// If the spec is invalid, the design has the wrong length, or the unit does not exist or is clamped.
pub fn responses(
    trial: &TrialSpec,
    design: &[f64],
    unit: usize,
    frequencies: &[f64],
) -> Result<Vec<Vec<FrequencyResponse>>, NoResult> {
    let problem = weighed(trial, design)?;
    let (scene, units) = (&problem.scene, problem.scene.layout.units());
    check_rest(scene, design)?;
    if unit >= units || scene.clamped.contains(&unit) {
        let why = if unit >= units {
            format!("the body has units 0 … {}", units - 1)
        } else {
            "it is clamped".to_owned()
        };
        return Err(NoResult::Rejected(format!("unit {unit}: {why}")));
    }
    let found = modes::responses(scene, &Rest::new(scene, design), &[unit], frequencies);
    Ok(found.into_iter().map(|panels| panels.into_iter().flatten().collect()).collect())
}

/// The problem of a design. Runs the sensor search if the chips have mass.
fn weighed(trial: &TrialSpec, design: &[f64]) -> Result<Problem, NoResult> {
    let problem = with_design(trial, design)?;
    if problem.search.is_none() || problem.scene.chip.is_none() {
        return Ok(problem);
    }
    Ok(placed(&problem, &pool(1)?)?.0)
}

/// Rejects scenes with driven units and bodies without equilibrium, which cannot be linearised.
pub(crate) fn check_rest(scene: &Scene, design: &[f64]) -> Result<(), NoResult> {
    if let Some(panel) = scene.panels.iter().find(|panel| panel.unit_acceleration().is_some()) {
        return Err(NoResult::Rejected(format!(
            "body.panels: unit {} is driven, and small motions are those of held units under forces: clamp it, and shake the base or \
             strike other units",
            panel.unit
        )));
    }
    if touches(scene, design) {
        let why = "body.contact: parts of the body touch as it is cast, so it is not at rest and small motions are undefined";
        return Err(NoResult::Rejected(why.to_owned()));
    }
    match start(scene, design) {
        Ok(_) => Ok(()),
        Err(Outcome::NoMass) => {
            Err(NoResult::Rejected("body.design: a unit is inverted or has nearly vanished".to_owned()))
        }
        Err(outcome) => Err(NoResult::Rejected(format!(
            "body.compression: {}: the compressed body has no equilibrium for small motions",
            outcome.name()
        ))),
    }
}

#[cfg(test)]
mod tests;
