//! What a linear model of a body is worth: the part of its signals that its linearisation at rest does not give.
//!
//! ```text
//! 100 · mean over channels of Σ (s(f) − s_lin(f))² / Σ s(f)²,   s_lin(f) = s(ε f)/ε
//! ```
//! Both by the same integrator with the same steps; Tsit5's absolute tolerance is scaled by ε too. What is not linear in s_lin
//! is of the order of ε.

use crate::dynamics::{Accuracy, Forces, Outcome, Simulation, Solver, signal_error, simulate, touches};
use crate::random::Purpose;
use crate::trial::{Counters, Mould};

/// ε: errors of 1e-5 in s_lin, which rounding stays a thousand times below.
const SMALL: f64 = 1e-5;
/// Accuracy at least, in f64: the rounding of f32 would hide the differences that are asked for.
pub(super) const EXACT: Accuracy = Accuracy(1e-3);
/// Samples that are looked at: three blocks of lanes.
const SAMPLES: usize = 24;

/// Of the accelerations, and of the angular velocities (%).
pub type Nonlinear = [f64; 2];

/// Of a body under the first samples of the holdout, without what chips add; none where one does not end well, or where parts touch
/// at rest; none of a body other than polygons.
pub(crate) fn nonlinear(mould: &Mould, counters: &mut Counters) -> Option<Nonlinear> {
    let &Mould { trial, design, solver } = mould;
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
        let solver = Solver { tolerance: solver.tolerance.map(|t| t.of_motion(by)), ..solver };
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
