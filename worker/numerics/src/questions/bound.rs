//! What a body's sensors can tell of a trial's forces at most, to first order, in the trial's own errors.
//!
//! ```text
//! error_i = 100 tr(D Q_i Dᵀ)/Σ f_i²      mean = 100 · mean over training samples of 1/Σ f² · mean of tr(D Q_i Dᵀ)
//! ```
//! The prior weighs training samples by 1/Σ f², as the mean error does: of a linear body the mean is then the least that any
//! decoder linear in the signals has on these samples.

use super::nonlinear::EXACT;
use crate::dynamics::{Method, Solver, choose};
use crate::modes::bound::{Noise, Prior, along, posterior_variance};
use crate::random::Purpose;
use crate::trial::{Failure, Problem, Trial, Trouble};

/// What could be known at most.
#[derive(Debug, Clone, PartialEq)]
pub struct Bound {
    /// Error (%) of the first samples of the holdout; none without force.
    pub samples: Vec<Option<f64>>,
    /// In the mean.
    pub mean: f64,
    /// Of one that knows the stimuli's mean and covariance and hears no signal.
    pub deaf: f64,
    /// Directions of the stimuli that were followed.
    pub directions: usize,
}

/// Of a body under the first `samples` of the holdout; none where the trial's chips have no noise, which tell all.
///
/// # Errors
/// If a simulation does not end well.
pub fn bound(
    problem: &Problem,
    design: &[f64],
    samples: usize,
    pool: &crate::Pool,
) -> Result<Option<Bound>, Failure> {
    // differences take equal steps
    let method = match problem.solver.method {
        Method::Tsit5 => Method::Auto,
        method => method,
    };
    let trial =
        Trial::new(&Problem { solver: Solver { method, ..problem.solver }, ..problem.clone() }, pool)?;
    let problem = &trial.problem;
    let Some(chip) = trial.chip.as_ref().filter(|chip| chip.noise.iter().all(|white| *white > 0.0)) else {
        return Ok(None);
    };
    let noise = Noise { white: chip.noise.clone(), bias: chip.bias.clone() };
    let weights = |targets: &[f64], samples: usize| -> Vec<Option<f64>> {
        let of = targets.chunks_exact(targets.len() / samples.max(1));
        of.map(|f| Some(f.iter().map(|f| f * f).sum::<f64>()).filter(|s| *s > 0.0).map(f64::recip)).collect()
    };
    let known = weights(&problem.targets(&trial.train), trial.train.samples);
    let weight = known.iter().flatten().sum::<f64>() / known.iter().flatten().count() as f64;
    let known: Vec<f64> = known.into_iter().map(Option::unwrap_or_default).collect();
    let prior = Prior::new(&trial.train, &known, |forces| problem.targets(forces));

    let unseen = problem.forces(Purpose::Holdout, 0, samples.min(problem.stimuli.holdout));
    let (scene, _) = problem.in_motion(&problem.scene, &unseen);
    let plan = choose(&scene, design, &trial.tuned(design).solver.at_most(EXACT));
    let trouble = |outcome| Failure::Initial(Trouble::Simulation(outcome));
    let mut left = Vec::new();
    for sample in 0..unseen.samples {
        let along = along(&scene, design, &unseen, sample, &prior, &plan, pool).map_err(trouble)?;
        let along = problem.read(along, prior.directions.samples);
        left.push(posterior_variance(&prior, &along, &noise));
    }
    let own = weights(&problem.targets(&unseen), unseen.samples);
    Ok(Some(Bound {
        samples: own.iter().zip(&left).map(|(w, left)| Some(100.0 * (*w)? * left)).collect(),
        mean: 100.0 * weight * left.iter().sum::<f64>() / left.len() as f64,
        deaf: 100.0 * weight * (prior.variance.iter().sum::<f64>() + prior.rest),
        directions: prior.variance.len(),
    }))
}
