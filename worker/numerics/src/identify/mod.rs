//! Fits a cast to measured records: its material, and every other property that manufacture scatters.
//!
//! ```text
//! min over z:  F = ½ ‖R^{-½} (y − a(z))‖² + ½ ‖z‖²      z standard normal, of what [`Deviations`] scatter; R noise and bias
//! ```
//! The fit is the maximum a posteriori estimate; z holds the unknowns of [`Deviations`], R the noise and bias. A free parameter stays
//! within a factor of `BOX` of the spec. All other scattered properties are fitted too, so that intervals cover shifted nodes. `descent`
//! has the steps, `search` the windows and starts.

mod clock;
mod descent;
mod discrepancy;
mod interval;
mod objective;
mod search;
mod unknowns;

use crate::dynamics::{Accuracy, Forces, Parameters, SimulationCounts};
use crate::trial::{Chip, DesignWithSolver, Problem, tuned};
use crate::variation::{Cast, Deviations};
pub use clock::{Offset, between, margin};
use descent::Descent;
pub use interval::Direction;
use objective::Misfit;
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
    /// k_c (N·mm/rad²), in scenes with contact.
    Contact,
}

impl Parameter {
    /// All parameters, in the order of `Parameters::array`.
    pub const ALL: [Self; 6] =
        [Self::Stretch, Self::Shear, Self::Bend, Self::Damping, Self::Density, Self::Contact];

    /// Name in outputs.
    pub fn name(self) -> &'static str {
        ["stretch", "shear", "bend", "damping", "density", "contact"][self as usize]
    }

    /// Unit; empty if dimensionless.
    pub fn unit(self) -> &'static str {
        ["N/mm", "N/mm", "N·mm/rad", "", "Mg/mm²", "N·mm/rad²"][self as usize]
    }
}

/// How a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// The Newton decrement is a fraction of a standard error.
    Converged,
    /// No step lowers F, although the gradient is not small.
    NoProgress,
    /// The limit on steps is reached.
    StepsSpent,
    /// The records do not determine some combination of free parameters.
    NotIdentifiable,
    /// A free parameter or a clock offset is at its bound.
    AtTheBound,
    /// Most of the signals remain in the residual: the records have another body, clock or unit.
    NotExplained,
    /// The body cannot be simulated at the start of the fit.
    StartFailed,
}

impl Ending {
    /// All endings, in declaration order.
    pub const ALL: [Self; 7] = [
        Self::Converged,
        Self::NoProgress,
        Self::StepsSpent,
        Self::NotIdentifiable,
        Self::AtTheBound,
        Self::NotExplained,
        Self::StartFailed,
    ];

    /// Name in outputs.
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

/// Callback of long computations: `false` stops them.
pub type GoOn<'a> = dyn FnMut() -> bool + 'a;

/// Steps in one window with one metric.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iteration {
    /// Window from the first force of each record (s).
    pub window: f64,
    /// RMS residual after the steps within the window: accelerations and rotation rates (% of the signals' RMS).
    pub misfit: [f64; 2],
    /// Parameters after the steps.
    pub parameters: Parameters,
}

/// A finished iteration. A fit resumes from all its turns with bit-identical results.
#[derive(Debug, Clone, PartialEq)]
pub struct FitIteration {
    /// Its window, misfit and parameters.
    pub iteration: Iteration,
    /// z after the iteration.
    pub z: Vec<f64>,
    /// How the iteration ended.
    pub ending: Ending,
    /// Number of steps.
    pub steps: usize,
}

/// Estimate of one unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The unknown.
    pub unknown: Unknown,
    /// Standard deviation of the prior: of a logarithm, in rad, or in mm.
    pub scatter: f64,
    /// Estimated z, in units of `scatter`.
    pub found: f64,
    /// Posterior standard deviation in units of `scatter`; 1 if the records do not determine the unknown.
    pub left: f64,
    /// Half width of the 95 % interval, including model discrepancy, in units of `scatter`; measured records only. `None` for a free
    /// parameter that is not identifiable or at its bound.
    pub half: Option<f64>,
    /// Whether this is a free parameter at its bound.
    pub at_the_bound: bool,
}

/// Model fitted to the records of a cast.
#[derive(Debug, Clone, PartialEq)]
pub struct Twin {
    /// Fitted cast; the design if the fit failed.
    pub cast: Cast,
    /// RMS over channels of residual/noise of the chips; 1 if that noise is unknown.
    pub misfit: f64,
    /// Noise per channel (mm/s², rad/s): the residual, at least the chips' noise.
    pub noise: Vec<f64>,
}

/// Result of a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The twin.
    pub twin: Twin,
    /// Estimate per unknown; free parameters come first.
    pub estimates: Vec<Estimate>,
    /// Clock offset per record; empty without clock uncertainty or intervals. `None`: the record cannot be simulated.
    pub offsets: Vec<Option<Offset>>,
    /// How the fit ended.
    pub ending: Ending,
    /// Share of the residual that filters of the fitted signals explain on left-out records (model discrepancy). `None` for one record or
    /// without intervals.
    pub unmodelled: Option<f64>,
    /// Combinations of free parameters that the records do not determine.
    pub undetermined: Vec<Direction>,
    /// Correlations of the free parameters' estimates; 0 with parameters that are not identifiable.
    pub correlation: Vec<Vec<f64>>,
    /// Start values unless records are measured.
    pub measured: MeasuredFit,
    /// Number of steps.
    pub steps: usize,
    /// Cost of the simulations.
    pub counters: SimulationCounts,
}

/// How a twin reproduces measured records.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MeasuredFit {
    /// RMS residual of accelerations and rotation rates (% of the signals' RMS), at the start and at the end.
    pub misfit: [[f64; 2]; 2],
    /// RMS residual at the end (mm/s², rad/s).
    pub residual: [f64; 2],
    /// Simulated readings (N, T, channels) at the start and at the end.
    pub signals: [Vec<f64>; 2],
    /// State of the fit after each iteration.
    pub iterations: Vec<Iteration>,
    /// Integration method.
    pub solver: String,
}

/// Largest factor between a free parameter and its value in the spec.
pub const BOX: f64 = 8.0;
/// RMS residual (%) of accelerations or rotation rates above which the signals are not explained.
pub const UNEXPLAINED: f64 = 50.0;
/// Largest integration error for measured records, where it does not average out.
const FINE: Accuracy = Accuracy(1e-4);

/// Records of one body: forces, readings (N, T, channels) as its chips return them, and the standard deviation of each record's clock error
/// (s).
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
            measured: MeasuredFit { misfit: [[100.0; 2]; 2], ..MeasuredFit::default() },
            steps: 0,
            counters: SimulationCounts::default(),
        }
    }

    /// Fits a cast of a trial's body to signals (N, T, channels) as its chips return them under `forces`. The prior is the trial's
    /// variation, or [`Deviations::USUAL`]. The caller must leave out failed samples. Returns `None` if `go_on` returns `false`.
    ///
    /// # Panics
    /// If lengths do not match.
    pub(crate) fn of(
        mould: &DesignWithSolver,
        (forces, signals): (&Forces, &[f64]),
        go_on: &mut GoOn,
    ) -> Option<Self> {
        let &DesignWithSolver { trial, design, solver } = mould;
        let variation = trial.problem.variation.unwrap_or(Deviations::USUAL);
        let unknowns = Unknowns::new(&trial.problem.scene, &variation, trial.pool);
        let all = (forces, signals, 0.0);
        let problem = &trial.problem;
        let objective = Misfit::new(problem, trial.chip.as_ref(), design, all, unknowns, solver, trial.pool);
        let mut fit = Self::begun(&objective.unknowns);
        let watch: &mut dyn FnMut(&FitIteration) = &mut |_| ();
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

    /// Fits a problem's body of this design to measured records, with intervals. `free` parameters are fitted and other parameters held at
    /// the spec. If `free` is empty, parameters scatter as in the trial's variation, or [`Deviations::USUAL`]; other properties always do.
    /// Relative noise in the spec refers to the records.
    ///
    /// The result does not depend on the number of threads. `known` holds earlier turns of the same fit; `watch` receives each new turn.
    ///
    /// # Panics
    /// If lengths do not match, or a free parameter is not above 0.
    pub fn of_records(
        problem: &Problem,
        design: &[f64],
        records: Records<'_>,
        free: &[Parameter],
        pool: &crate::Pool,
        known: &[FitIteration],
        watch: &mut dyn FnMut(&FitIteration),
    ) -> Self {
        let own = Parameters::of(&problem.scene).array();
        assert!(free.iter().all(|&k| own[k as usize] > 0.0), "{free:?} of {own:?}");
        let chip = chip(problem, records.1);
        let asked = problem.solver.at_most(FINE);
        let tuned = tuned(problem, &problem.scene, design, records.0, &asked, pool);
        let variation = problem.variation.unwrap_or(Deviations::USUAL);
        let unknowns = Unknowns::of_records(&problem.scene, &variation, free, pool);
        let mut fit = Self::begun(&unknowns);
        fit.measured.solver = tuned.reason;
        let mut objective =
            Misfit::new(problem, chip.as_ref(), design, records, unknowns, &tuned.solver, pool);
        objective.counters += tuned.counters;
        let go_on: &mut GoOn = &mut || true;
        let mut descent = Descent::new(objective, go_on, known, watch);
        if descent.objective.leave_out() > 0 {
            descent.fit(&mut fit, records.0, &asked, free.is_empty());
        }
        (fit.steps, fit.counters) = (descent.steps, descent.objective.counters);
        fit.measured.iterations = descent.iterations;
        fit
    }
}

/// Chips of the problem; relative noise refers to the RMS of these readings.
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
