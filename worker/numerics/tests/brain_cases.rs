//! The brain against the reference cases of `tests/cases` (JAX, f64), on every instruction set that the machine has.

use metasense_numerics::brain::*;
use metasense_numerics::simd::Width;
use std::path::PathBuf;

struct Case {
    folder: PathBuf,
    json: serde_json::Value,
}

impl Case {
    fn open(name: &str) -> Self {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases").join(name);
        let text = std::fs::read_to_string(folder.join("case.json")).expect("case.json");
        Self { folder, json: serde_json::from_str(&text).expect("JSON") }
    }

    fn array(&self, name: &str) -> Vec<f64> {
        let bytes = std::fs::read(self.folder.join(format!("{name}.npy"))).expect(name);
        npyz::NpyFile::new(&bytes[..]).expect(name).into_vec().expect(name)
    }

    fn number(&self, name: &str) -> f64 {
        self.json[name].as_f64().expect(name)
    }

    fn size(&self, name: &str) -> usize {
        self.json[name].as_u64().expect(name) as usize
    }

    fn shape(&self) -> Shape {
        Shape {
            instants: self.size("T"),
            inputs: 3 * self.size("M"),
            outputs: self.size("K"),
            architecture: Architecture::paper(self.size("width")),
        }
    }

    /// b1, b2, b3, w1, w2, w3 with this prefix, in the flat order.
    fn flat(&self, prefix: &str) -> Vec<f64> {
        ["b1", "b2", "b3", "w1", "w2", "w3"]
            .iter()
            .flat_map(|name| self.array(&format!("{prefix}{name}")))
            .collect()
    }
}

fn cast<F: Real>(values: &[f64]) -> Vec<F> {
    values.iter().map(|&v| F::from_f64(v)).collect()
}

/// ‖a − b‖ / ‖b‖.
fn distance<F: Real>(a: &[F], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let missed: f64 = a.iter().zip(b).map(|(a, b)| (a.to_f64() - b).powi(2)).sum();
    (missed / b.iter().map(|b| b * b).sum::<f64>()).sqrt()
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads")
}

fn widths() -> impl Iterator<Item = Width> {
    [Width::Baseline, Width::Avx2, Width::Avx512].into_iter().filter(|&w| w <= Width::detect())
}

fn compare_cnn<F: Real>(name: &str, width: Width, tolerance: f64) {
    let (case, pool) = (Case::open(name), pool(2));
    let shape = case.shape();
    let data = Data::<F>::new(shape, &cast(&case.array("x")), &cast(&case.array("y")));
    let ws = &mut Workspace::with_width(shape, width);
    let weights: Vec<F> = cast(&case.flat(""));
    let mut found = Vec::new();

    found.push(("output", distance(&predict(&weights, data.all(), ws, &pool), &case.array("output"))));
    let mut gradient = vec![F::ZERO; shape.weights()];
    let (value, inputs) = full_gradient(&weights, data.all(), &mut gradient, ws, &pool);
    found.push(("loss", (value / case.number("loss") - 1.0).abs()));
    found.push(("gradient", distance(&gradient, &case.flat("grad_"))));
    found.push(("grad_x", distance(&inputs, &case.array("grad_x"))));
    assert_eq!(loss(&weights, data.all(), ws, &pool), value);
    assert_eq!(loss_gradient(&weights, data.all(), &mut gradient, ws, &pool), value);
    assert_eq!(input_gradient(&weights, data.all(), ws, &pool).1, inputs);

    let v: Vec<F> = cast(&case.flat("v_"));
    let curvature = Curvature::new(&weights, data.all(), ws, &pool);
    let mut hv = vec![F::ZERO; shape.weights()];
    curvature.product(Matrix::Hessian, &v, &mut hv, ws, &pool);
    found.push(("Hv", distance(&hv, &case.flat("Hv_"))));
    found.push(("mixed_v", distance(&curvature.mixed_product(&v, ws, &pool), &case.array("mixed_v"))));

    let (mut trained, mut adam, mut losses) = (weights.clone(), Adam::new(weights.len()), Vec::new());
    let outcome = train(&mut trained, &mut adam, data.all(), &|_| 1e-2, 5, &mut losses, ws, &pool);
    assert_eq!(outcome, TrainOutcome::Ok);
    found.push(("adam5", distance(&trained, &case.flat("adam5_"))));
    for (i, loss) in losses.iter().enumerate() {
        let expected = case.json["adam"]["losses_before_step"][i].as_f64().expect("loss");
        assert!((f64::from(*loss) / expected - 1.0).abs() < 1e-4, "step {i}: {loss} {expected}");
    }
    assert!(found.iter().all(|(_, d)| *d <= tolerance), "{name} {}: {found:?}", width.name());
}

/// Relative distances of outputs, loss, gradients, second derivatives and five Adam steps.
#[test]
fn the_network_and_its_derivatives_match_the_reference_in_f64() {
    for width in widths() {
        compare_cnn::<f64>("cnn_small_p", width, 1e-10);
        compare_cnn::<f64>("cnn_full_p", width, 1e-10);
    }
}

/// The same in the precision of training.
#[test]
fn the_network_and_its_derivatives_match_the_reference_in_f32() {
    for width in widths() {
        compare_cnn::<f32>("cnn_small_p", width, 1e-4);
        compare_cnn::<f32>("cnn_full_p", width, 1e-4);
    }
}

/// z against 20 recorded iterations, within ten times the recorded sensitivity; the term that belongs to the recorded z.
#[test]
fn the_implicit_term_matches_the_reference_as_far_as_it_is_determined() {
    for name in ["implicit_width8_p", "implicit_width64_p"] {
        let (case, pool) = (Case::open(name), pool(2));
        let shape = case.shape();
        let data =
            |set: &str| Data::new(shape, &case.array(&format!("x_{set}")), &case.array(&format!("y_{set}")));
        let (train, test) = (data("train"), data("test"));
        let ws = &mut Workspace::new(shape);
        let weights = case.flat("");
        let mut b = vec![0.0; shape.weights()];
        let (loss_test, grad_x) = full_gradient(&weights, test.all(), &mut b, ws, &pool);
        let dots = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert!((loss_test / case.number("loss_test") - 1.0).abs() < 1e-10, "{loss_test}");
        assert!(
            distance(&b, &case.array("b")) < 1e-9 && distance(&grad_x, &case.array("grad_x_test")) < 1e-9
        );
        let direct = dots(&grad_x, &case.array("dA_test"));
        assert!((direct / case.number("direct") - 1.0).abs() < 1e-9, "{direct}");

        let curvature = Curvature::new(&weights, train.all(), ws, &pool);
        for solve in case.json["solves"].as_array().expect("solves") {
            let number = |key: &str| solve[key].as_f64().expect(key);
            let tag = if number("lam") == 0.0 { "0".to_string() } else { number("lam").to_string() };
            let allowed = 1e-6f64.max(10.0 * number("cg_sensitivity_to_1e-12"));
            let policy = Policy::Damped(number("lam"));
            let found = solve_implicit(&curvature, &b, policy, 1e-7, 20, ws, &pool);
            assert_eq!(found.outcome, SolveOutcome::IterationLimit);
            let z = distance(&found.z, &case.array(&format!("z_cg_{tag}")));
            // From the recorded z: 20 iterations at small λ leave the term itself undetermined to 10 %.
            let mut term = curvature.mixed_product(&case.array(&format!("z_cg_{tag}")), ws, &pool);
            term.iter_mut().for_each(|t| *t = -*t);
            let implicit = distance(&term, &case.array(&format!("implicit_cg_{tag}")));
            let scalar = dots(&term, &case.array("dA_train"));
            let of_scalar = (scalar / number("cg_implicit") - 1.0).abs();
            assert!(
                z <= allowed && implicit <= 1e-10 && of_scalar <= 1e-10,
                "{name} λ = {tag}: z {z:.1e} of {allowed:.1e}, term {implicit:.1e}, scalar {of_scalar:.1e}"
            );
        }
    }
}

/// Errors in percent, and none for the sample of zero force.
#[test]
fn the_prediction_error_matches_the_reference() {
    let case = Case::open("metric_p");
    let errors = prediction_error(&case.array("force"), &case.array("predicted"), 2, 3);
    for (found, expected) in errors.iter().zip(case.array("error")) {
        match found {
            None => assert!(expected.is_nan(), "{expected}"),
            Some(error) => assert!((error - expected).abs() < 1e-12, "{error} {expected}"),
        }
    }
    let known: Vec<f64> = errors.into_iter().flatten().collect();
    assert!((known.iter().sum::<f64>() / known.len() as f64 - case.number("mean")).abs() < 1e-12);
}

/// A made-up task: smooth signals, targets that are a lagged mixture of them.
fn task(shape: Shape, samples: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
    use metasense_numerics::random::{Purpose, Stream};
    let mut stream = Stream::new(Purpose::Batch, seed, [0, 0]);
    let (t, c) = (shape.instants, shape.inputs);
    let (mut x, mut y) = (vec![0.0; samples * t * c], vec![0.0; samples * t * shape.outputs]);
    for n in 0..samples {
        for channel in 0..c {
            let [a, f, p] = [1.5 * stream.normal(), 0.05 + 0.3 * stream.uniform(), 6.0 * stream.uniform()];
            (0..t).for_each(|i| x[(n * t + i) * c + channel] = a * (f * i as f64 + p).sin());
        }
        for (i, k) in (1..t).flat_map(|i| (0..shape.outputs).map(move |k| (i, k))) {
            let at = |i: usize, channel: usize| x[(n * t + i) * c + channel % c];
            y[(n * t + i) * shape.outputs + k] =
                at(i, k) * 0.5 - (at(i - 1, k + 1)).tanh() + 0.1 * at(i, k + 2).powi(2);
        }
    }
    (x, y)
}

/// Bits of a training on one, two and three threads, of full and of odd batches.
#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let shape = Shape { instants: 43, inputs: 6, outputs: 3, architecture: Architecture::paper(16) };
    let (x, y) = task(shape, 50, 1);
    let data = Data::<f32>::new(shape, &cast(&x), &cast(&y));
    let odd: Vec<usize> = (0..37).map(|i| (i * 7) % 50).collect();
    let run = |threads| {
        let (pool, ws) = (pool(threads), &mut Workspace::new(shape));
        let mut weights: Vec<f32> = cast(&initial_weights(shape, 3, 0));
        let (mut adam, mut losses) = (Adam::new(weights.len()), Vec::new());
        for batch in [data.all(), data.batch(&odd)] {
            let outcome = train(&mut weights, &mut adam, batch, &|_| 1e-2, 20, &mut losses, ws, &pool);
            assert_eq!(outcome, TrainOutcome::Ok);
        }
        (weights, losses)
    };
    let one = run(1);
    assert!(one.1[39] < 0.5 * one.1[0], "{:?}", one.1);
    assert!(one == run(2) && one == run(3));
}

/// A batch of indices is the data set of those samples.
#[test]
fn a_batch_is_its_samples() {
    let shape = Shape { instants: 21, inputs: 3, outputs: 2, architecture: Architecture::paper(8) };
    let (x, y) = task(shape, 6, 2);
    let data = Data::<f64>::new(shape, &x, &y);
    let (nx, ny) = (21 * 3, 21 * 2);
    let two =
        Data::new(shape, &[&x[4 * nx..5 * nx], &x[..nx]].concat(), &[&y[4 * ny..5 * ny], &y[..ny]].concat());
    let (ws, pool, weights) = (&mut Workspace::new(shape), pool(1), initial_weights(shape, 1, 0));
    let mut gradients = [vec![0.0; shape.weights()], vec![0.0; shape.weights()]];
    let a = full_gradient(&weights, data.batch(&[4, 0]), &mut gradients[0], ws, &pool);
    let b = full_gradient(&weights, two.all(), &mut gradients[1], ws, &pool);
    assert!(a == b && gradients[0] == gradients[1], "{} {}", a.0, b.0);
}

/// Dead layers, NaN and divergence are named, and the weights stay finite.
#[test]
fn trainings_gone_wrong_are_named() {
    let shape = Shape { instants: 21, inputs: 3, outputs: 2, architecture: Architecture::paper(8) };
    let (x, y) = task(shape, 6, 2);
    let data = Data::<f64>::new(shape, &x, &y);
    let (pool, fresh) = (pool(1), initial_weights(shape, 1, 0));
    let run = |mut weights: Vec<f64>, data: &Data<f64>, rate: f64| {
        let (mut adam, mut losses, ws) = (Adam::new(weights.len()), Vec::new(), &mut Workspace::new(shape));
        let outcome = train(&mut weights, &mut adam, data.all(), &|_| rate, 30, &mut losses, ws, &pool);
        assert!(weights.iter().all(|w| w.is_finite()));
        outcome
    };
    assert_eq!(run(fresh.clone(), &data, 1e-2), TrainOutcome::Ok);
    for layer in 0..2 {
        let mut weights = fresh.clone();
        weights[shape.range(1)].fill(0.1);
        weights[shape.range(layer)].fill(-1e3);
        assert_eq!(run(weights, &data, 1e-2), TrainOutcome::DeadLayer(layer + 1));
    }
    assert_eq!(run(fresh.clone(), &data, 1e3), TrainOutcome::Diverged);
    assert_eq!(run(fresh.clone(), &data, 1e200), TrainOutcome::NonFinite);
    let poisoned = Data::new(shape, &[&[f64::NAN], &x[1..]].concat(), &y);
    assert_eq!(run(fresh, &poisoned, 1e-2), TrainOutcome::NonFinite);
}
