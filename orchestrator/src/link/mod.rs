//! The orchestrator's side of iceoryx2: one domain per worker process, and a thread that reads from it.
//!
//! The thread forwards messages to a tokio channel. Nothing waits for the thread without a time limit: if iceoryx2 hangs in the
//! domain of a killed process, the run continues.

mod runtime;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use metasense_schemas::wire::{
    self, BackpressureStrategy, BeatReceiver, DomainEnd, Lease, LinkError, MessageReceiver, MessageSender,
    Sample, Services, Sleeper, ToOrchestrator, ToWorker, Waker,
};
use metasense_worker::process::check_shared_memory;
use tokio::sync::mpsc::Sender;

pub use runtime::{Domain, Runtime, RuntimeError, SHARED_MEMORY};

use crate::scheduler::WorkerId;

/// Longest wait for the database writer to release arrays.
const HOLD_MAX: Duration = Duration::from_secs(60);

/// An event from a worker's link.
#[derive(Debug)]
pub enum LinkEvent {
    /// The domain exists: the process may start.
    Open,
    /// A message with all arrays that belong to it.
    Message(Box<ToOrchestrator>, Option<Sample>),
    /// A sign of life.
    Beat(Lease),
    /// The link failed.
    Broken(LinkError),
    /// After `Channel::close`: everything sent has been read, and the domain is removed.
    Closed,
}

/// The link to a worker.
#[derive(Debug)]
pub struct WorkerChannel {
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    closing: AtomicBool,
    ports: Mutex<Option<Ports>>,
}

#[derive(Debug)]
struct Ports {
    down: MessageSender,
    wake_worker: Waker,
    wake_self: Waker,
}

impl WorkerChannel {
    /// Creates the domain on a new thread, which sends the link's events to `words`.
    pub fn open(
        domain: Domain,
        worker: WorkerId,
        words: Sender<(WorkerId, LinkEvent)>,
    ) -> std::io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let theirs = Arc::clone(&shared);
        std::thread::Builder::new().name(format!("link-{worker}")).spawn(move || {
            let say = |word| words.blocking_send((worker, word)).is_ok();
            if let Err(error) = read(&domain, &theirs, &say) {
                say(LinkEvent::Broken(error));
            }
            theirs.ports.lock().unwrap_or_else(PoisonError::into_inner).take();
            domain.remove();
            say(LinkEvent::Closed);
        })?;
        Ok(Self { shared })
    }

    /// Sends without waiting. Returns false if the worker does not read.
    pub fn send(&self, message: &ToWorker) -> Result<bool, LinkError> {
        match &*self.shared.ports.lock().unwrap_or_else(PoisonError::into_inner) {
            None => Ok(false),
            Some(ports) => {
                let bytes = wire::encode(message);
                check_shared_memory(bytes.len())?;
                let sent = wire::send(&ports.down, &bytes)?;
                // If the wake-up fails, the worker's polling finds the message.
                let _ = ports.wake_worker.notify();
                Ok(sent)
            }
        }
    }

    /// Tells the thread to read the rest and end. Call this only after the process has ended.
    pub fn close(&self) {
        self.shared.closing.store(true, Ordering::Release);
        if let Some(ports) = &*self.shared.ports.lock().unwrap_or_else(PoisonError::into_inner) {
            let _ = ports.wake_self.notify();
        }
    }
}

struct Receivers {
    up: MessageReceiver,
    arrays: MessageReceiver,
    beats: BeatReceiver,
    sleeper: Sleeper,
}

/// Creates the domain, and reads from it until told to end.
fn read(domain: &Domain, shared: &Shared, say: &dyn Fn(LinkEvent) -> bool) -> Result<(), LinkError> {
    std::fs::create_dir(&domain.root).map_err(LinkError::of("making the domain's directory"))?;
    let services = Services::new(&domain.root.to_string_lossy(), &domain.prefix, DomainEnd::Orchestrator)?;
    let receivers = Receivers {
        up: Services::receiver(&services.up)?,
        arrays: Services::receiver(&services.arrays)?,
        beats: Services::beat_receiver(&services.progress)?,
        sleeper: Services::sleeper(&services.wake_orchestrator)?,
    };
    let ports = Ports {
        down: Services::sender(&services.down, BackpressureStrategy::DiscardData)?,
        wake_worker: Services::waker(&services.wake_worker)?,
        wake_self: Services::waker(&services.wake_orchestrator)?,
    };
    *shared.ports.lock().unwrap_or_else(PoisonError::into_inner) = Some(ports);
    let mut heard = say(LinkEvent::Open);
    while heard {
        // Loaded before reading, so that everything sent before `close` is read below.
        let closing = shared.closing.load(Ordering::Acquire);
        heard = receivers.read_all(say)?;
        if closing {
            break;
        }
        wire::sleep(&receivers.sleeper, "waiting for a worker")?;
    }
    Ok(())
}

impl Receivers {
    /// Forwards all pending beats and messages. False: nothing receives them any more.
    fn read_all(&self, say: &dyn Fn(LinkEvent) -> bool) -> Result<bool, LinkError> {
        let mut beat = None;
        while let Some(sample) = self.beats.receive().map_err(LinkError::of("receiving progress"))? {
            beat = Some(*sample);
        }
        if let Some(beat) = beat
            && !say(LinkEvent::Beat(beat))
        {
            return Ok(false);
        }
        while let Some(message) = wire::receive::<ToOrchestrator>(&self.up)? {
            let arrays = match &message {
                ToOrchestrator::Finished(.., arrays) if !arrays.is_empty() => {
                    Some(wire::receive_arrays(&self.arrays, arrays, HOLD_MAX)?)
                }
                _ => None,
            };
            if !say(LinkEvent::Message(Box::new(message), arrays)) {
                return Ok(false);
            }
        }
        Ok(true)
    }
}
