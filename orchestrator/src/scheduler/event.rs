//! What may happen in a run, and what is to be done.

use metasense_schemas::reason::Reason;
use metasense_schemas::wire::Lease;

use super::{Answer, Millis, Steer, WorkerId};

/// What passes through the scheduler unread.
pub trait Payload {
    /// An outer step.
    type Step;
    /// A checkpoint behind the last step.
    type Saved;
    /// A result.
    type Result;
    /// Who has given a command, and waits for the answer.
    type Asker;
}

/// What may happen.
#[derive(Debug, Clone, PartialEq)]
pub enum Event<P: Payload> {
    /// Time has passed.
    Clock(Millis),
    /// A worker has said hello.
    Up(WorkerId),
    /// A sign of life.
    Beat(WorkerId, Lease),
    /// An outer step is done; whether it was the last one.
    Step(WorkerId, Lease, bool, P::Step),
    /// The comparison at the end of the trial has come further.
    Saved(WorkerId, Lease, P::Saved),
    /// The trial is done.
    Finished(WorkerId, Lease, P::Result),
    /// The attempt came to no result; the worker goes on.
    Failed(WorkerId, Lease, Reason),
    /// A worker is gone, and everything it said has been read.
    Lost(WorkerId, Reason),
    /// What an action asked to record is on disk.
    Recorded(Lease, Mark),
    /// Nothing can be recorded any more.
    StoreBroken,
    /// A person wants the run to end.
    Interrupt,
    /// A person gives a command.
    Steer(Steer, P::Asker),
}

/// What was recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// A step, or a checkpoint behind the last one.
    Step,
    /// A result.
    Result,
    /// The end of an attempt without one.
    Failure,
}

/// What is to be done.
#[derive(Debug, Clone, PartialEq)]
pub enum Action<P: Payload> {
    /// Start this worker process.
    Spawn(WorkerId),
    /// Record that the attempt begins, and give the trial to the worker, from its last checkpoint.
    Assign(WorkerId, Lease),
    /// Record a step.
    RecordStep(Lease, P::Step),
    /// Record how far the comparison has come.
    RecordCheckpoint(Lease, P::Saved),
    /// Record a result.
    RecordResult(Lease, P::Result),
    /// Record that the attempt came to nothing; `settled`: and so did the trial.
    RecordFailure {
        /// Which attempt.
        lease: Lease,
        /// Why.
        reason: Reason,
        /// No further attempt follows.
        settled: bool,
    },
    /// Record that a trial which waits is not to be run.
    RecordCancelled(Lease),
    /// Tell a person what came of the command.
    Answer(P::Asker, Answer),
    /// Ask for the trial back after the step in progress, or in the middle of the comparison.
    AskStop(WorkerId),
    /// End the process in order.
    Close(WorkerId),
    /// End the process at once.
    Kill(WorkerId),
    /// A message came of an attempt that is not current.
    CountStale(Lease),
    /// The run is over.
    End(Outcome),
}

/// How a run ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Every trial is settled.
    Complete,
    /// By request.
    Interrupted,
    /// Nothing could be recorded any more.
    StoreBroken,
    /// No worker process comes up.
    NoWorkers,
    /// Trials die on this machine one after the other without a step, the last one for this.
    Unfit(Reason),
}
