//! CPU seconds in the records of a trial. A separate test binary, because the clock measures the whole process.

use std::time::{Duration, Instant};

use metasense_schemas::record::{Checkpoint, StepRecord};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::{LoopControl, ObserveTrial, pool, run_trial};
use serde_json::json;

/// Sleeps after each step, like a worker that waits for a core or the database.
#[derive(Default)]
struct Sleeper {
    recorded: f64,
    beats: usize,
    by_step: Vec<usize>,
}

const NAP: Duration = Duration::from_millis(150);

impl ObserveTrial for Sleeper {
    fn progress(&mut self) -> LoopControl {
        self.beats += 1;
        std::thread::sleep(NAP / 10);
        LoopControl::Continue
    }

    fn save(&mut self, _: Checkpoint) {}

    fn step(&mut self, record: StepRecord, _: Checkpoint) -> LoopControl {
        let s = record.seconds;
        self.recorded += s.simulate + s.train + s.differentiate + s.implicit + s.project + s.store;
        self.by_step.push(self.beats);
        std::thread::sleep(NAP);
        LoopControl::Continue
    }
}

/// Three steps of some milliseconds, each followed by 0.15 s of sleep: the record contains the CPU time only.
#[test]
fn a_trials_seconds_are_those_of_the_cpu_and_not_of_the_wall_clock() {
    let trial: TrialSpec = serde_json::from_value(json!({
        "body": {
            "columns": 4, "rows": 3, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
            "stiffness": { "stretch": 3.0, "shear": 0.5, "bend": 1.0 },
        },
        "time": { "duration": 0.05, "samples": 20 },
        "solver": {}, "sensors": {}, "evaluation": {}, "feasible": {},
        "stimuli": { "kind": "bell", "samples": 6, "test": 2, "holdout": 2, "onset": [0.0, 0.02] },
        "brain": { "iterations": 3 },
        "optimise": { "protocol": "joint", "iterations": 3, "batch": 4 },
        "point": { "panels": 2, "sensors": 1, "placement": 0, "seed": 1 },
        "panel_units": [9, 10], "sensor_units": [5],
    }))
    .unwrap();
    let (began, mut sleeper) = (Instant::now(), Sleeper::default());
    let result = run_trial(&trial, None, &pool(1).unwrap(), &mut sleeper).unwrap();
    let (wall, recorded) = (began.elapsed().as_secs_f64(), sleeper.recorded + result.seconds_evaluation);
    assert!(recorded > 0.0, "{recorded} s recorded");
    // progress is reported within every step, not only at its end
    let within = |steps: &[usize]| steps[1] - steps[0];
    assert!(sleeper.by_step.windows(2).all(|steps| within(steps) >= 4), "{:?}", sleeper.by_step);
    assert!(recorded < wall - 2.9 * NAP.as_secs_f64(), "{recorded} s recorded, wall clock {wall} s");
}
