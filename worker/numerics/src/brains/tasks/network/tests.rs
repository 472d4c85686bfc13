//! Gradient, and labels that no linear readout can estimate.

use super::*;

fn stream() -> Stream {
    Stream::new(Purpose::Stimulus, 6, [0, 0])
}

/// L(w + εδ) = L(w) + ε g·δ + O(ε²), for values and classes.
#[test]
fn the_gradient_is_exact() {
    let mut stream = stream();
    let x = DMatrix::from_fn(7, 3, |_, _| stream.normal());
    for is_class in [false, true] {
        let y = DMatrix::from_fn(7, 2, |i, k| f64::from(u8::from(i % 2 == k)));
        let weights: Vec<f64> = (0..length(3, 2)).map(|_| 0.5 * stream.normal()).collect();
        let direction: Vec<f64> = weights.iter().map(|_| stream.normal()).collect();
        let at = |step: f64| {
            let moved: Vec<f64> = weights.iter().zip(&direction).map(|(w, d)| w + step * d).collect();
            loss(&moved, &x, &y, is_class)
        };
        let (start, gradient) = at(0.0);
        let slope: f64 = gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let remainders = [4e-3, 2e-3, 1e-3].map(|step| (at(step).0 - start - step * slope).abs());
        let orders = [0, 1].map(|i| (remainders[i] / remainders[i + 1]).log2());
        assert!(
            orders.iter().all(|order| (1.8..2.2).contains(order)),
            "{is_class}: {orders:?} {remainders:?}"
        );
    }
}

/// Products of signals, as values and as classes, which a linear readout cannot estimate. The same seed gives the same bits.
#[test]
fn products_of_signals_are_estimated() {
    let mut stream = stream();
    let mut records = |n: usize| {
        let x: Vec<f64> = (0..2 * n).map(|_| stream.normal()).collect();
        let products: Vec<f64> = x.chunks_exact(2).map(|x| x[0] * x[1]).collect();
        (x, products)
    };
    let ((x, known), (tests, truth)) = (records(300), records(200));
    let values: Labels = known.iter().map(|p| vec![5.0 + 0.1 * p]).collect();
    let network = Network::new(1, SensingTask::Peak, &x, &values);
    let squares =
        network.outputs(&tests).iter().zip(&truth).map(|(o, p)| (o - 5.0 - 0.1 * p).powi(2)).sum::<f64>();
    let share = squares / truth.iter().map(|p| (0.1 * p).powi(2)).sum::<f64>();
    assert!(share < 0.1, "{share}");
    assert_eq!(network.outputs(&tests), Network::new(1, SensingTask::Peak, &x, &values).outputs(&tests));

    let signs: Labels = known.iter().map(|p| vec![if *p > 0.0 { 3.0 } else { 1.0 }]).collect();
    let network = Network::new(1, SensingTask::Panel, &x, &signs);
    let right =
        network.outputs(&tests).row_iter().zip(&truth).filter(|(o, p)| (o[1] > o[0]) == (**p > 0.0)).count();
    assert!(right > 180 && network.classes == [1.0, 3.0], "{right} of 200");
}
