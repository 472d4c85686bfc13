//! Bodies read by the inverse brain: by the model of a design, or of what a twin says that a cast of it is.

use metasense_numerics::brains::{Estimate, Inverse, TO_EACH_SIDE};
use metasense_numerics::trial::{Problem, Trial};
use metasense_schemas::spec::TrialSpec;
use serde::{Deserialize, Serialize};

use crate::identify::Ending;
use crate::measured::Measured;
use crate::run::{Failure, Pool, check_design, placed, pool};
use crate::twin::Twin;

/// What an inverse brain says of some samples.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Posterior {
    /// Forces (N, T, K) (N).
    pub forces: Vec<f64>,
    /// Lower end of their 95 % bands (N), likewise.
    pub low: Vec<f64>,
    /// The upper.
    pub high: Vec<f64>,
    /// How many descents did not converge.
    pub unconverged: usize,
    /// How many samples the model does not explain: their residual is above 1.5 times the noise's square.
    pub unexplained: usize,
    /// CPU time of reading them (s).
    pub seconds: f64,
}

impl Posterior {
    /// Of estimates.
    pub fn of(found: &[Estimate]) -> Self {
        let end = |sign: f64| {
            let of = found.iter().flat_map(|one| one.forces.iter().zip(&one.deviations));
            of.map(|(f, deviation)| f + sign * TO_EACH_SIDE * deviation).collect()
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

    /// Adds those of further samples.
    pub fn extend(&mut self, other: &Self) {
        self.forces.extend_from_slice(&other.forces);
        self.low.extend_from_slice(&other.low);
        self.high.extend_from_slice(&other.high);
        self.unconverged += other.unconverged;
        self.unexplained += other.unexplained;
        self.seconds += other.seconds;
    }

    /// The part of true forces (N, T, K) (N) that lies in the bands.
    pub fn coverage(&self, truth: &[f64]) -> f64 {
        let inside = truth.iter().zip(&self.low).zip(&self.high);
        inside.filter(|((f, low), high)| (*low..=*high).contains(f)).count() as f64 / truth.len() as f64
    }
}

/// Lets the inverse brain of a design, or of its twin, read. It begins with a linear brain fitted to the training samples, simulated
/// on that model.
///
/// # Errors
/// If the design is another body's, or its model cannot be simulated.
pub fn with_brain<T>(
    problem: &Problem,
    (design, twin): (&[f64], Option<&Twin>),
    pool: &Pool,
    read: impl FnOnce(&mut Inverse) -> T,
) -> Result<T, Failure> {
    check_design(problem, design)?;
    let trial = Trial::new(problem, pool)?;
    Ok(read(&mut Inverse::of(&trial, design, twin)?))
}

/// The trial's holdout on a body, or on its twin, as its chips read it; samples that cannot be simulated are left out.
///
/// # Errors
/// If the spec stands for no trial, the design is another body's, or more samples fail than may in a comparison.
pub fn holdout(
    trial: &TrialSpec,
    (design, twin): (&[f64], Option<&Twin>),
    threads: usize,
) -> Result<Measured, Failure> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    check_design(&problem, design)?;
    let forces = problem.holdout();
    let twin = twin.map(|twin| &twin.cast);
    let samples = Trial::new(&problem, &pool)?.samples(design, twin, forces.clone())?;
    let ended: Vec<usize> = (0..samples.count()).filter(|&i| !samples.failed[i]).collect();
    Ok(Measured::of(forces.select(&ended), samples.select(&ended).signals, problem.low_pass()))
}
