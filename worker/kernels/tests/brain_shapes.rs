//! Networks of many shapes, compared with a direct convolution, and their derivatives, compared with differences, on every
//! supported instruction set.

use metasense_kernels::brain::*;
use metasense_kernels::random::{Purpose, Stream};
use metasense_kernels::simd::Width;

const SAMPLES: usize = 3;

/// The paper's shape with odd T; the long one; causal ones; kernels of length 1 only; a last layer with a longer kernel; widths
/// that are not a multiple of a register, that need one and three registers; kernels longer than half a sample; more outputs
/// than inputs; the largest number of layers.
fn shapes() -> Vec<Shape> {
    let of = |instants, [inputs, outputs]: [usize; 2], architecture| Shape {
        instants,
        inputs,
        outputs,
        architecture,
    };
    let long = |causal| Architecture::new(24, &[9, 9, 9, 1], &[1, 4, 16, 1], causal);
    vec![
        of(20, [3, 2], Architecture::paper(64)),
        of(21, [6, 3], Architecture::paper(16)),
        of(36, [3, 2], Architecture::new(48, &[3, 3, 3, 1], &[1; 4], false)),
        of(36, [3, 2], Architecture::new(64, &[3, 3, 3, 1], &[1; 4], true)),
        of(70, [3, 2], long(false)),
        of(141, [3, 2], long(true)),
        of(7, [3, 2], Architecture::new(8, &[1, 1], &[1, 1], false)),
        of(20, [3, 2], Architecture::new(20, &[3, 3, 3], &[1; 3], false)),
        of(23, [3, 4], Architecture::new(50, &[3, 3, 3, 3], &[2, 1, 3, 2], false)),
        of(23, [9, 2], Architecture::new(40, &[4, 2, 3, 2], &[1, 3, 1, 5], true)),
        of(12, [3, 2], Architecture::new(80, &[9, 3, 1], &[2, 1, 1], false)),
        of(10, [3, 2], Architecture::new(16, &[3; LAYERS_MAX], &[1; LAYERS_MAX], false)),
    ]
}

fn widths() -> impl Iterator<Item = Width> {
    [Width::Baseline, Width::Avx2, Width::Avx512].into_iter().filter(|&w| w <= Width::detect())
}

fn pool(threads: usize) -> metasense_kernels::Pool {
    metasense_kernels::Pool::new(threads).expect("threads")
}

fn normal(n: usize, seed: u64) -> Vec<f64> {
    let mut stream = Stream::new(Purpose::Batch, seed, [0, 0]);
    (0..n).map(|_| stream.normal()).collect()
}

fn cast<F: Real>(values: &[f64]) -> Vec<F> {
    values.iter().map(|&v| F::from_f64(v)).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn plus(a: &[f64], step: f64, direction: &[f64]) -> Vec<f64> {
    a.iter().zip(direction).map(|(a, d)| a + step * d).collect()
}

/// A network with nonzero biases, signals and targets, and a workspace.
struct Task {
    shape: Shape,
    weights: Vec<f64>,
    x: Vec<f64>,
    y: Vec<f64>,
    ws: Workspace<f64>,
    pool: metasense_kernels::Pool,
}

impl Task {
    fn new(shape: Shape, width: Width) -> Self {
        let mut weights = initial_weights(shape, 3, 0);
        let biases = shape.range(shape.layers()).start;
        weights[..biases].copy_from_slice(&normal(biases, 4));
        Self {
            shape,
            weights,
            x: normal(SAMPLES * shape.instants * shape.inputs, 5),
            y: normal(SAMPLES * shape.instants * shape.outputs, 6),
            ws: Workspace::new(shape, width),
            pool: pool(1),
        }
    }

    fn data(&self, x: &[f64]) -> Data<f64> {
        let sigma: Vec<f64> = (0..self.shape.outputs).map(|k| 0.5 + k as f64).collect();
        Data::new(self.shape, x, &self.y).with_output_weights(&sigma)
    }

    fn loss(&mut self, weights: &[f64], x: &[f64]) -> f64 {
        loss(weights, self.data(x).all(), &mut self.ws, &self.pool)
    }

    /// Gradients in weights and inputs.
    fn gradients(&mut self, weights: &[f64], x: &[f64]) -> [Vec<f64>; 2] {
        let mut gradient = vec![0.0; weights.len()];
        let inputs = full_gradient(weights, self.data(x).all(), &mut gradient, &mut self.ws, &self.pool).1;
        [gradient, inputs]
    }

    fn predict(&mut self, weights: &[f64], x: &[f64]) -> Vec<f64> {
        predict(weights, self.data(x).all(), &mut self.ws, &self.pool)
    }

    fn product(&mut self, v: &[f64]) -> Vec<f64> {
        let (data, mut out) = (self.data(&self.x), vec![0.0; v.len()]);
        let curvature = Curvature::new(&self.weights, data.all(), &mut self.ws, &self.pool);
        curvature.product(v, &mut out, &mut self.ws, &self.pool);
        out
    }
}

/// Predictions (N, T, K) by the formulas in `shape`, evaluated directly.
fn plainly(shape: Shape, causal: bool, weights: &[f64], x: &[f64]) -> Vec<f64> {
    let (layers, t) = (shape.architecture.layers(), shape.instants);
    let mut all = Vec::new();
    for sample in x.chunks_exact(t * shape.inputs) {
        let (mut a, mut inputs) = (sample.to_vec(), shape.inputs);
        for (l, layer) in layers.iter().enumerate() {
            let (b, w) = (&weights[shape.range(l)], &weights[shape.range(layers.len() + l)]);
            let outputs = b.len();
            let reach = (layer.kernel - 1) * layer.dilation;
            let before = if causal { reach } else { reach / 2 };
            let mut z = vec![0.0; t * outputs];
            for (n, o) in (0..t).flat_map(|n| (0..outputs).map(move |o| (n, o))) {
                let mut sum = b[o];
                for tap in 0..layer.kernel {
                    let at = n + tap * layer.dilation;
                    if (before..before + t).contains(&at) {
                        for c in 0..inputs {
                            sum += a[(at - before) * inputs + c] * w[(tap * inputs + c) * outputs + o];
                        }
                    }
                }
                z[n * outputs + o] = if l + 1 < layers.len() { sum.max(0.0) } else { sum };
            }
            (a, inputs) = (z, outputs);
        }
        all.extend(a);
    }
    all
}

/// ‖a − b‖ / ‖b‖.
fn distance<F: Real>(a: &[F], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let missed: f64 = a.iter().zip(b).map(|(a, b)| (a.to_f64() - b).powi(2)).sum();
    (missed / dot(b, b)).sqrt()
}

fn answers<F: Real>(task: &Task, width: Width) -> Vec<F> {
    let data = Data::<F>::new(task.shape, &cast(&task.x), &cast(&task.y));
    let ws = &mut Workspace::new(task.shape, width);
    predict(&cast::<F>(&task.weights), data.all(), ws, &task.pool)
}

/// Compares predictions in f64 and f32.
#[test]
fn every_shape_is_the_convolution_written_plainly() {
    for (shape, width) in shapes().into_iter().flat_map(|s| widths().map(move |w| (s, w))) {
        let task = Task::new(shape, width);
        let expected = plainly(shape, shape.architecture.causal(), &task.weights, &task.x);
        let double = distance(&answers::<f64>(&task, width), &expected);
        let single = distance(&answers::<f32>(&task, width), &expected);
        assert!(double < 1e-13 && single < 1e-5, "{shape:?} {}: {double:e} {single:e}", width.name());
    }
}

/// L(β + εδ) = L(β) + ε g·δ + O(ε²), in weights and in inputs: half the step leaves a quarter of the remainder. Steps are so
/// short that hardly any unit crosses its kink.
#[test]
fn first_derivatives_leave_a_remainder_of_second_order() {
    for (shape, width) in shapes().into_iter().flat_map(|s| widths().map(move |w| (s, w))) {
        let mut task = Task::new(shape, width);
        let (weights, x) = (task.weights.clone(), task.x.clone());
        let here = task.loss(&weights, &x);
        let [gradient, inputs] = task.gradients(&weights, &x);
        let (dw, dx) = (normal(weights.len(), 8), normal(x.len(), 9));
        let mut order = |slope: f64, moved: &mut dyn FnMut(&mut Task, f64) -> f64| {
            assert!(slope.abs() > 1e-3, "{slope}");
            let mut left = |step: f64| (moved(&mut task, step) - here - step * slope).abs();
            (left(1e-6) / left(5e-7)).log2()
        };
        let orders = [
            order(dot(&gradient, &dw), &mut |task, step| task.loss(&plus(&weights, step, &dw), &x)),
            order(dot(&inputs, &dx), &mut |task, step| task.loss(&weights, &plus(&x, step, &dx))),
        ];
        assert!(orders.iter().all(|p| (1.9..2.1).contains(p)), "{shape:?} {}: {orders:?}", width.name());
    }
}

/// Steps are so short that no unit crosses its kink. The error is ‖H v − differences‖/‖differences‖. H is symmetric.
#[test]
fn hessian_products_are_differences_of_gradients() {
    let step = 1e-7;
    for (shape, width) in shapes().into_iter().flat_map(|s| widths().map(move |w| (s, w))) {
        let mut task = Task::new(shape, width);
        let (weights, x) = (task.weights.clone(), task.x.clone());
        let (u, v) = (normal(weights.len(), 8), normal(weights.len(), 9));
        let [hu, hv] = [&u, &v].map(|v| task.product(v));
        let [ahead, _] = task.gradients(&plus(&weights, step, &v), &x);
        let [behind, _] = task.gradients(&plus(&weights, -step, &v), &x);
        let differences: Vec<f64> = ahead.iter().zip(&behind).map(|(a, b)| (a - b) / (2.0 * step)).collect();
        let missed = distance(&hv, &differences);
        let symmetric = (dot(&u, &hv) - dot(&v, &hu)).abs() / (dot(&u, &u) * dot(&hv, &hv)).sqrt();
        assert!(missed < 1e-6, "{shape:?} {}: {missed:e}", width.name());
        assert!(symmetric < 1e-13, "{shape:?} {}: {symmetric:e}", width.name());
    }
}

/// Along dx, ∂/∂x ⟨∂L/∂β, v⟩ equals v times the difference of weight gradients. The whole vector equals the difference of input
/// gradients along v.
#[test]
fn mixed_products_are_differences_of_gradients() {
    let step = 1e-7;
    for (shape, width) in shapes().into_iter().flat_map(|s| widths().map(move |w| (s, w))) {
        let mut task = Task::new(shape, width);
        let (weights, x) = (task.weights.clone(), task.x.clone());
        let (v, dx) = (normal(weights.len(), 8), normal(x.len(), 9));
        let data = task.data(&x);
        let curvature = Curvature::new(&weights, data.all(), &mut task.ws, &task.pool);
        let mixed = curvature.mixed_product(&v, &mut task.ws, &task.pool);
        let half = |a: &[f64], b: &[f64]| -> Vec<f64> {
            a.iter().zip(b).map(|(a, b)| (a - b) / (2.0 * step)).collect()
        };
        let [ahead, _] = task.gradients(&weights, &plus(&x, step, &dx));
        let [behind, _] = task.gradients(&weights, &plus(&x, -step, &dx));
        let expected = dot(&v, &half(&ahead, &behind));
        let along = (dot(&mixed, &dx) - expected).abs() / (dot(&mixed, &mixed) * dot(&dx, &dx)).sqrt();
        let [_, ahead] = task.gradients(&plus(&weights, step, &v), &x);
        let [_, behind] = task.gradients(&plus(&weights, -step, &v), &x);
        let whole = distance(&mixed, &half(&ahead, &behind));
        assert!(along < 1e-6 && whole < 1e-6, "{shape:?} {}: {along:e} {whole:e}", width.name());
    }
}

/// If inputs from an instant on change, the earlier predictions of a causal network stay identical, those of others change.
#[test]
fn a_causal_network_does_not_look_ahead() {
    for shape in shapes() {
        let mut task = Task::new(shape, Width::detect());
        let (weights, mut x) = (task.weights.clone(), task.x.clone());
        let before = task.predict(&weights, &x);
        let at = shape.instants / 2;
        for sample in x.chunks_exact_mut(shape.instants * shape.inputs) {
            sample[at * shape.inputs..].iter_mut().for_each(|x| *x += 1.0);
        }
        let after = task.predict(&weights, &x);
        let samples = before.chunks_exact(shape.instants * shape.outputs);
        let early = |pair: (&[f64], &[f64])| pair.0[..at * shape.outputs] == pair.1[..at * shape.outputs];
        let same = samples.zip(after.chunks_exact(shape.instants * shape.outputs)).all(early);
        let blind = shape.architecture.layers().iter().all(|layer| layer.kernel == 1);
        assert_eq!(same, shape.architecture.causal() || blind, "{shape:?}");
        assert!(before != after, "{shape:?}");
    }
}

/// Training and second derivatives are identical bit by bit on one, two and three threads.
#[test]
fn any_number_of_threads_gives_the_same_bits_in_every_shape() {
    for shape in shapes() {
        let n = 37;
        let (x, y) =
            (normal(n * shape.instants * shape.inputs, 1), normal(n * shape.instants * shape.outputs, 2));
        let data = Data::<f32>::new(shape, &cast(&x), &cast(&y));
        let run = |threads| {
            let pool = pool(threads);
            let ws = &mut Workspace::new(shape, pool.width());
            let mut weights: Vec<f32> = cast(&initial_weights(shape, 3, 0));
            let v = weights.clone();
            let (mut adam, mut losses) = (Adam::new(weights.len()), Vec::new());
            let outcome = train(&mut weights, &mut adam, data.all(), &|_| 3e-3, 5, &mut losses, ws, &pool);
            assert_eq!(outcome, TrainOutcome::Ok);
            let curvature = Curvature::new(&weights, data.all(), ws, &pool);
            let mut product = vec![0.0; v.len()];
            curvature.product(&v, &mut product, ws, &pool);
            (losses, product, curvature.mixed_product(&v, ws, &pool), weights)
        };
        let one = run(1);
        assert!(one.0[4] < one.0[0], "{shape:?}: {:?}", one.0);
        assert!(one == run(2) && one == run(3), "{shape:?}");
    }
}

/// If a hidden layer is inactive, the outcome contains its number.
#[test]
fn any_dead_layer_is_named() {
    for shape in shapes() {
        let mut task = Task::new(shape, Width::detect());
        for layer in 1..shape.layers() {
            let mut weights = initial_weights(shape, 3, 0);
            for above in layer..shape.layers() {
                weights[shape.range(above)].fill(0.1);
            }
            weights[shape.range(layer - 1)].fill(-1e3);
            let (data, mut adam, mut losses) = (task.data(&task.x), Adam::new(weights.len()), Vec::new());
            let rate = &|_| 1e-2;
            let outcome =
                train(&mut weights, &mut adam, data.all(), rate, 3, &mut losses, &mut task.ws, &task.pool);
            assert_eq!(outcome, TrainOutcome::DeadLayer(layer), "{shape:?}");
        }
    }
}

/// The flat order of the paper's shape is b₁, b₂, b₃, w₁, w₂, w₃; the number of weights of the long shape.
#[test]
fn weights_are_counted() {
    let [paper, long] =
        [Architecture::paper(64), Architecture::new(24, &[9, 9, 9, 1], &[1, 4, 16, 1], false)]
            .map(|architecture| Shape { instants: 200, inputs: 3, outputs: 2, architecture });
    let ranges = [0..64, 64..128, 128..130, 130..706, 706..12_994, 12_994..13_122];
    assert!(ranges.into_iter().enumerate().all(|(block, range)| paper.range(block) == range));
    assert_eq!(paper.weights(), 13_122);
    assert_eq!(long.weights(), 9 * 3 * 24 + 24 + 2 * (9 * 24 * 24 + 24) + 24 * 2 + 2);
}

/// A batch of indices is equivalent to a data set of those samples.
#[test]
fn a_batch_is_its_samples() {
    let shape = Shape { instants: 21, inputs: 3, outputs: 2, architecture: Architecture::paper(8) };
    let (x, y) = (normal(6 * 21 * 3, 1), normal(6 * 21 * 2, 2));
    let data = Data::<f64>::new(shape, &x, &y);
    let (nx, ny) = (21 * 3, 21 * 2);
    let two =
        Data::new(shape, &[&x[4 * nx..5 * nx], &x[..nx]].concat(), &[&y[4 * ny..5 * ny], &y[..ny]].concat());
    let (pool, weights) = (pool(1), initial_weights(shape, 1, 0));
    let ws = &mut Workspace::new(shape, pool.width());
    let mut gradients = [vec![0.0; shape.weights()], vec![0.0; shape.weights()]];
    let a = full_gradient(&weights, data.batch(&[4, 0]), &mut gradients[0], ws, &pool);
    let b = full_gradient(&weights, two.all(), &mut gradients[1], ws, &pool);
    assert!(a == b && gradients[0] == gradients[1], "{} {}", a.0, b.0);
}

/// NaN and divergence are reported, and the weights stay finite.
#[test]
fn trainings_gone_wrong_are_named() {
    let shape = Shape { instants: 21, inputs: 3, outputs: 2, architecture: Architecture::paper(8) };
    let (x, y) = (normal(6 * 21 * 3, 1), normal(6 * 21 * 2, 2));
    let data = Data::<f64>::new(shape, &x, &y);
    let (pool, fresh) = (pool(1), initial_weights(shape, 1, 0));
    let run = |mut weights: Vec<f64>, data: &Data<f64>, rate: f64| {
        let (mut adam, mut losses, ws) =
            (Adam::new(weights.len()), Vec::new(), &mut Workspace::new(shape, pool.width()));
        let outcome = train(&mut weights, &mut adam, data.all(), &|_| rate, 30, &mut losses, ws, &pool);
        assert!(weights.iter().all(|w| w.is_finite()));
        outcome
    };
    assert_eq!(run(fresh.clone(), &data, 1e-2), TrainOutcome::Ok);
    assert_eq!(run(fresh.clone(), &data, 1e3), TrainOutcome::Diverged);
    assert_eq!(run(fresh.clone(), &data, 1e200), TrainOutcome::NonFinite);
    let poisoned = Data::new(shape, &[&[f64::NAN], &x[1..]].concat(), &y);
    assert_eq!(run(fresh, &poisoned, 1e-2), TrainOutcome::NonFinite);
}
