//! A trial without maths, to measure and to test the engine: steps of a known length, and a result that depends
//! on every one of them, so that a step lost, repeated or out of order shows.

use std::time::{Duration, Instant};

use metasense_schemas::record::{BodyEvaluation, Checkpoint, NetworkEvaluation, StepRecord, TrialResult};
use metasense_schemas::wire::Fault;

use crate::run::{Control, Failure, Observe};

/// What a no-op trial is.
#[derive(Debug, Clone, Copy)]
pub struct Noop {
    /// Outer steps.
    pub steps: u32,
    /// Length of a step.
    pub step_length: Duration,
    /// Makes results differ.
    pub seed: u64,
    /// What goes wrong, if anything.
    pub fault: Option<Fault>,
}

/// Runs it from a checkpoint or from the start.
///
/// # Errors
/// What its fault asks for, or a stop.
pub fn run(
    noop: &Noop,
    checkpoint: Option<Checkpoint>,
    observer: &mut dyn Observe,
) -> Result<TrialResult, Failure> {
    let mut state =
        checkpoint.unwrap_or_else(|| Checkpoint { design: vec![mixed(noop.seed)], ..Default::default() });
    match noop.fault {
        Some(Fault::Reject) => return Err(Failure::Rejected("a no-op trial that is to be refused".into())),
        Some(Fault::Hang) => loop {
            std::thread::park();
        },
        Some(Fault::Die) => {
            let _ = std::io::Write::write_all(&mut std::io::stderr(), b"a no-op trial that is to die\n");
            std::process::abort()
        }
        Some(Fault::NonFinite) => return Err(Failure::NonFinite("a no-op trial that is to fail".into())),
        None => {}
    }
    while state.step < noop.steps {
        let began = Instant::now();
        while began.elapsed() < noop.step_length {
            std::thread::sleep(
                (noop.step_length - began.elapsed().min(noop.step_length)).min(Duration::from_millis(20)),
            );
            observer.progress(f64::from(state.step) / f64::from(noop.steps));
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
        if observer.step(record, state.clone()) == Control::Stop && state.step < noop.steps {
            return Err(Failure::Stopped);
        }
    }
    let evaluation = |design: f64| BodyEvaluation {
        design: vec![design],
        networks: vec![NetworkEvaluation {
            error_test: Some(100.0 * design),
            error_holdout: Some(100.0 * design),
            outcome: "ok".into(),
            ..Default::default()
        }],
        ..Default::default()
    };
    Ok(TrialResult {
        initial: evaluation(mixed(noop.seed)),
        optimised: evaluation(state.design[0]),
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
