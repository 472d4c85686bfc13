//! Evaluates inverse decoders on a body and its casts: with the design as model, and with twins calibrated on a few records.

use super::evaluation::{BandCoverage, CastDecoder, CastEvaluation, NetworkEvaluation, Regularisation};
use super::observe::Log;
use super::state::State;
use crate::brains::{Band, BandKind, Estimate, Fitted, Inverse, Z_95};
use crate::identify::{Fit, GoOn};
use crate::trial::{Counters, DesignWithSolver, Samples, Trouble, as_ref_result};

/// Numbers of records on which twins are calibrated.
const RECORDS: [u32; 2] = [10, 30];
/// Held-out samples per cast that inverse decoders evaluate: each takes as long as about a hundred simulations.
pub const INVERTED_PER_CAST: usize = 16;

/// Errors of the samples of a cast, the decoder's regularisation, and its band.
type InverseErrors = (Vec<Option<f64>>, Regularisation, Option<BandCoverage>);

/// Evaluates the last body's test and held-out samples; `None` if the observer stopped it.
pub(super) fn evaluate_inverse(
    &DesignWithSolver { trial, design, solver }: &DesignWithSolver,
    sets: &Result<[Samples; 3], Trouble>,
    state: &mut State,
    log: &mut Log,
) -> Option<()> {
    let read = |counters: &mut Counters, go_on: &mut GoOn| {
        let brain = as_ref_result(sets).and_then(|[known, test, holdout]| {
            Ok((Inverse::new(trial, design, solver, None, known)?, test, holdout))
        });
        let (mut brain, test, holdout) = match brain {
            Ok(brain) => brain,
            Err(trouble) => return Some(Err(trouble)),
        };
        let test = test.errors(&forces(&brain.read_while(&test.signals, go_on)?));
        let found = brain.read_while(&holdout.signals, go_on)?;
        counters.dynamics += brain.counters.dynamics;
        let evaluation = NetworkEvaluation::of(None, &test, &holdout.errors(&forces(&found)));
        Some(Ok((evaluation, band(&found, holdout, None))))
    };
    let done = state.comparison.completed_fraction(0, &trial.problem);
    let found = log.timed_while(done, |s| &mut s.train, |report, go_on| read(&mut report.counters, go_on));
    let Some(found) = found else {
        log.save(state);
        return None;
    };
    let comparison = &mut state.comparison;
    let turn = comparison.bodies.len() - 1;
    comparison.bands.resize_with(turn + 1, Vec::new);
    let evaluation = match found {
        Ok((evaluation, band)) => {
            comparison.bands[turn] = vec![band];
            evaluation
        }
        Err(trouble) => NetworkEvaluation::failed(trouble),
    };
    comparison.bodies[turn].networks.push(evaluation);
    log.report_progress(&trial.problem, state)
}

/// Evaluates a cast, given its training and held-out samples. Decoders: inverse with the design as model (`known`: its training
/// samples), inverse with twins, linear fitted to twins. `None` if `go_on` returns false.
pub(super) fn evaluate_inverse_on_cast(
    mould: &DesignWithSolver,
    known: &Result<Samples, Trouble>,
    cast: u32,
    sets: &Result<[Samples; 2], Trouble>,
    counters: &mut Counters,
    go_on: &mut GoOn,
) -> Option<(Vec<CastEvaluation>, Vec<BandCoverage>)> {
    let &DesignWithSolver { trial, design, solver } = mould;
    let (mut readings, mut bands, mut work) = (Vec::new(), Vec::new(), Counters::default());
    let mut record_errors = |by: CastDecoder, found: Result<InverseErrors, Trouble>| {
        let found = found.map(|(errors, regularisation, band)| {
            bands.extend(band);
            (errors, regularisation)
        });
        readings.push(CastEvaluation::new(cast, by, found));
    };
    let sets = as_ref_result(sets);
    let some = sets
        .map(|[_, holdout]| holdout.select(&(0..INVERTED_PER_CAST.min(holdout.count())).collect::<Vec<_>>()));
    let evaluate_inverter = |by, brain: Result<Inverse, Trouble>, work: &mut Counters, go_on: &mut GoOn| {
        let (mut brain, holdout) = match (brain, &some) {
            (Ok(brain), Ok(some)) => (brain, some),
            (Err(trouble), _) => return Some(Err(trouble)),
            (_, Err(trouble)) => return Some(Err(*trouble)),
        };
        let found = brain.read_while(&holdout.signals, go_on)?;
        work.dynamics += brain.counters.dynamics;
        let band = band(&found, holdout, Some((cast, by)));
        Some(Ok((holdout.errors(&forces(&found)), Regularisation::default(), Some(band))))
    };
    let brain = as_ref_result(known).and_then(|known| Inverse::new(trial, design, solver, None, known));
    record_errors(CastDecoder::Inverse, evaluate_inverter(CastDecoder::Inverse, brain, &mut work, go_on)?);
    // twins need records of the cast
    let most = if trial.problem.evaluation.records { trial.train.samples } else { 0 };
    for n in RECORDS.into_iter().filter(|&n| n as usize <= most) {
        let twin = match sets {
            Ok([train, _]) => {
                // failed samples carry no information
                let first: Vec<usize> = (0..n as usize).filter(|&i| !train.failed[i]).collect();
                // the initial body may have failed under forces that the cast survived
                let [all, _] = trial.problem.training_and_test();
                let (forces, records) = (all.select(&first), train.select(&first));
                let Fit { twin, counters, .. } = Fit::of(mould, (&forces, &records.signals), go_on)?;
                work.dynamics += counters;
                mould.samples(Some(&twin.cast), all, &mut work).map(|known| (known, twin))
            }
            Err(trouble) => Err(trouble),
        };
        let twin = as_ref_result(&twin);
        let linear = twin.and_then(|(known, _)| {
            let [_, holdout] = sets?;
            let fitted = Fitted::of(trial, known)?;
            let regularisation = Regularisation { ridge: Some(fitted.ridge), kappa: None };
            Ok((fitted.errors_on(holdout), regularisation, None))
        });
        record_errors(CastDecoder::TwinLinear(n), linear);
        let by = CastDecoder::Twin(n);
        let brain = twin.and_then(|(known, twin)| Inverse::new(trial, design, solver, Some(twin), known));
        record_errors(by, evaluate_inverter(by, brain, &mut work, go_on)?);
    }
    counters.dynamics += work.dynamics;
    Some((readings, bands))
}

/// Forces (N, T, K) in N.
fn forces(found: &[Estimate]) -> Vec<f64> {
    found.iter().flat_map(|estimate| &estimate.forces).copied().collect()
}

/// The posterior band around each instant, its coverage, and the number of samples that the model explains.
fn band(found: &[Estimate], samples: &Samples, cast: Option<(u32, CastDecoder)>) -> BandCoverage {
    let half: Vec<f64> = found.iter().flat_map(|estimate| &estimate.deviations).map(|d| Z_95 * d).collect();
    let is_covered = |((f, half), said): &((&f64, &f64), f64)| (*f - said).abs() <= **half;
    let all = samples.targets.iter().zip(&half).zip(forces(found));
    let inside = all.filter(is_covered).count();
    let explained = found.iter().filter(|estimate| estimate.is_explained()).count();
    let band = Band { kind: BandKind::Posterior, samples: explained, half_width: Vec::new() };
    let part = |sum: f64| (!half.is_empty()).then(|| sum / half.len() as f64);
    let width = part(2.0 * half.iter().sum::<f64>());
    BandCoverage { cast, band, width, coverage: part(inside as f64) }
}
