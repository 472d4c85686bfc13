//! Expands a spec into an ordered list of trials with stable hashes. Reads only the files that the spec names.
//!
//! The order is breadth first: the first placement and seed of every point (axes, K, M) precede the second of any. Layouts,
//! panels and placements are computed once per body, and problems checked once per point, so that 10⁵ trials take seconds.

mod axes;
mod brains;
mod combinations;
pub mod cost;
pub mod goal;
mod size;
mod until;

use std::collections::{BTreeSet, HashSet};
use std::error::Error as _;
use std::path::{Path, PathBuf};

use metasense_schemas::spec::{
    Body, BodyKind, Design, Disturbance, Lattice, LayoutKind, Own, Point, Run, Search, SearchFrom, Sensors,
    Stimuli, SweepSpec, Training, TrialSpec,
};
use metasense_source::{HashError, Source, SpecError, position_of};
use metasense_worker::design::{self, DesignError, Feasible, Layout, Limits};
use metasense_worker::memory;
use metasense_worker::problem::{self, Invalid, Panel, as_written};
use metasense_worker::{external, polygons, records};

use serde_json::Value;

use crate::cell::plain;
use crate::control::WORKERS_MAX;
use axes::Combination;
use combinations::Combinations;
use metasense_schemas::record::Parts;
pub use metasense_schemas::record::Trial;

/// Specs with more trials are rejected as mistakes.
const MOST_TRIALS: usize = 1_000_000;

/// A spec file and its trials.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Text of the file.
    pub source: Source,
    /// The parsed spec.
    pub spec: SweepSpec,
    /// The trials, in the order in which they run.
    pub trials: Vec<Trial>,
    /// Keys of the file that overrides have made irrelevant, with the reason; `source` does not contain them.
    pub left_out: Vec<String>,
}

/// Values of a trial's spec at the given keys; lists and tables as text, missing keys as null.
pub fn values_at(spec: &Value, keys: &BTreeSet<&str>) -> Vec<Value> {
    let value = |key: &&str| match spec.pointer(&format!("/{}", key.replace('.', "/"))) {
        None => Value::Null,
        Some(value @ (Value::Array(_) | Value::Object(_))) => value.to_string().into(),
        Some(scalar) => scalar.clone(),
    };
    keys.iter().map(value).collect()
}

/// Text with a trial's K, M, placement, seed, and its values of `keys`.
pub fn point_in_words(spec: &Value, keys: &BTreeSet<&str>) -> String {
    let point = |name: &str| plain(&spec["point"][name]);
    let [k, m, placement, seed] = ["panels", "sensors", "placement", "seed"].map(point);
    let mut words = format!("K={k} M={m} placement {placement} seed {seed}");
    for (key, value) in keys.iter().zip(values_at(spec, keys)).filter(|(_, value)| !value.is_null()) {
        words += &format!(" {key}={}", plain(&value));
    }
    words
}

impl Plan {
    /// Expands the text of a spec file.
    ///
    /// # Errors
    /// For the first key that is unknown or has an impossible value.
    pub fn new(file: impl AsRef<Path>, text: String) -> Result<Self, SpecError> {
        Self::of(Source::spec(file, text, &[])?)
    }

    /// Expands a spec.
    ///
    /// # Errors
    /// As [`Plan::new`].
    pub fn of(source: Source) -> Result<Self, SpecError> {
        let Combinations { source, spec, combinations, left_out } = Combinations::of(source)?;
        let mut points = Vec::new();
        let added = combinations.iter().try_for_each(|one| add_points(&spec, &source, one, &mut points));
        external::end(); // workers start processes of their own
        added?;
        let trials = trials(&spec, &points);
        if trials.is_empty() {
            return Err(source.error("sweep.exclude", "excludes all trials"));
        }
        until::check(spec.until.as_ref(), &trials, &source)?;
        Ok(Self { source, spec, trials, left_out })
    }

    /// A plan with trials that were expanded earlier.
    ///
    /// # Errors
    /// If the spec is invalid.
    pub fn listed(source: Source, trials: Vec<Trial>) -> Result<Self, SpecError> {
        let spec = until::grid(source.parse()?, &source)?;
        Ok(Self { source, spec, trials, left_out: Vec::new() })
    }

    /// The only trial whose hash starts with `hash`.
    ///
    /// # Errors
    /// If no trial or several match.
    pub fn find(&self, hash: &str) -> Result<&Trial, HashError> {
        let at = position_of(hash, self.trials.iter().map(|trial| trial.hash.as_str()))?;
        Ok(&self.trials[at])
    }

    /// Checks that each trial fits into the memory of a worker, limited by `[run] memory`, the machine and its limits.
    ///
    /// # Errors
    /// Names the key that needs the most memory.
    pub fn check_memory(&self) -> Result<(), SpecError> {
        let limit = memory::limit(self.spec.run.memory);
        let refused = |e: Invalid| self.source.error_with(&e.key, Some(&e.value), &e.remedy);
        let check = |trial: &Trial| memory::check(&trial.spec, trial.units, limit.as_ref());
        self.trials.iter().try_for_each(check).map_err(refused)
    }

    /// Path of the database by default.
    #[must_use]
    pub fn default_database(&self) -> PathBuf {
        Path::new("results").join(format!("{}.sqlite", self.spec.name))
    }
}

/// Largest seed: f64 represents it and the seeds that [until] and [goal] add to it exactly.
const MOST_SEED: u64 = 1 << 52;

/// Checks the lists of `[sweep]`, and the name, which becomes a file name.
fn check_sweep(spec: &SweepSpec, source: &Source) -> Result<(), SpecError> {
    let sweep = &spec.sweep;
    let harmless = |c: char| c.is_alphanumeric() || "-_.".contains(c);
    if spec.name.is_empty() || spec.name.starts_with('.') || !spec.name.chars().all(harmless) {
        return Err(source.error(
            "name",
            "must consist of letters, digits, '-', '_' and '.', because it names the database",
        ));
    }
    for (list, key) in [(&sweep.panels, "sweep.panels"), (&sweep.sensors, "sweep.sensors")] {
        if !list.is_empty() || sweep.points.is_empty() {
            distinct(list, key, source)?;
        }
    }
    if !sweep.points.is_empty() {
        distinct(&sweep.points, "sweep.points", source)?;
    }
    if let Some(seed) = sweep.seeds.iter().find(|seed| **seed > MOST_SEED) {
        let remedy = format!("must be at most {MOST_SEED}");
        return Err(source.error_with("sweep.seeds", Some(&seed.to_string()), &remedy));
    }
    distinct(&sweep.seeds, "sweep.seeds", source)?;
    for (path, values) in &sweep.axes {
        distinct(values, path, source)?;
    }
    for (key, least) in [
        ("sweep.panels", sweep.panels.iter().min()),
        ("sweep.sensors", sweep.sensors.iter().min()),
        ("sweep.placements", Some(&sweep.placements)),
    ] {
        if least == Some(&0) {
            return Err(source.error_with(key, Some("0"), "must be at least 1"));
        }
    }
    check_run(&spec.run, source)?;
    for (asked, table) in [(spec.until.is_some(), "until"), (spec.goal.is_some(), "goal")] {
        if asked && sweep.own_placements {
            let remedy =
                format!("cannot be set together with [{table}], which adds seeds and placements itself");
            return Err(source.error("sweep.own_placements", &remedy));
        }
    }
    if spec.sensors.placements.is_some() {
        if sweep.placements != 1 {
            return Err(source.error("sweep.placements", "cannot be set together with sensors.placements"));
        }
        if spec.sensors.search.is_some() {
            return Err(source.error(
                "sensors.search",
                "cannot be set together with sensors.placements, which fixes the units",
            ));
        }
    }
    let others = sweep.axes.values().map(Vec::len);
    let own = [sweep.panels.len(), sweep.sensors.len(), sweep.points.len()].map(|n| n.max(1));
    let mut lists = others.chain(own).chain([sweep.seeds.len(), sweep.placements]);
    match lists.try_fold(1usize, usize::checked_mul) {
        Some(n) if n <= MOST_TRIALS => Ok(()),
        n => {
            let n = n.map_or("too many".to_owned(), |n| n.to_string());
            Err(source
                .error("sweep", &format!("its lists span {n} trials; at most {MOST_TRIALS} are allowed")))
        }
    }
}

/// Largest `run.grace` (s).
pub(crate) const GRACE_MAX: f64 = 3600.0;

fn check_run(run: &Run, source: &Source) -> Result<(), SpecError> {
    let thousand = |n: Option<usize>| n.is_none_or(|n| (1..=WORKERS_MAX as usize).contains(&n));
    let seconds = |s: Option<f64>, least: f64| s.is_none_or(|s| s >= least && s <= 1e9);
    for (key, holds, remedy) in [
        ("run.workers", thousand(run.workers), "must be at least 1, at most 1024"),
        ("run.threads", thousand(run.threads), "must be at least 1, at most 1024"),
        ("run.niceness", run.niceness.is_none_or(|n| n <= 19), "must be at most 19"),
        ("run.memory", run.memory.is_none_or(|mib| mib >= 64), "must be at least 64 MiB"),
        ("run.backoff", seconds(run.backoff, 0.0), "must be at least 0, at most 1e9 s"),
        ("run.no_progress", seconds(run.no_progress, 0.1), "must be at least 0.1, at most 1e9 s"),
        (
            "run.grace",
            run.grace.is_none_or(|s| (0.0..=GRACE_MAX).contains(&s)),
            "must be at least 0, at most 3600 s",
        ),
        ("run.lock_wait", seconds(run.lock_wait, 0.0), "must be at least 0, at most 1e9 s"),
        ("run.time_limit", seconds(run.time_limit, 0.1), "must be at least 0.1, at most 1e9 s"),
    ] {
        if !holds {
            return Err(source.error(key, remedy));
        }
    }
    Ok(())
}

/// Rejects lists that contain a unit twice, and lists with the same units as another, in any order.
fn check_placements(lists: &[Vec<usize>], source: &Source) -> Result<(), SpecError> {
    let key = "sensors.placements";
    let mut lists = lists.to_vec();
    lists.iter_mut().for_each(|list| list.sort_unstable());
    match lists.iter().flat_map(|list| list.windows(2)).find(|pair| pair[0] == pair[1]) {
        Some(pair) => Err(source.error_with(
            key,
            Some(&pair[0].to_string()),
            "is listed twice: a unit has at most one sensor",
        )),
        None => distinct(&lists, key, source),
    }
}

fn distinct<T: serde::Serialize>(values: &[T], key: &str, source: &Source) -> Result<(), SpecError> {
    if values.is_empty() {
        return Err(source.error(key, "needs at least one value"));
    }
    let mut seen = HashSet::new();
    match values.iter().find(|value| !seen.insert(serde_json::to_string(value).expect("it is JSON"))) {
        Some(value) => Err(source.error_with(key, Some(&as_written(value)), "is listed twice")),
        None => Ok(()),
    }
}

/// All trials of one combination of axes, K and M; they differ in placement and seed.
struct PointPlan {
    template: TrialSpec,
    /// Sensor units per placement.
    placements: Vec<Vec<usize>>,
    excluded: Vec<axes::Exclusion>,
    units: usize,
    design_parameters: usize,
    brain_parameters: usize,
    cost: (Parts<f64>, Parts<u64>),
    training: Training,
}

fn add_points(
    sweep: &SweepSpec,
    source: &Source,
    combination: &Combination,
    points: &mut Vec<PointPlan>,
) -> Result<(), SpecError> {
    let located = |e: Invalid| source.error_with(&e.key, Some(&e.value), &e.remedy);
    problem::external::refuse_unread(&combination.spec).map_err(located)?;
    let (spec, scale) = match combination.spec.body.kind {
        BodyKind::Polygons => size::scale_to_size(&with_file(&combination.spec, source)?).map_err(located)?,
        BodyKind::External => (described(&combination.spec, source)?, 1.0),
    };
    let layout = layout(&spec.body).map_err(located)?;
    let spec = &SweepSpec {
        body: Body {
            design: with_design("body.design", spec.body.design.as_ref(), &layout, source)?,
            ..spec.body.clone()
        },
        sensors: Sensors {
            relative_to: with_design(
                "sensors.relative_to",
                spec.sensors.relative_to.as_ref(),
                &layout,
                source,
            )?,
            ..spec.sensors.clone()
        },
        stimuli: with_records(&spec.stimuli, source)?,
        ..spec.clone()
    };
    let clamped = problem::clamped(&spec.body, &layout).map_err(located)?;
    let searched = spec.sensors.search.is_some_and(|search| search != Search::Random);
    spec.sensors.placements.as_ref().map_or(Ok(()), |lists| check_placements(lists, source))?;
    let placement_count =
        sweep.sweep.placements * if sweep.sweep.own_placements { sweep.sweep.seeds.len() } else { 1 };
    if sweep.sweep.own_placements && (searched || spec.sensors.placements.is_some()) {
        return Err(source.error(
            "sweep.own_placements",
            "cannot be set together with sensors.search or sensors.placements",
        ));
    }
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
            if excluded.iter().any(axes::Exclusion::is_total) {
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
            points.push(PointPlan {
                placements,
                excluded,
                units: layout.units(),
                design_parameters: problem::design_parameters(&template, &layout).map_err(located)?,
                brain_parameters: cost::brain_parameters(&template),
                cost: cost::of(&template, layout.units()),
                training: Training::of(&template),
                template,
            });
        }
    }
    Ok(())
}

/// Advice about a file that does not exist.
fn from_where(path: &Path) -> &'static str {
    if path.exists() { "" } else { "; file names are relative to the folder of the spec" }
}

/// The error for a file of the body that cannot be read or is invalid.
fn unread(key: &str, file: &Path, path: &Path, error: &DesignError, source: &Source) -> SpecError {
    let because = error.source().map_or(String::new(), |cause| format!(": {cause}{}", from_where(path)));
    source.error_with(key, Some(&format!("{file:?}")), &format!("{error}{because}"))
}

/// `1 trial`, `2 trials`.
pub(crate) fn counted(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// The spec with the polygons of its body's file and their mean lengths, so that the trial's hash depends on the content.
fn with_file(spec: &SweepSpec, source: &Source) -> Result<SweepSpec, SpecError> {
    let mut spec = spec.clone();
    let body = &mut spec.body;
    let Some(own) = body.file.take() else { return Ok(spec) };
    let others = [
        ("body.columns", body.columns.is_some()),
        ("body.rows", body.rows.is_some()),
        ("body.spacing", body.spacing.is_some()),
        ("body.ligament_length", body.ligament_length.is_some()),
        ("body.width", body.width.is_some()),
        ("body.diameter", body.diameter.is_some()),
        ("body.lattice", body.lattice != Lattice::Square),
        ("body.layout", body.layout != LayoutKind::Planar),
        ("optimise.tie", spec.optimise.tie.is_some()),
    ];
    if let Some((key, _)) = others.into_iter().find(|(_, given)| *given) {
        return Err(source.error(key, "cannot be set together with body.file"));
    }
    let (given, name) = match own {
        Own::Given(given) => (given, String::new()),
        Own::File(file) => {
            let path = source.file.parent().unwrap_or(Path::new("")).join(&file);
            let read = polygons::read(&path).map_err(|e| unread("body.file", &file, &path, &e, source))?;
            (read, format!("{file:?}, "))
        }
    };
    body.file = Some(Own::Given(given));
    let layout =
        problem::layout(body).map_err(|e| source.error_with(&e.key, Some(&(name + &e.value)), &e.remedy))?;
    (body.spacing, body.ligament_length) = (Some(layout.spacing), Some(layout.ligament_length));
    Ok(spec)
}

/// The spec of an external body with what its program describes, and its design.
fn described(spec: &SweepSpec, source: &Source) -> Result<SweepSpec, SpecError> {
    let located = |e: Invalid| source.error_with(&e.key, Some(&e.value), &e.remedy);
    let (mut spec, folder) = (spec.clone(), source.file.parent().unwrap_or(Path::new("")));
    for word in &mut spec.body.command {
        // a link stays one: an interpreter of a virtual environment is told by where it lies
        let file = std::path::absolute(folder.join(&*word)).ok().filter(|file| file.is_file());
        if let Some(path) = file.as_deref().and_then(Path::to_str) {
            path.clone_into(word);
        }
    }
    let (command, limit) = (&spec.body.command, spec.body.time_limit);
    let asked = external::describe(command, limit);
    let description = asked.map_err(|fault| source.error("body.command", &fault.detail))?;
    if let Some(Design::File(file)) = &spec.body.design {
        let path = folder.join(file);
        let read = design::read_array(&path, description.alpha.len());
        let shifts = read.map_err(|e| unread("body.design", file, &path, &e, source))?;
        spec.body.design = Some(Design::Shifts { shifts });
    }
    problem::external::described(&spec, description).map_err(located)
}

/// A design with the content of its file, so that the trial's hash depends on the content; other designs unchanged.
fn with_design(
    key: &str,
    design: Option<&Design>,
    layout: &Layout,
    source: &Source,
) -> Result<Option<Design>, SpecError> {
    let Some(Design::File(file)) = design else { return Ok(design.cloned()) };
    let path = source.file.parent().unwrap_or(Path::new("")).join(file);
    let shifts = design::read(&path, layout).map_err(|e| unread(key, file, &path, &e, source))?;
    Ok(Some(Design::Shifts { shifts }))
}

/// Placement `p` of a body. Excludes driven units: their motion is prescribed, whatever the body does.
fn placement(body: &Body, layout: &Layout, p: u64, clamped: &[usize]) -> Vec<usize> {
    layout.placement(p, &[clamped, &problem::driven(body)].concat())
}

/// The stimuli with absolute paths of their records, for workers, and the digest of the contents.
fn with_records(stimuli: &Stimuli, source: &Source) -> Result<Stimuli, SpecError> {
    let mut stimuli = stimuli.clone();
    if let Some(recorded) = &mut stimuli.recorded {
        let folder = source.file.parent().unwrap_or(Path::new(""));
        for file in &mut recorded.files {
            let path = folder.join(&*file);
            let fault = |e: std::io::Error| {
                let remedy = format!("cannot be read: {e}{}", from_where(&path));
                source.error_with("stimuli.recorded.files", Some(&format!("{file:?}")), &remedy)
            };
            *file = path.canonicalize().map_err(fault)?;
            if file.to_str().is_none() {
                let shown = file.display().to_string();
                return Err(source.error_with("stimuli.recorded.files", Some(&shown), "must be UTF-8"));
            }
        }
        distinct(&recorded.files, "stimuli.recorded.files", source)?;
        let located = |e: Invalid| source.error_with(&e.key, Some(&e.value), &e.remedy);
        let digest = records::digest(recorded).map_err(located)?;
        recorded.digest.get_or_insert(digest);
    }
    Ok(stimuli)
}

/// A single body of a spec, for commands about designs rather than trials.
pub struct SpecBody {
    /// The body as written, with its design.
    pub body: Body,
    /// Its layout.
    pub layout: Layout,
    /// Limits of its designs.
    pub limits: Limits,
    /// Feasible designs; `None` if the trials of the sweep move the body in different ways.
    pub castable: Option<Feasible>,
    /// The initial design; it may be infeasible.
    pub initial: Vec<f64>,
    /// Clamped units.
    pub clamped: Vec<usize>,
    /// Units that are partly held.
    pub guided: Vec<usize>,
    /// Input panels for the first K of the sweep.
    pub panels: Vec<Panel>,
    /// Sensor units of the first placement for the first M of the sweep.
    pub sensors: Vec<usize>,
}

impl SpecBody {
    /// The body of a spec; `None` if the sweep has several.
    ///
    /// # Errors
    /// For the first key that is unknown or has an impossible value.
    pub fn new(source: &Source) -> Result<Option<Self>, SpecError> {
        let sweep = source.parse()?;
        let located = |e: Invalid| source.error_with(&e.key, Some(&e.value), &e.remedy);
        problem::external::polygons(&sweep.body).map_err(located)?;
        let mut combinations = axes::combinations(&sweep, source)?;
        let first = combinations.swap_remove(0).spec;
        let keeps_panels = first.feasible.keep_panels;
        let other = |spec: &SweepSpec| {
            let panels = keeps_panels && spec.sweep.panels != first.sweep.panels;
            spec.body != first.body || spec.feasible != first.feasible || panels
        };
        let panels_vary = keeps_panels && first.sweep.panels.len() > 1;
        if panels_vary || combinations.iter().any(|c| other(&c.spec)) {
            return Ok(None);
        }
        let (first, _) = size::scale_to_size(&with_file(&first, source)?).map_err(located)?;
        let layout = layout(&first.body).map_err(located)?;
        let design = with_design("body.design", first.body.design.as_ref(), &layout, source)?;
        let body = Body { design, ..first.body.clone() };
        let limits = problem::limits(&first.feasible).map_err(located)?;
        let initial = problem::initial_design(&body, &layout, limits).map_err(located)?;
        let clamped = problem::clamped(&body, &layout).map_err(located)?;
        let panels = first.sweep.panels.first().copied().unwrap_or(0);
        let sensors = first.sweep.sensors.first().copied().unwrap_or(0);
        let placed = match &first.sensors.placements {
            Some(lists) => {
                check_placements(lists, source)?;
                let units = lists.iter().find(|list| list.len() == sensors).cloned().unwrap_or_default();
                problem::check_units("sensors.placements", &units, &layout, &clamped).map_err(located)?
            }
            None => placement(&body, &layout, 0, &clamped).into_iter().take(sensors).collect(),
        };
        let units = match panels {
            0 => Vec::new(),
            _ => problem::panel_units(&body, &layout, panels).map_err(located)?,
        };
        let held = problem::held(&body, &layout).map_err(located)?;
        let kept = problem::fixed_shape_units(&first.feasible, &units, &held);
        let moves = |spec: &SweepSpec| {
            let mut frozen = spec.optimise.frozen.clone().unwrap_or_default();
            frozen.sort_unstable();
            (spec.optimise.tie.unwrap_or([1, 1]), frozen)
        };
        let moves_alike = combinations.iter().all(|c| moves(&c.spec) == moves(&first));
        let castable = problem::castable(&first.optimise, &layout, limits, &kept).map_err(located)?;
        Ok(Some(Self {
            castable: moves_alike.then_some(castable),
            limits,
            initial,
            guided: held[clamped.len()..].to_vec(),
            clamped,
            panels: problem::panels(&body, &units, &layout),
            sensors: placed,
            body,
            layout,
        }))
    }

    /// The body of a trial.
    ///
    /// # Errors
    /// If the values are impossible; the trials of a plan are valid.
    pub fn of_trial(trial: &TrialSpec) -> Result<Self, Invalid> {
        problem::external::polygons(&trial.body)?;
        let layout = problem::layout(&trial.body)?;
        let limits = problem::limits(&trial.feasible)?;
        let (clamped, held) = (problem::clamped(&trial.body, &layout)?, problem::held(&trial.body, &layout)?);
        let kept = problem::fixed_shape_units(&trial.feasible, &trial.panel_units, &held);
        Ok(Self {
            castable: Some(problem::castable(&trial.optimise, &layout, limits, &kept)?),
            limits,
            initial: problem::initial_design(&trial.body, &layout, limits)?,
            guided: held[clamped.len()..].to_vec(),
            clamped,
            panels: problem::panels(&trial.body, &trial.panel_units, &layout),
            sensors: trial.sensor_units.clone(),
            body: trial.body.clone(),
            layout,
        })
    }
}

/// The layout of a body in a spec. Specs of circular bodies must omit rows; only their trials have them, equal to columns.
fn layout(body: &Body) -> Result<Layout, Invalid> {
    match (body.layout, body.rows) {
        (LayoutKind::Circular, Some(rows)) => Err(Invalid {
            key: "body.rows".into(),
            value: rows.to_string(),
            remedy: "must be left out for a circular body: body.columns counts its units across".into(),
        }),
        _ => problem::layout(body),
    }
}

/// The common part of the trials of a point, in a canonical form, so that equal trials have equal hashes.
fn template(spec: &SweepSpec, scale: f64, panels: usize, panel_units: &[usize], sensors: usize) -> TrialSpec {
    let mut body = spec.body.clone();
    body.panel_units = None;
    body.panels.truncate(panels);
    body.panel_angle = body.panel_angle.filter(|angle| *angle != 0.0);
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
        feasible: spec.feasible,
        point: Point { panels, sensors, placement: 0, seed: 0 },
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

fn trials(spec: &SweepSpec, points: &[PointPlan]) -> Vec<Trial> {
    let mut trials = Vec::new();
    let mut seen = HashSet::new();
    let most_placements = points.iter().map(|p| p.placements.len()).max().unwrap_or(0);
    for (s, &seed) in spec.sweep.seeds.iter().enumerate() {
        let own = spec.sweep.placements * s..spec.sweep.placements * (s + 1);
        for placement in if spec.sweep.own_placements { own } else { 0..most_placements } {
            for point in points {
                let Some(units) = point.placements.get(placement) else { continue };
                if point.excluded.iter().any(|e| e.holds(placement, seed)) {
                    continue;
                }
                let spec = at(&point.template, placement, units, seed);
                let hash = spec.hash();
                // Different axis values may give the same trial.
                if seen.insert(hash.clone()) {
                    trials.push(Trial {
                        hash,
                        training: point.training.at(&spec),
                        trains: true,
                        spec,
                        order: trials.len(),
                        units: point.units,
                        design_parameters: point.design_parameters,
                        brain_parameters: point.brain_parameters,
                        cost: point.cost.0,
                        weight: point.cost.1,
                        pause: None,
                    });
                }
            }
        }
    }
    cost::first_trains(&mut trials);
    trials
}
