use super::*;

const SIZE: ChipErrors =
    ChipErrors { noise: Size::Relative(0.1), bias: Size::Physical([3.0, 0.2]), ..ChipErrors::NONE };

const ALL: [usize; 3] = [0, 1, 2];

fn forces(samples: usize) -> Forces {
    let values = (0..samples * 5).map(|i| i as f64 * 0.37).collect();
    Forces { samples, panels: 1, instants: 4, values, strikes: Vec::new() }
}

/// Noise and bias have the given sizes; the draw of a sample does not depend on its position.
#[test]
fn noise_and_bias_have_their_sizes_and_follow_the_sample() {
    let chip = Chip::new(&SIZE, 7, &[10.0, 20.0, 1.0], &ALL);
    let all = forces(40);
    let mut signals = vec![0.0; 40 * 500 * 3];
    chip.disturb(&mut signals, &all);
    for (c, (noise, bias)) in [(1.0, 3.0), (2.0, 3.0), (0.1, 0.2)].into_iter().enumerate() {
        let of_samples: Vec<(f64, f64)> = signals
            .chunks_exact(1500)
            .map(|sample| {
                let x: Vec<f64> = sample[c..].iter().step_by(3).copied().collect();
                let mean = x.iter().sum::<f64>() / 500.0;
                (mean, x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 499.0)
            })
            .collect();
        let found = (of_samples.iter().map(|s| s.1).sum::<f64>() / 40.0).sqrt() / noise;
        let spread = (of_samples.iter().map(|s| s.0 * s.0).sum::<f64>() / 40.0).sqrt() / bias;
        assert!((found - 1.0).abs() < 0.03 && (spread - 1.0).abs() < 0.5, "{c}: {found} {spread}");
    }
    let last = all.select(&[39]);
    let mut alone = vec![0.0; 500 * 3];
    chip.disturb(&mut alone, &last);
    assert_eq!(alone, signals[39 * 1500..]);
}

/// Accelerations are rounded to 0.5 and limited to ±4, angular velocities to 0.1 and ±1; limited readings have no gradient.
#[test]
fn readings_come_in_steps_and_end_with_the_range() {
    let sizes = ChipErrors { range: [4.0, 1.0], resolution: [0.5, 0.1], ..ChipErrors::NONE };
    let chip = Chip::new(&sizes, 1, &[1.0; 3], &ALL);
    let mut signals = [0.2, 0.3, 0.04, -5.0, 3.9, 0.96, 0.0, -3.6, -2.0, 1.26, 9.0, 0.5];
    chip.disturb(&mut signals, &forces(1));
    let says = [0.0, 0.5, 0.0, -4.0, 4.0, 1.0, 0.0, -3.5, -1.0, 1.5, 4.0, 0.5];
    assert!(signals.iter().zip(says).all(|(a, b)| (a - b).abs() < 1e-12), "{signals:?}");
    let mut cotangent = [1.0; 12];
    chip.disturb_vjp(&mut cotangent, &signals);
    let passes = says.iter().enumerate().map(|(i, x): (usize, &f64)| x.abs() < [4.0, 4.0, 1.0][i % 3]);
    assert!(cotangent.iter().zip(passes).all(|(c, passes)| (*c > 0.0) == passes), "{cotangent:?}");
}

/// Readings of a channel do not depend on which other channels exist.
#[test]
fn a_channel_that_is_read_alone_is_disturbed_alike() {
    let sizes = ChipErrors { range: [5.0, 0.3], resolution: [0.5, 0.1], ..SIZE };
    let mut stream = Stream::new(Purpose::Design, 3, [0, 0]);
    let signals: Vec<f64> = (0..2 * 4 * 6).map(|_| stream.normal()).collect();
    let rms = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    let mut all = signals.clone();
    Chip::new(&sizes, 7, &rms, &ALL).disturb(&mut all, &forces(2));
    for read in [&[0, 1][..], &[2], &[0, 2]] {
        let of = |all: &[f64]| -> Vec<f64> {
            all.chunks_exact(3).flat_map(|all| read.iter().map(|&c| all[c])).collect()
        };
        let mut some = of(&signals);
        Chip::new(&sizes, 7, &of(&rms), read).disturb(&mut some, &forces(2));
        assert_eq!(some, of(&all), "{read:?}");
    }
}
