//! One trial on the reference scene without any orchestrator: `trial optimise.protocol=joint sweep.sensors=2 …`.
//!
//! Keys are those of the spec, values JSON; prints a line a step with the CPU seconds so far, then the comparison.
//! Decides what a protocol or an integrator costs and gains.

use metasense_numerics::body::Layout;
use metasense_schemas::record::{Checkpoint, StepRecord};
use metasense_schemas::spec::{Brain, Evaluation, Feasible, Optimise, Sensors, Solver, Time, TrialSpec};
use metasense_worker::course::cpu_seconds;
use metasense_worker::run::{Control, Observe, run_trial};
use serde_json::{Value, json};

fn main() {
    let mut spec = json!({
        "body": {
            "columns": 6, "rows": 6, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
            "stiffness": { "stretch": 3.0, "shear": 0.5, "bend": 1.0 },
        },
        "time": Time::default(),
        "solver": Solver::default(),
        "sensors": Sensors::default(),
        "stimuli": { "kind": "bell" },
        "brain": Brain::default(),
        "optimise": Optimise::default(),
        "evaluation": Evaluation::default(),
        "feasible": Feasible::default(),
        "point": { "panels": 2, "sensors": 1, "placement": 0, "seed": 1 },
        "panel_units": [], "sensor_units": [],
    });
    let (mut threads, mut every) = (1, 10);
    for argument in std::env::args().skip(1) {
        let (key, value) = argument.split_once('=').expect("key=value");
        let value: Value = serde_json::from_str(value).unwrap_or_else(|_| Value::from(value));
        match key {
            "threads" => threads = value.as_u64().expect("a number") as usize,
            "every" => every = value.as_u64().expect("a number") as u32,
            _ => {
                let path = format!("/{}", key.replace("sweep", "point").replace('.', "/"));
                let (parent, name) = path.rsplit_once('/').expect("a path");
                spec.pointer_mut(parent).expect("a key of the spec")[name] = value;
            }
        }
    }
    let whole = |path: &str| spec.pointer(path).and_then(Value::as_u64).expect("a number") as usize;
    let (columns, rows, panels, sensors) =
        (whole("/body/columns"), whole("/body/rows"), whole("/point/panels"), whole("/point/sensors"));
    let layout = Layout::planar(columns, rows, 15.0, 2.25);
    let mut placement = layout.placement(whole("/point/placement") as u64, &layout.bottom());
    placement.truncate(sensors);
    if (columns, rows, sensors) == (6, 6, 1) {
        placement = vec![21];
    }
    spec["panel_units"] = json!(Layout::planar_panels(columns, rows, panels).expect("so many panels"));
    spec["sensor_units"] = json!(placement);
    let trial: TrialSpec = serde_json::from_value(spec).expect("a spec");

    let mut printer = Printer { every, last: trial.optimise.steps() as u32 - 1, spent: [0.0; 5] };
    let start = cpu_seconds();
    match run_trial(&trial, None, threads, &mut printer) {
        Err(failure) => println!("{failure}"),
        Ok(result) => {
            for (name, body) in [("initial", &result.initial), ("optimised", &result.optimised)] {
                for network in &body.networks {
                    let show = |e: Option<f64>| e.map_or("-".into(), |e| format!("{e:.2}"));
                    println!(
                        "{name}: error % train {} test {} holdout {}  loss {:.5}",
                        show(network.error_train),
                        show(network.error_test),
                        show(network.error_holdout),
                        network.losses.last().copied().unwrap_or(f32::NAN),
                    );
                }
            }
            println!(
                "best step {}, evaluation {:.1} s, CPU {:.1} s",
                result.best_step,
                result.seconds_evaluation,
                cpu_seconds() - start
            );
        }
    }
}

struct Printer {
    every: u32,
    last: u32,
    spent: [f64; 5],
}

impl Observe for Printer {
    fn progress(&mut self, _: f64) {}

    fn step(&mut self, record: StepRecord, _: Checkpoint) -> Control {
        let s = &record.seconds;
        for (sum, part) in
            self.spent.iter_mut().zip([s.simulate, s.train, s.differentiate, s.implicit, s.project])
        {
            *sum += part;
        }
        if record.step.is_multiple_of(self.every) || record.step == self.last {
            println!(
                "{:4} cpu {:6.1}  train {:.5}  test {:6.2} %  |g| {:.2e} |da| {:.3} {} {:.3}  {}  [{}]",
                record.step,
                cpu_seconds(),
                record.loss_train.unwrap_or(f64::NAN),
                record.error_test.unwrap_or(f64::NAN),
                record.gradient_norm.unwrap_or(f64::NAN),
                record.step_length.unwrap_or(f64::NAN),
                record.projection,
                record.projection_distance.unwrap_or(f64::NAN),
                record.outcome,
                self.spent.map(|s| format!("{s:.1}")).join(" "),
            );
        }
        Control::Continue
    }
}
