//! What a linear model of a body is worth.

use super::*;

/// The small problem with forces of so many times the usual amplitude.
fn with_amplitude(times: f64) -> Problem {
    let mut problem = small(PROTOCOLS[3]);
    if let Source::Bell(bell) = &mut problem.stimuli.source {
        bell.amplitude = bell.amplitude.map(|a| times * a);
    }
    problem.solver = Solver { method: Method::Nystrom6, tolerance: 1e-6 };
    problem
}

/// The relative deviation from a linear motion grows with the amplitude, its square by four from one to the next double one.
#[test]
fn the_nonlinear_part_goes_with_the_square_of_small_forces() {
    let share = |times: f64| {
        let problem = with_amplitude(times);
        let pool = pool(1);
        let setting = Setting::new(&problem, &pool).unwrap();
        nonlinear(&setting, &problem.initial, &problem.solver, &mut Report::default()).unwrap()
    };
    let [whole, first, second] = [1.0, 0.005, 0.01].map(share);
    for kind in 0..2 {
        let ratio = second[kind] / first[kind];
        assert!((ratio - 4.0).abs() < 0.1, "{kind}: {first:?} {second:?}");
        assert!(second[kind] < 0.1 && (1.0..300.0).contains(&whole[kind]), "{whole:?} {second:?}");
    }
}
