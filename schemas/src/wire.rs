//! What goes through shared memory: lives for one build, checked on connecting.
//!
//! Every worker process has an iceoryx2 domain of its own (root path and prefix), which the orchestrator creates
//! and removes as a whole. Whatever a killed worker leaves half made is therefore never met again by anybody:
//! no dead-node clean-up runs, and none is needed.

use std::time::Duration;

use iceoryx2::config::Config;
use iceoryx2::port::ReceiveError;
use iceoryx2::port::listener::ListenerWaitError;
use iceoryx2::prelude::*;
use serde::{Deserialize, Serialize};

use crate::record::{Checkpoint, StepRecord, TrialResult};

/// The iceoryx2 service variant: its ports may move between threads.
pub type Ipc = ipc_threadsafe::Service;

/// A trial of this run, by position, and which attempt at it. A message of an attempt that is no longer current is dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Lease {
    /// Position in the run's list of trials.
    pub trial: u32,
    /// Attempt, from 1, counted over all runs.
    pub attempt: u32,
}

/// What a worker is started with: the one argument of the hidden subcommand, as JSON.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Start {
    /// Root path of the worker's domain.
    pub root: String,
    /// Prefix of its shared-memory segments.
    pub prefix: String,
    /// Build of the orchestrator.
    pub build: String,
    /// Its process id.
    pub parent: u32,
    /// Added to the worker's niceness.
    pub niceness: i32,
    /// Limit of the worker's data segment (MiB); none if absent.
    pub memory_mib: Option<u64>,
    /// Instruction set of its kernels.
    pub simd: String,
}

/// To the worker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ToWorker {
    /// Do this.
    Job {
        /// Whose it is.
        lease: Lease,
        /// What is to be done: a `TrialSpec` as JSON (untagged parts of it need a self-describing format).
        work: String,
        /// Where to go on from.
        checkpoint: Option<Box<Checkpoint>>,
        /// Threads to use.
        threads: u32,
        /// Hand it back after this outer step.
        pause: Option<u32>,
        /// The trial's hash, of which the process bears the beginning as its name.
        hash: String,
    },
    /// Finish the step in progress, or save the comparison, and hand the trial back. It may come before the job, and after its
    /// end.
    Stop {
        /// Whose it is.
        lease: Lease,
    },
}

/// Declares what ends a trial numerically, with the names by which records know it.
macro_rules! causes {
    ($($(#[$doc:meta])* $cause:ident = $name:literal,)*) => {
        /// What ends a trial numerically.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        pub enum Cause {
            $($(#[$doc])* $cause,)*
        }

        impl Cause {
            /// Each of them.
            pub const ALL: &[Self] = &[$(Self::$cause),*];

            /// Its name in the database.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$cause => $name,)*
                }
            }
        }
    };
}

causes! {
    /// A sample took more steps than any reasonable scene needs.
    StepLimit = "step_limit",
    /// Its steps fell below what the clock resolves.
    StepTooSmall = "step_too_small",
    /// Its state was not a finite number. Older databases say so of every other cause, too.
    NonFinite = "non_finite",
    /// Void angles below the least allowed could not be avoided.
    ForbiddenContact = "forbidden_contact",
    /// Steps too long for the highest mode made energy of nothing.
    Unstable = "unstable",
    /// The body lost its stability while `body.compression` moved its held units.
    Buckled = "buckled",
    /// Under `body.compression` it came to rest nowhere.
    NoEquilibrium = "no_equilibrium",
    /// No unit of a hidden layer fires.
    DeadLayer = "dead_layer",
    /// The training loss grew without bound.
    Diverged = "diverged",
    /// The training loss was not a finite number.
    LossNonFinite = "loss_non_finite",
    /// The training loss left its trend.
    LossJump = "loss_jump",
    /// The gradient in the design was not finite.
    GradientNonFinite = "gradient_non_finite",
    /// The linear brain's normal matrix has no factor.
    Singular = "singular",
    /// No units are as many and as far apart as the sensors are to be.
    NowhereToSense = "nowhere_to_sense",
    /// Most readings of the initial body are at the end of the sensors' range.
    Saturated = "saturated",
}

/// Why an attempt came to no result, as the worker sees it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Trouble {
    /// The maths.
    Numerical(Cause),
    /// Validation says no.
    Rejected,
    /// A bug: the computation panicked.
    Panicked,
    /// The machine is short of something: threads, descriptors, memory, room on a disk.
    Shortage,
}

/// To the orchestrator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ToOrchestrator {
    /// The worker is there.
    Hello {
        /// Its build.
        build: String,
        /// Its process id.
        pid: u32,
    },
    /// An outer step is done.
    Step {
        /// Whose it is.
        lease: Lease,
        /// What happened.
        record: Box<StepRecord>,
        /// Where to go on from.
        checkpoint: Box<Checkpoint>,
    },
    /// The comparison at the end has come further.
    Saved {
        /// Whose it is.
        lease: Lease,
        /// Where to go on from.
        checkpoint: Box<Checkpoint>,
    },
    /// The trial is done.
    Finished {
        /// Whose it is.
        lease: Lease,
        /// The result; its arrays are taken out where they were sent apart.
        result: Box<TrialResult>,
        /// What lies in the one sample that was sent before this message; nothing was if there is none.
        arrays: Vec<ArrayHead>,
    },
    /// The attempt came to no result.
    Failed {
        /// Whose it is.
        lease: Lease,
        /// The kind of reason.
        trouble: Trouble,
        /// In words.
        detail: String,
    },
    /// The trial is handed back after `ToWorker::Stop`.
    Stopped {
        /// Whose it is.
        lease: Lease,
    },
}

/// An array of a result: the bytes `start..end` of the sample are an NPY file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArrayHead {
    /// Its name within the trial.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
    /// First byte.
    pub start: usize,
    /// Behind its last byte.
    pub end: usize,
}

/// The heartbeat: that a worker comes further with an attempt. May be lost.
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
pub struct Progress {
    /// `Lease::trial`.
    pub trial: u32,
    /// `Lease::attempt`.
    pub attempt: u32,
}

/// Longest time a worker goes without looking at its messages while idle, and the orchestrator without looking at progress.
pub const POLL: Duration = Duration::from_millis(200);
/// Messages that may wait in a direction.
const MESSAGES: usize = 16;
/// Where POSIX shared memory lives.
pub const SHARED_MEMORY: &str = "/dev/shm";
/// Results of a worker whose arrays may wait, and as many be held until they are recorded.
const ARRAYS: usize = 8;
/// Arrays of fewer bytes in all go along in the message.
pub const APART: usize = 4096;
/// First size of a message's chunk (bytes); grows on demand.
const CHUNK: usize = 16 * 1024;

/// Bytes of the file that holds what may wait of messages or arrays, where the largest has so many: all have chunks of one size, behind a head.
#[must_use]
pub fn segment(largest: usize) -> u64 {
    let chunks = MESSAGES.max(2 * ARRAYS) + 2;
    (largest.max(CHUNK).next_power_of_two() * chunks + 4096) as u64
}

/// iceoryx2's configuration of a domain. Clean-up of dead nodes is off: a domain goes as a whole.
///
/// # Errors
/// If root or prefix are no valid names for iceoryx2.
pub fn config(root: &str, prefix: &str) -> Result<Config, SemanticStringError> {
    let mut config = Config::default();
    config.global.set_root_path(&Path::new(root.as_bytes())?);
    config.global.prefix = FileName::new(prefix.as_bytes())?;
    config.global.service.cleanup_dead_nodes_on_open = false;
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.creation_timeout = Duration::from_secs(5);
    Ok(config)
}

/// A failure of the shared-memory link, with iceoryx2's own name for it.
#[derive(Debug, thiserror::Error)]
#[error("shared memory: {step} failed: {cause}")]
pub struct LinkError {
    /// What was tried.
    pub step: &'static str,
    /// What iceoryx2 says.
    pub cause: String,
}

impl LinkError {
    /// Of an iceoryx2 error.
    pub fn of<E: std::fmt::Debug>(step: &'static str) -> impl FnOnce(E) -> Self {
        move |cause| Self { step, cause: format!("{cause:?}") }
    }
}

/// A message's port factory.
type Bytes = iceoryx2::service::port_factory::publish_subscribe::PortFactory<Ipc, [u8], ()>;
/// A port factory of progress.
type Beats = iceoryx2::service::port_factory::publish_subscribe::PortFactory<Ipc, Progress, ()>;
/// A port factory of wake-ups.
type Wakes = iceoryx2::service::port_factory::event::PortFactory<Ipc>;

/// Sends messages of a direction.
pub type MessageSender = iceoryx2::port::publisher::Publisher<Ipc, [u8], ()>;
/// Receives messages of a direction.
pub type MessageReceiver = iceoryx2::port::subscriber::Subscriber<Ipc, [u8], ()>;
/// The arrays of a result in shared memory, borrowed until dropped.
pub type Sample = iceoryx2::sample::Sample<Ipc, [u8], ()>;
/// Sends progress.
pub type BeatSender = iceoryx2::port::publisher::Publisher<Ipc, Progress, ()>;
/// Receives progress.
pub type BeatReceiver = iceoryx2::port::subscriber::Subscriber<Ipc, Progress, ()>;
/// Wakes the other end.
pub type Waker = iceoryx2::port::notifier::Notifier<Ipc>;
/// Is woken.
pub type Sleeper = iceoryx2::port::listener::Listener<Ipc>;

/// The services of a worker's domain. The orchestrator creates them, the worker opens them; each limit is set here. What makes
/// a port fails where iceoryx2 cannot create it.
#[derive(Debug)]
pub struct Services {
    /// Orchestrator to worker.
    pub down: Bytes,
    /// Worker to orchestrator.
    pub up: Bytes,
    /// Arrays of results.
    pub arrays: Bytes,
    /// Heartbeat.
    pub progress: Beats,
    /// Wakes the worker.
    pub wake_worker: Wakes,
    /// Wakes the orchestrator.
    pub wake_orchestrator: Wakes,
}

/// Which end of a domain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Creates the services.
    Orchestrator,
    /// Opens them.
    Worker,
}

/// A node of a domain. Signals are nobody's business here.
///
/// # Errors
/// If iceoryx2 cannot create it.
pub fn node(config: &Config) -> Result<Node<Ipc>, LinkError> {
    NodeBuilder::new()
        .config(config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<Ipc>()
        .map_err(LinkError::of("creating a node"))
}

impl Services {
    /// Creates or opens all services of the node's domain.
    ///
    /// # Errors
    /// If one does not come about.
    pub fn new(node: &Node<Ipc>, end: End) -> Result<Self, LinkError> {
        macro_rules! service {
            ($name:literal, $builder:expr) => {{
                let builder = $builder;
                match end {
                    End::Orchestrator => builder.create().map_err(LinkError::of(concat!("creating ", $name))),
                    End::Worker => builder.open().map_err(LinkError::of(concat!("opening ", $name))),
                }?
            }};
        }
        let name = |name: &str| ServiceName::new(name).map_err(LinkError::of("naming a service"));
        macro_rules! pubsub {
            ($name:literal, $payload:ty, $buffer:expr, $borrowed:expr, $overflow:expr) => {
                service!(
                    $name,
                    node.service_builder(&name($name)?)
                        .publish_subscribe::<$payload>()
                        .max_publishers(1)
                        .max_subscribers(1)
                        .max_nodes(2)
                        .history_size(0)
                        .subscriber_max_buffer_size($buffer)
                        .subscriber_max_borrowed_samples($borrowed)
                        .enable_safe_overflow($overflow)
                )
            };
        }
        macro_rules! event {
            ($name:literal) => {
                service!(
                    $name,
                    node.service_builder(&name($name)?)
                        .event()
                        .max_nodes(2)
                        .max_listeners(1)
                        .max_notifiers(2)
                        .event_id_max_value(1)
                )
            };
        }
        Ok(Self {
            down: pubsub!("down", [u8], MESSAGES, 1, false),
            up: pubsub!("up", [u8], MESSAGES, 1, false),
            arrays: pubsub!("arrays", [u8], ARRAYS, ARRAYS, false),
            progress: pubsub!("progress", Progress, 64, 1, true),
            wake_worker: event!("wake-worker"),
            wake_orchestrator: event!("wake-orchestrator"),
        })
    }

    /// A sender of messages. A full buffer discards: the caller sees that nobody received.
    pub fn sender(service: &Bytes) -> Result<MessageSender, LinkError> {
        Self::sender_of(service, BackpressureStrategy::DiscardData, "creating a sender")
    }

    /// A sender of arrays, which are written where they are read.
    pub fn array_sender(service: &Bytes) -> Result<MessageSender, LinkError> {
        Self::sender_of(service, BackpressureStrategy::RetryUntilDelivered, "creating a sender of arrays")
    }

    fn sender_of(
        service: &Bytes,
        full: BackpressureStrategy,
        step: &'static str,
    ) -> Result<MessageSender, LinkError> {
        service
            .publisher_builder()
            .initial_max_slice_len(CHUNK)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .max_loaned_samples(1)
            .backpressure_strategy(full)
            .create()
            .map_err(LinkError::of(step))
    }

    /// A receiver of messages.
    pub fn receiver(service: &Bytes) -> Result<MessageReceiver, LinkError> {
        service.subscriber_builder().create().map_err(LinkError::of("creating a receiver"))
    }

    /// A sender of progress.
    pub fn beat_sender(service: &Beats) -> Result<BeatSender, LinkError> {
        service
            .publisher_builder()
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(LinkError::of("creating a sender of progress"))
    }

    /// A receiver of progress.
    pub fn beat_receiver(service: &Beats) -> Result<BeatReceiver, LinkError> {
        service.subscriber_builder().create().map_err(LinkError::of("creating a receiver of progress"))
    }

    /// Wakes the listener of a wake-up service.
    pub fn waker(service: &Wakes) -> Result<Waker, LinkError> {
        service.notifier_builder().create().map_err(LinkError::of("creating a waker"))
    }

    /// Waits for wake-ups.
    pub fn sleeper(service: &Wakes) -> Result<Sleeper, LinkError> {
        service.listener_builder().create().map_err(LinkError::of("creating a sleeper"))
    }
}

/// Waits for a wake-up, for `POLL` at the longest. A signal, also one that stopped the process or let it go on, ends the
/// wait early and does no harm: whoever waits looks again.
///
/// # Errors
/// If iceoryx2 cannot wait; `waiting` says for what.
pub fn sleep(sleeper: &Sleeper, waiting: &'static str) -> Result<(), LinkError> {
    match sleeper.timed_wait(|_| {}, POLL) {
        Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
        Err(error) => Err(LinkError::of(waiting)(error)),
    }
}

/// A message as bytes.
///
/// # Panics
/// Never for the types of this module: postcard refuses sequences of unknown length alone.
pub fn encode<T: Serialize>(message: &T) -> Vec<u8> {
    postcard::to_allocvec(message).expect("messages hold sequences of known length")
}

/// Copies a message into a loaned chunk and sends it. False: the buffer of the other end is full, or nobody is there.
///
/// # Errors
/// If there is no memory for it.
pub fn send(sender: &MessageSender, message: &[u8]) -> Result<bool, LinkError> {
    let chunk = sender.loan_slice_uninit(message.len()).map_err(LinkError::of("loaning a chunk"))?;
    let received = chunk.write_from_slice(message).send().map_err(LinkError::of("sending"))?;
    Ok(received > 0)
}

/// The arrays of a result, which were sent before it. Waits while the orchestrator holds as many as it may.
///
/// # Errors
/// If there are none, or not all of `heads`, or none of the held ones is let go for `patience`.
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
            Ok(None) => return Err(wrong("they were not sent".into())),
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

/// The next message, if there is one.
///
/// # Errors
/// If the connection is broken or the message is of another build.
pub fn receive<T: serde::de::DeserializeOwned>(receiver: &MessageReceiver) -> Result<Option<T>, LinkError> {
    match receiver.receive().map_err(LinkError::of("receiving"))? {
        None => Ok(None),
        Some(sample) => {
            postcard::from_bytes(sample.payload()).map(Some).map_err(LinkError::of("decoding a message"))
        }
    }
}

#[cfg(test)]
mod tests;
