//! Messages between orchestrator and workers in shared memory. Both must be of the same build, which they check on connecting.
//!
//! Every worker process has its own iceoryx2 domain (root path and prefix), which the orchestrator creates and removes as a
//! whole. Leftovers of a killed worker disappear with it, so that no clean-up of dead nodes is needed.

use std::time::Duration;

use iceoryx2::config::Config;
use iceoryx2::port::ReceiveError;
use iceoryx2::port::listener::ListenerWaitError;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
pub use iceoryx2::prelude::BackpressureStrategy;
use iceoryx2::prelude::*;
use serde::{Deserialize, Serialize};

use crate::reason::Reason;
use crate::record::{Checkpoint, StepRecord, TrialResult};

/// The iceoryx2 service variant: its ports may move between threads.
pub type Ipc = ipc_threadsafe::Service;

/// A trial of this run and an attempt at it. Messages of attempts that are not current are dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ZeroCopySend)]
#[repr(C)]
pub struct Lease {
    /// Position in the run's list of trials.
    pub trial: u32,
    /// Attempt, from 1, counted over all runs.
    pub attempt: u32,
}

/// Settings of a worker: the argument of the hidden subcommand, as JSON.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkerStart {
    /// Root path of the worker's domain.
    pub root: String,
    /// Prefix of its shared-memory segments.
    pub prefix: String,
    /// Build of the orchestrator.
    pub build: String,
    /// Process id of the orchestrator.
    pub parent: u32,
    /// Added to the worker's niceness.
    pub niceness: i32,
    /// Limit of the worker's data segment (MiB); `None`: no limit.
    pub memory_mib: Option<u64>,
    /// Instruction set of the kernels.
    pub simd: String,
}

/// Message to a worker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ToWorker {
    /// Run a trial.
    Job {
        /// The attempt.
        lease: Lease,
        /// The `TrialSpec` as JSON, because its untagged parts need a self-describing format.
        work: String,
        /// State from which to resume.
        checkpoint: Option<Box<Checkpoint>>,
        /// Number of threads.
        threads: u32,
        /// Outer step after which to return the trial.
        pause: Option<u32>,
        /// Hash of the trial; the process name contains its beginning.
        hash: String,
    },
    /// Finish the current step, or save the comparison, and return the trial. May arrive before the job or after its end.
    Stop(Lease),
}

/// Message to the orchestrator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ToOrchestrator {
    /// The worker has started.
    Hello {
        /// Build of the worker.
        build: String,
        /// Process id of the worker.
        pid: u32,
    },
    /// An outer step is done; with its record, and the state from which to resume.
    Step(Lease, Box<StepRecord>, Box<Checkpoint>),
    /// A part of the final comparison is done; with the state from which to resume.
    Saved(Lease, Box<Checkpoint>),
    /// The trial is done; with its result, and the arrays in the sample that was sent before this message (none: no sample).
    Finished(Lease, Box<TrialResult>, Vec<ArrayHead>),
    /// The attempt failed; with the reason and a description.
    Failed(Lease, Reason, String),
    /// The trial is returned after `ToWorker::Stop`.
    Stopped(Lease),
}

/// An array of a result: the bytes `start..end` of the sample are an NPY file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArrayHead {
    /// Name within the trial.
    pub name: String,
    /// Shape.
    pub shape: Vec<usize>,
    /// First byte.
    pub start: usize,
    /// End (exclusive).
    pub end: usize,
}

/// Longest interval at which an idle worker checks for messages, and the orchestrator for progress.
pub const POLL: Duration = Duration::from_millis(200);
/// Number of messages that may be queued per direction.
const MESSAGES: usize = 16;
/// Folder of POSIX shared memory.
pub const SHARED_MEMORY: &str = "/dev/shm";
/// Number of results per worker whose arrays may be queued; as many may be held until they are recorded.
const ARRAYS: usize = 8;
/// Arrays of fewer bytes in total are sent within the message.
pub const INLINE_LIMIT: usize = 4096;
/// Initial size of a message chunk (bytes); grows on demand.
const CHUNK: usize = 16 * 1024;

/// Returns the size (bytes) of the file of a queue whose largest entry has `largest` bytes: chunks of one size after a header.
pub fn segment(largest: usize) -> u64 {
    let chunks = MESSAGES.max(2 * ARRAYS) + 2;
    (largest.max(CHUNK).next_power_of_two() * chunks + 4096) as u64
}

/// A failure of the shared-memory link.
#[derive(Debug, thiserror::Error)]
#[error("shared memory: {step} failed: {cause}")]
pub struct LinkError {
    /// The operation.
    pub step: &'static str,
    /// iceoryx2's name of the error.
    pub cause: String,
}

impl LinkError {
    /// Converts an error of iceoryx2.
    pub fn of<E: std::fmt::Debug>(step: &'static str) -> impl FnOnce(E) -> Self {
        move |cause| Self { step, cause: format!("{cause:?}") }
    }
}

/// Service that sends messages or progress.
type Channel<T> = iceoryx2::service::port_factory::publish_subscribe::PortFactory<Ipc, T, ()>;
/// Service that sends wake-ups.
type Wakes = iceoryx2::service::port_factory::event::PortFactory<Ipc>;

/// Sends messages.
pub type MessageSender = Publisher<Ipc, [u8], ()>;
/// Receives messages.
pub type MessageReceiver = Subscriber<Ipc, [u8], ()>;
/// The arrays of a result in shared memory, borrowed until dropped.
pub type Sample = iceoryx2::sample::Sample<Ipc, [u8], ()>;
/// Sends progress.
pub type BeatSender = Publisher<Ipc, Lease, ()>;
/// Receives progress.
pub type BeatReceiver = Subscriber<Ipc, Lease, ()>;
/// Wakes the other end.
pub type Waker = iceoryx2::port::notifier::Notifier<Ipc>;
/// Waits for wake-ups.
pub type Sleeper = iceoryx2::port::listener::Listener<Ipc>;

/// The services of a worker's domain, with their limits. The orchestrator creates them, the worker opens them. Functions that
/// create a port fail if iceoryx2 cannot create it.
#[derive(Debug)]
pub struct Services {
    /// Messages to the worker.
    pub down: Channel<[u8]>,
    /// Messages to the orchestrator.
    pub up: Channel<[u8]>,
    /// Arrays of results.
    pub arrays: Channel<[u8]>,
    /// Heartbeat: the attempt with which a worker has made progress. May be lost.
    pub progress: Channel<Lease>,
    /// Wakes the worker.
    pub wake_worker: Wakes,
    /// Wakes the orchestrator.
    pub wake_orchestrator: Wakes,
}

/// End of a domain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DomainEnd {
    /// Creates the services.
    Orchestrator,
    /// Opens the services.
    Worker,
}

impl Services {
    /// Creates or opens all services of a domain, given by its root path and the prefix of its segments. Clean-up of dead nodes
    /// is off, because a domain is removed as a whole. So are signal handling and log, whose messages concern killed processes.
    pub fn new(root: &str, prefix: &str, end: DomainEnd) -> Result<Self, LinkError> {
        set_log_level(LogLevel::Fatal);
        let naming = "naming the domain";
        let mut config = Config::default();
        config.global.set_root_path(&Path::new(root.as_bytes()).map_err(LinkError::of(naming))?);
        config.global.prefix = FileName::new(prefix.as_bytes()).map_err(LinkError::of(naming))?;
        config.global.service.cleanup_dead_nodes_on_open = false;
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.creation_timeout = Duration::from_secs(5);
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Ipc>()
            .map_err(LinkError::of("creating a node"))?;
        macro_rules! service {
            ($name:literal, $($builder:tt)+) => {{
                let name = ServiceName::new($name).map_err(LinkError::of("naming a service"))?;
                let builder = node.service_builder(&name).$($builder)+.max_nodes(2);
                match end {
                    DomainEnd::Orchestrator => builder.create().map_err(LinkError::of(concat!("creating ", $name))),
                    DomainEnd::Worker => builder.open().map_err(LinkError::of(concat!("opening ", $name))),
                }?
            }};
        }
        macro_rules! pubsub {
            ($name:literal, $payload:ty, $buffer:expr, $borrowed:expr, $overflow:expr) => {
                service!(
                    $name,
                    publish_subscribe::<$payload>()
                        .max_publishers(1)
                        .max_subscribers(1)
                        .history_size(0)
                        .subscriber_max_buffer_size($buffer)
                        .subscriber_max_borrowed_samples($borrowed)
                        .enable_safe_overflow($overflow)
                )
            };
        }
        macro_rules! event {
            ($name:literal) => {
                service!($name, event().max_listeners(1).max_notifiers(2).event_id_max_value(1))
            };
        }
        Ok(Self {
            down: pubsub!("down", [u8], MESSAGES, 1, false),
            up: pubsub!("up", [u8], MESSAGES, 1, false),
            arrays: pubsub!("arrays", [u8], ARRAYS, ARRAYS, false),
            progress: pubsub!("progress", Lease, 64, 1, true),
            wake_worker: event!("wake-worker"),
            wake_orchestrator: event!("wake-orchestrator"),
        })
    }

    /// Creates a sender of messages. If the buffer is `full`, it waits, or discards the message and [`send`] returns false.
    pub fn sender(service: &Channel<[u8]>, full: BackpressureStrategy) -> Result<MessageSender, LinkError> {
        service
            .publisher_builder()
            .initial_max_slice_len(CHUNK)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .max_loaned_samples(1)
            .backpressure_strategy(full)
            .create()
            .map_err(LinkError::of("creating a sender"))
    }

    /// Creates a receiver of messages.
    pub fn receiver(service: &Channel<[u8]>) -> Result<MessageReceiver, LinkError> {
        service.subscriber_builder().create().map_err(LinkError::of("creating a receiver"))
    }

    /// Creates a receiver of progress.
    pub fn beat_receiver(service: &Channel<Lease>) -> Result<BeatReceiver, LinkError> {
        service.subscriber_builder().create().map_err(LinkError::of("creating a receiver of progress"))
    }

    /// Creates a sender of progress.
    pub fn beat_sender(service: &Channel<Lease>) -> Result<BeatSender, LinkError> {
        service
            .publisher_builder()
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(LinkError::of("creating a sender of progress"))
    }

    /// Creates the notifier of a wake-up service.
    pub fn waker(service: &Wakes) -> Result<Waker, LinkError> {
        service.notifier_builder().create().map_err(LinkError::of("creating a waker"))
    }

    /// Creates the listener of a wake-up service.
    pub fn sleeper(service: &Wakes) -> Result<Sleeper, LinkError> {
        service.listener_builder().create().map_err(LinkError::of("creating a sleeper"))
    }
}

/// Waits for a wake-up, at most `POLL`. A signal ends the wait early, which is harmless: callers check their condition again.
/// `waiting` names the operation in errors.
pub fn sleep(sleeper: &Sleeper, waiting: &'static str) -> Result<(), LinkError> {
    match sleeper.timed_wait(|_| {}, POLL) {
        Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
        Err(error) => Err(LinkError::of(waiting)(error)),
    }
}

/// Encodes a message: postcard rejects only sequences of unknown length, which the types of this module do not contain.
pub fn encode<T: Serialize>(message: &T) -> Vec<u8> {
    postcard::to_allocvec(message).expect("messages hold sequences of known length")
}

/// Copies a message into a loaned chunk and sends it. Returns false if the receiver's buffer is full or there is no receiver.
pub fn send(sender: &MessageSender, message: &[u8]) -> Result<bool, LinkError> {
    let chunk = sender.loan_slice_uninit(message.len()).map_err(LinkError::of("loaning a chunk"))?;
    let received = chunk.write_from_slice(message).send().map_err(LinkError::of("sending"))?;
    Ok(received > 0)
}

/// Receives the arrays of a result, which were sent before it. Waits while the orchestrator holds the maximum number.
/// Fails if no arrays were sent, `heads` do not fit them, or no held sample is released within `patience`.
pub fn receive_arrays(
    receiver: &MessageReceiver,
    heads: &[ArrayHead],
    patience: Duration,
) -> Result<Sample, LinkError> {
    let wrong = |cause: String| LinkError { step: "receiving the arrays of a result", cause };
    let mut waited = Duration::ZERO;
    loop {
        match receiver.receive() {
            Err(ReceiveError::ExceedsMaxBorrows) if waited < patience => {
                let pause = Duration::from_millis(1);
                std::thread::sleep(pause);
                waited += pause;
            }
            Err(error) => return Err(wrong(format!("{error:?}"))),
            Ok(None) => return Err(wrong("the arrays were not sent".into())),
            Ok(Some(sample)) => {
                let len = sample.payload().len();
                let beyond = |head: &&ArrayHead| head.start > head.end || head.end > len;
                return match heads.iter().find(beyond) {
                    None => Ok(sample),
                    Some(head) => Err(wrong(format!("{head:?} does not lie within {len} bytes"))),
                };
            }
        }
    }
}

/// Receives the next message, if there is one.
pub fn receive<T: serde::de::DeserializeOwned>(receiver: &MessageReceiver) -> Result<Option<T>, LinkError> {
    let Some(sample) = receiver.receive().map_err(LinkError::of("receiving"))? else { return Ok(None) };
    postcard::from_bytes(sample.payload()).map(Some).map_err(LinkError::of("decoding a message"))
}

#[cfg(test)]
mod tests;
