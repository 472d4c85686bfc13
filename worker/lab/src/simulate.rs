//! One body under given forces: signals, motion and, for a cotangent on the signals, the gradient in the design.

use metasense_numerics::Pool;
use metasense_numerics::dynamics::{
    self, Forces, IntegratorSettings, Outcome, Scene, Simulation, Tuned, Wrt, energy, tune,
};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::memory::check_states;
use metasense_worker::run::{NoResult, pool};

use crate::prepare::{any_body, check_design, finite, placed};

/// Result of a simulation of N samples, T instants, M sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// Signals (N, T, 3M) (mm/s², rad/s).
    pub signals: Vec<f64>,
    /// (u, v, θ) of every unit at every instant, (N, T, units, 3) (mm, rad).
    pub displacements: Vec<f64>,
    /// Velocities, (N, T, units, 3) (mm/s, rad/s).
    pub velocities: Vec<f64>,
    /// Elastic energy, contact included, (N, T) (N·mm).
    pub energies: Vec<f64>,
    /// Gradient of Σ cotangent·signals in α, if a cotangent was given.
    pub gradient: Option<Vec<f64>>,
    /// Outcome of each sample.
    pub outcomes: Vec<&'static str>,
    /// N, T, units, M.
    pub shape: [usize; 4],
    /// The integrator, and why it was chosen.
    pub solver: String,
    /// Force evaluations, including the reverse sweep, without the pilot.
    pub force_evaluations: u64,
    /// Force evaluations of the pilot.
    pub pilot_evaluations: u64,
}

/// Forces from an array of shape (N, K, R + 1), R the scene's T or a multiple of it.
///
/// # Errors
/// If the shape does not match the scene, or a number is not finite.
pub fn forces(scene: &Scene, shape: &[usize], values: Vec<f64>) -> Result<Forces, NoResult> {
    let (panels, instants) = (scene.panels.len(), scene.instants);
    finite("the forces", &values)?;
    match *shape {
        [samples, k, clock]
            if samples > 0 && k == panels && clock > 1 && (clock - 1).is_multiple_of(instants) =>
        {
            Ok(Forces { samples, panels, instants: clock - 1, values, strikes: Vec::new() })
        }
        _ => Err(NoResult::Rejected(format!(
            "the forces have shape {shape:?}; it must be (N, K, T + 1) = (N, {panels}, {}), or a clock finer by a whole factor",
            instants + 1
        ))),
    }
}

/// Checks that a cotangent has the shape `expected`, that of the signals.
///
/// # Errors
/// If it has not, or a number is not finite.
pub fn check_cotangent(expected: [usize; 3], shape: &[usize], values: &[f64]) -> Result<(), NoResult> {
    if shape != expected {
        return Err(NoResult::Rejected(format!(
            "the cotangent has shape {shape:?}; it must be {expected:?}, that of the signals"
        )));
    }
    finite("the cotangent", values)
}

/// Simulates as a trial does: runs the pilot on the first samples, then all samples.
pub fn strike(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    solver: &IntegratorSettings,
    keep_tape: bool,
    pool: &Pool,
) -> (Tuned, Simulation) {
    let tuned = tune(scene, design, forces, solver, pool);
    let run = dynamics::simulate(scene, design, forces, &tuned.solver, keep_tape, pool);
    (tuned, run)
}

/// Simulates `design` under `forces` (N, K, R + 1), R the trial's T or a multiple of it, with the trial's solver settings.
///
/// # Errors
/// If the spec is invalid, or shapes do not match it.
pub fn simulate(
    trial: &TrialSpec,
    design: &[f64],
    forces: (&[usize], &[f64]),
    cotangent: Option<(&[usize], &[f64])>,
    threads: usize,
) -> Result<Simulated, NoResult> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    let scene = &problem.scene;
    check_design(&problem, design)?;
    let forces = self::forces(scene, forces.0, forces.1.to_vec())?;
    let (samples, instants, sensors) = (forces.samples, scene.instants, scene.sensors.len());
    check_states(samples, instants, scene.layout.units()).map_err(|e| NoResult::Rejected(e.to_string()))?;
    if let Some((shape, values)) = cotangent {
        check_cotangent([samples, instants, 3 * sensors], shape, values)?;
    }
    let (tuned, run) = strike(scene, design, &forces, &problem.solver, true, &pool);
    let mut work = run.counters;
    let units = scene.layout.units();
    let mut found = Simulated {
        signals: run.signals.clone(),
        displacements: Vec::new(),
        velocities: Vec::new(),
        energies: Vec::new(),
        gradient: None,
        outcomes: run.outcomes.iter().map(|o| o.name()).collect(),
        shape: [samples, instants, units, sensors],
        solver: tuned.plan.reason,
        force_evaluations: 0,
        pilot_evaluations: tuned.counters.force_evaluations,
    };
    for (sample, outcome) in run.outcomes.iter().enumerate() {
        for n in 1..=instants {
            // As in the signals, a failed sample is zero throughout.
            let (x, v) = match (outcome, &run.tape) {
                (Outcome::Ok, Some(tape)) => tape.state(sample, n),
                _ => (vec![[0.0; 3]; units], vec![[0.0; 3]; units]),
            };
            let e = energy(scene, design, &x);
            found.energies.push(e.elastic + e.contact);
            found.displacements.extend(x.into_flattened());
            found.velocities.extend(v.into_flattened());
        }
    }
    if let Some((_, cotangent)) = cotangent {
        let gradient = run.vjp(cotangent, Wrt::Design, &pool);
        work += gradient.counters;
        found.gradient = Some(gradient.design);
    }
    found.force_evaluations = work.force_evaluations;
    Ok(found)
}

/// The layout of a trial's body, without units if the body is external, and its initial design.
///
/// # Errors
/// If the spec is invalid.
pub fn body(trial: &TrialSpec) -> Result<(metasense_worker::design::Layout, Vec<f64>), NoResult> {
    let problem = any_body(trial)?;
    Ok((problem.scene.layout, problem.initial))
}
