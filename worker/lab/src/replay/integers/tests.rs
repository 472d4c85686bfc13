use metasense_schemas::spec::{BrainKind, TrialSpec};
use metasense_worker::run::{pool, run_trial};

use super::*;
use crate::replay::tests::{Blind, small_trial};
use crate::replay::{fit_decoder, layers, replay};

/// A trial's replay, and its decoder as layers.
fn brain(trial: &TrialSpec) -> (Replay, Vec<Convolution>) {
    let result = run_trial(trial, None, &pool(1).unwrap(), &mut Blind).unwrap();
    let body = &result.optimised;
    let weights = body.networks.first().map_or(&[][..], |network| &network.weights);
    let replay = replay(trial, &body.design, weights, 0, 1).unwrap();
    let layers = layers(trial, &fit_decoder(trial, weights, &replay).unwrap(), &replay).unwrap();
    (replay, layers)
}

/// A network, a linear decoder with shared weights at long lags, and a stacked decoder.
fn brains() -> [(Replay, Vec<Convolution>); 3] {
    [BrainKind::Cnn, BrainKind::Linear, BrainKind::Stacked].map(|kind| {
        let mut trial = small_trial();
        trial.brain.kind = kind;
        trial.time.samples = if kind == BrainKind::Cnn { 30 } else { 100 };
        brain(&trial)
    })
}

/// RMS difference between `read` and the trial's decoder over a set, relative to the RMS of the latter.
fn off(replay: &Replay, set: u8, brain: &[f64], read: &dyn Fn(&[f64]) -> Vec<f32>) -> f64 {
    let count = replay.split.len();
    let [signals, forces] = [&replay.signals[..], brain].map(|v| v.chunks_exact(v.len() / count));
    let (mut difference, mut all) = (0.0, 0.0);
    for ((signals, forces), _) in signals.zip(forces).zip(&replay.split).filter(|(_, own)| **own == set) {
        for (said, f) in read(signals).into_iter().zip(forces) {
            difference += (f64::from(said) - f).powi(2);
            all += f * f;
        }
    }
    (difference / all).sqrt()
}

/// Layers in f32 match the trial's decoder within 1e-5 of the greatest force, with 16 bits within 1e-3, with 8-bit weights within
/// a few percent; 8-bit activations are worse. No sum exceeds the bound, even for readings beyond full scale.
#[test]
fn integers_say_what_the_brain_says() {
    for (replay, layers) in brains() {
        let grouped = layers[0].spans.iter().any(|span| *span > 1);
        assert!(grouped == layers[0].linear);
        let single = SinglePrecision::new(&layers);
        // On training samples a stacked network uses out-of-fold estimates.
        let sets = if grouped && layers.len() > 1 { 2..=2 } else { 0..=2 };
        let exact = sets.map(|set| off(&replay, set, &replay.predictions, &|signals| single.read(signals)));
        let exact = exact.fold(0.0, f64::max);
        let one = replay.signals.len() / replay.split.len();
        let said = replay.signals.chunks_exact(one).flat_map(|signals| single.read(signals));
        let said: Vec<f64> = said.map(f64::from).collect();
        let [i16, i8] = [32767, 127].map(|most| Integers::new(&layers, most, &replay));
        let coarse = Integers::quantise(&layers, 127, 127, 1.0, &replay);
        let [fine, coarser, coarsest] =
            [&i16, &i8, &coarse].map(|of| off(&replay, 0, &said, &|signals| of.read(signals)));
        println!("{} layers: {exact:.1e} {fine:.1e} {coarser:.1e} {coarsest:.1e}", layers.len());
        assert!(exact < 1e-5 && fine < 1e-3 && coarser < 0.1, "{exact} {fine} {coarser}");
        assert!(4.0 * fine < coarser && 1.5 * coarser < coarsest, "{fine} {coarser} {coarsest}");
        for (of, most) in [(&i16, 32767), (&i8, 127)] {
            let loud: Vec<f64> = replay.signals[..one].iter().map(|x| 1e6 * x).collect();
            let greatest = |signals: &[f64]| of.sums(signals).into_iter().map(i64::abs).max().unwrap();
            assert!((greatest(&replay.signals[..one])..=of.bound).contains(&greatest(&loud)));
            let weights = of.layers.iter().flat_map(|layer| &layer.weights);
            assert_eq!(weights.map(|w| w.abs()).max(), Some(most));
        }
    }
}

/// Larger test and held-out samples change nothing; a larger training sample does.
#[test]
fn scales_are_those_of_training_samples() {
    let (mut replay, layers) = brain(&small_trial());
    let before = Integers::new(&layers, 127, &replay);
    let one = replay.signals.len() / replay.split.len();
    for set in [2, 1, 0] {
        let split = replay.split.clone();
        let own = replay.signals.chunks_exact_mut(one).zip(split).filter(|(_, s)| *s == set);
        own.for_each(|(signals, _)| signals.iter_mut().for_each(|x| *x *= 3.0));
        assert_eq!(Integers::new(&layers, 127, &replay) == before, set > 0, "set {set}");
    }
}

/// Rounds to the nearest step, halves away from zero, clips at full scale, and maps NaN to 0.
#[test]
fn readings_are_rounded_to_steps() {
    let (replay, layers) = brain(&small_trial());
    let of = Integers::new(&layers, 127, &replay);
    let steps = [0.49, 0.5, -0.5, -0.49, 1.49, -1.5, 4e4, -4e4, f32::INFINITY, f32::NAN];
    assert_eq!(steps.map(|x| of.steps(2.0 * x)), [0, 1, -1, 0, 1, -2, 32767, -32767, 32767, 0]);
}

/// A ratio is accurate to 2⁻²¹ for sums of up to 40 bits, and no product exceeds 2⁶².
#[test]
fn a_ratio_is_a_factor_and_a_shift() {
    for bound in [1i64 << 20, i32::MAX.into(), 1 << 40] {
        for exact in [1.0, 0.3, 1.7e-4, 3.3e-9] {
            let (factor, shift) = ratio(exact, bound);
            let found = factor as f64 / 2f64.powi(shift as i32);
            assert!((found / exact - 1.0).abs() < 2f64.powi(-21), "{exact} {bound}: {factor} {shift}");
            assert!(factor < 1 << 31 && factor.checked_mul(bound).unwrap() <= 1 << 62);
        }
    }
    assert_eq!(ratio(1e-300, 1 << 20), (0, 62));
}
