//! Pilot: selects integrator and number of steps by measurement on the first samples.
//!
//! The laws of `choose` hold for the reference scene; sharp forces, contact and many periods between instants change their
//! factors. The reference solution is `nystrom6`, with steps doubled until two runs agree to the requested error. Then the method
//! with the least work by its law is measured at this number of steps, at more and at fewer, until no cheaper method is left. The
//! last run tests f32.

use super::choose::{Candidate, candidates, choose_under};
use super::{
    Accuracy, Forces, IntegrationPlan, Integrator, IntegratorSettings, Outcome, Precision, Scene, Simulation,
    SimulationCounts, Tolerance, run,
};
use crate::lanes::LANES;

/// Result of a pilot.
#[derive(Debug, Clone, PartialEq)]
pub struct Tuned {
    /// Solver with a definite method. Its accuracy or tolerance also gives the requested error for other designs.
    pub solver: IntegratorSettings,
    /// Plan of this solver for the pilot's design.
    pub plan: IntegrationPlan,
    /// Relative error of the pilot's signals; `None` if not measured.
    pub error: Option<f64>,
    /// Work of the pilot.
    pub counters: SimulationCounts,
}

/// Least ratio of requested to measured error: later samples and bodies differ from the pilot's.
const SAFETY: f64 = 1.25;
/// Largest refinement of the law's steps. Motion that needs more is chaotic.
const REFINED: usize = 8;
/// Largest number of runs per method.
const TRIES: usize = 6;
/// Part of a plan's reason if no steps give the requested error.
const UNREACHED: &str = "of the pilot gave the requested error";

/// Whether a plan with this reason gives the requested error, as far as measured. Chaotic motion does not: its signals change
/// with the steps.
pub fn keeps_error(reason: &str) -> bool {
    !reason.contains(UNREACHED)
}

/// Finds the cheapest integration with the solver's accuracy, for this scene and these forces.
///
/// Uses the first eight samples; the result does not depend on the number of threads. If no steps are accurate enough, returns
/// those with the least error, and the plan's reason states this. For `Tsit5`, returns the tolerance of its error norm.
///
/// # Panics
/// As `simulate`.
pub fn tune(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    solver: &IntegratorSettings,
    pool: &crate::Pool,
) -> Tuned {
    let requested = solver.accuracy.0;
    let first: Vec<usize> = (0..forces.samples.min(LANES)).collect();
    let mut pilot =
        Pilot { scene, design, forces: forces.select(&first), pool, counters: SimulationCounts::default() };
    let adaptive = solver.method == Integrator::Tsit5;
    let tune_by_law = |why: Option<String>, counters| {
        let tolerance = adaptive.then(|| Tolerance::from(solver.accuracy));
        let solver = IntegratorSettings { tolerance, ..*solver };
        let mut plan = choose_under(scene, design, forces.kinks(scene), &solver);
        if let Some(why) = why {
            plan.reason = format!("{}; {why}", plan.reason);
        }
        Tuned { solver, plan, error: None, counters }
    };
    let all = candidates(scene, design, forces.kinks(scene));
    let has_motion = pilot.forces.values.iter().any(|f| *f != 0.0) && all[0].highest > 0.0;
    if !has_motion || scene.sensors.is_empty() {
        return tune_by_law(None, SimulationCounts::default());
    }
    let six = all.iter().find(|c| c.law.method == Integrator::Nystrom6).expect("a law");
    let (reference, known) = match pilot.reference(six, requested) {
        Ok(found) => found,
        Err((refined, off)) => {
            let left = if off.is_finite() { format!("{off:.0e}") } else { "unknown".to_owned() };
            let why = format!("no number of steps {UNREACHED}; the remaining error is {left}");
            let own = |c: &&Candidate| c.law.method == solver.method;
            let method = if solver.method == Integrator::Auto { Some(six) } else { all.iter().find(own) };
            let Some(candidate) = method.filter(|_| refined > 1) else {
                return tune_by_law(Some(why), pilot.counters);
            };
            let steps = refined * candidate.steps(Accuracy(requested.min(0.01)));
            let plan = candidate.plan(steps, candidate.reason(steps, &why));
            let exact = steps as f64 * (1.0 - 1e-9);
            let solver = IntegratorSettings::new(plan.method, candidate.accuracy(exact));
            return Tuned { solver, plan, error: None, counters: pilot.counters };
        }
    };
    if adaptive {
        let Some((tolerance, error)) = pilot.tolerance(&reference, requested) else {
            return tune_by_law(Some(format!("no tolerance {UNREACHED}")), pilot.counters);
        };
        let reason = format!(
            "tsit5 with error norm tolerance {tolerance:.1e}: measured error {error:.0e}, requested {requested:.0e}"
        );
        let tolerance = Tolerance::both(tolerance);
        let solver = IntegratorSettings { tolerance: Some(tolerance), ..*solver };
        let plan = IntegrationPlan { reason, ..IntegrationPlan::tsit5(tolerance) };
        return Tuned { solver, plan, error: Some(error), counters: pilot.counters };
    }
    let mut open: Vec<Candidate> = all
        .into_iter()
        .filter(|c| solver.method == Integrator::Auto || solver.method == c.law.method)
        .collect();
    let mut best: Option<(Candidate, MinimalSteps)> = None;
    // Cheapest by their laws first. A method with more work than the best measured one is skipped.
    open.sort_by_key(|c| c.steps(solver.accuracy) * c.law.work);
    for candidate in open {
        let work = |steps: usize| steps * candidate.law.work;
        let bound = best.as_ref().map_or(usize::MAX, |(c, f)| f.steps * c.law.work);
        if work(candidate.steps(solver.accuracy)) >= bound {
            continue;
        }
        let known = Some(known).filter(|_| candidate.law.method == Integrator::Nystrom6);
        if let Some(fewest) = pilot.find_min_steps(&candidate, &reference, requested, known)
            && work(fewest.steps) < bound
        {
            best = Some((candidate, fewest));
        }
    }
    let Some((candidate, MinimalSteps { steps, exact, error })) = best else {
        return tune_by_law(Some(format!("no steps {UNREACHED}")), pilot.counters);
    };
    let plan = candidate.plan(steps, String::new());
    let rounded = pilot.rounded(&candidate, &plan, &reference, requested);
    let (precision, error) = rounded.map_or((Precision::Double, error), |error| (Precision::Single, error));
    let bits = if rounded.is_some() { "f32, " } else { "" };
    let why = format!("{bits}measured error {error:.0e}, requested {requested:.0e}");
    let plan = IntegrationPlan { precision, reason: candidate.reason(steps, &why), ..plan };
    let single_below = rounded.map_or(0.0, |_| candidate.single(solver.accuracy));
    let double = IntegratorSettings::new(plan.method, candidate.accuracy(exact));
    let solver = IntegratorSettings { single_below, ..double };
    Tuned { solver, plan, error: Some(error), counters: pilot.counters }
}

/// The fewest steps that give an error.
struct MinimalSteps {
    steps: usize,
    /// Fractional number of steps, between `steps` − `kinks` and `steps`.
    exact: f64,
    /// Relative error measured at `steps`.
    error: f64,
}

/// Steps, or their refinement, and the relative error of the signals.
type StepsAndError = (usize, f64);

/// The first samples, for repeated runs.
struct Pilot<'a> {
    scene: &'a Scene,
    design: &'a [f64],
    forces: Forces,
    pool: &'a crate::Pool,
    counters: SimulationCounts,
}

impl Pilot<'_> {
    /// Error of a plan in f32, if it is at most `requested`.
    fn rounded(
        &mut self,
        candidate: &Candidate,
        plan: &IntegrationPlan,
        reference: &Simulation,
        requested: f64,
    ) -> Option<f64> {
        if candidate.highest > candidate.single(Accuracy(requested)) {
            return None;
        }
        let plan = IntegrationPlan { precision: Precision::Single, ..plan.clone() };
        Some(self.error(&plan, reference)).filter(|error| SAFETY * error <= requested)
    }

    fn run(&mut self, plan: &IntegrationPlan) -> Simulation {
        let simulation = run(self.scene, self.design, &self.forces, plan, false, self.pool);
        self.counters += simulation.counters;
        simulation
    }

    /// Error of a plan against the reference solution. Infinite if additional samples fail, or if samples were repeated with
    /// finer steps, which is expensive.
    fn error(&mut self, plan: &IntegrationPlan, reference: &Simulation) -> f64 {
        let simulation = self.run(plan);
        let fails = |(a, b): (&Outcome, &Outcome)| *a != Outcome::Ok && *b == Outcome::Ok;
        let halved = simulation.plan.steps.count() > 0 && simulation.counters.rejected > 0;
        if halved || simulation.outcomes.iter().zip(&reference.outcomes).any(fails) {
            return f64::INFINITY;
        }
        self.distance(&simulation, reference)
    }

    /// `signal_error` over the samples that succeed in both simulations; infinite if there are none.
    fn distance(&self, a: &Simulation, b: &Simulation) -> f64 {
        let len = b.signals.len() / b.outcomes.len().max(1);
        let well = |i: &usize| a.outcomes[*i] == Outcome::Ok && b.outcomes[*i] == Outcome::Ok;
        let of = |s: &Simulation| -> Vec<f64> {
            (0..b.outcomes.len()).filter(well).flat_map(|i| &s.signals[i * len..][..len]).copied().collect()
        };
        signal_error(&of(a), &of(b), 3 * self.scene.sensors.len())
    }

    /// The largest tolerance found for Tsit5 with at most the error `requested`, including the safety factor, and its error.
    fn tolerance(&mut self, reference: &Simulation, requested: f64) -> Option<(f64, f64)> {
        let mut tolerance = Tolerance::from(Accuracy(requested)).relative;
        let mut good: Option<(f64, f64)> = None;
        for _ in 0..TRIES {
            let error = self.error(&IntegrationPlan::tsit5(Tolerance::both(tolerance)), reference);
            let keeps = SAFETY * error <= requested;
            if keeps && good.is_none_or(|(t, _)| tolerance > t) {
                good = Some((tolerance, error));
            }
            // Work varies as the fifth root of the tolerance, so a few times too small is acceptable.
            if keeps && error > 0.2 * requested {
                break;
            }
            // The error is about proportional to the tolerance while steps resolve the motion.
            let factor = (0.5 * requested / (SAFETY * error)).clamp(1e-2, 1e2);
            let next = (tolerance * factor).clamp(Tolerance::SMALLEST, 0.5);
            if next == tolerance || good.is_some_and(|(t, _)| next <= t) {
                break;
            }
            tolerance = next;
        }
        good
    }

    /// The reference solution, much more accurate than `requested`, with steps and error of the run before it. Otherwise the best
    /// refinement of the law's steps and its error: the least one, or, with fewer steps, at most twice that.
    fn reference(
        &mut self,
        six: &Candidate,
        requested: f64,
    ) -> Result<(Simulation, StepsAndError), StepsAndError> {
        let start = six.steps(Accuracy(requested.min(0.01)));
        let (mut refined, mut errors) = (1, Vec::new());
        let mut coarse = self.run(&six.plan(start, String::new()));
        while refined < REFINED {
            let fine = self.run(&six.plan(2 * refined * start, String::new()));
            // A sample repeated with finer steps may be identical in both runs; the difference does not measure its error.
            let error =
                if coarse.counters.rejected > 0 { f64::INFINITY } else { self.distance(&coarse, &fine) };
            if error <= requested {
                return Ok((fine, (refined * start, error)));
            }
            errors.push((2 * refined, error));
            (coarse, refined) = (fine, 2 * refined);
        }
        let least = errors.iter().fold(f64::INFINITY, |least, (_, error)| least.min(*error));
        let first = errors.into_iter().find(|(_, error)| *error <= 2.0 * least).expect("at least one");
        Err(match least {
            // Contact required finer steps in every run, and samples succeeded with them.
            f64::INFINITY if coarse.outcomes.iter().all(|o| *o == Outcome::Ok) => (REFINED, least),
            // If the error is as large as the signals, more steps do not help.
            0.1.. => (1, least),
            _ => first,
        })
    }

    /// The fewest steps of a method with at most the error `requested`, including the safety factor.
    fn find_min_steps(
        &mut self,
        candidate: &Candidate,
        reference: &Simulation,
        requested: f64,
        known: Option<StepsAndError>,
    ) -> Option<MinimalSteps> {
        let start = candidate.steps(Accuracy(requested));
        // required for stability
        let least = candidate.steps(Accuracy(f64::INFINITY));
        let most = REFINED * start.max(least);
        let mut tried: Vec<(usize, f64)> = Vec::new();
        let mut steps = start;
        let power = candidate.law.power;
        let exact = |(steps, error): (usize, f64), power: f64| {
            steps as f64 * (SAFETY * error / requested).powf(1.0 / power)
        };
        for _ in 0..TRIES {
            let error = match known {
                Some((n, error)) if n == steps => error,
                _ => self.error(&candidate.plan(steps, String::new()), reference),
            };
            tried.push((steps, error));
            if error.is_infinite() {
                if steps >= most {
                    break;
                }
                steps = candidate.round_to_kinks(2.0 * steps as f64).min(most);
                continue;
            }
            // For forces or contacts that are not smooth, the observed order is below the method's order.
            let seen = match tried[..] {
                [.., (n, e), (m, f)] if n != m => (e / f).ln() / (m as f64 / n as f64).ln(),
                _ => power,
            };
            let seen = if seen >= 1.0 { seen.min(power) } else { 1.0 };
            let required_steps = exact((steps, error), seen);
            if required_steps.is_nan() {
                return None;
            }
            steps = candidate.round_to_kinks(required_steps).clamp(least, most);
            if tried.iter().any(|(n, _)| *n == steps) {
                break;
            }
        }
        let good = tried.into_iter().filter(|(_, error)| SAFETY * error <= requested).min_by_key(|t| t.0);
        good.map(|(steps, error)| {
            let (n, part) = (steps as f64, 0.9 * candidate.kinks as f64);
            let exact = exact((steps, error), power).clamp(n - part, n * (1.0 - 1e-9));
            MinimalSteps { steps, exact, error }
        })
    }
}

/// Relative error of signals (N, T, `channels`): the root mean square of ‖a − b‖/‖b‖ over the channels, so gyroscopes and
/// accelerometers have equal weight. Channels in which b is only rounding are omitted; infinite if none remains.
///
/// # Panics
/// If the lengths differ.
pub fn signal_error(a: &[f64], b: &[f64], channels: usize) -> f64 {
    assert_eq!(a.len(), b.len(), "lengths of the signals");
    let (mut off, mut size) = (vec![0.0; channels], vec![0.0; channels]);
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        off[i % channels] += (a - b) * (a - b);
        size[i % channels] += b * b;
    }
    let rounding = 1e-20 * size.iter().sum::<f64>();
    let parts: Vec<f64> =
        off.iter().zip(&size).filter(|(_, size)| **size > rounding).map(|(off, size)| off / size).collect();
    if parts.is_empty() { f64::INFINITY } else { (parts.iter().sum::<f64>() / parts.len() as f64).sqrt() }
}
