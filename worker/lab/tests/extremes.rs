//! Small trials with extreme values: every command returns a result or an error, and none panics.
//!
//! Trials are drawn by number. `EXTREMES_SEED=N` sets the first number, `EXTREMES_CASES=N` the count.

use std::panic::{AssertUnwindSafe, catch_unwind};

use metasense_lab::{bound, casts, modes, operator, place, replay, simulate};
use metasense_numerics::identify::{Fit, Parameter};
use metasense_numerics::random::Draw;
use metasense_numerics::random::Purpose;
use metasense_schemas::record::{Checkpoint, StepRecord};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::problem::problem;
use metasense_worker::run::{LoopControl, ObserveTrial, pool, run_trial};
use serde_json::{Value, json};

struct Silent;

impl ObserveTrial for Silent {
    fn progress(&mut self) -> LoopControl {
        LoopControl::Continue
    }
    fn save(&mut self, _: Checkpoint) {}
    fn step(&mut self, _: StepRecord, _: Checkpoint) -> LoopControl {
        LoopControl::Continue
    }
}

/// A 3 × 3 body, one panel, one sensor.
fn usual() -> Value {
    json!({
        "body": {
            "columns": 3, "rows": 3, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
            "stiffness": { "stretch": 3.0, "shear": 0.5, "bend": 1.0 },
        },
        "time": { "duration": 0.05, "samples": 10 },
        "solver": { "tolerance": 3e-2 },
        "sensors": {},
        "stimuli": { "kind": "bell", "samples": 6, "test": 2, "holdout": 2, "onset": [0.0, 0.02], "width": [0.01, 0.02] },
        "brain": { "kind": "linear", "iterations": 2, "width": 16 },
        "optimise": { "brain": "linear", "iterations": 1, "batch": 2 },
        "evaluation": {}, "feasible": {},
        "point": { "panels": 1, "sensors": 1, "placement": 0, "seed": 1 },
        "panel_units": [7], "sensor_units": [4],
    })
}

/// Keys and extreme values for them.
fn choices() -> Vec<(&'static str, Vec<Value>)> {
    vec![
        ("/time/samples", vec![json!(3), json!(4), json!(40)]),
        ("/stimuli/samples", vec![json!(2), json!(3), json!(12)]),
        ("/stimuli/test", vec![json!(1)]),
        ("/stimuli/holdout", vec![json!(1)]),
        ("/stimuli/kind", vec![json!("irregular")]),
        (
            "/stimuli/onset",
            vec![json!([0.0499, 100.0]), json!([0.0499, 0.0499]), json!([0.0, 0.2]), json!([-0.01, -0.009])],
        ),
        (
            "/stimuli/amplitude",
            vec![json!([1e-300, 1e-300]), json!([0.0, 1e-3]), json!([1e3, 1e3]), json!([1e200, 1e200])],
        ),
        ("/stimuli/width", vec![json!([1e-6, 1e-6]), json!([1e3, 1e3])]),
        ("/stimuli/power", vec![json!([1e-3, 1e-3]), json!([1e3, 1e3])]),
        ("/stimuli/force_samples", vec![json!(400)]),
        (
            "/sensors/noise",
            vec![json!(1e-300), json!(1e-12), json!(1e-8), json!(0.03), json!(1e300), json!([1e-300, 1e300])],
        ),
        ("/sensors/bias", vec![json!(1e-300), json!(0.1), json!(1e300)]),
        ("/sensors/range", vec![json!([1e-300, 1e-300]), json!([1e300, 1.0])]),
        ("/sensors/resolution", vec![json!([1e-300, 0.0])]),
        ("/sensors/delay", vec![json!(0.049)]),
        ("/sensors/bandwidth", vec![json!(1e-3), json!(50.0)]),
        ("/sensors/search", vec![json!("greedy")]),
        ("/sensors/channels", vec![json!(["omega"])]),
        ("/sensors/mass", vec![json!(1e-300), json!(1e-3)]),
        ("/brain/kind", vec![json!("cnn"), json!("stacked"), json!("inverse")]),
        ("/brain/ridge", vec![json!(0.0), json!(1e-300), json!(1e300)]),
        ("/brain/memory", vec![json!([0.0, 0.0])]),
        ("/brain/learning_rate", vec![json!(1e-300), json!(1e300)]),
        ("/optimise/brain", vec![json!("cnn")]),
        ("/optimise/protocol", vec![json!("paper"), json!("random")]),
        ("/optimise/learning_rate", vec![json!(1e-300), json!(1e300)]),
        ("/optimise/objective", vec![json!("mean"), json!("worst"), json!({ "cvar": 0.5 })]),
        ("/evaluation/casts", vec![json!(1)]),
        ("/evaluation/records", vec![json!(false)]),
        (
            "/variation",
            vec![
                json!({ "stretch": 1.0, "nodes": 0.3 }),
                json!({ "gain": 1.0, "misalignment": 45.0 }),
                json!({ "damping": 1e-300 }),
            ],
        ),
        ("/body/damping_ratio", vec![json!(0.0), json!(1e-300), json!(10.0), json!(1e300)]),
        ("/body/density", vec![json!(1e-6), json!(1e-3)]),
        ("/body/stiffness/shear", vec![json!(1e-9), json!(1e-300)]),
        ("/body/stiffness/bend", vec![json!(1e-9)]),
        (
            "/body/contact",
            vec![
                json!({ "cutoff_angle": 5.0, "stiffness": 1.0 }),
                json!({ "cutoff_angle": 170.0, "stiffness": 1e-3 }),
            ],
        ),
        ("/body/clamp", vec![json!([0]), json!([]), json!([0, 1, 2, 3, 5, 6, 8])]),
        ("/body/guides", vec![json!([{ "units": [4], "holds": ["x", "turn"] }])]),
        ("/body/linearised", vec![json!(true)]),
        ("/sensor_units", vec![json!([7]), json!([3, 4, 5]), json!([])]),
        ("/panel_units", vec![json!([6, 8])]),
    ]
}

fn trial(draw: &mut Draw) -> Option<TrialSpec> {
    let (mut spec, choices) = (usual(), choices());
    for _ in 0..=draw.below(5) {
        let (path, values) = &choices[draw.below(choices.len())];
        let (table, key) = path.rsplit_once('/').unwrap();
        spec.pointer_mut(table).unwrap()[key] = values[draw.below(values.len())].clone();
    }
    for (list, count) in [("/panel_units", "panels"), ("/sensor_units", "sensors")] {
        let length = spec.pointer(list).unwrap().as_array().unwrap().len().max(1);
        spec["point"][count] = json!(length);
    }
    if spec["sensors"]["search"].is_string() {
        spec["sensor_units"] = json!([]);
    }
    serde_json::from_value(spec).ok()
}

/// Runs all commands on a trial; returns the number of results.
fn ask(trial: &TrialSpec) -> usize {
    let Ok(problem) = problem(trial) else { return 0 };
    let (design, pool) = (&problem.initial, pool(1).unwrap());
    let found = run_trial(trial, None, &pool, &mut Silent);
    let answered = [
        found.is_ok(),
        bound::bound(trial, design, 1, None, 1).is_ok(),
        bound::bound(trial, design, 1, Some(1e-9), 1).is_ok(),
        place::search_placements(trial, design, 0, 1).is_ok(),
        modes::slowest(trial, design, 4).is_ok(),
        modes::responses(trial, design, 4, &[0.0, 1.0, 1e300]).is_ok(),
        operator::operator_figures(trial, design).is_ok(),
        casts::casts(trial, design, 1, None, 1, &mut |_| ()).is_ok(),
        replay::replay(trial, design, &[], 1, 1).is_ok(),
    ];
    if problem.search.is_none() && !problem.scene.panels.is_empty() {
        let forces = problem.forces(Purpose::Stimulus, 0, 2);
        let shape = [2, forces.panels, forces.instants + 1];
        let simulated = simulate::simulate(trial, design, (&shape, &forces.values), None, 1);
        let Ok(simulated) = simulated else { return answered.into_iter().filter(|is| *is).count() };
        let width = problem.shape().inputs;
        for factor in [1.0, 0.0, 1e-200, 1e200] {
            let signals: Vec<f64> = simulated.signals.iter().map(|s| factor * s).collect();
            if signals.iter().all(|s| s.is_finite()) && width == 3 * problem.scene.sensors.len() {
                for free in [&[][..], &[Parameter::Stretch, Parameter::Density]] {
                    let records = (&forces, &signals[..], 0.0);
                    Fit::of_records(&problem, design, records, free, &pool, &[], &mut |_| ());
                }
            }
        }
    }
    answered.into_iter().filter(|is| *is).count()
}

#[test]
fn questions_to_extreme_trials_are_answered_or_refused() {
    let number = |name: &str, usual: u64| std::env::var(name).map_or(usual, |text| text.parse().unwrap());
    let (first, cases) = (number("EXTREMES_SEED", 0), number("EXTREMES_CASES", 12));
    let mut answered = 0;
    for seed in first..first + cases {
        let trial = trial(&mut Draw::numbered(7, seed));
        let Some(trial) = trial else { continue };
        let begun = std::time::Instant::now();
        match catch_unwind(AssertUnwindSafe(|| ask(&trial))) {
            Ok(count) => answered += count,
            Err(_) => panic!("EXTREMES_SEED={seed}: {}", serde_json::to_string(&trial).unwrap()),
        }
        println!("{seed}: {:.2?}", begun.elapsed());
    }
    assert!(answered as u64 > cases, "{answered} results from {cases} trials starting with seed {first}");
}
