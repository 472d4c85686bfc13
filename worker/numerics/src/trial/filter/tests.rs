use super::*;
use crate::random::{Purpose, Stream};
use std::f64::consts::TAU;

/// Readings per second.
const RATE: f64 = 200.0;

fn filter(bandwidth: f64, delay: f64) -> Filter {
    Filter::new(&ChipErrors { bandwidth, delay, ..ChipErrors::NONE }, RATE.recip())
}

/// Amplitude and phase (rad) of the readings of sin(2πft), over the last of many whole periods.
fn response(filter: &Filter, f: f64) -> (f64, f64) {
    let (fine, readings) = (RATE * filter.clock as f64, 2000);
    let wave = (1..=readings * filter.clock).map(|m| (TAU * f * m as f64 / fine).sin());
    let read = filter.run(wave.collect(), 1, 1);
    let last = 1000; // whole periods of multiples of 0.2 Hz
    let part = |of: fn(f64) -> f64| -> f64 {
        let at = |n: usize| read[n - 1] * of(TAU * f * n as f64 / RATE);
        2.0 / last as f64 * (readings - last + 1..=readings).map(at).sum::<f64>()
    };
    let (sine, cosine) = (part(f64::sin), part(f64::cos));
    (sine.hypot(cosine), cosine.atan2(sine))
}

/// 1/(1 − x² + i√2 x), x = f/bandwidth: gain within 0.004, phase within 1e-3.
#[test]
fn the_low_pass_is_butterworths() {
    for bandwidth in [20.0, 42.0, 98.0, 188.0] {
        let filter = filter(bandwidth, 0.0);
        for f in [1.0, 10.0, 25.0, 42.0, 80.0, 94.0] {
            let (gain, phase) = response(&filter, f);
            let x = f / bandwidth;
            let (re, im) = (1.0 - x * x, 2f64.sqrt() * x);
            let off = [gain - re.hypot(im).recip(), (phase + im.atan2(re)).sin()];
            assert!(off[0].abs() < 4e-3 && off[1].abs() < 1e-3, "{bandwidth} Hz at {f} Hz: {off:?}");
            let passes = ChipErrors { bandwidth, delay: 2e-3, ..ChipErrors::NONE }.passes(f);
            let (gain, phase) = response(&self::filter(bandwidth, 2e-3), f);
            assert!((passes - c64::cis(phase) * gain).norm() < 5e-3, "{bandwidth} Hz at {f} Hz: {passes}");
        }
    }
}

/// A delay shifts a sine at 0.8 of the readings' Nyquist frequency without changing its amplitude, within 1e-3.
#[test]
fn a_delay_is_one_at_high_frequencies_too() {
    let f = 0.8 * RATE / 2.0;
    for delay in [0.0001, 0.0003, 0.000_625, 0.0009, 0.0025, 0.0123] {
        let (gain, phase) = response(&filter(f64::INFINITY, delay), f);
        let off = (phase + TAU * f * delay).sin();
        assert!((gain - 1.0).abs() < 1e-3 && off.abs() < 1e-3, "{delay} s: {gain} {off}");
    }
}

/// Delays of whole clock instants are exact to the bit; readings before the first instant are 0.
#[test]
fn a_delay_of_whole_instants_moves_the_readings() {
    let filter = filter(f64::INFINITY, 3.0 / 1600.0);
    let signals: Vec<f64> = (1..=2 * 4 * 8).map(f64::from).collect();
    assert_eq!(filter.run(signals, 2, 1), [5.0, 13.0, 21.0, 29.0, 37.0, 45.0, 53.0, 61.0]);
    let long = super::Filter::new(&ChipErrors { delay: 0.02, ..ChipErrors::NONE }, RATE.recip());
    assert_eq!(long.run(vec![1.0; 5 * 8], 1, 1), [0.0, 0.0, 0.0, 0.0, 1.0]);
}

/// (F a)·c = a·(Fᵀ c) for low-passes, delays and both, with several channels and samples.
#[test]
fn the_filter_and_its_pull_back_are_transposes() {
    for (bandwidth, delay) in
        [(42.0, 0.0), (f64::INFINITY, 0.0001), (f64::INFINITY, 0.0071), (188.0, 0.0123), (20.0, 0.2)]
    {
        let filter = filter(bandwidth, delay);
        let (samples, readings, width) = (2, 6, 3);
        let mut stream = Stream::new(Purpose::Design, 3, [0, 0]);
        let mut draw = |count: usize| -> Vec<f64> { (0..count).map(|_| stream.normal()).collect() };
        let (a, c) = (draw(samples * readings * filter.clock * width), draw(samples * readings * width));
        let read = filter.run(a.clone(), samples, width);
        let back = filter.run_vjp(&c, samples, width);
        let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        let (left, right) = (dot(&read, &c), dot(&a, &back));
        assert!((left - right).abs() < 1e-12 * (1.0 + left.abs()), "{bandwidth} {delay}: {left} {right}");
        assert_eq!((read.len(), back.len()), (c.len(), a.len()));
    }
}

/// ∫ = h²/2 (1 − √2 h/3 + …) and h²/6 (1 − √2 h/4 + …) for small h = ωΔ, also where the closed form would cancel.
#[test]
fn a_slow_low_pass_integrates_twice() {
    for angle in [1e-9, 1e-6, 9.99e-4, 1.001e-3] {
        let LowPass { g: [early, late], .. } = LowPass::new(angle);
        let found = [early[0] + late[0], late[0]].map(|part| part / (angle * angle));
        let slope = 2f64.sqrt() * angle;
        let expected = [0.5 * (1.0 - slope / 3.0), (1.0 - slope / 4.0) / 6.0];
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{angle}: {found} {expected}");
        }
    }
}
