//! Conversions between the numerical types and the stored records, so that the former can change without the latter.

use metasense_numerics::brain::Adam;
use metasense_numerics::brain::linear::Lags;
use metasense_numerics::brains::{self, Band, BandKind, DecoderState, NetworkTraining};
use metasense_numerics::dynamics;
use metasense_numerics::nested::{self, Best, CastDecoder, PastDesign, State};
use metasense_numerics::trial::{self, Problem};
use metasense_schemas::record::{
    self, BodyRecord, CastRecord, Checkpoint, ComparisonProgress, ImplicitRecord, Moments, NetworkInTraining,
    NetworkRecord, PlacedRecord, ReadingRecord, SpreadRecord, StepRecord, StepSeconds, TaskReading,
    UnderRecord, WorkCounts,
};
use metasense_schemas::spec::TrialSpec;

/// `None` for NaN and ±∞.
pub fn finite(value: Option<f64>) -> Option<f64> {
    value.filter(|x| x.is_finite())
}

/// Record of a step.
pub fn step_record(report: &nested::Report) -> StepRecord {
    StepRecord {
        step: report.step,
        loss_test: finite(report.loss_test),
        loss_train: finite(report.loss_train),
        error_test: finite(report.error_test),
        error_train: finite(report.error_train),
        ridge: finite(report.ridge),
        gradient_norm: finite(report.gradient_norm),
        step_length: finite(report.step_length),
        projection: report.projection.map_or("none", |status| status.name()).into(),
        projection_distance: finite(report.projection_distance),
        implicit: report.implicit.map(|implicit| ImplicitRecord {
            iterations: implicit.iterations as u32,
            residual: implicit.residual,
            // Infinite if no product was computed; SQLite and JSON cannot store infinity.
            smallest_curvature: finite(Some(implicit.smallest_curvature)).unwrap_or(0.0),
            outcome: implicit.outcome.name().into(),
        }),
        outcome: report.trouble.map_or("ok", |trouble| trouble.name()).into(),
        fresh_samples: report.fresh_samples,
        counters: counters(&report.counters),
        seconds: seconds(&report.seconds),
    }
}

/// Counts of computations.
pub fn counters(counters: &trial::Counters) -> WorkCounts {
    WorkCounts {
        force_evaluations: counters.dynamics.force_evaluations,
        steps: counters.dynamics.steps,
        rejected: counters.dynamics.rejected,
        brain_iterations: counters.brain_iterations,
        hessian_products: counters.hessian_products,
        projection_iterations: counters.projection_iterations,
    }
}

fn seconds(seconds: &nested::Seconds) -> StepSeconds {
    let &nested::Seconds { simulate, train, differentiate, implicit, project } = seconds;
    StepSeconds { simulate, train, differentiate, implicit, project, store: 0.0 }
}

fn spread(spread: trial::Spread) -> SpreadRecord {
    let trial::Spread { median, p90, above } = spread;
    SpreadRecord { median: finite(Some(median)), p90: finite(Some(p90)), above }
}

/// The inverse of [`spread`].
fn spread_of(spread: SpreadRecord) -> trial::Spread {
    let known = |value: Option<f64>| value.unwrap_or(f64::INFINITY);
    trial::Spread { median: known(spread.median), p90: known(spread.p90), above: spread.above }
}

/// Stored form of a body's evaluation.
pub fn body_evaluation(body: nested::BodyEvaluation) -> BodyRecord {
    let network = |network: nested::NetworkEvaluation| NetworkRecord {
        error_train: finite(network.error_train),
        error_test: finite(network.error_test),
        error_holdout: finite(network.error_holdout),
        losses: network.losses,
        errors: network.errors,
        weights: network.weights,
        outcome: network.trouble.map_or("ok", |trouble| trouble.name()).into(),
        spread: network.spread.map(spread),
    };
    BodyRecord {
        design: body.design,
        networks: body.networks.into_iter().map(network).collect(),
        long: body.long.into_iter().map(network).collect(),
        readings: body.readings.iter().map(reading).collect(),
        zero_samples: body.zero_samples,
    }
}

/// Result of a sensor search.
pub fn placed(placed: metasense_numerics::place::Placed) -> PlacedRecord {
    let (runner_up, runner_up_error) = placed.runner_up.unzip();
    PlacedRecord {
        units: placed.units,
        errors: placed.errors,
        runner_up: runner_up.unwrap_or_default(),
        runner_up_error,
        ridge: placed.ridge,
        energies: placed.energies,
    }
}

fn reading(reading: &brains::Reading) -> ReadingRecord {
    ReadingRecord {
        before: reading.lags.before as u32,
        after: reading.lags.after as u32,
        ridge: reading.ridge,
        error_train: finite(reading.error_train),
        error_test: finite(reading.error_test),
        error_holdout: finite(reading.error_holdout),
        spread: reading.spread.map(spread),
    }
}

/// Checkpoint from which a run resumes.
pub fn checkpoint(state: &State) -> Checkpoint {
    let State { step, rate_factor: caution, consecutive_undone: setbacks, trend, .. } = *state;
    let DecoderState { weights, adam, ridge } = &state.decoder_state;
    let best =
        |best: &Best| record::BestDesign { design: best.design.clone(), error: best.error, step: best.step };
    let waypoint = |w: &PastDesign| record::Waypoint { step: w.step, design: w.design.clone() };
    Checkpoint {
        step,
        design: state.design.clone(),
        design_moments: moments(&state.design_adam),
        weights: weights.clone(),
        weight_moments: moments(adam),
        best: state.best.as_ref().map(best),
        caution,
        setbacks,
        trend,
        ridge: *ridge,
        trail: state.recent_designs.iter().map(waypoint).collect(),
        comparison: Some(&state.comparison).filter(|c| !c.bodies.is_empty()).map(comparison).map(Box::new),
        moves: Vec::new(),
        found: state.fitness.clone(),
        casts: state.comparison.casts.iter().map(|casts| cast_readings(casts)).collect(),
        bands: state.comparison.bands.iter().map(|bands| self::bands(bands)).collect(),
    }
}

/// The decoder of a cast with this name and number of records.
fn brain_of_cast(reader: &str, records: u32) -> Result<CastDecoder, String> {
    CastDecoder::named(reader, records).ok_or_else(|| format!("unknown decoder of a cast: {reader:?}"))
}

/// Prediction bands of a body and its casts.
pub fn bands(bands: &[nested::BandCoverage]) -> Vec<record::BandRecord> {
    let band = |nested::BandCoverage { cast, band, width, coverage }: &nested::BandCoverage| {
        let (reader, records) = cast.map_or(("own", 0), |(_, by)| (by.name(), by.records().unwrap_or(0)));
        record::BandRecord {
            reader: reader.into(),
            records,
            cast: cast.map(|(cast, _)| cast),
            method: if band.kind == BandKind::Posterior { "posterior" } else { "conformal" }.into(),
            kind: match band.kind {
                BandKind::Instant | BandKind::Posterior => "instant",
                BandKind::Sample => "sample",
            }
            .into(),
            level: brains::LEVEL,
            samples: band.samples as u32,
            coverage: finite(*coverage),
            width: finite(*width),
            half_width: band.half_width.clone(),
            outcome: if width.is_some() { "ok" } else { "too_few" }.into(),
        }
    };
    bands.iter().map(band).collect()
}

/// The inverse of [`bands`].
fn banded(bands: &[record::BandRecord]) -> Result<Vec<nested::BandCoverage>, String> {
    let reading = |band: &record::BandRecord| {
        let cast = band
            .cast
            .map(|cast| Ok::<_, String>((cast, brain_of_cast(&band.reader, band.records)?)))
            .transpose()?;
        let kind = match (&*band.method, &*band.kind) {
            ("posterior", _) => BandKind::Posterior,
            (_, "instant") => BandKind::Instant,
            (_, "sample") => BandKind::Sample,
            (_, name) => return Err(format!("unknown kind of band: {name:?}")),
        };
        let (samples, half_width) = (band.samples as usize, band.half_width.clone());
        let (width, coverage) = (band.width, band.coverage);
        Ok(nested::BandCoverage { cast, band: Band { kind, samples, half_width }, width, coverage })
    };
    bands.iter().map(reading).collect()
}

/// Errors on the casts of a body.
pub fn cast_readings(casts: &[nested::CastEvaluation]) -> Vec<CastRecord> {
    let reading = |reading: &nested::CastEvaluation| CastRecord {
        cast: reading.cast,
        reader: reading.decoder.name().into(),
        records: reading.decoder.records().unwrap_or(0),
        error: finite(reading.error),
        outcome: reading.trouble.map_or("ok", |trouble| trouble.name()).into(),
        spread: reading.spread.map(spread),
        ridge: reading.regularisation.ridge,
        share: reading.regularisation.kappa,
    };
    casts.iter().map(reading).collect()
}

/// Errors of both bodies under the further kinds of forces of the trial.
pub fn under_readings(trial: &TrialSpec, under: &[Vec<nested::UnderReading>; 2]) -> Vec<UnderRecord> {
    let kinds: Vec<_> = trial.evaluation.under.iter().flatten().map(|part| part.kind.name()).collect();
    let bodies = ["initial", "optimised"].into_iter().zip(under);
    let all = bodies.flat_map(|(body, readings)| readings.iter().map(move |reading| (body, reading)));
    all.map(|(body, reading)| UnderRecord {
        body: body.into(),
        stimuli: kinds[reading.kind].into(),
        reader: if reading.own { "own" } else { "carried" }.into(),
        error: reading.error.map_or(Some(trial::FAILED), finite),
        outcome: reading.error.map_or_else(|trouble| trouble.name(), |_| "ok").into(),
        spread: reading.spread.map(spread),
    })
    .collect()
}

/// Errors of readouts of all tasks on the initial (0) or trained (1) body.
pub fn task_readings(body: usize, found: &[brains::TaskEstimate]) -> Vec<TaskReading> {
    let reading = |estimate: &brains::TaskEstimate| TaskReading {
        body: ["initial", "optimised"][body].into(),
        task: estimate.task.0.into(),
        readout: estimate.readout.into(),
        unit: estimate.task.1.into(),
        error: finite(Some(estimate.error)),
        interval: estimate.interval.map(|end| finite(Some(end))),
        least: estimate.least,
        trivial: finite(Some(estimate.trivial)),
        samples: estimate.samples as u32,
        score: finite(Some(estimate.score)),
        detail: estimate.detail.clone(),
        casts: estimate.casts,
        log_loss: estimate.calibration.as_ref().map(|of| of.log_loss),
        calibration_error: estimate.calibration.as_ref().map(|of| of.error),
        reliability: estimate.calibration.as_ref().map_or_else(Vec::new, |of| of.bins.clone()),
    };
    found.iter().map(reading).collect()
}

/// The inverse of [`cast_readings`].
fn casts_read(casts: &[CastRecord]) -> Result<Vec<nested::CastEvaluation>, String> {
    let reading = |reading: &CastRecord| {
        let by = brain_of_cast(&reading.reader, reading.records)?;
        let trouble = trouble(&reading.outcome)?;
        let &CastRecord { cast, error, spread, ridge, share, .. } = reading;
        let (spread, regularisation) =
            (spread.map(spread_of), nested::Regularisation { ridge, kappa: share });
        Ok(nested::CastEvaluation { cast, decoder: by, error, spread, regularisation, trouble })
    };
    casts.iter().map(reading).collect()
}

/// Failure by its name in `outcome`.
fn trouble(outcome: &str) -> Result<Option<trial::Trouble>, String> {
    match outcome {
        "ok" => Ok(None),
        name => trial::Trouble::named(name)
            .map(Some)
            .ok_or_else(|| format!("unknown outcome of a decoder: {name:?}")),
    }
}

fn moments<T: Clone>(adam: &Adam<T>) -> Moments<T> {
    Moments { first: adam.m.clone(), second: adam.v.clone(), steps: adam.t }
}

fn adam<T>(moments: Moments<T>) -> Adam<T> {
    Adam { m: moments.first, v: moments.second, t: moments.steps }
}

fn comparison(comparison: &nested::Comparison) -> ComparisonProgress {
    let training = |fresh: &NetworkTraining| NetworkInTraining {
        weights: fresh.weights.clone(),
        moments: moments(&fresh.adam),
        losses: fresh.losses.clone(),
        errors: fresh.errors.clone(),
    };
    ComparisonProgress {
        bodies: comparison.bodies.iter().cloned().map(body_evaluation).collect(),
        training: comparison.training.as_ref().map(training),
        counters: counters(&comparison.counters),
        seconds: seconds(&comparison.seconds),
    }
}

/// The inverse of [`checkpoint`].
///
/// # Errors
/// If the checkpoint does not match the trial.
pub fn state(checkpoint: Checkpoint, problem: &Problem) -> Result<State, String> {
    let parameters = problem.initial.len();
    let Checkpoint { step, design, design_moments, weights, weight_moments, best, trail, .. } = checkpoint;
    let Checkpoint { caution, setbacks, trend, ridge, comparison, found, casts, bands, .. } = checkpoint;
    let lengths = [design.len(), design_moments.first.len(), design_moments.second.len()];
    if lengths != [parameters; 3] || trail.iter().any(|waypoint| waypoint.design.len() != parameters) {
        return Err(format!("the checkpoint has {lengths:?} design parameters, the trial has {parameters}"));
    }
    if caution.is_nan() || caution <= 0.0 {
        return Err(format!("the checkpoint has the step factor {caution}; must be above 0"));
    }
    let waypoint = |w: record::Waypoint| PastDesign { step: w.step, design: w.design };
    let casts = casts.iter().map(|casts| casts_read(casts)).collect::<Result<_, _>>()?;
    let bands = bands.iter().map(|bands| banded(bands)).collect::<Result<_, _>>()?;
    let comparison = comparison.map(|c| comparison_from(*c, problem)).transpose()?.unwrap_or_default();
    Ok(State {
        step,
        design,
        design_adam: adam(design_moments),
        decoder_state: DecoderState { weights, adam: adam(weight_moments), ridge },
        best: best.map(|best| Best { design: best.design, error: best.error, step: best.step }),
        rate_factor: caution,
        consecutive_undone: setbacks,
        trend,
        recent_designs: trail.into_iter().map(waypoint).collect(),
        comparison: nested::Comparison { casts, bands, ..comparison },
        fitness: found,
    })
}

/// The inverse of [`comparison`].
fn comparison_from(comparison: ComparisonProgress, problem: &Problem) -> Result<nested::Comparison, String> {
    let ComparisonProgress { bodies, training, counters, seconds } = comparison;
    let (parameters, weights) = (problem.initial.len(), problem.reader_shape().weights());
    let of_design = |body: &BodyRecord| body.design.len() == parameters;
    let of_network = |t: &NetworkInTraining| {
        [&t.weights, &t.moments.first, &t.moments.second].iter().all(|w| w.len() == weights)
    };
    if bodies.len() > 2 || !bodies.iter().all(of_design) || !training.iter().all(of_network) {
        return Err(format!(
            "the checkpoint's comparison does not have {parameters} design parameters and {weights} weights"
        ));
    }
    let fresh = |training: NetworkInTraining| {
        let NetworkInTraining { weights, moments, losses, errors } = training;
        NetworkTraining { weights, adam: adam(moments), losses, errors }
    };
    let StepSeconds { simulate, train, differentiate, implicit, project, .. } = seconds;
    Ok(nested::Comparison {
        bodies: bodies.into_iter().map(evaluation_from).collect::<Result<_, _>>()?,
        casts: Vec::new(),
        bands: Vec::new(),
        tasks: Vec::new(),
        training: training.map(fresh),
        counters: trial::Counters {
            dynamics: dynamics::SimulationCounts {
                force_evaluations: counters.force_evaluations,
                steps: counters.steps,
                rejected: counters.rejected,
            },
            brain_iterations: counters.brain_iterations,
            hessian_products: counters.hessian_products,
            projection_iterations: counters.projection_iterations,
        },
        seconds: nested::Seconds { simulate, train, differentiate, implicit, project },
    })
}

/// The inverse of [`body_evaluation`].
fn evaluation_from(body: BodyRecord) -> Result<nested::BodyEvaluation, String> {
    let network = |network: NetworkRecord| {
        let trouble = trouble(&network.outcome)?;
        let NetworkRecord { error_train, error_test, error_holdout, spread, .. } = network;
        let NetworkRecord { losses, errors, weights, .. } = network;
        let network = nested::NetworkEvaluation {
            error_train,
            error_test,
            error_holdout,
            spread: spread.map(spread_of),
            losses,
            errors,
            weights,
            trouble,
        };
        Ok(network)
    };
    let reading = |reading: ReadingRecord| {
        let ReadingRecord { before, after, ridge, error_train, error_test, error_holdout, spread } = reading;
        let lags = Lags { before: before as usize, after: after as usize };
        let spread = spread.map(spread_of);
        brains::Reading { lags, ridge, error_train, error_test, error_holdout, spread }
    };
    Ok(nested::BodyEvaluation {
        design: body.design,
        networks: body.networks.into_iter().map(network).collect::<Result<_, String>>()?,
        long: body.long.into_iter().map(network).collect::<Result<_, String>>()?,
        readings: body.readings.into_iter().map(reading).collect(),
        zero_samples: body.zero_samples,
    })
}

#[cfg(test)]
mod tests;
