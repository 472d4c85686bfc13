//! Bounds on the error of a trial's forces: of the best linear decoder around each motion and, for pulses, of any decoder.
//!
//! ```text
//! error_i = 100 tr(D Q_i Dᵀ)/Σ f_i²      mean = 100 · mean over training samples of 1/Σ f² · mean of tr(D Q_i Dᵀ)
//! ```
//! The prior weighs training samples by 1/Σ f², as the mean error does. For a linear body, the mean is therefore the least error
//! of any decoder that is linear in the signals. Inverting the mean of Q⁻¹ gives less (Jensen); for Gaussian forces it is the
//! bound of Van Trees.

use super::chain::{ModelOutput, walks};
use super::modes::bound::{ForcePrior, Noise, information, jacobian_times, posterior_variance};
use metasense_numerics::dynamics::{Forces, IntegrationPlan, Outcome, Scene, choose, run};
use metasense_numerics::nested::EXACT;
use metasense_numerics::random::{Purpose, Stream};
use metasense_numerics::stimuli::{Bell, HistorySource};
use metasense_numerics::trial::{Failure, PreparedTrial, Problem, Trouble};
use nalgebra::DMatrix;

/// Bounds of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Bound {
    /// Error (%) of the best linear decoder around each of the first held-out samples; `None` without force.
    pub samples: Vec<Option<f64>>,
    /// Mean error (%), from the mean posterior covariance.
    pub mean: f64,
    /// Error (%) from the inverse of the mean information.
    pub mean_information: f64,
    /// Error (%) of the stimuli's mean, without signals.
    pub prior_only: f64,
    /// Number of directions of the stimuli in the prior.
    pub directions: usize,
    /// Lower bound on the mean error (%) of every decoder of pulses, and its standard error; `None` for other stimuli.
    pub least: Option<[f64; 2]>,
}

/// Walks per held-out sample for the bound of all decoders; walks that run together.
const WALKS: usize = 8;
const TOGETHER: usize = 16;

/// Bounds for a body under the first `samples` held-out samples; `None` if the chips have no noise, or too little for f64.
///
/// # Errors
/// If a simulation fails, or all training samples have equal forces.
pub fn bound(
    problem: &Problem,
    design: &[f64],
    samples: usize,
    pool: &metasense_numerics::Pool,
) -> Result<Option<Bound>, Failure> {
    let trial =
        PreparedTrial::new(&Problem { solver: problem.solver.in_equal_steps(), ..problem.clone() }, pool)?;
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
    let prior = ForcePrior::new(&trial.train, &known, |forces| problem.targets(forces));
    if prior.variance.is_empty() {
        return Err(Failure::Initial(Trouble::FewForces));
    }

    let holdout_forces = problem.forces(Purpose::Holdout, 0, samples.min(problem.stimuli.holdout));
    let (scene, _) = problem.in_motion(&problem.scene, &holdout_forces);
    let plan = choose(&scene, design, &trial.tuned(design).solver.at_most(EXACT));
    let trouble = |outcome| Failure::Initial(Trouble::Simulation(outcome));
    let (mut left, mut total) = (Vec::new(), DMatrix::zeros(prior.variance.len(), prior.variance.len()));
    for sample in 0..holdout_forces.samples {
        let along =
            jacobian_times(&scene, design, &holdout_forces, sample, &prior, &plan, pool).map_err(trouble)?;
        let along = problem.read(along, prior.directions.samples);
        let known = information(&prior, &along, &noise);
        total += &known;
        let Some(variance) = posterior_variance(&prior, known) else { return Ok(None) };
        left.push(variance);
    }
    let Some(informed) = posterior_variance(&prior, total / left.len() as f64) else { return Ok(None) };
    let any_decoder = match &problem.stimuli.source {
        HistorySource::Bell(bell) => Some(decoder_error_bound(
            problem,
            (&scene, design, &plan),
            bell,
            &noise,
            WALKS * holdout_forces.samples,
            pool,
        )),
        _ => None,
    };
    let own = weights(&problem.targets(&holdout_forces), holdout_forces.samples);
    Ok(Some(Bound {
        samples: own.iter().zip(&left).map(|(w, left)| Some(100.0 * (*w)? * left)).collect(),
        mean: 100.0 * weight * left.iter().sum::<f64>() / left.len() as f64,
        mean_information: 100.0 * weight * informed,
        prior_only: 100.0 * weight * (prior.variance.iter().sum::<f64>() + prior.rest),
        directions: prior.variance.len(),
        least: any_decoder,
    }))
}

/// Lower bound (mean, standard error) (%) on the error of every decoder, given the family of pulses, the body and its noise, from
/// `count` walks.
fn decoder_error_bound(
    problem: &Problem,
    (scene, design, plan): (&Scene, &[f64], &IntegrationPlan),
    bell: &Bell,
    noise: &Noise,
    count: usize,
    pool: &metasense_numerics::Pool,
) -> [f64; 2] {
    let (panels, instants) = (problem.scene.panels.len(), problem.stimuli.instants);
    let forces = |at: &[Vec<f64>]| {
        let mut values = vec![0.0; at.len() * panels * (instants + 1)];
        let pulses = at.iter().flat_map(|u| u.chunks_exact(Bell::PARAMETERS));
        for (history, u) in values.chunks_exact_mut(instants + 1).zip(pulses) {
            let part = |k: usize| (1.0 + (-u[k]).exp()).recip();
            bell.pulse(std::array::from_fn(part)).history_into(problem.scene.duration, history);
        }
        Forces { samples: at.len(), panels, instants, values, strikes: Vec::new() }
    };
    let mut model = |at: &[Vec<f64>]| -> Vec<Option<ModelOutput>> {
        let forces = forces(at);
        let found = run(scene, design, &forces.refined_for(scene), plan, false, pool);
        let read = problem.read(found.signals, forces.samples);
        let (readings, targets) = (read.len() / at.len().max(1), problem.targets(&forces));
        let one = targets.len() / at.len().max(1);
        let seen = |((readings, asked), outcome): ((&[f64], &[f64]), &Outcome)| {
            let weight = -asked.iter().map(|f| f * f).sum::<f64>().ln();
            let (readings, asked) = (readings.to_vec(), asked.to_vec());
            (*outcome == Outcome::Ok).then_some(ModelOutput { readings, targets: asked, weight })
        };
        let read = noise.whitened(read, readings);
        read.chunks_exact(readings).zip(targets.chunks_exact(one)).zip(&found.outcomes).map(seen).collect()
    };
    let mut errors = Vec::with_capacity(count);
    for first in (0..count).step_by(TOGETHER) {
        // The pulses of the held-out set, as `bells` draws them.
        let truth = |sample: u64| -> Vec<f64> {
            let drawn = |k: usize| Stream::new(Purpose::Holdout, problem.seed, [sample, k as u64]);
            let parts = (0..panels).flat_map(|k| {
                let mut stream = drawn(k);
                (0..Bell::PARAMETERS).map(move |_| stream.uniform().max(f64::EPSILON))
            });
            parts.map(|p| (p / (1.0 - p)).ln()).collect()
        };
        let truths: Vec<Vec<f64>> = (first..count.min(first + TOGETHER)).map(|i| truth(i as u64)).collect();
        let power = |sample: &[f64]| sample.iter().map(|f| f * f).sum::<f64>();
        let targets = problem.targets(&forces(&truths));
        let powers = targets.chunks_exact(targets.len() / truths.len()).map(power).collect::<Vec<_>>();
        let mut stream = Stream::new(Purpose::Chip, problem.seed, [u64::MAX, first as u64]);
        let found = walks(truths, &mut model, &mut stream);
        errors.extend(found.into_iter().zip(powers).filter_map(|(e, power)| Some(100.0 * e? / power)));
    }
    let count = errors.len().max(1) as f64;
    let mean = errors.iter().sum::<f64>() / count;
    let square: f64 = errors.iter().map(|e| (e - mean).powi(2)).sum();
    [mean, square.sqrt() / count]
}
