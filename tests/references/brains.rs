//! The tables of brains and of where sensors are.

use super::rows::{Row, brain, change, geometric, number, of, one, percent, ratio, rows};
use super::table;

/// `setting` of a table of answers.
pub(super) fn setting(stimuli: &str, noise: &str) -> String {
    let noise = if noise.is_empty() { String::new() } else { format!("sensors.noise = {noise}, ") };
    format!("K = 2, M = 1, {noise}stimuli.kind = {stimuli}")
}

const STIMULI: [(&str, &str); 2] = [("bell", "smooth pulses"), ("irregular", "hammer blows")];

pub fn brains() -> String {
    let all = rows("brains-two-core/answer-brains.csv");
    let mut lines = Vec::new();
    for (kind, words) in STIMULI {
        for (noise, percent) in [("", "none"), ("0.01", "1 %"), ("0.03", "3 %"), ("0.1", "10 %")] {
            let setting = setting(kind, noise);
            let own = |name: &str, memory: &str| {
                let wanted =
                    [("setting", &*setting), ("trained_with", name), ("read_by", name), ("before", memory)];
                // Of the linear brain there are shorter waits, too.
                let after = [("after", memory)];
                change(one(&all, &[&wanted[..], &after].concat()))
            };
            let read = |name: &str| {
                let wanted = [("setting", &*setting), ("trained_with", name), ("read_by", "linear")];
                change(one(&all, &[&wanted[..], &[("before", "0.995"), ("after", "0.995")]].concat()))
            };
            lines.push(vec![
                words.to_owned(),
                percent.to_owned(),
                own("cnn", "0.01"),
                own("long", "0.42"),
                own("linear", "0.995"),
                read("cnn"),
                read("long"),
            ]);
        }
    }
    table(
        &[
            "stimuli",
            "sensor noise",
            "the paper's network",
            "long network",
            "linear brain",
            "bodies of the paper's network, read by the linear brain",
            "bodies of the long network, read by the linear brain",
        ],
        lines,
    )
}

pub fn linear_bodies() -> String {
    let all = rows("fig2-linear/answer-brains.csv");
    let line = |reader: &str| {
        let mut cells = vec![brain(reader).to_owned()];
        for (kind, _) in STIMULI {
            let setting = setting(kind, "");
            let wanted = [("setting", &*setting), ("trained_with", "linear"), ("read_by", reader)];
            // A linear brain reads by shorter memories, too: the longest comes first.
            cells.push(change(of(&all, &wanted).find(|row| row["after"] == row["before"]).unwrap()));
        }
        cells
    };
    let readers = ["cnn", "long", "linear", "stacked", "stacked, long"];
    table(&["read by", "smooth pulses", "hammer blows"], readers.map(line))
}

pub fn placed() -> String {
    let all = rows("placed-two-core/answer-placed.csv");
    let readers = [
        ("linear brain", "K = 4, linear, stimuli.kind = bell"),
        ("long network", "K = 4, trained with linear, read by long, stimuli.kind = bell"),
    ];
    let mut lines = Vec::new();
    for (reader, setting) in readers {
        let by_sensors = |cell: &dyn Fn(&Row) -> String| {
            ["1", "2", "3", "4", "5", "6"]
                .map(|m| cell(one(&all, &[("setting", setting), ("set", "holdout"), ("M", m)])))
        };
        for (what, name) in [
            ("initial body, sensors at random", "random_initial"),
            ("initial body, sensors placed", "placed_initial"),
            ("trained body, sensors at random", "random_optimised"),
            ("trained body, sensors placed", "placed_optimised"),
        ] {
            let cells = by_sensors(&|row| percent(row, name));
            lines.push([vec![reader.to_owned(), what.to_owned()], cells.to_vec()].concat());
        }
        for (what, name) in [
            ("gain by placing, initial body", "by_placing"),
            ("gain by training, sensors placed", "by_training"),
        ] {
            let (low, high) = (format!("{name}_low"), format!("{name}_high"));
            let cells = by_sensors(&|row| ratio(row, name, &low, &high));
            lines.push([vec![reader.to_owned(), what.to_owned()], cells.to_vec()].concat());
        }
    }
    table(&["read by", "", "M = 1", "2", "3", "4", "5", "6"], lines)
}

/// Error against the number of sensors, for the bodies of Figs. 4B and 4C.
pub fn sensors() -> String {
    let noises = [("0.0", "without noise"), ("0.03", "3 % noise")];
    let four = noises.into_iter().flat_map(|(noise, words)| {
        [("cnn", "four-forces-map-network"), ("linear", "four-forces-map")].map(|(name, folder)| {
            let mut all = rows(&format!("{folder}/trials.csv"));
            let middle = |row: &Row| row["noise"] == noise && !["4", "5"].contains(&&*row["placement"]);
            all.retain(|row| middle(row) && super::map::is_middle(row));
            (format!("K = 4, {}, {words}", brain(name)), all)
        })
    });
    let eight = ["cnn", "linear"].map(|name| {
        let mut all = rows("eight-forces-map/trials.csv");
        all.retain(|row| row["brain"] == name);
        (format!("K = 8, {}, 3 % noise", brain(name)), all)
    });
    let line = |(words, all): (String, Vec<Row>)| {
        let cell = |m: &str| {
            let error = |body: &str| {
                geometric(
                    of(&all, &[("sensors", m)]).map(|row| number(row, &format!("holdout_error_{body}"))),
                )
            };
            match of(&all, &[("sensors", m)]).count() {
                0 => String::new(),
                _ => format!("{} → {} %", error("initial"), error("optimised")),
            }
        };
        [vec![words], ["1", "2", "3", "4", "6"].map(cell).to_vec()].concat()
    };
    table(&["", "M = 1", "2", "3", "4", "6"], four.chain(eight).map(line))
}

/// The brain of a row of evidence and what else sets the row apart; `None` for rows beside the main ones.
pub(super) fn with(text: &str) -> Option<(&str, String)> {
    let (brain, rest) = text.split_once(", ").unwrap_or((text, ""));
    let rest = rest.replace("sensors.noise = 0.03", "3 % noise");
    let is_main = rest.split(", ").all(|part| ["", "3 % noise", "in %", "in logarithms"].contains(&part));
    match (brain, &*rest) {
        ("cnn" | "long", "evaluation.seeds = 3") => Some((brain, String::new())),
        ("cnn", "evaluation.seeds = 1") => Some((brain, "one network a body".into())),
        ("cnn" | "long", _) if is_main => Some((brain, rest)),
        ("linear", _) => Some((brain, rest)),
        _ => None,
    }
}
