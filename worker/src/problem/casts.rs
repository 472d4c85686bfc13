//! Deviations of casts, training objectives and evaluations over casts, from the spec.

use metasense_numerics::brains::fits;
use metasense_numerics::dynamics::{MaxwellBranch, Parameters};
use metasense_numerics::trial::{CastObjective, ObjectiveDomain};
use metasense_numerics::variation::Deviations;
use metasense_schemas::spec::{self, Scatter, TrialSpec};

use super::body::lengths;
use crate::invalid::{Invalid, as_written, at_most, invalid, require, within};

/// Greatest standard deviation of a logarithm: one cast in three hundred then deviates by a factor of twenty.
const DEVIATION_MAX: f64 = 1.0;
/// Greatest standard deviation σ of nodes relative to the ligament length l: 4σ of the distance between two nodes is then about l.
const NODES_MAX: f64 = 1.0 / 6.0;
/// Greatest standard deviation of a chip's angle (degrees).
const MISALIGNMENT_MAX: f64 = 45.0;
/// Greatest correlation length of nodes (mm), longer than any body.
const CORRELATION_MAX: f64 = 10_000.0;
/// Deviations of the ligament length that still leave it below the spacing.
const LENGTHS: f64 = 6.0;
/// Greatest number of units with correlated nodes: their correlation matrix takes about 140 MB.
const ALIKE_MAX: usize = 2000;
/// Greatest number of casts; more are probably a mistake.
const CASTS_MAX: usize = 10_000;

/// Deviations of casts of a body with `units` units.
pub(super) fn variation(trial: &TrialSpec, units: usize) -> Result<Option<Deviations>, Invalid> {
    let Some(given) = &trial.variation else { return Ok(None) };
    let spec::Variation { stretch, shear, bend, damping, density, contact, .. } = *given;
    let spec::Variation { nodes, gain, misalignment, ligament_length, relaxation, .. } = *given;
    let of_contact = deviation("contact", contact.unwrap_or(0.0))?;
    let touches = trial.body.contact.is_some() || contact.is_none();
    require(touches, "variation.contact", of_contact, "has no effect: the body has no body.contact")?;
    let (key, nodes, correlation) = match nodes {
        None => ("variation.nodes", 0.0, 0.0),
        Some(spec::Nodes::Each(scatter)) => ("variation.nodes", scatter, 0.0),
        Some(spec::Nodes::Alike(alike)) => ("variation.nodes.scatter", alike.scatter, alike.correlation),
    };
    let [spacing, length] = lengths(&trial.body)?;
    let most = NODES_MAX * length;
    let remedy = format!(
        "must lie between 0 and {most:.3} mm, a sixth of body.ligament_length: with larger deviations, units would touch"
    );
    require((0.0..=most).contains(&nodes), key, nodes, &remedy)?;
    let key = "variation.nodes.correlation";
    let sound = (0.0..=CORRELATION_MAX).contains(&correlation);
    require(sound, key, correlation, "must lie between 0 and 10000 mm")?;
    let remedy = format!("the body has {units} units; correlated nodes need at most {ALIKE_MAX}");
    require(correlation == 0.0 || units <= ALIKE_MAX, key, correlation, &remedy)?;
    let [stretch, shear, bend] = [
        deviations("stretch", stretch, "ligament")?,
        deviations("shear", shear, "ligament")?,
        deviations("bend", bend, "ligament")?,
    ];
    let density = deviations("density", density, "unit")?;
    let material = Parameters {
        stretch: stretch[0],
        shear: shear[0],
        bend: bend[0],
        damping_ratio: deviation("damping", damping.unwrap_or(0.0))?,
        density: density[0],
        contact: of_contact,
    };
    let (gain, turn) = (deviation("gain", gain.unwrap_or(0.0))?, misalignment.unwrap_or(0.0));
    let remedy = "must be a standard deviation from 0 to 45 degrees";
    require((0.0..=MISALIGNMENT_MAX).contains(&turn), "variation.misalignment", turn, remedy)?;
    let (ligaments, units) = ([stretch[1], shear[1], bend[1]], density[1]);
    let misalignment = turn.to_radians();
    let ligament_length = ligament_length.unwrap_or(0.0);
    let most = ((spacing / length).ln() / LENGTHS).min(DEVIATION_MAX);
    let remedy = format!(
        "must be a standard deviation of the logarithm from 0 to {most:.3}: with larger deviations, units would vanish"
    );
    require((0.0..=most).contains(&ligament_length), "variation.ligament_length", ligament_length, &remedy)?;
    let relaxation = relaxation.map(relaxing).transpose()?;
    let parts = Deviations { material, ligaments, units, ligament_length, ..Deviations::default() };
    Ok(Some(Deviations { relaxation, nodes, correlation, gain, misalignment, ..parts }))
}

/// Relaxation of ligaments in casts that evaluate a body.
fn relaxing(spec::Relaxation { share, time }: spec::Relaxation) -> Result<MaxwellBranch, Invalid> {
    let remedy = "must lie between 0 and 1: a fraction of the ligament's stiffness";
    require((0.0..=1.0).contains(&share), "variation.relaxation.share", share, remedy)?;
    let remedy = "must lie between 1e-4 and 1000 s: a faster branch acts as damping only";
    require((1e-4..=1e3).contains(&time), "variation.relaxation.time", time, remedy)?;
    Ok(MaxwellBranch { share, time })
}

/// Checks the standard deviation of a key of `[variation]`.
fn deviation(key: &str, value: f64) -> Result<f64, Invalid> {
    let remedy = "must be a standard deviation of the logarithm from 0 to 1";
    require((0.0..=DEVIATION_MAX).contains(&value), &format!("variation.{key}"), value, remedy)
        .map(|()| value)
}

/// Standard deviations of a cast's common factor and of each `part`'s factor.
fn deviations<Parts: Copy + Into<[f64; 2]>>(
    key: &str,
    given: Option<Scatter<Parts>>,
    part: &str,
) -> Result<[f64; 2], Invalid> {
    match given {
        None => Ok([0.0; 2]),
        Some(Scatter::Common(common)) => Ok([deviation(key, common)?, 0.0]),
        Some(Scatter::Parts(parts)) => {
            let [common, each] = parts.into();
            let keys = ["common", part].map(|of| format!("{key}.{of}"));
            Ok([deviation(&keys[0], common)?, deviation(&keys[1], each)?])
        }
    }
}

/// The objective over casts, or over parts of a mixture.
pub(super) fn casting(trial: &TrialSpec) -> Result<Option<CastObjective>, Invalid> {
    let spec::Optimise { objective, casts, protocol, .. } = trial.optimise.clone().resolved();
    let Some(tail) = objective.and_then(spec::Objective::tail) else { return Ok(None) };
    let shown = as_written(&objective);
    let parts = trial.stimuli.mix.as_ref().filter(|_| trial.variation.is_none()).map(Vec::len);
    if trial.variation.is_none() && parts.is_none() {
        let remedy = "needs a [variation] or a mixture of stimuli";
        return Err(invalid("optimise.objective", shown, remedy));
    }
    let remedy = "has no effect on this optimise.protocol, only on joint";
    require(protocol == spec::Protocol::Joint, "optimise.objective", shown, remedy)?;
    let remedy = "must lie between 0 and 1";
    require((0.0..=1.0).contains(&tail), "optimise.objective.cvar", 1.0 - tail, remedy)?;
    let casts = casts.unwrap_or(1);
    within("optimise.casts", casts, 1, CASTS_MAX)?;
    let remedy = "must be left out: without a [variation] the objective is over the parts of stimuli.mix";
    require(parts.is_none_or(|parts| parts == casts), "optimise.casts", casts, remedy)?;
    let over = if parts.is_some() { ObjectiveDomain::Parts } else { ObjectiveDomain::Casts };
    Ok(Some(CastObjective { over, casts, tail }))
}

/// Number of casts in the final comparison.
pub(super) fn casts(trial: &TrialSpec) -> Result<usize, Invalid> {
    let casts = trial.evaluation.casts.unwrap_or(0);
    at_most("evaluation.casts", casts, CASTS_MAX)?;
    let readable = fits(trial.time.samples, trial.signals());
    let remedy = "must be 0: a linear decoder of such long samples takes too long";
    require(casts == 0 || readable, "evaluation.casts", casts, remedy)?;
    Ok(casts)
}
