//! Compares the network and its derivatives, the implicit term and the error metric with their cases.

use metasense_numerics::brain::{
    Adam, Architecture, Curvature, Data, Real, Shape, Workspace, full_gradient, predict, prediction_error,
    solve_implicit, train,
};
use metasense_numerics::simd::Width;

use super::case::{Case, CaseError};
use super::{ComparedQuantity, dot, relative};

const F64: f64 = 1e-10;
const F32: f64 = 1e-4;

fn shape(case: &Case) -> Result<Shape, CaseError> {
    Ok(Shape {
        instants: case.size("T")?,
        inputs: 3 * case.size("M")?,
        outputs: case.size("K")?,
        architecture: Architecture::paper(case.size("width")?),
    })
}

/// b1, b2, b3, w1, w2, w3 with this prefix, in the flat order of the weights.
fn flat(case: &Case, shape: Shape, prefix: &str) -> Result<Vec<f64>, CaseError> {
    let mut weights = Vec::with_capacity(shape.weights());
    for (block, name) in ["b1", "b2", "b3", "w1", "w2", "w3"].iter().enumerate() {
        weights.extend(case.array_of(&format!("{prefix}{name}"), shape.range(block).len())?);
    }
    Ok(weights)
}

fn cast<F: Real>(values: &[f64]) -> Vec<F> {
    values.iter().map(|&v| F::from_f64(v)).collect()
}

/// Output, loss, gradients, second derivatives and five Adam steps, in both precisions, with every instruction set of the
/// machine.
pub fn network(case: &Case, pool: &metasense_numerics::Pool) -> Result<Vec<ComparedQuantity>, CaseError> {
    let mut rows = Vec::new();
    for width in Width::ALL.into_iter().filter(|width| *width <= Width::detect()) {
        rows.extend(network_in::<f64>(case, width, "f64", F64, pool)?);
        rows.extend(network_in::<f32>(case, width, "f32", F32, pool)?);
    }
    Ok(rows)
}

fn network_in<F: Real>(
    case: &Case,
    width: Width,
    precision: &str,
    tolerance: f64,
    pool: &metasense_numerics::Pool,
) -> Result<Vec<ComparedQuantity>, CaseError> {
    let (shape, samples) = (shape(case)?, case.size("N")?);
    let x = case.array_of("x", samples * shape.instants * shape.inputs)?;
    let y = case.array_of("y", samples * shape.instants * shape.outputs)?;
    let data = Data::<F>::new(shape, &cast(&x), &cast(&y));
    let ws = &mut Workspace::new(shape, width);
    let weights: Vec<F> = cast(&flat(case, shape, "")?);
    let mut rows = Vec::new();
    let mut compare = |quantity: &str, found: &[F], expected: &[f64]| {
        let found: Vec<f64> = found.iter().map(|v| v.to_f64()).collect();
        rows.push(ComparedQuantity::new(
            format!("{quantity} {precision} {}", width.name()),
            relative(&found, expected),
            tolerance,
        ));
    };
    let mut gradient = vec![F::from_f64(0.0); shape.weights()];
    compare("output", &predict(&weights, data.all(), ws, pool), &case.array("output")?);
    let (loss, inputs) = full_gradient(&weights, data.all(), &mut gradient, ws, pool);
    compare("loss", &[F::from_f64(loss)], &[case.number("loss")?]);
    compare("gradient in the weights", &gradient, &flat(case, shape, "grad_")?);
    compare("gradient in the inputs", &inputs, &case.array("grad_x")?);
    let v: Vec<F> = cast(&flat(case, shape, "v_")?);
    let curvature = Curvature::new(&weights, data.all(), ws, pool);
    curvature.product(&v, &mut gradient, ws, pool);
    compare("Hessian-vector product", &gradient, &flat(case, shape, "Hv_")?);
    compare("mixed product", &curvature.mixed_product(&v, ws, pool), &case.array("mixed_v")?);
    let (mut trained, mut adam, mut losses) = (weights, Adam::new(shape.weights()), Vec::new());
    let outcome = train(&mut trained, &mut adam, data.all(), &|_| 1e-2, 5, &mut losses, ws, pool);
    compare("five Adam steps", &trained, &flat(case, shape, "adam5_")?);
    let theirs: Result<Vec<f64>, CaseError> =
        (0..losses.len()).map(|i| case.number(&format!("adam.losses_before_step.{i}"))).collect();
    let ours: Vec<f64> = losses.into_iter().map(f64::from).collect();
    let name = format!("losses before each step {precision} {}", width.name());
    rows.push(ComparedQuantity::new(name, relative(&ours, &theirs?), F32));
    if let Some(last) = rows.last_mut() {
        last.note = outcome.name().to_string();
    }
    Ok(rows)
}

/// b, the direct term, z after 20 conjugate-gradient iterations at each λ, and the resulting implicit term.
pub fn implicit(case: &Case, pool: &metasense_numerics::Pool) -> Result<Vec<ComparedQuantity>, CaseError> {
    let shape = shape(case)?;
    let data = |set: &str| -> Result<Data<f64>, CaseError> {
        let samples = case.size(&format!("N_{set}"))? * shape.instants;
        let x = case.array_of(&format!("x_{set}"), samples * shape.inputs)?;
        Ok(Data::new(shape, &x, &case.array_of(&format!("y_{set}"), samples * shape.outputs)?))
    };
    let (train, test) = (data("train")?, data("test")?);
    let (ws, weights) = (&mut Workspace::new(shape, pool.width()), flat(case, shape, "")?);
    let mut b = vec![0.0; shape.weights()];
    let (loss, grad_x) = full_gradient(&weights, test.all(), &mut b, ws, pool);
    let direct = dot(&grad_x, &case.array_of("dA_test", grad_x.len())?);
    let mut rows = vec![
        ComparedQuantity::new("test loss", relative(&[loss], &[case.number("loss_test")?]), F64),
        case.row("∂L_test/∂β", &b, "b", F64)?,
        case.row("∂L_test/∂A", &grad_x, "grad_x_test", F64)?,
        ComparedQuantity::new("direct term", relative(&[direct], &[case.number("direct")?]), 1e-9),
    ];
    let curvature = Curvature::new(&weights, train.all(), ws, pool);
    for i in 0..case.list("solves")?.len() {
        let number = |key: &str| case.number(&format!("solves.{i}.{key}"));
        let lambda = number("lam")?;
        // Covers the effect of the last digits of b, and the difference between two programs with the same iteration.
        let tolerance = (10.0 * number("cg_sensitivity_to_1e-12")?)
            .max(10.0 * number("cg_hand_relative_difference").unwrap_or(0.0))
            .max(1e-6);
        let solve = solve_implicit(&curvature, &b, lambda, 1e-7, 20, ws, pool);
        let expected = case.array_of(&format!("z_cg_{lambda}"), shape.weights())?;
        // Uses the recorded z: at small λ, twenty iterations determine the term to a tenth only.
        let mut term = curvature.mixed_product(&expected, ws, pool);
        term.iter_mut().for_each(|t| *t = -*t);
        let scalar = dot(&term, &case.array_of("dA_train", term.len())?);
        let (name, error) = (format!("z, λ = {lambda}"), relative(&solve.z, &expected));
        let note = format!("{} after {}", solve.outcome.name(), solve.iterations);
        rows.extend([
            match number("cg_min_rayleigh")? {
                // Our solver stops at negative curvature, where the term is meaningless.
                least if least < 0.0 => ComparedQuantity::shown(name, error)
                    .noted(format!("{note}; the reference continued through {least:.0e}")),
                _ => ComparedQuantity::new(name, error, tolerance).noted(note),
            },
            case.row(&format!("implicit term, λ = {lambda}"), &term, &format!("implicit_cg_{lambda}"), F64)?,
            ComparedQuantity::new(
                format!("implicit scalar, λ = {lambda}"),
                relative(&[scalar], &[number("cg_implicit")?]),
                1e-9,
            ),
        ]);
    }
    Ok(rows)
}

/// Errors of samples, their mean, and which samples have none.
pub fn metric(case: &Case) -> Result<Vec<ComparedQuantity>, CaseError> {
    let size = |axis: usize| case.size(&format!("arrays.force.{axis}"));
    let (samples, instants, panels) = (size(0)?, size(1)?, size(2)?);
    let read = |name: &str| case.array_of(name, samples * instants * panels);
    let found = prediction_error(&read("force")?, &read("predicted")?, panels, instants);
    let expected = case.array_of("error", samples)?;
    let known: Vec<f64> = found.iter().copied().flatten().collect();
    let theirs: Vec<f64> = expected.iter().copied().filter(|e| !e.is_nan()).collect();
    let disagree = found.iter().zip(&expected).filter(|(f, e)| f.is_none() != e.is_nan()).count();
    let mut rows = vec![
        ComparedQuantity::new("error of samples", relative(&known, &theirs), 1e-12),
        ComparedQuantity::new("samples without force that are misclassified", disagree as f64, 0.0),
    ];
    // Without errors there is no mean.
    if !known.is_empty() {
        let mean = known.iter().sum::<f64>() / known.len() as f64;
        rows.push(ComparedQuantity::new("mean error", relative(&[mean], &[case.number("mean")?]), 1e-12));
    }
    Ok(rows)
}
