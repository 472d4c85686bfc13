//! Observer of an outer loop, and the log that reports to it.

use super::report::{Report, Seconds};
use super::state::State;
use crate::identify::GoOn;
use crate::trial::Problem;

/// Observer of an outer loop. It provides the clock.
pub trait Observe {
    /// Seconds since some fixed moment.
    fn seconds(&mut self) -> f64;
    /// Receives the completed fraction of the whole trial. After `Stop`, an outer step still finishes; training in the final
    /// comparison does not.
    fn progress(&mut self, fraction: f64) -> LoopControl;
    /// Receives a finished outer step and the state after it.
    fn step(&mut self, report: &Report, state: &State) -> LoopControl;
    /// Receives the state during the final comparison, every few seconds and after `Stop`.
    fn save(&mut self, state: &State);
}

/// What the loop does next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoopControl {
    /// Continues.
    Continue,
    /// Stops.
    Stop,
}

/// An observer without a clock that never stops the loop.
#[derive(Debug)]
pub struct NoObserver;

impl Observe for NoObserver {
    fn seconds(&mut self) -> f64 {
        0.0
    }

    fn progress(&mut self, _: f64) -> LoopControl {
        LoopControl::Continue
    }

    fn step(&mut self, _: &Report, _: &State) -> LoopControl {
        LoopControl::Continue
    }

    fn save(&mut self, _: &State) {}
}

/// The current report, and the clock.
pub(super) struct Log<'a> {
    pub(super) report: Report,
    pub(super) observer: &'a mut dyn Observe,
    /// When the state was last saved (s); at first, when the log was created.
    saved: f64,
}

/// Seconds of a comparison between two saves: the work that a kill may lose.
const SAVE_EVERY: f64 = 2.0;

impl<'a> Log<'a> {
    pub(super) fn new(step: u32, observer: &'a mut dyn Observe) -> Self {
        let saved = observer.seconds();
        Self { report: Report { step, ..Report::default() }, observer, saved }
    }

    /// Does `work` and adds its time to the part of [`Seconds`] that `part` picks.
    pub(super) fn timed<T>(
        &mut self,
        part: fn(&mut Seconds) -> &mut f64,
        work: impl FnOnce(&mut Report) -> T,
    ) -> T {
        self.timed_while(0.0, part, |report, _| work(report))
    }

    /// As [`Self::timed`]; `work` can ask whether to continue. `done`: completed fraction of the whole trial.
    pub(super) fn timed_while<T>(
        &mut self,
        done: f64,
        part: fn(&mut Seconds) -> &mut f64,
        work: impl FnOnce(&mut Report, &mut GoOn) -> T,
    ) -> T {
        let Self { report, observer, .. } = self;
        let start = observer.seconds();
        let result = work(report, &mut || observer.progress(done) == LoopControl::Continue);
        *part(&mut report.seconds) += observer.seconds() - start;
        result
    }

    pub(super) fn save_is_due(&mut self) -> bool {
        self.observer.seconds() - self.saved >= SAVE_EVERY
    }

    /// Passes the state, with the report's counters and times, to the observer.
    pub(super) fn save(&mut self, state: &mut State) {
        (state.comparison.counters, state.comparison.seconds) = (self.report.counters, self.report.seconds);
        self.observer.save(state);
        self.saved = self.observer.seconds();
    }

    /// Reports the progress of the comparison; `None` if the observer stops it. The observer then has the state.
    pub(super) fn report_progress(&mut self, problem: &Problem, state: &mut State) -> Option<()> {
        let wanted = self.observer.progress(state.comparison.completed_fraction(0, problem));
        if wanted == LoopControl::Stop || self.save_is_due() {
            self.save(state);
        }
        (wanted != LoopControl::Stop).then_some(())
    }
}
