//! Errors of decoders on given records: fresh networks by cross-validation, or the inverse decoder.

use std::sync::atomic::{AtomicUsize, Ordering};

use metasense_numerics::brains::{HeldOutEstimates, Recipe, records};
use metasense_numerics::dynamics::Forces;
use metasense_numerics::stimuli;
use metasense_numerics::trial::PreparedTrial;
use metasense_schemas::spec::{BrainKind, TrialSpec};
use metasense_worker::clock::cpu_seconds;
use metasense_worker::convert::finite;
use metasense_worker::problem::{self, solvable};
use metasense_worker::run::{NoResult, pool};
use serde::{Deserialize, Serialize};

use crate::inverse::{Posterior, with_brain};
use crate::measured::Measured;
use crate::prepare::{any_body, check_design, placed};
use crate::questions;
use crate::twin::Twin;

/// Number of networks and length of their training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Effort {
    /// Number of folds of the cross-validation, at least 2. The inverse decoder ignores it.
    pub folds: usize,
    /// Networks per fold.
    pub seeds: usize,
    /// Adam iterations per network.
    pub iterations: usize,
    /// Kind of decoder. Linear decoders have one fit per fold.
    pub brain: BrainKind,
}

/// Estimated forces and errors of records.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluated {
    /// The fold of each record (N).
    pub folds: Vec<usize>,
    /// True forces (N, T, K) (N).
    pub targets: Vec<f64>,
    /// Out-of-fold forces (N, T, K) (N) estimated by the networks of the first seed.
    pub predictions: Vec<f64>,
    /// Errors (%) by seed, then record; `None` for a record without force.
    pub errors: Vec<Vec<Option<f64>>>,
    /// Mean error on the training records (%), by seed, then fold.
    pub errors_train: Vec<Vec<Option<f64>>>,
    /// (iteration, mean error on the left-out records (%)), by seed, then fold.
    pub progress: Vec<Vec<Vec<(u32, f64)>>>,
    /// Outcome of each training, by seed, then fold.
    pub outcomes: Vec<Vec<String>>,
    /// Posterior of the inverse decoder.
    pub posterior: Option<Posterior>,
}

impl Evaluated {
    /// From the networks by seed, then fold.
    fn new(by_seed: &[Vec<FoldEstimates>], folds: Vec<usize>, targets: Vec<f64>) -> Self {
        let members = stimuli::members(&folds);
        let size = targets.len() / folds.len();
        let mut predictions = vec![0.0; targets.len()];
        for (network, records) in by_seed.iter().take(1).flatten().zip(&members) {
            for (predicted, record) in network.predictions.chunks_exact(size).zip(records) {
                predictions[record * size..][..size].copy_from_slice(predicted);
            }
        }
        let errors_of = |networks: &Vec<FoldEstimates>| {
            let mut errors = vec![None; folds.len()];
            for (network, records) in networks.iter().zip(&members) {
                let own = records.iter().zip(&network.errors);
                own.for_each(|(record, error)| errors[*record] = finite(*error));
            }
            errors
        };
        Self {
            errors: by_seed.iter().map(errors_of).collect(),
            errors_train: map_networks(by_seed, |network| network.error_train),
            progress: map_networks(by_seed, |network| network.progress.clone()),
            outcomes: map_networks(by_seed, |network| network.outcome.clone()),
            targets,
            folds,
            predictions,
            posterior: None,
        }
    }
}

/// Estimates and errors of the network of one fold; from the inverse decoder, only the posterior of one batch of records.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FoldEstimates {
    /// Estimated forces (n, T, K) (N) of the fold's n records; first seed only.
    predictions: Vec<f64>,
    errors: Vec<Option<f64>>,
    error_train: Option<f64>,
    progress: Vec<(u32, f64)>,
    outcome: String,
    posterior: Option<Posterior>,
}

impl FoldEstimates {
    fn new(found: HeldOutEstimates, first: bool) -> Self {
        let HeldOutEstimates { predictions, errors, error_train, progress, trouble, .. } = found;
        let outcome = trouble.map_or("ok", |trouble| trouble.name()).to_owned();
        Self {
            predictions: if first { predictions } else { Vec::new() },
            errors,
            error_train,
            progress,
            outcome,
            posterior: None,
        }
    }
}

/// Store of finished networks, by number.
pub trait NetworkStore: Sync {
    /// The stored network of this number.
    fn network(&self, number: usize) -> Option<FoldEstimates>;
    /// Stores a finished network.
    fn store_network(&self, number: usize, network: &FoldEstimates);
}

/// Cross-validates `effort.seeds` networks per fold on measured or simulated signals, on `threads` threads. Networks in `kept`
/// are not trained again.
///
/// # Errors
/// If the spec is invalid, or there are fewer records than folds.
///
/// # Panics
/// If the records do not match the trial's panels, sensors and clock.
pub fn evaluate(
    trial: &TrialSpec,
    measured: &Measured,
    effort: Effort,
    threads: usize,
    kept: &dyn NetworkStore,
) -> Result<Evaluated, NoResult> {
    let problem = any_body(trial)?;
    let Effort { folds, seeds, iterations, brain } = effort;
    if brain != BrainKind::Cnn {
        solvable(trial, problem.decoder.lags).map_err(|invalid| NoResult::Rejected(invalid.to_string()))?;
    }
    let Measured { forces, signals, low_pass, .. } = measured;
    let samples = forces.samples;
    if !(2..=samples).contains(&folds) {
        return Err(NoResult::Rejected(format!(
            "--folds {folds}: must lie between 2 and {samples}, the number of records"
        )));
    }
    let records = records(forces, signals.clone(), problem.scene.instants, *low_pass);
    let recipe = Recipe { kind: problem::kind(brain), ..problem.recipe() };
    let dealt = stimuli::folds(problem.seed, samples, folds);

    // One network per thread: a few records cannot use more threads.
    let next = AtomicUsize::new(0);
    let work = || -> Result<Vec<(usize, FoldEstimates)>, NoResult> {
        let (pool, mut found) = (pool(1)?, Vec::new());
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= seeds * folds {
                return Ok(found);
            }
            if let Some(network) = kept.network(number) {
                found.push((number, network));
                continue;
            }
            let (fold, seed) = (number % folds, (number / folds) as u64);
            let (unseen, known): (Vec<usize>, Vec<usize>) = (0..samples).partition(|&i| dealt[i] == fold);
            let [unseen, known] = [unseen, known].map(|numbers| records.select(&numbers));
            let estimates = HeldOutEstimates::of(&known, &unseen, recipe, seed, iterations, &pool);
            let network = FoldEstimates::new(estimates, number < folds);
            kept.store_network(number, &network);
            found.push((number, network));
        }
    };
    let mut networks = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(work)).collect();
        let found = threads.into_iter().map(|thread| thread.join().expect("training does not panic"));
        found.collect::<Result<Vec<_>, _>>().map(|found| found.concat())
    })?;
    networks.sort_by_key(|(number, _)| *number);
    let mut networks = networks.into_iter().map(|(_, network)| network);
    let by_seed: Vec<Vec<FoldEstimates>> =
        (0..seeds).map(|_| networks.by_ref().take(folds).collect()).collect();
    Ok(Evaluated::new(&by_seed, dealt, records.targets))
}

fn map_networks<T>(by_seed: &[Vec<FoldEstimates>], what: impl Fn(&FoldEstimates) -> T) -> Vec<Vec<T>> {
    by_seed.iter().map(|networks| networks.iter().map(&what).collect()).collect()
}

/// Records per batch of the inverse decoder: the lanes of its simulation.
const TOGETHER: usize = 32;

/// Number of batches of the inverse decoder.
pub fn parts(records: usize) -> usize {
    records.div_ceil(TOGETHER)
}

/// Estimates the forces of records with the inverse decoder of a design or its twin, in [`parts`]. Parts in `kept` are not
/// computed again.
///
/// # Errors
/// If the spec is invalid, the design belongs to another body, or its model cannot be simulated.
pub fn estimate_by_inverse(
    trial: &TrialSpec,
    own: (&[f64], Option<&Twin>),
    measured: &Measured,
    threads: usize,
    kept: &dyn NetworkStore,
) -> Result<Evaluated, NoResult> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    let Measured { forces, signals, low_pass, .. } = measured;
    let records = records(forces, signals.clone(), problem.scene.instants, *low_pass);
    let one = signals.len() / forces.samples;
    let mut found: Vec<Option<FoldEstimates>> =
        (0..parts(forces.samples)).map(|part| kept.network(part)).collect();
    if found.contains(&None) {
        with_brain(&problem, own, &pool, |brain| {
            let parts = signals.chunks(TOGETHER * one).zip(&mut found).enumerate();
            for (number, (signals, found)) in parts.filter(|(_, (_, found))| found.is_none()) {
                let begun = cpu_seconds();
                let mut posterior = Posterior::of(&brain.read(signals));
                posterior.seconds = cpu_seconds() - begun;
                let part = FoldEstimates { posterior: Some(posterior), ..FoldEstimates::default() };
                kept.store_network(number, &part);
                *found = Some(part);
            }
        })?;
    }
    let mut posterior = Posterior::default();
    let parts = found.iter().flatten().filter_map(|part| part.posterior.as_ref());
    parts.for_each(|part| posterior.extend(part));
    let estimates = FoldEstimates {
        predictions: posterior.forces.clone(),
        errors: records.errors(&posterior.forces),
        outcome: "ok".to_owned(),
        ..FoldEstimates::default()
    };
    let evaluated = Evaluated::new(&[vec![estimates]], vec![0; forces.samples], records.targets);
    Ok(Evaluated { posterior: Some(posterior), ..evaluated })
}

/// As [`evaluate`], with decoders fitted to a twin's simulated training samples, or with its inverse decoder. Also returns the
/// signals (N, T, channels) of the twin under the records' forces. `folds` are those of [`evaluate`].
///
/// # Errors
/// If the spec is invalid, or the twin cannot be simulated.
pub fn evaluate_by_twin(
    trial: &TrialSpec,
    (design, twin): (&[f64], &Twin),
    measured: &Measured,
    effort: Effort,
    folds: &[usize],
    threads: usize,
    kept: &dyn NetworkStore,
) -> Result<(Vec<f64>, Evaluated), NoResult> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    check_design(&problem, design)?;
    let Measured { forces, signals, low_pass, .. } = measured;
    let (ready, cast) = (PreparedTrial::new(&problem, &pool)?, Some(&twin.cast));
    let sensed = ready.samples(design, cast, forces.clone())?.signals;
    if effort.brain == BrainKind::Inverse {
        return Ok((sensed, estimate_by_inverse(trial, (design, Some(twin)), measured, threads, kept)?));
    }
    let [known, _] = problem.training_and_test();
    let known = ready.samples(design, cast, known)?;
    let records = records(forces, signals.clone(), problem.scene.instants, *low_pass);
    let recipe = Recipe { kind: problem::kind(effort.brain), ..problem.recipe() };
    let of = |number| HeldOutEstimates::of(&known, &records, recipe, number as u64, effort.iterations, &pool);
    let by_seed: Vec<Vec<FoldEstimates>> =
        (0..effort.seeds).map(|number| vec![FoldEstimates::new(of(number), number == 0)]).collect();
    let evaluated = Evaluated::new(&by_seed, vec![0; folds.len()], records.targets);
    Ok((sensed, Evaluated { folds: folds.to_vec(), ..evaluated }))
}

/// Signals (N, T, 3M) of the trial's model of `design` under the same forces, with the noise of its chips.
///
/// # Errors
/// If the spec is invalid, the design has the wrong length, or a simulation fails.
pub fn simulated(
    trial: &TrialSpec,
    design: &[f64],
    forces: &Forces,
    threads: usize,
) -> Result<Vec<f64>, NoResult> {
    let pool = pool(threads)?;
    let problem = match trial.body.kind.is_polygons() {
        true => placed(trial, &pool)?,
        false => any_body(trial)?,
    };
    check_design(&problem, design)?;
    let signals = questions::sense(&problem, design, forces, &pool);
    match problem.body.failure() {
        Some(fault) => Err(NoResult::of_body(fault)),
        None => Ok(signals?),
    }
}
