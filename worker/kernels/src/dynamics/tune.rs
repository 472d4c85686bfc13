//! Which integrator and how many steps, by measurement: a pilot of the first samples before all others.
//!
//! The laws of `choose` hold for the reference scene; sharp forces, contact or long ringing between instants have other
//! factors. The pilot's truth is `nystrom6`, its steps doubled until two runs agree to the asked error. Then the method of
//! least work by its law is measured at this many steps, and at more or fewer, until no cheaper one is left; at the end once
//! more in f32, which is taken where that keeps the error, too.

use super::choose::{Candidate, candidates, choose_under};
use super::{
    Accuracy, Counters, Forces, Method, Outcome, Plan, Precision, Scene, Simulation, Solver, Tolerance, run,
};
use crate::lanes::LANES;

/// What a pilot made of a solver.
#[derive(Debug, Clone, PartialEq)]
pub struct Tuned {
    /// Never `Auto`; by its accuracy or tolerance other designs keep the asked error, too.
    pub solver: Solver,
    /// What that is for the design of the pilot, and why.
    pub plan: Plan,
    /// Relative error of the pilot's signals; none where it was not, or could not be, measured.
    pub error: Option<f64>,
    /// The pilot's work.
    pub counters: Counters,
}

/// The asked error by the measured one, at least: other samples and the bodies to come are not those of the pilot.
const SAFETY: f64 = 1.25;
/// By how much the law's steps may have to be refined: from there on motion is chaotic rather than quick.
const REFINED: usize = 8;
/// Runs of one method.
const TRIES: usize = 6;
/// How the reason of a plan says that no steps keep the error asked.
const UNREACHED: &str = "of the pilot reached the error asked";

/// Whether a plan of this reason keeps the error asked, as far as a pilot has measured it: motion that no steps resolve has other
/// signals by other steps.
pub fn keeps_error(reason: &str) -> bool {
    !reason.contains(UNREACHED)
}

/// Finds the cheapest way to keep the solver's accuracy in this scene under these forces.
///
/// Takes the first eight samples, in the order given; the same inputs give the same answer on any number of threads.
/// Where no steps reach it, those of least error remain and the plan's reason says so. `Tsit5` comes back with the tolerance of
/// its own error norm that keeps the error asked.
///
/// # Panics
/// As `simulate`.
pub fn tune(scene: &Scene, design: &[f64], forces: &Forces, solver: &Solver, pool: &crate::Pool) -> Tuned {
    let asked = solver.accuracy.0;
    let first: Vec<usize> = (0..forces.samples.min(LANES)).collect();
    let mut pilot =
        Pilot { scene, design, forces: forces.select(&first), pool, counters: Counters::default() };
    let adaptive = solver.method == Method::Tsit5;
    let as_it_is = |why: Option<String>, counters| {
        let tolerance = adaptive.then(|| Tolerance::from(solver.accuracy));
        let solver = Solver { tolerance, ..*solver };
        let mut plan = choose_under(scene, design, forces.kinks(scene), &solver);
        if let Some(why) = why {
            plan.reason = format!("{}; {why}", plan.reason);
        }
        Tuned { solver, plan, error: None, counters }
    };
    let all = candidates(scene, design, forces.kinks(scene));
    let moved = pilot.forces.values.iter().any(|f| *f != 0.0) && all[0].highest > 0.0;
    if !moved || scene.sensors.is_empty() {
        return as_it_is(None, Counters::default());
    }
    let six = all.iter().find(|c| c.law.method == Method::Nystrom6).expect("a law");
    let (truth, known) = match pilot.truth(six, asked) {
        Ok(found) => found,
        Err((refined, off)) => {
            let left = if off.is_finite() { format!("{off:.0e}") } else { "an unknown one".to_owned() };
            let why = format!("no steps {UNREACHED}, {left} is left");
            let own = |c: &&Candidate| c.law.method == solver.method;
            let method = if solver.method == Method::Auto { Some(six) } else { all.iter().find(own) };
            let Some(candidate) = method.filter(|_| refined > 1) else {
                return as_it_is(Some(why), pilot.counters);
            };
            let steps = refined * candidate.steps(Accuracy(asked.min(0.01)));
            let plan = candidate.plan(steps, candidate.reason(steps, &why));
            let exact = steps as f64 * (1.0 - 1e-9);
            let solver = Solver::new(plan.method, candidate.accuracy(exact));
            return Tuned { solver, plan, error: None, counters: pilot.counters };
        }
    };
    if adaptive {
        let Some((tolerance, error)) = pilot.tolerance(&truth, asked) else {
            return as_it_is(Some(format!("no tolerance {UNREACHED}")), pilot.counters);
        };
        let reason = format!(
            "tsit5, tolerance {tolerance:.1e} of its own error norm: error {error:.0e} measured, asked {asked:.0e}"
        );
        let tolerance = Tolerance::both(tolerance);
        let solver = Solver { tolerance: Some(tolerance), ..*solver };
        let plan = Plan { reason, ..Plan::tsit5(tolerance) };
        return Tuned { solver, plan, error: Some(error), counters: pilot.counters };
    }
    let mut open: Vec<Candidate> =
        all.into_iter().filter(|c| solver.method == Method::Auto || solver.method == c.law.method).collect();
    let mut best: Option<(Candidate, Fewest)> = None;
    // By their laws, the cheapest first; none is tried that would do more work than the best that was measured.
    open.sort_by_key(|c| c.steps(solver.accuracy) * c.law.work);
    for candidate in open {
        let work = |steps: usize| steps * candidate.law.work;
        let bound = best.as_ref().map_or(usize::MAX, |(c, f)| f.steps * c.law.work);
        if work(candidate.steps(solver.accuracy)) >= bound {
            continue;
        }
        let known = Some(known).filter(|_| candidate.law.method == Method::Nystrom6);
        if let Some(fewest) = pilot.fewest(&candidate, &truth, asked, known)
            && work(fewest.steps) < bound
        {
            best = Some((candidate, fewest));
        }
    }
    let Some((candidate, Fewest { steps, exact, error })) = best else {
        return as_it_is(Some(format!("no steps {UNREACHED}")), pilot.counters);
    };
    let plan = candidate.plan(steps, String::new());
    let rounded = pilot.rounded(&candidate, &plan, &truth, asked);
    let (precision, error) = rounded.map_or((Precision::Double, error), |error| (Precision::Single, error));
    let bits = if rounded.is_some() { "f32, " } else { "" };
    let why = format!("{bits}error {error:.0e} measured, asked {asked:.0e}");
    let plan = Plan { precision, reason: candidate.reason(steps, &why), ..plan };
    let single = rounded.map_or(0.0, |_| candidate.single(solver.accuracy));
    let solver = Solver { single, ..Solver::new(plan.method, candidate.accuracy(exact)) };
    Tuned { solver, plan, error: Some(error), counters: pilot.counters }
}

/// The fewest steps that keep an error.
struct Fewest {
    steps: usize,
    /// How many it would be, were steps not whole: just above `steps` − 1 at least.
    exact: f64,
    /// Relative error measured at `steps`.
    error: f64,
}

/// Steps, or by how much they are refined, and the relative error of the signals then.
type Measured = (usize, f64);

/// The first samples, run again and again.
struct Pilot<'a> {
    scene: &'a Scene,
    design: &'a [f64],
    forces: Forces,
    pool: &'a crate::Pool,
    counters: Counters,
}

impl Pilot<'_> {
    fn channels(&self) -> usize {
        3 * self.scene.sensors.len()
    }

    /// Error of a plan's steps in f32, where that is no more than asked.
    fn rounded(&mut self, candidate: &Candidate, plan: &Plan, truth: &Simulation, asked: f64) -> Option<f64> {
        if candidate.highest > candidate.single(Accuracy(asked)) {
            return None;
        }
        let found = self.run_plan(&Plan { precision: Precision::Single, ..plan.clone() });
        Some(self.error(&found, truth)).filter(|error| SAFETY * error <= asked)
    }

    fn run(&mut self, candidate: &Candidate, steps: usize) -> Simulation {
        self.run_plan(&candidate.plan(steps, String::new()))
    }

    fn run_plan(&mut self, plan: &Plan) -> Simulation {
        let simulation = run(self.scene, self.design, &self.forces, plan, false, self.pool);
        self.counters += simulation.counters;
        simulation
    }

    /// Error against the truth; infinite where samples failed that need not, or steps were halved, which is not cheap.
    fn error(&self, simulation: &Simulation, truth: &Simulation) -> f64 {
        let fails = |(a, b): (&Outcome, &Outcome)| *a != Outcome::Ok && *b == Outcome::Ok;
        let halved = simulation.plan.steps.count() > 0 && simulation.counters.rejected > 0;
        if halved || simulation.outcomes.iter().zip(&truth.outcomes).any(fails) {
            return f64::INFINITY;
        }
        distance(simulation, truth, self.channels())
    }

    /// The largest tolerance of Tsit5's own norm found to keep the error, with safety, and the error.
    fn tolerance(&mut self, truth: &Simulation, asked: f64) -> Option<(f64, f64)> {
        let mut tolerance = Tolerance::from(Accuracy(asked)).relative;
        let mut good: Option<(f64, f64)> = None;
        for _ in 0..TRIES {
            let found = self.run_plan(&Plan::tsit5(Tolerance::both(tolerance)));
            let error = self.error(&found, truth);
            let keeps = SAFETY * error <= asked;
            if keeps && good.is_none_or(|(t, _)| tolerance > t) {
                good = Some((tolerance, error));
            }
            // Work is as its fifth root: a few times too small is near enough.
            if keeps && error > 0.2 * asked {
                break;
            }
            // Errors are about as the tolerance, until steps no longer resolve the motion.
            let factor = (0.5 * asked / (SAFETY * error)).clamp(1e-2, 1e2);
            let next = (tolerance * factor).clamp(Tolerance::LEAST, 0.5);
            if next == tolerance || good.is_some_and(|(t, _)| next <= t) {
                break;
            }
            tolerance = next;
        }
        good
    }

    /// Signals that are exact to well below `asked`, with steps and error of the run before; or by how much the law's steps
    /// are best refined, and the error left: the least, or up to twice that for fewer steps, as where motion is chaotic.
    fn truth(&mut self, six: &Candidate, asked: f64) -> Result<(Simulation, Measured), Measured> {
        let start = six.steps(Accuracy(asked.min(0.01)));
        let (mut refined, mut errors) = (1, Vec::new());
        let mut coarse = self.run(six, start);
        while refined < REFINED {
            let fine = self.run(six, 2 * refined * start);
            // A sample whose steps were halved has the same bits in both, whatever its error.
            let error = if coarse.counters.rejected > 0 {
                f64::INFINITY
            } else {
                distance(&coarse, &fine, self.channels())
            };
            if error <= asked {
                return Ok((fine, (refined * start, error)));
            }
            errors.push((2 * refined, error));
            (coarse, refined) = (fine, 2 * refined);
        }
        let least = errors.iter().fold(f64::INFINITY, |least, (_, error)| least.min(*error));
        let first = errors.into_iter().find(|(_, error)| *error <= 2.0 * least).expect("at least one");
        Err(match least {
            // To the end contact asked for shorter steps than these, and got them.
            f64::INFINITY if coarse.outcomes.iter().all(|o| *o == Outcome::Ok) => (REFINED, least),
            // An error as large as the signals is no better for any steps.
            0.1.. => (1, least),
            _ => first,
        })
    }

    /// The fewest steps of a method whose error, with safety, is at most `asked`.
    fn fewest(
        &mut self,
        candidate: &Candidate,
        truth: &Simulation,
        asked: f64,
        known: Option<Measured>,
    ) -> Option<Fewest> {
        let start = candidate.steps(Accuracy(asked));
        // What stability asks for whatever the error
        let least = candidate.steps(Accuracy(f64::INFINITY));
        let most = REFINED * start.max(least);
        let mut tried: Vec<(usize, f64)> = Vec::new();
        let mut steps = start;
        let power = candidate.law.power;
        let exact = |(steps, error): (usize, f64), power: f64| {
            steps as f64 * (SAFETY * error / asked).powf(1.0 / power)
        };
        for _ in 0..TRIES {
            let error = match known {
                Some((n, error)) if n == steps => error,
                _ => {
                    let found = self.run(candidate, steps);
                    self.error(&found, truth)
                }
            };
            tried.push((steps, error));
            if error.is_infinite() {
                if steps >= most {
                    break;
                }
                steps = candidate.whole(2.0 * steps as f64).min(most);
                continue;
            }
            // Where forces or contacts are not smooth, errors fall more slowly than the method's order has it.
            let seen = match tried[..] {
                [.., (n, e), (m, f)] if n != m => (e / f).ln() / (m as f64 / n as f64).ln(),
                _ => power,
            };
            let seen = if seen >= 1.0 { seen.min(power) } else { 1.0 };
            let wanted = exact((steps, error), seen);
            if wanted.is_nan() {
                return None;
            }
            steps = candidate.whole(wanted).clamp(least, most);
            if tried.iter().any(|(n, _)| *n == steps) {
                break;
            }
        }
        let good = tried.into_iter().filter(|(_, error)| SAFETY * error <= asked).min_by_key(|t| t.0);
        good.map(|(steps, error)| {
            let (n, part) = (steps as f64, 0.9 * candidate.kinks as f64);
            Fewest { steps, exact: exact((steps, error), power).clamp(n - part, n * (1.0 - 1e-9)), error }
        })
    }
}

/// `signal_error` of the samples that ended well in both; infinite where there is none.
fn distance(a: &Simulation, b: &Simulation, channels: usize) -> f64 {
    let len = b.signals.len() / b.outcomes.len().max(1);
    let well = |i: &usize| a.outcomes[*i] == Outcome::Ok && b.outcomes[*i] == Outcome::Ok;
    let of = |s: &Simulation| -> Vec<f64> {
        (0..b.outcomes.len()).filter(well).flat_map(|i| &s.signals[i * len..][..len]).copied().collect()
    };
    signal_error(&of(a), &of(b), channels)
}

/// Relative error of signals (N, T, `channels`) as networks see them: the root mean square over the channels of
/// ‖a − b‖/‖b‖ of each, so that a gyroscope counts as much as an accelerometer. Channels in which b is nothing but rounding are
/// left out; infinite where none is left.
///
/// # Panics
/// If lengths differ.
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
