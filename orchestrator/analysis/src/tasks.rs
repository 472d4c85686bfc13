//! Other sensing tasks than force histories: errors on the initial and the trained body.

use super::numbers::distinct;
use super::paired::Ratio;
use super::trial::Cluster;
use metasense_render::{Table, row};

/// Result of a task on both bodies of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskResult {
    /// Group of the trial: equal K, M and decoder in training.
    pub setting: String,
    /// Placement and seed.
    pub cluster: Cluster,
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

/// Returns one row per setting, task and readout: means over trials, and the ratio initial/trained with its 95 % interval over
/// placements and seeds.
pub fn table(all: &[TaskResult]) -> Table {
    let columns = "setting task readout unit trials trivial initial optimised ratio ratio_low ratio_high";
    let kinds = distinct(all.iter().map(|read| (&read.setting, read.task, read.readout)));
    let line = |(setting, task, readout): (&String, (&'static str, &'static str), &'static str)| {
        let own: Vec<&TaskResult> = all
            .iter()
            .filter(|read| (&read.setting, read.task, read.readout) == (setting, task, readout))
            .collect();
        let ratio = |read: &&TaskResult| {
            let [initial, trained] =
                read.errors.map(|error| error.max(read.error_min).max(f64::MIN_POSITIVE));
            (read.cluster, initial / trained)
        };
        let found = Ratio::of(&own.iter().map(ratio).collect::<Vec<_>>());
        let mean =
            |of: &dyn Fn(&TaskResult) -> f64| own.iter().map(|read| of(read)).sum::<f64>() / own.len() as f64;
        let interval = found.as_ref().and_then(|ratio| ratio.interval);
        let head = row![
            setting,
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

#[cfg(test)]
mod tests;
