//! Opens, starts, observes and ends worker processes and their links. A process counts as lost when it has ended and all its
//! messages are read.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use metasense_schemas::reason::Reason;
use metasense_schemas::wire::{Lease, LinkError, WorkerStart};
use metasense_worker::limits::{self, Needs};
use metasense_worker::{process, simd};
use tokio::sync::mpsc::Sender;

use super::{Engine, Events};
use crate::fleet::{Fleet, ProcessEvent};
use crate::link::{LinkEvent, Runtime, WorkerChannel};
use crate::scheduler::{Event, WorkerId};
use crate::store::LogLevel;

/// Longest wait for the link of an ended process; later messages are lost.
const LINK_GRACE: Duration = Duration::from_millis(700);

/// Process and link of a worker, from the creation of its domain until both have ended.
#[derive(Debug)]
pub(super) struct Link {
    pub line: WorkerChannel,
    pub started: bool,
    /// The process must not be started.
    pub cancelled: bool,
    pub ended: Option<(Reason, Instant)>,
    /// Why we killed the process, if its exit status does not show it.
    pub why: Option<Reason>,
    pub closed: bool,
}

/// Worker processes and their links.
#[derive(Debug)]
pub(super) struct Workers {
    // Declared before `runtime`: processes must end before the directory that they use is removed.
    pub fleet: Fleet,
    pub links: HashMap<WorkerId, Link>,
    pub runtime: Runtime,
    pub link_sender: Sender<(WorkerId, LinkEvent)>,
    /// Last lease of each worker.
    pub leases: HashMap<WorkerId, Lease>,
    /// Error messages of attempts that have not ended.
    pub details: HashMap<Lease, String>,
    /// The last error of a worker that has no trial.
    pub last_words: String,
}

impl Engine<'_> {
    /// Creates the domain of a worker, whose process starts when the domain exists.
    pub(super) fn open(&mut self, worker: WorkerId, events: &mut Events) {
        let needs = Needs { workers: 1, threads: self.options.threads, files: &[] };
        let line = limits::check(&needs).map_err(|short| short.to_string()).and_then(|()| {
            WorkerChannel::open(self.workers.runtime.domain(worker), worker, self.workers.link_sender.clone())
                .map_err(|error| error.to_string())
        });
        match line {
            Ok(line) => {
                let (started, cancelled, closed) = (false, false, false);
                let link = Link { line, started, cancelled, ended: None, why: None, closed };
                self.workers.links.insert(worker, link);
            }
            Err(error) => self.misfire(worker, error, events),
        }
    }

    /// Prevents the start of a worker whose domain is still being created.
    pub(super) fn cancel(&mut self, worker: WorkerId) {
        if let Some(link) = self.workers.links.get_mut(&worker)
            && !link.started
        {
            link.cancelled = true;
        }
    }

    pub(super) fn broken(&mut self, worker: WorkerId, error: &LinkError) {
        tracing::error!(%worker, %error, "the link to the worker failed; killing the worker");
        self.workers.last_words = error.to_string();
        self.cancel(worker);
        self.workers.fleet.kill(worker);
    }

    pub(super) fn start(&mut self, worker: WorkerId, events: &mut Events) {
        let Some(link) = self.workers.links.get_mut(&worker) else { return };
        if link.cancelled {
            link.line.close();
            return;
        }
        let domain = self.workers.runtime.domain(worker);
        let start = WorkerStart {
            root: domain.root.to_string_lossy().into_owned(),
            prefix: domain.prefix,
            build: process::build(),
            parent: std::process::id(),
            niceness: self.options.niceness,
            memory_mib: self.options.memory_mib,
            simd: simd::name().into(),
        };
        link.started = true;
        if let Err(error) = self.workers.fleet.spawn(worker, &start) {
            if let Some(link) = self.workers.links.remove(&worker) {
                link.line.close();
            }
            self.misfire(worker, error.to_string(), events);
        }
    }

    pub(super) fn misfire(&mut self, worker: WorkerId, error: String, events: &mut Events) {
        tracing::error!(%worker, error, "a worker could not be started");
        self.workers.last_words = error;
        events.push_back(Event::Lost(worker, Reason::WorkerExited(-1)));
    }

    pub(super) fn heard(&mut self, worker: WorkerId, heard: ProcessEvent, events: &mut Events) {
        match heard {
            // The line belongs to the current or last trial of the worker.
            ProcessEvent::Line(line) => match self.workers.leases.get(&worker) {
                Some(lease) => {
                    // the first line gives the error, later ones the location
                    if !line.is_empty() {
                        self.workers.details.entry(*lease).or_insert_with(|| line.clone());
                    }
                    self.writer.pending_log.push((*lease, LogLevel::Warn, line));
                }
                None => self.workers.last_words = line,
            },
            ProcessEvent::End(reason) => {
                if let Some(link) = self.workers.links.get_mut(&worker) {
                    link.ended = Some((reason, Instant::now()));
                    link.line.close();
                }
                self.lost(worker, events);
            }
        }
    }

    /// Removes a worker whose process has ended and whose messages are all read.
    pub(super) fn lost(&mut self, worker: WorkerId, events: &mut Events) {
        let Some(link) = self.workers.links.get(&worker) else { return };
        let reason = match link.ended {
            Some((reason, at)) if link.closed || at.elapsed() > LINK_GRACE => link.why.unwrap_or(reason),
            None if link.closed && !link.started => Reason::WorkerExited(-1),
            _ => return,
        };
        if !link.closed {
            tracing::error!(%worker, "the link of a dead worker does not close; continuing without it");
        }
        if self.workers.last_words.is_empty() {
            self.workers.last_words = reason.to_string();
        }
        tracing::info!(%worker, %reason, "worker ended");
        self.workers.links.remove(&worker);
        self.workers.leases.remove(&worker);
        self.workers.fleet.forget(worker);
        events.push_back(Event::Lost(worker, reason));
    }
}
