//! A body compared by given records: fresh networks predict each record without having seen it.

use std::sync::atomic::{AtomicUsize, Ordering};

use metasense_numerics::brains::{Recipe, Records, Unseen};
use metasense_numerics::dynamics::Forces;
use metasense_numerics::questions;
use metasense_numerics::stimuli;
use metasense_schemas::spec::{BrainKind, TrialSpec};
use serde::{Deserialize, Serialize};

use crate::convert::finite;
use crate::measured::Measured;
use crate::problem::{self, solvable};
use crate::run::{Failure, check_design, placed, pool, prepared};
use crate::twin::Cast;

/// How many networks, and how long they train.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Effort {
    /// Parts into which the records are divided, each predicted by networks trained on the others; at least 2.
    pub folds: usize,
    /// Networks a fold.
    pub seeds: usize,
    /// Adam iterations of each.
    pub iterations: usize,
    /// Kind of brain; of linear ones there is one for each fold.
    pub brain: BrainKind,
}

/// How well fresh networks read the forces of records.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluated {
    /// The fold of each record (N).
    pub folds: Vec<usize>,
    /// True forces (N, T, K) (N).
    pub targets: Vec<f64>,
    /// Forces as the first seed's networks that have not seen a record predict them (N, T, K) (N).
    pub predictions: Vec<f64>,
    /// Errors (%) by seed, then record; `None` where there is no force.
    pub errors: Vec<Vec<Option<f64>>>,
    /// Mean error on its training records (%), by seed, then fold.
    pub errors_train: Vec<Vec<Option<f64>>>,
    /// (Iteration, mean error on unseen records (%) there), by seed, then fold.
    pub progress: Vec<Vec<Vec<(u32, f64)>>>,
    /// How each training ended, likewise.
    pub outcomes: Vec<Vec<String>>,
}

/// Predictions and errors of a fold's network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Network {
    /// Predicted forces (n, T, K) (N) of the fold's n records; of the first seed's networks alone.
    predictions: Vec<f64>,
    errors: Vec<Option<f64>>,
    error_train: Option<f64>,
    progress: Vec<(u32, f64)>,
    outcome: String,
}

impl Network {
    fn new(found: Unseen, first: bool) -> Self {
        let Unseen { predictions, errors, error_train, progress, trouble, .. } = found;
        let outcome = trouble.map_or("ok", |trouble| trouble.name()).to_owned();
        Self {
            predictions: if first { predictions } else { Vec::new() },
            errors,
            error_train,
            progress,
            outcome,
        }
    }
}

/// The networks that are there already, by number, and what hears of each new one.
pub trait Kept: Sync {
    /// That of this number.
    fn network(&self, number: usize) -> Option<Network>;
    /// It is done.
    fn done(&self, number: usize, network: &Network);
}

/// Trains `effort.seeds` networks a fold on measured or simulated signals, on `threads` threads, but those that are `kept`.
///
/// # Errors
/// If the spec stands for no trial, or there are fewer records than folds.
///
/// # Panics
/// If the records are not of this trial's panels, sensors and clock.
pub fn evaluate(
    trial: &TrialSpec,
    measured: &Measured,
    effort: Effort,
    threads: usize,
    kept: &dyn Kept,
) -> Result<Evaluated, Failure> {
    let problem = prepared(trial)?;
    let Effort { folds, seeds, iterations, brain } = effort;
    if brain != BrainKind::Cnn {
        solvable(trial, problem.decoder.lags).map_err(|invalid| Failure::Rejected(invalid.to_string()))?;
    }
    let Measured { forces, signals, low_pass } = measured;
    let samples = forces.samples;
    if !(2..=samples).contains(&folds) {
        return Err(Failure::Rejected(format!(
            "--folds {folds}: must lie between 2 and the {samples} records"
        )));
    }
    let records = Records::new(forces, signals.clone(), problem.scene.instants, *low_pass);
    let recipe = Recipe { kind: problem::kind(brain), ..problem.recipe() };
    let dealt = stimuli::folds(problem.seed, samples, folds);

    // a network a thread: few records would not keep more of them busy
    let next = AtomicUsize::new(0);
    let work = || -> Result<Vec<(usize, Network)>, Failure> {
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
            let network = records.unseen(&dealt, fold, recipe, seed, iterations, &pool);
            let network = Network::new(network, number < folds);
            kept.done(number, &network);
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
    let by_seed: Vec<Vec<Network>> = (0..seeds).map(|_| networks.by_ref().take(folds).collect()).collect();
    let of = |fold: usize| (0..samples).filter(|i| dealt[*i] == fold).collect::<Vec<usize>>();
    let members: Vec<Vec<usize>> = (0..folds).map(of).collect();
    let size = records.targets().len() / samples;
    let mut predictions = vec![0.0; records.targets().len()];
    for (network, records) in by_seed.iter().flatten().take(folds).zip(&members) {
        for (predicted, record) in network.predictions.chunks_exact(size).zip(records) {
            predictions[record * size..][..size].copy_from_slice(predicted);
        }
    }
    let errors_of = |networks: &Vec<Network>| {
        let mut errors = vec![None; samples];
        for (network, records) in networks.iter().zip(&members) {
            records.iter().zip(&network.errors).for_each(|(record, error)| errors[*record] = finite(*error));
        }
        errors
    };
    Ok(Evaluated {
        errors: by_seed.iter().map(errors_of).collect(),
        errors_train: each(&by_seed, |network| network.error_train),
        progress: each(&by_seed, |network| network.progress.clone()),
        outcomes: each(&by_seed, |network| network.outcome.clone()),
        targets: records.targets().to_vec(),
        folds: dealt,
        predictions,
    })
}

fn each<T>(by_seed: &[Vec<Network>], what: impl Fn(&Network) -> T) -> Vec<Vec<T>> {
    by_seed.iter().map(|networks| networks.iter().map(&what).collect()).collect()
}

/// The same of brains that are trained on a twin of the body, on its simulated training samples, and read all of the records; and the
/// signals (N, T, channels) that the twin gives under the same forces. `folds` are those of [`evaluate`].
///
/// # Errors
/// If the spec stands for no trial, or the twin cannot be simulated.
pub fn by_twin(
    trial: &TrialSpec,
    (design, twin): (&[f64], &Cast),
    measured: &Measured,
    effort: Effort,
    folds: &[usize],
    threads: usize,
) -> Result<(Vec<f64>, Evaluated), Failure> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    check_design(&problem, design)?;
    let Measured { forces, signals, low_pass } = measured;
    let records = Records::new(forces, signals.clone(), problem.scene.instants, *low_pass);
    let recipe = Recipe { kind: problem::kind(effort.brain), ..problem.recipe() };
    let (known, sensed) = questions::rehearse(&problem, design, twin, forces, &pool)?;
    let of = |number| records.taught(&known, recipe, number as u64, effort.iterations, &pool);
    let found: Vec<Network> = (0..effort.seeds).map(|number| Network::new(of(number), number == 0)).collect();
    let evaluated = Evaluated {
        errors: found.iter().map(|network| network.errors.iter().map(|e| finite(*e)).collect()).collect(),
        errors_train: found.iter().map(|network| vec![network.error_train]).collect(),
        progress: found.iter().map(|network| vec![network.progress.clone()]).collect(),
        outcomes: found.iter().map(|network| vec![network.outcome.clone()]).collect(),
        targets: records.targets().to_vec(),
        folds: folds.to_vec(),
        predictions: found[0].predictions.clone(),
    };
    Ok((sensed, evaluated))
}

/// Signals (N, T, 3M) that the trial's model of `design` gives under the same forces, its chips' noise included.
///
/// # Errors
/// If the spec stands for no trial, the design is of another length, or a sample does not reach its end.
pub fn simulated(
    trial: &TrialSpec,
    design: &[f64],
    forces: &Forces,
    threads: usize,
) -> Result<Vec<f64>, Failure> {
    let pool = pool(threads)?;
    let problem = placed(trial, &pool)?;
    check_design(&problem, design)?;
    Ok(questions::sense(&problem, design, forces, &pool)?)
}
