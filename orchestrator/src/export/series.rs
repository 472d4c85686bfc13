//! A trial's time series as one long table, one row per sample and instant.

use metasense_lab::replay::Replay;
use serde_json::{Value, json};

use super::bands;
use crate::analysis::BodyState;
use crate::look::{Table, row};
use crate::reader::StoredTrial;

/// Forces (N), signals (mm/s², rad/s), predictions and their bands (N) of both bodies. `set` is train, test or holdout; `time` in s.
pub fn table(stored: &StoredTrial, replays: &[Replay; 2]) -> Table {
    let (panels, sensors, instants) =
        (stored.spec().panel_units.len(), stored.spec().point.sensors, stored.spec().time.samples);
    let (read, signals) = (stored.spec().sensors.read(), stored.spec().signals());
    let mut columns: Vec<String> = ["sample", "set", "time"].map(String::from).to_vec();
    columns.extend((0..panels).map(|k| format!("force_{k}")));
    // per body, the values after its signals: predictions and limits of bands (N, T, K)
    let mut prediction_columns: [Vec<Vec<f64>>; 2] = Default::default();
    for body in BodyState::ALL {
        let (name, replay) = (body.name(), &replays[body as usize]);
        for m in 0..sensors {
            columns.extend(read.iter().map(|c| format!("{}_{m}_{name}", c.name())));
        }
        let own = (!replay.predictions.is_empty()).then(|| ("prediction".into(), replay.predictions.clone()));
        for (of, values) in own.into_iter().chain(bands(stored, replay, body as usize)) {
            columns.extend((0..panels).map(|k| format!("{of}_{k}_{name}")));
            prediction_columns[body as usize].push(values);
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
            for (replay, own) in replays.iter().zip(&prediction_columns) {
                row.extend(replay.signals[at * signals..][..signals].iter().map(|v| json!(v)));
                let predicted = own.iter().flat_map(|values| &values[at * panels..][..panels]);
                row.extend(predicted.map(|v| json!(v)));
            }
            rows.push(row);
        }
    }
    Table { columns, rows }
}
