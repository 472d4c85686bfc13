//! A prepared trial: its forces, integrators tuned on the initial body, and scales of the decoders.
//!
//! ```text
//! A(α) = readings of the sensors' chips on body α under forces f          ∂L/∂α = Aᵀ_α ∂L/∂A
//! ```
//! The nested optimisation and the analyses of single bodies share this context.

mod body;
mod chip;
mod filter;
mod mould;
mod outcome;
mod problem;
mod samples;
mod scales;
mod settings;

pub use body::{BodyFailure, BodyModel, BodyTape, Pilot, ScenePolygons, SimulationInput, SimulationOutput};
pub use chip::{Chip, ChipErrors, Size};
pub(crate) use mould::DesignWithSolver;
pub(crate) use outcome::as_ref_result;
pub use outcome::{Counters, Failure, Result, Trouble};
pub use problem::{ForceSets, Placing, Problem};
pub use samples::{FAILED, Samples, Spread, mean_error};
pub(crate) use samples::{error_of_each, pick};
pub use scales::Scales;
pub use settings::{
    CastObjective, Decoder, DecoderKind, FinalComparison, Normalisation, ObjectiveDomain, OuterLoop,
    RateSchedule, RidgeChoice, StepTraining, Terms, Training, TrainingProtocol,
};

use crate::dynamics::{self, Forces, IntegratorSettings, Outcome, Scene};
use crate::random::Purpose;
use crate::stimuli::HistorySource;
use crate::variation::{Cast, Casts, Chips};
use rayon::prelude::*;
use std::sync::OnceLock;

/// Separates the reasons for the accurate and the coarse integrator in [`Integrators::reason`].
pub(crate) const COARSE: &str = ". Coarse steps: ";
/// Samples of a pilot: the number of SIMD lanes.
const PILOT: usize = 8;

/// A prepared trial.
pub struct PreparedTrial<'a> {
    /// The problem, with tuned integrators.
    pub problem: Problem,
    /// Thread pool.
    pub pool: &'a crate::Pool,
    /// Accurate and coarse integrators.
    pub(crate) integrators: Integrators,
    /// Forces of the training samples.
    pub train: Forces,
    pub(crate) test: Forces,
    /// Scales of the linear decoder.
    pub scales: Scales,
    /// Scales of the networks.
    pub network_scales: Scales,
    /// Chips of the sensors.
    pub chip: Option<Chip>,
    /// Cholesky factor L of the correlation of node shifts in casts.
    likeness: Vec<f64>,
    /// The initial body under the training forces; determines the scales.
    pub(crate) initial: Samples,
    /// λ of the linear decoder on `initial`, once chosen.
    pub(crate) initial_ridge: OnceLock<Result<f64>>,
}

/// The choice of a trial's integrators.
pub(crate) struct Integrators {
    /// Why they were chosen.
    pub reason: String,
    /// Work of the pilots.
    pub pilots: dynamics::SimulationCounts,
    /// The accurate integrator of the initial body, without the work of its pilot.
    initial: Pilot,
    /// The accurate integrator of the spec, not tuned.
    requested: IntegratorSettings,
}

/// Result of a simulation with sensors.
pub struct Response {
    /// Readings and targets.
    pub samples: Samples,
    motion: SimulationOutput,
    /// Chips of the simulated cast.
    chips: Chips,
}

impl<'a> PreparedTrial<'a> {
    /// Draws the forces, tunes the integrators, simulates the initial body and computes the scales from it. Every
    /// process that resumes or analyses a trial obtains the same result.
    ///
    /// # Errors
    /// If no training sample has a force, if the initial body cannot be simulated, or if it exceeds the sensors' range.
    ///
    /// # Panics
    /// If the sensors have no units yet, or two share a unit.
    pub fn new(problem: &Problem, pool: &'a crate::Pool) -> Result<Self, Failure> {
        Self::with_chip(problem, pool, None)
    }

    /// Prepares another body under forces of another kind, with the same chips.
    ///
    /// # Errors
    /// If the body cannot be simulated.
    pub(crate) fn with_source(&self, source: &HistorySource, design: &[f64]) -> Result<Self, Failure> {
        let stimuli = ForceSets { source: source.clone(), ..self.problem.stimuli.clone() };
        let (initial, solver, under) = (design.to_vec(), self.integrators.requested, Vec::new());
        let mut problem = Problem { stimuli, initial, solver, under, ..self.problem.clone() };
        problem.optimise.coarse = None;
        Self::with_chip(&problem, self.pool, self.chip.clone())
    }

    /// Without `chip`, noise is relative to the signals of the initial body or of `problem.relative_to`.
    fn with_chip(problem: &Problem, pool: &'a crate::Pool, chip: Option<Chip>) -> Result<Self, Failure> {
        assert!(problem.search.is_none(), "the sensors are not in place");
        let sensors = &problem.scene.sensors;
        let twice = (1..sensors.len()).any(|i| sensors[..i].contains(&sensors[i]));
        assert!(!twice, "a unit twice in {sensors:?}");
        let (mut problem, asked) = (problem.clone(), problem.solver);
        let usual = pilot(&problem, &problem.initial, &asked, pool);
        let steps = problem.optimise.coarse.filter(|_| problem.optimise.iterations > 0);
        let coarse = steps.map(|coarse| pilot(&problem, &problem.initial, &coarse, pool));
        let (mut reason, mut pilots) = (usual.reason.clone(), usual.counters);
        problem.solver = usual.solver;
        if let Some(coarse) = coarse {
            reason = format!("{reason}{COARSE}{}", coarse.reason);
            pilots += coarse.counters;
            problem.optimise.coarse = Some(coarse.solver);
        }

        let [mut train, test] = problem.training_and_test();
        let plain =
            |design: &[f64], solver: &IntegratorSettings, forces: &mut Forces| -> Result<Samples, Failure> {
                let motion = simulated(&problem, &problem.scene, design, forces, solver, false, pool);
                check_failures(&motion.outcomes).map_err(Failure::Initial)?;
                let failed = clear_failed_forces(forces, &motion.outcomes);
                let signals = problem.read(motion.signals, forces.samples);
                Ok(problem.samples(signals, forces).with_failed(failed))
            };
        let chip = match (chip, &problem.relative_to) {
            (None, Some(design)) => {
                let tuned = pilot(&problem, design, &asked, pool);
                pilots += tuned.counters;
                let signals = plain(design, &tuned.solver, &mut train.clone());
                let signals = signals.map_err(|failure| Failure::Reference(failure.trouble()))?;
                problem.chip(&Scales::of(&signals).channels)
            }
            (chip, _) => chip,
        };
        let mut initial = plain(&problem.initial, &problem.solver, &mut train)?;
        if initial.targets.iter().all(|f| *f == 0.0) {
            return Err(Failure::Initial(Trouble::NoForce));
        }
        let scales = Scales::of(&initial);
        let chip = chip.or_else(|| problem.chip(&scales.channels));
        if let Some(chip) = &chip {
            chip.disturb(&mut initial.signals, &train);
            if 2 * chip.saturated(&initial.signals) > initial.signals.len() {
                return Err(Failure::Initial(Trouble::Saturated));
            }
        }
        let network_scales = match problem.brain.scaling {
            Normalisation::Rms => scales.clone(),
            Normalisation::Extremes => Scales::by_extremes(&initial),
        };
        let likeness =
            problem.variation.map_or(Vec::new(), |v| v.correlation_factor(&problem.scene.layout, pool));
        let usual = Pilot { counters: dynamics::SimulationCounts::default(), ..usual };
        let integrators = Integrators { reason, pilots, initial: usual, requested: asked };
        Ok(Self {
            problem,
            pool,
            integrators,
            train,
            test,
            scales,
            network_scales,
            chip,
            likeness,
            initial,
            initial_ridge: OnceLock::new(),
        })
    }

    /// Scales of the linear decoder and of the network for training signals (N, T, channels). With RMS scaling, the network uses
    /// the scale of its own body; otherwise networks on bodies with larger signals would learn faster.
    pub(crate) fn scales_of(&self, signals: &[f64]) -> [Scales; 2] {
        let network = match self.problem.brain.scaling {
            Normalisation::Rms => self.scales.with_rms_of(signals),
            Normalisation::Extremes => self.network_scales.clone(),
        };
        [self.scales.clone(), network]
    }

    /// The accurate integrator tuned on a body, with the work of the pilot (none for the initial body).
    pub fn tuned(&self, design: &[f64]) -> Pilot {
        match design == self.problem.initial {
            true => self.integrators.initial.clone(),
            false => pilot(&self.problem, design, &self.integrators.requested, self.pool),
        }
    }

    /// Simulates a body under `forces`, and counts the work.
    ///
    /// # Errors
    /// If a sample fails.
    pub fn simulate(
        &self,
        design: &[f64],
        forces: &Forces,
        solver: &IntegratorSettings,
        keep_tape: bool,
        counters: &mut Counters,
    ) -> Result<Response> {
        let scene = &self.problem.scene;
        let motion = simulated(&self.problem, scene, design, forces, solver, keep_tape, self.pool);
        counters.dynamics += motion.counters;
        check_outcomes(&motion.outcomes)?;
        Ok(self.response(motion, Chips::default(), forces, vec![false; forces.samples]))
    }

    /// Samples of a body or a cast of it, with the integrator tuned on the body.
    ///
    /// # Errors
    /// If too many samples fail.
    pub fn samples(&self, design: &[f64], cast: Option<&Cast>, forces: Forces) -> Result<Samples, Failure> {
        let mould = DesignWithSolver { trial: self, design, solver: &self.tuned(design).solver };
        mould.samples(cast, forces, &mut Counters::default()).map_err(Failure::Initial)
    }

    /// Draws a cast; `None` (as designed) without a variation.
    pub(crate) fn cast(&self, casts: Casts, number: u64) -> Option<Cast> {
        let problem = &self.problem;
        let (body, likeness) = ((&problem.scene.layout, problem.scene.sensors.len()), &self.likeness);
        problem.variation.map(|variation| variation.cast(problem.seed, casts, number, body, likeness))
    }

    /// Simulates a body or a cast of it; some samples may fail. The gradient is with respect to the design.
    ///
    /// # Errors
    /// If too many samples fail.
    pub(crate) fn simulate_cast(
        &self,
        cast: Option<&Cast>,
        design: &[f64],
        mut forces: Forces,
        solver: &IntegratorSettings,
        keep_tape: bool,
        counters: &mut Counters,
    ) -> Result<Response> {
        let scene = &self.problem.scene;
        let own = cast.map(|cast| (cast.scene(scene), cast.design(design)));
        let (scene, design) = own.as_ref().map_or((scene, design), |(scene, design)| (scene, design));
        let motion = simulated(&self.problem, scene, design, &forces, solver, keep_tape, self.pool);
        counters.dynamics += motion.counters;
        check_failures(&motion.outcomes)?;
        let failed = clear_failed_forces(&mut forces, &motion.outcomes);
        let chips = cast.map_or_else(Chips::default, |cast| cast.chips.clone());
        Ok(self.response(motion, chips, &forces, failed))
    }

    /// Computes `of` for 0 … `count` − 1 in parallel, because one cast has too few samples to occupy all threads. Adds the work to
    /// `counters` in an order that does not depend on the number of threads.
    pub(crate) fn map_parallel<T: Send>(
        &self,
        count: usize,
        counters: &mut Counters,
        of: impl Fn(usize, &mut Counters) -> T + Sync,
    ) -> Vec<T> {
        let counted = |number| {
            let mut own = Counters::default();
            (of(number, &mut own), own)
        };
        let work = || (0..count).into_par_iter().map(counted).unzip();
        let (found, taken): (Vec<T>, Vec<Counters>) = self.pool.install(work);
        taken.into_iter().for_each(|own| *counters += own);
        found
    }

    fn response(
        &self,
        mut motion: SimulationOutput,
        chips: Chips,
        forces: &Forces,
        failed: Vec<bool>,
    ) -> Response {
        let mut signals = std::mem::take(&mut motion.signals);
        chips.read(&mut signals);
        let signals = self.disturbed_signals(signals, forces);
        Response { samples: self.problem.samples(signals, forces).with_failed(failed), motion, chips }
    }

    /// dL/dα from a cotangent on the readings (N, T, channels) of a simulation with tape.
    ///
    /// # Errors
    /// If the gradient is not finite.
    pub fn vjp(
        &self,
        Response { motion, samples, chips }: &Response,
        mut cotangent: Vec<f64>,
        counters: &mut Counters,
    ) -> Result<Vec<f64>> {
        if let Some(chip) = &self.chip {
            chip.disturb_vjp(&mut cotangent, &samples.signals);
        }
        let mut cotangent = self.problem.read_vjp(cotangent, motion.outcomes.len());
        chips.read_vjp(&mut cotangent);
        let (gradient, work) = motion.tape.vjp(&cotangent, self.pool);
        counters.dynamics += work;
        match gradient.iter().all(|g| g.is_finite()) {
            true => Ok(gradient),
            false => Err(Trouble::GradientNonFinite),
        }
    }

    /// The chips' readings (N, T, channels) of simulated signals.
    pub fn disturbed_signals(&self, signals: Vec<f64>, forces: &Forces) -> Vec<f64> {
        let mut signals = self.problem.read(signals, forces.samples);
        if let Some(chip) = &self.chip {
            chip.disturb(&mut signals, forces);
        }
        signals
    }
}

/// Tunes an integrator on a body with the first samples.
pub fn pilot(problem: &Problem, design: &[f64], solver: &IntegratorSettings, pool: &crate::Pool) -> Pilot {
    let forces = problem.forces(Purpose::Stimulus, 0, problem.stimuli.samples.min(PILOT));
    tuned(problem, &problem.scene, design, &forces, solver, pool)
}

/// Tunes an integrator on any scene under given forces.
pub fn tuned(
    problem: &Problem,
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    solver: &IntegratorSettings,
    pool: &crate::Pool,
) -> Pilot {
    let (scene, forces) = problem.in_motion(scene, forces);
    problem.body.pilot(&scene, design, &forces, solver, pool)
}

/// Simulates on the clock of the motion, in f64 for the inverse decoder, to which f32 rounding would be noise.
pub fn simulated(
    problem: &Problem,
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    solver: &IntegratorSettings,
    keep_tape: bool,
    pool: &crate::Pool,
) -> SimulationOutput {
    let (scene, forces) = problem.in_motion(scene, forces);
    let double = problem.decoder_kind == DecoderKind::Inverse;
    let input = SimulationInput { design, forces: &forces, solver, keep_tape, double };
    problem.body.simulate(&scene, &input, pool)
}

/// Checks that all samples succeeded.
///
/// # Errors
/// The outcome of the first failed sample.
pub fn check_outcomes(outcomes: &[Outcome]) -> Result<()> {
    let failed = outcomes.iter().find(|&&outcome| outcome != Outcome::Ok);
    failed.map_or(Ok(()), |&outcome| Err(Trouble::Simulation(outcome)))
}

/// One of `FAILURE_RATIO` samples may fail, rounded to the nearest integer.
const FAILURE_RATIO: usize = 32;

/// Checks that few samples failed.
///
/// # Errors
/// If too many samples failed: the outcome of the first.
pub fn check_failures(outcomes: &[Outcome]) -> Result<()> {
    let failed = outcomes.iter().filter(|&&outcome| outcome != Outcome::Ok).count();
    let most = (outcomes.len() + FAILURE_RATIO / 2) / FAILURE_RATIO;
    if failed > most { check_outcomes(outcomes) } else { Ok(()) }
}

/// Sets the forces of failed samples to zero; returns which samples failed and had forces.
pub fn clear_failed_forces(forces: &mut Forces, outcomes: &[Outcome]) -> Vec<bool> {
    let len = forces.panels * (forces.instants + 1);
    let one = |(history, &outcome): (&mut [f64], &Outcome)| {
        let failed = outcome != Outcome::Ok && history.iter().any(|f| *f != 0.0);
        if failed {
            history.fill(0.0);
        }
        failed
    };
    forces.values.chunks_exact_mut(len).zip(outcomes).map(one).collect()
}

#[cfg(test)]
mod tests;
