//! Commands to a running sweep: each is an event and gets one answer; a refused command changes nothing.
//!
//! A pause stops running trials after their steps in progress and frees the machine; a trial itself may run for hours. Workers
//! stay idle.

use metasense_schemas::reason::Reason;
use metasense_schemas::wire::Lease;

use super::{Action, Millis, Payload, Phase, Prior, SchedulerState, Slot, SlotState, Stopping};

/// A command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Steer {
    /// Assign no trials, and stop the running ones.
    Pause,
    /// Assign trials again.
    Resume,
    /// End the run in order, as does the first `Event::Interrupt`.
    Stop,
    /// Cancel this trial; its records stay.
    Cancel(u32),
    /// Give this trial to the next free worker.
    Next(u32),
    /// Set the number of workers; if there are too many, idle ones end first, busy ones after their trial.
    Workers(u32),
    /// Add trials; they get the next numbers and wait behind the others.
    Add(Vec<Prior>),
}

/// The answer to a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SteerAnswer {
    /// Paused; number of trials that are stopping.
    Paused(usize),
    /// Resumed; number of trials that wait.
    Resumed(usize),
    /// The run is stopping; number of trials that are stopping, and the longest wait for them.
    Stopping(usize, Millis),
    /// The trial is cancelled; `true`: after its step in progress.
    Cancelled(bool),
    /// The trial is next; `true`: when another has trained its body.
    Next(bool),
    /// Number of workers before and after.
    Workers([u32; 2]),
    /// Number of trials added.
    Added(usize),
    /// The command was refused.
    Refused(SteerRefusal),
}

/// Why a command was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SteerRefusal {
    /// The run is stopping.
    Stopping,
    /// The trial is done.
    Done,
    /// The trial has failed.
    Failed(Reason),
    /// The trial is running.
    Running,
}

impl SteerRefusal {
    /// The refusal for a trial that is not pending.
    fn of(phase: Phase) -> Self {
        match phase {
            Phase::Failed(reason) => Self::Failed(reason),
            Phase::Recording(_) | Phase::Done => Self::Done,
            Phase::Pending | Phase::Running(_) => Self::Running,
        }
    }
}

impl SchedulerState {
    pub(super) fn steer<P: Payload>(&mut self, steer: Steer, out: &mut Vec<Action<P>>) -> SteerAnswer {
        match steer {
            Steer::Add(priors) => {
                self.add(&priors);
                SteerAnswer::Added(priors.len())
            }
            _ if self.stop.stage != Stopping::No => SteerAnswer::Refused(SteerRefusal::Stopping),
            Steer::Pause => {
                self.settings.paused = true;
                SteerAnswer::Paused(self.busy())
            }
            Steer::Resume => {
                self.settings.paused = false;
                SteerAnswer::Resumed(self.waiting())
            }
            Steer::Stop => {
                self.interrupt();
                SteerAnswer::Stopping(self.busy(), self.settings.grace)
            }
            Steer::Cancel(trial) => self.give_up(trial, out),
            Steer::Next(trial) => self.put_first(trial),
            Steer::Workers(workers) => self.set_workers(workers),
        }
    }

    fn give_up<P: Payload>(&mut self, number: u32, out: &mut Vec<Action<P>>) -> SteerAnswer {
        let trial = &mut self.trials[number as usize];
        match trial.phase {
            Phase::Pending => {
                trial.phase = Phase::Failed(Reason::Cancelled);
                let lease = Lease { trial: number, attempt: trial.attempt };
                self.dequeue(number);
                self.unsettled -= 1;
                self.unrecorded += 1;
                out.push(Action::RecordCancelled(lease));
                SteerAnswer::Cancelled(false)
            }
            Phase::Running(_) => {
                trial.unwanted = Some(Reason::Cancelled);
                SteerAnswer::Cancelled(true)
            }
            settled => SteerAnswer::Refused(SteerRefusal::of(settled)),
        }
    }

    fn put_first(&mut self, number: u32) -> SteerAnswer {
        match self.trials[number as usize].phase {
            Phase::Pending => {
                self.dequeue(number);
                let first = self.queues.ready.first().map_or(0, |(rank, _)| *rank).min(0) - 1;
                self.trials[number as usize].first = Some(first);
                self.queues.ready.insert((first, number));
                SteerAnswer::Next(self.bodies.is_in_training(self.trials[number as usize].body))
            }
            other => SteerAnswer::Refused(SteerRefusal::of(other)),
        }
    }

    /// Removes a pending trial from its queue.
    fn dequeue(&mut self, number: u32) {
        self.queues.ready.remove(&(self.trials[number as usize].rank(), number));
        self.queues.delayed.retain(|(_, trial)| *trial != number);
    }

    /// Sets the number of workers. Slots that were given up are tried again.
    fn set_workers(&mut self, workers: u32) -> SteerAnswer {
        assert!(workers > 0, "a run needs a worker");
        let before = std::mem::replace(&mut self.settings.workers, workers);
        self.slots.resize(self.slots.len().max(workers as usize), Slot::EMPTY);
        for slot in self.slots.iter_mut().filter(|slot| slot.work == SlotState::GivenUp) {
            (slot.misfires, slot.work) = (0, SlotState::Empty { until: self.now });
        }
        SteerAnswer::Workers([before, workers])
    }
}

#[cfg(test)]
mod tests;
