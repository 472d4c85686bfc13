//! Searches without a gradient, as baselines: every candidate is made castable and read, and the best is kept.
//!
//! ```text
//! α = Π(α₀ + P z)     random: z ~ N(0, σ²)     cmaes: z of CMA-ES from σ on     fitness = e_test · (1 + (lost/asked)²)
//! ```
//! with what the projection took of a candidate's way as lost: CMA-ES goes on from where it asked, not from where it was
//! put. A step reads one candidate, the first one the initial body.

mod evolution;

use super::observe::Log;
use super::protocol::Sensed;
use super::state::{State, norm};
use crate::body::Freedom;
use crate::feasible::Feasible;
use crate::random::{Purpose, Stream};
use crate::trial::{Failure, Problem, Protocol, Trouble};
use evolution::Evolution;

/// The candidates of a search at work.
pub(super) struct GradientFree<'a> {
    problem: &'a Problem,
    freedom: Freedom,
    evolution: Option<Evolution>,
}

impl<'a> GradientFree<'a> {
    /// The problem's, where its protocol is one, as far as it had come with what `found` holds.
    pub(super) fn new(problem: &'a Problem, found: &[f64]) -> Option<Self> {
        let freedom = problem.freedom();
        let evolution = match problem.optimise.protocol {
            Protocol::Random(_) => None,
            Protocol::Cmaes(_) => {
                Some(Evolution::new(freedom.parameters(), problem.optimise.rate, problem.seed))
            }
            _ => return None,
        };
        let mut search = Self { problem, freedom, evolution };
        found.iter().for_each(|fitness| search.tell(*fitness));
        Some(search)
    }

    fn tell(&mut self, fitness: f64) {
        if let Some(evolution) = &mut self.evolution {
            evolution.tell(fitness);
        }
    }

    /// The candidate after so many, as it is asked for.
    fn target(&self, number: usize) -> Vec<f64> {
        let coordinates = self.freedom.coordinates();
        let drawn = match &self.evolution {
            Some(evolution) => {
                debug_assert_eq!(evolution.told(), number as u64);
                evolution.ask()
            }
            None => {
                let mut stream = Stream::new(Purpose::Search, self.problem.seed, [number as u64, 0]);
                coordinates.iter().map(|_| self.problem.optimise.rate * stream.normal()).collect()
            }
        };
        let mut z = vec![0.0; self.problem.initial.len()];
        coordinates.into_iter().zip(drawn).for_each(|(i, x)| z[i] = x);
        self.problem.initial.iter().zip(self.freedom.spread(&z)).map(|(a, b)| a + b).collect()
    }

    /// Takes in what was read of the state's design, and puts the next candidate there.
    ///
    /// # Errors
    /// If the initial body could not be read.
    pub(super) fn step(
        &mut self,
        sensed: Result<Sensed, Trouble>,
        state: &mut State,
        castable: &mut Feasible,
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
            let target = self.target(state.found.len());
            let [asked, lost] = [initial, &state.design].map(|from| distance(&target, from));
            let fitness = error * (1.0 + (lost / asked.max(f64::MIN_POSITIVE)).powi(2));
            state.found.push(fitness);
            self.tell(fitness);
        }
        let target = self.target(state.found.len());
        let projection = log.timed(|s| &mut s.project, |_| castable.project(initial, &target, None));
        state.put(self.problem, &self.freedom, projection, &mut log.report);
        Ok(())
    }
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    norm(a.iter().zip(b).map(|(a, b)| a - b))
}
