//! Expands a spec into an ordered list of trials with stable hashes. Reads only the files that the spec names.
//!
//! The order is breadth first: the first placement and seed of every point (axes, K, M) precede the second of any. Layouts,
//! panels and placements are computed once per body, and problems checked once per point, so that 10⁵ trials take seconds.

mod axes;
mod brains;
mod check;
mod combinations;
mod files;
mod goal;
#[cfg(test)]
mod tests;
mod until;

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use metasense_lab::cost;
use metasense_schemas::spec::{
    Body, BodyKind, Design, Disturbance, Feasible, LayoutKind, Search, SearchFrom, SharedTraining,
    SweepPoint, SweepSpec, TrialSpec,
};
use metasense_source::{Source, SpecError};
use metasense_worker::design::Layout;
use metasense_worker::invalid::invalid;
use metasense_worker::problem::{self, Invalid};
use metasense_worker::{external, memory, records};

use crate::hashes::{HashError, position_of};
use axes::Combination;
pub(crate) use axes::combinations;
pub(crate) use check::{GRACE_MAX, check_placements};
use combinations::Combinations;
use files::{described, with_records};
pub(crate) use files::{with_design, with_file};
pub use metasense_schemas::record::PlannedTrial;

/// A spec file and its trials.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Text of the file.
    pub source: Source,
    /// The parsed spec.
    pub spec: SweepSpec,
    /// The trials, in the order in which they run.
    pub trials: Vec<PlannedTrial>,
    /// Repeated trials of points, and keys of the file that overrides have made irrelevant, with the reason; `source` does not
    /// contain these keys.
    pub left_out: Vec<String>,
}

impl Plan {
    /// Expands the text of a spec file. The error names the first key that is unknown or has an impossible value.
    pub fn new(file: impl AsRef<Path>, text: String) -> Result<Self, SpecError> {
        Self::of(Source::spec(file, text, &[])?)
    }

    /// Expands a spec.
    pub fn of(source: Source) -> Result<Self, SpecError> {
        let Combinations { source, spec, combinations, mut left_out } = Combinations::of(source)?;
        let mut points = Vec::new();
        let added = combinations.iter().try_for_each(|one| add_points(&spec, &source, one, &mut points));
        external::end(); // workers start processes of their own
        added?;
        let (trials, repeated) = trials(&spec, &points);
        if repeated > 0 && spec.sweep.axes.is_empty() {
            left_out.push(format!("sweep.points: {} equal to others", counted(repeated, "trial")));
        }
        if trials.is_empty() {
            return Err(source.error("sweep.exclude", "excludes all trials"));
        }
        until::check(spec.until.as_ref(), &trials, &source)?;
        Ok(Self { source, spec, trials, left_out })
    }

    /// A plan with trials that were expanded earlier.
    pub fn listed(source: Source, trials: Vec<PlannedTrial>) -> Result<Self, SpecError> {
        let spec = until::grid(source.parse()?, &source)?;
        Ok(Self { source, spec, trials, left_out: Vec::new() })
    }

    /// The only trial whose hash starts with `hash`.
    pub fn find(&self, hash: &str) -> Result<&PlannedTrial, HashError> {
        let at = position_of(hash, self.trials.iter().map(|trial| trial.hash.as_str()))?;
        Ok(&self.trials[at])
    }

    /// Checks that each trial fits into the memory of a worker, limited by `[run] memory`, the machine and its limits. The error
    /// names the key that needs the most memory.
    pub fn check_memory(&self) -> Result<(), SpecError> {
        let limit = memory::limit(self.spec.run.memory);
        let check = |trial: &PlannedTrial| memory::check(&trial.spec, trial.units, limit.as_ref());
        self.trials.iter().try_for_each(check).map_err(located(&self.source))
    }

    /// Path of the database by default.
    pub fn default_database(&self) -> PathBuf {
        Path::new("results").join(format!("{}.sqlite", self.spec.name))
    }
}

/// All trials of one combination of axes, K and M; they differ in placement and seed.
struct PointPlan {
    /// The trials, without placement, seed and hashes.
    trial: PlannedTrial,
    /// Sensor units per placement.
    placements: Vec<Vec<usize>>,
    excluded: Vec<axes::Exclusion>,
    training: SharedTraining,
}

fn add_points(
    sweep: &SweepSpec,
    source: &Source,
    combination: &Combination,
    points: &mut Vec<PointPlan>,
) -> Result<(), SpecError> {
    let located = located(source);
    problem::external::refuse_unread(&combination.spec).map_err(located)?;
    let (mut spec, scale) = match combination.spec.body.kind {
        BodyKind::Polygons => {
            problem::scale_to_size(&with_file(&combination.spec, source)?).map_err(located)?
        }
        BodyKind::External => (described(&combination.spec, source)?, 1.0),
    };
    let layout = layout(&spec.body).map_err(located)?;
    spec.body.design = with_design("body.design", spec.body.design, &layout, source)?;
    spec.sensors.relative_to = with_design("sensors.relative_to", spec.sensors.relative_to, &layout, source)?;
    spec.stimuli = with_records(spec.stimuli, source)?;
    let spec = &spec;
    let clamped = problem::clamped(&spec.body, &layout).map_err(located)?;
    let searched = spec.sensors.search.is_some_and(|search| search != Search::Random);
    spec.sensors.placements.as_ref().map_or(Ok(()), |lists| check_placements(lists, source))?;
    let chosen = searched || spec.sensors.placements.is_some();
    source.require(&[(
        "sweep.own_placements",
        !(sweep.sweep.own_placements && chosen),
        "cannot be set together with sensors.search or sensors.placements",
    )])?;
    let placement_count =
        sweep.sweep.placements * if sweep.sweep.own_placements { sweep.sweep.seeds.len() } else { 1 };
    // keep only the units that carry sensors: there may be a million placements
    let max_sensors = spec.sweep.sensors.iter().copied().max().unwrap_or_default();
    let order = |p: usize| {
        let mut order = match &spec.body.description {
            Some(body) => external::placement(body.sensors.len(), p as u64),
            None => placement(&spec.body, &layout, p as u64, &clamped),
        };
        order.truncate(max_sensors);
        order
    };
    let seeded: Vec<Vec<usize>> = (0..placement_count).map(order).collect();
    for &panels in &spec.sweep.panels {
        let panel_units = problem::panel_units(&spec.body, &layout, panels).map_err(located)?;
        for &sensors in &spec.sweep.sensors {
            let excluded = combination.exclusions(panels, sensors);
            if excluded.contains(&[None; 2]) {
                continue;
            }
            let placements: Vec<Vec<usize>> = match &spec.sensors.placements {
                Some(lists) => lists.iter().filter(|list| list.len() == sensors).cloned().collect(),
                // the worker chooses the units
                None if searched => vec![Vec::new(); placement_count],
                None => seeded.iter().map(|order| order.iter().copied().take(sensors).collect()).collect(),
            };
            if placements.is_empty() {
                // An invalid unit may be the cause.
                for list in spec.sensors.placements.iter().flatten().filter(|_| spec.body.kind.is_polygons())
                {
                    problem::check_units("sensors.placements", list, &layout, &clamped).map_err(located)?;
                }
                let remedy =
                    format!("contains no list of {}, which sweep.sensors needs", counted(sensors, "unit"));
                return Err(source.error("sensors.placements", &remedy));
            }
            if let Some(short) = placements.iter().find(|units| !searched && units.len() < sensors) {
                let remedy =
                    format!("the body has {} free units inside its boundary to carry sensors", short.len());
                return Err(source.error_with("sweep.sensors", Some(&sensors.to_string()), &remedy));
            }
            let template = template(spec, scale, panels, &panel_units, sensors);
            // Random placements are valid by construction, and searched ones are empty, so checking the last suffices; lists by
            // users are all checked.
            let to_check = if spec.sensors.placements.is_some() { 0 } else { placements.len() - 1 };
            for (placement, units) in placements.iter().enumerate().skip(to_check) {
                let trial = at(&template, placement, units, sweep.sweep.seeds[0]);
                problem::problem(&trial)
                    .and_then(|problem| records::check_records(&trial, &problem))
                    .map_err(located)?;
            }
            let (cost, weight) = cost::of(&template, layout.units());
            let training = SharedTraining::of(&template);
            let trial = PlannedTrial {
                hash: String::new(),
                training: String::new(),
                order: 0,
                units: layout.units(),
                design_parameters: problem::design_parameters(&template, &layout).map_err(located)?,
                brain_parameters: cost::brain_parameters(&template),
                trains: true,
                cost,
                weight,
                pause: None,
                spec: template,
            };
            points.push(PointPlan { trial, placements, excluded, training });
        }
    }
    Ok(())
}

/// Returns a conversion of invalid values into errors at their keys.
pub(crate) fn located(source: &Source) -> impl Fn(Invalid) -> SpecError + Copy {
    move |e| source.error_with(&e.key, Some(&e.value), &e.remedy)
}

/// `1 trial`, `2 trials`.
pub(crate) fn counted(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Placement `p` of a body. Excludes driven units: their motion is prescribed, whatever the body does.
pub(crate) fn placement(body: &Body, layout: &Layout, p: u64, clamped: &[usize]) -> Vec<usize> {
    layout.placement(p, &[clamped, &problem::driven(body)].concat())
}

/// The layout of a body in a spec. Specs of circular bodies must omit rows; only their trials have them, equal to columns.
pub(crate) fn layout(body: &Body) -> Result<Layout, Invalid> {
    match (body.layout, body.rows) {
        (LayoutKind::Circular, Some(rows)) => {
            let remedy = "must be left out for a circular body: body.columns counts its units across";
            Err(invalid("body.rows", rows, remedy))
        }
        _ => problem::layout(body),
    }
}

/// The common part of the trials of a point, in a canonical form, so that equal trials have equal hashes.
fn template(spec: &SweepSpec, scale: f64, panels: usize, panel_units: &[usize], sensors: usize) -> TrialSpec {
    let mut body = spec.body.clone();
    body.panel_units = None;
    body.panels.truncate(panels);
    body.compression = body.compression.filter(|parts| *parts != [0.0; 2]);
    body.rows = body.rows.or(body.columns);
    body.clamp = body.kind.is_polygons().then(|| problem::clamp(&body));
    if !body.kind.is_polygons()
        || body.file.is_some()
        || matches!(body.design, Some(Design::Shifts { .. })) && body.lattice.turns()
    {
        body.initial_angle = 0.0; // not used
    }
    let mut sensor_spec = spec.sensors.clone().resolved();
    sensor_spec.placements = None;
    sensor_spec.search = sensor_spec.search.filter(|search| *search != Search::Random);
    sensor_spec.from = sensor_spec.from.filter(|from| *from != SearchFrom::Interior);
    sensor_spec.spacing = sensor_spec.spacing.filter(|spacing| *spacing != 0.0);
    let none =
        |size: &Disturbance| matches!(size, Disturbance::Relative(0.0) | Disturbance::Physical([0.0, 0.0]));
    sensor_spec.noise = sensor_spec.noise.filter(|size| !none(size));
    sensor_spec.bias = sensor_spec.bias.filter(|size| !none(size));
    sensor_spec.relative_to = sensor_spec.relative_to.filter(|_| spec.sensors.is_relative());
    sensor_spec.delay = sensor_spec.delay.filter(|delay| *delay != 0.0);
    sensor_spec.bandwidth = sensor_spec.bandwidth.filter(|bandwidth| *bandwidth != f64::INFINITY);
    sensor_spec.range = sensor_spec.range.filter(|range| range.iter().any(|most| most.is_finite()));
    sensor_spec.resolution = sensor_spec.resolution.filter(|step| *step != [0.0; 2]);
    sensor_spec.mass = sensor_spec.mass.filter(|mass| *mass != 0.0);
    sensor_spec.inertia = sensor_spec.inertia.filter(|moment| *moment != 0.0);
    sensor_spec.offset = sensor_spec.offset.filter(|offset| *offset != [0.0; 2]);
    sensor_spec.tilt = sensor_spec.tilt.filter(|tilt| *tilt != 0.0);
    let mut stimuli = spec.stimuli.clone().resolved();
    stimuli.force_samples = stimuli.force_samples.filter(|instants| *instants != spec.time.samples);
    let (brain, mut optimise, evaluation, variation) = brains::resolved(spec);
    optimise.learning_rate = optimise.learning_rate.map(|rate| scale * rate);
    TrialSpec {
        body,
        time: spec.time,
        solver: spec.solver,
        sensors: sensor_spec,
        stimuli,
        variation,
        brain,
        optimise,
        evaluation,
        // without limits, the others have no effect
        feasible: if spec.feasible.limits {
            spec.feasible
        } else {
            Feasible { limits: false, ..Feasible::default() }
        },
        point: SweepPoint { panels, sensors, placement: 0, seed: 0 },
        panel_units: panel_units.to_vec(),
        sensor_units: Vec::new(),
    }
}

fn at(template: &TrialSpec, placement: usize, sensor_units: &[usize], seed: u64) -> TrialSpec {
    let mut trial = template.clone();
    trial.point.placement = placement;
    trial.point.seed = seed;
    trial.sensor_units = sensor_units.to_vec();
    trial
}

/// The trials, and the number of repeated ones.
fn trials(spec: &SweepSpec, points: &[PointPlan]) -> (Vec<PlannedTrial>, usize) {
    let (mut trials, mut repeated) = (Vec::new(), 0);
    let mut seen = HashSet::new();
    let most_placements = points.iter().map(|p| p.placements.len()).max().unwrap_or(0);
    for (s, &seed) in spec.sweep.seeds.iter().enumerate() {
        let own = spec.sweep.placements * s..spec.sweep.placements * (s + 1);
        for placement in if spec.sweep.own_placements { own } else { 0..most_placements } {
            for point in points {
                let Some(units) = point.placements.get(placement) else { continue };
                let is_here = |[p, s]: &axes::Exclusion| {
                    p.is_none_or(|p| p == placement as u64) && s.is_none_or(|s| s == seed)
                };
                if point.excluded.iter().any(is_here) {
                    continue;
                }
                let spec = at(&point.trial.spec, placement, units, seed);
                let (hash, training) = (spec.hash(), point.training.at(&spec));
                // Different axis values may give the same trial.
                match seen.insert(hash.clone()) {
                    true => {
                        trials.push(PlannedTrial { hash, training, spec, order: trials.len(), ..point.trial })
                    }
                    false => repeated += 1,
                }
            }
        }
    }
    cost::first_trains(&mut trials);
    (trials, repeated)
}
