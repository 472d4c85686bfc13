use super::*;

fn judged(body: &str, errors: &[f64]) -> BodyErrors {
    BodyErrors {
        body: body.into(),
        by: SignalSource::Measured,
        errors: errors.iter().map(|e| Some(*e)).collect(),
        error_train: None,
        by_seed: vec![],
        by_fold: vec![],
        progress: vec![],
        agreement: None,
        posterior: None,
    }
}

/// Errors that differ by a factor of 2 per record: the ratio is exact for paired records, but not for unpaired ones.
#[test]
fn pairs_know_a_ratio_better_than_records_apart() {
    let errors: Vec<f64> = (1..=30).map(|i| 4.0 + f64::from(i * i % 17)).collect();
    let half: Vec<f64> = errors.iter().map(|e| 0.5 * e).collect();
    let (first, second) = (judged("a", &errors), judged("b", &half));
    let paired = mean_ratio(&first, &second, true).unwrap();
    let apart = mean_ratio(&first, &second, false).unwrap();
    let (tight, wide) = (paired.interval.unwrap(), apart.interval.unwrap());
    assert!((paired.ratio - 2.0).abs() < 1e-12 && (apart.ratio - 2.0).abs() < 1e-12);
    assert!((tight.high - tight.low) < 1e-12, "{tight:?}");
    assert!(wide.low < 1.9 && wide.high > 2.1 && wide.low > 1.0, "{wide:?}");
}

/// An equal channel, one of twice the size, one of opposite sign; then all delayed by two instants.
#[test]
fn signals_agree_by_shape_by_size_and_in_time() {
    let value = |at: usize| {
        let (record, n, c) = (at / 150, at / 3 % 50, at % 3);
        (0.7 * n as f64 + c as f64 + record as f64).sin() * (-0.05 * n as f64).exp()
    };
    let measured: Vec<f64> = (0..600).map(value).collect();
    let factors = [1.0, 2.0, -1.0];
    let simulated: Vec<f64> = measured.iter().enumerate().map(|(i, m)| m * factors[i % 3]).collect();
    let found = Agreement::of(&measured, &simulated, [50, 3]);
    assert!((found.correlation - 1.0 / 3.0).abs() < 1e-9, "{found:?}");
    assert!((found.difference - 100.0 * (5.0f64 / 3.0).sqrt()).abs() < 1e-9, "{found:?}");
    let late = |at: usize| if at / 3 % 50 < 2 { 0.0 } else { measured[at - 6] };
    let late: Vec<f64> = (0..600).map(late).collect();
    let found = Agreement::of(&late, &measured, [50, 3]);
    assert!(found.lag == 2 && found.correlation < 0.9, "{found:?}");
    assert_eq!(Agreement::of(&measured, &late, [50, 3]).lag, -2);
}
