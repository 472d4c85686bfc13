//! Who watches an outer loop, and the log that it writes for them.

use super::report::{Report, Seconds};
use super::state::State;
use crate::identify::GoOn;
use crate::trial::Problem;

/// Who watches an outer loop. The maths has no clock of its own.
pub trait Observe {
    /// Seconds since any fixed moment.
    fn seconds(&mut self) -> f64;
    /// The part of the whole trial that is done. An outer step is finished all the same, a training in the comparison at the
    /// end is not.
    fn progress(&mut self, fraction: f64) -> Control;
    /// A finished outer step, and the state to go on from after it.
    fn step(&mut self, report: &Report, state: &State) -> Control;
    /// The state to go on from within the comparison at the end, every few seconds, and where it stops.
    fn save(&mut self, state: &State);
}

/// What an observer wants next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// More.
    Continue,
    /// No more.
    Stop,
}

/// Nobody watches, and time does not count.
#[derive(Debug)]
pub struct Nobody;

impl Observe for Nobody {
    fn seconds(&mut self) -> f64 {
        0.0
    }

    fn progress(&mut self, _: f64) -> Control {
        Control::Continue
    }

    fn step(&mut self, _: &Report, _: &State) -> Control {
        Control::Continue
    }

    fn save(&mut self, _: &State) {}
}

/// The report under way, and the clock.
pub(super) struct Log<'a> {
    pub(super) report: Report,
    observer: &'a mut dyn Observe,
    /// When the state was last saved, or this was made.
    saved: f64,
}

/// Seconds of a comparison between two savings of it: what a kill may cost.
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
        let start = self.observer.seconds();
        let result = work(&mut self.report);
        *part(&mut self.report.seconds) += self.observer.seconds() - start;
        result
    }

    /// The same of work that asks meanwhile whether it is to go on, as long as a part of the whole trial is done.
    pub(super) fn timed_while<T>(
        &mut self,
        done: f64,
        part: fn(&mut Seconds) -> &mut f64,
        work: impl FnOnce(&mut Report, &mut GoOn) -> T,
    ) -> T {
        let Self { report, observer, .. } = self;
        let start = observer.seconds();
        let result = work(report, &mut || observer.progress(done) == Control::Continue);
        *part(&mut report.seconds) += observer.seconds() - start;
        result
    }

    pub(super) fn seconds(&mut self) -> f64 {
        self.observer.seconds()
    }

    pub(super) fn progress(&mut self, fraction: f64) -> Control {
        self.observer.progress(fraction)
    }

    pub(super) fn save_is_due(&mut self) -> bool {
        self.observer.seconds() - self.saved >= SAVE_EVERY
    }

    /// Hands the observer the state, with what the report says of the comparison.
    pub(super) fn save(&mut self, state: &mut State) {
        (state.comparison.counters, state.comparison.seconds) = (self.report.counters, self.report.seconds);
        self.observer.save(state);
        self.saved = self.observer.seconds();
    }

    /// Tells the observer how far the comparison has come; `None` if it says stop: it has the state by then.
    pub(super) fn paused(&mut self, problem: &Problem, state: &mut State) -> Option<()> {
        let wanted = self.progress(state.comparison.part(0, problem));
        if wanted == Control::Stop || self.save_is_due() {
            self.save(state);
        }
        (wanted != Control::Stop).then_some(())
    }
}
