//! Networks on given signals and forces, wherever they come from: each record is predicted by one that has not seen it.
//!
//! A seeded shuffle deals the records into folds; a fold's network trains on all others, from the initial weights of the
//! comparison at the end of a trial. Its scales are those of its own training records.

use super::evaluation::Fresh;
use super::linear::{Decoder, Plain, Stack, force_scale};
use super::problem::{Problem, Schedule, Training};
use super::report::{Failure, Trouble};
use super::setting::{Scales, Setting, all_well, mean_error};
use super::tuning::Tuning;
use crate::Heartbeat;
use crate::brain::linear::Sizes;
use crate::brain::{Shape, TrainOutcome, Workspace, prediction_error};
use crate::dynamics::{Forces, simulate, tune};
use crate::random::{Purpose, Stream};
use crate::stimuli::targets;

/// Records of one body.
#[derive(Debug, Clone, PartialEq)]
pub struct Records {
    /// T, 3M, K and the network's layers.
    shape: Shape,
    samples: usize,
    /// (N, T, 3M) (mm/s², rad/s).
    signals: Vec<f64>,
    /// (N, T, K) (N).
    targets: Vec<f64>,
}

/// What a fold's network says.
#[derive(Debug, Clone, PartialEq)]
pub struct Unseen {
    /// Predicted forces (n, T, K) (N) of the fold's n records.
    pub predictions: Vec<f64>,
    /// Their errors (%); `None` where there is no force.
    pub errors: Vec<Option<f64>>,
    /// Mean error on the records that trained it (%).
    pub error_train: Option<f64>,
    /// Training loss (normalised) at every iteration.
    pub losses: Vec<f32>,
    /// (Iteration, from 1, mean error on the fold's records there) at the milestones of the training.
    pub progress: Vec<(u32, f64)>,
    /// What went wrong.
    pub trouble: Option<Trouble>,
}

impl Records {
    /// Signals (N, T, 3M) under forces; with `low_pass` targets hold what T instants can say.
    ///
    /// # Panics
    /// If signals or panels are not as many as those of the shape.
    pub fn new(forces: &Forces, signals: Vec<f64>, shape: Shape, low_pass: bool) -> Self {
        let Forces { samples, panels, .. } = *forces;
        assert_eq!(panels, shape.outputs, "panels");
        assert_eq!(signals.len(), samples * shape.instants * shape.inputs, "signals of {samples} samples");
        Self { shape, samples, signals, targets: targets(forces, shape.instants, low_pass) }
    }

    /// True forces (N, T, K) (N).
    pub fn targets(&self) -> &[f64] {
        &self.targets
    }

    /// Signals (n, T, 3M) and targets (n, T, K) of the records listed.
    fn select(&self, records: &[usize]) -> (Vec<f64>, Vec<f64>) {
        let pick = |values: &[f64]| {
            let size = values.len() / self.samples;
            records.iter().flat_map(|&i| &values[i * size..][..size]).copied().collect()
        };
        (pick(&self.signals), pick(&self.targets))
    }

    /// The records listed as a linear brain takes them.
    fn plain(&self, scales: &Scales, records: &[usize]) -> Plain {
        let (signals, targets) = self.select(records);
        let Shape { instants, inputs, outputs, .. } = self.shape;
        let force = force_scale(&scales.mean, &scales.deviation);
        let sizes = Sizes { instants, channels: inputs, outputs };
        Plain::new(sizes, scales.inputs(&signals), &targets, force, &Heartbeat::default())
    }

    /// Trains a network on the records outside `fold` (of each record, as `folds` deals them) and lets it predict those
    /// inside. `start` is a seed and the number of its initial weights; a network that is `stacked` sees what such a
    /// linear brain makes of the signals, too.
    ///
    /// # Panics
    /// If there is no record inside or outside.
    pub fn unseen(
        &self,
        folds: &[usize],
        fold: usize,
        training: Training,
        stacked: Option<&Decoder>,
        schedule: Schedule,
        start: [u64; 2],
        pool: &crate::Pool,
    ) -> Unseen {
        let (test, train): (Vec<usize>, Vec<usize>) = (0..self.samples).partition(|&i| folds[i] == fold);
        let (signals, targets) = self.select(&train);
        let scales = Scales::new(&self.shape, &signals, &targets);
        let (test_signals, truth) = self.select(&test);
        let (data, unseen) = match stacked {
            None => {
                let data = |signals: &[f64], targets: &[f64]| scales.data(self.shape, signals, targets);
                (data(&signals, &targets), data(&test_signals, &truth))
            }
            Some(decoder) => {
                let shape = Shape { inputs: self.shape.inputs + self.shape.outputs, ..self.shape };
                let [known, unseen] = [&train, &test].map(|records| self.plain(&scales, records));
                let stack = match Stack::new(decoder, start[0], &known) {
                    Ok(stack) => stack,
                    Err(trouble) => return Unseen::nothing(&truth, test.len(), trouble),
                };
                let seen = scales.stacked(shape, &signals, &known, &stack.cross_fitted(&known.x));
                (seen, scales.stacked(shape, &test_signals, &unseen, &stack.answers(&unseen.x)))
            }
        };
        let [mut workspace, mut aside] = [(); 2].map(|()| Workspace::new(data.shape(), pool.width()));
        let mut error =
            |weights: &[f32]| mean_error(&scales.predict(weights, &unseen, &truth, &mut aside, pool).1);
        let mut fresh = Fresh::new(data.shape(), start);
        let outcome =
            fresh.train(&data, training, schedule, &mut error, &mut |_| false, &mut workspace, pool);
        let outcome = outcome.expect("it does not pause");
        let Fresh { weights, losses, errors: progress, .. } = fresh;
        let error_train = mean_error(&scales.predict(&weights, &data, &targets, &mut workspace, pool).1);
        let (predictions, errors) = scales.predict(&weights, &unseen, &truth, &mut workspace, pool);
        let trouble = (outcome != TrainOutcome::Ok).then_some(Trouble::Training(outcome));
        Unseen { predictions, errors, error_train, losses, progress, trouble }
    }
}

impl Unseen {
    /// Of a brain that came to nothing.
    fn nothing(truth: &[f64], records: usize, trouble: Trouble) -> Self {
        Self {
            predictions: vec![0.0; truth.len()],
            errors: vec![None; records],
            error_train: None,
            losses: Vec::new(),
            progress: Vec::new(),
            trouble: Some(trouble),
        }
    }
}

impl Records {
    /// The same by a linear brain, its λ by folds of the records outside `fold`.
    ///
    /// # Panics
    /// If there is no record inside or outside.
    pub fn unseen_linear(&self, folds: &[usize], fold: usize, decoder: &Decoder, seed: u64) -> Unseen {
        let (test, train): (Vec<usize>, Vec<usize>) = (0..self.samples).partition(|&i| folds[i] == fold);
        let (signals, targets) = self.select(&train);
        let (test_signals, truth) = self.select(&test);
        let Shape { instants, inputs, outputs, .. } = self.shape;
        let sizes = Sizes { instants, channels: inputs, outputs };
        let fitted = match decoder.fitted(seed, sizes, &signals, &targets, None) {
            Ok(fitted) => fitted,
            Err(trouble) => return Unseen::nothing(&truth, test.len(), trouble),
        };
        let predictions = fitted.predict(&test_signals);
        Unseen {
            errors: prediction_error(&truth, &predictions, outputs, instants),
            predictions,
            error_train: fitted.error,
            losses: Vec::new(),
            progress: Vec::new(),
            trouble: None,
        }
    }
}

/// The fold, from 0, of each of `records` records: a seeded shuffle, sizes that differ by one at most.
pub fn folds(seed: u64, records: usize, folds: usize) -> Vec<usize> {
    let mut of = vec![0; records];
    let order = Stream::new(Purpose::Split, seed, [records as u64, 2]).permutation(records);
    order.into_iter().enumerate().for_each(|(n, record)| of[record] = n % folds);
    of
}

/// Signals (N, T, 3M) of a body under given forces, as its chips say them: those of the trial, which are the same on every body.
///
/// # Errors
/// If a sample does not reach its end, or, where chips are relative to it, the trial's initial body does not.
pub fn sense(
    problem: &Problem,
    design: &[f64],
    forces: &Forces,
    pool: &crate::Pool,
) -> Result<Vec<f64>, Failure> {
    let scene = &problem.scene;
    let solver = tune(scene, design, forces, &problem.solver, pool).solver;
    let simulation = simulate(scene, design, forces, &solver, false, pool);
    all_well(&simulation.outcomes).map_err(Failure::Initial)?;
    let mut signals = simulation.signals;
    if problem.disturbance.is_some() {
        let trial = Tuning::new(problem, pool)?.problem;
        Setting::new(&trial, pool)?.disturb(&mut signals, forces);
    }
    Ok(signals)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::brain::Architecture;

    #[test]
    fn folds_are_equal_but_for_one_and_follow_the_seed() {
        let found = folds(3, 32, 5);
        let mut sizes: Vec<usize> = (0..5).map(|f| found.iter().filter(|&&g| g == f).count()).collect();
        sizes.sort_unstable();
        assert_eq!(sizes, [6, 6, 6, 7, 7], "{found:?}");
        assert_eq!(found, folds(3, 32, 5));
        assert_ne!(found, folds(4, 32, 5));
    }

    /// A record whose forces are made up: whoever has seen it knows them, its own fold's network cannot.
    #[test]
    fn a_fold_s_network_has_not_seen_its_records() {
        let (samples, instants) = (12, 16);
        let mut stream = Stream::new(Purpose::Design, 5, [0, 0]);
        let mut forces = Forces { samples, panels: 1, instants, values: Vec::new() };
        let mut signals = Vec::new();
        for _ in 0..samples {
            let f: Vec<f64> = (0..=instants).map(|_| stream.uniform()).collect();
            f[1..].iter().for_each(|f| signals.extend([3e3 * f, -1e3 * f, 0.1 * f]));
            forces.values.extend(f);
        }
        // the made-up one
        signals[..instants * 3].iter_mut().for_each(|x| *x = -*x);
        let pool = crate::Pool::new(1).unwrap();
        let architecture = Architecture::paper(64);
        let shape = Shape { instants, inputs: 3, outputs: 1, architecture };
        let records = Records::new(&forces, signals, shape, false);
        let dealt = folds(1, samples, 4);
        let inside: Vec<usize> = (0..samples).filter(|&i| dealt[i] == dealt[0]).collect();
        let inside_of = |record: usize| inside.iter().position(|&i| i == record).unwrap();
        let training = Training { iterations: 150, rate: 1e-2, architecture };
        let fold = |fold| records.unseen(&dealt, fold, training, None, Schedule::Cosine, [1, 0], &pool);
        let decoder = Decoder::whole(instants, 3);
        let linear = |fold| records.unseen_linear(&dealt, fold, &decoder, 1);
        let stacked = |fold| {
            let (decoder, schedule) = (Some(&decoder), Schedule::Cosine);
            records.unseen(&dealt, fold, training, decoder, schedule, [1, 0], &pool)
        };
        assert!(stacked(dealt[0]).errors[inside_of(0)].unwrap() > 50.0);
        let read = [fold(dealt[0]), linear(dealt[0])];
        let seen = [fold((dealt[0] + 1) % 4), linear((dealt[0] + 1) % 4)];
        let (own, other) = (read[0].clone(), seen[0].clone());
        assert!(read[1].errors[inside_of(0)].unwrap() > 50.0 && seen[1].trouble.is_none(), "{:?}", read[1]);
        let first = own.errors[inside_of(0)].unwrap();
        let train = other.error_train.unwrap();
        assert!(first > 50.0 && train < 10.0, "unseen {first} %, seen {train} %");
        assert_eq!((own.errors.len(), own.predictions.len()), (3, 3 * instants));
        assert_eq!(own, fold(dealt[0]));
    }
}
