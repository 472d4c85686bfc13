//! Estimates of other quantities than force histories from a body's signals.

use metasense_numerics::brains::RECORDS_MIN;
pub use metasense_numerics::brains::Task;
use metasense_numerics::stimuli::targets;
use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::Failure;

use crate::prepare::prepared;
pub use crate::questions::tasks::TaskEstimate;
use crate::questions::tasks::{Observations, tasks as read};
use crate::replay::{linear, replay};

/// Estimates, on the held-out set, of the forces and of the tasks whose labels vary among the training samples; and the other tasks.
///
/// # Errors
/// If the spec is invalid, the design has the wrong length or cannot be simulated, or there are too few samples.
pub fn tasks(
    trial: &TrialSpec,
    design: &[f64],
    threads: usize,
) -> Result<(Vec<TaskEstimate>, Vec<Task>), Failure> {
    let replay = replay(trial, design, &[], 0, threads)?;
    let rejected = |why: &str| Failure::Rejected(why.to_owned());
    let Some(decoder) = linear(trial, &replay)? else {
        return Err(rejected(
            "the linear decoder of these signals is too large: use fewer sensors or instants",
        ));
    };
    let (panels, channels) = (replay.forces.panels, replay.signal_scale.len());
    let samples = replay.split.len();
    let instants = replay.signals.len() / (samples * channels);
    let forces = targets(&replay.forces, instants, false);
    let signals: Vec<f64> = replay
        .signals
        .chunks_exact(channels)
        .flat_map(|all| {
            all.iter().zip(&replay.signal_scale).map(|(x, scale)| x / scale.max(f64::MIN_POSITIVE))
        })
        .collect();
    let len = instants * panels;
    let has_force = |i: &usize| forces[i * len..][..len].iter().any(|f| *f != 0.0);
    let of = |set: u8| -> Vec<usize> {
        (0..samples).filter(|&i| replay.split[i] == set && !replay.failed[i]).filter(has_force).collect()
    };
    let (train, judge) = (of(0), of(2));
    if train.len() < RECORDS_MIN || judge.len() < RECORDS_MIN {
        return Err(rejected("stimuli.samples and stimuli.holdout: tasks need ten samples with force each"));
    }
    let labeller = &prepared(trial)?.labeller();
    let (signals, forces, decoded) = (&signals[..], &forces[..], &decoder.predictions[..]);
    let (train, judge) = (&train[..], &judge[..]);
    Ok(read(&Observations { signals, forces, decoded, train, judge, instants, labeller }))
}
