use super::*;
use crate::Pool;
use crate::brain::linear::{Lags, Sizes};
use crate::random::{Purpose, Stream};
use crate::stimuli::members;

const LAGS: Lags = Lags { before: 2, after: 1 };
const RIDGE: f64 = 1e-2;
const FOLDS: [usize; 12] = [0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2];

/// Twelve samples of two channels and two noisy forces; the last has no force.
fn samples() -> ScaledSamples {
    let sizes = Sizes { instants: 9, channels: 2, outputs: 2 };
    let mut stream = Stream::new(Purpose::Design, 5, [0, 0]);
    let x: Vec<f64> = (0..FOLDS.len() * 18).map(|_| stream.normal()).collect();
    let mut y: Vec<f64> = x.iter().map(|x| x + 0.5 * x * x + 0.3 * stream.normal()).collect();
    y[11 * 18..].fill(0.0);
    let power = |y: &[f64]| y.iter().map(|y| y * y).sum::<f64>();
    let w = y.chunks_exact(18).map(|y| if power(y) > 0.0 { power(y).recip() } else { 0.0 }).collect();
    ScaledSamples { sizes, x, y, w, failed: vec![false; FOLDS.len()], pool: Pool::new(1).unwrap() }
}

fn crossed(samples: &ScaledSamples, ridge: f64) -> CrossValidation {
    let parts = fold_equations(samples, &members(&FOLDS), LAGS);
    let all = samples.normal(LAGS);
    CrossValidation::new(samples.clone(), 3, members(&FOLDS), &parts, &all, ridge).unwrap()
}

/// Errors (%) by explicit fits without each fold.
fn refitted(samples: &ScaledSamples, ridge: f64) -> Vec<Option<f64>> {
    let mut errors = vec![None; FOLDS.len()];
    for fold in 0..3 {
        let (own, others): (Vec<usize>, Vec<usize>) = (0..12).partition(|i| FOLDS[*i] == fold);
        let linear = solve(samples.select(&others).normal(LAGS), ridge).unwrap().linear();
        let own_samples = samples.select(&own);
        let found = own_samples.errors(&linear.predict(&own_samples.x));
        own.iter().zip(found).for_each(|(i, error)| errors[*i] = error);
    }
    errors
}

/// Mean error of each of three casts of four samples.
fn of_casts(samples: &ScaledSamples, ridge: f64) -> [f64; 3] {
    let errors = refitted(samples, ridge);
    [0, 1, 2].map(|cast| 0.01 * mean_error(&errors[4 * cast..][..4]).unwrap())
}

fn mean(samples: &ScaledSamples, ridge: f64) -> f64 {
    of_casts(samples, ridge).iter().sum::<f64>() / 3.0
}

#[test]
fn errors_are_those_of_fits_without_the_fold() {
    let samples = samples();
    let (found, known) = (crossed(&samples, RIDGE).errors, refitted(&samples, RIDGE));
    for (found, known) in found.iter().zip(&known) {
        assert_eq!(found.is_some(), known.is_some());
        assert!(found.zip(*known).is_none_or(|(a, b)| (a / b - 1.0).abs() < 1e-9), "{found:?} {known:?}");
    }
    assert_eq!(found.iter().flatten().count(), 11);
}

/// Central differences of explicit refits, in the signals for unequal weights of the casts and in ln λ.
#[test]
fn gradients_are_those_of_refits() {
    let samples = samples();
    let by_cast = [0.2, 0.0, 0.7];
    let gradient = crossed(&samples, RIDGE).vjp(&by_cast);
    let mut stream = Stream::new(Purpose::Design, 6, [0, 0]);
    let direction: Vec<f64> = gradient.iter().map(|_| stream.normal()).collect();
    let at = |step: f64| {
        let mut moved = samples.clone();
        moved.x.iter_mut().zip(&direction).for_each(|(x, d)| *x += step * d);
        of_casts(&moved, RIDGE).iter().zip(&by_cast).map(|(e, by)| e * by).sum::<f64>()
    };
    let slope: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
    let known = (at(1e-5) - at(-1e-5)) / 2e-5;
    assert!((slope / known - 1.0).abs() < 1e-6 && known.abs() > 1e-3, "{slope} {known}");

    for ridge in [1e-4, 1e-2, 1.0] {
        let [up, down] = [1e-4, -1e-4].map(|step: f64| mean(&samples, ridge * step.exp()).ln());
        let step = (crossed(&samples, ridge).next_ridge() / ridge).ln();
        let known = (-RIDGE_RATE * (up - down) / 2e-4).clamp(-1.0, 1.0);
        assert!((step - known).abs() < 1e-5, "{ridge}: {step} {known}");
    }
}

/// Steps of λ end at the least error, from both sides. (A far smaller λ has no effect on the error, and thus no slope.)
#[test]
fn steps_of_the_ridge_end_at_the_least_error() {
    let samples = samples();
    let ends = [1e-2, 1e2].map(|start| (0..1000).fold(start, |at, _| crossed(&samples, at).next_ridge()));
    assert!((ends[0] / ends[1]).ln().abs() < 1e-3, "{ends:?}");
    let [below, at, above] = [0.8, 1.0, 1.25].map(|times| mean(&samples, times * ends[0]));
    assert!(at < below && at < above, "{below} {at} {above}");
}

/// Earlier samples that equal those outside a fold change neither its decoder nor its part of the gradient: the error of the first
/// cast, which is the first fold.
#[test]
fn earlier_samples_count_as_if_they_moved() {
    let samples = samples();
    let folds: Vec<usize> = (0..12).map(|i| i / 4).collect();
    let own = samples.normal(LAGS);
    let others: Vec<usize> = (4..12).collect();
    let all = own.clone().plus(0.4, &samples.select(&others).normal(LAGS));
    let parts = fold_equations(&samples, &members(&folds), LAGS);
    let [alone, together] = [&own, &all].map(|all| {
        let crossed = CrossValidation::new(samples.clone(), 3, members(&folds), &parts, all, RIDGE);
        crossed.unwrap().vjp(&[1.0, 0.0, 0.0])
    });
    let size = alone.iter().map(|g| g.abs()).fold(0.0, f64::max);
    assert!(size > 0.0 && alone.iter().zip(&together).all(|(a, b)| (a - b).abs() < 1e-9 * size), "{size}");
}
