//! What a person may command of a run that goes on: each command is an event and gets one answer; a refused one changes nothing.
//!
//! A pause takes running trials back after the step in progress, as the end of a run does: who pauses wants the machine, and
//! what it costs is the beginning of another attempt, while a trial may go on for hours. Workers stay, idle.

use std::fmt;

use metasense_schemas::reason::Reason;
use metasense_schemas::wire::Lease;

use super::{Action, Payload, Phase, Prior, Slot, State, Stopping, Trial, Work, with_workers};

/// A command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Steer {
    /// Hand no trial out, and take those that run back.
    Pause,
    /// Hand trials out again.
    Resume,
    /// End the run in order; the first `Event::Interrupt` is the same.
    Stop,
    /// Give this trial up, with what is recorded of it.
    Cancel(u32),
    /// Give this one to the next worker that is free.
    Next(u32),
    /// So many worker processes: idle ones end first, others when their trial does.
    Workers(u32),
    /// Trials that were not known before; they are numbered on, and come after those that wait.
    Add(Vec<Prior>),
}

/// What came of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Nothing is handed out; so many trials are on their way back.
    Paused(usize),
    /// Trials are handed out; so many wait.
    Resumed(usize),
    /// The run ends; so many trials are on their way back.
    Stopping(usize),
    /// The trial is given up; `true`: once its worker has finished the step in progress.
    Cancelled(bool),
    /// The trial is the next one.
    Next,
    /// Worker processes before and from now on.
    Workers([u32; 2]),
    /// So many trials more.
    Added(usize),
    /// Nothing has changed.
    Refused(Refusal),
}

/// Why nothing has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The run is about to end.
    Stopping,
    /// The trial has its result.
    Done,
    /// The trial has come to nothing.
    Failed(Reason),
    /// The trial is with a worker.
    Running,
}

impl Refusal {
    /// Of a trial that does not wait.
    fn of(phase: Phase) -> Self {
        match phase {
            Phase::Failed(reason) => Self::Failed(reason),
            Phase::Recording(_) | Phase::Done => Self::Done,
            Phase::Pending | Phase::Running(_) => Self::Running,
        }
    }
}

impl fmt::Display for Answer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let back = |f: &mut fmt::Formatter<'_>, running: usize| match running {
            0 => f.write_str("no trial is running"),
            1 => f.write_str("1 running trial is taken back after its step in progress"),
            n => write!(f, "{n} running trials are taken back after their steps in progress"),
        };
        match self {
            Self::Paused(running) => {
                f.write_str("paused: ")?;
                back(f, *running)
            }
            Self::Resumed(waiting) => write!(f, "goes on: trials that wait: {waiting}"),
            Self::Stopping(running) => {
                f.write_str("stopping: ")?;
                back(f, *running)
            }
            Self::Cancelled(false) => f.write_str("cancelled"),
            Self::Cancelled(true) => f.write_str("cancelled: it ends after its step in progress"),
            Self::Next => f.write_str("goes to the next worker that is free"),
            Self::Workers([before, after]) => write!(f, "workers: {before} before, {after} from now on"),
            Self::Added(count) => write!(f, "trials added: {count}"),
            Self::Refused(Refusal::Stopping) => f.write_str("the run is about to end"),
            Self::Refused(Refusal::Done) => f.write_str("the trial is done"),
            Self::Refused(Refusal::Failed(reason)) => write!(f, "the trial is given up already ({reason})"),
            Self::Refused(Refusal::Running) => f.write_str("the trial is running already"),
        }
    }
}

impl State {
    /// Somebody wants the run to end: in order at first, then at once.
    pub(super) fn interrupt(&mut self) {
        let first = self.stopping == Stopping::No;
        self.stopping = self.stopping.max(if first { Stopping::Asked } else { Stopping::AtOnce });
        if first {
            self.stopping_since = self.now;
        }
    }

    pub(super) fn steer<P: Payload>(&mut self, steer: Steer, out: &mut Vec<Action<P>>) -> Answer {
        match steer {
            Steer::Add(priors) => self.add(&priors),
            _ if self.stopping != Stopping::No => Answer::Refused(Refusal::Stopping),
            Steer::Pause => {
                self.settings.paused = true;
                Answer::Paused(self.busy())
            }
            Steer::Resume => {
                self.settings.paused = false;
                Answer::Resumed(self.waiting())
            }
            Steer::Stop => {
                self.interrupt();
                Answer::Stopping(self.busy())
            }
            Steer::Cancel(trial) => self.give_up(trial, out),
            Steer::Next(trial) => self.put_first(trial),
            Steer::Workers(workers) => self.set_workers(workers),
        }
    }

    fn add(&mut self, priors: &[Prior]) -> Answer {
        for prior in priors {
            let trial = Trial::new(prior);
            self.ready.insert((trial.rank(), self.trials.len() as u32));
            self.trials.push(trial);
        }
        self.unsettled += priors.len();
        Answer::Added(priors.len())
    }

    fn give_up<P: Payload>(&mut self, number: u32, out: &mut Vec<Action<P>>) -> Answer {
        let trial = &mut self.trials[number as usize];
        match trial.phase {
            Phase::Pending => {
                trial.phase = Phase::Failed(Reason::Cancelled);
                let lease = Lease { trial: number, attempt: trial.attempt };
                self.dequeue(number);
                self.unsettled -= 1;
                self.unrecorded += 1;
                out.push(Action::RecordCancelled(lease));
                Answer::Cancelled(false)
            }
            Phase::Running(_) => {
                trial.unwanted = Some(Reason::Cancelled);
                Answer::Cancelled(true)
            }
            settled => Answer::Refused(Refusal::of(settled)),
        }
    }

    fn put_first(&mut self, number: u32) -> Answer {
        match self.trials[number as usize].phase {
            Phase::Pending => {
                self.dequeue(number);
                let first = self.ready.first().map_or(0, |(rank, _)| *rank).min(0) - 1;
                self.trials[number as usize].first = Some(first);
                self.ready.insert((first, number));
                Answer::Next
            }
            other => Answer::Refused(Refusal::of(other)),
        }
    }

    /// Takes a trial that waits out of where it does.
    fn dequeue(&mut self, number: u32) {
        self.ready.remove(&(self.trials[number as usize].rank(), number));
        self.delayed.retain(|(_, trial)| *trial != number);
    }

    /// Slots that were given up are tried again: a person who asks for workers wants them.
    fn set_workers(&mut self, workers: u32) -> Answer {
        assert!(workers > 0, "a run needs a worker");
        let before = std::mem::replace(&mut self.settings.workers, workers);
        self.slots.resize(self.slots.len().max(workers as usize), Slot::EMPTY);
        for slot in self.slots.iter_mut().filter(|slot| slot.work == Work::GivenUp) {
            (slot.misfires, slot.work) = (0, Work::Empty { until: self.now });
        }
        Answer::Workers([before, workers])
    }

    /// Asks for the trials back that are not to be finished, all of them in a pause.
    pub(super) fn take_back<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
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
    pub(super) fn shrink<P: Payload>(&mut self, out: &mut Vec<Action<P>>) {
        let alive = self.slots.iter().filter(|slot| slot.is_alive()).count();
        let surplus = alive.saturating_sub(self.settings.workers as usize);
        let idle = |(_, slot): &(_, &mut Slot)| matches!(slot.work, Work::Starting { .. } | Work::Idle);
        for (worker, slot) in with_workers(&mut self.slots).filter(idle).take(surplus) {
            slot.work = Work::Ending { lease: None, since: self.now, why: None };
            out.push(Action::Close(worker));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Event, Mark, Outcome, Settings, WorkerId, on_event};
    use super::*;

    /// Nothing is recorded, and answers are for nobody.
    #[derive(Debug, Clone, PartialEq)]
    struct Nothing;

    impl Payload for Nothing {
        type Step = ();
        type Saved = ();
        type Result = ();
        type Asker = ();
    }

    type Actions = Vec<Action<Nothing>>;

    /// A run whose workers are up: they have the first trials.
    fn run(trials: usize, workers: u32) -> State {
        let settings = Settings {
            workers,
            paused: false,
            retries: 0,
            backoff: 500,
            no_progress: 10_000,
            time_limit: None,
            prune: None,
        };
        let mut state = State::new(settings, &vec![Prior::default(); trials]);
        up(&mut state, Event::Clock(0));
        state
    }

    /// An event, after which workers that it starts come up; all actions.
    fn up(state: &mut State, event: Event<Nothing>) -> Actions {
        let mut actions = on_event(state, event);
        let spawned: Vec<WorkerId> =
            actions.iter().filter_map(|a| if let Action::Spawn(id) = a { Some(*id) } else { None }).collect();
        for worker in spawned {
            actions.extend(on_event(state, Event::Up(worker)));
        }
        actions
    }

    fn steer(state: &mut State, command: Steer) -> (Answer, Actions) {
        let mut actions = up(state, Event::Steer(command, ()));
        let answer = |action: &Action<Nothing>| match action {
            Action::Answer((), answer) => Some(*answer),
            _ => None,
        };
        let (at, answer) =
            actions.iter().enumerate().find_map(|(at, a)| Some((at, answer(a)?))).expect("an answer");
        actions.remove(at);
        (answer, actions)
    }

    const fn id(slot: u32) -> WorkerId {
        WorkerId { slot, generation: 1 }
    }

    const fn lease(trial: u32, attempt: u32) -> Lease {
        Lease { trial, attempt }
    }

    fn finish(state: &mut State, slot: u32, trial: u32) -> Actions {
        let mut actions = up(state, Event::Finished(id(slot), lease(trial, 1), ()));
        actions.extend(up(state, Event::Recorded(lease(trial, 1), Mark::Result)));
        actions
    }

    const fn failed(trial: u32, reason: Reason, settled: bool) -> Action<Nothing> {
        Action::RecordFailure { lease: lease(trial, 1), reason, settled }
    }

    /// Also trials that come back for other reasons meanwhile wait; the same trials go on, begun ones first.
    #[test]
    fn a_pause_takes_trials_back_and_hands_out_none() {
        let mut state = run(3, 2);
        let (answer, actions) = steer(&mut state, Steer::Pause);
        assert_eq!(answer, Answer::Paused(2));
        assert_eq!(actions, [Action::AskStop(id(0)), Action::AskStop(id(1))]);
        assert_eq!(steer(&mut state, Steer::Pause), (Answer::Paused(2), vec![]), "nobody is asked twice");
        let back = up(&mut state, Event::Failed(id(0), lease(0, 1), Reason::Stopped));
        assert_eq!(back, [failed(0, Reason::Stopped, false)]);
        // this one was quicker than the pause
        assert_eq!(finish(&mut state, 1, 1), [Action::RecordResult(lease(1, 1), ())]);
        assert_eq!(up(&mut state, Event::Clock(60_000)), []);
        let (answer, actions) = steer(&mut state, Steer::Resume);
        assert_eq!(answer, Answer::Resumed(2));
        assert_eq!(actions, [Action::Assign(id(0), lease(0, 2)), Action::Assign(id(1), lease(2, 1))]);
    }

    /// One that waits, one that runs and stops, one whose worker dies before, one that is done before; none is given out again.
    #[test]
    fn what_is_cancelled_is_recorded_and_not_given_out_again() {
        let mut state = run(5, 3);
        let waits = steer(&mut state, Steer::Cancel(4));
        assert_eq!(waits, (Answer::Cancelled(false), vec![Action::RecordCancelled(lease(4, 0))]));
        for slot in 0..3 {
            let (answer, actions) = steer(&mut state, Steer::Cancel(slot));
            assert_eq!((answer, &actions[..]), (Answer::Cancelled(true), &[Action::AskStop(id(slot))][..]));
        }
        let stopped = up(&mut state, Event::Failed(id(0), lease(0, 1), Reason::Stopped));
        assert_eq!(stopped, [failed(0, Reason::Cancelled, true), Action::Assign(id(0), lease(3, 1))]);
        let died = up(&mut state, Event::Lost(id(1), Reason::WorkerKilled(9)));
        assert_eq!(died, [failed(1, Reason::Cancelled, true)]);
        assert_eq!(finish(&mut state, 2, 2)[0], Action::RecordResult(lease(2, 1), ()));
        let refused = |why| (Answer::Refused(why), vec![]);
        assert_eq!(steer(&mut state, Steer::Cancel(2)), refused(Refusal::Done));
        assert_eq!(steer(&mut state, Steer::Cancel(4)), refused(Refusal::Failed(Reason::Cancelled)));
        assert_eq!(steer(&mut state, Steer::Next(0)), refused(Refusal::Failed(Reason::Cancelled)));
        for trial in [0, 1, 4] {
            up(&mut state, Event::Recorded(lease(trial, 1), Mark::Failure));
        }
        let last = finish(&mut state, 0, 3);
        assert!(!last.iter().any(|a| matches!(a, Action::Assign(..) | Action::Spawn(_))), "{last:?}");
        let ended = [0, 2].map(|slot| up(&mut state, Event::Lost(id(slot), Reason::WorkerExited(0))));
        assert_eq!(ended.concat(), [Action::End(Outcome::Complete)]);
    }

    /// The last one that was asked for goes before the others, also one that has just died and would have to wait.
    #[test]
    fn what_is_to_be_next_goes_first() {
        let mut state = run(5, 1);
        assert_eq!(steer(&mut state, Steer::Next(0)), (Answer::Refused(Refusal::Running), vec![]));
        for trial in [4, 3] {
            assert_eq!(steer(&mut state, Steer::Next(trial)), (Answer::Next, vec![]));
        }
        let next = |state: &mut State, trial| {
            finish(state, 0, trial).into_iter().find(|action| matches!(action, Action::Assign(..)))
        };
        assert_eq!(next(&mut state, 0), Some(Action::Assign(id(0), lease(3, 1))));
        assert_eq!(next(&mut state, 3), Some(Action::Assign(id(0), lease(4, 1))));
        assert_eq!(next(&mut state, 4), Some(Action::Assign(id(0), lease(1, 1))));
        let mut state = run(3, 1);
        state.settings.retries = 1;
        up(&mut state, Event::Lost(id(0), Reason::WorkerKilled(11)));
        let (answer, _) = steer(&mut state, Steer::Next(0));
        assert_eq!(answer, Answer::Next);
        assert!(matches!(state.phase(0), Phase::Running(_)) || state.ready.first() == Some(&(-1, 0)));
    }

    /// More: started at once, given up slots again, too. Fewer: the idle one, then the first one whose trial ends.
    #[test]
    fn workers_become_more_and_fewer() {
        let mut state = run(6, 1);
        let (answer, actions) = steer(&mut state, Steer::Workers(3));
        assert_eq!(answer, Answer::Workers([1, 3]));
        assert_eq!(actions[..2], [Action::Spawn(id(1)), Action::Spawn(id(2))]);
        assert_eq!((state.busy(), state.waiting()), (3, 3));
        // one becomes idle in a pause
        steer(&mut state, Steer::Pause);
        finish(&mut state, 1, 1);
        let (answer, actions) = steer(&mut state, Steer::Workers(1));
        assert_eq!((answer, &actions[..]), (Answer::Workers([3, 1]), &[Action::Close(id(1))][..]));
        assert_eq!(finish(&mut state, 2, 2), [Action::RecordResult(lease(2, 1), ()), Action::Close(id(2))]);
        steer(&mut state, Steer::Resume);
        let next = finish(&mut state, 0, 0);
        assert_eq!(next[1..], [Action::Assign(id(0), lease(3, 1))], "one goes on");
        for slot in [1, 2] {
            assert_eq!(up(&mut state, Event::Lost(id(slot), Reason::WorkerExited(0))), []);
        }
        state.slots[1].work = Work::GivenUp;
        let (_, actions) = steer(&mut state, Steer::Workers(2));
        assert_eq!(actions[0], Action::Spawn(WorkerId { slot: 1, generation: 2 }));
    }

    /// In the order in which they come, also where all else is settled and workers are about to end; refused by nothing, as
    /// they are in the database by then.
    #[test]
    fn added_trials_are_run() {
        let mut state = run(1, 1);
        let ended = finish(&mut state, 0, 0);
        assert_eq!(ended[1..], [Action::Close(id(0))]);
        let priors = [Prior { attempts: 4, ..Prior::default() }, Prior::default()];
        let (answer, actions) = steer(&mut state, Steer::Add(priors.to_vec()));
        assert_eq!((answer, actions), (Answer::Added(2), vec![]));
        let actions = up(&mut state, Event::Lost(id(0), Reason::WorkerExited(0)));
        let worker = WorkerId { slot: 0, generation: 2 };
        assert_eq!(actions, [Action::Spawn(worker), Action::Assign(worker, lease(1, 5))]);
        assert_eq!(state.waiting(), 1);
        let (answer, actions) = steer(&mut state, Steer::Stop);
        assert_eq!((answer, &actions[..]), (Answer::Stopping(1), &[Action::AskStop(worker)][..]));
        for command in
            [Steer::Stop, Steer::Pause, Steer::Resume, Steer::Cancel(2), Steer::Next(2), Steer::Workers(9)]
        {
            assert_eq!(steer(&mut state, command), (Answer::Refused(Refusal::Stopping), vec![]));
        }
        assert_eq!(steer(&mut state, Steer::Add(vec![Prior::default()])).0, Answer::Added(1));
        up(&mut state, Event::Failed(worker, lease(1, 5), Reason::Stopped));
        up(&mut state, Event::Recorded(lease(1, 5), Mark::Failure));
        let ended = up(&mut state, Event::Lost(worker, Reason::WorkerExited(0)));
        assert_eq!(ended, [Action::End(Outcome::Interrupted)]);
    }
}
