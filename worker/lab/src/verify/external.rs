//! Tests of an external body: repeatable calls, independent samples, and a gradient that matches the signals.

use metasense_numerics::Pool;
use metasense_numerics::dynamics::Forces;
use metasense_numerics::random::{Purpose, Stream};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::external::{External, SimulationRequest};
use metasense_worker::problem::external::body;
use metasense_worker::run::NoResult;

use super::{ComparedQuantity, dot, relative};
use crate::prepare::any_body;

/// Samples of a test.
const SAMPLES: usize = 3;
/// Longest step relative to the design's RMS; number of steps, each half the previous one.
const STEP: f64 = 1e-2;
const HALVINGS: usize = 12;
/// Largest relative error of a derivative.
const DERIVATIVE: f64 = 1e-5;
/// Largest deviation of the order from 2.
const ORDER: f64 = 0.2;

/// Tests the body of a trial; one row per test.
///
/// # Errors
/// If the body is not external or its process fails.
pub fn external(trial: &TrialSpec, pool: &Pool) -> Result<Vec<ComparedQuantity>, NoResult> {
    let (initial, body) = body(trial).map_err(|invalid| NoResult::Rejected(invalid.to_string()))?;
    let problem = any_body(trial)?;
    let forces = problem.forces(Purpose::Stimulus, 0, SAMPLES);
    tests(&body, &problem.scene, &initial, &forces, trial.solver.tolerance, pool).map_err(NoResult::of_body)
}

fn tests(
    body: &External,
    scene: &metasense_numerics::dynamics::Scene,
    initial: &[f64],
    forces: &Forces,
    tolerance: f64,
    pool: &Pool,
) -> Result<Vec<ComparedQuantity>, metasense_numerics::trial::BodyFailure> {
    let heartbeat = pool.heartbeat();
    let question = SimulationRequest { scene, design: initial, forces, tolerance };
    body.check_repeats(&question, heartbeat)?;
    let mut rows = vec![ComparedQuantity::new("apply and vjp repeat bit by bit", 0.0, 0.0)];

    let signals = body.apply(&question, heartbeat)?;
    let mut apart = Vec::with_capacity(signals.len());
    for i in 0..forces.samples {
        apart.extend(body.apply(&SimulationRequest { forces: &forces.select(&[i]), ..question }, heartbeat)?);
    }
    rows.push(ComparedQuantity::new("samples together and one by one", relative(&apart, &signals), 1e-9));

    let size = (dot(initial, initial) / initial.len() as f64).sqrt();
    let size = if size > 0.0 { size } else { 1.0 };
    let mut stream = Stream::new(Purpose::Design, 0, [0, 0]);
    let cotangent: Vec<f64> = signals.iter().map(|_| stream.normal()).collect();
    let way: Vec<f64> = initial.iter().map(|_| stream.normal()).collect();
    let gradient = body.vjp(&question, &cotangent, heartbeat)?;
    let twice: Vec<f64> = cotangent.iter().map(|c| -2.0 * c).collect();
    let twice: Vec<f64> = body.vjp(&question, &twice, heartbeat)?.iter().map(|g| -0.5 * g).collect();
    rows.push(ComparedQuantity::new("vjp is linear in the cotangent", relative(&twice, &gradient), 1e-9));

    // ⟨c, A(α + h v)⟩ − ⟨c, A(α)⟩
    let change = |h: f64| {
        let design: Vec<f64> = initial.iter().zip(&way).map(|(x, v)| x + h * v).collect();
        let moved = body.apply(&SimulationRequest { design: &design, ..question }, heartbeat)?;
        let change: Vec<f64> = moved.iter().zip(&signals).map(|(a, b)| a - b).collect();
        Ok(dot(&cotangent, &change))
    };
    let slope = dot(&gradient, &way);
    let (mut least, mut remainders) = (f64::INFINITY, Vec::new());
    let noise = 1e3 * f64::EPSILON * dot(&signals, &signals).sqrt() * dot(&cotangent, &cotangent).sqrt();
    for n in 0..HALVINGS {
        let h = STEP * size * 0.5f64.powi(n as i32);
        let [ahead, behind] = [change(h)?, change(-h)?];
        least = least.min(((ahead - behind) / (2.0 * h) - slope).abs() / slope.abs().max(f64::MIN_POSITIVE));
        remainders.push((ahead - h * slope).abs());
    }
    let note = "⟨c, J v⟩ by central differences against ⟨Jᵀ c, v⟩, at the best of 12 steps";
    rows.push(ComparedQuantity::new("derivative", least, DERIVATIVE).noted(note));
    let clear: Vec<f64> = remainders.into_iter().take_while(|r| *r > noise).collect();
    let order = match &clear[..] {
        [first, .., last] => (first / last).log2() / (clear.len() - 1) as f64,
        _ => 2.0, // the body is linear in its design
    };
    let note = format!("Taylor: order {order:.2} of the remainder, over {} steps", clear.len());
    rows.push(ComparedQuantity::new("2 − order", 2.0 - order, ORDER).noted(note));
    Ok(rows.into_iter().map(|row| ComparedQuantity { case: "external body".to_owned(), ..row }).collect())
}
