//! A trial without computation, to measure and test the engine. Steps have a known duration. The result depends on each step,
//! so that lost, repeated or swapped steps are detected.

use std::time::{Duration, Instant};

use metasense_numerics::Heartbeat;
use metasense_schemas::reason::Cause;
use metasense_schemas::record::{BodyRecord, Checkpoint, NetworkRecord, StepRecord, TrialResult};
use metasense_worker::run::{LoopControl, NoResult, ObserveTrial};
use serde::{Deserialize, Serialize};

/// The job of a no-op trial.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Noop {
    /// Outer steps.
    pub steps: u32,
    /// Duration of a step (ms).
    pub millis: u32,
    /// Length of the result's array; 0: none.
    pub array: u64,
    /// Seed of the result.
    pub seed: u64,
    /// Fault, if any.
    pub fault: Option<Fault>,
}

/// A fault.
#[derive(Debug, Clone, Copy, Serialize, Deserialize, clap::ValueEnum)]
pub enum Fault {
    /// A step never ends and sends no sign of life.
    Hang,
    /// The worker aborts at once.
    Die,
    /// The result is not finite.
    NonFinite,
    /// The trial is rejected.
    Reject,
    /// The machine lacks a resource.
    Short,
}

/// Runs the trial from its start or a checkpoint, as `metasense_worker::process::Perform`.
pub fn perform(
    job: &str,
    checkpoint: Option<Checkpoint>,
    _threads: usize,
    _heartbeat: Heartbeat,
    observer: &mut dyn ObserveTrial,
) -> Result<TrialResult, NoResult> {
    let noop: Noop = serde_json::from_str(job).map_err(|error| NoResult::Rejected(error.to_string()))?;
    let step_length = Duration::from_millis(noop.millis.into());
    let mut state =
        checkpoint.unwrap_or_else(|| Checkpoint { design: vec![mixed(noop.seed)], ..Default::default() });
    match noop.fault {
        Some(Fault::Reject) => return Err(NoResult::Rejected("a no-op trial that is to be refused".into())),
        Some(Fault::Short) => {
            return Err(NoResult::Shortage("of what a no-op trial is to be short of".into()));
        }
        Some(Fault::Hang) => loop {
            std::thread::park();
        },
        Some(Fault::Die) => {
            let _ = std::io::Write::write_all(&mut std::io::stderr(), b"a no-op trial that is to die\n");
            std::process::abort()
        }
        Some(Fault::NonFinite) => {
            let detail = "a no-op trial that is to fail".into();
            return Err(NoResult::Numerical { cause: Cause::NonFinite, detail });
        }
        None => {}
    }
    while state.step < noop.steps {
        let began = Instant::now();
        while began.elapsed() < step_length {
            std::thread::sleep(step_length.saturating_sub(began.elapsed()).min(Duration::from_millis(20)));
            observer.progress();
        }
        let step = state.step;
        state.design[0] = mixed(state.design[0].to_bits() ^ u64::from(step));
        state.step += 1;
        let record = StepRecord {
            step,
            error_test: Some(100.0 * state.design[0]),
            projection: "untouched".into(),
            outcome: "ok".into(),
            ..Default::default()
        };
        if observer.step(record, state.clone()) == LoopControl::Stop && state.step < noop.steps {
            return Err(NoResult::Stopped);
        }
    }
    let evaluation = |design: f64, array: u64| BodyRecord {
        design: std::iter::once(design).chain((0..array).map(|n| (noop.seed + n) as f64)).collect(),
        networks: vec![NetworkRecord {
            error_test: Some(100.0 * design),
            error_holdout: Some(100.0 * design),
            outcome: "ok".into(),
            ..Default::default()
        }],
        ..Default::default()
    };
    Ok(TrialResult {
        initial: evaluation(mixed(noop.seed), 0),
        optimised: evaluation(state.design[0], noop.array),
        best_step: noop.steps,
        simd: "none".into(),
        solver: "none".into(),
        ..Default::default()
    })
}

/// SplitMix64's finaliser, as a number in [0, 1).
fn mixed(x: u64) -> f64 {
    let mut z = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}
