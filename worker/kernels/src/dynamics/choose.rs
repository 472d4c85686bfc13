//! Selects integrator and number of steps from the scene's highest frequency and the requested accuracy.

use super::model::Model;
use super::stiffness::hessian;
use super::{Accuracy, IntegrationPlan, Integrator, IntegratorSettings, Precision, Scene, Tolerance};

/// Highest angular frequency of small undamped motion about the start of samples (rad/s): the square root of the largest eigenvalue of
/// M^-½ H M^-½ by Lanczos' method, accurate to 1e-3 before its vectors lose orthogonality. Relaxing ligaments count with their
/// instantaneous stiffness.
pub fn highest_frequency(scene: &Scene, design: &[f64]) -> f64 {
    frequency_of(&Model::new(scene, design), scene)
}

/// The same of a model; 0 without a start of samples.
fn frequency_of(model: &Model, scene: &Scene) -> f64 {
    if model.start.is_err() {
        return 0.0;
    }
    let root: Vec<f64> = model.inverse_mass.as_flattened().iter().map(|m| m.sqrt()).collect();
    let n = root.len();
    let apply = |y: &[f64]| -> Vec<f64> {
        let w: Vec<f64> = y.iter().zip(&root).map(|(y, r)| y * r).collect();
        let [curved, ..] = hessian(model, scene, model.start(), &[w]);
        curved.iter().zip(&root).map(|(h, r)| h * r).collect()
    };
    let norm = |y: &[f64]| y.iter().map(|y| y * y).sum::<f64>().sqrt();
    // a starting vector without symmetry, so that it contains the highest mode
    let mut q: Vec<f64> =
        (0..n).map(|i| if root[i] > 0.0 { (1.0 + 7.3 * i as f64).sin() } else { 0.0 }).collect();
    let size = norm(&q);
    if size == 0.0 {
        return 0.0;
    }
    q.iter_mut().for_each(|q| *q /= size);
    let (mut diagonal, mut beside, mut previous) = (Vec::new(), Vec::new(), vec![0.0; n]);
    for _ in 0..60.min(n) {
        let mut z = apply(&q);
        let a: f64 = z.iter().zip(&q).map(|(z, q)| z * q).sum();
        let b = beside.last().copied().unwrap_or(0.0);
        for i in 0..n {
            z[i] -= a * q[i] + b * previous[i];
        }
        diagonal.push(a);
        let size = norm(&z);
        if size <= 1e-12 * a.abs() {
            break;
        }
        beside.push(size);
        z.iter_mut().for_each(|z| *z /= size);
        previous = std::mem::replace(&mut q, z);
    }
    let k = diagonal.len();
    let tridiagonal = nalgebra::DMatrix::from_fn(k, k, |i, j| match i.abs_diff(j) {
        0 => diagonal[i],
        1 => beside[i.min(j)],
        _ => 0.0,
    });
    let stiffer = 1.0 + scene.relaxation.map_or(0.0, |relaxation| relaxation.share);
    (stiffer * tridiagonal.symmetric_eigenvalues().max().max(0.0)).sqrt()
}

/// Relative error of the signals: factor · wᵖ with w = ω h/stages, ω the highest frequency.
///
/// Fitted on the reference scene for errors from 2e-3 to 7e-8, within a third. Other scenes have other factors: many periods between
/// instants, sharp forces, contact. `tune` measures the factor.
pub(super) struct Law {
    pub(super) method: Integrator,
    pub(super) power: f64,
    factor: f64,
    /// Largest w, for stability of motion far from rest.
    limit: f64,
    /// Force evaluations per step.
    pub(super) work: usize,
}

const LAWS: [Law; 3] = [
    Law { method: Integrator::Leapfrog, power: 2.0, factor: 0.45, limit: 1.1, work: 1 },
    Law { method: Integrator::Nystrom4, power: 4.0, factor: 0.25, limit: 0.6, work: 6 },
    Law { method: Integrator::Nystrom6, power: 6.0, factor: 1.5, limit: 0.5, work: 11 },
];

/// Relative error of signals due to f32: ROUNDING · (ω Δ)², Δ the interval, because accelerations are small differences of elastic
/// forces. It holds for pulses as fast as the reference scene's; slower pulses have larger errors.
const ROUNDING: f64 = 3e-7;
/// Lower limit of ω Δ (rad): shorter intervals do not reduce the error, because the motion is the same.
const RADIANS_MIN: f64 = 20.0;
/// Upper limit of ω Δ (rad), at which gradients have errors of 1e-2.
const RADIANS_MAX: f64 = 66.0;

/// A method of equal steps for a scene.
pub(super) struct Candidate {
    pub(super) law: &'static Law,
    /// Highest frequency, or the fastest decay if this is larger (rad/s).
    pub(super) highest: f64,
    /// Length of an interval (s).
    pub(super) interval: f64,
    /// Kinks of the forces per interval, each of which ends a step.
    pub(super) kinks: usize,
}

impl Candidate {
    /// Steps per interval by the law.
    pub(super) fn steps(&self, Accuracy(error): Accuracy) -> usize {
        let w = (error / self.law.factor).powf(1.0 / self.law.power).min(self.law.limit);
        self.round_to_kinks(self.highest * self.interval / (w * self.stages()))
    }

    /// The next multiple of `kinks`, at least `steps`.
    pub(super) fn round_to_kinks(&self, steps: f64) -> usize {
        (steps / self.kinks as f64).ceil().clamp(1.0, 1e6) as usize * self.kinks
    }

    /// The error for which the law gives `steps` steps after rounding up.
    pub(super) fn accuracy(&self, steps: f64) -> Accuracy {
        let w = self.highest * self.interval / (steps * self.stages());
        Accuracy(self.law.factor * w.powf(self.law.power))
    }

    /// A plan with these steps in f64.
    pub(super) fn plan(&self, steps: usize, reason: String) -> IntegrationPlan {
        IntegrationPlan { reason, ..IntegrationPlan::equal(self.law.method, steps) }
    }

    /// Highest frequency (rad/s) at which the rounding law of f32 gives at most a third of the requested error.
    pub(super) fn single(&self, Accuracy(error): Accuracy) -> f64 {
        let radians = (error / (3.0 * ROUNDING)).sqrt();
        if radians < RADIANS_MIN { 0.0 } else { radians.min(RADIANS_MAX) / self.interval }
    }

    /// Text with method, steps, reason and highest frequency.
    pub(super) fn reason(&self, steps: usize, why: &str) -> String {
        format!(
            "{}, {steps} steps per interval of {} ms: {why}; highest frequency {:.0} Hz",
            self.law.method.name(),
            (self.interval * 1e6).round() * 1e-3,
            self.highest / std::f64::consts::TAU
        )
    }

    fn stages(&self) -> f64 {
        self.law.method.stages().expect("equal steps") as f64
    }
}

/// Largest rate c/m of the free coordinates (1/s); strong damping needs steps that resolve it.
pub(super) fn fastest_decay(model: &Model) -> f64 {
    let rates = model.inverse_mass.iter().flat_map(|inverse| (0..3).map(|d| inverse[d] * model.damping[d]));
    rates.fold(0.0, f64::max)
}

/// All methods of equal steps for this scene, under forces with `kinks` kinks per interval.
pub(super) fn candidates(scene: &Scene, design: &[f64], kinks: usize) -> Vec<Candidate> {
    let model = Model::new(scene, design);
    // without a start, no sample moves
    let decay = if model.start.is_ok() { fastest_decay(&model) } else { 0.0 };
    let highest = frequency_of(&model, scene).max(decay);
    let interval = scene.duration / scene.instants as f64;
    LAWS.iter().map(|law| Candidate { law, highest, interval, kinks }).collect()
}

/// Selects the plan of a solver for a scene and design, under forces on the scene's clock.
pub fn choose(scene: &Scene, design: &[f64], solver: &IntegratorSettings) -> IntegrationPlan {
    choose_under(scene, design, 1, solver)
}

/// As [`choose`], under forces with `kinks` kinks per interval.
pub(super) fn choose_under(
    scene: &Scene,
    design: &[f64],
    kinks: usize,
    solver: &IntegratorSettings,
) -> IntegrationPlan {
    let IntegratorSettings { method, accuracy, tolerance, single_below: single } = *solver;
    // For τ ≥ 0.1 ms and g ≤ 1, the law of `nystrom4` bounds the error of the scheme of `relaxing`. An accuracy found by a pilot with
    // another method is valid too: a difficult scene increases the factors of all laws alike.
    let method = if scene.relaxation.is_some() { Integrator::Nystrom4 } else { method };
    if method == Integrator::Tsit5 {
        let tolerance = tolerance.unwrap_or_else(|| Tolerance::from(accuracy));
        return IntegrationPlan { reason: "requested".to_owned(), ..IntegrationPlan::tsit5(tolerance) };
    }
    let best = candidates(scene, design, kinks)
        .into_iter()
        .filter(|c| method == Integrator::Auto || method == c.law.method)
        .min_by_key(|c| c.steps(accuracy) * c.law.work)
        .expect("a law for every method of equal steps");
    let steps = best.steps(accuracy);
    let reason =
        best.reason(steps, &format!("from the error law of this method for an error of {:.0e}", accuracy.0));
    let precision = if best.highest <= single { Precision::Single } else { Precision::Double };
    IntegrationPlan { precision, ..best.plan(steps, reason) }
}
