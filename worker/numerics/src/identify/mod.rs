//! Material parameters from recorded signals: weighted least squares in the logarithms of the parameters.
//!
//! ```text
//! min over q = ln p:  F = ½ Σ (y − a(p))²/s_c² + ½ Σ (q − q₀)²/ln²10,   y recorded, a simulated, s_c the noise of a kind
//! ```
//! Levenberg and Marquardt's method (Marquardt, SIAM J. Appl. Math. 11, 1963): the gradient by the adjoint, JᵀJ from
//! tangents. A wave's phase makes F hilly far from its minimum, so the fit begins with the first part of each record
//! and lengthens it, from another start where it loses it. The last term decides only where records do not.

mod clock;
mod discrepancy;
mod interval;
mod objective;
pub mod twin;

use crate::dynamics::{Counters, Forces, Parameters, Scene, Solver};
pub use clock::Offset;
pub use interval::{Direction, Estimate};
use nalgebra::{DMatrix, DVector};
use objective::{Objective, Point};

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

/// What is fitted and how.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The parameters that move, each once; the others stay at the scene's.
    pub free: Vec<Parameter>,
    /// How to integrate; steps are tuned on the scene as it is given, and again where the beginnings of the records led.
    pub solver: Solver,
    /// Most iterations, those of the beginnings of the records included.
    pub iterations: usize,
    /// Standard deviation of the unknown offset of each record's clock (s); 0: clocks are exact.
    pub offset: f64,
}

/// How a fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// What is left of a step is below a hundredth of the standard errors.
    Converged,
    /// No step lowers F any more, though the gradient asks for one.
    NoProgress,
    /// All iterations are spent.
    IterationsSpent,
    /// The records do not tell some combination of parameters.
    NotIdentifiable,
    /// A parameter stands as far from the scene's as it may: the records ask for one beyond.
    AtTheBound,
    /// The fitted motion leaves most of the signals: the records are not those of this body, clock or units.
    NotExplained,
    /// The scene as it is given could not be simulated.
    StartFailed,
}

impl Verdict {
    /// The name by which people know it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::NoProgress => "no progress",
            Self::IterationsSpent => "iterations spent",
            Self::NotIdentifiable => "not identifiable",
            Self::AtTheBound => "at the bound",
            Self::NotExplained => "signals not explained",
            Self::StartFailed => "the start cannot be simulated",
        }
    }
}

/// One iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iteration {
    /// How much of each record was looked at (s), from its first force.
    pub window: f64,
    /// RMS of the residual in % of the signals', accelerations and rotation rates, within the window.
    pub misfit: [f64; 2],
    /// The parameters.
    pub parameters: Parameters,
}

/// An iteration and what came of it: with all of them a fit goes on to the same bits from where it was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turn {
    /// Where it began.
    pub iteration: Iteration,
    /// The next point, and Marquardt's damping there; none where the descent was over.
    pub next: Option<([f64; 6], f64)>,
}

/// A fit.
#[derive(Debug, Clone, PartialEq)]
pub struct Identified {
    /// How it ended.
    pub outcome: Verdict,
    /// The parameters found, those held included.
    pub parameters: Parameters,
    /// Of each fitted parameter.
    pub estimates: Vec<Estimate>,
    /// By how much later each record's readings were taken than it says; empty where clocks are exact.
    pub offsets: Vec<Offset>,
    /// Combinations that the records do not tell.
    pub undetermined: Vec<Direction>,
    /// Correlations of the estimates, zero with what is not identifiable.
    pub correlation: Vec<Vec<f64>>,
    /// Root of the ratio of the extreme eigenvalues of JᵀJ in ln p.
    pub condition: f64,
    /// RMS of the residual in % of the signals', accelerations and rotation rates: at the start and at the end.
    pub misfit: [[f64; 2]; 2],
    /// RMS of the residual at the end (mm/s², rad/s).
    pub noise: [f64; 2],
    /// Share of the residual that the motion explains on records that were not asked, where several were fitted: what the model lacks.
    pub unmodelled: Option<f64>,
    /// Simulated signals (N, T, 3M) at the start and at the end.
    pub signals: [Vec<f64>; 2],
    /// All iterations.
    pub iterations: Vec<Iteration>,
    /// How it was integrated.
    pub solver: String,
    /// Work done.
    pub counters: Counters,
}

/// ln 10: what the start is trusted to.
const TRUST: f64 = std::f64::consts::LN_10;
/// Largest change of a logarithm in a step.
const STRIDE: f64 = std::f64::consts::LN_2;
/// Part of a standard error below which a step is nothing.
const CLOSE: f64 = 0.01;
/// By how much a window is lengthened.
const GROWTH: f64 = 1.4;
/// Root of the sum of the squared misfits (%) of both kinds from which a window is lost: another start is tried.
const LOST: f64 = 60.0;
/// The same where clocks may be off: their offsets explain much of the signals of another material.
const LOST_BY_CLOCKS: f64 = 30.0;
/// RMS of the residual (%), of accelerations or rotation rates, above which a fit has not explained the signals.
pub const UNEXPLAINED: f64 = 50.0;
/// Factors of other starts, on stretch, shear, bend and density.
const SCALES: [f64; 3] = [1.0, 0.5, 2.0];
/// Other starts that are tried, those of least misfit in the first window first.
const TRIES: usize = 24;
/// Farthest from the scene's values that a fit may lead, as a factor.
pub const BOX: f64 = 8.0;
/// Iterations of the first window.
const FIRST: usize = 12;
/// Iterations of a window but the last.
const GLANCES: usize = 6;
/// Rounds of noise and fit at the end.
const ROUNDS: usize = 6;

/// Fits the free parameters of `scene` to `signals` (N, T, 3M) under `forces`, from those of the scene on.
///
/// The result does not depend on the number of threads. `watch` sees every turn but those that are `known`, of the same fit
/// before; they are not computed again.
///
/// # Panics
/// If lengths do not fit together, no parameter is free, or a free one is not above 0.
pub fn fit(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    signals: &[f64],
    settings: &Settings,
    pool: &crate::Pool,
    known: &[Turn],
    watch: &mut dyn FnMut(&Turn),
) -> Identified {
    let len = forces.samples * scene.instants * 3 * scene.sensors.len();
    assert_eq!(signals.len(), len, "length of the signals");
    let start = Parameters::of(scene).array();
    let free = &settings.free;
    assert!(!free.is_empty() && free.iter().all(|&k| start[k as usize] > 0.0), "{free:?} of {start:?}");
    let asked = settings.solver;
    let mut objective = Objective::new(scene, design, forces, signals, asked, (free, settings.offset), pool);
    let solver = objective.tune(&start, &asked);
    let left = settings.iterations;
    let mut search = Search { objective, known, watch, iterations: Vec::new(), left, asked, solver };
    let (outcome, point, first) = search.all(start);
    let Search { mut objective, iterations, solver, .. } = search;
    let signals = [first.map_or_else(Vec::new, |p| p.signals().to_vec()), Vec::new()];
    let mut fit = Identified {
        outcome,
        parameters: Parameters::from_array(start),
        estimates: Vec::new(),
        offsets: Vec::new(),
        undetermined: Vec::new(),
        correlation: Vec::new(),
        condition: f64::INFINITY,
        misfit: [[100.0; 2]; 2],
        noise: [0.0; 2],
        unmodelled: None,
        signals,
        iterations,
        solver,
        counters: objective.counters,
    };
    let Some(point) = point else { return fit };
    let residual = objective.left(point.signals());
    fit.unmodelled =
        discrepancy::explained(point.signals(), &residual, forces.samples, 3 * scene.sensors.len());
    let jacobian = objective.jacobian(&point);
    let spread = interval::spread(&objective, &point, &jacobian, fit.unmodelled.unwrap_or(0.0));
    fit.parameters = Parameters::from_array(point.parameters);
    fit.estimates = spread.estimates(free, &start, &point.parameters);
    (fit.undetermined, fit.correlation, fit.condition) =
        (spread.undetermined, spread.correlation, spread.condition);
    fit.offsets = spread.offsets;
    if fit.estimates.iter().any(|e| e.at_the_bound) || fit.offsets.iter().any(|o| o.half.is_none()) {
        fit.outcome = Verdict::AtTheBound;
    } else if !fit.undetermined.is_empty() && fit.outcome == Verdict::Converged {
        fit.outcome = Verdict::NotIdentifiable;
    }
    fit.misfit = [objective.misfit(&fit.signals[0]), objective.misfit(point.signals())];
    // what is at the bound or undetermined is the nearer cause
    let has_a_cause = matches!(fit.outcome, Verdict::AtTheBound | Verdict::NotIdentifiable);
    if !has_a_cause && fit.misfit[1].iter().any(|left| *left > UNEXPLAINED) {
        fit.outcome = Verdict::NotExplained;
    }
    fit.noise = objective.residual_rms(point.signals());
    fit.signals[1] = point.signals().to_vec();
    fit.counters = objective.counters;
    fit
}

/// A fit in progress.
struct Search<'a> {
    objective: Objective<'a>,
    known: &'a [Turn],
    watch: &'a mut dyn FnMut(&Turn),
    iterations: Vec<Iteration>,
    left: usize,
    /// What is asked of the integrator, and what it came to.
    asked: Solver,
    solver: String,
}

impl Search<'_> {
    /// Window after window from one start after the other until one stays with the records, then noise and fit in turns.
    /// The last point, and that of the start.
    fn all(&mut self, start: [f64; 6]) -> (Verdict, Option<Point>, Option<Point>) {
        let Some(first) = self.objective.at(&start) else { return (Verdict::StartFailed, None, None) };
        let (mut best, mut farthest) = (start, (0, f64::INFINITY));
        let mut starts = vec![start];
        let lost = self.lost();
        for tried in 0..=TRIES {
            let Some(&from) = starts.get(tried) else { break };
            let (found, (window, misfit)) = self.lengthen(from);
            if window > farthest.0 || (window == farthest.0 && misfit < farthest.1) {
                (best, farthest) = (found, (window, misfit));
            }
            if misfit < lost || self.left == 0 {
                break;
            }
            if tried == 0 {
                starts.extend(self.others(&start));
            }
        }
        self.solver = self.objective.tune(&best, &self.asked);
        let Some(mut point) = self.whole(&best) else {
            return (Verdict::NoProgress, Some(first.clone()), Some(first));
        };
        for _ in 0..ROUNDS {
            let changed = self.objective.weigh(&point);
            let (outcome, found) = self.descend(point, usize::MAX, CLOSE);
            point = found;
            if outcome != Verdict::Converged || changed < 0.02 {
                return (outcome, Some(point), Some(first));
            }
        }
        (Verdict::Converged, Some(point), Some(first))
    }

    /// From the first window on until the whole record is looked at or lost: what was found, the last window and its misfit.
    fn lengthen(&mut self, start: [f64; 6]) -> ([f64; 6], (usize, f64)) {
        let mut parameters = start;
        let mut window = self.objective.first_window();
        let mut most = FIRST;
        while window < self.objective.instants() && self.left > 0 {
            self.objective.look_at(window);
            let Some(point) = self.objective.at(&parameters) else {
                return (parameters, (window, f64::INFINITY));
            };
            self.objective.weigh(&point);
            let (_, point) = self.descend(point, most, 0.1);
            parameters = point.parameters;
            let [a, b] = self.objective.misfit(point.signals());
            if a.hypot(b) > self.lost() {
                return (parameters, (window, a.hypot(b)));
            }
            window = ((window as f64 * GROWTH).ceil() as usize).max(window + 1);
            most = GLANCES;
        }
        (parameters, (window, 0.0))
    }

    fn lost(&self) -> f64 {
        if self.objective.clock.is_some() { LOST_BY_CLOCKS } else { LOST }
    }

    /// All combinations of `SCALES` on the start, those of least misfit in the first window first.
    fn others(&mut self, start: &[f64; 6]) -> Vec<[f64; 6]> {
        let objective = &mut self.objective;
        objective.look_at(objective.first_window());
        let mut others: Vec<(f64, [f64; 6])> = (1..81usize)
            .map(|n| [n / 27, n / 9 % 3, n / 3 % 3, n % 3].map(|k| SCALES[k]))
            .filter_map(|scales| {
                let there = objective.scaled(start, scales)?;
                let point = objective.at(&there)?;
                let [a, b] = objective.misfit(point.signals());
                Some((a.hypot(b), there))
            })
            .collect();
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        others.into_iter().map(|o| o.1).collect()
    }

    fn whole(&mut self, parameters: &[f64; 6]) -> Option<Point> {
        self.objective.look_at(self.objective.instants());
        self.objective.at(parameters)
    }

    /// Levenberg and Marquardt's steps until what is left is below `close` standard errors.
    fn descend(&mut self, point: Point, most: usize, close: f64) -> (Verdict, Point) {
        let mut point = self.objective.again(point);
        let (mut damping, mut turns) = (1e-2, 0);
        // What is known is gone through without a simulation, but for that of where it ends.
        let mut there = None;
        while let Some(Turn { iteration, next: Some((to, eased)) }) = self.known.get(self.iterations.len())
            && turns < most
        {
            self.iterations.push(*iteration);
            (self.left, turns, damping, there) = (self.left - 1, turns + 1, *eased, Some(to));
        }
        if let Some(there) = there {
            point = self.objective.at(there).expect("it was simulated before");
        }
        for _ in turns..most {
            let objective = &mut self.objective;
            let record = Iteration {
                window: objective.seconds(),
                misfit: objective.misfit(point.signals()),
                parameters: Parameters::from_array(point.parameters),
            };
            self.iterations.push(record);
            if self.left == 0 {
                return (Verdict::IterationsSpent, point);
            }
            self.left -= 1;
            let number = self.iterations.len();
            let mut tell = |next: Option<([f64; 6], f64)>| {
                if number > self.known.len() {
                    (self.watch)(&Turn { iteration: record, next });
                }
            };
            let gradient = objective.gradient(&point);
            let jacobian = objective.jacobian(&point);
            let curvature = objective.curvature(&jacobian);
            let Some(newton) = solve(&curvature, &gradient, 0.0) else {
                tell(None);
                return (Verdict::NoProgress, point);
            };
            let decrement = gradient.dot(&newton).max(0.0).sqrt();
            if decrement < close || newton.amax() < 1e-10 {
                tell(None);
                return (Verdict::Converged, point);
            }
            let mut accepted = None;
            while damping < 1e9 {
                let Some(mut step) = solve(&curvature, &gradient, damping) else { break };
                let longest = step.amax();
                if longest > STRIDE {
                    step *= STRIDE / longest;
                }
                let there = objective.moved(&point.parameters, &-&step);
                let promised = gradient.dot(&step) - 0.5 * step.dot(&(&curvature * &step));
                let found = objective.at(&there);
                let gained = found.as_ref().map(|p| point.cost(objective) - p.cost(objective));
                match (found, gained) {
                    (Some(found), Some(gained)) if gained > 0.0 => {
                        damping *= if gained > 0.75 * promised { 0.1 } else { 1.0 };
                        damping = if gained < 0.25 * promised { damping * 4.0 } else { damping }.max(1e-12);
                        accepted = Some(found);
                        break;
                    }
                    _ => damping = (damping * 8.0).max(1e-6),
                }
                if longest < 1e-12 {
                    break;
                }
            }
            tell(accepted.as_ref().map(|found| (found.parameters, damping)));
            match accepted {
                Some(found) => point = found,
                None => return (Verdict::NoProgress, point),
            }
        }
        (Verdict::Converged, point)
    }
}

/// (H + damping·diag H)⁻¹ g.
fn solve(h: &DMatrix<f64>, g: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
    let mut h = h.clone();
    for k in 0..h.nrows() {
        h[(k, k)] *= 1.0 + damping;
    }
    Some(h.cholesky()?.solve(g))
}
