//! The tables of casts, and of trained bodies under other conditions.

use super::rows::{
    Row, geometric, number, of, only_row, percent, ratio, rounded_mean, rows, short, spread, with_interval,
};
use super::table;

/// One line per body of the setting: its error as designed, and errors of one kind of decoders on its casts.
fn cast_lines(rows: &[Row], setting: &str, own: &str, all: &str, records: &[&str]) -> Vec<Vec<String>> {
    let mut bodies: Vec<&str> =
        rows.iter().filter(|row| row["setting"] == setting).map(|row| &*row["body"]).collect();
    bodies.dedup();
    let line = |body: &&str| {
        let by = |read_by, records| {
            only_row(
                rows,
                &[("setting", setting), ("body", body), ("read_by", read_by), ("records", records)],
            )
        };
        let mut cells = vec![words(body), percent(by(own, ""), "designed")];
        cells.extend([own, all].map(|read_by| spread(by(read_by, ""))));
        cells.extend(records.iter().map(|n| spread(by("records", n))));
        cells
    };
    bodies.iter().map(line).collect()
}

/// Description of a body's training.
fn words(body: &str) -> String {
    match body {
        "initial" => "initial body",
        "nominal" => "trained as designed",
        "mean of casts" | "mean of casts, iterations = 75" => "trained over casts",
        "mean of casts, iterations = 225" => "trained over casts, three times the steps",
        other => panic!("no words for the body {other:?}"),
    }
    .to_owned()
}

/// Errors on casts of bodies of several settings, with linear decoders and with networks.
pub fn casts() -> String {
    let rows = rows("robust-two-core/answer-casts.csv");
    let lines = |settings: &[(&str, &str)], own, all, records: &[&str]| -> Vec<Vec<String>> {
        let of = |(setting, words): &(&str, &str)| {
            let lines = cast_lines(&rows, setting, own, all, records);
            lines.into_iter().map(|line| [vec![(*words).to_owned()], line].concat()).collect::<Vec<_>>()
        };
        settings.iter().flat_map(of).collect()
    };
    let linear = [
        ("K = 2, M = 1, linear", "K = 2, M = 1"),
        ("K = 2, M = 1, linear, sensors.mass = 9e-6", "the same, chip of 9 g"),
        ("K = 4, M = 2, linear", "K = 4, M = 2"),
    ];
    let networks = [("K = 2, M = 1, cnn", "the paper's network"), ("K = 2, M = 1, long", "long network")];
    let head = ["", "body", "as designed", "cast: decoder of the design", "one decoder for all casts"];
    let records = ["calibrated on 10 records", "on 100"];
    format!(
        "{}\n{}",
        table(&[&head[..], &records].concat(), lines(&linear, "nominal", "casts", &["10", "100"])),
        table(
            &["decoder", "body", "as designed", "cast: network of the design", "one network for all casts"],
            lines(&networks, "network", "network_casts", &[])
        )
    )
}

/// Errors of bodies under forces other than their training forces.
pub fn transfer() -> String {
    let rows = rows("transfer/answer-transfer.csv");
    let mut bodies: Vec<&str> = Vec::new();
    for row in &rows {
        if !bodies.contains(&&row["body"][..]) {
            bodies.push(&row["body"]);
        }
    }
    let line = |body: &&str| -> Vec<String> {
        let read = ["bell", "irregular"].map(|under| only_row(&rows, &[("body", *body), ("under", under)]));
        let name = match *body {
            "initial" => "none: the initial body".into(),
            "bell" => "pulses".into(),
            "irregular" => "blows".into(),
            mix if mix.contains("iterations = 150") => "the same, four times the samples".to_owned(),
            mix if mix.contains("mean of parts") => "both, the mean of logarithms".to_owned(),
            _ => "both, the mean error".into(),
        };
        let own = read.map(|row| percent(row, "own"));
        let carried =
            read.map(|row| if row["carried"].is_empty() { String::new() } else { percent(row, "carried") });
        let kept = read.map(|row| match &row["kept"][..] {
            "" | "1.0" => String::new(),
            _ => ratio(row, "kept", "kept_low", "kept_high"),
        });
        [vec![name], own.to_vec(), kept.to_vec(), carried.to_vec()].concat()
    };
    let head = [
        "trained under",
        "error under pulses",
        "under blows",
        "part of the pulses' gain",
        "part of the blows' gain",
        "decoder of the training forces: pulses",
        "blows",
    ];
    table(&head, bodies.iter().map(line))
}

/// Bodies trained under pulses, simulated blows and measured blows, each evaluated under all three.
pub fn transfer_recorded() -> String {
    let rows = rows("transfer/recorded.csv");
    let line = |(body, words): (&str, &str)| {
        let read = ["bell", "irregular", "recorded"]
            .map(|under| only_row(&rows, &[("body", body), ("under", under)]));
        let kept = match body {
            "initial" | "recorded" => String::new(),
            _ => ratio(read[2], "kept", "kept_low", "kept_high"),
        };
        [vec![words.to_owned()], read.map(|row| percent(row, "own")).to_vec(), vec![kept]].concat()
    };
    let bodies = [
        ("initial", "none: the initial body"),
        ("bell", "pulses"),
        ("irregular", "simulated blows"),
        ("recorded", "measured blows"),
    ];
    let head = [
        "trained under",
        "error under pulses",
        "under simulated blows",
        "under measured blows",
        "part of the measured blows' gain",
    ];
    table(&head, bodies.map(line))
}

/// The same bodies, trained with linear decoders, evaluated with long networks.
pub fn transfer_networks() -> String {
    let all = rows("transfer/networks.csv");
    let kinds = ["bell", "irregular"];
    let errors = |body: &str, under: &str| -> Vec<f64> {
        of(&all, &[("trained_under", body), ("read_under", under)]).map(|row| number(row, "error")).collect()
    };
    let line = |(body, words): (&str, &str)| {
        let read = kinds.map(|under| format!("{} %", geometric(errors(body, under).into_iter())));
        let kept = kinds.map(|under| {
            if [under, "initial"].contains(&body) {
                return String::new();
            }
            let ends = ["initial", under].map(|other| errors(other, under));
            let own = errors(body, under);
            let part = |i: usize| (ends[0][i] / own[i]).ln() / (ends[0][i] / ends[1][i]).ln();
            let parts: Vec<f64> = (0..own.len()).map(part).collect();
            with_interval(&parts, |x| x)
        });
        [vec![words.to_owned()], read.to_vec(), kept.to_vec()].concat()
    };
    let bodies = [
        ("initial", "none: the initial body"),
        ("bell", "pulses"),
        ("irregular", "blows"),
        ("mix", "both, the mean of logarithms"),
    ];
    let head = [
        "trained under",
        "error under pulses",
        "under blows",
        "part of the pulses' gain",
        "part of the blows' gain",
    ];
    table(&head, bodies.map(line))
}

/// Errors of a body of real scale and of the reference body, per seed.
pub fn real_scale() -> String {
    let all = rows("real-scale/trials.csv");
    let scenes = [
        ("reference", "bell", "reference body, smooth pulses"),
        ("real, chip", "bell", "real scale with the chip, smooth pulses"),
        ("reference", "irregular", "reference body, hand-hammered blows"),
        ("real, chip", "irregular", "real scale with the chip, hammer blows of 6 … 15 ms"),
        ("real", "irregular", "the same without mass, range and steps of a chip"),
    ];
    let line = |(body, stimuli, words): (&str, &str, &str)| {
        let errors = |(panels, sensors): (&str, &str)| {
            let wanted = [("body", body), ("stimuli", stimuli), ("panels", panels), ("sensors", sensors)];
            let seeds: Vec<&Row> = of(&all, &wanted).collect();
            let of_seeds =
                |name: &str| seeds.iter().map(|row| short(&row[name])).collect::<Vec<_>>().join(", ");
            format!("{} → {} %", of_seeds("initial"), of_seeds("optimised"))
        };
        let cells = [("2", "1"), ("2", "2"), ("4", "1"), ("4", "2")].map(errors);
        [vec![words.to_owned()], cells.to_vec()].concat()
    };
    table(&["", "K = 2, M = 1", "K = 2, M = 2", "K = 4, M = 1", "K = 4, M = 2"], scenes.map(line))
}

/// Bodies trained over casts, evaluated with a material that the model does not contain.
pub fn relaxing() -> String {
    let all = rows("robust-two-core/relaxing.csv");
    let line = |body: &str| {
        let errors = |(reader, records): (&str, &str)| {
            let wanted = [("body", body), ("reader", reader), ("records", records)];
            let seeds: Vec<&Row> = of(&all, &wanted).collect();
            let mean = |name: &str| geometric(seeds.iter().map(|row| number(row, name)));
            format!("{} [{}] %", mean("median"), mean("percentile_90"))
        };
        let cells = [("nominal", "0"), ("casts", "0"), ("records", "10"), ("records", "100")].map(errors);
        [vec![body.to_owned()], cells.to_vec()].concat()
    };
    let bodies = [
        "initial body",
        "trained as designed",
        "trained over casts",
        "trained over casts, three times the steps",
    ];
    let head =
        ["body", "decoder of the design", "one decoder for all casts", "calibrated on 10 records", "on 100"];
    table(&head, bodies.map(line))
}

/// Coverage of prediction bands on casts: instants, whole samples.
pub fn bands() -> String {
    let all = rows("robust-two-core/bands.csv");
    let line = |(decoder, body): (&str, &str)| {
        let mean = |reader: &str, name: &str| {
            ["instant", "sample"].map(|kind| {
                let wanted = [("decoder", decoder), ("body", body), ("reader", reader), ("kind", kind)];
                rounded_mean(&of(&all, &wanted).map(|row| number(row, name)).collect::<Vec<_>>())
            })
        };
        let [own, of_casts] =
            if decoder == "linear" { ["nominal", "casts"] } else { ["network", "network_casts"] };
        let covered = |reader: &str| format!("{} %", mean(reader, "coverage").join(", "));
        let mut cells = vec![format!("{decoder}, {body}"), mean("designed", "width").join(", ")];
        cells.extend(["designed", own, of_casts].map(covered));
        cells
    };
    let bodies = ["initial", "trained as designed", "trained over casts"];
    let decoders = ["linear", "the paper's network", "long network"];
    let lines = decoders.into_iter().flat_map(|decoder| bodies.map(|body| line((decoder, body))));
    let head = [
        "decoder, body",
        "width (N)",
        "as designed",
        "casts, design's decoder",
        "casts, decoder for all casts",
    ];
    table(&head, lines)
}

/// Errors of the quickstart's bodies on casts.
pub fn quickstart_casts() -> String {
    lines("quickstart-casts.csv")
}

/// Errors of the tutorial's bodies on casts.
pub fn evening_casts() -> String {
    lines("evening-casts.csv")
}

fn lines(file: &str) -> String {
    let rows = rows(file);
    table(
        &[
            "body, with a linear decoder",
            "as designed",
            "cast: decoder of the design",
            "one decoder for all casts",
            "calibrated on 10 records",
            "on 100",
        ],
        cast_lines(&rows, "K = 2, M = 1", "nominal", "casts", &["10", "100"]),
    )
}
