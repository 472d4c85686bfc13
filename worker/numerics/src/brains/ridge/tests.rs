use super::*;
use crate::Pool;
use crate::brain::linear::Sizes;
use crate::random::{Purpose, Stream};

fn judged(errors: &[&[f64]]) -> Vec<(f64, Vec<Option<f64>>)> {
    let values = (0..errors.len()).map(|j| 10_f64.powi(-(j as i32)));
    values.zip(errors).map(|(value, errors)| (value, errors.iter().copied().map(Some).collect())).collect()
}

/// Selects the greatest value within a standard error of the least, even beyond a maximum between them.
#[test]
fn the_greatest_value_as_good_as_the_best_is_taken() {
    // 1 and 0.1 are worse in every sample; 0.01 differs from 0.001 by less than the spread of differences.
    let found =
        one_se_choice(&judged(&[&[9.0, 9.5, 9.0], &[5.0, 5.1, 5.2], &[1.0, 1.3, 1.1], &[1.2, 1.0, 1.1]]));
    assert_eq!(found, Ok(0.01));
    // A maximum between the least and a greater value.
    let found = one_se_choice(&judged(&[
        &[2.0, 2.0, 2.1],
        &[90.0, 80.0, 95.0],
        &[1.0, 1.1, 1.0],
        &[80.0, 70.0, 90.0],
    ]));
    assert_eq!(found, Ok(0.01));
    // Within a standard error because of one outlier, but a fifth worse.
    let found = one_se_choice(&judged(&[&[1.3, 9.0, 1.2, 1.2], &[1.0, 1.1, 1.0, 1.1]]));
    assert_eq!(found, Ok(0.1));
    assert_eq!(one_se_choice(&[]), Err(Trouble::Singular));
    assert_eq!(one_se_choice(&[(1.0, vec![None]), (0.1, vec![None])]), Ok(NEUTRAL));
}

/// Samples y = x · w + noise with a few instants.
fn samples(count: usize, noise: f64, pool: &Pool) -> ScaledSamples {
    let sizes = Sizes { instants: 12, channels: 2, outputs: 1 };
    let mut stream = Stream::new(Purpose::Stimulus, 5, [count as u64, 0]);
    let x: Vec<f64> = (0..count * 24).map(|_| stream.normal()).collect();
    let y: Vec<f64> = x.chunks_exact(2).map(|x| x[0] - 0.5 * x[1] + noise * stream.normal()).collect();
    let w = y.chunks_exact(12).map(|y| y.iter().map(|f| f * f).sum::<f64>().recip()).collect();
    ScaledSamples { sizes, x, y, w, failed: vec![false; count], pool: pool.clone() }
}

/// Each sample is tested once, with weights of the other folds; a direct computation gives the same errors.
#[test]
fn parts_judge_what_they_were_not_fitted_to() {
    let pool = Pool::new(1).unwrap();
    let samples = samples(7, 0.1, &pool);
    let lags = crate::brain::linear::Lags { before: 1, after: 1 };
    let (all, dealt) = (samples.normal(lags), assign_folds(3, 7));
    let own = split_folds(&samples, &all, &dealt);
    let found = super::errors_by_value([1e-3].into_iter(), false, own, FoldSplit::errors_of_others);
    assert_eq!(found[0].1.len(), 7);
    let own: Vec<usize> = (0..7).filter(|&i| dealt[i] == 0).collect();
    let others: Vec<usize> = (0..7).filter(|&i| dealt[i] != 0).collect();
    let linear = solve(samples.select(&others).normal(lags), 1e-3).unwrap().linear();
    let judges = samples.select(&own);
    for (found, expected) in found[0].1.iter().zip(judges.errors(&linear.predict(&judges.x))) {
        assert!((found.unwrap() - expected.unwrap()).abs() < 1e-9, "{found:?} {expected:?}");
    }
}

/// One sample, samples without force, and one fold also have a λ.
#[test]
fn too_few_samples_to_judge_have_a_neutral_value() {
    let pool = Pool::new(1).unwrap();
    let lags = crate::brain::linear::Lags { before: 1, after: 1 };
    let one = samples(1, 0.1, &pool);
    assert_eq!(ridge_of(&one, &one.normal(lags), &assign_folds(3, 1)), Ok(NEUTRAL));
}

/// More noise gives a greater λ. With many samples, the reduced search gives the same λ as the full one, or its neighbour.
#[test]
fn noise_asks_for_regularisation() {
    let pool = Pool::new(1).unwrap();
    let lags = crate::brain::linear::Lags { before: 5, after: 5 };
    for count in [20, 80] {
        let of = |noise| {
            let samples = samples(count, noise, &pool);
            let (all, dealt) = (samples.normal(lags), assign_folds(3, count));
            let own = split_folds(&samples, &all, &dealt);
            let full = super::errors_by_value(ridges(), false, own, FoldSplit::errors_of_others);
            (ridge_of(&samples, &all, &dealt).unwrap(), one_se_choice(&full).unwrap())
        };
        let [(quiet, quiet_by_all), (loud, loud_by_all)] = [1e-4, 2.0].map(of);
        assert!(quiet < loud, "{count}: {quiet} {loud}");
        for (found, by_all) in [(quiet, quiet_by_all), (loud, loud_by_all)] {
            assert!((found.log10() - by_all.log10()).abs() < 1.5, "{count}: {found} {by_all}");
        }
    }
}
