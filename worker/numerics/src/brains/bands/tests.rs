use super::*;
use crate::brain::linear::Sizes;
use crate::random::Draw;

const SIZES: Sizes = Sizes { instants: 5, channels: 1, outputs: 2 };

/// N samples with estimates of 0: heavy-tailed errors, correlated within a sample, proportional to `shape`.
fn drawn(draw: &mut Draw, count: usize, shape: impl Fn(usize) -> f64) -> Samples {
    let one = SIZES.instants * SIZES.outputs;
    let sample = |draw: &mut Draw| {
        let own = draw.normal().exp();
        (0..one).map(|i| own * shape(i) * (draw.normal() + 0.2 * draw.normal().powi(3))).collect::<Vec<_>>()
    };
    let targets = (0..count).flat_map(|_| sample(draw)).collect();
    Samples::new(SIZES, vec![0.0; count * SIZES.instants], targets)
}

fn zeros(samples: &Samples) -> Vec<f64> {
    vec![0.0; samples.targets.len()]
}

/// Mean coverage of both kinds, with standard error, over `times` bands of `count` samples each; test errors are `factor` times
/// the calibration errors.
fn coverage(count: usize, times: u64, factor: f64) -> [[f64; 2]; 2] {
    let found: Vec<[f64; 2]> = (0..times)
        .map(|time| {
            let mut draw = Draw::numbered(7, time);
            let shape = |i: usize| 1.0 + i as f64;
            // Errors on training samples have another shape and are smaller.
            let known = drawn(&mut draw, 20, |i| 0.1 * (10 - i) as f64);
            let (calibration, unseen) =
                (drawn(&mut draw, count, shape), drawn(&mut draw, 40, |i| factor * shape(i)));
            let bands = Band::conformal((&known, &zeros(&known)), (&calibration, &zeros(&calibration)));
            bands.map(|band| band.coverage(&unseen, &zeros(&unseen), 0).unwrap())
        })
        .collect();
    [0, 1].map(|kind| {
        let n = found.len() as f64;
        let mean = found.iter().map(|c| c[kind]).sum::<f64>() / n;
        let square = found.iter().map(|c| (c[kind] - mean).powi(2)).sum::<f64>();
        [mean, square.sqrt() / n]
    })
}

/// With n exchangeable samples the coverage is rank/(n + 1) for any distribution: 95 % for n = 19 and 99, 30/31 for n = 30.
#[test]
fn bands_cover_the_next_sample_as_often_as_they_say() {
    for (count, times) in [(19, 2000), (30, 2000), (99, 1000)] {
        let truth = (0.95 * (count + 1) as f64 - 1e-9).ceil() / (count + 1) as f64;
        assert!((0.95 - 1e-12..0.97).contains(&truth));
        for [mean, deviation] in coverage(count, times, 1.0) {
            assert!(deviation < 3e-3, "{count}: {deviation}");
            assert!((mean - truth).abs() < 3.5 * deviation, "{count}: {mean} ± {deviation}, not {truth}");
        }
    }
    // The test detects errors larger than those of the calibration.
    for [mean, deviation] in coverage(99, 200, 1.5) {
        assert!(mean < 0.95 - 3.5 * deviation, "{mean} ± {deviation}");
    }
}

/// A failed test sample is not covered, a failed calibration sample has the worst score, and fewer than 19 samples give no band.
#[test]
fn what_failed_or_is_too_little_covers_nothing() {
    let mut draw = Draw::numbered(8, 0);
    let known = drawn(&mut draw, 5, |_| 1.0);
    let of =
        |calibration: &Samples| Band::conformal((&known, &zeros(&known)), (calibration, &zeros(calibration)));
    let calibration = drawn(&mut draw, 39, |_| 1.0);
    let failed = |i: usize| (0..39).map(|n| n < i).collect::<Vec<_>>();
    let [all, one] = [0, 1].map(|i| of(&calibration.clone().with_failed(failed(i))));
    for (all, one) in all.iter().zip(&one) {
        assert!(one.half_width.iter().zip(&all.half_width).all(|(one, all)| one >= all));
        assert!(one.width() > all.width());
        let inside = Samples::new(SIZES, vec![0.0; 10], vec![0.0; 20]);
        assert_eq!(all.coverage(&inside, &zeros(&inside), 0), Some(1.0));
        let inside = inside.with_failed(vec![true, false]);
        assert_eq!(all.coverage(&inside, &zeros(&inside), 0), Some(0.5));
        assert_eq!(all.coverage(&inside, &zeros(&inside), 1), Some(1.0));
        assert_eq!(all.coverage(&inside, &zeros(&inside), 2), None);
    }
    for band in of(&calibration.select(&(0..18).collect::<Vec<_>>()))
        .iter()
        .chain(&of(&calibration.clone().with_failed(failed(3))))
    {
        assert_eq!((band.half_width.len(), band.width()), (0, None));
        assert_eq!(band.coverage(&calibration, &zeros(&calibration), 0), None);
    }
}
