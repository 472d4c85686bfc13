//! The maths' reports and states as what is stored, and back. Stored types age slowly, maths types are free to change.

use metasense_numerics::brain::Adam;
use metasense_numerics::nested::{self, Best, State, Waypoint};
use metasense_schemas::record::{
    BodyEvaluation, Checkpoint, Counters, ImplicitRecord, NetworkEvaluation, Placed, Reading, Seconds,
    StepRecord,
};

/// Not a number becomes absent.
pub(crate) fn finite(value: Option<f64>) -> Option<f64> {
    value.filter(|x| x.is_finite())
}

/// A step's report.
pub fn step_record(report: &nested::Report) -> StepRecord {
    StepRecord {
        step: report.step,
        loss_test: finite(report.loss_test),
        loss_train: finite(report.loss_train),
        error_test: finite(report.error_test),
        error_train: finite(report.error_train),
        gradient_norm: finite(report.gradient_norm),
        step_length: finite(report.step_length),
        projection: report.projection.map_or("none", |status| status.name()).into(),
        projection_distance: finite(report.projection_distance),
        implicit: report.implicit.map(|implicit| ImplicitRecord {
            policy: implicit.policy.name().into(),
            iterations: implicit.iterations as u32,
            residual: implicit.residual,
            // infinite where no product was taken, which SQLite and JSON do not know
            smallest_curvature: finite(Some(implicit.smallest_curvature)).unwrap_or(0.0),
            outcome: implicit.outcome.name().into(),
        }),
        outcome: report.trouble.map_or("ok", |trouble| trouble.name()).into(),
        fresh_samples: report.fresh_samples,
        counters: counters(&report.counters),
        seconds: seconds(&report.seconds),
    }
}

/// Counts of work.
pub fn counters(counters: &nested::Counters) -> Counters {
    Counters {
        force_evaluations: counters.dynamics.force_evaluations,
        steps: counters.dynamics.steps,
        rejected: counters.dynamics.rejected,
        brain_iterations: counters.brain_iterations,
        hessian_products: counters.hessian_products,
        projection_iterations: counters.projection_iterations,
    }
}

fn seconds(seconds: &nested::Seconds) -> Seconds {
    let &nested::Seconds { simulate, train, differentiate, implicit, project } = seconds;
    Seconds { simulate, train, differentiate, implicit, project, store: 0.0 }
}

/// A body with its fresh networks.
pub fn body_evaluation(body: nested::BodyEvaluation) -> BodyEvaluation {
    let network = |network: nested::NetworkEvaluation| NetworkEvaluation {
        error_train: finite(network.error_train),
        error_test: finite(network.error_test),
        error_holdout: finite(network.error_holdout),
        losses: network.losses,
        errors: network.errors,
        weights: network.weights,
        outcome: network.trouble.map_or("ok", |trouble| trouble.name()).into(),
    };
    BodyEvaluation {
        design: body.design,
        networks: body.networks.into_iter().map(network).collect(),
        long: body.long.into_iter().map(network).collect(),
        readings: body.readings.iter().map(reading).collect(),
        zero_samples: body.zero_samples,
    }
}

/// What a search for sensors found.
pub fn placed(placed: metasense_numerics::place::Placed) -> Placed {
    let (runner_up, runner_up_error) = placed.runner_up.unzip();
    Placed {
        units: placed.units,
        errors: placed.errors,
        runner_up: runner_up.unwrap_or_default(),
        runner_up_error,
        ridge: placed.ridge,
    }
}

fn reading(reading: &nested::Reading) -> Reading {
    Reading {
        before: reading.lags.before as u32,
        after: reading.lags.after as u32,
        ridge: reading.ridge,
        error_train: finite(reading.error_train),
        error_test: finite(reading.error_test),
        error_holdout: finite(reading.error_holdout),
    }
}

/// What is needed to go on. `protocol` holds caution, setbacks, trend (0: none), the ridge where there is one, then
/// (step, α) of each waypoint.
pub fn checkpoint(state: &State) -> Checkpoint {
    let mut protocol = vec![state.caution, f64::from(state.setbacks), state.trend.unwrap_or(0.0)];
    protocol.extend(state.ridge);
    for waypoint in &state.trail {
        protocol.push(f64::from(waypoint.step));
        protocol.extend_from_slice(&waypoint.design);
    }
    Checkpoint {
        step: state.step,
        design: state.design.clone(),
        design_moments: (state.design_adam.m.clone(), state.design_adam.v.clone(), state.design_adam.t),
        weights: state.weights.clone(),
        weight_moments: (state.weight_adam.m.clone(), state.weight_adam.v.clone(), state.weight_adam.t),
        best: state.best.as_ref().map(|best| (best.design.clone(), best.error, best.step)),
        protocol,
    }
}

/// The inverse of [`checkpoint`].
///
/// # Errors
/// If the checkpoint is not of a trial with `parameters` design parameters.
pub fn state(checkpoint: Checkpoint, parameters: usize) -> Result<State, String> {
    let Checkpoint { step, design, design_moments, weights, weight_moments, best, protocol } = checkpoint;
    let lengths = [design.len(), design_moments.0.len(), design_moments.1.len()];
    // one number beside whole waypoints is the ridge
    let ridge = protocol.get(3).copied().filter(|_| (protocol.len() - 3) % (1 + parameters) == 1);
    let first = if ridge.is_some() { 4 } else { 3 };
    let waypoints = protocol.get(first..).unwrap_or_default().chunks(1 + parameters);
    if lengths != [parameters; 3]
        || protocol.len() < 3
        || waypoints.clone().any(|w| w.len() != 1 + parameters)
    {
        return Err(format!(
            "a checkpoint of {lengths:?} design parameters where the trial has {parameters}"
        ));
    }
    let adam = |(m, v, t)| Adam { m, v, t };
    Ok(State {
        step,
        design,
        design_adam: adam(design_moments),
        weights,
        weight_adam: Adam { m: weight_moments.0, v: weight_moments.1, t: weight_moments.2 },
        best: best.map(|(design, error, step)| Best { design, error, step }),
        caution: protocol[0],
        setbacks: protocol[1] as u32,
        trend: (protocol[2] > 0.0).then_some(protocol[2]),
        ridge,
        trail: waypoints.map(|w| Waypoint { step: w[0] as u32, design: w[1..].to_vec() }).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A state that has all its parts goes through its stored form unchanged; one of another trial is refused.
    #[test]
    fn a_state_survives_its_checkpoint() {
        let full = State {
            step: 7,
            design: vec![0.1, -0.2],
            design_adam: Adam { m: vec![1.0, 2.0], v: vec![3.0, 4.0], t: 7 },
            weights: vec![0.5; 3],
            weight_adam: Adam { m: vec![0.1; 3], v: vec![0.2; 3], t: 70 },
            best: Some(Best { design: vec![0.3, 0.4], error: 12.5, step: 5 }),
            caution: 0.5,
            setbacks: 2,
            trend: Some(0.01),
            ridge: None,
            trail: vec![
                Waypoint { step: 5, design: vec![0.3, 0.4] },
                Waypoint { step: 6, design: vec![0.5, 0.6] },
            ],
        };
        let bare = State { best: None, trend: None, trail: Vec::new(), weights: Vec::new(), ..full.clone() };
        let linear = State { ridge: Some(1e-4), weights: Vec::new(), ..full.clone() };
        for original in [full, bare, linear] {
            let bytes = postcard::to_allocvec(&checkpoint(&original)).unwrap();
            let read: Checkpoint = postcard::from_bytes(&bytes).unwrap();
            assert!(state(read.clone(), 3).is_err());
            assert_eq!(state(read, 2).unwrap(), original);
        }
    }
}
