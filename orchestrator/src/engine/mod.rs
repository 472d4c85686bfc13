//! The main loop of a run: turns messages, deaths, signals, commands and time into events for the scheduler, and carries out
//! its actions.
//!
//! The scheduler decides; fleet (processes), link (shared memory) and writer (database) act. A result counts, and is shown,
//! once it is on disk.

mod begin;
mod clock;
mod database;
mod links;
mod spent;
mod steer;
mod watch;
mod writer;

use std::borrow::Cow;
use std::collections::{HashMap, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use metasense_schemas::reason::Reason;
use metasense_schemas::record::{Checkpoint, StepRecord, TrialResult};
use metasense_schemas::wire::{Lease, Sample, ToOrchestrator, ToWorker};
use metasense_worker::limits::{self, Needs, Shortage};
use metasense_worker::process;
use tokio::sync::mpsc;

pub use begin::{RerunPolicy, begin, reopen};
pub use watch::{Silent, View, Watch};

use begin::Bodies;
use clock::Clock;
use database::{Files, WriterLink};
use links::Workers;
use spent::Ledger;
use steer::PendingRequest;

use crate::control::Control;
use crate::exit::remedy;
use crate::files::host;
use crate::fleet::Fleet;
use crate::link::{LinkEvent, Runtime, RuntimeError};
use crate::plan::PlannedTrial;
use crate::provenance;
use crate::scheduler::{
    self, Action, Event, Payload, Phase, Prior, RecordKind, RunOutcome, SchedulerState, Settings, WorkerId,
};
use crate::signals::Signals;
use crate::sql;
use crate::store::{LogLevel, Store, StoreError};
use writer::{Entry, QueuedRecord, ResultArrays, WriterEvent};

/// Time between two checks of deadlines and updates of the view.
const TICK: Duration = Duration::from_millis(200);
/// Capacity of the channels of link events and of records for the writer.
const QUEUE: usize = 512;

/// Default wait for steps in progress when a run is stopped (s), short because a person may be waiting.
pub const GRACE: f64 = 10.0;

/// Options of a run.
#[derive(Debug, Clone)]
pub struct Options {
    /// Settings of the scheduler.
    pub settings: Settings,
    /// Threads per worker.
    pub threads: u32,
    /// Added to the niceness of workers.
    pub niceness: i32,
    /// Memory limit per worker (MiB).
    pub memory_mib: Option<u64>,
    /// The program that contains the hidden `worker` subcommand.
    pub program: PathBuf,
}

/// Result of a run.
#[derive(Debug, Clone)]
pub struct Summary {
    /// How it ended.
    pub outcome: RunOutcome,
    /// Whether a stop was requested.
    pub stopping: bool,
    /// Messages of outdated attempts.
    pub stale: usize,
    /// Trials by how they ended, and the workers at the end.
    pub view: View,
}

/// Why a run failed.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// No directory in shared memory.
    #[error(transparent)]
    Runtime(#[from] RuntimeError),
    /// The limits of the machine are too low for the workers.
    #[error("the limits of {host} are too low for the workers; no trial was started: raise the limit or use fewer workers, then run the same command again", host = host())]
    Short(#[from] Shortage),
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// No worker starts.
    #[error("no worker process starts on {host}; the last one: {0}", host = host())]
    NoWorkers(String),
}

/// Runs trials until all have ended or a stop is requested. `control` receives commands.
///
/// `work` returns the job of a trial in the form that workers read. Call this from the main thread, because workers die with
/// the thread that started them.
pub async fn run<'a>(
    store: &mut Store,
    trials: &[&'a PlannedTrial],
    work: &'a dyn Fn(&PlannedTrial) -> String,
    options: &'a Options,
    signals: &mut Signals,
    control: &'a Control,
    watch: &'a mut dyn Watch,
) -> Result<Summary, EngineError> {
    let settings = &options.settings;
    let workers = settings.workers.min(trials.len() as u32);
    limits::check(&Needs { workers, threads: options.threads, files: &[store.path()] })?;
    let (priors, bodies) = begin::priors(store, trials).await?;
    let state = SchedulerState::new(settings.clone(), &priors);
    let mut view = View::new(settings.workers, settings.paused);
    trials.iter().zip(&priors).for_each(|(trial, prior)| begin::show(&mut view, trial, prior));
    store.set_provenance(provenance::this_machine(options.threads));
    let (files, runtime) = (Files::new(store.presence()), Runtime::new()?);
    let (heard_out, mut process_events) = mpsc::channel(QUEUE);
    let (link_sender, mut link_receiver) = mpsc::channel(QUEUE);
    let (queue, entries) = mpsc::channel(QUEUE);
    let (writer_events, mut written) = mpsc::unbounded_channel();
    let hashes = trials.iter().map(|trial| trial.hash.clone()).collect();
    // Runs on this task: arrays in shared memory may move between threads, but must not be shared by two.
    let writing = writer::write(store, hashes, entries, writer_events);
    let (rereads, mut reads) = mpsc::unbounded_channel();
    let mut ticks = tokio::time::interval(TICK);
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);

    let trials = trials.iter().map(|trial| Cow::Borrowed(*trial)).collect();
    let mut engine = Engine {
        state,
        agenda: Agenda { trials, priors, bodies, work },
        options,
        clock: Clock::start(),
        workers: Workers {
            fleet: Fleet::new(options.program.clone(), heard_out),
            links: HashMap::new(),
            runtime,
            link_sender,
            leases: HashMap::new(),
            last_words: String::new(),
            details: HashMap::new(),
        },
        writer: WriterLink { queue, files, error: None, pending_log: Vec::new() },
        view,
        spent: Ledger::new(),
        stale: 0,
        control,
        rereads,
        watch,
    };
    let running = async move {
        let mut events = VecDeque::new();
        let outcome = loop {
            tokio::select! {
                // While the writer waits for a lock, messages of workers are left in their channel once the queue is half full. The loop
                // never blocks, so signals are still handled.
                Some((worker, word)) = link_receiver.recv(), if engine.has_room() => engine.word(worker, word, &mut events),
                Some((worker, process_events)) = process_events.recv() => engine.heard(worker, process_events, &mut events),
                Some(word) = written.recv() => engine.written(word, &mut events),
                Some(()) = signals.next() => engine.interrupt(&mut events),
                Some(request) = control.next() => engine.handle_command(request, &mut events),
                Some(read) = reads.recv() => engine.read(read).await,
                _ = ticks.tick() => engine.tick(&mut events),
            }
            if let Some(outcome) = engine.carry_out(&mut events).await {
                break outcome;
            }
        };
        let Engine { view, state, stale, writer, workers, watch, .. } = engine;
        watch.end(&view, outcome);
        match (outcome, writer.error) {
            (_, Some(error)) => Err(error.into()),
            (RunOutcome::NoWorkers, None) => Err(EngineError::NoWorkers(workers.last_words)),
            _ => Ok(Summary { outcome, stopping: state.is_stopping(), stale, view }),
        }
    };
    tokio::join!(writing, running).1
}

/// Types of the records that the scheduler passes on unread.
#[derive(Debug)]
enum Records {}

impl Payload for Records {
    type Step = (Box<StepRecord>, Arc<Checkpoint>);
    type Saved = Arc<Checkpoint>;
    type Result = (Box<TrialResult>, Option<ResultArrays>);
    type Asker = PendingRequest;
}

struct Engine<'a> {
    state: SchedulerState,
    agenda: Agenda<'a>,
    options: &'a Options,
    clock: Clock,
    workers: Workers,
    writer: WriterLink,
    view: View,
    spent: Ledger,
    stale: usize,
    control: &'a Control,
    rereads: mpsc::UnboundedSender<steer::ReloadResult>,
    watch: &'a mut dyn Watch,
}

/// Trials of the run, what was done of them before, and how their jobs are written.
struct Agenda<'a> {
    trials: Vec<Cow<'a, PlannedTrial>>,
    priors: Vec<Prior>,
    bodies: Bodies,
    work: &'a dyn Fn(&PlannedTrial) -> String,
}

impl Agenda<'_> {
    fn trial(&self, lease: Lease) -> &PlannedTrial {
        &self.trials[lease.trial as usize]
    }
}

type Events = VecDeque<Event<Records>>;

impl Engine<'_> {
    /// Whether the writer's queue is less than half full.
    fn has_room(&self) -> bool {
        self.writer.queue.capacity() > QUEUE / 2
    }

    /// Passes the events to the scheduler and carries out its actions. Returns the outcome when the run is over.
    async fn carry_out(&mut self, events: &mut Events) -> Option<RunOutcome> {
        let now = self.clock.look();
        let mut actions: VecDeque<_> = scheduler::on_event(&mut self.state, Event::Clock(now)).into();
        loop {
            self.record_said().await;
            while let Some(action) = actions.pop_front() {
                if let Some(outcome) = self.act(action, events).await {
                    return Some(outcome);
                }
            }
            actions = scheduler::on_event(&mut self.state, events.pop_front()?).into();
        }
    }

    /// Carries out an action. Returns the outcome if the run ends.
    async fn act(&mut self, action: Action<Records>, events: &mut Events) -> Option<RunOutcome> {
        match action {
            Action::End(outcome) => return Some(outcome),
            Action::Spawn(worker) => self.open(worker, events),
            Action::Assign(worker, lease) => {
                self.workers.leases.insert(worker, lease);
                self.spent.begin(lease, worker, &self.workers.fleet);
                self.record(QueuedRecord::Begin(lease)).await;
                self.view.forecast.assigned(lease.trial, self.clock.elapsed());
                let prior = self.agenda.priors[lease.trial as usize];
                if prior.steps.is_some() || self.agenda.bodies.begun.contains(&prior.body) {
                    let pause = self.agenda.trial(lease).pause;
                    self.record(QueuedRecord::Load(worker, lease, pause)).await;
                } else {
                    self.view.forecast.goes_on(lease.trial, 0, true);
                    self.send_job(worker, lease, None);
                }
            }
            Action::RecordStep(lease, (record, checkpoint)) => {
                let prior = &mut self.agenda.priors[lease.trial as usize];
                prior.steps = Some(checkpoint.step);
                self.agenda.bodies.begun.insert(prior.body);
                self.view.steps += 1;
                self.view.forecast.stepped(lease.trial, self.clock.elapsed());
                self.record_spent(lease).await;
                self.record(QueuedRecord::Step(lease, record, checkpoint)).await;
            }
            Action::RecordResult(lease, (result, arrays)) => {
                self.workers.details.remove(&lease);
                // counts as done once it is on disk
                self.view.forecast.returned(lease.trial, true, self.clock.elapsed());
                self.view.forecast.settled(lease.trial);
                self.record_spent(lease).await;
                self.spent.end(lease);
                self.record(QueuedRecord::Result(lease, result, arrays)).await;
            }
            Action::RecordCheckpoint(lease, checkpoint) => {
                self.record_spent(lease).await;
                self.record(QueuedRecord::Checkpoint(lease, checkpoint)).await;
            }
            Action::RecordFailure { lease, reason, settled } => {
                let trial = self.agenda.trial(lease);
                self.view.attempt_failed(lease.trial, reason, settled, self.clock.elapsed());
                let (hash, attempt) = (&trial.hash, lease.attempt);
                let in_order = matches!(reason, Reason::Stopped | Reason::Paused);
                match reason {
                    _ if in_order => {
                        tracing::debug!(hash, attempt, %reason, "the trial was stopped on request")
                    }
                    Reason::Cancelled if settled => {
                        tracing::info!(hash, attempt, %reason, "the trial was cancelled")
                    }
                    _ if settled => {
                        tracing::error!(hash, attempt, %reason, remedy = remedy(reason), "the trial has failed");
                    }
                    _ => tracing::warn!(hash, attempt, %reason, "the attempt failed; the trial is retried"),
                }
                let text = match self.workers.details.remove(&lease) {
                    Some(detail) => format!("{reason}: {detail}"),
                    None => reason.to_string(),
                };
                let level = if reason == Reason::Cancelled { LogLevel::Info } else { LogLevel::Error };
                if !in_order {
                    self.watch.attempt_failed(trial, lease.attempt, reason, settled, &text);
                    self.record(QueuedRecord::Log(lease, level, text)).await;
                }
                self.record_spent(lease).await;
                self.spent.end(lease);
                self.record(QueuedRecord::Failure(lease, reason, settled && reason != Reason::Paused)).await;
            }
            Action::RecordCancelled(lease) => {
                let trial = self.agenda.trial(lease);
                self.view.attempt_failed(lease.trial, Reason::Cancelled, true, self.clock.elapsed());
                tracing::info!(trial.hash, "the trial was cancelled before an attempt");
                self.record(QueuedRecord::Cancelled(lease)).await;
            }
            Action::Answer(asker, answer) => self.answered(asker, answer),
            Action::AskStop(worker) => {
                if let (Some(link), Some(&lease)) =
                    (self.workers.links.get(&worker), self.workers.leases.get(&worker))
                    && !link.line.send(&ToWorker::Stop(lease)).is_ok_and(|sent| sent)
                {
                    self.workers.fleet.kill(worker);
                }
            }
            Action::Close(worker) => {
                self.cancel(worker);
                self.workers.fleet.close(worker);
            }
            Action::Kill(worker) => {
                self.cancel(worker);
                self.workers.fleet.kill(worker);
            }
            Action::CountStale(lease) => {
                self.stale += 1;
                tracing::info!(lease.trial, lease.attempt, "dropped a message of an outdated attempt");
            }
        }
        None
    }

    async fn record(&mut self, write: QueuedRecord) {
        self.enqueue(Entry::Write(write)).await;
    }

    /// Queues an entry; waits while the queue is full. Does nothing after the store has failed.
    async fn enqueue(&mut self, entry: Entry) {
        if self.writer.error.is_none() {
            let _ = self.writer.queue.send(entry).await;
        }
    }

    async fn record_said(&mut self) {
        for (lease, level, text) in std::mem::take(&mut self.writer.pending_log) {
            self.record(QueuedRecord::Log(lease, level, text)).await;
        }
        if self.has_room() {
            for lease in std::mem::take(&mut self.spent.due) {
                self.record_spent(lease).await;
            }
        }
    }

    async fn record_spent(&mut self, lease: Lease) {
        if let Some(seconds) = self.spent.grown_seconds(lease, &self.workers.fleet) {
            self.record(QueuedRecord::Spent(lease, seconds)).await;
        }
    }

    fn send_job(&mut self, worker: WorkerId, lease: Lease, checkpoint: Option<Checkpoint>) {
        let trial = self.agenda.trial(lease);
        let (work, hash, pause) = ((self.agenda.work)(trial), trial.hash.clone(), trial.pause);
        let (checkpoint, threads) = (checkpoint.map(Box::new), self.options.threads);
        let job = ToWorker::Job { lease, work, checkpoint, threads, pause, hash };
        let Some(link) = self.workers.links.get_mut(&worker) else { return };
        match link.line.send(&job) {
            Ok(true) => {}
            Ok(false) => {
                tracing::error!(%worker, "the worker does not read its messages; killing it");
                self.workers.fleet.kill(worker);
            }
            Err(error) => {
                tracing::error!(%worker, %error, "sending a job failed; killing the worker");
                link.why = match error.step {
                    process::MAKING_ROOM => Some(Reason::SharedMemoryFull),
                    process::FILE_SIZE => Some(Reason::Shortage),
                    _ => None,
                };
                self.workers.details.insert(lease, error.to_string());
                self.workers.fleet.kill(worker);
            }
        }
    }

    fn word(&mut self, worker: WorkerId, word: LinkEvent, events: &mut Events) {
        match word {
            LinkEvent::Open => self.start(worker, events),
            LinkEvent::Message(message, arrays) => events.extend(self.message(worker, *message, arrays)),
            LinkEvent::Beat(lease) => events.push_back(Event::Beat(worker, lease)),
            LinkEvent::Broken(error) => self.broken(worker, &error),
            LinkEvent::Closed => {
                if let Some(link) = self.workers.links.get_mut(&worker) {
                    link.closed = true;
                }
                self.lost(worker, events);
            }
        }
    }

    /// The event of a message.
    fn message(
        &mut self,
        worker: WorkerId,
        message: ToOrchestrator,
        sample: Option<Sample>,
    ) -> Option<Event<Records>> {
        Some(match message {
            ToOrchestrator::Hello { build, pid } if build != process::build() => {
                tracing::error!(%worker, pid, build, "the worker is of another build; killing it");
                self.workers.last_words =
                    format!("the worker is build {build}, this program is build {}", process::build());
                self.workers.fleet.kill(worker);
                return None;
            }
            ToOrchestrator::Hello { .. } => Event::Up(worker),
            ToOrchestrator::Step(lease, record, checkpoint) => {
                let trial = self.agenda.trials.get(lease.trial as usize);
                let steps = trial.map_or(1, |trial| trial.spec.optimise.steps());
                let trained = checkpoint.step as usize >= steps.max(1);
                Event::Step(worker, lease, trained, (record, Arc::from(checkpoint)))
            }
            ToOrchestrator::Saved(lease, checkpoint) => Event::Saved(worker, lease, Arc::from(checkpoint)),
            ToOrchestrator::Finished(lease, result, heads) => {
                let arrays = sample.map(|sample| ResultArrays { heads, sample });
                Event::Finished(worker, lease, (result, arrays))
            }
            ToOrchestrator::Failed(lease, reason, detail) => {
                let trial = self.agenda.trials.get(lease.trial as usize).map(|trial| trial.hash.as_str());
                tracing::error!(trial, lease.attempt, %reason, detail, "the worker reported a failure of the trial");
                self.workers.details.insert(lease, detail);
                Event::Failed(worker, lease, reason)
            }
            ToOrchestrator::Stopped(lease) => {
                let due = self.agenda.trials.get(lease.trial as usize).and_then(|trial| trial.pause);
                let done = self.agenda.priors.get(lease.trial as usize).and_then(|prior| prior.steps);
                let paused = due.zip(done).is_some_and(|(due, done)| done >= due);
                Event::Failed(worker, lease, if paused { Reason::Paused } else { Reason::Stopped })
            }
        })
    }

    fn written(&mut self, word: WriterEvent, events: &mut Events) {
        match word {
            WriterEvent::Recorded(lease, mark) => events.push_back(Event::Recorded(lease, mark)),
            WriterEvent::Done(lease, result) => {
                self.view.done += 1;
                self.watch.done(self.agenda.trial(lease), &result);
                events.push_back(Event::Recorded(lease, RecordKind::Result));
            }
            WriterEvent::Loaded(worker, lease, checkpoint) => {
                let checkpoint = checkpoint.unwrap_or_else(|why| {
                    let trial = self.agenda.trial(lease);
                    tracing::error!(trial.hash, why, "the checkpoint cannot be used; the trial restarts");
                    self.watch.begins_anew(trial, &why);
                    let text = format!("restarted, because the checkpoint cannot be used: {why}");
                    self.writer.pending_log.push((lease, LogLevel::Warn, text));
                    None
                });
                if self.state.phase(lease.trial) == Phase::Running(worker) {
                    let step = checkpoint.as_ref().map(|checkpoint| checkpoint.step);
                    self.agenda.priors[lease.trial as usize].steps = step;
                    let whole = checkpoint.as_ref().is_none_or(|checkpoint| checkpoint.comparison.is_none());
                    self.view.forecast.goes_on(lease.trial, step.unwrap_or(0), whole);
                    self.send_job(worker, lease, checkpoint.map(|checkpoint| *checkpoint));
                }
            }
            WriterEvent::Planned(fresh, request) => self.planned(fresh, request, events),
            WriterEvent::Broken(error) => {
                tracing::error!(%error, "the database failed; the run ends");
                self.writer.error = Some(error);
                events.push_back(Event::StoreBroken);
            }
        }
    }

    fn interrupt(&mut self, events: &mut Events) {
        self.watch.interrupted(self.state.is_stopping(), Duration::from_millis(self.options.settings.grace));
        events.push_back(Event::Interrupt);
    }

    fn tick(&mut self, events: &mut Events) {
        let late: Vec<_> =
            self.workers.links.iter().filter(|(_, link)| link.ended.is_some()).map(|(id, _)| *id).collect();
        late.into_iter().for_each(|worker| self.lost(worker, events));
        self.spent.tick(&self.workers.fleet);
        self.check_database(events);
        if self.state.is_stopping() {
            sql::hurry();
        }
        self.view.busy = self.state.busy();
        self.view.elapsed = self.clock.elapsed();
        self.watch.tick(&self.view);
    }
}
