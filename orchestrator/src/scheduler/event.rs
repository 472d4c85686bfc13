//! Events of a run and actions in response.

use metasense_schemas::reason::Reason;
use metasense_schemas::wire::Lease;

use super::{Millis, Steer, SteerAnswer, WorkerId};

/// Types of the data that the scheduler passes on unread.
pub trait Payload {
    /// Record of an outer step.
    type Step;
    /// Checkpoint after the last step.
    type Saved;
    /// Result of a trial.
    type Result;
    /// Sender of a command, who waits for the answer.
    type Asker;
}

/// An event of a run.
#[derive(Debug, Clone, PartialEq)]
pub enum Event<P: Payload> {
    /// Time has passed.
    Clock(Millis),
    /// A worker is ready.
    Up(WorkerId),
    /// A sign of life of a busy worker.
    Beat(WorkerId, Lease),
    /// An outer step is done; `true`: it was the last.
    Step(WorkerId, Lease, bool, P::Step),
    /// A checkpoint of the final evaluation.
    Saved(WorkerId, Lease, P::Saved),
    /// The trial is done.
    Finished(WorkerId, Lease, P::Result),
    /// The attempt failed; the worker continues.
    Failed(WorkerId, Lease, Reason),
    /// A worker has ended, and all its messages have been read.
    Lost(WorkerId, Reason),
    /// A record is on disk.
    Recorded(Lease, RecordKind),
    /// The database fails.
    StoreBroken,
    /// A person requests the end of the run.
    Interrupt,
    /// A person sends a command.
    Steer(Steer, P::Asker),
}

/// Kind of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordKind {
    /// A step, or a checkpoint of the final evaluation.
    Step,
    /// A result.
    Result,
    /// A failed attempt.
    Failure,
}

/// An action that the engine must carry out.
#[derive(Debug, Clone, PartialEq)]
pub enum Action<P: Payload> {
    /// Start this worker process.
    Spawn(WorkerId),
    /// Record the start of the attempt, and give the trial with its last checkpoint to the worker.
    Assign(WorkerId, Lease),
    /// Record a step.
    RecordStep(Lease, P::Step),
    /// Record a checkpoint of the final evaluation.
    RecordCheckpoint(Lease, P::Saved),
    /// Record a result.
    RecordResult(Lease, P::Result),
    /// Record a failed attempt.
    RecordFailure {
        /// The attempt.
        lease: Lease,
        /// The reason.
        reason: Reason,
        /// Whether the trial has failed, too: no further attempt follows.
        settled: bool,
    },
    /// Record that a pending trial is cancelled.
    RecordCancelled(Lease),
    /// Answer a command.
    Answer(P::Asker, SteerAnswer),
    /// Tell the worker to stop its trial after the step in progress, or within the final evaluation.
    AskStop(WorkerId),
    /// End the process in order.
    Close(WorkerId),
    /// Kill the process.
    Kill(WorkerId),
    /// Count a message with an outdated lease.
    CountStale(Lease),
    /// The run is over.
    End(RunOutcome),
}

/// How a run ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunOutcome {
    /// Every trial has ended.
    Complete,
    /// Stopped on request.
    Interrupted,
    /// The database failed.
    StoreBroken,
    /// No worker process starts.
    NoWorkers,
    /// The machine is unfit: trials die one after another without a step, or a shortage lasts. The last reason.
    Unfit(Reason),
}
