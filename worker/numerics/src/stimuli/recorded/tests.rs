use super::*;
use std::f64::consts::TAU;

/// A clock of 200 Hz keeps a sine of 20 Hz and removes one of 170 Hz, which would alias to 30 Hz.
#[test]
fn what_a_clock_cannot_say_is_taken_out() {
    let dt = 1.0 / 25_600.0;
    let tone =
        |hertz: f64| -> Vec<f64> { (0..25_601).map(|i| (TAU * hertz * i as f64 * dt).sin()).collect() };
    let size = |v: &[f64]| v[40..160].iter().map(|x| x * x).sum::<f64>().sqrt();
    let read = |hertz: f64| anti_aliased(&tone(hertz), 0.0, dt, 1.0, 200);
    let plain = resample(&tone(20.0), 0.0, dt, 1.0, 200);
    let kept: Vec<f64> = read(20.0).iter().zip(&plain).map(|(a, b)| a - b).collect();
    assert!(size(&kept) < 1e-3 * size(&plain), "{}", size(&kept) / size(&plain));
    let left = size(&read(170.0)) / size(&plain);
    let aliased = size(&resample(&tone(170.0), 0.0, dt, 1.0, 200)) / size(&plain);
    assert!(left < 1e-3 && aliased > 0.5, "{left} {aliased}");
}

/// A blow of 0.3 ms between instants: linear interpolation loses or exaggerates it, the low-pass keeps its impulse.
#[test]
fn the_impulse_of_a_short_blow_stays() {
    let dt = 1.0 / 25_600.0;
    let blow = |t: f64| {
        if (0.1020..0.1023).contains(&t) { 80.0 * (TAU * (t - 0.102) / 6e-4).sin() } else { 0.0 }
    };
    let record: Vec<f64> = (0..25_601).map(|i| blow(i as f64 * dt)).collect();
    let impulse = record.iter().sum::<f64>() * dt;
    let sum = |v: Vec<f64>| v.iter().sum::<f64>() / 200.0;
    let kept = sum(anti_aliased(&record, 0.0, dt, 1.0, 200)) / impulse;
    assert!((kept - 1.0).abs() < 1e-3, "{kept}");
    assert!((sum(resample(&record, 0.0, dt, 1.0, 200)) / impulse - 1.0).abs() > 0.5);
}

/// A blow of 1 or 3 ms at the start or end of a sample: the targets contain its whole impulse, for any clock of the forces.
#[test]
fn the_impulse_of_a_blow_at_either_end_stays() {
    let dt = 1.0 / 25_600.0;
    for (onset, width) in [(0.0, 1e-3), (0.0, 3e-3), (0.004, 1e-3), (0.996, 3e-3)] {
        let blow = |t: f64| if t > 0.0 && t < width { (TAU * t / (2.0 * width)).sin() } else { 0.0 };
        // From half a second before the sample to half a second after it.
        let record: Vec<f64> = (-12_800..38_400).map(|i| blow(f64::from(i) * dt - onset)).collect();
        let impulse = record.iter().sum::<f64>() * dt;
        for instants in [200, 800] {
            let values = anti_aliased_force(&record, -0.5, dt, 1.0, instants);
            let ends = 0.5 * (values[0] + values[instants]);
            let simulated = (values.iter().sum::<f64>() - ends) / instants as f64;
            let forces = Forces { samples: 1, panels: 1, instants, values, strikes: Vec::new() };
            let told = crate::stimuli::targets(&forces, 200, true);
            let told = (told.iter().sum::<f64>() - 0.5 * told[199]) / 200.0;
            for (what, kept) in [("simulated", simulated / impulse), ("told", told / impulse)] {
                assert!((kept - 1.0).abs() < 1e-2, "{what}: {kept} of {width} s at {onset} s by {instants}");
            }
        }
    }
}

/// A force that continues beyond both ends stays unchanged there.
#[test]
fn a_force_that_goes_on_is_left_as_it_is() {
    let dt = 1.0 / 25_600.0;
    let force = |t: f64| 2.0 + (TAU * 0.5 * (t - 0.3)).cos();
    let record: Vec<f64> = (-12_800..38_400).map(|i| force(f64::from(i) * dt)).collect();
    for instants in [200, 800] {
        let values = anti_aliased_force(&record, -0.5, dt, 1.0, instants);
        let off = |(n, f): (usize, &f64)| (f - force(n as f64 / instants as f64)).abs();
        let most = values.iter().enumerate().map(off).fold(0.0, f64::max);
        assert!(most < 0.02, "{most} by {instants}");
        let forces = Forces { samples: 1, panels: 1, instants, values, strikes: Vec::new() };
        let told = crate::stimuli::targets(&forces, 200, true);
        let off = |(n, f): (usize, &f64)| (f - force((n + 1) as f64 / 200.0)).abs();
        let most = told.iter().enumerate().map(off).fold(0.0, f64::max);
        assert!(most < 0.02, "{most} of targets by {instants}");
    }
}

/// At both ends, outside, and at positions with rounding error.
#[test]
fn a_record_is_linear_inside_and_zero_outside() {
    let read = resample(&[1.0, 3.0, 5.0], 0.25, 0.25, 1.0, 8);
    assert_eq!(read, [0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 0.0, 0.0]);
    assert_eq!(resample(&[], 0.0, 0.1, 1.0, 2), [0.0; 3]);
}
