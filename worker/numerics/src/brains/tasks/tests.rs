//! Labels of known forces, leave-one-out errors, and their gradients on synthetic signals.

use super::*;
use crate::random::{Purpose, Stream};
use nalgebra::{DMatrix, DVector};

const PANELS: usize = 3;
const INSTANTS: usize = 20;

fn labeller() -> Labeller {
    Labeller { interval: 0.01, points: vec![[0.0, 5.0], [15.0, 5.0], [30.0, 5.0]] }
}

/// Pulses of three instants, one per struck panel: (panel, first instant, height).
fn forces(pulses: &[(usize, usize, f64)]) -> Vec<f64> {
    let mut forces = vec![0.0; INSTANTS * PANELS];
    for &(panel, first, height) in pulses {
        (first..first + 3).for_each(|n| forces[n * PANELS + panel] = height);
    }
    forces
}

#[test]
fn labels_are_what_the_forces_say() {
    let two = forces(&[(2, 4, 0.5), (0, 9, -2.0)]);
    let label = |task: SensingTask| labeller().label(task, &two, 1);
    assert_eq!(label(SensingTask::Panel), [0.0]);
    assert_eq!(label(SensingTask::Count), [2.0]);
    assert_eq!(label(SensingTask::Peak), [2.0, 0.0, 0.5]);
    let impulse = label(SensingTask::Impulse);
    assert!((impulse[0] - 60.0).abs() < 1e-9 && impulse[1] == 0.0 && (impulse[2] - 15.0).abs() < 1e-9);
    // a fifth of the impulse acts 30 mm from the rest
    let position = label(SensingTask::Position);
    assert!((position[0] - 6.0).abs() < 1e-9 && (position[1] - 5.0).abs() < 1e-9, "{position:?}");
    assert_eq!(label(SensingTask::Kind), [1.0]);
    // Instants are numbered from 1.
    assert!((label(SensingTask::Onset)[0] - 50.0).abs() < 1e-9);

    let all = [two, forces(&[]), forces(&[(2, 4, 0.5), (0, 11, -2.0)])].concat();
    let varied = |forces: &[f64], parts: &[usize]| labeller().varied(forces, parts, INSTANTS);
    assert_eq!(
        varied(&all, &[0, 1, 0]),
        [],
        "the first blow has the same instant, and the second sample no force"
    );
    let all = [all, forces(&[(1, 4, 1.0), (2, 6, 0.5)])].concat();
    assert_eq!(
        varied(&all, &[0; 4]),
        [SensingTask::Panel, SensingTask::Position, SensingTask::Peak, SensingTask::Impulse]
    );
    assert_eq!(varied(&all, &[0, 0, 0, 1]).last(), Some(&SensingTask::Kind));
}

/// Signals (14, 9) and labels of two tasks that depend on them and on noise.
fn records() -> (Vec<f64>, [(SensingTask, Labels); 2]) {
    let mut stream = Stream::new(Purpose::Stimulus, 3, [0, 0]);
    let x: Vec<f64> = (0..14 * 9).map(|_| 2.0 + stream.normal()).collect();
    let mut label = |x: &[f64]| vec![x[0] - x[3] + 0.3 * stream.normal(), x[1] + 0.3 * stream.normal()];
    let peaks: Labels = x.chunks_exact(9).map(&mut label).collect();
    let panels = peaks.iter().map(|peaks| vec![f64::from(peaks[0] > 0.0)]).collect();
    (x, [(SensingTask::Peak, peaks), (SensingTask::Panel, panels)])
}

/// The residual of a record is its error by a fit to all others with the same λ.
#[test]
fn residuals_are_those_of_records_left_out() {
    let (x, tasks) = records();
    let readout = Readout::new(&x, &tasks);
    let output = &readout.fits[0].outputs[1];
    let y: Vec<f64> = tasks[0].1.iter().map(|label| label[1]).collect();
    let (x, n) = (DMatrix::from_row_slice(14, 9, &x), 14);
    let centred = |x: &DMatrix<f64>, mean: &nalgebra::RowDVector<f64>| {
        DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| x[(i, j)] - mean[j])
    };
    let ridge = output.share * centred(&x, &x.row_mean()).norm_squared() / f64::from(n);
    for left_out in 0..14 {
        let others = x.clone().remove_row(left_out);
        let known = DVector::from_iterator(13, (0..14).filter(|&i| i != left_out).map(|i| y[i]));
        let mean = others.row_mean();
        let z = centred(&others, &mean);
        let normal = z.tr_mul(&z) + DMatrix::identity(9, 9) * ridge;
        let w = normal.lu().solve(&z.tr_mul(&known.add_scalar(-known.mean()))).unwrap();
        let said = known.mean() + ((x.row(left_out) - mean) * w)[0];
        let (found, wanted) = (output.residuals[left_out], said - y[left_out]);
        assert!((found.abs() - wanted.abs()).abs() < 1e-9, "{left_out}: {found} {wanted}");
    }
}

/// Records of two classes with known probabilities: the probabilities of a readout are nearly as good, and calibrated. A class that
/// no training record has, and classes without error, have a finite loss.
#[test]
fn probabilities_of_classes_are_calibrated() {
    let mut stream = Stream::new(Purpose::Stimulus, 4, [0, 0]);
    let mut records = |n: usize, slope: f64| {
        let x: Vec<f64> = (0..3 * n).map(|_| stream.normal()).collect();
        let of = |x: &[f64]| 1.0 / (1.0 + (-slope * x[0]).exp());
        let truth: Vec<f64> = x.chunks_exact(3).map(of).collect();
        let labels: Labels = truth.iter().map(|p| vec![f64::from(u8::from(stream.uniform() < *p))]).collect();
        let log = |(p, label): (&f64, &Vec<f64>)| -if label[0] == 1.0 { *p } else { 1.0 - p }.ln();
        let best = truth.iter().zip(&labels).map(log).sum::<f64>() / n as f64;
        (x, labels, best)
    };
    let mut read = |slope: f64| {
        let ((x, known, _), (tests, truth, best)) = (records(400, slope), records(2000, slope));
        let tasks = [(SensingTask::Panel, known)];
        let readout = Readout::new(&x, &tasks);
        let of = |truth: Labels| readout.calibrations(&tasks, &tests, &[truth])[0].clone().unwrap();
        (of(truth.clone()), of(vec![vec![7.0]; truth.len()]), best)
    };
    let (found, unknown, best) = read(2.0);
    assert!(best > 0.3 && (found.log_loss - best).abs() < 0.05 && found.error < 6.0, "{best} {found:?}");
    assert_eq!(found.bins.iter().map(|bin| bin[2]).sum::<f64>(), 2000.0);
    assert!(found.bins.iter().all(|bin| bin[0] >= 0.5), "the greatest of two");
    assert!((unknown.log_loss - 402f64.ln()).abs() < 1e-9 && unknown.error > 50.0, "{unknown:?}");
    let (certain, _, _) = read(1e9);
    assert!(certain.log_loss > 0.0 && certain.log_loss < best, "{certain:?}");
}

/// L(x + εδ) = L(x) + ε g·δ + O(ε²), for one task and for several; a common factor on the signals changes nothing.
#[test]
fn the_gradient_of_the_loss_is_exact() {
    let (x, tasks) = records();
    let mut stream = Stream::new(Purpose::Design, 1, [0, 0]);
    let direction: Vec<f64> = x.iter().map(|_| stream.normal()).collect();
    for tasks in [&tasks[..1], &tasks[1..], &tasks] {
        let at = |step: f64| {
            let x: Vec<f64> = x.iter().zip(&direction).map(|(x, d)| x + step * d).collect();
            Readout::new(&x, tasks)
        };
        let (start, steps) = (at(0.0), [4e-3, 2e-3, 1e-3]);
        let gradient = start.loss_vjp();
        let slope: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let remainders = steps.map(|step| (at(step).loss() - start.loss() - step * slope).abs());
        let orders = [0, 1].map(|i| (remainders[i] / remainders[i + 1]).log2());
        assert!(orders.iter().all(|order| (1.8..2.2).contains(order)), "{slope:e} {orders:?} {remainders:?}");
        assert!(slope.abs() > 1e-3 && start.loss() > 0.01 && start.loss() < 1.0, "{slope} {}", start.loss());
        let radial: f64 = gradient.iter().zip(&x).map(|(g, x)| g * x).sum();
        assert!(radial.abs() < 1e-9, "{radial}");
    }
}
