//! Samples whose simulation fails have 100 % error, on every body and with every decoder.

use super::small::with_failing_samples;
use super::*;
use crate::trial::PreparedTrial;

/// A failed sample has 100 % error in the training, test and held-out sets of both bodies, in the loop, the comparison, other
/// decoders. With zero force instead, results are identical except that means have one sample less.
#[test]
fn samples_that_fail_count_as_read_entirely_wrong() {
    // numbers beyond the pilot's samples
    let (train, test) = crate::stimuli::split(3, 32, 16, false);
    let late = |set: &[usize]| *set.last().expect("not empty");
    let spoilt = [(Purpose::Stimulus, late(&train)), (Purpose::Stimulus, late(&test)), (Purpose::Holdout, 2)];
    for brain in [DecoderKind::Linear, DecoderKind::Network, DecoderKind::Stacked] {
        let [failing, silent] = [1e200, 0.0].map(|factor| {
            let problem = with_failing_samples(brain, &spoilt, factor);
            let mut keeper = Keeper::default();
            let found = optimise(&problem, None, &pool(2), &mut keeper).unwrap().unwrap();
            let tests: Vec<f64> = keeper.reports.iter().filter_map(|report| report.error_test).collect();
            (problem, found, tests)
        });
        let counted = |failing: Option<f64>, silent: Option<f64>, what: &str| {
            let (found, wanted) = (failing.unwrap(), (15.0 * silent.unwrap() + 100.0) / 16.0);
            assert!((found / wanted - 1.0).abs() < 1e-9, "{brain:?}, {what}: {found} %, not {wanted} %");
        };
        for (a, b) in [(&failing.1.initial, &silent.1.initial), (&failing.1.optimised, &silent.1.optimised)] {
            assert_eq!((a.zero_samples, &a.design), ([1; 3], &b.design));
            for (a, b) in a.networks.iter().zip(&b.networks) {
                counted(a.error_train, b.error_train, "training set");
                counted(a.error_test, b.error_test, "test set");
                counted(a.error_holdout, b.error_holdout, "holdout");
                for (a, b) in a.errors.iter().zip(&b.errors) {
                    counted(Some(a.1), Some(b.1), "on the way");
                }
            }
            for (a, b) in a.readings.iter().zip(&b.readings) {
                counted(a.error_train, b.error_train, "training set read");
                counted(a.error_holdout, b.error_holdout, "holdout read");
            }
        }
        assert!(!failing.2.is_empty());
        failing.2.iter().zip(&silent.2).for_each(|(a, b)| counted(Some(*a), Some(*b), "a step's test"));
    }
}

/// A training sample that fails on the initial body counts as failed in every step.
#[test]
fn what_the_initial_body_fails_on_counts_against_every_step() {
    let (train, _) = crate::stimuli::split(3, 32, 16, false);
    let last = *train.last().expect("not empty");
    let [failing, silent] = [1e200, 0.0].map(|factor| {
        let problem = with_failing_samples(DecoderKind::Linear, &[(Purpose::Stimulus, last)], factor);
        let mut keeper = Keeper::default();
        let trial = PreparedTrial::new(&problem, &pool(2)).map(|trial| trial.initial.failures());
        assert_eq!(trial, Ok(u64::from(factor > 0.0)));
        optimise(&problem, None, &pool(2), &mut keeper).unwrap().unwrap();
        keeper.reports.iter().map(|report| report.error_train.unwrap()).collect::<Vec<f64>>()
    });
    for (found, silent) in failing.iter().zip(&silent) {
        let wanted = (15.0 * silent + 100.0) / 16.0;
        assert!((found / wanted - 1.0).abs() < 1e-9, "{found} %, not {wanted} %");
    }
}

/// The implicit term is the derivative of a fit to the samples that did not fail.
#[test]
fn the_whole_gradient_holds_where_a_training_sample_fails() {
    let (train, _) = crate::stimuli::split(3, 32, 16, false);
    let last = *train.last().expect("not empty");
    let mut problem = with_failing_samples(DecoderKind::Linear, &[(Purpose::Stimulus, last)], 1e200);
    let own = linear::linear(TrainingProtocol::Paper(Terms::Implicit));
    (problem.decoder, problem.optimise) = (own.decoder, own.optimise);
    problem.scene.density *= 4.0; // fewer steps
    linear::check_the_whole_gradient(problem, true);
}
