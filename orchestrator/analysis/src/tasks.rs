//! Sensing tasks beside the force histories: how much better the trained body serves them than the initial one.

use super::numbers::distinct;
use super::paired::Ratio;
use super::trial::Cluster;
use metasense_render::{Table, row};

/// A task on both bodies of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Read {
    /// Which trials it belongs to: those of the same K and M, trained with the same decoder.
    pub setting: String,
    /// Its placement and seed.
    pub cluster: Cluster,
    /// Task and unit of its error.
    pub task: (&'static str, &'static str),
    /// How it is read.
    pub readout: &'static str,
    /// Errors on the held-out set, of the initial and of the trained body.
    pub errors: [f64; 2],
    /// The error without signals.
    pub trivial: f64,
    /// What an error counts at least in a ratio.
    pub least: f64,
}

/// A row per setting, task and readout: means over trials, and the ratio initial over trained with its 95 % interval over placements and
/// seeds. In the ratio an error counts as half of one sample's at least.
pub fn table(all: &[Read]) -> Table {
    let columns = "setting task readout unit trials trivial initial optimised ratio ratio_low ratio_high";
    let kinds = distinct(all.iter().map(|read| (&read.setting, read.task, read.readout)));
    let line = |(setting, task, readout): (&String, (&'static str, &'static str), &'static str)| {
        let own: Vec<&Read> = all
            .iter()
            .filter(|read| (&read.setting, read.task, read.readout) == (setting, task, readout))
            .collect();
        let ratio = |read: &&Read| {
            let [initial, trained] = read.errors.map(|error| error.max(read.least).max(f64::MIN_POSITIVE));
            (read.cluster, initial / trained)
        };
        let found = Ratio::of(&own.iter().map(ratio).collect::<Vec<_>>());
        let mean =
            |of: &dyn Fn(&Read) -> f64| own.iter().map(|read| of(read)).sum::<f64>() / own.len() as f64;
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
