//! What a person may command of a run that goes on: each command is an event and gets one answer; a refused one changes nothing.
//!
//! A pause takes running trials back after the step in progress, however long that takes: who pauses wants the machine, and what it
//! costs is the beginning of another attempt, while a trial may go on for hours. Workers stay, idle.

use std::fmt;

use metasense_schemas::reason::Reason;
use metasense_schemas::wire::Lease;

use super::{Action, Millis, Payload, Phase, Prior, Slot, State, Stopping, Work};

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
    /// The run ends; so many trials are on their way back, and are waited for so long.
    Stopping(usize, Millis),
    /// The trial is given up; `true`: once its worker has finished the step in progress.
    Cancelled(bool),
    /// The trial is the next one; `true`: once another has trained its body.
    Next(bool),
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
            1 => f.write_str("1 running trial stops after its step in progress"),
            n => write!(f, "{n} running trials stop after their steps in progress"),
        };
        match self {
            Self::Paused(running) => {
                f.write_str("paused: ")?;
                back(f, *running)
            }
            Self::Resumed(waiting) => write!(f, "resumed; pending trials: {waiting}"),
            Self::Stopping(running, grace) => {
                f.write_str("stopping: ")?;
                back(f, *running)?;
                match running {
                    0 => Ok(()),
                    _ => write!(f, ", or ended after {} s", *grace as f64 / 1000.0),
                }
            }
            Self::Cancelled(false) => f.write_str("cancelled"),
            Self::Cancelled(true) => f.write_str("cancelled: it ends after its step in progress"),
            Self::Next(false) => f.write_str("starts on the next free worker"),
            Self::Next(true) => {
                f.write_str("starts on the next free worker when another trial has trained its body")
            }
            Self::Workers([before, after]) => write!(f, "workers: {before} before, {after} from now on"),
            Self::Added(count) => write!(f, "trials added: {count}"),
            Self::Refused(Refusal::Stopping) => f.write_str("the run is stopping"),
            Self::Refused(Refusal::Done) => f.write_str("the trial is done"),
            Self::Refused(Refusal::Failed(reason)) => write!(f, "the trial has already ended ({reason})"),
            Self::Refused(Refusal::Running) => f.write_str("the trial is already running"),
        }
    }
}

impl State {
    pub(super) fn steer<P: Payload>(&mut self, steer: Steer, out: &mut Vec<Action<P>>) -> Answer {
        match steer {
            Steer::Add(priors) => {
                self.add(&priors);
                Answer::Added(priors.len())
            }
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
                Answer::Stopping(self.busy(), self.settings.grace)
            }
            Steer::Cancel(trial) => self.give_up(trial, out),
            Steer::Next(trial) => self.put_first(trial),
            Steer::Workers(workers) => self.set_workers(workers),
        }
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
                Answer::Next(self.bodies.is_in_training(self.trials[number as usize].body))
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
}

#[cfg(test)]
mod tests;
