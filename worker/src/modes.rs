//! Eigenmodes of a trial's body at rest, and how its panels move its units there.

use metasense_numerics::dynamics::{Rest, Scene, highest_frequency, start, touches};
use metasense_numerics::modes::{self, NoModes};
pub use metasense_numerics::modes::{Mode, Response};
use metasense_numerics::place::placed;
use metasense_numerics::trial::Problem;
use metasense_schemas::spec::TrialSpec;

use crate::run::{Failure, pool, prepared, with_design};

/// The `count` slowest modes of a body; fewer where it has fewer.
///
/// # Errors
/// If the spec stands for no trial, the design is of another length, or the body has no modes.
pub fn slowest(trial: &TrialSpec, design: &[f64], count: usize) -> Result<Vec<Mode>, Failure> {
    let problem = weighed(trial, design)?;
    let scene = &problem.scene;
    check_rest(scene, design)?;
    modes::modes(&Rest::new(scene, design), scene.layout.units(), count).map_err(|none| match none {
        NoModes::Loose => Failure::Rejected(
            "body: some motion has neither stiffness nor damping; hold a unit with body.clamp, or set body.damping_ratio above 0"
                .to_owned(),
        ),
        NoModes::NotFinite => Failure::Rejected(
            "body: its modes are not finite; check body.density, body.stiffness and body.damping_ratio".to_owned(),
        ),
    })
}

/// First and highest natural frequency (Hz) of the body that a trial starts from; the first that is above 0.
///
/// # Errors
/// If the spec stands for no trial, or the body has no such motions.
pub fn natural_frequencies(trial: &TrialSpec) -> Result<[f64; 2], Failure> {
    let Problem { scene, initial, .. } = &prepared(trial)?;
    check_rest(scene, initial)?;
    let none = || Failure::Rejected("body: it has no modes".to_owned());
    let modes =
        modes::modes(&Rest::new(scene, initial), scene.layout.units(), SLOWEST).map_err(|_| none())?;
    let highest = highest_frequency(scene, initial) / std::f64::consts::TAU;
    let first = modes.iter().map(Mode::frequency).find(|hertz| *hertz > STILL * highest).ok_or_else(none)?;
    Ok([first, highest])
}

/// Modes among which the first that moves is: a body that nothing holds has three that do not.
const SLOWEST: usize = 6;
/// Part of the highest frequency below which a mode stands still.
const STILL: f64 = 1e-9;

/// Responses of a unit to each panel at these frequencies (Hz): (frequencies, panels).
///
/// # Errors
/// If the spec stands for no trial, the design is of another length, or there is no such unit.
pub fn responses(
    trial: &TrialSpec,
    design: &[f64],
    unit: usize,
    frequencies: &[f64],
) -> Result<Vec<Vec<Response>>, Failure> {
    let problem = weighed(trial, design)?;
    let (scene, units) = (&problem.scene, problem.scene.layout.units());
    check_rest(scene, design)?;
    if unit >= units || scene.clamped.contains(&unit) {
        let why = if unit >= units {
            format!("the body has units 0 … {}", units - 1)
        } else {
            "it is held".to_owned()
        };
        return Err(Failure::Rejected(format!("unit {unit}: {why}")));
    }
    let found = modes::responses(scene, &Rest::new(scene, design), &[unit], frequencies);
    Ok(found.into_iter().map(|panels| panels.into_iter().flatten().collect()).collect())
}

/// The problem, with sensors where a search finds them if their chips have a mass.
fn weighed(trial: &TrialSpec, design: &[f64]) -> Result<Problem, Failure> {
    let problem = with_design(trial, design)?;
    if problem.search.is_none() || problem.scene.chip.is_none() {
        return Ok(problem);
    }
    Ok(placed(&problem, &pool(1)?)?.0)
}

/// Refuses a scene whose linearisation is no body's under forces, and a body that is nowhere to linearise about.
pub(crate) fn check_rest(scene: &Scene, design: &[f64]) -> Result<(), Failure> {
    if let Some(panel) = scene.panels.iter().find(|panel| panel.drives().is_some()) {
        return Err(Failure::Rejected(format!(
            "body.panels: unit {} is driven, and small motions are those of held units under forces: clamp it, and shake the base or \
             strike other units",
            panel.unit
        )));
    }
    if touches(scene, design) {
        let why = "body.contact: parts of the body touch as it is cast, so it is not at rest and small motions are undefined";
        return Err(Failure::Rejected(why.to_owned()));
    }
    match start(scene, design) {
        Ok(_) => Ok(()),
        Err(outcome) => Err(Failure::Rejected(format!(
            "body.compression: {}: the compressed body has no equilibrium for small motions",
            outcome.name()
        ))),
    }
}
