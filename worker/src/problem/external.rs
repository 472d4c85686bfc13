//! Trials with an external body: checks of the spec, and conversion to a problem.

use std::collections::BTreeSet;
use std::sync::Arc;

use metasense_numerics::dynamics::{Panel, Scene};
use metasense_schemas::spec::{
    self, Body, BodyKind, Channel, Description, Feasible, Sensors, Solver, SweepSpec, TrialSpec, flatten,
};
use serde::Serialize;

use super::{OfBody, limits};
use crate::external::{External, TIME_LIMIT, limits as linear};
use crate::invalid::{Invalid, invalid, require};

/// Largest number of design components, panels or sensors; more are presumably a mistake.
const MOST: usize = 1_000_000;
const NO_EFFECT: &str = "has no effect on an external body: delete this key";

/// Rejects external bodies.
///
/// # Errors
/// If the body is external.
pub fn polygons(body: &Body) -> Result<(), Invalid> {
    let remedy = "is not a body of polygons, which this command requires; `run` and `trial` train and compare external bodies";
    require(body.kind.is_polygons(), "body.kind", "\"external\"", remedy)
}

/// Rejects keys that have no effect on the spec's kind of body.
///
/// # Errors
/// If there is such a key; names the first.
pub fn refuse_unread(spec: &SweepSpec) -> Result<(), Invalid> {
    let body = &spec.body;
    require(body.description.is_none(), "body.description", "", "must be left out: the program provides it")?;
    if body.kind == BodyKind::Polygons {
        let remedy = "has no effect without body.kind = \"external\"";
        require(body.command.is_empty(), "body.command", format!("{:?}", body.command), remedy)?;
        return require(body.time_limit.is_none(), "body.time_limit", "", remedy);
    }
    let remedy = "must be set: the program that simulates the body";
    require(!body.command.is_empty(), "body.command", "", remedy)?;
    let limit = body.time_limit.unwrap_or(TIME_LIMIT);
    let remedy = "must be at least 0.001, at most 1e9 s";
    require((1e-3..=1e9).contains(&limit), "body.time_limit", limit, remedy)?;
    let none: Body = serde_json::from_str("{}").expect("every key has a default");
    let design = matches!(body.design, Some(spec::Design::Random { .. }));
    require(!design, "body.design", "{ random = … }", "external bodies have no random designs; use a file")?;
    only("body", body, &none, &["kind", "command", "time_limit", "design", "panel_units"])?;
    only("feasible", &spec.feasible, &Feasible::default(), &[])?;
    only("solver", &spec.solver, &Solver::default(), &["tolerance"])?;
    let read = ["channels", "placements", "noise", "bias", "delay", "bandwidth", "range", "resolution"];
    only("sensors", &spec.sensors, &Sensors::default(), &[&read[..], &["search"]].concat())?;
    let searched = spec.sensors.search.is_some_and(|search| search != spec::Search::Random);
    require(!searched, "sensors.search", "\"greedy\"", "external bodies have random or given placements")?;
    for (key, given) in [
        ("stimuli.offset", spec.stimuli.offset.is_some()),
        ("stimuli.angle", spec.stimuli.angle.is_some()),
        ("optimise.tie", spec.optimise.tie.is_some()),
        ("optimise.frozen", spec.optimise.frozen.is_some()),
        ("variation", spec.variation.is_some()),
        ("goal", spec.goal.is_some()),
    ] {
        require(!given, key, "", NO_EFFECT)?;
    }
    let inverse = spec.brain.kind == spec::BrainKind::Inverse;
    let remedy = "inverts only bodies of polygons; use \"linear\", \"cnn\" or \"stacked\"";
    require(!inverse, "brain.kind", "\"inverse\"", remedy)
}

/// Rejects keys of a table that differ from their defaults, except those in `read`.
fn only<T: Serialize>(table: &str, given: &T, default: &T, read: &[&str]) -> Result<(), Invalid> {
    let [given, default] =
        [given, default].map(|table| flatten(&serde_json::to_value(table).expect("a table is JSON")));
    let is_read = |key: &str| read.iter().any(|name| key.split('.').next() == Some(name));
    match given.iter().find(|(key, value)| !is_read(key) && default.get(*key) != Some(value)) {
        None => Ok(()),
        Some((key, value)) => Err(invalid(&format!("{table}.{key}"), value, NO_EFFECT)),
    }
}

/// Completes the spec with the design and channels of the description.
///
/// # Errors
/// If the description is invalid or the spec contradicts it.
pub fn described(spec: &SweepSpec, mut description: Description) -> Result<SweepSpec, Invalid> {
    check(&description)?;
    let mut spec = spec.clone();
    let alpha = std::mem::take(&mut description.alpha);
    let own = spec.body.design.get_or_insert_with(|| spec::Design::Shifts { shifts: alpha.clone() });
    if let spec::Design::Shifts { shifts } = own {
        let remedy = format!("the body {} has {} numbers", description.name, alpha.len());
        require(shifts.len() == alpha.len(), "body.design", format!("{} numbers", shifts.len()), &remedy)?;
    }
    let count = description.channels.len();
    let channels = spec.sensors.channels.get_or_insert_with(|| Channel::ALL[..count].to_vec());
    let remedy = format!(
        "the body {} has {count} signals per sensor: {}",
        description.name,
        description.channels.join(", ")
    );
    let known = channels.iter().all(|channel| (*channel as usize) < count);
    require(known, "sensors.channels", crate::invalid::as_written(&channels), &remedy)?;
    if let Some(samples) = description.samples {
        let remedy = format!("must be {samples}, as the body {} computes", description.name);
        require(spec.time.samples == samples, "time.samples", spec.time.samples, &remedy)?;
    }
    if let Some(duration) = description.duration {
        let remedy = format!("must be {duration} s, as the body {} computes", description.name);
        require(spec.time.duration == duration, "time.duration", spec.time.duration, &remedy)?;
    }
    if !description.tolerance {
        let remedy = format!("the body {} has no tolerance: delete this key", description.name);
        let usual = spec.solver == Solver::default();
        require(usual, "solver.tolerance", spec.solver.tolerance, &remedy)?;
        require(spec.optimise.coarse.is_none(), "optimise.coarse", "", &remedy)?;
    }
    spec.body.description = Some(description);
    Ok(spec)
}

/// Checks a description.
pub(super) fn check(description: &Description) -> Result<(), Invalid> {
    let Description { alpha, lower, upper, constraints, panels, sensors, channels, .. } = description;
    let holds = |holds: bool, key: &str, remedy: &str| {
        require(holds, "body.command", format!("{}: {key}", description.name), remedy)
    };
    let n = alpha.len();
    holds((1..=MOST).contains(&n), "alpha", "must contain 1 to 1000000 numbers")?;
    holds(alpha.iter().all(|x| x.is_finite()), "alpha", "must be finite")?;
    for (bound, key) in [(lower, "lower"), (upper, "upper")] {
        let sound =
            bound.as_ref().is_none_or(|bound| bound.len() == n && bound.iter().all(|x| x.is_finite()));
        holds(sound, key, &format!("must contain {n} finite numbers, one per number of alpha"))?;
    }
    for row in constraints {
        let numbers: BTreeSet<usize> = row.terms.iter().map(|(i, _)| *i).collect();
        let terms =
            numbers.len() == row.terms.len() && row.terms.iter().all(|(i, a)| *i < n && a.is_finite());
        let some = row.terms.iter().any(|(_, a)| *a != 0.0) && (row.least.is_some() || row.most.is_some());
        let remedy = format!("must have terms of distinct numbers 0 to {}, and a limit", n - 1);
        holds(terms && some, "constraints", &remedy)?;
    }
    for (names, key, most) in
        [(panels, "panels", MOST), (sensors, "sensors", MOST), (channels, "channels", 3)]
    {
        holds((1..=most).contains(&names.len()), key, &format!("must contain 1 to {most} names"))?;
    }
    holds(linear(description, n).hold(alpha), "alpha", "must keep its bounds and constraints")
}

/// The panels of a body: the first K, or those of `body.panel_units`.
pub(super) fn panel_units(
    body: &Body,
    description: &Description,
    panels: usize,
) -> Result<Vec<usize>, Invalid> {
    let all = description.panels.len();
    let units = body.panel_units.clone().unwrap_or_else(|| (0..all).collect());
    indices("body.panel_units", &units, all)?;
    let remedy = format!("the body {} has {} panels", description.name, units.len());
    require(panels <= units.len(), "sweep.panels", panels, &remedy)?;
    Ok(units[..panels].to_vec())
}

/// Rejects indices of nonexistent places and duplicate indices.
fn indices(key: &str, given: &[usize], count: usize) -> Result<(), Invalid> {
    for (n, i) in given.iter().enumerate() {
        require(*i < count, key, i, &format!("the body describes places 0 to {}", count - 1))?;
        require(!given[..n].contains(i), key, i, "must be named once")?;
    }
    Ok(())
}

/// The initial design and the body of a trial.
///
/// # Errors
/// If the body is not external.
pub fn body(trial: &TrialSpec) -> Result<(Vec<f64>, External), Invalid> {
    let none = || invalid("body.kind", "\"polygons\"", "must be \"external\"");
    let description = trial.body.description.as_ref().ok_or_else(none)?;
    Ok((parts(trial, description)?.initial, External::new(&trial.body, description)))
}

/// The body's part of the problem: a scene with panels, sensors and clock, without units.
pub(super) fn parts(trial: &TrialSpec, description: &Description) -> Result<OfBody, Invalid> {
    let design = match &trial.body.design {
        Some(spec::Design::Shifts { shifts }) => shifts.clone(),
        _ => return Err(invalid("body.design", "", "must be numbers: a trial contains the design itself")),
    };
    let external = External::new(&trial.body, description);
    let limits_hold = linear(description, design.len()).hold(&design);
    let remedy = "must keep the bounds and constraints that the program describes";
    require(limits_hold, "body.design", "", remedy)?;
    indices("sweep.panels", &trial.panel_units, description.panels.len())?;
    indices("sensors.placements", &trial.sensor_units, description.sensors.len())?;
    let (sensors, panels) = (trial.point.sensors, trial.point.panels);
    let remedy = format!("the body has places for {} sensors", description.sensors.len());
    require(sensors > 0 && trial.sensor_units.len() == sensors, "sweep.sensors", sensors, &remedy)?;
    let remedy = format!("the body has {} panels", description.panels.len());
    require(panels > 0 && trial.panel_units.len() == panels, "sweep.panels", panels, &remedy)?;
    let scene = Scene {
        panels: trial.panel_units.iter().map(|place| Panel::central(*place, [0.0; 2])).collect(),
        sensors: trial.sensor_units.clone(),
        duration: trial.time.duration,
        instants: trial.time.samples,
        ..Scene::default()
    };
    let limits = limits(&trial.feasible)?;
    Ok(OfBody { body: Arc::new(external), scene, limits, initial: design, relative_to: None })
}
