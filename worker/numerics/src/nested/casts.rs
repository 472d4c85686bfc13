//! Evaluates decoders on casts that no training used.
//!
//! Linear decoders are fitted to the body as designed, to samples of many other casts, and, if requested, to these and 10, 30, 100
//! or all training samples of the cast itself. Trials with networks add the first network of their comparison, and one trained on
//! other casts. Each is evaluated on the held-out set; a cast whose simulation fails has an error of 100 %.

use super::evaluation::{BandCoverage, CastDecoder, CastEvaluation, Regularisation};
use super::fresh::fit_and_evaluate;
use super::inversion::evaluate_inverse_on_cast;
use super::observe::{Log, NoObserver};
use super::state::State;
use crate::brains::{Band, Fitted, FittedDecoder, NetworkTraining, Pooled, Recipe, new_decoder};
use crate::random::Purpose;
use crate::trial::{
    Counters, Decoder, DecoderKind, DesignWithSolver, PreparedTrial, Problem, Result, RidgeChoice, Samples,
    as_ref_result,
};
use crate::variation::{Cast, Casts};

/// Number of casts to which the decoder for all casts is fitted, and of samples per cast.
const FITTING_CASTS: usize = 24;
const KNOWN_SAMPLES: usize = 20;
/// Number of their first sample, above those of the outer steps.
const KNOWN_FIRST: u64 = 1 << 40;
/// Numbers of records on which decoders are calibrated, if the training set is larger; all its samples follow.
pub const RECORDS: [usize; 3] = [10, 30, 100];

/// Training samples of the body as designed, and samples of many casts.
type FittingSamples = [Result<Samples>; 2];

/// The decoders fitted before a cast is evaluated, and the numbers of records.
struct CastDecoders<'a> {
    /// Trained on the body as designed and on many casts; empty unless the trial's decoder is a network.
    networks: Vec<Result<Box<dyn FittedDecoder + 'a>>>,
    nominal: Result<Fitted>,
    casts: Result<Pooled>,
    /// Numbers of records of a cast on which decoders are calibrated.
    records: Vec<usize>,
}

/// Evaluates the remaining casts of body number `turn`. `None` if the observer stopped it; the observer then has the state.
pub(super) fn evaluate_casts(
    mould: &DesignWithSolver,
    turn: usize,
    state: &mut State,
    log: &mut Log,
) -> Option<()> {
    let trial = mould.trial;
    let problem = &trial.problem;
    let done = state.comparison.casts_read(turn);
    if done >= problem.evaluation.casts {
        return Some(());
    }
    let counted = log.report.counters;
    // a resumed comparison fits its decoders again, to the same bits
    let fitting_samples = log.timed(|s| &mut s.simulate, |report| known(mould, &mut report.counters));
    if done > 0 || state.comparison.training.is_some() {
        log.report.counters = counted;
    }
    let some = as_ref_result(&fitting_samples[1]).map(|casts| thin_samples(casts, trial.train.samples));
    let readings = &state.comparison.bodies[turn].readings;
    let own = readings.first().filter(|reading| reading.lags == problem.decoder.lags);
    let ridge = own.map(|reading| reading.ridge).filter(|_| problem.decoder.ridge == RidgeChoice::Auto);
    let mut brains = log.timed(|s| &mut s.train, |_| CastDecoders::new(trial, &fitting_samples, ridge));
    if problem.decoder_kind.is_network() {
        let known = [as_ref_result(&fitting_samples[0]), as_ref_result(&some)];
        brains.networks = networks(trial, known, (turn, ridge), state, log)?;
    }
    if done > 0 {
        log.report.counters = counted;
    }
    for number in done..problem.evaluation.casts {
        // work that an interrupted cast repeats counts once
        let counted = if number == 0 { counted } else { log.report.counters };
        let cast = trial.cast(Casts::Unseen, number as u64);
        let sets = log.timed(|s| &mut s.simulate, |report| sets(mould, cast.as_ref(), &mut report.counters));
        state.comparison.casts.resize_with(turn + 1, Vec::new);
        state.comparison.bands.resize_with(state.comparison.bodies.len(), Vec::new);
        let done = state.comparison.completed_fraction(0, problem);
        let bands = &mut state.comparison.bands[turn];
        let before = bands.len();
        let found = log.timed_while(
            done,
            |s| &mut s.train,
            |report, go_on| {
                let mut found = brains.read(trial, number as u32, &sets, bands);
                if problem.decoder_kind == DecoderKind::Inverse {
                    let (number, counters) = (number as u32, &mut report.counters);
                    let (readings, own) =
                        evaluate_inverse_on_cast(mould, &fitting_samples[0], number, &sets, counters, go_on)?;
                    found.extend(readings);
                    bands.extend(own);
                }
                Some(found)
            },
        );
        let Some(found) = found else {
            bands.truncate(before);
            log.report.counters = counted;
            log.save(state);
            return None;
        };
        state.comparison.casts[turn].extend(found);
        log.report_progress(problem, state)?;
    }
    Some(())
}

/// Equally many samples of each cast, in total at least `training` if there are enough.
fn thin_samples(casts: &Samples, training: usize) -> Samples {
    let each = training.div_ceil(FITTING_CASTS).min(KNOWN_SAMPLES);
    casts.select(&(0..casts.count()).filter(|i| i % KNOWN_SAMPLES < each).collect::<Vec<_>>())
}

/// The first network of the comparison, and one with the same initial weights and iterations trained on casts; `None` if the
/// observer stopped it.
fn networks<'a>(
    trial: &'a PreparedTrial<'a>,
    known: [Result<&'a Samples>; 2],
    (turn, ridge): (usize, Option<f64>),
    state: &mut State,
    log: &mut Log,
) -> Option<Vec<Result<Box<dyn FittedDecoder + 'a>>>> {
    let (recipe, [nominal, casts]) = (trial.problem.recipe(), known);
    let casts = match casts {
        Ok(known) => weights_for(trial, known, state, log)?.map(|weights| (known, weights)),
        Err(trouble) => Err(trouble),
    };
    let first = state.comparison.bodies[turn].networks.first();
    let nominal = nominal.and_then(|known| {
        let first = first.expect("it is compared first");
        first.trouble.map_or(Ok((known, first.weights.clone())), Err)
    });
    let ready = [(nominal, ridge), (casts, None)].map(|(trained, ridge)| {
        let (known, weights) = trained?;
        let scales = [(); 2].map(|()| trial.scales.clone());
        let ridge = ridge.map_or(recipe.decoder.ridge, RidgeChoice::Given);
        let recipe = Recipe { decoder: Decoder { ridge, ..recipe.decoder }, ..recipe };
        let mut reader = new_decoder(recipe, known, scales, trial.pool)?;
        *reader.training().expect("a network has weights") = Some(NetworkTraining::of(weights));
        Ok(reader)
    });
    Some(ready.into())
}

/// Weights of a network trained on samples of casts, with the comparison's initial weights and iterations; `None` if the observer
/// stopped it.
fn weights_for(
    trial: &PreparedTrial,
    known: &Samples,
    state: &mut State,
    log: &mut Log,
) -> Option<Result<Vec<f32>>> {
    let scales = trial.scales_of(&known.signals);
    let mut reader = match new_decoder(trial.problem.recipe(), known, scales, trial.pool) {
        Ok(reader) => reader,
        Err(trouble) => return Some(Err(trouble)),
    };
    let (sets, iterations) = ([(); 3].map(|()| known.select(&[])), trial.problem.brain.iterations);
    let found = fit_and_evaluate(trial, &mut *reader, &sets, None, (0, iterations, false), state, log)?;
    Some(found.trouble.map_or(Ok(found.weights), Err))
}

/// A decoder for all casts of a body.
#[derive(Debug, Clone, PartialEq)]
pub enum DecoderForCasts {
    /// A linear decoder.
    Linear(Fitted),
    /// Weights of a network, for inputs at the trial's scales.
    Network(Vec<f32>),
    /// A linear decoder, and weights of the network that also uses its estimates.
    Stacked(Fitted, Vec<f32>),
}

/// Fits a decoder of the trial's kind for all casts of a design, to the same casts as the comparison; evaluated casts are others.
///
/// # Errors
/// If these casts cannot be simulated, or fitting fails.
pub fn brain_for_casts(trial: &PreparedTrial, design: &[f64]) -> Result<DecoderForCasts> {
    let solver = &trial.tuned(design).solver;
    let casts = samples_of_casts(&DesignWithSolver { trial, design, solver }, &mut Counters::default());
    if !trial.problem.decoder_kind.is_network() {
        let casts = casts?;
        let pooled = Pooled::new(trial, &casts, casts.count() / KNOWN_SAMPLES)?;
        return Ok(DecoderForCasts::Linear(pooled.fitted));
    }
    let (mut state, mut observer) = (State::new(&trial.problem), NoObserver);
    let samples = thin_samples(&casts?, trial.train.samples);
    let weights = weights_for(trial, &samples, &mut state, &mut Log::new(0, &mut observer));
    let weights = weights.expect("nobody says stop")?;
    Ok(match trial.problem.decoder_kind {
        DecoderKind::Stacked => {
            let Problem { decoder, seed, .. } = &trial.problem;
            let beneath = decoder.fitted(*seed, &samples, trial.scales.clone(), trial.pool)?;
            DecoderForCasts::Stacked(beneath, weights)
        }
        _ => DecoderForCasts::Network(weights),
    })
}

/// Evaluates linear and inverse decoders on the first `count` casts of a design. `progress` receives the number of finished casts.
pub fn evaluate_linear_on_casts(
    trial: &PreparedTrial,
    design: &[f64],
    count: usize,
    progress: &mut dyn FnMut(usize),
) -> Vec<CastEvaluation> {
    let (solver, counters) = (&trial.tuned(design).solver, &mut Counters::default());
    let mould = DesignWithSolver { trial, design, solver };
    let known = known(&mould, counters);
    let mut brains = CastDecoders::new(trial, &known, None);
    let mut found = Vec::new();
    for number in 0..count {
        let cast = trial.cast(Casts::Unseen, number as u64);
        let sets = sets(&mould, cast.as_ref(), counters);
        found.extend(brains.read(trial, number as u32, &sets, &mut Vec::new()));
        if trial.problem.decoder_kind == DecoderKind::Inverse {
            let evaluated =
                evaluate_inverse_on_cast(&mould, &known[0], number as u32, &sets, counters, &mut || true);
            found.extend(evaluated.expect("told to go on").0);
        }
        progress(number + 1);
    }
    found
}

/// Training samples of the body as designed, and samples of many casts.
fn known(mould: &DesignWithSolver, counters: &mut Counters) -> FittingSamples {
    let [train, _] = mould.trial.problem.training_and_test();
    [mould.samples(None, train, counters), samples_of_casts(mould, counters)]
}

/// Samples of the `FITTING_CASTS` casts.
fn samples_of_casts(mould: &DesignWithSolver, counters: &mut Counters) -> Result<Samples> {
    let trial = mould.trial;
    let one = |number: usize, counters: &mut Counters| {
        let first = KNOWN_FIRST + (number * KNOWN_SAMPLES) as u64;
        let forces = trial.problem.forces(Purpose::Fresh, first, KNOWN_SAMPLES);
        mould.samples(trial.cast(Casts::Known, number as u64).as_ref(), forces, counters)
    };
    let (mut all, mut failed) = (Vec::with_capacity(FITTING_CASTS), None);
    for found in trial.map_parallel(FITTING_CASTS, counters, one) {
        match found {
            Ok(found) => all.push(found),
            // casts that fail are left out
            Err(trouble) => failed = Some(trouble),
        }
    }
    match failed {
        Some(trouble) if all.is_empty() => Err(trouble),
        _ => Ok(Samples::joined(&all.iter().collect::<Vec<_>>())),
    }
}

/// Training samples of a cast, empty unless decoders are calibrated on them, and its held-out samples.
fn sets(mould: &DesignWithSolver, cast: Option<&Cast>, counters: &mut Counters) -> Result<[Samples; 2]> {
    let problem = &mould.trial.problem;
    let [train, _] = problem.training_and_test();
    let mut of = |forces| mould.samples(cast, forces, counters);
    let train = problem.evaluation.records.then(|| of(train)).transpose()?;
    let holdout = of(problem.holdout())?;
    Ok([train.unwrap_or_else(|| holdout.select(&[])), holdout])
}

impl CastDecoders<'_> {
    /// Fits the linear decoders. `ridge`: λ chosen earlier on the body as designed, if known.
    fn new(trial: &PreparedTrial, known: &FittingSamples, ridge: Option<f64>) -> Self {
        let nominal = as_ref_result(&known[0]).and_then(|known| match ridge {
            Some(ridge) => {
                let decoder = Decoder { ridge: RidgeChoice::Given(ridge), ..trial.problem.decoder };
                decoder.fit(trial.problem.seed, known, Some(trial.scales.channels.clone()), trial.pool)
            }
            None => Fitted::of(trial, known),
        });
        let casts = as_ref_result(&known[1])
            .and_then(|known| Pooled::new(trial, known, known.count() / KNOWN_SAMPLES));
        let all = trial.train.samples;
        let records = RECORDS.into_iter().filter(|&n| n < all).chain([all]);
        let records = records.filter(|_| trial.problem.evaluation.records).collect();
        Self { networks: Vec::new(), nominal, casts, records }
    }

    /// Evaluates all decoders on a cast with these training and held-out samples. Appends to `bands` the coverage of the design's
    /// bands by the trial's kind of decoder.
    fn read(
        &mut self,
        trial: &PreparedTrial,
        cast: u32,
        sets: &Result<[Samples; 2]>,
        bands: &mut Vec<BandCoverage>,
    ) -> Vec<CastEvaluation> {
        let networks =
            [CastDecoder::Network, CastDecoder::NetworkCasts].into_iter().take(self.networks.len());
        let brains = networks.chain([CastDecoder::Nominal, CastDecoder::Casts]);
        let records = self.records.iter().map(|&n| CastDecoder::Records(n as u32));
        let brains: Vec<CastDecoder> = brains.chain(records).collect();
        let own: &[CastDecoder] = match trial.problem.decoder_kind {
            DecoderKind::Linear => &[CastDecoder::Nominal, CastDecoder::Casts],
            DecoderKind::Network | DecoderKind::Stacked => &[CastDecoder::Network, CastDecoder::NetworkCasts],
            DecoderKind::Inverse => &[],
        };
        let designed: Vec<BandCoverage> = bands.iter().filter(|band| band.cast.is_none()).cloned().collect();
        brains
            .into_iter()
            .map(|by| {
                let found = as_ref_result(sets).and_then(|[train, holdout]| {
                    let (said, regularisation) = self.predict(trial, by, train, &holdout.signals)?;
                    Ok((holdout, said, regularisation))
                });
                for reading in designed.iter().filter(|_| own.contains(&by)) {
                    let within = |(holdout, said, _): &(&Samples, Vec<f64>, _)| {
                        reading.band.coverage(holdout, said, trial.problem.first_band_sample(holdout.count()))
                    };
                    // a failed decoder covers nothing
                    let coverage = found.as_ref().map_or(reading.coverage.map(|_| 0.0), within);
                    let band = Band { half_width: Vec::new(), ..reading.band };
                    bands.push(BandCoverage { cast: Some((cast, by)), band, width: reading.width, coverage });
                }
                let errors =
                    found.map(|(holdout, said, regularisation)| (holdout.errors(&said), regularisation));
                CastEvaluation::new(cast, by, errors)
            })
            .collect()
    }

    /// Forces (N, T, K) in N from signals (N, T, 3M) of a cast with these training samples, and the decoder's regularisation.
    fn predict(
        &mut self,
        trial: &PreparedTrial,
        by: CastDecoder,
        train: &Samples,
        signals: &[f64],
    ) -> Result<(Vec<f64>, Regularisation)> {
        let network = |network: &mut Result<Box<dyn FittedDecoder + '_>>| {
            let network = network.as_mut().map_err(|trouble| *trouble)?;
            Ok((network.predict(signals), Regularisation { ridge: network.ridge(), kappa: None }))
        };
        let linear = |fitted: &Fitted, share| {
            Ok((fitted.predict(signals), Regularisation { ridge: Some(fitted.ridge), kappa: share }))
        };
        match by {
            CastDecoder::Network => network(&mut self.networks[0]),
            CastDecoder::NetworkCasts => network(&mut self.networks[1]),
            CastDecoder::Nominal => linear(as_ref_result(&self.nominal)?, None),
            CastDecoder::Casts => linear(&as_ref_result(&self.casts)?.fitted, None),
            CastDecoder::Records(n) => {
                let some = train.select(&(0..n as usize).collect::<Vec<_>>());
                let (seed, pool) = (trial.problem.seed, trial.pool);
                let (fitted, share) = as_ref_result(&self.casts)?.calibrated(seed, &some, pool)?;
                linear(&fitted, Some(share))
            }
            CastDecoder::Inverse | CastDecoder::TwinLinear(_) | CastDecoder::Twin(_) => {
                unreachable!("read by `evaluate_inverse_on_cast`")
            }
        }
    }
}
