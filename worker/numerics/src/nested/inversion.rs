//! How an inverse brain reads a body, as designed and cast: by the model of the design, and by twins calibrated on a few records.

use super::casts::{CastBrain, CastReading};
use super::comparison::paused;
use super::evaluation::{BandReading, NetworkEvaluation};
use super::observe::Log;
use super::state::State;
use crate::brains::{Band, BandKind, Estimate, Fitted, Inverse, TO_EACH_SIDE};
use crate::dynamics::{Precision, Solver};
use crate::identify::twin::{Fit, Twin};
use crate::trial::{Counters, FAILED, Samples, Trial, Trouble};

/// Records of a cast that twins are calibrated on.
const RECORDS: [u32; 2] = [10, 30];
/// Samples of the holdout that are read of each cast: each takes as long as some hundred simulations.
const OF_A_CAST: usize = 16;

/// Reads the last body's test samples and holdout; `None` if the observer said stop.
pub(super) fn invert(
    trial: &Trial,
    design: &[f64],
    solver: &Solver,
    sets: Result<[Samples; 3], Trouble>,
    state: &mut State,
    log: &mut Log,
) -> Option<()> {
    let read = |counters: &mut Counters| {
        let [known, test, holdout] = sets?;
        let mut brain = Inverse::new(trial, design, solver, None, &known)?;
        let error_test = test.error(&forces(&brain.read(&test.signals)));
        let found = brain.read(&holdout.signals);
        counters.dynamics += brain.counters.dynamics;
        let error_holdout = holdout.error(&forces(&found));
        let evaluation = NetworkEvaluation { error_test, error_holdout, ..NetworkEvaluation::default() };
        Ok((evaluation, band(&found, &holdout, None)))
    };
    let found = log.timed(|s| &mut s.train, |report| read(&mut report.counters));
    let comparison = &mut state.comparison;
    let turn = comparison.bodies.len() - 1;
    comparison.bands.resize_with(turn + 1, Vec::new);
    let evaluation = match found {
        Ok((evaluation, band)) => {
            comparison.bands[turn] = vec![band];
            evaluation
        }
        Err(trouble) => NetworkEvaluation::nothing(trouble),
    };
    comparison.bodies[turn].networks.push(evaluation);
    paused(trial, state, log)
}

/// How a cast of these training and holdout samples is read by the model of the design, of which `known` are training samples,
/// and by twins, each also by a linear brain that was fitted to the twin.
pub(super) fn invert_cast(
    trial: &Trial,
    (design, solver): (&[f64], &Solver),
    known: &Result<Samples, Trouble>,
    cast: u32,
    sets: &Result<[Samples; 2], Trouble>,
    counters: &mut Counters,
) -> (Vec<CastReading>, Vec<BandReading>) {
    let (mut readings, mut bands) = (Vec::new(), Vec::new());
    let mut keep = |by: CastBrain, found: Result<(Option<f64>, Option<BandReading>), Trouble>| {
        let (error, trouble) = match found {
            Ok((error, band)) => {
                bands.extend(band);
                (error, None)
            }
            Err(trouble) => (Some(FAILED), Some(trouble)),
        };
        readings.push(CastReading { cast, by, error, trouble });
    };
    let some = |holdout: &Samples| holdout.select(&(0..OF_A_CAST.min(holdout.count())).collect::<Vec<_>>());
    let mut inverted = |by, twin: Option<&Twin>, known: Result<&Samples, Trouble>| {
        let (known, [_, holdout]) = (known?, sets.as_ref().map_err(|trouble| *trouble)?);
        let holdout = some(holdout);
        let mut brain = Inverse::new(trial, design, solver, twin, known)?;
        let found = brain.read(&holdout.signals);
        counters.dynamics += brain.counters.dynamics;
        Ok((holdout.error(&forces(&found)), Some(band(&found, &holdout, Some((cast, by))))))
    };
    keep(CastBrain::Inverse, inverted(CastBrain::Inverse, None, known.as_ref().map_err(|trouble| *trouble)));
    for n in RECORDS.into_iter().filter(|&n| n as usize <= trial.train.samples) {
        let mut counted = Counters::default();
        let twin = sets.as_ref().map_err(|trouble| *trouble).and_then(|[train, _]| {
            // what failed tells nothing
            let first: Vec<usize> = (0..n as usize).filter(|&i| !train.failed[i]).collect();
            let records = train.select(&first);
            let Fit { twin, .. } =
                Fit::of(trial, design, solver, &trial.train.select(&first), &records.signals);
            let (cast, [forces, _]) = (Some(&twin.cast), trial.problem.known());
            let double = Precision::Double;
            let known = trial.simulate_cast(cast, design, forces, solver, double, false, &mut counted)?;
            Ok((known.samples, twin))
        });
        let linear = twin.as_ref().map_err(|trouble| *trouble).and_then(|(known, _)| {
            let [_, holdout] = sets.as_ref().map_err(|trouble| *trouble)?;
            Ok((Fitted::of(trial, known)?.error_on(&some(holdout)), None))
        });
        keep(CastBrain::TwinLinear(n), linear);
        let by = CastBrain::Twin(n);
        let twin = twin.as_ref().map_err(|trouble| *trouble);
        let found = twin.and_then(|(known, twin)| inverted(by, Some(twin), Ok(known)));
        keep(by, found);
    }
    (readings, bands)
}

/// (N, T, K) (N).
fn forces(found: &[Estimate]) -> Vec<f64> {
    found.iter().flat_map(|estimate| &estimate.forces).copied().collect()
}

/// The posterior's own band about each instant, how much of what was read lies in it, and how many samples the model explains.
fn band(found: &[Estimate], samples: &Samples, cast: Option<(u32, CastBrain)>) -> BandReading {
    let half: Vec<f64> =
        found.iter().flat_map(|estimate| &estimate.deviations).map(|d| TO_EACH_SIDE * d).collect();
    let within = |((f, half), said): &((&f64, &f64), f64)| (*f - said).abs() <= **half;
    let all = samples.targets.iter().zip(&half).zip(forces(found));
    let inside = all.filter(within).count();
    let explained = found.iter().filter(|estimate| estimate.is_explained()).count();
    let band = Band { kind: BandKind::Posterior, samples: explained, half_width: Vec::new() };
    let part = |sum: f64| (!half.is_empty()).then(|| sum / half.len() as f64);
    let width = part(2.0 * half.iter().sum::<f64>());
    BandReading { cast, band, width, coverage: part(inside as f64) }
}
