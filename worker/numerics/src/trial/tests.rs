use super::*;

/// Of n samples, n/32 (rounded) may fail; their forces become zero.
#[test]
fn few_samples_may_fail() {
    let forces = |samples: usize| Forces {
        samples,
        panels: 2,
        instants: 3,
        values: vec![1.0; samples * 8],
        strikes: Vec::new(),
    };
    let failing = |samples: usize, failed: usize| -> Vec<Outcome> {
        (0..samples).map(|i| if i < failed { Outcome::NonFinite } else { Outcome::Ok }).collect()
    };
    for (samples, failed, may) in
        [(32, 1, true), (32, 2, false), (8, 1, false), (30, 1, true), (270, 8, true), (270, 9, false)]
    {
        let mut some = forces(samples);
        let outcomes = failing(samples, failed);
        let wanted = if may { Ok(()) } else { Err(Trouble::Simulation(Outcome::NonFinite)) };
        assert_eq!(check_failures(&outcomes), wanted, "{failed} of {samples}");
        let which: Vec<bool> = outcomes.iter().map(|outcome| *outcome != Outcome::Ok).collect();
        assert_eq!(clear_failed_forces(&mut some, &outcomes), which);
        let silent = some.values.chunks(8).take_while(|f| f.iter().all(|f| *f == 0.0)).count();
        assert_eq!((silent, some.values.iter().sum::<f64>()), (failed, (8 * (samples - failed)) as f64));
    }
}

/// Over parts of a mixture, the objective is the geometric mean of the losses with its derivatives. The worst part is the one with
/// the greatest ratio to its first loss.
#[test]
fn an_objective_over_parts_is_of_relative_errors() {
    let of = |tail| CastObjective { over: ObjectiveDomain::Parts, casts: 2, tail };
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} for {b}");
    let (mean, weights) = of(1.0).objective(&[4.0, 1.0], &[1.0, 1.0]);
    for (a, b) in [(mean, 2.0), (weights[0], 0.25), (weights[1], 1.0)] {
        near(a, b);
    }
    let (worst, weights) = of(0.0).objective(&[4.0, 1.0], &[8.0, 1.5]);
    for (a, b) in [(worst, 1.0), (weights[0], 0.0), (weights[1], 1.0)] {
        near(a, b);
    }
}

/// Weights for the mean of all casts, the worst half, a tail that contains part of a cast, and the worst cast.
#[test]
fn an_objective_weighs_the_worst_casts() {
    let weights =
        |tail| CastObjective { over: ObjectiveDomain::Casts, casts: 4, tail }.weights(&[3.0, 1.0, 4.0, 2.0]);
    assert_eq!(weights(1.0), [0.25; 4]);
    assert_eq!(weights(0.5), [0.5, 0.0, 0.5, 0.0]);
    let cut = weights(0.4);
    let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
    assert!(near(cut[2], 0.625) && near(cut[0], 0.375) && cut[1] == 0.0 && cut[3] == 0.0, "{cut:?}");
    for tail in [0.25, 0.1, 0.0] {
        assert_eq!(weights(tail), [0.0, 0.0, 1.0, 0.0]);
    }
}

/// One error of 1000 % among eleven changes no quantile. Samples without force do not count; NaN counts as infinite.
#[test]
fn one_sample_does_not_move_a_spread() {
    let errors = |last: f64| -> Vec<Option<f64>> {
        (0..10).map(|i| Some(f64::from(i))).chain([None, Some(last)]).collect()
    };
    let spread = Spread { median: 5.0, p90: 9.0, above: 1 };
    for last in [1000.0, f64::INFINITY, f64::NAN] {
        assert_eq!(Spread::of(&errors(last)), Some(spread), "{last}");
    }
    assert_eq!(Spread::of(&errors(FAILED)), Some(Spread { above: 0, ..spread }));
    assert_eq!(Spread::of(&[Some(1.0), Some(3.0)]), Some(Spread { median: 2.0, p90: 2.8, above: 0 }));
    assert_eq!(Spread::of(&[Some(1.0), None]), Some(Spread { median: 1.0, p90: 1.0, above: 0 }));
    assert_eq!(Spread::of(&[None, None]), None);
}
