//! The table of tasks other than forces in the authors' scene.

use super::rows::{Row, number, only_row, rows, short, with_interval};
use super::table;

/// One line per noise, task and readout: means over seeds, and the ratio of the errors of the initial and the trained body. In the
/// ratio, an error counts at least as half of one sample's.
pub fn tasks() -> String {
    let all = rows("tasks/rows.csv");
    let mut lines = Vec::new();
    for (noise, words) in [("0", "none"), ("0.03", "3 %")] {
        for task in ["panel", "count", "peak", "impulse", "onset"] {
            let own = |readout: &str, body: &str| -> Vec<&Row> {
                let cells = [noise, task, readout, body];
                let is_own = |row: &&Row| {
                    ["noise", "task", "readout", "body"].iter().zip(cells).all(|(n, c)| row[*n] == c)
                };
                all.iter().filter(is_own).collect()
            };
            let mean = |rows: &[&Row], column: &str| {
                let mean = rows.iter().map(|row| number(row, column)).sum::<f64>() / rows.len() as f64;
                if mean == 0.0 { "0".to_owned() } else { short(&mean.to_string()) }
            };
            let cell = |readout: &str| {
                let (initial, trained) = (own(readout, "initial"), own(readout, "optimised"));
                let logs: Vec<f64> = initial
                    .iter()
                    .map(|before| {
                        let wanted =
                            [("noise", noise), ("task", task), ("readout", readout), ("body", "optimised")];
                        let same = [&wanted[..], &[("seed", before["seed"].as_str())]].concat();
                        let [a, b] = [before, only_row(&all, &same)]
                            .map(|row| number(row, "error").max(number(row, "least")));
                        (a / b).ln()
                    })
                    .collect();
                let [a, b] = [&initial, &trained].map(|rows| mean(rows, "error"));
                format!("{a} → {b}, {}", with_interval(&logs, f64::exp))
            };
            let first = own("direct", "initial");
            let head = [words, task, &first[0]["unit"]].map(str::to_owned);
            let rest = vec![mean(&first, "trivial"), cell("direct"), cell("decoded")];
            lines.push([head.to_vec(), rest].concat());
        }
    }
    let columns = ["noise", "task", "unit", "error without signals", "direct, gain", "decoded, gain"];
    table(&columns, lines)
}
