//! Nonlinear share: the part of a body's signals that its linearisation at rest does not explain.
//!
//! ```text
//! 100 · mean over channels of Σ (s(f) − s_lin(f))² / Σ s(f)²,   s_lin(f) = s(ε f)/ε
//! ```
//! Both runs use the same integrator and steps; Tsit5's absolute tolerance is scaled by ε as well. Nonlinear terms in s_lin are
//! of order ε.

use crate::dynamics::{
    Accuracy, Forces, IntegratorSettings, Outcome, Simulation, signal_error, simulate, touches,
};
use crate::random::Purpose;
use crate::trial::{Counters, DesignWithSolver};

/// ε: causes errors of 1e-5 in s_lin, a thousand times the rounding error.
const SMALL: f64 = 1e-5;
/// Largest tolerance, in f64: rounding in f32 would hide the differences.
pub const EXACT: Accuracy = Accuracy(1e-3);
/// Number of samples: three blocks of lanes.
const SAMPLES: usize = 24;

/// Nonlinear share of the accelerations, and of the angular velocities (%).
pub type Nonlinear = [f64; 2];

/// Nonlinear share of a body under the first held-out samples, without chip effects; `None` if a simulation fails, if parts touch
/// at rest, or if the body does not consist of polygons.
pub(super) fn nonlinear(mould: &DesignWithSolver, counters: &mut Counters) -> Option<Nonlinear> {
    let &DesignWithSolver { trial, design, solver } = mould;
    let (problem, scene) = (&trial.problem, &trial.problem.scene);
    if scene.layout.units() == 0 || touches(scene, design) {
        return None;
    }
    let solver = solver.at_most(EXACT);
    let forces = problem.forces(Purpose::Holdout, 0, problem.stimuli.holdout.min(SAMPLES));
    let scaled = |by: f64| {
        let values = forces.values.iter().map(|f| by * f).collect();
        Forces { values, ..forces.clone() }
    };
    let [full, small] = [1.0, SMALL].map(|by| {
        let solver =
            IntegratorSettings { tolerance: solver.tolerance.map(|t| t.for_motion_scaled_by(by)), ..solver };
        simulate(scene, design, &scaled(by), &solver, false, trial.pool)
    });
    [&full, &small].iter().for_each(|run| counters.dynamics += run.counters);
    let well = |run: &Simulation| run.outcomes.iter().all(|o| *o == Outcome::Ok);
    let channels = 3 * scene.sensors.len();
    let of = |turn: bool| {
        let pick = |run: &Simulation, by: f64| -> Vec<f64> {
            let kind = |c: usize| (c % channels % 3 == 2) == turn;
            run.signals.iter().enumerate().filter(|(c, _)| kind(*c)).map(|(_, s)| by * s).collect()
        };
        let of_kind = if turn { channels / 3 } else { channels / 3 * 2 };
        100.0 * signal_error(&pick(&small, SMALL.recip()), &pick(&full, 1.0), of_kind).powi(2)
    };
    let found = (channels > 0 && well(&full) && well(&small)).then(|| [of(false), of(true)]);
    found.filter(|found| found.iter().all(|share| share.is_finite()))
}
