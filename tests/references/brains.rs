//! The tables of decoders and of sensor placements.

use super::map::{SETTINGS, is_first_placement, of_setting};
use super::rows::{Row, brain, change, geometric, number, of, only_row, percent, ratio, rows};
use super::table;

/// Value of `setting` in a table of answers.
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
                // Linear decoders also have rows with shorter delays.
                let after = [("after", memory)];
                change(only_row(&all, &[&wanted[..], &after].concat()))
            };
            let read = |name: &str| {
                let wanted = [("setting", &*setting), ("trained_with", name), ("read_by", "linear")];
                change(only_row(&all, &[&wanted[..], &[("before", "0.995"), ("after", "0.995")]].concat()))
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
            "linear decoder",
            "linear decoder on bodies of the paper's network",
            "linear decoder on bodies of the long network",
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
            // Linear decoders also have rows with shorter memories, after the longest.
            cells.push(change(of(&all, &wanted).find(|row| row["after"] == row["before"]).unwrap()));
        }
        cells
    };
    let readers = ["cnn", "long", "linear", "stacked", "stacked, long"];
    table(&["decoder", "smooth pulses", "hammer blows"], readers.map(line))
}

pub fn placed() -> String {
    let all = rows("placed-two-core/answer-placed.csv");
    let readers = [
        ("linear decoder", "K = 4, linear, stimuli.kind = bell"),
        ("long network", "K = 4, trained with linear, read by long, stimuli.kind = bell"),
    ];
    let mut lines = Vec::new();
    for (reader, setting) in readers {
        let by_sensors = |cell: &dyn Fn(&Row) -> String| {
            ["1", "2", "3", "4", "5", "6"]
                .map(|m| cell(only_row(&all, &[("setting", setting), ("set", "holdout"), ("M", m)])))
        };
        for (what, name) in [
            ("initial body, random sensors", "random_initial"),
            ("initial body, placed sensors", "placed_initial"),
            ("trained body, random sensors", "random_optimised"),
            ("trained body, placed sensors", "placed_optimised"),
        ] {
            let cells = by_sensors(&|row| percent(row, name));
            lines.push([vec![reader.to_owned(), what.to_owned()], cells.to_vec()].concat());
        }
        for (what, name) in [
            ("gain by placement, initial body", "by_placing"),
            ("gain by training, placed sensors", "by_training"),
        ] {
            let (low, high) = (format!("{name}_low"), format!("{name}_high"));
            let cells = by_sensors(&|row| ratio(row, name, &low, &high));
            lines.push([vec![reader.to_owned(), what.to_owned()], cells.to_vec()].concat());
        }
    }
    table(&["decoder", "", "M = 1", "2", "3", "4", "5", "6"], lines)
}

/// Error against the number of sensors, for the bodies of Figs. 4B and 4C.
pub fn sensors() -> String {
    let files = [("cnn", "four-forces-map-network"), ("linear", "four-forces-map")];
    let four = files.map(|(name, folder)| (name, rows(&format!("{folder}/trials.csv"))));
    let eight = rows("eight-forces-map/trials.csv");
    let mut curves: Vec<(String, Vec<&Row>)> = Vec::new();
    for (n, noise) in ["3 % noise", "without noise"].iter().enumerate() {
        for (name, rows) in &four {
            let mut own = of_setting(rows, SETTINGS[n]);
            own.retain(|row| is_first_placement(row));
            curves.push((format!("K = 4, {}, {noise}", brain(name)), own));
        }
    }
    for (name, _) in files {
        let own = eight.iter().filter(|row| row["brain"] == name).collect();
        curves.push((format!("K = 8, {}, 3 % noise", brain(name)), own));
    }
    let line = |(words, rows): (String, Vec<&Row>)| {
        let cell = |m: &str| {
            let here: Vec<&&Row> = rows.iter().filter(|row| row["sensors"] == m).collect();
            let error =
                |body| geometric(here.iter().map(|row| number(row, &format!("holdout_error_{body}"))));
            match here.is_empty() {
                true => String::new(),
                false => format!("{} → {} %", error("initial"), error("optimised")),
            }
        };
        [vec![words], ["1", "2", "3", "4", "6"].map(cell).to_vec()].concat()
    };
    table(&["", "M = 1", "2", "3", "4", "6"], curves.into_iter().map(line))
}

/// The decoder of a row of evidence and its other distinction; `None` for secondary rows.
pub(super) fn with(text: &str) -> Option<(&str, &str)> {
    match text.split_once(", ").unwrap_or((text, "")) {
        (brain @ ("cnn" | "long" | "linear"), "" | "evaluation.seeds = 3") => Some((brain, "")),
        ("cnn", "evaluation.seeds = 1") => Some(("cnn", "one network per body")),
        (brain @ ("cnn" | "long" | "linear"), height @ ("in %" | "in logarithms")) => Some((brain, height)),
        ("linear", rest) => Some(("linear", rest)),
        _ => None,
    }
}
