//! All decisions of a run: `on_event(&mut State, Event) -> Vec<Action>`, without clock, randomness or I/O.
//!
//! A trial is `pending → running → recording → done`, or `failed`, or pending again; a worker's slot is `empty → starting →
//! idle ⇄ busy → ending → empty`. Every message carries its lease (trial, attempt); a message whose lease its worker does not
//! hold is counted and dropped. The scheduler passes records on without reading them ([`Payload`]).

mod bodies;
mod event;
mod fitness;
mod slot;
mod steer;
#[cfg(test)]
mod tests;
mod trial;

use std::collections::BTreeSet;

use metasense_schemas::reason::Reason;
use metasense_schemas::wire::Lease;

pub use event::{Action, Event, Payload, RecordKind, RunOutcome};
pub use fitness::{UNFIT_DEATHS, UNFIT_TRIALS};
pub use slot::WorkerId;
pub use steer::{Steer, SteerAnswer, SteerRefusal};
pub use trial::{Phase, Prior};

use bodies::Bodies;
use fitness::{Deaths, Shortage};
use slot::{Slot, SlotState, with_workers};
use trial::Trial;

/// Milliseconds since the start of the run.
pub type Millis = u64;

/// Settings of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Settings {
    /// Number of worker processes.
    pub workers: u32,
    /// Start paused: assign no trials until `Steer::Resume`.
    pub paused: bool,
    /// Retries of a trial after deaths without a step in between.
    pub retries: u32,
    /// Wait before the first retry; doubles up to `BACKOFF_MAX`.
    pub backoff: Millis,
    /// Longest time without a sign of life of a busy worker.
    pub no_progress: Millis,
    /// Longest duration of an attempt.
    pub time_limit: Option<Millis>,
    /// Whether workers have a memory limit of their own: a trial that exceeds it would do so on every machine.
    pub memory_limited: bool,
    /// Longest wait for steps in progress when the run stops.
    pub grace: Millis,
}

impl Settings {
    /// Backoff after this many consecutive failures.
    fn backoff(&self, failures: u32) -> Millis {
        (self.backoff << failures.saturating_sub(1).min(20)).min(BACKOFF_MAX)
    }
}

/// Longest wait before a retry.
pub const BACKOFF_MAX: Millis = 60_000;
/// Longest time between the start of a process and its first message.
pub const STARTING_MAX: Millis = 30_000;
/// Longest time between closing a process and killing it.
pub const ENDING_MAX: Millis = 1_000;
/// Consecutive failed starts after which a slot is given up.
pub const MISFIRES_MAX: u32 = 4;
/// Unrecorded results of a worker at which it gets no further trial.
pub const RESULTS_MAX: usize = 64;
/// Unrecorded records of the run at which no trial is assigned.
pub const UNRECORDED_MAX: usize = 256;

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Stopping {
    #[default]
    No,
    Asked,
    AtOnce,
    Broken,
}

/// State of the scheduler.
#[derive(Debug, Clone, Default)]
pub struct SchedulerState {
    settings: Settings,
    now: Millis,
    trials: Vec<Trial>,
    queues: Queues,
    slots: Vec<Slot>,
    bodies: Bodies,
    unsettled: usize,
    unrecorded: usize,
    deaths: Deaths,
    shortage: Shortage,
    stop: Stop,
    ended: bool,
}

/// Trials that wait:
#[derive(Debug, Clone, Default)]
struct Queues {
    /// for a worker or for their body, by rank, then in the order of the plan.
    ready: BTreeSet<(i64, u32)>,
    /// for a time.
    delayed: BTreeSet<(Millis, u32)>,
}

/// Whether the run stops, and why.
#[derive(Debug, Clone, Copy, Default)]
struct Stop {
    stage: Stopping,
    /// Time of the first interrupt; 0 if the database failed first.
    since: Millis,
}

/// Updates the state and returns the actions. All decisions are made here.
#[must_use = "actions must be carried out"]
pub fn on_event<P: Payload>(state: &mut SchedulerState, event: Event<P>) -> Vec<Action<P>> {
    let mut actions = Vec::new();
    if state.ended {
        return actions;
    }
    let out = &mut actions;
    match event {
        Event::Clock(now) => state.clock(now, out),
        Event::Up(worker) => state.up(worker),
        Event::Beat(worker, lease) if state.holds(worker, lease) => state.beat(worker),
        Event::Beat(..) => {}
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
            state.note_progress(worker);
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
            if mark == RecordKind::Result
                && let Phase::Recording(worker) = std::mem::replace(&mut trial.phase, Phase::Done)
            {
                state.unsettled -= 1;
                if let Some(slot) = state.slot(worker) {
                    slot.unrecorded -= 1;
                }
            }
        }
        Event::StoreBroken => state.stop.stage = Stopping::Broken,
        Event::Interrupt => state.interrupt(),
        Event::Steer(steer, asker) => {
            let answer = state.steer(steer, out);
            out.push(Action::Answer(asker, answer));
        }
    }
    state.stop(out);
    state.shrink(out);
    state.assign(out);
    state.spawn(out);
    state.end(out);
    actions
}

impl SchedulerState {
    /// A run of these trials, in the order of the plan. The first event should be `Event::Clock`.
    pub fn new(settings: Settings, trials: &[Prior]) -> Self {
        assert!(settings.workers > 0, "a run needs a worker");
        let slots = vec![Slot::EMPTY; settings.workers as usize];
        let mut state = Self { slots, settings, ..Self::default() };
        state.add(trials);
        state
    }

    fn add(&mut self, priors: &[Prior]) {
        for (prior, number) in priors.iter().zip(self.trials.len() as u32..) {
            let trial = Trial::new(prior);
            if prior.trained {
                self.bodies.trained(prior.body);
            }
            self.queues.ready.insert((trial.rank(), number));
            self.trials.push(trial);
        }
        self.unsettled += priors.len();
    }

    /// Requests the end of the run: the first request ends it in order, the second at once.
    fn interrupt(&mut self) {
        let first = self.stop.stage == Stopping::No;
        self.stop.stage = self.stop.stage.max(if first { Stopping::Asked } else { Stopping::AtOnce });
        if first {
            self.stop.since = self.now;
        }
    }

    /// The phase of a trial.
    pub fn phase(&self, trial: u32) -> Phase {
        self.trials[trial as usize].phase
    }

    /// Whether the run is stopping.
    pub fn is_stopping(&self) -> bool {
        self.stop.stage != Stopping::No
    }

    /// Whether the run is paused.
    pub fn is_paused(&self) -> bool {
        self.settings.paused
    }

    /// Requested number of worker processes.
    pub fn workers(&self) -> u32 {
        self.settings.workers
    }

    /// Number of trials that wait for a worker.
    pub fn waiting(&self) -> usize {
        self.queues.ready.len() + self.queues.delayed.len()
    }

    /// Number of workers that have a trial.
    pub fn busy(&self) -> usize {
        self.slots.iter().filter(|slot| slot.is_busy()).count()
    }

    /// The slot of a worker, if it contains this process.
    fn slot(&mut self, worker: WorkerId) -> Option<&mut Slot> {
        self.slots.get_mut(worker.slot as usize).filter(|slot| slot.generation == worker.generation)
    }

    /// Whether a worker holds a lease. An ending worker still holds its lease: its last messages count.
    fn holds(&mut self, worker: WorkerId, lease: Lease) -> bool {
        self.slot(worker).is_some_and(|slot| match slot.work {
            SlotState::Busy { lease: held, .. } => held == lease,
            SlotState::Ending { lease: held, .. } => held == Some(lease),
            _ => false,
        })
    }

    fn beat(&mut self, worker: WorkerId) {
        let now = self.now;
        if let Some(Slot { work: SlotState::Busy { beat, .. }, .. }) = self.slot(worker) {
            *beat = now;
        }
    }

    /// Notes progress that a death of the worker cannot undo once it is recorded.
    fn progressed(&mut self, worker: WorkerId, lease: Lease) {
        self.beat(worker);
        self.note_progress(worker);
        let trial = &mut self.trials[lease.trial as usize];
        (trial.stepped, trial.begun) = (true, true);
        self.unrecorded += 1;
    }

    /// Trials that may be assigned, in order: those whose body no other trial is training.
    fn assignable(&self) -> impl Iterator<Item = (i64, u32)> {
        let waits = |number: u32| self.bodies.is_in_training(self.trials[number as usize].body);
        self.queues.ready.iter().copied().filter(move |(_, number)| !waits(*number))
    }

    /// Notes progress of a worker.
    fn note_progress(&mut self, worker: WorkerId) {
        self.deaths = Deaths::default();
        if let Some(&mut Slot { work: SlotState::Busy { since, .. }, .. }) = self.slot(worker) {
            self.shortage.came_further(since);
        }
    }

    /// Why this machine is unfit, if so: repeated deaths, or a shortage while no busy worker can free anything.
    fn unfit(&self) -> Option<Reason> {
        let short = self.shortage.lasting(self.settings.retries).filter(|_| self.busy() == 0);
        short.or(self.deaths.unfit())
    }

    /// Whether trials may be assigned and workers started now.
    fn may_assign(&self) -> bool {
        let waits = self.settings.paused || self.shortage.is_waited_for(self.now);
        self.stop.stage == Stopping::No && !waits && self.unfit().is_none()
    }

    /// Number of workers that may be started; negative if there are too many.
    fn room(&self) -> isize {
        let alive = self.slots.iter().filter(|slot| slot.is_free() || slot.is_busy()).count();
        self.settings.workers as isize - alive as isize
    }

    /// Takes the lease from a worker.
    fn release(&mut self, worker: WorkerId) {
        if let Some(slot) = self.slot(worker) {
            match &mut slot.work {
                SlotState::Ending { lease, .. } => *lease = None,
                work => *work = SlotState::Idle,
            }
        }
    }

    fn up(&mut self, worker: WorkerId) {
        if let Some(slot) = self.slot(worker)
            && let SlotState::Starting { .. } = slot.work
        {
            slot.misfires = 0;
            slot.work = SlotState::Idle;
        }
    }

    fn clock<P: Payload>(&mut self, now: Millis, out: &mut Vec<Action<P>>) {
        self.now = self.now.max(now);
        while let Some(&(until, trial)) = self.queues.delayed.first()
            && until <= self.now
        {
            self.queues.delayed.pop_first();
            self.queues.ready.insert((self.trials[trial as usize].rank(), trial));
        }
        let (now, settings) = (self.now, &self.settings);
        let waited_out = self.stop.stage != Stopping::No && now > self.stop.since + settings.grace;
        for (worker, slot) in with_workers(&mut self.slots) {
            let late = |since| settings.time_limit.is_some_and(|limit| now > since + limit);
            let quiet = |beat| now > beat + settings.no_progress;
            let (lease, why) = match slot.work {
                SlotState::Busy { lease, .. } if waited_out => (Some(lease), Some(Reason::Stopped)),
                SlotState::Busy { lease, beat, .. } if quiet(beat) => (Some(lease), Some(Reason::NoProgress)),
                SlotState::Busy { lease, since, .. } if late(since) => (Some(lease), Some(Reason::TimeLimit)),
                SlotState::Starting { since } if now > since + STARTING_MAX => (None, None),
                SlotState::Ending { lease, since, why } if now > since + ENDING_MAX => (lease, why),
                _ => continue,
            };
            slot.work = SlotState::Ending { lease, since: now, why };
            out.push(Action::Kill(worker));
        }
    }

    fn lost<P: Payload>(&mut self, worker: WorkerId, reason: Reason, out: &mut Vec<Action<P>>) {
        let now = self.now;
        // whoever kills the run may kill its workers, too
        let with_the_run = self.stop.stage != Stopping::No && reason == Reason::WorkerKilled(9);
        let reason = if with_the_run { Reason::Stopped } else { reason };
        let Some(slot) = self.slot(worker) else { return };
        let (lease, why, misfired) = match slot.work {
            SlotState::Busy { lease, .. } => (Some(lease), reason, false),
            SlotState::Ending { lease, why, .. } => (lease, why.unwrap_or(reason), false),
            SlotState::Starting { .. } => (None, reason, true),
            SlotState::Idle | SlotState::Empty { .. } | SlotState::GivenUp => (None, reason, false),
        };
        slot.misfires += u32::from(misfired);
        slot.work = if slot.misfires >= MISFIRES_MAX {
            SlotState::GivenUp
        } else {
            SlotState::Empty { until: now + if misfired { 200 << slot.misfires } else { 0 } }
        };
        if let Some(lease) = lease {
            self.attempt_failed(lease, why, out);
        }
    }

    /// Ends an attempt without a result; the trial is retried or failed.
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
            reason == Reason::Stopped || self.stop.stage >= Stopping::AtOnce && reason != Reason::Cancelled;
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
            let wait = if deaths == 0 { 0 } else { self.settings.backoff(deaths) };
            self.queues.delayed.insert((self.now + wait, lease.trial));
        }
        if !shortage {
            self.shortage.relieved(self.now, self.settings.retries);
        } else if !by_request {
            self.shortage.note_failure(reason, self.now, |in_a_row| self.settings.backoff(in_a_row));
        }
        if !by_request && !shortage && !stepped {
            if death {
                self.deaths.note(lease.trial, reason);
            } else if reason != Reason::Cancelled && reason != Reason::TimeLimit {
                self.deaths = Deaths::default(); // the worker survived and reported the error
            }
        }
        self.unrecorded += 1;
        out.push(Action::RecordFailure { lease, reason, settled });
    }

    /// Stops workers: all if the run must end, all that have a trial in a pause, and those of unwanted trials.
    fn stop<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        let finished = self.unsettled == 0 || self.unfit().is_some() && self.busy() == 0;
        let ends = finished || self.stop.stage != Stopping::No;
        for (worker, slot) in with_workers(&mut self.slots) {
            match slot.work {
                SlotState::Busy { lease, .. } if self.stop.stage >= Stopping::AtOnce => {
                    slot.work =
                        SlotState::Ending { lease: Some(lease), since: self.now, why: Some(Reason::Stopped) };
                    out.push(Action::Kill(worker));
                }
                SlotState::Busy { lease, since, beat, asked: false }
                    if ends
                        || self.settings.paused
                        || self.trials[lease.trial as usize].unwanted.is_some() =>
                {
                    slot.work = SlotState::Busy { lease, since, beat, asked: true };
                    out.push(Action::AskStop(worker));
                }
                SlotState::Idle | SlotState::Starting { .. } if ends => {
                    slot.close(self.now);
                    out.push(Action::Close(worker));
                }
                _ => {}
            }
        }
    }

    /// Closes surplus idle workers.
    fn shrink<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        let surplus = usize::try_from(-self.room()).unwrap_or(0);
        let idle = |(_, slot): &(_, &mut Slot)| slot.is_free();
        for (worker, slot) in with_workers(&mut self.slots).filter(idle).take(surplus) {
            slot.close(self.now);
            out.push(Action::Close(worker));
        }
    }

    /// Assigns trials to idle workers.
    fn assign<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        if !self.may_assign() {
            return;
        }
        let may = |slot: &Slot| slot.work == SlotState::Idle && slot.unrecorded < RESULTS_MAX;
        let idle: Vec<WorkerId> =
            with_workers(&mut self.slots).filter(|(_, slot)| may(slot)).map(|(worker, _)| worker).collect();
        for worker in idle.into_iter().take_while(|_| self.unrecorded < UNRECORDED_MAX) {
            let Some((rank, number)) = self.assignable().next() else { return };
            self.queues.ready.remove(&(rank, number));
            let trial = &mut self.trials[number as usize];
            trial.attempt += 1;
            trial.phase = Phase::Running(worker);
            let (lease, now) = (Lease { trial: number, attempt: trial.attempt }, self.now);
            self.bodies.handed_out(trial.body, number);
            self.slots[worker.slot as usize].work =
                SlotState::Busy { lease, since: now, beat: now, asked: false };
            out.push(Action::Assign(worker, lease));
        }
    }

    /// Starts workers for the trials that wait for one; trials whose body is in training do not count.
    fn spawn<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        if !self.may_assign() {
            return;
        }
        let Some(room) = usize::try_from(self.room()).ok().filter(|room| *room > 0) else { return };
        let free = self.assignable().take(self.settings.workers as usize).count() + self.queues.delayed.len();
        let coming = self.slots.iter().filter(|slot| slot.is_free()).count();
        let mut wanted = free.saturating_sub(coming).min(room);
        for (slot, number) in self.slots.iter_mut().zip(0..) {
            if let SlotState::Empty { until } = slot.work
                && until <= self.now
                && wanted > 0
            {
                wanted -= 1;
                slot.generation += 1;
                slot.unrecorded = 0;
                slot.work = SlotState::Starting { since: self.now };
                out.push(Action::Spawn(WorkerId { slot: number, generation: slot.generation }));
            }
        }
    }

    /// Ends the run when nothing is left to do.
    fn end<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        let deserted =
            self.slots.iter().all(|slot| matches!(slot.work, SlotState::Empty { .. } | SlotState::GivenUp));
        // A broken store records nothing more, so pending records are not waited for.
        let recording = self.unrecorded > 0 && self.stop.stage != Stopping::Broken;
        if !deserted || recording {
            return;
        }
        let outcome = match (self.stop.stage, self.unfit()) {
            (Stopping::Broken, _) => RunOutcome::StoreBroken,
            _ if self.unsettled == 0 => RunOutcome::Complete,
            (Stopping::Asked | Stopping::AtOnce, _) => RunOutcome::Interrupted,
            (Stopping::No, Some(reason)) => RunOutcome::Unfit(reason),
            (Stopping::No, None) if self.slots.iter().all(|slot| slot.work == SlotState::GivenUp) => {
                RunOutcome::NoWorkers
            }
            (Stopping::No, None) => return,
        };
        self.ended = true;
        out.push(Action::End(outcome));
    }
}
