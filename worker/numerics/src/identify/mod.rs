//! The cast that best explains measured records: its material, and what else manufacture scatters.
//!
//! ```text
//! min over z:  F = ½ ‖R^{-½} (y − a(z))‖² + ½ ‖z‖²      z standard normal, of what a [`Variation`] scatters; R noise and bias
//! ```
//! The maximum a posteriori estimate. A parameter that is free may differ from its start by a factor of `BOX`; what else scatters is fitted
//! with it, so that its interval contains what shifted nodes look like. `descent` has the steps, `search` the way to them.

mod clock;
mod descent;
mod discrepancy;
mod interval;
mod objective;
mod search;
mod unknowns;

use crate::dynamics::{Accuracy, Counters, Forces, Parameters};
use crate::trial::{Chip, Mould, Problem, tuned};
use crate::variation::{Cast, Variation};
pub use clock::{Offset, between, margin};
use descent::Descent;
pub use interval::Direction;
use objective::Objective;
pub use unknowns::Unknown;
use unknowns::Unknowns;

/// A parameter that can be fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Parameter {
    /// k_l (N/mm).
    Stretch,
    /// k_s (N/mm).
    Shear,
    /// k_θ (N·mm/rad).
    Bend,
    /// ζ.
    Damping,
    /// Plane density (Mg/mm²).
    Density,
    /// k_c (N·mm/rad²), of a scene with contact.
    Contact,
}

impl Parameter {
    /// All, in the order of `Parameters::array`.
    pub const ALL: [Self; 6] =
        [Self::Stretch, Self::Shear, Self::Bend, Self::Damping, Self::Density, Self::Contact];

    /// The name by which people know it.
    pub fn name(self) -> &'static str {
        ["stretch", "shear", "bend", "damping", "density", "contact"][self as usize]
    }

    /// Its unit, empty of a pure number.
    pub fn unit(self) -> &'static str {
        ["N/mm", "N/mm", "N·mm/rad", "", "Mg/mm²", "N·mm/rad²"][self as usize]
    }
}

/// How a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// What is left of a step is a part of a standard error.
    Converged,
    /// No step lowers what is minimised any more, though its gradient asks for one.
    NoProgress,
    /// All steps are spent.
    StepsSpent,
    /// The records do not determine some combination of free parameters.
    NotIdentifiable,
    /// A free parameter or a clock is as far from its start as it may be: the records ask for more.
    AtTheBound,
    /// The fitted motion leaves most of the signals: the records are not those of this body, clock or units.
    NotExplained,
    /// Where it was to begin, the body cannot be simulated.
    StartFailed,
}

impl Ending {
    /// All, in their order.
    pub const ALL: [Self; 7] = [
        Self::Converged,
        Self::NoProgress,
        Self::StepsSpent,
        Self::NotIdentifiable,
        Self::AtTheBound,
        Self::NotExplained,
        Self::StartFailed,
    ];

    /// The name by which people know it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::NoProgress => "no progress",
            Self::StepsSpent => "steps spent",
            Self::NotIdentifiable => "not identifiable",
            Self::AtTheBound => "at the bound",
            Self::NotExplained => "signals not explained",
            Self::StartFailed => "the start cannot be simulated",
        }
    }
}

/// Asked in the course of long work whether it is to go on.
pub type GoOn<'a> = dyn FnMut() -> bool + 'a;

/// Steps in one window and metric.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iteration {
    /// How much of each record was looked at (s), from its first force.
    pub window: f64,
    /// RMS of the residual in % of the signals', accelerations and rotation rates, within the window, after them.
    pub misfit: [f64; 2],
    /// The parameters after them.
    pub parameters: Parameters,
}

/// An iteration and what came of it: with all of them a fit goes on to the same bits from where it was.
#[derive(Debug, Clone, PartialEq)]
pub struct Turn {
    /// What it was.
    pub iteration: Iteration,
    /// z after it.
    pub z: Vec<f64>,
    /// How it ended.
    pub ending: Ending,
    /// Steps taken.
    pub steps: usize,
}

/// What is known of one unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Which.
    pub unknown: Unknown,
    /// Standard deviation of its prior: of a logarithm, in rad, in mm.
    pub scatter: f64,
    /// Its estimate z, in units of `scatter`.
    pub found: f64,
    /// Standard deviation of its posterior, in units of `scatter`; 1 if the records do not determine it.
    pub left: f64,
    /// Half width of its 95 % interval, in units of `scatter`, with the discrepancy of the model; of measured records. None for a free
    /// parameter that is not identifiable or at the bound.
    pub half: Option<f64>,
    /// Whether it is a free parameter as far from its start as it may be.
    pub at_the_bound: bool,
}

/// A twin.
#[derive(Debug, Clone, PartialEq)]
pub struct Twin {
    /// The cast that explains the records best; as designed where none was found.
    pub cast: Cast,
    /// RMS over the channels of the residual, divided by the noise of the chips; 1 if that noise is unknown and estimated from the
    /// residual.
    pub misfit: f64,
    /// What stands for the noise of each channel that is read (mm/s², rad/s): what is left, but no less than the chips'.
    pub noise: Vec<f64>,
}

/// How a twin was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// It.
    pub twin: Twin,
    /// Of each unknown; free parameters come first.
    pub estimates: Vec<Estimate>,
    /// By how much later each record's readings were taken than it says, where clocks may be off and intervals were asked for; none of
    /// a record that the body cannot be simulated under.
    pub offsets: Vec<Option<Offset>>,
    /// How the fit ended.
    pub ending: Ending,
    /// Share of what is left that the motion explains on records that were not asked, where several were fitted and intervals asked for:
    /// what the model lacks.
    pub unmodelled: Option<f64>,
    /// Combinations of free parameters that the records do not determine.
    pub undetermined: Vec<Direction>,
    /// Correlations of the free parameters' estimates, zero with what is not identifiable.
    pub correlation: Vec<Vec<f64>>,
    /// RMS of the residual in % of the signals', accelerations and rotation rates: at the start and at the end; of measured records.
    pub misfit: [[f64; 2]; 2],
    /// RMS of the residual at the end (mm/s², rad/s), likewise.
    pub residual: [f64; 2],
    /// Simulated readings (N, T, channels) at the start and at the end, likewise.
    pub signals: [Vec<f64>; 2],
    /// Iterations on measured records.
    pub iterations: Vec<Iteration>,
    /// How those were integrated.
    pub solver: String,
    /// Steps taken.
    pub steps: usize,
    /// Work done.
    pub counters: Counters,
}

/// Farthest from the spec's value that a free parameter may be, as a factor.
pub const BOX: f64 = 8.0;
/// RMS of the residual (%), of accelerations or rotation rates, above which a fit has not explained the signals.
pub const UNEXPLAINED: f64 = 50.0;
/// Error of the signals by steps under measured records, in which it does not average out.
const FINE: Accuracy = Accuracy(1e-4);

/// Records of one body: forces, readings (N, T, channels) as its chips give them, and the standard deviation of the error of each record's
/// clock (s).
pub type Records<'a> = (&'a Forces, &'a [f64], f64);

impl Fit {
    fn begun(unknowns: &Unknowns) -> Self {
        let cast = unknowns.cast(&vec![0.0; unknowns.all().len()]);
        Self {
            twin: Twin { cast, misfit: f64::INFINITY, noise: Vec::new() },
            estimates: Vec::new(),
            offsets: Vec::new(),
            ending: Ending::StartFailed,
            unmodelled: None,
            undetermined: Vec::new(),
            correlation: Vec::new(),
            misfit: [[100.0; 2]; 2],
            residual: [0.0; 2],
            signals: [Vec::new(), Vec::new()],
            iterations: Vec::new(),
            solver: String::new(),
            steps: 0,
            counters: Counters::default(),
        }
    }

    /// Of a trial's body from signals (N, T, channels) as its chips give them under `forces`. What
    /// scatters is the trial's variation, or [`Variation::USUAL`]. Samples that failed must be left out. `None` if it is told meanwhile not to
    /// go on.
    ///
    /// # Panics
    /// If lengths do not fit together.
    pub(crate) fn of(mould: &Mould, (forces, signals): (&Forces, &[f64]), go_on: &mut GoOn) -> Option<Self> {
        let &Mould { trial, design, solver } = mould;
        let variation = trial.problem.variation.unwrap_or(Variation::USUAL);
        let unknowns = Unknowns::new(&trial.problem.scene, &variation, trial.pool);
        let all = (forces, signals, 0.0);
        let problem = &trial.problem;
        let objective =
            Objective::new(problem, trial.chip.as_ref(), design, all, unknowns, solver, trial.pool);
        Self::of_cast(objective, go_on)
    }

    fn of_cast(objective: Objective<'_>, go_on: &mut GoOn) -> Option<Self> {
        let mut fit = Self::begun(&objective.unknowns);
        let watch: &mut dyn FnMut(&Turn) = &mut |_| ();
        let mut descent = Descent::new(objective, go_on, &[], watch);
        if descent.objective.leave_out() > 0 {
            fit.ending = Ending::NoProgress;
            if let Some((point, columns)) = descent.by_windows(&mut fit.ending)? {
                fit.tell(&descent.objective, &point, &columns);
            }
        }
        (fit.steps, fit.counters) = (descent.steps, descent.objective.counters);
        Some(fit)
    }

    /// Of a problem's body of this design from measured records, with intervals. `free` parameters may take any value, others are the
    /// spec's; if none is free, all scatter as the trial's variation says, or [`Variation::USUAL`]. The rest scatters so in any case. Noise
    /// that the spec has relative is so to the records.
    ///
    /// The result does not depend on the number of threads. `watch` sees every turn but those that are `known`, of the same fit before.
    ///
    /// # Panics
    /// If lengths do not fit together, or a free parameter is not above 0.
    pub fn of_records(
        problem: &Problem,
        design: &[f64],
        records: Records<'_>,
        free: &[Parameter],
        pool: &crate::Pool,
        known: &[Turn],
        watch: &mut dyn FnMut(&Turn),
    ) -> Self {
        let own = Parameters::of(&problem.scene).array();
        assert!(free.iter().all(|&k| own[k as usize] > 0.0), "{free:?} of {own:?}");
        let chip = chip(problem, records.1);
        let asked = problem.solver.at_most(FINE);
        let tuned = tuned(problem, &problem.scene, design, records.0, &asked, pool);
        let variation = problem.variation.unwrap_or(Variation::USUAL);
        let unknowns = Unknowns::of_records(&problem.scene, &variation, free, pool);
        let mut fit = Self::begun(&unknowns);
        fit.solver = tuned.reason;
        let mut objective =
            Objective::new(problem, chip.as_ref(), design, records, unknowns, &tuned.solver, pool);
        objective.counters += tuned.counters;
        let go_on: &mut GoOn = &mut || true;
        let mut descent = Descent::new(objective, go_on, known, watch);
        if descent.objective.leave_out() > 0 {
            descent.fit(&mut fit, records.0, &asked, free.is_empty());
        }
        (fit.steps, fit.counters) = (descent.steps, descent.objective.counters);
        fit.iterations = descent.iterations;
        fit
    }
}

/// The chips, what is relative in them so to these readings.
fn chip(problem: &Problem, readings: &[f64]) -> Option<Chip> {
    let width = problem.shape().inputs;
    let rms = |c: usize| {
        let of = readings[c..].iter().step_by(width);
        (of.map(|y| y * y).sum::<f64>() * width as f64 / readings.len() as f64).sqrt()
    };
    problem.chip(&(0..width).map(rms).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests;
