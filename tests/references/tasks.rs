//! The tables of tasks other than forces in the authors' scene.

use super::rows::{Row, number, of, only_row, rows, seeds, short, with_interval};
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

/// Trainings of the transfer matrix.
const TRAININGS: [&str; 8] = ["forces", "panel", "count", "position", "peak", "impulse", "onset", "all"];

/// One line per training, one column per task: the ratio of the errors of the initial and the trained body. Below, the part of the
/// specialist's gain (a ratio of mean logarithms) that the trainings for forces and for all tasks keep.
pub fn transfer() -> String {
    let all = rows("tasks/transfer.csv");
    let seeds = seeds(&all);
    let logs = |training: &str, task: &str| -> Vec<f64> {
        let ratio = |seed: &&str| {
            let readout = if task == "forces" { "decoded" } else { "direct" };
            let own = [("seed", *seed), ("trained_for", training), ("task", task), ("readout", readout)];
            let error = |body| {
                let row = only_row(&all, &[&own[..], &[("body", body)]].concat());
                number(row, "error").max(number(row, "least"))
            };
            (error("initial") / error("optimised")).ln()
        };
        seeds.iter().map(ratio).collect()
    };
    let tasks = &TRAININGS[..7];
    let line = |training: &&str| {
        let cells = tasks.iter().map(|task| with_interval(&logs(training, task), f64::exp));
        std::iter::once((*training).to_owned()).chain(cells).collect::<Vec<_>>()
    };
    let kept = |training: &str| {
        let cell = |task: &&str| {
            let [own, specialist] = [training, task].map(|of| logs(of, task).iter().sum::<f64>());
            short(&(own / specialist).to_string())
        };
        let head = format!("{training}: part kept of the specialist's gain");
        std::iter::once(head).chain(tasks.iter().map(cell)).collect::<Vec<_>>()
    };
    let columns = [&["trained for"], tasks].concat();
    table(&columns, TRAININGS.iter().map(line).chain(["forces", "all"].map(kept)))
}

/// One line per task: mean errors over seeds of the decoded readout, on initial and on trained bodies.
pub fn decoded() -> String {
    let all = rows("tasks/transfer.csv");
    let line = |task: &&str| {
        let mean = |training: &str, body: &str, column: &str| {
            let wanted = [("trained_for", training), ("task", task), ("readout", "decoded"), ("body", body)];
            let own: Vec<f64> = of(&all, &wanted).map(|row| number(row, column)).collect();
            short(&(own.iter().sum::<f64>() / own.len() as f64).to_string())
        };
        let first = of(&all, &[("task", task)]).next().expect("rows of the task").clone();
        let trained = ["forces", "impulse", "all"].map(|training| mean(training, "optimised", "error"));
        let head = [task, first["unit"].as_str()].map(str::to_owned);
        let initial = ["trivial", "error"].map(|column| mean("forces", "initial", column));
        [&head[..], &initial, &trained].concat()
    };
    let columns =
        ["task", "unit", "without signals", "initial", "trained for forces", "for impulse", "for all"];
    table(&columns, TRAININGS[..7].iter().map(line))
}
