//! One body under given forces: signals, motion and, of a cotangent on the signals, the gradient in the design.

use metasense_numerics::dynamics::{self, Forces, Outcome, energy, pull_back, tune};
use metasense_schemas::spec::TrialSpec;

use crate::problem::problem;
use crate::run::{Failure, placed, pool};

/// What a body does; N samples, T instants, M sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulated {
    /// (N, T, 3M) (mm/s², rad/s).
    pub signals: Vec<f64>,
    /// (u, v, θ) of every unit at every instant, (N, T, units, 3) (mm, rad).
    pub displacements: Vec<f64>,
    /// Likewise (mm/s, rad/s).
    pub velocities: Vec<f64>,
    /// Elastic energy, contact included, (N, T) (N·mm).
    pub energies: Vec<f64>,
    /// dα of Σ cotangent·signals, where one was given.
    pub gradient: Option<Vec<f64>>,
    /// How each sample ended.
    pub outcomes: Vec<&'static str>,
    /// N, T, units, M.
    pub shape: [usize; 4],
    /// The integrator, and why.
    pub solver: String,
    /// Evaluations of the forces, pilot and reverse sweep included.
    pub force_evaluations: u64,
}

/// Simulates `design` under `forces` (N, K, R + 1), R the trial's T or a multiple of it, at the trial's solver settings.
///
/// # Errors
/// If the spec stands for no trial, or shapes do not fit it.
pub fn simulate(
    trial: &TrialSpec,
    design: &[f64],
    forces: (&[usize], &[f64]),
    cotangent: Option<(&[usize], &[f64])>,
    threads: usize,
) -> Result<Simulated, Failure> {
    let rejected = |what: String| Failure::Rejected(what);
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    let scene = &problem.scene;
    if design.len() != problem.initial.len() {
        let expected = problem.initial.len();
        return Err(rejected(format!("the design has {} numbers, the trial {expected}", design.len())));
    }
    let (panels, instants) = (scene.panels.len(), scene.instants);
    let (samples, clock) = match *forces.0 {
        [n, k, clock] if n > 0 && k == panels && clock > 1 && (clock - 1).is_multiple_of(instants) => {
            (n, clock - 1)
        }
        _ => {
            return Err(rejected(format!(
                "the forces have shape {:?}; it must be (N, K, T + 1) = (N, {panels}, {}), or a clock finer by a whole factor",
                forces.0,
                instants + 1
            )));
        }
    };
    let sensors = scene.sensors.len();
    let expected = [samples, instants, 3 * sensors];
    if let Some((shape, _)) = cotangent
        && shape != expected
    {
        return Err(rejected(format!(
            "the cotangent has shape {shape:?}; it must be {expected:?}, that of the signals"
        )));
    }
    if let Some(bad) = design.iter().chain(forces.1).find(|x| !x.is_finite()) {
        return Err(rejected(format!("{bad} among the numbers of design and forces")));
    }
    let forces = Forces { samples, panels, instants: clock, values: forces.1.to_vec() };
    let tuned = tune(scene, design, &forces, &problem.solver, &pool);
    let run = dynamics::simulate(scene, design, &forces, &tuned.solver, true, &pool);
    let mut work = tuned.counters;
    work += run.counters;
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
    };
    for (sample, outcome) in run.outcomes.iter().enumerate() {
        for n in 1..=instants {
            // As the signals: what a failed sample did before it failed is not told.
            let (x, v) = match (outcome, &run.tape) {
                (Outcome::Ok, Some(tape)) => tape.state(scene, sample, n),
                _ => (vec![[0.0; 3]; units], vec![[0.0; 3]; units]),
            };
            let e = energy(scene, design, &x);
            found.energies.push(e.elastic + e.contact);
            found.displacements.extend(x.into_flattened());
            found.velocities.extend(v.into_flattened());
        }
    }
    if let Some((_, cotangent)) = cotangent {
        let all: Vec<usize> = (0..samples).collect();
        let gradient = pull_back(scene, design, &forces, &run, &all, cotangent, &pool);
        work += gradient.counters;
        found.gradient = Some(gradient.design);
    }
    found.force_evaluations = work.force_evaluations;
    Ok(found)
}

/// The layout of a trial's body, and its initial design.
///
/// # Errors
/// If the spec stands for no trial.
pub fn body(trial: &TrialSpec) -> Result<(crate::design::Layout, Vec<f64>), Failure> {
    let problem = problem(trial).map_err(|invalid| Failure::Rejected(invalid.to_string()))?;
    Ok((problem.scene.layout, problem.initial))
}
