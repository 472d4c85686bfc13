use super::*;
use std::f64::consts::TAU;

/// A sine of 20 Hz passes a clock of 200 Hz, one of 170 Hz, which would come back as 30 Hz, does not.
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

/// A blow of 0.3 ms between instants: read linearly it is lost or overstated, anti-aliased its impulse stays.
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

/// Ends, outside and rounding.
#[test]
fn a_record_is_linear_inside_and_zero_outside() {
    let read = resample(&[1.0, 3.0, 5.0], 0.25, 0.25, 1.0, 8);
    assert_eq!(read, [0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 0.0, 0.0]);
    assert_eq!(resample(&[], 0.0, 0.1, 1.0, 2), [0.0; 3]);
}
