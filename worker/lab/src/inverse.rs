//! The inverse decoder of a design, or of the twin of a cast.

use metasense_numerics::brains::{Estimate, Inverse, Z_95};
use metasense_numerics::trial::{PreparedTrial, Problem};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::{NoResult, Pool, pool};
use serde::{Deserialize, Serialize};

use crate::identify::Ending;
use crate::measured::Measured;
use crate::prepare::{check_design, placed};
use crate::twin::Twin;

/// Forces that an inverse decoder estimates from samples, with uncertainties.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Posterior {
    /// Most probable forces (N, T, K) (N).
    pub forces: Vec<f64>,
    /// Lower ends of their 95 % bands (N, T, K) (N).
    pub low: Vec<f64>,
    /// Upper ends (N, T, K) (N).
    pub high: Vec<f64>,
    /// Number of descents that did not converge.
    pub unconverged: usize,
    /// Number of samples that the model does not explain: mean squared residual above 1.5 σ².
    pub unexplained: usize,
    /// CPU time of the estimates (s).
    pub seconds: f64,
}

impl Posterior {
    /// Collects estimates.
    pub fn of(found: &[Estimate]) -> Self {
        let end = |sign: f64| {
            let of = found.iter().flat_map(|one| one.forces.iter().zip(&one.deviations));
            of.map(|(f, deviation)| f + sign * Z_95 * deviation).collect()
        };
        Self {
            forces: found.iter().flat_map(|one| &one.forces).copied().collect(),
            low: end(-1.0),
            high: end(1.0),
            unconverged: found.iter().filter(|one| one.ending != Ending::Converged).count(),
            unexplained: found.iter().filter(|one| !one.is_explained()).count(),
            seconds: 0.0,
        }
    }

    /// Appends the posterior of further samples.
    pub fn extend(&mut self, other: &Self) {
        self.forces.extend_from_slice(&other.forces);
        self.low.extend_from_slice(&other.low);
        self.high.extend_from_slice(&other.high);
        self.unconverged += other.unconverged;
        self.unexplained += other.unexplained;
        self.seconds += other.seconds;
    }

    /// Share of the true forces (N, T, K) (N) that lie in the bands.
    pub fn coverage(&self, truth: &[f64]) -> f64 {
        let inside = truth.iter().zip(&self.low).zip(&self.high);
        inside.filter(|((f, low), high)| (*low..=*high).contains(f)).count() as f64 / truth.len() as f64
    }
}

/// Calls `read` with the inverse decoder of a design or its twin. The descent starts from a linear decoder fitted to simulated
/// training samples.
///
/// # Errors
/// If the design belongs to another body, or its model cannot be simulated.
pub fn with_brain<T>(
    problem: &Problem,
    (design, twin): (&[f64], Option<&Twin>),
    pool: &Pool,
    read: impl FnOnce(&mut Inverse) -> T,
) -> Result<T, NoResult> {
    check_design(problem, design)?;
    let trial = PreparedTrial::new(problem, pool)?;
    Ok(read(&mut Inverse::of(&trial, design, twin)?))
}

/// Held-out samples of a body or its twin, with chip effects. Failed samples are left out.
///
/// # Errors
/// If the spec is invalid, the design belongs to another body, or more samples fail than a comparison accepts.
pub fn holdout(
    trial: &TrialSpec,
    (design, twin): (&[f64], Option<&Twin>),
    threads: usize,
) -> Result<Measured, NoResult> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    check_design(&problem, design)?;
    let forces = problem.holdout();
    let twin = twin.map(|twin| &twin.cast);
    let samples = PreparedTrial::new(&problem, &pool)?.samples(design, twin, forces.clone())?;
    let ended: Vec<usize> = (0..samples.count()).filter(|&i| !samples.failed[i]).collect();
    Ok(Measured::of(forces.select(&ended), samples.select(&ended).signals, problem.low_pass()))
}
