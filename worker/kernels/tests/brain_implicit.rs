//! The implicit term, compared with the derivative through every step of a training.

use metasense_kernels::brain::*;
use metasense_kernels::random::{Purpose, Stream};

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The reverse sweep through all steps of gradient descent and −∂²L/∂x∂β (H + ρI)⁻¹ ∂L_test/∂β give the same dL_test/dx_train. The
/// ridge ρ/2 |β − β₀|² makes the optimum unique. Small weights and biases of ±2 keep units away from the kinks of ReLU, near which
/// gradient descent would not converge.
#[test]
fn the_implicit_term_is_the_derivative_through_a_training_to_the_optimum() {
    let shape = Shape { instants: 12, inputs: 3, outputs: 2, architecture: Architecture::paper(8) };
    let (ridge, rate, steps) = (1.0, 0.006, 3600);
    let mut stream = Stream::new(Purpose::Batch, 5, [0, 0]);
    let mut sample = |n: usize| {
        let x: Vec<f64> = (0..n * shape.instants * shape.inputs).map(|_| 0.3 * stream.normal()).collect();
        let y = (0..n * shape.instants * 2)
            .map(|i| x[i / 2 * 3] - 0.7 * x[i / 2 * 3 + 1 + i % 2])
            .collect::<Vec<f64>>();
        Data::new(shape, &x, &y)
    };
    let (train, test) = (sample(4), sample(3));
    let pool = metasense_kernels::Pool::new(1).expect("threads");
    let ws = &mut Workspace::new(shape, pool.width());

    // training; every iterate is stored
    let mut gradient = vec![0.0; shape.weights()];
    let mut fresh: Vec<f64> = initial_weights(shape, 2, 0).iter().map(|w| 0.3 * w).collect();
    fresh[..2 * shape.architecture.width()]
        .iter_mut()
        .enumerate()
        .for_each(|(i, b)| *b = if i % 4 == 3 { -2.0 } else { 2.0 });
    let mut path = vec![fresh];
    for i in 0..steps {
        loss_gradient(&path[i], train.all(), &mut gradient, ws, &pool);
        gradient.iter_mut().zip(path[i].iter().zip(&path[0])).for_each(|(g, (w, w0))| *g += ridge * (w - w0));
        path.push(path[i].iter().zip(&gradient).map(|(w, g)| w - rate * g).collect());
    }
    let (optimum, left) = (&path[steps], dot(&gradient, &gradient).sqrt());
    assert!(left < 1e-9, "gradient left: {left:e}");
    let mut b = vec![0.0; shape.weights()];
    let loss_test = loss_gradient(optimum, test.all(), &mut b, ws, &pool);

    // reverse sweep: λ ← λ − rate (H + ρ) λ; each step contributes −rate ∂²L/∂x∂β λ
    let (mut lambda, mut h) = (b.clone(), vec![0.0; shape.weights()]);
    let mut unrolled = vec![0.0; train.all().len() * shape.instants * shape.inputs];
    for weights in path[..steps].iter().rev() {
        let curvature = Curvature::new(weights, train.all(), ws, &pool);
        let share = curvature.mixed_product(&lambda, ws, &pool);
        unrolled.iter_mut().zip(share).for_each(|(sum, s)| *sum -= rate * s);
        curvature.product(&lambda, &mut h, ws, &pool);
        lambda.iter_mut().zip(&h).for_each(|(l, h)| *l -= rate * (h + ridge * *l));
    }

    let curvature = Curvature::new(optimum, train.all(), ws, &pool);
    let solve = solve_implicit(&curvature, &b, ridge, 1e-12, 500, ws, &pool);
    assert_eq!(solve.outcome, SolveOutcome::Converged, "residual {:e}", solve.residual);
    assert!(solve.smallest_curvature > 0.5 * ridge, "curvature {}", solve.smallest_curvature);
    let implicit: Vec<f64> = curvature.mixed_product(&solve.z, ws, &pool).iter().map(|t| -t).collect();
    let missed: Vec<f64> = implicit.iter().zip(&unrolled).map(|(a, b)| a - b).collect();
    let relative = (dot(&missed, &missed) / dot(&unrolled, &unrolled)).sqrt();
    let norm = dot(&unrolled, &unrolled).sqrt();
    assert!(norm > 1e-4 && loss_test > 1e-3, "{norm} {loss_test}");
    assert!(relative < 1e-4, "implicit and unrolled differ by {relative:e}, {} iterations", solve.iterations);
}
