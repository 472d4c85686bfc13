//! What stays fixed during a trial: forces, targets, split, and the scales between physics and network.
//!
//! ```text
//! x = A / rms(A₀)          y = (f − mean)/deviation        f̂ = mean + deviation·ŷ
//! ```
//! rms a channel of the initial body's training signals A₀, mean and deviation a panel of the training forces. A fresh
//! network at the end is trained on A / rms(A), its body's own, and then told to take x.

use super::chip::Chip;
use super::problem::{Kind, Problem};
use super::report::{Failure, Log, Report, Trouble};
use crate::brain::{self, Data, Real, Shape, Workspace};
use crate::dynamics::{self, Forces, Outcome, Simulation, Solver, Wrt, planned};

/// The fixed part of a trial.
pub(super) struct Setting<'a> {
    pub(super) problem: &'a Problem,
    pub(super) pool: &'a crate::Pool,
    pub(super) shape: Shape,
    pub(super) train: Forces,
    pub(super) test: Forces,
    pub(super) scales: Scales,
    pub(super) chip: Option<Chip>,
    /// The initial body's training signals, from which the scales come (N, T, 3M).
    pub(super) initial_signals: Vec<f64>,
}

/// Scales between physics and network.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scales {
    /// RMS of each signal channel (3M).
    pub(super) channels: Vec<f64>,
    /// Mean force of each panel (N).
    pub(super) mean: Vec<f64>,
    /// Standard deviation of each panel's force (N).
    pub(super) deviation: Vec<f64>,
}

impl<'a> Setting<'a> {
    /// Draws the forces, simulates the initial body and takes the scales.
    pub(super) fn new(problem: &'a Problem, pool: &'a crate::Pool) -> Result<Self, Failure> {
        let [mut train, test] = problem.known();
        let shape = problem.shape();
        let simulation = simulated(problem, &problem.initial, &train, &problem.solver, false, pool);
        silence(&mut train, &simulation.outcomes).map_err(Failure::Initial)?;
        let scales = Scales::new(&shape, &simulation.signals, &problem.targets(&train));
        let chip = problem.chip(&scales.channels);
        let mut setting =
            Self { problem, pool, shape, train, test, scales, chip, initial_signals: simulation.signals };
        let mut signals = std::mem::take(&mut setting.initial_signals);
        setting.disturb(&mut signals, &setting.train);
        setting.initial_signals = signals;
        Ok(setting)
    }

    /// Simulated signals as the chips say them.
    pub(super) fn disturb(&self, signals: &mut [f64], forces: &Forces) {
        if let Some(chip) = &self.chip {
            chip.disturb(signals, forces);
        }
    }

    /// Simulates a body under `forces` and counts the work.
    pub(super) fn simulate(
        &self,
        design: &[f64],
        forces: &Forces,
        solver: &Solver,
        keep_tape: bool,
        report: &mut Report,
    ) -> Result<Simulation, Trouble> {
        let mut simulation = simulated(self.problem, design, forces, solver, keep_tape, self.pool);
        report.counters.dynamics += simulation.counters;
        all_well(&simulation.outcomes)?;
        self.disturb(&mut simulation.signals, forces);
        Ok(simulation)
    }

    /// The same where some samples may fail: from then on `forces` has them without force, and they without signals, as
    /// all know what to do with. Returns how many.
    pub(super) fn simulate_most(
        &self,
        design: &[f64],
        forces: &mut Forces,
        solver: &Solver,
        keep_tape: bool,
        report: &mut Report,
    ) -> Result<(Simulation, u32), Trouble> {
        let mut simulation = simulated(self.problem, design, forces, solver, keep_tape, self.pool);
        report.counters.dynamics += simulation.counters;
        let failed = silence(forces, &simulation.outcomes)?;
        self.disturb(&mut simulation.signals, forces);
        Ok((simulation, failed))
    }

    /// Simulates a body under two sets of forces, each with a tape where `true` stands beside it.
    pub(super) fn simulate_both(
        &self,
        design: &[f64],
        [first, second]: [(&Forces, bool); 2],
        solver: &Solver,
        log: &mut Log,
    ) -> Result<[Simulation; 2], Trouble> {
        log.timed(
            |s| &mut s.simulate,
            |report| {
                let mut of = |(forces, tape)| self.simulate(design, forces, solver, tape, report);
                Ok([of(first)?, of(second)?])
            },
        )
    }

    /// dL/dα of a cotangent on the network's inputs (N, T, 3M), of all samples of the simulation.
    pub(super) fn vjp(
        &self,
        simulation: &Simulation,
        inputs: &[f64],
        log: &mut Log,
    ) -> Result<Vec<f64>, Trouble> {
        let mut cotangent = self.scales.inputs_vjp(inputs);
        if let Some(chip) = &self.chip {
            chip.disturb_vjp(&mut cotangent, simulation.outcomes.len());
        }
        let gradient =
            log.timed(|s| &mut s.differentiate, |_| simulation.vjp(&cotangent, Wrt::Design, self.pool));
        log.report.counters.dynamics += gradient.counters;
        if gradient.design.iter().all(|g| g.is_finite()) {
            Ok(gradient.design)
        } else {
            Err(Trouble::GradientNonFinite)
        }
    }

    /// Inputs and targets of the network, normalised.
    pub(super) fn data<F: Real>(&self, signals: &[f64], forces: &Forces) -> Data<F> {
        self.scales.data(self.shape, signals, &self.problem.targets(forces))
    }

    /// Overwrites the samples of `data` from number `first` on.
    pub(super) fn fill(&self, data: &mut Data<f32>, first: usize, signals: &[f64], forces: &Forces) {
        let (x, y) = (self.scales.inputs(signals), self.scales.targets(&self.problem.targets(forces)));
        let (row_x, row_y) =
            (self.shape.instants * self.shape.inputs, self.shape.instants * self.shape.outputs);
        for (n, (x, y)) in x.chunks_exact(row_x).zip(y.chunks_exact(row_y)).enumerate() {
            data.set(first + n, x, y);
        }
    }

    /// The same as `data`, its loss in N².
    pub(super) fn physical_data<F: Real>(&self, signals: &[f64], forces: &Forces) -> Data<F> {
        let variances: Vec<f64> = self.scales.deviation.iter().map(|d| d * d).collect();
        self.data(signals, forces).with_output_weights(&variances)
    }

    /// Mean prediction error (%) over the samples with force.
    pub(super) fn error(
        &self,
        weights: &[f32],
        data: &Data<f32>,
        forces: &Forces,
        workspace: &mut Workspace<f32>,
    ) -> Option<f64> {
        let targets = self.problem.targets(forces);
        mean_error(&self.scales.predict(weights, data, &targets, workspace, self.pool).1)
    }
}

/// Simulates, in f64 where a linear brain trains: it takes f32's rounding for noise of the sensors, and bodies end at half as
/// much error again (K = 2, M = 1, four seeds).
fn simulated(
    problem: &Problem,
    design: &[f64],
    forces: &Forces,
    solver: &Solver,
    keep_tape: bool,
    pool: &crate::Pool,
) -> Simulation {
    let plan = planned(&problem.scene, design, forces, solver);
    let plan = if problem.optimise.brain == Kind::Linear { plan.double() } else { plan };
    dynamics::run(&problem.scene, design, forces, &plan, keep_tape, pool)
}

/// Mean over the samples with force; `None` where there is none, or it is no number.
pub(super) fn mean_error(errors: &[Option<f64>]) -> Option<f64> {
    let known: Vec<f64> = errors.iter().flatten().copied().collect();
    let mean = known.iter().sum::<f64>() / known.len() as f64;
    mean.is_finite().then_some(mean)
}

/// The first sample that did not end well gives its name.
pub(super) fn all_well(outcomes: &[Outcome]) -> Result<(), Trouble> {
    match outcomes.iter().find(|&&outcome| outcome != Outcome::Ok) {
        Some(&outcome) => Err(Trouble::Simulation(outcome)),
        None => Ok(()),
    }
}

/// One of so many samples may fail, to the nearest whole.
const ONE_OF: usize = 32;

/// Takes the forces of the samples that failed away and returns how many they are.
///
/// # Errors
/// If they are more than may be: the name of the first.
fn silence(forces: &mut Forces, outcomes: &[Outcome]) -> Result<u32, Trouble> {
    let len = forces.panels * (forces.instants + 1);
    let mut failed = 0;
    let mut first = None;
    for (history, &outcome) in forces.values.chunks_exact_mut(len).zip(outcomes) {
        if outcome != Outcome::Ok {
            history.fill(0.0);
            failed += 1;
            first.get_or_insert(outcome);
        }
    }
    match first {
        Some(outcome) if failed > (outcomes.len() + ONE_OF / 2) / ONE_OF => Err(Trouble::Simulation(outcome)),
        _ => Ok(failed as u32),
    }
}

impl Scales {
    pub(super) fn new(shape: &Shape, signals: &[f64], targets: &[f64]) -> Self {
        Self::of([shape.inputs, shape.outputs], signals, targets)
    }

    /// Of so many channels and panels.
    pub(super) fn of([inputs, outputs]: [usize; 2], signals: &[f64], targets: &[f64]) -> Self {
        let force = moments(targets, outputs);
        Self {
            channels: rms(signals, inputs),
            mean: force.iter().map(|m| m.0).collect(),
            deviation: force.iter().map(|m| above_zero((m.1 - m.0 * m.0).max(0.0).sqrt())).collect(),
        }
    }

    /// These, with the RMS of other signals (N, T, 3M).
    pub(super) fn with_rms_of(&self, signals: &[f64]) -> Self {
        Self { channels: rms(signals, self.channels.len()), ..self.clone() }
    }

    /// x on other scales / x on these, a channel (3M).
    pub(super) fn over(&self, other: &Self) -> Vec<f64> {
        self.channels.iter().zip(&other.channels).map(|(own, other)| own / other).collect()
    }

    /// x of signals (N, T, 3M).
    pub(super) fn inputs<F: Real>(&self, signals: &[f64]) -> Vec<F> {
        signals.iter().zip(self.channels.iter().cycle()).map(|(a, s)| F::from_f64(a / s)).collect()
    }

    /// Transpose of [`Scales::inputs`]: a cotangent on x as one on the signals.
    fn inputs_vjp(&self, cotangent: &[f64]) -> Vec<f64> {
        cotangent.iter().zip(self.channels.iter().cycle()).map(|(c, s)| c / s).collect()
    }

    /// y of forces (N, T, K) in N.
    pub(super) fn targets<F: Real>(&self, forces: &[f64]) -> Vec<F> {
        let panels = self.mean.iter().zip(&self.deviation).cycle();
        forces.iter().zip(panels).map(|(f, (mean, deviation))| F::from_f64((f - mean) / deviation)).collect()
    }

    /// Signals (N, T, 3M) and targets (N, T, K) in N as a network takes them.
    pub(super) fn data<F: Real>(&self, shape: Shape, signals: &[f64], targets: &[f64]) -> Data<F> {
        Data::new(shape, &self.inputs(signals), &self.targets(targets))
    }

    /// What a network says (N, T, K) in N, and its error of each sample (%).
    pub(super) fn predict(
        &self,
        weights: &[f32],
        data: &Data<f32>,
        targets: &[f64],
        workspace: &mut Workspace<f32>,
        pool: &crate::Pool,
    ) -> (Vec<f64>, Vec<Option<f64>>) {
        let shape = data.shape();
        let predicted = self.physical(&brain::predict(weights, data.all(), workspace, pool));
        let errors = brain::prediction_error(targets, &predicted, shape.outputs, shape.instants);
        (predicted, errors)
    }

    /// f̂ in N of ŷ (N, T, K).
    fn physical(&self, normalised: &[f32]) -> Vec<f64> {
        let panels = self.mean.iter().zip(&self.deviation).cycle();
        normalised.iter().zip(panels).map(|(&y, (mean, deviation))| mean + deviation * f64::from(y)).collect()
    }
}

/// Mean and mean square of each of `width` columns.
fn moments(values: &[f64], width: usize) -> Vec<(f64, f64)> {
    let count = (values.len() / width) as f64;
    (0..width)
        .map(|c| {
            let column = || values.iter().skip(c).step_by(width);
            (column().sum::<f64>() / count, column().map(|x| x * x).sum::<f64>() / count)
        })
        .collect()
}

/// RMS of each of `width` channels.
fn rms(signals: &[f64], width: usize) -> Vec<f64> {
    moments(signals, width).iter().map(|m| above_zero(m.1.sqrt())).collect()
}

/// A channel that never stirs stays as it is.
fn above_zero(scale: f64) -> f64 {
    if scale > 0.0 { scale } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One of 32 samples may fail, and is then one without force; of a handful none may, of many no more than in proportion.
    #[test]
    fn few_samples_may_fail() {
        let forces =
            |samples: usize| Forces { samples, panels: 2, instants: 3, values: vec![1.0; samples * 8] };
        let failing = |samples: usize, failed: usize| -> Vec<Outcome> {
            (0..samples).map(|i| if i < failed { Outcome::NonFinite } else { Outcome::Ok }).collect()
        };
        for (samples, failed, may) in
            [(32, 1, true), (32, 2, false), (8, 1, false), (30, 1, true), (270, 8, true), (270, 9, false)]
        {
            let mut some = forces(samples);
            let found = silence(&mut some, &failing(samples, failed));
            let wanted = if may { Ok(failed as u32) } else { Err(Trouble::Simulation(Outcome::NonFinite)) };
            assert_eq!(found, wanted, "{failed} of {samples}");
            let silent = some.values.chunks(8).take_while(|f| f.iter().all(|f| *f == 0.0)).count();
            assert_eq!((silent, some.values.iter().sum::<f64>()), (failed, (8 * (samples - failed)) as f64));
        }
    }
}
