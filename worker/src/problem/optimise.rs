//! The outer loop, from its spec: protocol, what stands for the Hessian's inverse, which shifts move.

use metasense_numerics::body::{Freedom, Layout};
use metasense_numerics::brain::Policy;
use metasense_numerics::feasible::{Feasible, Limits};
use metasense_numerics::trial::{Going, Protocol, Terms};
use metasense_schemas::spec::{self, TrialSpec};

use super::{ITERATIONS_MAX, SAMPLES_MAX, check_units, held, kept};
use crate::invalid::{Invalid, as_written, invalid, not_negative, positive, require, within};

/// How body and brain are trained together.
pub(super) fn protocol(optimise: &spec::Optimise) -> Result<Protocol, Invalid> {
    let &spec::Optimise {
        protocol,
        gradient,
        curvature,
        damping,
        batch,
        brain_iterations,
        brain_learning_rate,
        coarse,
        ..
    } = optimise;
    // a key that a protocol does not read is refused: it would make trials differ that are the same
    let unread = |key: &str, given: Option<String>, readers: &str| match given {
        Some(value) => {
            Err(invalid(key, value, format!("means nothing to this optimise.protocol, only to {readers}")))
        }
        None => Ok(()),
    };
    let paper = protocol == spec::Protocol::Paper;
    if paper {
        unread(
            "optimise.brain_iterations",
            brain_iterations.map(|n| n.to_string()),
            "envelope, joint, random and cmaes",
        )?;
        unread(
            "optimise.brain_learning_rate",
            brain_learning_rate.map(|r| r.to_string()),
            "envelope, joint, random and cmaes",
        )?;
    } else {
        unread("optimise.gradient", gradient.map(|terms| as_written(&terms)), "paper")?;
    }
    let implicit = paper && gradient != Some(spec::GradientTerms::Direct);
    if !implicit {
        let reader = "paper with optimise.gradient = \"implicit\" or \"implicit_only\"";
        unread("optimise.curvature", curvature.map(|c| as_written(&c)), reader)?;
        unread("optimise.damping", damping.map(|d| d.to_string()), reader)?;
    }
    if !matches!(protocol, spec::Protocol::Envelope | spec::Protocol::Joint) {
        unread("optimise.batch", batch.map(|n| n.to_string()), "envelope and joint")?;
        unread("optimise.coarse", coarse.map(|solver| as_written(&solver)), "envelope and joint")?;
    }
    let resolved = optimise.clone().resolved();
    // what a protocol does not read stays open, and does not matter
    let going = Going {
        batch: resolved.batch.unwrap_or(1),
        brain_iterations: resolved.brain_iterations.unwrap_or(1),
        brain_rate: resolved.brain_learning_rate.unwrap_or(1.0),
    };
    within("optimise.batch", going.batch, 1, SAMPLES_MAX)?;
    within("optimise.brain_iterations", going.brain_iterations, 1, ITERATIONS_MAX)?;
    positive("optimise.brain_learning_rate", going.brain_rate)?;
    Ok(match protocol {
        spec::Protocol::Paper => Protocol::Paper(match gradient {
            None | Some(spec::GradientTerms::Implicit) => Terms::Implicit(policy(curvature, damping)?),
            Some(spec::GradientTerms::Direct) => Terms::Direct,
            Some(spec::GradientTerms::ImplicitOnly) => Terms::ImplicitOnly(policy(curvature, damping)?),
        }),
        spec::Protocol::Warm | spec::Protocol::Envelope => Protocol::Envelope(going),
        spec::Protocol::Joint => Protocol::Joint(going),
        spec::Protocol::Random => Protocol::Random(going),
        spec::Protocol::Cmaes => Protocol::Cmaes(going),
    })
}

/// Cells of a block whose nodes are shifted together.
pub(super) fn tie(optimise: &spec::Optimise) -> Result<[usize; 2], Invalid> {
    let tie = optimise.tie.unwrap_or([1, 1]);
    let shown = format!("{tie:?}");
    require(
        tie.iter().all(|n| (1..=1000).contains(n)),
        "optimise.tie",
        shown,
        "must be two numbers from 1 to 1000",
    )?;
    Ok(tie)
}

/// Units whose design stays.
pub(super) fn frozen(optimise: &spec::Optimise, layout: &Layout) -> Result<Vec<usize>, Invalid> {
    check_units("optimise.frozen", optimise.frozen.as_deref().unwrap_or_default(), layout, &[])
}

/// How many numbers the outer loop moves: those of α, or of z where shifts are tied or frozen, as `Problem::freedom` has them.
///
/// # Errors
/// Where `optimise.tie` or `optimise.frozen` make no sense, or leave nothing to move.
pub fn design_parameters(trial: &TrialSpec, layout: &Layout) -> Result<usize, Invalid> {
    let (tie, frozen) = (tie(&trial.optimise)?, frozen(&trial.optimise, layout)?);
    let kept = kept(&trial.feasible, &trial.panel_units, &held(&trial.body, layout)?);
    let parameters = Freedom::of(layout, tie, &frozen, &kept).parameters();
    require(parameters > 0, "optimise.frozen", format!("{frozen:?}"), "must leave a unit's shape free")?;
    Ok(parameters)
}

/// The designs that can be cast and had, as `Problem::castable` has them: shifts that are tied stay so, units that are frozen, or in
/// `kept`, as they are.
///
/// # Errors
/// Where `optimise.tie` or `optimise.frozen` make no sense.
pub fn castable(
    optimise: &spec::Optimise,
    layout: &Layout,
    limits: Limits,
    kept: &[usize],
) -> Result<Feasible, Invalid> {
    let (tie, frozen) = (tie(optimise)?, frozen(optimise, layout)?);
    Ok(Feasible::moving(layout, limits, tie, &frozen, kept))
}

/// What stands for the Hessian's inverse.
fn policy(curvature: Option<spec::Curvature>, damping: Option<f64>) -> Result<Policy, Invalid> {
    let lambda = damping.unwrap_or(0.0);
    let shown = damping.map_or(String::new(), |lambda| lambda.to_string());
    let least = "must be a number above 0 where optimise.curvature is \"damped\"";
    not_negative("optimise.damping", lambda)?;
    match curvature.unwrap_or(spec::Curvature::Truncate) {
        spec::Curvature::Truncate => require(
            damping.is_none(),
            "optimise.damping",
            shown,
            "means nothing to optimise.curvature = \"truncate\", only to damped and gauss_newton",
        )
        .map(|()| Policy::Truncate),
        spec::Curvature::Damped => {
            require(lambda > 0.0, "optimise.damping", shown, least).map(|()| Policy::Damped(lambda))
        }
        spec::Curvature::GaussNewton => Ok(Policy::GaussNewton(lambda)),
    }
}
