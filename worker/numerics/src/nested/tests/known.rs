//! Nonlinear share of a body's signals.

use super::*;
use crate::dynamics::tune;
use crate::nested::nonlinear::nonlinear;

/// The small problem with forces of `times` the usual amplitude.
fn with_amplitude(times: f64) -> Problem {
    let mut problem = small(PROTOCOLS[2]);
    if let HistorySource::Bell(bell) = &mut problem.stimuli.source {
        bell.amplitude = bell.amplitude.map(|a| times * a);
    }
    problem.solver = IntegratorSettings::new(Integrator::Nystrom6, Accuracy(1e-6));
    problem
}

/// The nonlinear share quadruples when small forces double.
#[test]
fn the_nonlinear_part_goes_with_the_square_of_small_forces() {
    let share = |times: f64| {
        let problem = with_amplitude(times);
        let pool = pool(1);
        let trial = PreparedTrial::new(&problem, &pool).unwrap();
        let mould = DesignWithSolver { trial: &trial, design: &problem.initial, solver: &problem.solver };
        nonlinear(&mould, &mut Counters::default()).unwrap()
    };
    let [whole, first, second] = [1.0, 0.005, 0.01].map(share);
    for kind in 0..2 {
        let ratio = second[kind] / first[kind];
        assert!((ratio - 4.0).abs() < 0.1, "{kind}: {first:?} {second:?}");
        assert!(second[kind] < 0.1 && (1.0..300.0).contains(&whole[kind]), "{whole:?} {second:?}");
    }
}

/// The nonlinear share agrees between Tsit5 and equal steps: the tolerance scales with the small forces.
#[test]
fn the_nonlinear_part_does_not_depend_on_the_integrator() {
    for times in [0.1, 1.0] {
        let (problem, pool) = (with_amplitude(times), pool(1));
        let trial = PreparedTrial::new(&problem, &pool).unwrap();
        let share = |solver| {
            let mould = DesignWithSolver { trial: &trial, design: &problem.initial, solver };
            nonlinear(&mould, &mut Counters::default()).unwrap()
        };
        let asked = IntegratorSettings::new(Integrator::Tsit5, Accuracy(1e-4));
        let tsit5 = tune(&problem.scene, &problem.initial, &trial.train, &asked, &pool).solver;
        let (adaptive, equal) = (share(&tsit5), share(&problem.solver));
        for kind in 0..2 {
            let off = (adaptive[kind] / equal[kind] - 1.0).abs();
            assert!(off < 0.02, "× {times}: {adaptive:?} by Tsit5, {equal:?} by equal steps");
        }
    }
}
