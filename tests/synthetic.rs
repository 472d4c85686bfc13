//! A database of synthetic trials with known answers, for tests of programs that read databases.
//!
//! ```text
//! e_initial = 28·0.93^min(M, 6)·s       e_optimised = 28·exp(−0.7·min(M, 2) − 0.04·M)·s       (K = 4, 8 × 6 units)
//! e_optimised = 20·(N/100)^(−0.7) + 3   (K = 2, M = 1, n × n units)
//! e_random = 45                        (the same at n = 6, from random designs)
//! loss = 0.5·n^(−0.6) initially, 0.25 of it optimised, after iteration 1
//! ```
//! After long training e is half of the initial and a fifth of the optimised value (6 × 6 units, M = 1). s is a factor of each
//! placement with a little noise.

use std::path::Path;
use std::sync::OnceLock;

use metasense::plan::PlannedTrial;
use metasense::store::Store;
use metasense_schemas::record::{
    BodyRecord, Checkpoint, NetworkRecord, Parts, StepRecord, StepSeconds, TrialResult,
};
use metasense_schemas::spec::{Design, SweepSpec, TrialSpec};
use serde_json::{Value, json};

/// Spec text in the database.
pub const TEXT: &str = "name = \"synthetic\"\n# made-up trials\n";

/// A sweep with this name.
pub fn sweep_named(name: &str) -> SweepSpec {
    let mut spec = sweep(6, 6, 2);
    spec["name"] = name.into();
    serde_json::from_value(spec).unwrap()
}

fn sweep(columns: usize, rows: usize, panels: usize) -> Value {
    let spec: SweepSpec = serde_json::from_value(json!({
        "name": "synthetic",
        "body": {"columns": columns, "rows": rows, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
            "stiffness": {"stretch": 3.0, "shear": 0.5, "bend": 1.0}},
        "time": {"duration": 0.2, "samples": 40},
        "stimuli": {"kind": "bell", "samples": 20, "test": 5, "holdout": 5, "width": [0.05, 0.1], "onset": [0.0, 0.1]},
        "brain": {"iterations": 20},
        "optimise": {"iterations": 5},
        "evaluation": {"seeds": 2},
        "sweep": {"panels": [panels], "sensors": [1]},
    }))
    .unwrap();
    serde_json::to_value(spec).unwrap()
}

fn trial(
    order: usize,
    (columns, rows): (usize, usize),
    panels: usize,
    sensors: usize,
    placement: usize,
) -> PlannedTrial {
    let sweep = sweep(columns, rows, panels);
    let unit = |k: usize| (rows - 1) * columns + (2 * k + 1) * columns / (2 * panels);
    let mut spec = json!({
        "point": {"panels": panels, "sensors": sensors, "placement": placement, "seed": 1},
        "panel_units": (0..panels).map(unit).collect::<Vec<_>>(),
        "sensor_units": (0..sensors).map(|m| columns + 1 + (placement + 5 * m) % (columns - 2)
            + columns * ((placement + m) % (rows - 2))).collect::<Vec<_>>(),
    });
    for key in ["body", "time", "solver", "sensors", "stimuli", "brain", "optimise", "evaluation", "feasible"]
    {
        spec[key] = sweep[key].clone();
    }
    let spec: TrialSpec = serde_json::from_value(spec).unwrap();
    PlannedTrial {
        hash: format!("{order:032x}"),
        training: spec.training(),
        spec,
        order,
        units: columns * rows,
        design_parameters: 2 * ((columns + 1) * rows + columns * (rows + 1)),
        brain_parameters: 9 * sensors * 64 + 64 + 3 * 64 * 64 + 64 + 64 * panels + panels,
        trains: true,
        cost: Parts { steps: 0.0, comparison: 10.0 },
        weight: Parts { steps: 0, comparison: 10_000 },
        pause: None,
    }
}

/// Squares rotated by 25°, with every shift moved by `scatter`.
fn design(columns: usize, rows: usize, scatter: f64) -> Vec<f64> {
    let tangent = |i: usize, j: usize| {
        let sign = if (i + j).is_multiple_of(2) { 1.0 } else { -1.0 };
        6.375 * sign * 25f64.to_radians().tan()
    };
    let mut shifts = Vec::new();
    for i in 0..=columns {
        shifts.extend((0..rows).map(|j| [0.0, -tangent(i, j)]));
    }
    for i in 0..columns {
        shifts.extend((0..=rows).map(|j| [tangent(i, j), 0.0]));
    }
    let moved = |n: usize, x: f64| x + scatter * (1.7 * n as f64).sin();
    shifts.into_iter().flatten().enumerate().map(|(n, x)| moved(n, x)).collect()
}

fn evaluation(design: Vec<f64>, weights: usize, error: f64, loss: f32) -> BodyRecord {
    let network = |factor: f64| NetworkRecord {
        error_train: Some(0.8 * error * factor),
        error_test: Some(error * factor),
        error_holdout: Some(1.05 * error * factor),
        losses: (1..=1000u16).map(|n| if n == 1 { 1.0 } else { loss * f32::from(n).powf(-0.6) }).collect(),
        errors: (1..=1000).map(|n| (n, 1.05 * error * factor * (1000.0 / f64::from(n)).sqrt())).collect(),
        outcome: "ok".into(),
        weights: Vec::new(),
        spread: None,
    };
    let mut networks = vec![network(0.98), network(1.02)];
    networks[0].weights = (0..weights).map(|i| 0.1 * (3.7 * i as f32).sin()).collect();
    BodyRecord { design, networks, ..Default::default() }
}

fn step(step: u32, error: f64) -> StepRecord {
    StepRecord {
        step,
        error_test: Some(error),
        projection: "projected".into(),
        outcome: "ok".into(),
        seconds: StepSeconds {
            simulate: 0.5,
            train: 2.0,
            differentiate: 0.8,
            implicit: 0.4,
            project: 0.01,
            store: 0.001,
        },
        ..Default::default()
    }
}

/// Writes the database, in which one trial has failed and one is pending. It is made once for all tests.
pub fn write(db: &Path) {
    static MADE: OnceLock<Vec<u8>> = OnceLock::new();
    let make = || {
        let folder = tempfile::tempdir().unwrap();
        let db = folder.path().join("made.sqlite");
        tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(fill(&db));
        std::fs::read(db).unwrap()
    };
    std::fs::write(db, MADE.get_or_init(make)).unwrap();
}

async fn fill(db: &Path) {
    let mut trials: Vec<(PlannedTrial, f64, f64)> = Vec::new();
    for placement in 0..5 {
        for sensors in 1..=6 {
            let trial = trial(trials.len(), (8, 6), 4, sensors, placement);
            let m = sensors as f64;
            let noise =
                (0.15 * (2.3 * placement as f64).sin() + 0.02 * (7.9 * trials.len() as f64).sin()).exp();
            trials.push((
                trial,
                28.0 * 0.93f64.powf(m) * noise,
                28.0 * (-0.7 * m.min(2.0) - 0.04 * m).exp() * noise,
            ));
        }
    }
    for placement in 0..4 {
        for n in 4..=8 {
            let trial = trial(trials.len(), (n, n), 2, 1, placement);
            let noise = (0.03 * ((trials.len() * trials.len() * 7919 % 101) as f64 / 50.0 - 1.0)).exp();
            let law = 20.0 * (trial.design_parameters as f64 / 100.0).powf(-0.7) + 3.0;
            trials.push((trial, 30.0 * noise, law * noise));
        }
    }
    for seed in 1..=3 {
        let mut random = trial(trials.len(), (6, 6), 2, 1, 0);
        random.spec.body.design = Some(Design::Random { random: seed, spread: Design::SPREAD });
        trials.push((random, 45.0, 9.0));
    }
    for (trial, ..) in trials.iter_mut().filter(|t| (t.0.units, t.0.spec.body.design.is_none()) == (36, true))
    {
        trial.spec.evaluation.long_iterations = Some(2000);
    }
    for _ in 0..2 {
        trials.push((trial(trials.len(), (8, 6), 4, 6, trials.len()), 0.0, 0.0));
    }
    let spec: SweepSpec = serde_json::from_value(sweep(8, 6, 4)).unwrap();
    let mut store = Store::open(db).await.unwrap();
    let plan: Vec<PlannedTrial> = trials.iter().map(|t| t.0.clone()).collect();
    store.begin_sweep(&spec, TEXT, &plan).await.unwrap();
    store.begin_batch().await.unwrap();
    for (trial, initial, optimised) in &trials[..trials.len() - 1] {
        let attempt = store.begin_attempt(&trial.hash).await.unwrap();
        if *initial == 0.0 {
            store.fail(&trial.hash, attempt, "non_finite: sample 3 of the initial body", true).await.unwrap();
            continue;
        }
        for n in 0..5u32 {
            let error = optimised + (initial - optimised) * 0.5f64.powi(n as i32 + 1);
            store.record_step(&trial.hash, attempt, &step(n, error), &Checkpoint::default()).await.unwrap();
        }
        let (columns, rows) = (trial.spec.body.columns(), trial.spec.body.rows());
        let mut result = TrialResult {
            initial: evaluation(design(columns, rows, 0.0), trial.brain_parameters, *initial, 0.5),
            optimised: evaluation(design(columns, rows, 0.8), trial.brain_parameters, *optimised, 0.125),
            best_step: 4,
            seconds_evaluation: 3.0,
            simd: "avx2".into(),
            ..Default::default()
        };
        if trial.spec.evaluation.long_iterations.is_some() {
            for (body, factor) in [(&mut result.initial, 0.5), (&mut result.optimised, 0.2)] {
                body.long = body.networks.clone();
                for network in &mut body.long {
                    network.weights.clear();
                    network.error_test = network.error_test.map(|e| factor * e);
                    network.error_holdout = network.error_holdout.map(|e| factor * e);
                }
            }
        }
        store.finish(&trial.hash, attempt, &result, &[]).await.unwrap();
    }
    store.commit_batch().await.unwrap();
    store.close().await.unwrap();
}
