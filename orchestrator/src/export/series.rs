//! A trial's time series as one long table: a row a sample and instant.

use metasense_worker::replay::Replay;
use serde_json::{Value, json};

use crate::analysis::Body;
use crate::look::{Table, row};
use crate::store::Stored;

/// Forces (N), signals (mm/s², rad/s) and predictions (N) of both bodies. `set` is train, test or holdout; `time` in s.
pub fn table(stored: &Stored, replays: &[Replay; 2]) -> Table {
    let (panels, sensors, instants) =
        (stored.spec().panel_units.len(), stored.spec().point.sensors, stored.spec().time.samples);
    let (read, signals) = (stored.spec().sensors.read(), stored.spec().signals());
    let mut columns: Vec<String> = ["sample", "set", "time"].map(String::from).to_vec();
    columns.extend((0..panels).map(|k| format!("force_{k}")));
    for body in Body::ALL {
        for m in 0..sensors {
            columns.extend(read.iter().map(|c| format!("{}_{m}_{}", c.name(), body.name())));
        }
        if !replays[body as usize].predictions.is_empty() {
            columns.extend((0..panels).map(|k| format!("prediction_{k}_{}", body.name())));
        }
    }
    let mut rows = Vec::with_capacity(replays[0].forces.samples * instants);
    for (sample, kind) in replays[0].split.iter().enumerate() {
        let set = ["train", "test", "holdout"][usize::from(*kind)];
        for n in 1..=instants {
            let time = n as f64 * stored.spec().time.duration / instants as f64;
            let mut row: Vec<Value> = row![sample, set, time];
            let forces = &replays[0].forces.values;
            row.extend((0..panels).map(|k| json!(forces[(sample * panels + k) * (instants + 1) + n])));
            let at = sample * instants + n - 1;
            for replay in replays {
                row.extend(replay.signals[at * signals..][..signals].iter().map(|v| json!(v)));
                if !replay.predictions.is_empty() {
                    row.extend(replay.predictions[at * panels..][..panels].iter().map(|v| json!(v)));
                }
            }
            rows.push(row);
        }
    }
    Table { columns, rows }
}
