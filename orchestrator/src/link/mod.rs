//! The orchestrator's end of iceoryx2: for every worker process a domain, and a thread that reads from it.
//!
//! The thread turns messages into words on a tokio channel. It is never waited for without a time limit: should
//! iceoryx2 not return from a domain in which a process was killed, the run goes on without it.

mod runtime;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use metasense_schemas::wire::{
    self, BeatReceiver, End, LinkError, MessageReceiver, MessageSender, Progress, Sample, Services, Sleeper,
    ToOrchestrator, ToWorker, Waker,
};
use metasense_worker::process::make_room;
use tokio::sync::mpsc::Sender;

pub use runtime::{Domain, Runtime, RuntimeError, SHARED_MEMORY, remove_stale};

use crate::scheduler::WorkerId;

/// Longest wait for the writer to let arrays go.
const HOLD_MAX: Duration = Duration::from_secs(60);

/// What comes from a worker's link.
#[derive(Debug)]
pub enum Word {
    /// The domain is there: the process may start.
    Open,
    /// A message, with the arrays that belong to it; they are all there.
    Message(Box<ToOrchestrator>, Option<Sample>),
    /// A sign of life.
    Beat(Progress),
    /// The link does not work.
    Broken(LinkError),
    /// After `Line::close`: everything that was sent has been read, and the domain is gone.
    Closed,
}

/// The link to a worker.
#[derive(Debug)]
pub struct Line {
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

impl Line {
    /// Makes the domain on a thread of its own, from which words come.
    pub fn open(domain: Domain, worker: WorkerId, words: Sender<(WorkerId, Word)>) -> std::io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let theirs = Arc::clone(&shared);
        std::thread::Builder::new().name(format!("link-{worker}")).spawn(move || {
            let say = |word| words.blocking_send((worker, word)).is_ok();
            if let Err(error) = read(&domain, &theirs, &say) {
                say(Word::Broken(error));
            }
            theirs.ports.lock().unwrap_or_else(PoisonError::into_inner).take();
            domain.remove();
            say(Word::Closed);
        })?;
        Ok(Self { shared })
    }

    /// Sends; never waits. False: the worker does not read.
    ///
    /// # Errors
    /// If there is no room in shared memory for it.
    pub fn send(&self, message: &ToWorker) -> Result<bool, LinkError> {
        match &*self.shared.ports.lock().unwrap_or_else(PoisonError::into_inner) {
            None => Ok(false),
            Some(ports) => {
                let bytes = wire::encode(message);
                make_room(bytes.len())?;
                let sent = wire::send(&ports.down, &bytes)?;
                // A wake-up that fails is made good by the worker's own polling.
                let _ = ports.wake_worker.notify();
                Ok(sent)
            }
        }
    }

    /// Asks the thread to read what is left, and to end. Only once the process is gone.
    pub fn close(&self) {
        self.shared.closing.store(true, Ordering::Release);
        if let Some(ports) = &*self.shared.ports.lock().unwrap_or_else(PoisonError::into_inner) {
            let _ = ports.wake_self.notify();
        }
    }
}

/// The receiving ends.
struct Receivers {
    up: MessageReceiver,
    arrays: MessageReceiver,
    beats: BeatReceiver,
    sleeper: Sleeper,
}

/// Makes the domain, and reads from it until told to end.
fn read(domain: &Domain, shared: &Shared, say: &dyn Fn(Word) -> bool) -> Result<(), LinkError> {
    // Its errors come back as values; what it says besides is about processes that were killed.
    iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Fatal);
    std::fs::create_dir(&domain.root).map_err(LinkError::of("making the domain's directory"))?;
    let config = wire::config(&domain.root.to_string_lossy(), &domain.prefix)
        .map_err(LinkError::of("naming the domain"))?;
    let node = wire::node(&config)?;
    let services = Services::new(&node, End::Orchestrator)?;
    let receivers = Receivers {
        up: Services::receiver(&services.up)?,
        arrays: Services::receiver(&services.arrays)?,
        beats: Services::beat_receiver(&services.progress)?,
        sleeper: Services::sleeper(&services.wake_orchestrator)?,
    };
    let ports = Ports {
        down: Services::sender(&services.down)?,
        wake_worker: Services::waker(&services.wake_worker)?,
        wake_self: Services::waker(&services.wake_orchestrator)?,
    };
    *shared.ports.lock().unwrap_or_else(PoisonError::into_inner) = Some(ports);
    let mut heard = say(Word::Open);
    while heard {
        // Asked before reading: what was sent until then is read below.
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
    /// False: nobody listens any more.
    fn read_all(&self, say: &dyn Fn(Word) -> bool) -> Result<bool, LinkError> {
        let mut beat = None;
        while let Some(sample) = self.beats.receive().map_err(LinkError::of("receiving progress"))? {
            beat = Some(*sample);
        }
        if let Some(beat) = beat
            && !say(Word::Beat(beat))
        {
            return Ok(false);
        }
        while let Some(message) = wire::receive::<ToOrchestrator>(&self.up)? {
            let arrays = match &message {
                ToOrchestrator::Finished { arrays, .. } if !arrays.is_empty() => {
                    Some(wire::receive_arrays(&self.arrays, arrays, HOLD_MAX)?)
                }
                _ => None,
            };
            if !say(Word::Message(Box::new(message), arrays)) {
                return Ok(false);
            }
        }
        Ok(true)
    }
}
