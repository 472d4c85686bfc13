//! Sensor search before a trial: places sensors where a linear decoder has the least error on the initial body's training
//! samples.
//!
//! All candidates use the same simulations, with the chip properties of the sensors.

use super::{CANDIDATES, FIRST_RIDGE, NoPlacement, Placed, Scores};
use crate::Pool;
use crate::brain::linear::Sizes;
use crate::brains::ScaledSamples;
use crate::brains::ridge::assign_folds;
use crate::dynamics::Scene;
use crate::trial::{Counters, Failure, OuterLoop, Placing, PreparedTrial, Problem, Trouble};

/// Number of candidates, spread over all, that test whether energies help.
const JUDGES: usize = 4;
/// Number of candidates that are rated together if there are too many to search.
const GROUP: usize = 8;

/// Signals of all candidates.
#[derive(Debug, Clone)]
pub struct Candidates {
    /// Units, in the order of their channels.
    pub units: Vec<usize>,
    samples: ScaledSamples,
    dealt: Vec<usize>,
    /// Whether the energies of signals, as additional inputs, lower the error.
    energies: bool,
}

impl Candidates {
    /// Simulates the candidates of `search` on a body under the training samples.
    ///
    /// # Errors
    /// If the body cannot be simulated, or fewer than two folds contain forces.
    pub fn new(problem: &Problem, search: &Placing, design: &[f64], pool: &Pool) -> Result<Self, Failure> {
        let units = search.candidates.clone();
        // Without chip masses, which on all candidates would change the body.
        let scene = Scene { sensors: units.clone(), chip: None, ..problem.scene.clone() };
        let optimise = OuterLoop { coarse: None, ..problem.optimise };
        let trial = PreparedTrial::new(&Problem { scene, search: None, optimise, ..problem.clone() }, pool)?;
        let heard = if design == problem.initial {
            trial.initial.clone()
        } else {
            let solver = trial.tuned(design).solver;
            let counters = &mut Counters::default();
            let response = trial.simulate(design, &trial.train, &solver, false, counters);
            response.map_err(Failure::Initial)?.samples
        };
        let samples = ScaledSamples::of(&heard, &trial.scales, pool);
        let dealt = assign_folds(problem.seed, heard.count());
        // Forces must occur in at least two folds.
        let mut struck = dealt.iter().zip(&samples.w).filter(|(_, w)| **w > 0.0).map(|(fold, _)| fold);
        let first = struck.next();
        if struck.all(|fold| Some(fold) == first) {
            return Err(Failure::Initial(Trouble::FewForces));
        }
        let plain = Self { units, samples, dealt, energies: false };
        let mut judges: Vec<usize> =
            (0..JUDGES).map(|j| plain.units[j * (plain.units.len() - 1) / (JUDGES - 1)]).collect();
        judges.dedup();
        let mut judges = plain.select_units(&judges);
        let mut error = |energies| {
            judges.energies = energies;
            judges.scores(problem, pool).of_all()
        };
        let energies = error(true) < error(false);
        Ok(Self { energies, ..plain })
    }

    /// Keeps the best single units if there are too many to search.
    pub fn limit_candidates(self, problem: &Problem, pool: &Pool) -> Self {
        if self.units.len() <= CANDIDATES {
            return self;
        }
        let alone = self.rank_additions(&[], FIRST_RIDGE, problem, pool);
        let mut best: Vec<usize> = alone[..CANDIDATES].iter().map(|(unit, _)| *unit).collect();
        best.sort_unstable();
        self.select_units(&best)
    }

    /// Each unit that is not chosen, with the error (%) of a linear decoder of the chosen units and this one, best first.
    pub fn rank_additions(
        &self,
        chosen: &[usize],
        ridge: f64,
        problem: &Problem,
        pool: &Pool,
    ) -> Vec<(usize, f64)> {
        let others: Vec<usize> = self.units.iter().copied().filter(|unit| !chosen.contains(unit)).collect();
        let rated_group = |group: &[usize]| {
            let some = self.select_units(&[chosen, group].concat());
            some.scores(problem, pool).errors_with_each(chosen, group, 0.0, ridge)
        };
        let mut worth: Vec<(usize, f64)> = others.chunks(GROUP).flat_map(rated_group).collect();
        worth.sort_by(|a, b| a.1.total_cmp(&b.1));
        worth
    }

    /// Signals of some of the units.
    ///
    /// # Panics
    /// If one is not a candidate.
    pub fn select_units(&self, units: &[usize]) -> Self {
        let position = |unit: &usize| self.units.iter().position(|u| u == unit).expect("a candidate");
        let each = self.samples.sizes.channels / self.units.len();
        let from: Vec<usize> = units.iter().map(position).flat_map(|i| each * i..each * (i + 1)).collect();
        let rows = self.samples.x.chunks_exact(self.samples.sizes.channels);
        let x = rows.flat_map(|row| from.iter().map(|&c| row[c])).collect();
        let sizes = Sizes { channels: from.len(), ..self.samples.sizes };
        let samples = ScaledSamples { sizes, x, ..self.samples.clone() };
        Self { units: units.to_vec(), samples, dealt: self.dealt.clone(), energies: self.energies }
    }

    /// Prepares errors of subsets of the units.
    pub fn scores<'a>(&self, problem: &'a Problem, pool: &'a Pool) -> Scores<'a> {
        let ScaledSamples { sizes, x, y, w, .. } = &self.samples;
        let (layout, units) = (&problem.scene.layout, self.units.clone());
        Scores::new(layout, units, *sizes, [x, y, w], &self.dealt, self.energies, pool)
    }
}

/// The problem with its sensors placed, and the result of the search; unchanged if sensors are given.
///
/// # Errors
/// If the initial body cannot be simulated, or no placement exists.
pub fn placed(problem: &Problem, pool: &Pool) -> Result<(Problem, Option<Placed>), Failure> {
    let Some(search) = &problem.search else { return Ok((problem.clone(), None)) };
    let candidates =
        Candidates::new(problem, search, &problem.initial, pool)?.limit_candidates(problem, pool);
    let search = Placing { candidates: candidates.units.clone(), ..search.clone() };
    let found = candidates.scores(problem, pool).search(&search);
    let found = found.map_err(|NoPlacement| Failure::Initial(Trouble::Nowhere))?;
    let mut problem = problem.clone();
    problem.scene.sensors = found.units.clone();
    problem.search = None;
    Ok((problem, Some(found)))
}
