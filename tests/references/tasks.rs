//! The tables of tasks other than forces in the authors' scene.

use metasense::analysis::numbers::{correlation, ranks};

use super::rows::{Row, number, of, only_row, rounded_mean, rows, seeds, short, with_interval};
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
            rounded_mean(&of(&all, &wanted).map(|row| number(row, column)).collect::<Vec<_>>())
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

/// Mean error of positions (mm) of a readout, 20 ms after contact, on the initial body or one trained for positions.
pub fn position_error(readout: &str, body: &str) -> String {
    let training = [("trained_for", "position"), ("task", "position"), ("window", "20")];
    let wanted = [&training[..], &[("readout", readout), ("body", body)]].concat();
    let all = rows("position/rows.csv");
    rounded_mean(&of(&all, &wanted).map(|row| number(row, "error")).collect::<Vec<_>>())
}

/// One line per training, window and readout of `position-two-core`: means over seeds, and the ratio of the errors of the initial and
/// the trained body. In the ratio, an error counts at least as half of one sample's.
pub fn position() -> String {
    let all = rows("position/rows.csv");
    let line = |(training, task, window, readout): (&str, &str, &str, &str)| {
        let wanted = [("trained_for", training), ("task", task), ("window", window), ("readout", readout)];
        let column = |body: &str, name: &str| -> Vec<f64> {
            of(&all, &[&wanted[..], &[("body", body)]].concat()).map(|row| number(row, name)).collect()
        };
        let [initial, trained] = ["initial", "optimised"].map(|body| column(body, "error"));
        let compared = initial.iter().zip(&trained).zip(column("initial", "least"));
        let logs: Vec<f64> = compared.map(|((a, b), least)| (a.max(least) / b.max(least)).ln()).collect();
        let first = of(&all, &wanted).next().expect("rows of the task").clone();
        let signals = if window.is_empty() { "record".to_owned() } else { format!("{window} ms") };
        let head = [training, task, &signals, readout, first["unit"].as_str()].map(str::to_owned);
        let trivial = rounded_mean(&column("initial", "trivial"));
        let shown = [&initial, &trained].map(|errors| with_interval(errors, |error| error));
        [&head[..], &[trivial], &shown, &[with_interval(&logs, f64::exp)]].concat()
    };
    let mut kinds = vec![("forces", "position", "", "decoded")];
    for (training, task) in [("forces", "position"), ("position", "position"), ("panel", "panel")] {
        kinds.push((training, task, "", "direct"));
        let windows = ["20", "50"].into_iter().flat_map(|window| [(window, "direct"), (window, "network")]);
        kinds.extend(windows.map(|(window, readout)| (training, task, window, readout)));
    }
    let columns = [
        "trained for",
        "task",
        "signals",
        "readout",
        "unit",
        "without signals",
        "initial",
        "trained",
        "gain",
    ];
    table(&columns, kinds.into_iter().map(line))
}

/// One line per measure of memory and nonlinearity: means over seeds per training, and the rank correlation, over trainings, of the
/// trained body's measure with the error of the forces and of the position (decoded): mean over seeds.
pub fn capacity() -> String {
    let (all, errors) = (rows("tasks/capacity.csv"), rows("tasks/transfer.csv"));
    let seeds = seeds(&all);
    let value = |measure: &str, training: &str, body: &str, seed: &str| {
        let wanted = [("measure", measure), ("trained_for", training), ("body", body), ("seed", seed)];
        number(only_row(&all, &wanted), "value")
    };
    let error = |task: &str, training: &str, seed: &str| {
        let wanted = [("task", task), ("readout", "decoded"), ("body", "optimised")];
        let own = [&wanted[..], &[("trained_for", training), ("seed", seed)]].concat();
        number(only_row(&errors, &own), "error")
    };
    let line = |measure: &&str| {
        let mean = |training: &str, body: &str| {
            let values = seeds.iter().map(|seed| value(measure, training, body, seed));
            rounded_mean(&values.collect::<Vec<_>>())
        };
        let with_errors = |task: &str| {
            let of_seed = |seed: &&str| {
                let measures = TRAININGS.map(|training| value(measure, training, "optimised", seed));
                let errors = TRAININGS.map(|training| error(task, training, seed));
                correlation(&ranks(&measures), &ranks(&errors)).expect("they differ")
            };
            with_interval(&seeds.iter().map(of_seed).collect::<Vec<_>>(), |rank| rank)
        };
        let trained = ["forces", "impulse", "onset", "all"].map(|training| mean(training, "optimised"));
        let head = vec![(*measure).to_owned(), mean("forces", "initial")];
        [head, trained.to_vec(), ["forces", "position"].map(with_errors).to_vec()].concat()
    };
    let measures = ["memory", "degree 2", "degree 3", "total", "narma-2", "narma-5", "narma-10"];
    let columns = [
        "measure",
        "initial",
        "trained for forces",
        "for impulse",
        "for onset",
        "for all",
        "correlation with the error of forces",
        "of position",
    ];
    table(&columns, measures.iter().map(line))
}
