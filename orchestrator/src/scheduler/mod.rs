//! All decisions of a run: `on_event(&mut State, Event) -> Vec<Action>`, without clock, randomness or I/O.
//!
//! A trial is `pending → running → recording → done`, or `failed`, or pending again; a worker's slot is
//! `empty → starting → idle ⇄ busy → ending → empty`. Every message carries the lease (trial, attempt) it speaks of, and
//! one whose lease its worker does not hold is counted and dropped. [`Payload`] is what is recorded, which the scheduler
//! passes on unread.

mod bodies;
mod event;
mod shortage;
mod steer;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use metasense_schemas::reason::Reason;
use metasense_schemas::wire::Lease;

pub use event::{Action, Event, Mark, Outcome, Payload};
pub use steer::{Answer, Refusal, Steer};

use bodies::Bodies;
use shortage::Shortage;

/// Milliseconds since the run began.
pub type Millis = u64;

/// A worker process: its slot, and which process in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct WorkerId {
    /// From 0.
    pub slot: u32,
    /// From 1.
    pub generation: u32,
}

impl std::fmt::Display for WorkerId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}", self.slot, self.generation)
    }
}

/// Limits of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Worker processes.
    pub workers: u32,
    /// Nothing is handed out until somebody wants it.
    pub paused: bool,
    /// How often a trial is tried again after deaths without a step in between.
    pub retries: u32,
    /// Wait before the first such retry; doubles up to `BACKOFF_MAX`.
    pub backoff: Millis,
    /// Longest time without a sign of life.
    pub no_progress: Millis,
    /// Longest time of an attempt.
    pub time_limit: Option<Millis>,
    /// Workers have a limit of memory of their own: a trial that needs more needs it on every machine.
    pub memory_limited: bool,
    /// Longest wait for steps in progress once the run is to end.
    pub grace: Millis,
}

impl Settings {
    /// Wait after so many failures in a row.
    fn wait(&self, failures: u32) -> Millis {
        (self.backoff << failures.saturating_sub(1).min(20)).min(BACKOFF_MAX)
    }
}

/// Longest wait before a retry.
pub const BACKOFF_MAX: Millis = 60_000;
/// Longest time between the start of a process and its hello.
pub const STARTING_MAX: Millis = 30_000;
/// Longest time between asking a process to end and killing it.
pub const ENDING_MAX: Millis = 1_000;
/// Processes of a slot that may fail to come up in a row before the slot is given up.
pub const MISFIRES_MAX: u32 = 4;
/// Results of a worker that may wait for the disk before it gets a further trial.
pub const RESULTS_MAX: usize = 64;
/// Records that may wait for the disk before no further trial is handed out.
pub const UNRECORDED_MAX: usize = 256;

/// Deaths in a row without a step that say that the machine is at fault and not the trials …
pub const UNFIT_DEATHS: u32 = 10;
/// … where so many trials are among them.
pub const UNFIT_TRIALS: usize = 3;

/// A trial as the run finds it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Prior {
    /// Attempts of earlier runs.
    pub attempts: u32,
    /// Steps behind its checkpoint; a trial that has one goes first.
    pub steps: Option<u32>,
    /// Trials that train the same body have an equal one: each goes on from where any of them has come to.
    pub body: u32,
    /// Whether one of them has trained it to the end.
    pub trained: bool,
}

/// What a trial is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Waits.
    Pending,
    /// With a worker.
    Running(WorkerId),
    /// Its result is on the way to the disk.
    Recording(WorkerId),
    /// Its result is on the disk.
    Done,
    /// Given up.
    Failed(Reason),
}

#[derive(Debug, Clone)]
struct Trial {
    phase: Phase,
    attempt: u32,
    begun: bool,
    /// Deaths since the last step.
    deaths: u32,
    /// Shortages of the machine since the last step.
    shortages: u32,
    stepped: bool,
    body: u32,
    /// Not to be finished, and why: its worker is asked for it.
    unwanted: Option<Reason>,
    /// Its place before all that nobody has asked for first: the lower, the earlier.
    first: Option<i64>,
}

impl Trial {
    fn new(prior: &Prior) -> Self {
        Self {
            phase: Phase::Pending,
            attempt: prior.attempts,
            begun: prior.steps.is_some(),
            deaths: 0,
            shortages: 0,
            stepped: false,
            body: prior.body,
            unwanted: None,
            first: None,
        }
    }

    /// Its place among those that may be handed out: one that came to nothing lets the others go first.
    fn rank(&self) -> i64 {
        self.first.unwrap_or(2 * i64::from(self.deaths + self.shortages) + i64::from(!self.begun))
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Work {
    Empty { until: Millis },
    Starting { since: Millis },
    Idle,
    Busy { lease: Lease, since: Millis, beat: Millis, asked: bool },
    Ending { lease: Option<Lease>, since: Millis, why: Option<Reason> },
    GivenUp,
}

#[derive(Debug, Clone)]
struct Slot {
    generation: u32,
    misfires: u32,
    /// Results of this worker on their way to the disk.
    unrecorded: usize,
    work: Work,
}

impl Slot {
    const EMPTY: Self = Self { generation: 0, misfires: 0, unrecorded: 0, work: Work::Empty { until: 0 } };

    /// Whether its worker has a trial, or can have one.
    fn is_alive(&self) -> bool {
        matches!(self.work, Work::Starting { .. } | Work::Idle | Work::Busy { .. })
    }
}

/// Slots, each with the worker process that it has now.
fn with_workers(slots: &mut [Slot]) -> impl Iterator<Item = (WorkerId, &mut Slot)> {
    slots.iter_mut().zip(0..).map(|(state, slot)| (WorkerId { slot, generation: state.generation }, state))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Stopping {
    No,
    Asked,
    AtOnce,
    Broken,
}

/// Everything the scheduler knows.
#[derive(Debug, Clone)]
pub struct State {
    settings: Settings,
    now: Millis,
    trials: Vec<Trial>,
    /// Trials that wait for a worker, or for their body: those asked for first, begun ones, then in the order of the plan; behind them those that died.
    ready: BTreeSet<(i64, u32)>,
    /// Trials that wait for a time.
    delayed: BTreeSet<(Millis, u32)>,
    slots: Vec<Slot>,
    bodies: Bodies,
    unsettled: usize,
    unrecorded: usize,
    /// Since a worker has last come anywhere with its trial: deaths, the trials that died, and why the last one did.
    deaths: u32,
    dead: BTreeSet<u32>,
    died_of: Option<Reason>,
    shortage: Shortage,
    stopping: Stopping,
    /// Since when.
    stopping_since: Millis,
    ended: bool,
}

/// The only place that decides.
#[must_use = "actions must be carried out"]
pub fn on_event<P: Payload>(state: &mut State, event: Event<P>) -> Vec<Action<P>> {
    let mut actions = Vec::new();
    if state.ended {
        return actions;
    }
    let out = &mut actions;
    match event {
        Event::Clock(now) => state.clock(now, out),
        Event::Up(worker) => state.up(worker),
        Event::Beat(worker, lease) => {
            if state.holds(worker, lease) {
                state.beat(worker);
            }
        }
        Event::Step(worker, lease, ..)
        | Event::Saved(worker, lease, _)
        | Event::Finished(worker, lease, _)
        | Event::Failed(worker, lease, _)
            if !state.holds(worker, lease) =>
        {
            out.push(Action::CountStale(lease));
        }
        Event::Step(worker, lease, trained, record) => {
            state.progressed(worker, lease);
            if trained {
                state.bodies.trained(state.trials[lease.trial as usize].body);
            }
            out.push(Action::RecordStep(lease, record));
        }
        Event::Saved(worker, lease, record) => {
            state.progressed(worker, lease);
            out.push(Action::RecordCheckpoint(lease, record));
        }
        Event::Finished(worker, lease, record) => {
            state.came_further(worker);
            state.shortage.relieved(state.now, state.settings.retries);
            state.release(worker);
            state.slots[worker.slot as usize].unrecorded += 1;
            let trial = &mut state.trials[lease.trial as usize];
            trial.phase = Phase::Recording(worker);
            state.bodies.trained(trial.body);
            state.unrecorded += 1;
            out.push(Action::RecordResult(lease, record));
        }
        Event::Failed(worker, lease, reason) => {
            state.release(worker);
            state.attempt_failed(lease, reason, out);
        }
        Event::Lost(worker, reason) => state.lost(worker, reason, out),
        Event::Recorded(lease, mark) => {
            state.unrecorded = state.unrecorded.saturating_sub(1);
            let trial = &mut state.trials[lease.trial as usize];
            if mark == Mark::Result
                && let Phase::Recording(worker) = std::mem::replace(&mut trial.phase, Phase::Done)
            {
                state.unsettled -= 1;
                if let Some(slot) = state.slot(worker) {
                    slot.unrecorded -= 1;
                }
            }
        }
        Event::StoreBroken => state.stopping = Stopping::Broken,
        Event::Interrupt => state.interrupt(),
        Event::Steer(steer, asker) => {
            let answer = state.steer(steer, out);
            out.push(Action::Answer(asker, answer));
        }
    }
    state.stop(out);
    state.take_back(out);
    state.shrink(out);
    state.assign(out);
    state.spawn(out);
    state.end(out);
    actions
}

impl State {
    /// A run of these trials, in the order of the plan. The first event should be `Event::Clock`.
    pub fn new(settings: Settings, trials: &[Prior]) -> Self {
        assert!(settings.workers > 0, "a run needs a worker");
        let mut state = Self {
            now: 0,
            ready: BTreeSet::new(),
            delayed: BTreeSet::new(),
            unsettled: 0,
            trials: Vec::with_capacity(trials.len()),
            slots: vec![Slot::EMPTY; settings.workers as usize],
            bodies: Bodies::default(),
            unrecorded: 0,
            deaths: 0,
            dead: BTreeSet::new(),
            died_of: None,
            shortage: Shortage::default(),
            stopping: Stopping::No,
            stopping_since: 0,
            ended: false,
            settings,
        };
        state.add(trials);
        state
    }

    fn add(&mut self, priors: &[Prior]) {
        for (prior, number) in priors.iter().zip(self.trials.len() as u32..) {
            let trial = Trial::new(prior);
            if prior.trained {
                self.bodies.trained(prior.body);
            }
            self.ready.insert((trial.rank(), number));
            self.trials.push(trial);
        }
        self.unsettled += priors.len();
    }

    /// Somebody wants the run to end: in order at first, then at once.
    fn interrupt(&mut self) {
        let first = self.stopping == Stopping::No;
        self.stopping = self.stopping.max(if first { Stopping::Asked } else { Stopping::AtOnce });
        if first {
            self.stopping_since = self.now;
        }
    }

    /// What a trial is doing.
    pub fn phase(&self, trial: u32) -> Phase {
        self.trials[trial as usize].phase
    }

    /// Whether a person has asked for the end.
    pub fn is_stopping(&self) -> bool {
        self.stopping != Stopping::No
    }

    /// Whether nothing is handed out for the time being.
    pub fn is_paused(&self) -> bool {
        self.settings.paused
    }

    /// Worker processes that are wanted.
    pub fn workers(&self) -> u32 {
        self.settings.workers
    }

    /// Trials that wait for a worker.
    pub fn waiting(&self) -> usize {
        self.ready.len() + self.delayed.len()
    }

    /// Workers that have a trial.
    pub fn busy(&self) -> usize {
        self.slots.iter().filter(|slot| matches!(slot.work, Work::Busy { .. })).count()
    }

    /// The slot of a worker, if that process is the current one.
    fn slot(&mut self, worker: WorkerId) -> Option<&mut Slot> {
        self.slots.get_mut(worker.slot as usize).filter(|slot| slot.generation == worker.generation)
    }

    /// A worker that is being ended still holds its trial: what it said before it went counts.
    fn holds(&mut self, worker: WorkerId, lease: Lease) -> bool {
        self.slot(worker).is_some_and(|slot| match slot.work {
            Work::Busy { lease: held, .. } => held == lease,
            Work::Ending { lease: held, .. } => held == Some(lease),
            _ => false,
        })
    }

    fn beat(&mut self, worker: WorkerId) {
        let now = self.now;
        if let Some(Slot { work: Work::Busy { beat, .. }, .. }) = self.slot(worker) {
            *beat = now;
        }
    }

    /// A worker has come further with its trial than a death could take back, once that is recorded.
    fn progressed(&mut self, worker: WorkerId, lease: Lease) {
        self.beat(worker);
        self.came_further(worker);
        let trial = &mut self.trials[lease.trial as usize];
        (trial.stepped, trial.begun) = (true, true);
        self.unrecorded += 1;
    }

    /// Trials that may be handed out, in their order: those of which nobody else trains the body.
    fn free(&self) -> impl Iterator<Item = (i64, u32)> {
        let waits = |number: u32| self.bodies.is_in_training(self.trials[number as usize].body);
        self.ready.iter().copied().filter(move |(_, number)| !waits(*number))
    }

    /// A worker has come further with its trial.
    fn came_further(&mut self, worker: WorkerId) {
        self.machine_works();
        if let Some(&mut Slot { work: Work::Busy { since, .. }, .. }) = self.slot(worker) {
            self.shortage.came_further(since);
        }
    }

    /// A worker has come somewhere: this machine can do it.
    fn machine_works(&mut self) {
        self.deaths = 0;
        self.dead.clear();
    }

    /// Why this machine is given up, where it is: deaths, or shortages that no worker's end can relieve.
    fn unfit(&self) -> Option<Reason> {
        let short = self.shortage.lasting(self.settings.retries).filter(|_| self.busy() == 0);
        let died = self.deaths >= UNFIT_DEATHS && self.dead.len() >= UNFIT_TRIALS;
        short.or(self.died_of.filter(|_| died))
    }

    /// Whether trials and workers are begun at present.
    fn hands_out(&self) -> bool {
        let waits = self.settings.paused || self.shortage.is_waited_for(self.now);
        self.stopping == Stopping::No && !waits && self.unfit().is_none()
    }

    /// How many more workers there may be; below 0 where there are too many.
    fn room(&self) -> isize {
        let alive = self.slots.iter().filter(|slot| slot.is_alive()).count();
        self.settings.workers as isize - alive as isize
    }

    /// Takes the trial from a worker that holds one.
    fn release(&mut self, worker: WorkerId) {
        if let Some(slot) = self.slot(worker) {
            match &mut slot.work {
                Work::Ending { lease, .. } => *lease = None,
                work => *work = Work::Idle,
            }
        }
    }

    fn up(&mut self, worker: WorkerId) {
        if let Some(slot) = self.slot(worker)
            && let Work::Starting { .. } = slot.work
        {
            slot.misfires = 0;
            slot.work = Work::Idle;
        }
    }

    fn clock<P: Payload>(&mut self, now: Millis, out: &mut Vec<Action<P>>) {
        self.now = self.now.max(now);
        while let Some(&(until, trial)) = self.delayed.first()
            && until <= self.now
        {
            self.delayed.pop_first();
            self.ready.insert((self.trials[trial as usize].rank(), trial));
        }
        let (now, settings) = (self.now, &self.settings);
        let waited_out = self.stopping != Stopping::No && now > self.stopping_since + settings.grace;
        for (worker, slot) in with_workers(&mut self.slots) {
            let (lease, why) = match slot.work {
                Work::Busy { lease, .. } if waited_out => (Some(lease), Some(Reason::Stopped)),
                Work::Busy { lease, beat, .. } if now > beat + settings.no_progress => {
                    (Some(lease), Some(Reason::NoProgress))
                }
                Work::Busy { lease, since, .. }
                    if settings.time_limit.is_some_and(|limit| now > since + limit) =>
                {
                    (Some(lease), Some(Reason::TimeLimit))
                }
                Work::Starting { since } if now > since + STARTING_MAX => (None, None),
                Work::Ending { lease, since, why } if now > since + ENDING_MAX => (lease, why),
                _ => continue,
            };
            slot.work = Work::Ending { lease, since: now, why };
            out.push(Action::Kill(worker));
        }
    }

    fn lost<P: Payload>(&mut self, worker: WorkerId, reason: Reason, out: &mut Vec<Action<P>>) {
        let now = self.now;
        // whoever ends the run may end its workers, too
        let with_the_run = self.stopping != Stopping::No && reason == Reason::WorkerKilled(9);
        let reason = if with_the_run { Reason::Stopped } else { reason };
        let Some(slot) = self.slot(worker) else { return };
        let (lease, why, misfired) = match slot.work {
            Work::Busy { lease, .. } => (Some(lease), reason, false),
            Work::Ending { lease, why, .. } => (lease, why.unwrap_or(reason), false),
            Work::Starting { .. } => (None, reason, true),
            Work::Idle | Work::Empty { .. } | Work::GivenUp => (None, reason, false),
        };
        slot.misfires += u32::from(misfired);
        slot.work = if slot.misfires >= MISFIRES_MAX {
            Work::GivenUp
        } else {
            Work::Empty { until: now + if misfired { 200 << slot.misfires } else { 0 } }
        };
        if let Some(lease) = lease {
            self.attempt_failed(lease, why, out);
        }
    }

    /// An attempt came to nothing: again, later, or never.
    fn attempt_failed<P: Payload>(&mut self, lease: Lease, reason: Reason, out: &mut Vec<Action<P>>) {
        let own = reason == Reason::OutOfMemory && self.settings.memory_limited;
        let shortage = reason.is_shortage() && !own;
        let death = shortage || reason.is_retried();
        let trial = &mut self.trials[lease.trial as usize];
        self.bodies.given_back(trial.body, lease.trial);
        let back = death || reason == Reason::Paused;
        let reason = trial.unwanted.filter(|_| back).unwrap_or(reason);
        let [death, shortage] = [death, shortage].map(|is_so| is_so && reason != Reason::Cancelled);
        let by_request =
            reason == Reason::Stopped || self.stopping >= Stopping::AtOnce && reason != Reason::Cancelled;
        let stepped = std::mem::replace(&mut trial.stepped, false);
        if !by_request {
            if stepped {
                (trial.deaths, trial.shortages) = (0, 0);
            }
            trial.deaths += u32::from(!stepped && !shortage);
            trial.shortages += u32::from(shortage);
        }
        let settled = !by_request && (!death || !shortage && trial.deaths > self.settings.retries);
        let deaths = trial.deaths;
        if settled {
            trial.phase = Phase::Failed(reason);
            self.unsettled -= 1;
        } else {
            trial.phase = Phase::Pending;
            let wait = if deaths == 0 { 0 } else { self.settings.wait(deaths) };
            self.delayed.insert((self.now + wait, lease.trial));
        }
        if !shortage {
            self.shortage.relieved(self.now, self.settings.retries);
        } else if !by_request {
            self.shortage.met(reason, self.now, |in_a_row| self.settings.wait(in_a_row));
        }
        if !by_request && !shortage && !stepped {
            if death {
                self.deaths += 1;
                self.dead.insert(lease.trial);
                self.died_of = Some(reason);
            } else if reason != Reason::Cancelled && reason != Reason::TimeLimit {
                self.machine_works(); // the worker has lived to say what is wrong with the trial
            }
        }
        self.unrecorded += 1;
        out.push(Action::RecordFailure { lease, reason, settled });
    }

    /// Ends workers where the run is to end.
    fn stop<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        let finished = self.unsettled == 0 || self.unfit().is_some() && self.busy() == 0;
        if self.stopping == Stopping::No && !finished {
            return;
        }
        for (worker, slot) in with_workers(&mut self.slots) {
            let at_once = self.stopping >= Stopping::AtOnce;
            match slot.work {
                Work::Busy { lease, .. } if at_once => {
                    slot.work =
                        Work::Ending { lease: Some(lease), since: self.now, why: Some(Reason::Stopped) };
                    out.push(Action::Kill(worker));
                }
                Work::Busy { lease, since, beat, asked: false } => {
                    slot.work = Work::Busy { lease, since, beat, asked: true };
                    out.push(Action::AskStop(worker));
                }
                Work::Idle | Work::Starting { .. } => {
                    slot.work = Work::Ending { lease: None, since: self.now, why: None };
                    out.push(Action::Close(worker));
                }
                _ => {}
            }
        }
    }

    /// Asks for the trials back that are not to be finished, all of them in a pause.
    fn take_back<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        for (worker, slot) in with_workers(&mut self.slots) {
            if let Work::Busy { lease, asked: asked @ false, .. } = &mut slot.work
                && (self.settings.paused || self.trials[lease.trial as usize].unwanted.is_some())
            {
                *asked = true;
                out.push(Action::AskStop(worker));
            }
        }
    }

    /// Ends idle workers where there are more than are wanted.
    fn shrink<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        let surplus = usize::try_from(-self.room()).unwrap_or(0);
        let idle = |(_, slot): &(_, &mut Slot)| matches!(slot.work, Work::Starting { .. } | Work::Idle);
        for (worker, slot) in with_workers(&mut self.slots).filter(idle).take(surplus) {
            slot.work = Work::Ending { lease: None, since: self.now, why: None };
            out.push(Action::Close(worker));
        }
    }

    /// Hands trials to idle workers.
    fn assign<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        if !self.hands_out() {
            return;
        }
        let may = |slot: &Slot| slot.work == Work::Idle && slot.unrecorded < RESULTS_MAX;
        let idle: Vec<WorkerId> =
            with_workers(&mut self.slots).filter(|(_, slot)| may(slot)).map(|(worker, _)| worker).collect();
        for worker in idle.into_iter().take_while(|_| self.unrecorded < UNRECORDED_MAX) {
            let Some((rank, number)) = self.free().next() else { return };
            self.ready.remove(&(rank, number));
            let trial = &mut self.trials[number as usize];
            trial.attempt += 1;
            trial.phase = Phase::Running(worker);
            let (lease, now) = (Lease { trial: number, attempt: trial.attempt }, self.now);
            self.bodies.handed_out(trial.body, number);
            self.slots[worker.slot as usize].work = Work::Busy { lease, since: now, beat: now, asked: false };
            out.push(Action::Assign(worker, lease));
        }
    }

    /// Starts as many workers as there are trials that wait for one, and not for another trial to train their body.
    fn spawn<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        if !self.hands_out() {
            return;
        }
        let coming = |slot: &&Slot| matches!(slot.work, Work::Starting { .. } | Work::Idle);
        let Some(room) = usize::try_from(self.room()).ok().filter(|room| *room > 0) else { return };
        let free = self.free().take(self.settings.workers as usize).count() + self.delayed.len();
        let mut wanted = free.saturating_sub(self.slots.iter().filter(coming).count()).min(room);
        for (slot, number) in self.slots.iter_mut().zip(0..) {
            if let Work::Empty { until } = slot.work
                && until <= self.now
                && wanted > 0
            {
                wanted -= 1;
                slot.generation += 1;
                slot.unrecorded = 0;
                slot.work = Work::Starting { since: self.now };
                out.push(Action::Spawn(WorkerId { slot: number, generation: slot.generation }));
            }
        }
    }

    /// Says so when the run is over.
    fn end<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        let deserted = self.slots.iter().all(|slot| matches!(slot.work, Work::Empty { .. } | Work::GivenUp));
        // A broken store records nothing more: also not what a worker said before it went.
        let recording = self.unrecorded > 0 && self.stopping != Stopping::Broken;
        if !deserted || recording {
            return;
        }
        let outcome = match (self.stopping, self.unfit()) {
            (Stopping::Broken, _) => Outcome::StoreBroken,
            _ if self.unsettled == 0 => Outcome::Complete,
            (Stopping::Asked | Stopping::AtOnce, _) => Outcome::Interrupted,
            (Stopping::No, Some(reason)) => Outcome::Unfit(reason),
            (Stopping::No, None) if self.slots.iter().all(|slot| slot.work == Work::GivenUp) => {
                Outcome::NoWorkers
            }
            (Stopping::No, None) => return,
        };
        self.ended = true;
        out.push(Action::End(outcome));
    }
}
