//! Other sensing tasks than force histories: errors on the initial and the trained body.

use std::collections::BTreeMap;

use super::data::{Observation, groups};
use super::elbow::{ErrorScale, elbow};
use super::numbers::distinct;
use super::paired::Ratio;
use super::tables::{interval_cells, verdict_text};
use super::trial::{BodyState, Cluster, Trial};
use metasense_render::{Table, row};
use serde_json::Value;

/// Result of a task on both bodies of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskResult {
    /// Differences from other settings, except M and the task of the training.
    pub setting: String,
    /// M: number of sensors.
    pub sensors: u64,
    /// Placement and seed.
    pub cluster: Cluster,
    /// Task for which the body was trained.
    pub trained_for: String,
    /// Task and unit of its error.
    pub task: (String, String),
    /// Readout: from signals (`direct`, `network`) or from estimated forces (`decoded`).
    pub readout: String,
    /// Errors on the held-out set, of the initial and the trained body.
    pub errors: [f64; 2],
    /// Error of the best estimate without signals.
    pub trivial: f64,
    /// Lower bound of errors in a ratio: half of the error that one wrong sample causes, or 0.
    pub error_min: f64,
}

/// Setting, number of sensors, task with its unit, readout.
type Kind<'a> = (&'a String, u64, &'a (String, String), &'a String);

impl TaskResult {
    /// What a comparison of trainings keeps equal.
    pub fn kind(&self) -> Kind<'_> {
        (&self.setting, self.sensors, &self.task, &self.readout)
    }

    /// Errors that a ratio compares, above 0.
    fn compared(&self) -> [f64; 2] {
        self.errors.map(|error| error.max(self.error_min).max(f64::MIN_POSITIVE))
    }
}

/// The task for which the body of a trial was trained.
pub fn trained_for(trial: &Trial) -> &str {
    trial.setting.text("brain.task").unwrap_or("forces")
}

/// The trials whose bodies were trained in steps, which the gain by training concerns.
pub fn in_steps<'a>(trials: impl IntoIterator<Item = &'a Trial>) -> Vec<&'a Trial> {
    trials.into_iter().filter(|trial| trial.has_steps()).collect()
}

/// Results of all trials with estimates on both bodies.
pub fn results(trials: &[&Trial]) -> Vec<TaskResult> {
    let estimated: Vec<&Trial> = trials.iter().copied().filter(|trial| !trial.tasks.is_empty()).collect();
    // the default batch differs between tasks
    let groups = groups(&estimated, &["point.sensors", "brain.task", "optimise.batch"]);
    let all = groups.iter().flat_map(|group| group.trials.iter().map(move |trial| (&group.label, *trial)));
    all.flat_map(|(setting, trial)| pairs(setting, trial)).collect()
}

/// Pairs the estimates of a trial's bodies.
fn pairs(setting: &str, trial: &Trial) -> Vec<TaskResult> {
    let of = |body: BodyState| trial.tasks.iter().filter(move |read| read.body == body.name());
    let pair = of(BodyState::Initial).filter_map(|initial| {
        let same = |read: &&_| initial.is_like(read);
        let trained = of(BodyState::Optimised).find(same)?;
        Some(TaskResult {
            setting: setting.to_owned(),
            sensors: trial.sensors,
            cluster: trial.cluster,
            trained_for: trained_for(trial).to_owned(),
            task: (initial.task.clone(), initial.unit.clone()),
            readout: initial.readout.clone(),
            errors: [initial.error?, trained.error?],
            trivial: initial.trivial?,
            error_min: initial.least,
        })
    });
    pair.collect()
}

/// Ratio initial/trained over these trials.
pub fn ratio(own: &[&TaskResult]) -> Option<Ratio> {
    let of = |read: &&TaskResult| {
        let [initial, trained] = read.compared();
        (read.cluster, initial / trained)
    };
    Ratio::of(own.iter().map(of))
}

/// Elbow of the trained body's error against M, in logarithms; `None` with too few values of M.
fn elbow_text(own: &[&TaskResult]) -> Option<String> {
    let of = |read: &&TaskResult| Observation {
        at: read.sensors as f64,
        cluster: read.cluster,
        error: read.compared()[1],
    };
    let points: Vec<Observation> = own.iter().map(of).collect();
    elbow(&points, ErrorScale::Logarithm).ok().map(|found| verdict_text(found.verdict))
}

/// Ratio of each placement, such as `0: 1.8, 1: 2.3`; `None` for a single placement.
fn by_placement(own: &[&TaskResult]) -> Option<String> {
    let placements = distinct(own.iter().map(|read| read.cluster.placement));
    let of = |placement: &u64| {
        let own: Vec<&TaskResult> =
            own.iter().copied().filter(|read| read.cluster.placement == *placement).collect();
        Some(format!("{placement}: {:.3}", ratio(&own)?.ratio))
    };
    (placements.len() > 1).then(|| placements.iter().filter_map(of).collect::<Vec<_>>().join(", "))
}

/// Returns one row per setting, M, training, task and readout: means over trials, the ratio initial/trained with its 95 % interval
/// over placements and seeds, the ratio of each placement if there are several, and the elbow of the trained body's error against
/// M, over all M.
pub fn table(all: &[TaskResult]) -> Table {
    let columns = "setting M trained_for task readout unit trials trivial initial optimised ratio ratio_low ratio_high ratio_by_placement elbow";
    let kinds = distinct(all.iter().map(|read| (&read.trained_for, read.kind())));
    // the curve against M to which a result belongs
    let curve = |read: &TaskResult| {
        (read.trained_for.clone(), read.setting.clone(), read.task.clone(), read.readout.clone())
    };
    let mut curves: BTreeMap<_, Vec<&TaskResult>> = BTreeMap::new();
    all.iter().for_each(|read| curves.entry(curve(read)).or_default().push(read));
    let elbows: BTreeMap<_, _> = curves.into_iter().map(|(key, own)| (key, elbow_text(&own))).collect();
    let line = |(trained_for, kind): (&String, Kind)| {
        let is_own = |read: &&TaskResult| &read.trained_for == trained_for && read.kind() == kind;
        let own: Vec<&TaskResult> = all.iter().filter(is_own).collect();
        let (setting, sensors, task, readout) = kind;
        let found = ratio(&own);
        let mean =
            |of: &dyn Fn(&TaskResult) -> f64| own.iter().map(|read| of(read)).sum::<f64>() / own.len() as f64;
        let head = row![setting, sensors, trained_for, task.0, readout, task.1, own.len()];
        let errors =
            row![mean(&|read| read.trivial), mean(&|read| read.errors[0]), mean(&|read| read.errors[1])];
        [head, errors, interval_cells(found.as_ref()), row![by_placement(&own), elbows[&curve(own[0])]]]
            .concat()
    };
    Table::new(columns, kinds.into_iter().map(line))
}

/// Returns the transfer matrix: per setting, M, task and readout one row, per training one column with the ratio initial/trained and
/// its 95 % interval. `None` if all bodies were trained for one task.
pub fn matrix(all: &[TaskResult]) -> Option<Table> {
    let trainings = distinct(all.iter().map(|read| &read.trained_for));
    if trainings.len() < 2 {
        return None;
    }
    let line = |kind: Kind| {
        let cell = |training: &&String| {
            let is_own = |read: &&TaskResult| read.kind() == kind && read.trained_for == **training;
            let Some(found) = ratio(&all.iter().filter(is_own).collect::<Vec<_>>()) else {
                return Value::Null;
            };
            let short = |x: f64| if x < 9.95 { format!("{x:.2}") } else { format!("{x:.1}") };
            let interval = found.interval.map(|i| format!(" ({} … {})", short(i.low), short(i.high)));
            Value::from(format!("{}{}", short(found.ratio), interval.unwrap_or_default()))
        };
        let head = row![kind.0, kind.1, kind.2.0, kind.3];
        head.into_iter().chain(trainings.iter().map(cell)).collect::<Vec<Value>>()
    };
    let names: Vec<&str> = trainings.iter().map(|training| training.as_str()).collect();
    let columns = format!("setting M task readout {}", names.join(" "));
    Some(Table::new(&columns, distinct(all.iter().map(TaskResult::kind)).into_iter().map(line)))
}

#[cfg(test)]
mod tests;
