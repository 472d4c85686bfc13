//! Settings of the outer loop from its spec: the protocol, and which shifts move.

use metasense_numerics::body::{Freedom, Layout};
use metasense_numerics::feasible::{FeasibleSet, Limits};
use metasense_numerics::trial::{StepTraining, Terms, TrainingProtocol};
use metasense_schemas::spec::{self, TrialSpec};

use super::{ITERATIONS_MAX, SAMPLES_MAX, check_units};
use crate::invalid::{Invalid, absent, as_written, positive, require, within};

/// The training protocol.
pub(super) fn protocol(optimise: &spec::Optimise) -> Result<TrainingProtocol, Invalid> {
    let &spec::Optimise { protocol, gradient, batch, brain_iterations, brain_learning_rate, coarse, .. } =
        optimise;
    // keys without effect are rejected: otherwise identical trials would get different hashes
    let only_on = |readers: &str| format!("has no effect on this optimise.protocol, only on {readers}");
    if protocol == spec::Protocol::Paper {
        let remedy = only_on("joint and random");
        absent("optimise.brain_iterations", brain_iterations, &remedy)?;
        absent("optimise.brain_learning_rate", brain_learning_rate, &remedy)?;
    } else {
        absent("optimise.gradient", gradient.map(|terms| as_written(&terms)), &only_on("paper"))?;
    }
    if protocol != spec::Protocol::Joint {
        absent("optimise.batch", batch, &only_on("joint"))?;
        absent("optimise.coarse", coarse.map(|solver| as_written(&solver)), &only_on("joint"))?;
    }
    let resolved = optimise.clone().resolved();
    // placeholders for keys that the protocol does not use
    let going = StepTraining {
        batch: resolved.batch.unwrap_or(1),
        brain_iterations: resolved.brain_iterations.unwrap_or(1),
        brain_rate: resolved.brain_learning_rate.unwrap_or(1.0),
    };
    // cross-validation fits a linear decoder to a part of them
    let least = if optimise.linear() && protocol == spec::Protocol::Joint { 2 } else { 1 };
    within("optimise.batch", going.batch, least, SAMPLES_MAX)?;
    within("optimise.brain_iterations", going.brain_iterations, 1, ITERATIONS_MAX)?;
    positive("optimise.brain_learning_rate", going.brain_rate)?;
    Ok(match protocol {
        spec::Protocol::Paper => TrainingProtocol::Paper(match gradient {
            None | Some(spec::GradientTerms::Implicit) => Terms::Implicit,
            Some(spec::GradientTerms::Direct) => Terms::Direct,
        }),
        spec::Protocol::Joint => TrainingProtocol::Joint(going),
        spec::Protocol::Random => TrainingProtocol::Random(going),
    })
}

/// Size in cells of the blocks whose shifts are tied.
pub(super) fn tie(optimise: &spec::Optimise) -> Result<[usize; 2], Invalid> {
    let tie = optimise.tie.unwrap_or([1, 1]);
    let sound = tie.iter().all(|n| (1..=1000).contains(n));
    require(sound, "optimise.tie", format!("{tie:?}"), "must be two numbers from 1 to 1000")?;
    Ok(tie)
}

/// Units whose design does not change.
pub(super) fn frozen(optimise: &spec::Optimise, layout: &Layout) -> Result<Vec<usize>, Invalid> {
    check_units("optimise.frozen", optimise.frozen.as_deref().unwrap_or_default(), layout, &[])
}

/// Number of values that the outer loop moves: the length of α, or of z with tied or frozen shifts, as in `Problem::freedom`.
///
/// # Errors
/// If `optimise.tie` or `optimise.frozen` is invalid, or nothing can move.
pub fn design_parameters(trial: &TrialSpec, layout: &Layout) -> Result<usize, Invalid> {
    if let (Some(_), Some(spec::Design::Shifts { shifts })) = (&trial.body.description, &trial.body.design) {
        return Ok(shifts.len());
    }
    let (tie, frozen) = (tie(&trial.optimise)?, frozen(&trial.optimise, layout)?);
    let parameters = Freedom::new(layout, tie, &frozen).parameters();
    let remedy = "must leave the shape of at least one unit free";
    require(parameters > 0, "optimise.frozen", format!("{frozen:?}"), remedy)?;
    Ok(parameters)
}

/// The feasible designs, as in `Problem::castable`. Tied shifts stay tied; frozen units do not change.
///
/// # Errors
/// If `optimise.tie` or `optimise.frozen` is invalid.
pub fn castable(optimise: &spec::Optimise, layout: &Layout, limits: Limits) -> Result<FeasibleSet, Invalid> {
    let (tie, frozen) = (tie(optimise)?, frozen(optimise, layout)?);
    Ok(FeasibleSet::moving(layout, limits, tie, &frozen))
}
