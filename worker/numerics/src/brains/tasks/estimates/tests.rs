//! Estimates on synthetic bodies.

use super::*;
use crate::random::{Purpose, Stream};

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

/// 50 training and 30 test samples.
fn read_from(signals: &[f64], forces: &[f64], decoded: impl Fn(&[f64]) -> Vec<f64>) -> Vec<TaskEstimate> {
    let observed = |samples: std::ops::Range<usize>| {
        let of = |values: &[f64]| {
            let one = values.len() / 80;
            values[samples.start * one..samples.end * one].to_vec()
        };
        let none = vec![0; samples.len()];
        Observations { signals: of(signals), starts: none.clone(), forces: of(forces), parts: none }
    };
    let (known, test) = (observed(0..50), observed(50..80));
    tasks(&Fits::new(&known, INSTANTS, &labeller(), None), &test, &decoded(&test.forces))
}

fn read(noise: f64, decoded: impl Fn(&[f64]) -> Vec<f64>) -> Vec<TaskEstimate> {
    let (signals, forces) = made_up(noise);
    read_from(&signals, &forces, decoded)
}

/// Labels linear in the forces are estimated well from clean signals, less well from noisy ones; known forces give exact labels.
#[test]
fn tasks_are_read_as_well_as_signals_allow() {
    let clean = read(1e-6, <[f64]>::to_vec);
    let constant = [SensingTask::Count, SensingTask::Kind].map(SensingTask::name);
    assert!(clean.iter().all(|r| !constant.contains(&r.task)), "every sample has one pulse of one kind");
    let noisy = read(30.0, |forces| forces.iter().map(|f| 0.5 * f).collect());
    let error = |of: &[TaskEstimate], task: SensingTask, readout: &str| {
        let found = of.iter().find(|r| r.task == task.name() && r.readout == readout).unwrap();
        assert!(found.interval[0] <= found.error && found.error <= found.interval[1], "{found:?}");
        found.error / found.trivial
    };
    for task in [
        SensingTask::Panel,
        SensingTask::Position,
        SensingTask::Peak,
        SensingTask::Impulse,
        SensingTask::Onset,
    ] {
        assert_eq!(error(&clean, task, "decoded"), 0.0, "{task:?}");
        let score = |of: &[TaskEstimate]| of.iter().find(|r| r.task == task.name()).unwrap().score;
        assert!(score(&clean) > score(&noisy), "{task:?}: {clean:?} {noisy:?}");
        let (direct, blurred) = (error(&clean, task, "direct"), error(&noisy, task, "direct"));
        assert!(direct < 0.7 && blurred > direct, "{task:?}: {direct} {blurred}");
    }
    // 50 records for 60 unknowns: almost determined.
    assert!(error(&clean, SensingTask::Impulse, "direct") < 0.35);
    // Halved forces keep place and time, and have half the height.
    assert_eq!(
        error(&noisy, SensingTask::Panel, "decoded") + error(&noisy, SensingTask::Onset, "decoded"),
        0.0
    );
    assert!(error(&noisy, SensingTask::Impulse, "decoded") > 0.1);
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
    let found = read_from(&signals, &forces, <[f64]>::to_vec);
    for reading in found.iter().filter(|r| r.readout == "direct" && r.task.1 != "%") {
        assert!(reading.error < 1.25 * reading.trivial, "{reading:?}");
    }
}

/// The detail of a class counts all samples, the wrong ones off the diagonal; that of a position averages to the error.
#[test]
fn details_sum_to_the_errors() {
    let found = read(30.0, <[f64]>::to_vec);
    for estimate in &found {
        let weighted =
            |of: fn(&[f64; 3]) -> f64| estimate.detail.iter().map(|row| row[2] * of(row)).sum::<f64>();
        let samples = estimate.samples as f64;
        let error = match estimate.task.0 {
            "panel" => 100.0 * weighted(|row| f64::from(u8::from(row[0] != row[1]))) / samples,
            "position" => weighted(|row| row[1]) / samples,
            _ => {
                assert!(estimate.detail.is_empty());
                continue;
            }
        };
        assert_eq!(weighted(|_| 1.0), samples);
        assert!((error - estimate.error).abs() < 1e-9, "{estimate:?}");
    }
    assert_eq!(found.iter().filter(|estimate| !estimate.detail.is_empty()).count(), 4);
}
