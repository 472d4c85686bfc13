//! Search without gradients, as a baseline: evaluates random feasible designs and keeps the best.
//!
//! ```text
//! α = Π(α₀ + P z)     z ~ N(0, σ²)     fitness = e_test · (1 + (lost/asked)²)
//! ```
//! `asked` and `lost` are the distances (mm) of the target α₀ + P z from α₀ and from α. The first candidate is the initial body.

use super::observe::Log;
use super::protocol::StepResult;
use super::state::State;
use crate::body::Freedom;
use crate::feasible::{Castable, distance};
use crate::random::{Purpose, Stream};
use crate::trial::{Failure, Problem, Trouble};

/// A random search.
pub(super) struct GradientFree<'a> {
    problem: &'a Problem,
    freedom: Freedom,
}

impl<'a> GradientFree<'a> {
    /// `None` unless the protocol is a search.
    pub(super) fn new(problem: &'a Problem) -> Option<Self> {
        let is_search = problem.optimise.protocol.is_search();
        is_search.then(|| Self { problem, freedom: problem.body.freedom(problem) })
    }

    /// Target α (mm) of candidate `number`, before projection.
    fn target(&self, number: usize) -> Vec<f64> {
        let mut stream = Stream::new(Purpose::Search, self.problem.seed, [number as u64, 0]);
        let mut z = vec![0.0; self.problem.initial.len()];
        for i in self.freedom.coordinates() {
            z[i] = self.problem.optimise.rate * stream.normal();
        }
        self.problem.initial.iter().zip(self.freedom.spread(&z)).map(|(a, b)| a + b).collect()
    }

    /// Records the evaluation of the state's design, and replaces this design by the next candidate.
    ///
    /// # Errors
    /// If the initial body could not be evaluated.
    pub(super) fn step(
        &self,
        sensed: Result<StepResult, Trouble>,
        state: &mut State,
        castable: &mut dyn Castable,
        log: &mut Log,
    ) -> Result<(), Failure> {
        let initial = &self.problem.initial;
        let error = match sensed {
            Ok(sensed) => {
                state.remember(sensed.loss_train, sensed.error_test);
                sensed.error_test.unwrap_or(f64::INFINITY)
            }
            Err(trouble) if state.step == 0 => return Err(Failure::Initial(trouble)),
            Err(trouble) => {
                log.report.trouble = Some(trouble);
                f64::INFINITY
            }
        };
        if state.step > 0 {
            let target = self.target(state.fitness.len());
            let [target_distance, projection_distance] =
                [initial, &state.design].map(|from| distance(&target, from));
            let fitness =
                error * (1.0 + (projection_distance / target_distance.max(f64::MIN_POSITIVE)).powi(2));
            state.fitness.push(fitness);
        }
        let target = self.target(state.fitness.len());
        let projection = log.timed(|s| &mut s.project, |_| castable.project(initial, &target, None));
        state.set_design(self.problem, &self.freedom, projection, &mut log.report);
        Ok(())
    }
}
