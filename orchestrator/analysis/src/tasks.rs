//! Other sensing tasks than force histories: errors on the initial and the trained body.

use super::numbers::distinct;
use super::paired::Ratio;
use super::trial::Cluster;
use metasense_render::{Table, row};
use serde_json::Value;

/// Result of a task on both bodies of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskResult {
    /// Group of the trial: equal K, M and decoder in training.
    pub setting: String,
    /// Placement and seed.
    pub cluster: Cluster,
    /// Task for which the body was trained.
    pub trained_for: String,
    /// Task and unit of its error.
    pub task: (&'static str, &'static str),
    /// Readout: from signals or from estimated forces.
    pub readout: &'static str,
    /// Errors on the held-out set, of the initial and the trained body.
    pub errors: [f64; 2],
    /// Error of the best estimate without signals.
    pub trivial: f64,
    /// Lower bound of errors in a ratio: half of the error that one wrong sample causes, or 0.
    pub error_min: f64,
}

impl TaskResult {
    fn kind(&self) -> (&String, (&'static str, &'static str), &'static str) {
        (&self.setting, self.task, self.readout)
    }
}

/// Ratio initial/trained over these trials.
fn ratio(own: &[&TaskResult]) -> Option<Ratio> {
    let of = |read: &&TaskResult| {
        let [initial, trained] = read.errors.map(|error| error.max(read.error_min).max(f64::MIN_POSITIVE));
        (read.cluster, initial / trained)
    };
    Ratio::of(&own.iter().map(of).collect::<Vec<_>>())
}

/// Returns one row per setting, training, task and readout: means over trials, and the ratio initial/trained with its 95 % interval
/// over placements and seeds.
pub fn table(all: &[TaskResult]) -> Table {
    let columns =
        "setting trained_for task readout unit trials trivial initial optimised ratio ratio_low ratio_high";
    let kinds = distinct(all.iter().map(|read| (&read.trained_for, read.kind())));
    let line = |kind: (&String, (&String, (&'static str, &'static str), &'static str))| {
        let own: Vec<&TaskResult> =
            all.iter().filter(|read| (&read.trained_for, read.kind()) == kind).collect();
        let (trained_for, (setting, task, readout)) = kind;
        let found = ratio(&own);
        let mean =
            |of: &dyn Fn(&TaskResult) -> f64| own.iter().map(|read| of(read)).sum::<f64>() / own.len() as f64;
        let interval = found.as_ref().and_then(|ratio| ratio.interval);
        let head = row![
            setting,
            trained_for,
            task.0,
            readout,
            task.1,
            own.len(),
            mean(&|read| read.trivial),
            mean(&|read| read.errors[0]),
            mean(&|read| read.errors[1])
        ];
        let [low, high] = [interval.map(|i| i.low), interval.map(|i| i.high)];
        [head, row![found.map(|ratio| ratio.ratio), low, high]].concat()
    };
    Table::new(columns, kinds.into_iter().map(line))
}

/// Returns the transfer matrix: per setting, task and readout one row, per training one column with the ratio initial/trained and
/// its 95 % interval. `None` if all bodies were trained for one task.
pub fn matrix(all: &[TaskResult]) -> Option<Table> {
    let trainings = distinct(all.iter().map(|read| &read.trained_for));
    if trainings.len() < 2 {
        return None;
    }
    let line = |kind: (&String, (&'static str, &'static str), &'static str)| {
        let cell = |training: &&String| {
            let is_own = |read: &&TaskResult| read.kind() == kind && read.trained_for == **training;
            let Some(found) = ratio(&all.iter().filter(is_own).collect::<Vec<_>>()) else {
                return Value::Null;
            };
            let short = |x: f64| if x < 9.95 { format!("{x:.2}") } else { format!("{x:.1}") };
            let interval = found.interval.map(|i| format!(" ({} … {})", short(i.low), short(i.high)));
            Value::from(format!("{}{}", short(found.ratio), interval.unwrap_or_default()))
        };
        let head = row![kind.0, kind.1.0, kind.2];
        head.into_iter().chain(trainings.iter().map(cell)).collect::<Vec<Value>>()
    };
    let names: Vec<&str> = trainings.iter().map(|training| training.as_str()).collect();
    let columns = format!("setting task readout {}", names.join(" "));
    Some(Table::new(&columns, distinct(all.iter().map(TaskResult::kind)).into_iter().map(line)))
}

#[cfg(test)]
mod tests;
