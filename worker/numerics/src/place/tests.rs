use super::*;
use crate::random::{Purpose, Stream};
use nalgebra::{DMatrix, DVector};

fn draw(seed: u64, n: usize) -> Vec<f64> {
    let mut stream = Stream::new(Purpose::Design, seed, [9, 0]);
    (0..n).map(|_| stream.normal()).collect()
}

/// The error equals that of a direct solution in the time domain, per lag on the circle of 2T instants.
#[test]
fn errors_are_those_of_least_squares_over_lags() {
    let (instants, samples, folds, ridge) = (4, 9, 3, 0.02);
    let sizes = Sizes { instants, channels: 6, outputs: 2 };
    let x = draw(1, samples * instants * 6);
    let f = draw(2, samples * instants * 2);
    let w: Vec<f64> = draw(3, samples).iter().map(|w| w * w + 0.2).collect();
    let dealt: Vec<usize> = (0..samples).map(|i| (i * 2) % folds).collect();
    let chosen = [1, 3, 4, 5];
    let around = 2 * instants;
    let at = |values: &[f64], width: usize, i: usize, t: usize, c: usize| {
        if t < instants { values[(i * instants + t) * width + c] } else { 0.0 }
    };
    let rows = |fold: usize, inside: bool| {
        let own = (0..samples).filter(|&i| (dealt[i] == fold) == inside);
        own.flat_map(|i| (0..around).map(move |t| (i, t))).collect::<Vec<_>>()
    };
    let power = |rows: &[(usize, usize)]| -> f64 {
        rows.iter()
            .flat_map(|&(i, t)| (0..2).map(move |k| (i, t, k)))
            .map(|(i, t, k)| w[i] * at(&f, 2, i, t, k).powi(2))
            .sum()
    };
    let row = |&(i, t): &(usize, usize)| -> Vec<f64> {
        let lags = chosen.iter().flat_map(|&c| (0..around).map(move |l| (c, l)));
        lags.map(|(c, l)| w[i].sqrt() * at(&x, 6, i, (t + around - l) % around, c)).collect()
    };
    let (mut wrong, mut all) = (0.0, 0.0);
    for fold in 0..folds {
        let (known, unseen) = (rows(fold, false), rows(fold, true));
        let matrix = |rows: &[(usize, usize)]| {
            let values: Vec<f64> = rows.iter().flat_map(row).collect();
            DMatrix::from_row_slice(rows.len(), chosen.len() * around, &values)
        };
        let (a, b) = (matrix(&known), matrix(&unseen));
        let scale = power(&known).recip();
        let normal: DMatrix<f64> = scale * a.tr_mul(&a) + ridge * DMatrix::identity(a.ncols(), a.ncols());
        for k in 0..2 {
            let force = |rows: &[(usize, usize)]| {
                DVector::from_iterator(
                    rows.len(),
                    rows.iter().map(|&(i, t)| w[i].sqrt() * at(&f, 2, i, t, k)),
                )
            };
            let weights = normal.clone().cholesky().unwrap().solve(&(scale * a.tr_mul(&force(&known))));
            wrong += (&b * weights - force(&unseen)).norm_squared();
        }
        all += power(&unseen);
    }
    let found = Spectra::new(sizes, [&x, &f, &w], &dealt, &crate::Pool::new(1).unwrap())
        .error(&chosen, ridge)
        .unwrap();
    assert!((found / (100.0 * wrong / all) - 1.0).abs() < 1e-10, "{found} {}", 100.0 * wrong / all);
}

const UNITS: [usize; 6] = [2, 3, 5, 7, 8, 9];
const INSTANTS: usize = 12;
const SAMPLES: usize = 40;

/// Units 5 and 8 contain the two forces, delayed; unit 3 the first force with noise; the others loud noise.
fn signals() -> [Vec<f64>; 3] {
    let f = draw(4, SAMPLES * INSTANTS * 2);
    let mut x: Vec<f64> = draw(5, SAMPLES * INSTANTS * 18).into_iter().map(|x| 3.0 * x).collect();
    for i in 0..SAMPLES {
        for t in 0..INSTANTS {
            let force = |k: usize| if t > 0 { f[(i * INSTANTS + t - 1) * 2 + k] } else { 0.0 };
            let row = &mut x[(i * INSTANTS + t) * 18..][..18];
            for c in 0..3 {
                row[6 + c] = force(0) + 0.02 * row[6 + c];
                row[12 + c] = force(1) + 0.02 * row[12 + c];
                row[3 + c] = force(0) + 0.3 * row[3 + c];
            }
        }
    }
    [x, f, vec![1.0; SAMPLES]]
}

fn searched(sensors: usize, turn: usize, spacing: f64) -> Result<Placed, NoPlacement> {
    let layout = Layout::planar(4, 3, 10.0, 1.5);
    let [x, f, w] = signals();
    let dealt: Vec<usize> = (0..SAMPLES).map(|i| i % 4).collect();
    let pool = crate::Pool::new(2).unwrap();
    let sizes = Sizes { instants: INSTANTS, channels: 18, outputs: 2 };
    let scores = Scores::new(&layout, UNITS.to_vec(), sizes, [&x, &f, &w], &dealt, false, &pool);
    let search = Placing { candidates: UNITS.to_vec(), sensors, turn, spacing };
    let placed = scores.search(&search)?;
    if turn == 0 {
        // No exchange of one unit is better.
        let own = *placed.errors.last().unwrap();
        for i in 0..sensors {
            for &unit in &UNITS {
                let mut set = placed.units.clone();
                set[i] = unit;
                let far = |a: usize, b: usize| {
                    let [p, q] = [a, b].map(|unit| layout.centres[unit]);
                    (p[0] - q[0]).hypot(p[1] - q[1]) > spacing - 1e-9
                };
                if (0..i).chain(i + 1..sensors).all(|j| set[j] != unit && far(set[j], unit)) {
                    assert!(scores.error(&set, placed.ridge) >= own * (1.0 - 1e-12), "{set:?} {placed:?}");
                }
            }
        }
    }
    Ok(placed)
}

/// If forces depend on the energy of a signal only, a decoder with energies succeeds, and one without fails.
#[test]
fn energies_tell_what_no_linear_part_does() {
    let (instants, samples) = (8, 60);
    let layout = Layout::planar(2, 2, 10.0, 1.5);
    let x: Vec<f64> = draw(8, samples * instants * 3);
    let f: Vec<f64> = x.chunks_exact(3).map(|x| x.iter().map(|x| x * x).sum::<f64>() - 3.0).collect();
    let dealt: Vec<usize> = (0..samples).map(|i| i % 4).collect();
    let pool = crate::Pool::new(1).unwrap();
    let sizes = Sizes { instants, channels: 3, outputs: 1 };
    let [blind, seeing] = [false, true].map(|energies| {
        Scores::new(&layout, vec![2], sizes, [&x, &f, &vec![1.0; samples]], &dealt, energies, &pool).of_all()
    });
    assert!(blind > 90.0 && seeing < 5.0, "{blind} {seeing}");
}

/// The search finds the two units that contain the forces, for any number of sensors.
#[test]
fn the_units_that_carry_the_forces_are_found() {
    let two = searched(2, 0, 0.0).unwrap();
    let mut units = two.units.clone();
    units.sort_unstable();
    assert!(units == [5, 8] && two.errors[1] < 10.0 && two.errors[0] > 40.0, "{two:?}");
    assert!(two.runner_up.as_ref().is_some_and(|next| next.1 > two.errors[1]), "{two:?}");
    let three = searched(3, 0, 0.0).unwrap();
    assert!(three.units.contains(&5) && three.units.contains(&8), "{three:?}");
}

/// Units 5 and 8 are 14.1 mm apart (cells of 10 mm). A larger minimum distance selects another unit, or no placement exists.
#[test]
fn sensors_keep_their_distance_and_turns_differ() {
    let apart = searched(2, 0, 15.0).unwrap();
    assert!(!(apart.units.contains(&5) && apart.units.contains(&8)), "{apart:?}");
    assert_eq!(searched(3, 0, 100.0), Err(NoPlacement));
    assert_eq!(searched(7, 0, 0.0), Err(NoPlacement));
    let first: Vec<usize> = (0..6).map(|turn| searched(1, turn, 0.0).unwrap().units[0]).collect();
    let mut sorted = first.clone();
    sorted.sort_unstable();
    assert!(sorted == UNITS && [5, 8].contains(&first[0]), "{first:?}");
    let third = searched(2, 2, 0.0).unwrap();
    assert_eq!(third.units[0], first[2]);
}
