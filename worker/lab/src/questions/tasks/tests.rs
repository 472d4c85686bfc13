//! Estimates on synthetic bodies.

use super::*;
use metasense_numerics::random::{Purpose, Stream};

const PANELS: usize = 3;
const INSTANTS: usize = 20;

/// Pulses of three instants, one per struck panel: (panel, first instant, height).
fn forces(pulses: &[(usize, usize, f64)]) -> Vec<f64> {
    let mut forces = vec![0.0; INSTANTS * PANELS];
    for &(panel, first, height) in pulses {
        (first..first + 3).for_each(|n| forces[n * PANELS + panel] = height);
    }
    forces
}

fn labeller() -> Labeller {
    let points = (0..PANELS).map(|k| [15.0 * k as f64, 3.0]).collect();
    Labeller { interval: 0.005, points }
}

/// 80 samples of one pulse each; signals are a random linear map of the forces, plus noise.
fn made_up(noise: f64) -> (Vec<f64>, Vec<f64>) {
    let mut stream = Stream::new(Purpose::Stimulus, 5, [0, 0]);
    let (samples, channels) = (80, INSTANTS * PANELS + 4);
    let all: Vec<f64> = (0..samples)
        .flat_map(|_| {
            let pulse = (stream.below(PANELS), stream.below(INSTANTS - 3), 0.5 + stream.uniform());
            forces(&[pulse])
        })
        .collect();
    let mixing: Vec<f64> = (0..channels * INSTANTS * PANELS).map(|_| stream.normal()).collect();
    let signals = all
        .chunks_exact(INSTANTS * PANELS)
        .flat_map(|own| {
            mixing
                .chunks_exact(own.len())
                .map(|row| row.iter().zip(own).map(|(m, f)| m * f).sum::<f64>() + noise * stream.normal())
                .collect::<Vec<_>>()
        })
        .collect();
    (signals, all)
}

fn read(noise: f64, decoded: impl Fn(&[f64]) -> Vec<f64>) -> (Vec<TaskEstimate>, Vec<Task>) {
    let (signals, forces) = made_up(noise);
    let (train, judge): (Vec<usize>, Vec<usize>) = ((0..50).collect(), (50..80).collect());
    let decoded = decoded(&forces);
    tasks(&Observations {
        signals: &signals,
        forces: &forces,
        decoded: &decoded,
        train: &train,
        judge: &judge,
        instants: INSTANTS,
        labeller: &labeller(),
    })
}

/// Labels linear in the forces are estimated well from clean signals, less well from noisy ones; known forces give exact labels.
#[test]
fn tasks_are_read_as_well_as_signals_allow() {
    let (clean, constant) = read(1e-6, <[f64]>::to_vec);
    assert_eq!(constant, [Task::Count], "every sample has one pulse");
    let (noisy, _) = read(30.0, |forces| forces.iter().map(|f| 0.5 * f).collect());
    let error = |of: &[TaskEstimate], task: Task, readout: &str| {
        let found = of.iter().find(|r| r.task == task.name() && r.readout == readout).unwrap();
        assert!(found.interval[0] <= found.error && found.error <= found.interval[1], "{found:?}");
        found.error / found.trivial
    };
    for task in [Task::Panel, Task::Position, Task::Peak, Task::Impulse, Task::Onset] {
        assert_eq!(error(&clean, task, "decoded"), 0.0, "{task:?}");
        let score = |of: &[TaskEstimate]| of.iter().find(|r| r.task == task.name()).unwrap().score;
        assert!(score(&clean) > score(&noisy), "{task:?}: {clean:?} {noisy:?}");
        let (direct, blurred) = (error(&clean, task, "direct"), error(&noisy, task, "direct"));
        assert!(direct < 0.7 && blurred > direct, "{task:?}: {direct} {blurred}");
    }
    // 50 records for 60 unknowns: almost determined.
    assert!(error(&clean, Task::Impulse, "direct") < 0.35);
    // Halved forces keep place and time, and have half the height.
    assert_eq!(error(&noisy, Task::Panel, "decoded") + error(&noisy, Task::Onset, "decoded"), 0.0);
    assert!(error(&noisy, Task::Impulse, "decoded") > 0.1);
    // Halved forces have a quarter of the squares as error.
    let of_forces = [&clean, &noisy].map(|of| (of[0].task.0, of[0].error));
    assert_eq!(of_forces, [("forces", 0.0), ("forces", 25.0)]);
}

/// From signals without information the error is that of the trivial estimate, even with more signals than samples.
#[test]
fn noise_is_not_read() {
    let (_, forces) = made_up(1.0);
    let mut stream = Stream::new(Purpose::Holdout, 6, [0, 0]);
    let signals: Vec<f64> = (0..80 * 400).map(|_| stream.normal()).collect();
    let (train, judge): (Vec<usize>, Vec<usize>) = ((0..50).collect(), (50..80).collect());
    let (found, _) = tasks(&Observations {
        signals: &signals,
        forces: &forces,
        decoded: &forces,
        train: &train,
        judge: &judge,
        instants: INSTANTS,
        labeller: &labeller(),
    });
    for reading in found.iter().filter(|r| r.readout == "direct" && r.task.1 != "%") {
        assert!(reading.error < 1.25 * reading.trivial, "{reading:?}");
    }
}
