use super::*;

#[test]
fn the_ratio_of_known_pairs_with_student_s_interval() {
    let logs = [0.5, 0.7, 0.9, 1.1];
    let of_seeds = |logs: &[f64]| {
        let seed = |i: usize| Cluster { placement: 0, seed: i as u64 };
        Ratio::of(logs.iter().enumerate().map(|(i, l)| (seed(i), l.exp())))
    };
    let found = of_seeds(&logs).unwrap();
    let half = 3.182_446_305_284_263 * (0.2f64 / 3.0).sqrt() / 2.0;
    let interval = found.interval.unwrap();
    assert!((found.ratio.ln() - 0.8).abs() < 1e-12 && found.above_one == 4, "{found:?}");
    assert!((interval.low.ln() - (0.8 - half)).abs() < 1e-9, "{interval:?}");
    assert!((interval.high.ln() - (0.8 + half)).abs() < 1e-9, "{interval:?}");
    let few = of_seeds(&logs[..3]).unwrap();
    assert_eq!((few.interval, &few.over[..]), (None, "no interval, too few units: 3 seeds"));
    assert_eq!(of_seeds(&[]), None);
}

#[test]
fn schedules_are_not_mixed() {
    let trial = |rate: &str| Trial {
        setting: [("evaluation.schedule".to_owned(), serde_json::json!(rate))].into_iter().collect(),
        ..Trial::default()
    };
    let trials = ["cosine", "constant", "cosine"].map(trial);
    let found = schedules(&trials.iter().collect::<Vec<_>>());
    let counts: Vec<(&str, usize)> = found.iter().map(|(rate, trials)| (*rate, trials.len())).collect();
    assert_eq!(counts, [("constant", 1), ("cosine", 2)]);
}

/// Loss 1/n on the initial body and 1/(4n) on the trained one: equal loss at a quarter of the iterations.
#[test]
fn a_curve_four_times_as_steep_needs_a_quarter_of_the_iterations() {
    let curve =
        |factor: f64| -> Vec<CurvePoint> { (1..=1000).map(|n| (n, 1.0 / (factor * f64::from(n)))).collect() };
    let (slow, fast) = (curve(1.0), curve(4.0));
    assert_eq!(iteration_ratio(&slow, &fast), Some(4.0));
    assert_eq!(iteration_ratio(&fast, &slow), Some(0.25));
    assert_eq!(iteration_ratio(&slow, &[]), None);
}

/// In one trial, a sample of 30 000 % dominates the mean: by means the ratio is undecided, by medians it is above 1.
#[test]
fn a_few_samples_that_decide_a_mean_are_told() {
    let trials = |last: f64| -> Vec<Trial> {
        let error = |seed: u64| if seed == 5 { last } else { 10.0 };
        let trial = |seed: u64| Trial {
            cluster: Cluster { placement: 0, seed },
            errors: [
                [None, Some(20.0 + seed as f64), Some(18.0 + seed as f64)],
                [None, Some(error(seed)), Some(9.0)],
            ],
            ..Trial::default()
        };
        (0..6).map(trial).collect()
    };
    let of = |trials: &[Trial]| {
        let refs: Vec<&Trial> = trials.iter().collect();
        disagreement(|set| error_ratio(&refs, set))
    };
    let (ratio, verdicts) = of(&trials(500.0)).unwrap();
    assert_eq!(verdicts, "undecided by means, above 1 by medians");
    assert!((2.0..2.6).contains(&ratio.ratio) && ratio.interval.unwrap().low > 1.0, "{ratio:?}");
    assert_eq!(of(&trials(11.0)), None);
    // nothing is compared if some trials have no median
    let mut some = trials(500.0);
    some[0].errors.iter_mut().for_each(|of| of[2] = None);
    assert_eq!(of(&some), None);
}
