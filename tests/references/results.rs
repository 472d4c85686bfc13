//! The tables of results, from the rows that are committed. A number is rounded once, here.

use std::collections::BTreeMap;

use metasense::analysis::numbers::{deviation, geometric_mean, mean};
use metasense::analysis::operator::MEASURES;
use metasense_worker::student;
use serde_json::Value;

use super::{root, table, who_senses};

pub(super) type Row = BTreeMap<String, String>;

pub(super) fn rows(file: &str) -> Vec<Row> {
    let path = root().join("results/committed").join(file);
    let mut reader = csv::Reader::from_path(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let names = reader.headers().unwrap().clone();
    let pair = |row: csv::StringRecord| {
        names.iter().zip(row.iter()).map(|(name, cell)| (name.to_owned(), cell.to_owned())).collect()
    };
    reader.records().map(|row| pair(row.unwrap())).collect()
}

/// Rows whose cells are these.
pub(super) fn of<'a>(rows: &'a [Row], wanted: &'a [(&str, &str)]) -> impl Iterator<Item = &'a Row> {
    rows.iter().filter(|row| wanted.iter().all(|(name, cell)| row[*name] == *cell))
}

/// The only row whose cells are these.
pub(super) fn one<'a>(rows: &'a [Row], wanted: &[(&str, &str)]) -> &'a Row {
    let mut found = rows.iter().filter(|row| wanted.iter().all(|(name, cell)| row[*name] == *cell));
    let row = found.next().unwrap_or_else(|| panic!("no row has {wanted:?}"));
    // A trial's own brain may be one of the readers of every body: both rows then say the same.
    assert!(found.all(|other| other == row), "rows that have {wanted:?} differ");
    row
}

/// Two significant digits, three after a leading 1.
pub(super) fn short(text: &str) -> String {
    let x: f64 = text.parse().unwrap_or_else(|_| panic!("{text:?} is no number"));
    let digits = |count: i32| {
        let magnitude = x.abs().log10().floor() as i32;
        format!("{x:.*}", (count - 1 - magnitude).max(0) as usize)
    };
    let two = digits(2);
    if two.trim_start_matches(['0', '.', '-']).starts_with('1') { digits(3) } else { two }
}

fn percent(row: &Row, name: &str) -> String {
    format!("{} %", short(&row[name]))
}

/// Initial → optimised.
fn change(row: &Row) -> String {
    format!("{} → {} %", short(&row["initial"]), short(&row["optimised"]))
}

/// A ratio with its interval, where it has one.
fn ratio(row: &Row, value: &str, low: &str, high: &str) -> String {
    match row[value].as_str() {
        "" => "–".into(),
        value if row[low].is_empty() => short(value),
        value => format!("{} ({} … {})", short(value), short(&row[low]), short(&row[high])),
    }
}

fn brain(name: &str) -> &'static str {
    match name {
        "cnn" => "the paper's network",
        "long" => "long network",
        "linear" => "linear brain",
        "stacked" => "stacked network",
        "stacked, long" => "stacked long network",
        other => panic!("no words for the brain {other:?}"),
    }
}

pub fn quickstart() -> String {
    let mut rows = rows("quickstart.csv");
    rows.sort_by_key(|row| (row["sensors"].clone(), row["brain"].clone()));
    let line = |row: &Row| {
        let mut cells = vec![row["sensors"].clone(), brain(&row["brain"]).to_owned()];
        let errors = ["holdout_error_initial", "holdout_error_optimised"];
        let linear = ["linear_holdout_error_initial", "linear_holdout_error_optimised"];
        cells.extend(errors.iter().chain(&linear).map(|name| percent(row, name)));
        cells
    };
    table(
        &[
            "sensors M",
            "trained with and read by",
            "error, initial body",
            "trained body",
            "a linear decoder on the same bodies: initial",
            "trained",
        ],
        rows.iter().map(line),
    )
}

/// Median and 90th percentile over casts.
fn spread(row: &Row) -> String {
    format!("{} [{}] %", short(&row["median"]), short(&row["percentile_90"]))
}

/// A line for each body of the settings: how it reads as designed, and how brains of one kind read its casts.
fn cast_lines(rows: &[Row], setting: &str, own: &str, all: &str, records: &[&str]) -> Vec<Vec<String>> {
    let mut bodies: Vec<&str> =
        rows.iter().filter(|row| row["setting"] == setting).map(|row| &*row["body"]).collect();
    bodies.dedup();
    let line = |body: &&str| {
        let by = |read_by, records| {
            one(rows, &[("setting", setting), ("body", body), ("read_by", read_by), ("records", records)])
        };
        let mut cells = vec![words(body), percent(by(own, ""), "designed")];
        cells.extend([own, all].map(|read_by| spread(by(read_by, ""))));
        cells.extend(records.iter().map(|n| spread(by("records", n))));
        cells
    };
    bodies.iter().map(line).collect()
}

/// How a body that is cast was trained.
fn words(body: &str) -> String {
    match body {
        "initial" => "initial body",
        "nominal" => "trained as designed",
        "mean, one" | "mean, one, iterations = 75" => "trained over casts",
        "mean, one, iterations = 225" => "trained over casts, three times the steps",
        "mean, each" => "trained over casts, a decoder for each, three times the samples",
        other => panic!("no words for the body {other:?}"),
    }
    .to_owned()
}

/// What is left of bodies of several settings once they are cast: by linear decoders, and by networks.
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
            &["read by", "body", "as designed", "cast: network of the design", "one network for all casts"],
            lines(&networks, "network", "network_casts", &[])
        )
    )
}

/// What bodies are worth under forces that did not train them.
pub fn transfer() -> String {
    let rows = rows("transfer/answer-transfer.csv");
    let mut bodies: Vec<&str> = Vec::new();
    for row in &rows {
        if !bodies.contains(&&row["body"][..]) {
            bodies.push(&row["body"]);
        }
    }
    let line = |body: &&str| -> Vec<String> {
        let read = ["bell", "irregular"].map(|under| one(&rows, &[("body", *body), ("under", under)]));
        let name = match *body {
            "initial" => "none: the initial body".into(),
            "bell" => "pulses".into(),
            "irregular" => "blows".into(),
            mix if mix.contains("iterations = 150") => "the same, four times the samples".to_owned(),
            mix if mix.contains("objective") => "both, the mean of logarithms, a decoder for each".to_owned(),
            _ => "both, the mean error, one decoder".into(),
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
        "read under pulses",
        "under blows",
        "of the pulses' gain",
        "of the blows' gain",
        "its own decoder: pulses",
        "blows",
    ];
    table(&head, bodies.iter().map(line))
}

/// Bodies trained under pulses, simulated blows and measured ones, each read under all three.
pub fn transfer_recorded() -> String {
    let rows = rows("transfer/recorded.csv");
    let line = |(body, words): (&str, &str)| {
        let read =
            ["bell", "irregular", "recorded"].map(|under| one(&rows, &[("body", body), ("under", under)]));
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
        "read under pulses",
        "under simulated blows",
        "under measured blows",
        "of the measured blows' gain",
    ];
    table(&head, bodies.map(line))
}

/// The same bodies, trained with linear brains, read by long networks.
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
        ("mix", "both, the mean of logarithms, a decoder for each"),
    ];
    let head =
        ["trained under", "read under pulses", "under blows", "of the pulses' gain", "of the blows' gain"];
    table(&head, bodies.map(line))
}

/// What the sensors of initial and trained bodies can tell, in geometric means over seeds.
pub fn why() -> String {
    let all = rows("why/rows.csv");
    let line = |(words, body, trained): (&str, &str, Option<&str>)| {
        let values = |trained: Option<&str>, column: &str, by: f64| {
            let own = all
                .iter()
                .filter(|row| row["body"] == body && trained.is_none_or(|t| row["trained_with"] == t));
            geometric(own.map(|row| by * number(row, column)))
        };
        let mean = |trained: Option<&str>, column: &str| values(trained, column, 1.0);
        let errors = match trained {
            Some(brain) => format!("{} %", mean(Some(brain), "error")),
            None => format!("{}, {} %", mean(Some("linear"), "error"), mean(Some("cnn"), "error")),
        };
        let left = format!("{} %", mean(trained, "wiener_error"));
        let told = ["forces_told", "condition", "bits"].map(|column| mean(trained, column));
        let memory = format!("{} ms", values(trained, "memory", 1e3));
        [vec![words.to_owned(), errors, left], told.to_vec(), vec![memory]].concat()
    };
    let bodies = [
        ("initial", "initial", None),
        ("trained with a linear brain", "optimised", Some("linear")),
        ("trained with the paper's network", "optimised", Some("cnn")),
    ];
    let head = [
        "body",
        "error by its own brain",
        "left by Wiener's filter",
        "forces told apart",
        "condition",
        "bits a second",
        "memory",
    ];
    table(&head, bodies.map(line))
}

/// Rank correlations of what changes with what is gained.
pub fn why_correlated() -> String {
    let all = rows("why/operator.csv");
    let line = |measure: &str| {
        let cell = |setting: &str| {
            let row = one(&all, &[("setting", setting), ("measure", measure)]);
            ratio(row, "correlation", "correlation_low", "correlation_high")
        };
        vec![measure.to_owned(), cell("K = 2, M = 1, linear"), cell("K = 2, M = 1, cnn")]
    };
    table(&["measure", "linear brain", "the paper's network"], MEASURES.map(line))
}

/// Errors of a body of the real scale and of the reference body, seed by seed.
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

pub(super) fn number(row: &Row, name: &str) -> f64 {
    row[name].parse().unwrap_or_else(|_| panic!("{:?} is no number", row[name]))
}

/// The mean and Student's interval of 95 %, as they are shown.
pub(super) fn with_interval(values: &[f64], shown: fn(f64) -> f64) -> String {
    let half = student(values.len() - 1) * deviation(values).unwrap() / (values.len() as f64).sqrt();
    let centre = mean(values).unwrap();
    let [at, low, high] = [0.0, -half, half].map(|by| short(&shown(centre + by).to_string()));
    format!("{at} ({low} … {high})")
}

/// The geometric mean.
pub(super) fn geometric(values: impl Iterator<Item = f64>) -> String {
    short(&geometric_mean(&values.collect::<Vec<_>>()).to_string())
}

/// Bodies whose chip reads through a low-pass.
pub fn filtered() -> String {
    let all = rows("filtered/trials.csv");
    let line = |(bandwidth, words): (&str, &str)| {
        let errors = |noise: &str| {
            let wanted = [("bandwidth", bandwidth), ("noise", noise)];
            let seeds: Vec<&Row> = of(&all, &wanted).collect();
            let gains: Vec<f64> =
                seeds.iter().map(|row| number(row, "initial") / number(row, "optimised")).collect();
            let [least, most] = [f64::min, f64::max].map(|end| gains.iter().copied().reduce(end).unwrap());
            let [initial, optimised] =
                ["initial", "optimised"].map(|name| geometric(seeds.iter().map(|row| number(row, name))));
            let [gain, least, most] =
                [geometric(gains.iter().copied()), short(&least.to_string()), short(&most.to_string())];
            [format!("{initial} → {optimised} %"), format!("{gain} ({least} … {most})")]
        };
        [vec![words.to_owned()], errors("0").to_vec(), errors("1").to_vec()].concat()
    };
    let lines = [("", "none"), ("50.0", "50 Hz"), ("20.0", "20 Hz")].map(line);
    table(&["low-pass", "without noise", "gain", "with noise", "gain"], lines)
}

/// Searches for a design, and what their designs do on further seeds.
pub fn designs() -> String {
    let (searches, further) = (rows("design/searches.csv"), rows("design/further.csv"));
    let line = |row: &Row| {
        let wanted = [("requirement", row["requirement"].as_str()), ("seed", row["seed"].as_str())];
        let errors: Vec<f64> = of(&further, &wanted).map(|row| number(row, "error")).collect();
        let limit = number(row, "requirement");
        let found = row["code"] == "0";
        let design = match found {
            true => format!("{}, {}, {}", row["M"], row["operations"], row["units"]),
            false => "none".into(),
        };
        let judged = match errors.iter().copied().reduce(f64::max) {
            Some(worst) => {
                let met = errors.iter().filter(|error| **error <= limit).count();
                let worst = short(&worst.to_string());
                format!("{}, {worst} %; {met} of {}", geometric(errors.iter().copied()), errors.len())
            }
            None => String::new(),
        };
        vec![
            format!("{} %", row["requirement"]),
            row["seed"].clone(),
            format!("{} s ({} %)", row["cpu_seconds"], row["part"]),
            design,
            format!("{}, {} %", short(&row["error"]), short(&row["keeps_to"])),
            if found { format!("{:.0} %", 100.0 * number(row, "cheaper")) } else { String::new() },
            judged,
        ]
    };
    let head = [
        "at most",
        "seed",
        "CPU time (of the grid's)",
        "M, multiply-adds, units",
        "expected, kept to",
        "a cheaper class holds one",
        "8 further seeds: mean, worst; meet it",
    ];
    table(&head, searches.iter().map(line))
}

/// Lattices of one outline and mass.
pub fn families() -> String {
    let all = rows("families/trials.csv");
    let interval = |ratios: Vec<f64>| {
        with_interval(&ratios.iter().map(|ratio| ratio.ln()).collect::<Vec<_>>(), f64::exp)
    };
    let column = |lattice: &str, name: &str| -> Vec<f64> {
        of(&all, &[("lattice", lattice)]).map(|row| number(row, name)).collect()
    };
    let by = |ends: [Vec<f64>; 2]| ends[0].iter().zip(&ends[1]).map(|(a, b)| a / b).collect::<Vec<_>>();
    let line = |(lattice, words): (&str, &str)| {
        let [initial, optimised] = ["initial", "optimised"].map(|name| column(lattice, name));
        let wanted = [("lattice", lattice)];
        let first = of(&all, &wanted).next().unwrap();
        let other = |body: &str, own: &[f64]| match lattice {
            "square" => "1".to_owned(),
            _ => interval(by([own.to_vec(), column("square", body)])),
        };
        vec![
            words.to_owned(),
            first["units"].clone(),
            first["design_parameters"].clone(),
            format!("{} %", geometric(initial.iter().copied())),
            format!("{} %", geometric(optimised.iter().copied())),
            interval(by([initial.clone(), optimised.clone()])),
            other("initial", &initial),
            other("optimised", &optimised),
        ]
    };
    let lattices = [
        ("square", "squares"),
        ("chiral", "squares, chiral"),
        ("kagome", "Kagome's triangles"),
        ("triangular", "hexagons"),
    ];
    let head = [
        "units",
        "parameters",
        "untouched",
        "trained",
        "gain",
        "untouched, by squares",
        "trained, by squares",
    ];
    table(&[&["lattice"][..], &head].concat(), lattices.map(line))
}

/// Bodies whose held units come together before a sample, and each read under the other presses.
pub fn pressed() -> String {
    let (trials, readings) = (rows("pressed/trials.csv"), rows("pressed/read.csv"));
    let column = |of: &[Row], wanted: &[(&str, &str)], name: &str| -> Vec<f64> {
        self::of(of, wanted).map(|row| number(row, name)).collect()
    };
    let interval = |above: &[f64], below: &[f64]| {
        let ratios: Vec<f64> = above.iter().zip(below).map(|(a, b)| (a / b).ln()).collect();
        with_interval(&ratios, f64::exp)
    };
    let percent = |errors: &[f64]| format!("{} %", geometric(errors.iter().copied()));
    let presses = [("0.0", "as cast"), ("0.05", "5 % narrower"), ("-0.05", "5 % wider")];
    let line = |(press, words): (&str, &str)| {
        let [(initial, first), (optimised, best)] = ["initial", "optimised"].map(|name| {
            (column(&trials, &[("press", press)], name), column(&trials, &[("press", "0.0")], name))
        });
        let read = |at: &str| column(&readings, &[("trained", press), ("read", at)], "error");
        let own = read(press);
        let others = presses.iter().map(|p| p.0).filter(|other| *other != press);
        let both = |of: &dyn Fn(&str) -> Vec<f64>| -> Vec<f64> {
            let ends: Vec<Vec<f64>> = others.clone().map(of).collect();
            ends[0].iter().zip(&ends[1]).map(|(a, b)| (a * b).sqrt()).collect()
        };
        let untouched = both(&|other| column(&trials, &[("press", other)], "initial"));
        let otherwise = both(&read);
        let as_cast =
            |own: &[f64], cast: &[f64]| if press == "0.0" { "1".to_owned() } else { interval(own, cast) };
        vec![
            words.to_owned(),
            percent(&initial),
            percent(&optimised),
            as_cast(&initial, &first),
            as_cast(&optimised, &best),
            percent(&otherwise),
            interval(&otherwise, &own),
            interval(&otherwise, &untouched),
        ]
    };
    let head = [
        "a body",
        "untouched",
        "trained",
        "untouched, by as cast",
        "trained, by as cast",
        "trained, read under the others",
        "that by its own reading",
        "that by untouched bodies there",
    ];
    table(&head, presses.map(line))
}

/// Robust bodies in a world that the model does not contain.
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

/// What is left of the quickstart's bodies once they are cast.
pub fn quickstart_casts() -> String {
    let rows = rows("quickstart-casts.csv");
    table(
        &[
            "read by a linear decoder",
            "as designed",
            "cast: decoder of the design",
            "one decoder for all casts",
            "calibrated on 10 records",
            "on 100",
        ],
        cast_lines(&rows, "K = 2, M = 1", "nominal", "casts", &["10", "100"]),
    )
}

/// Four findings, with their numbers.
pub fn findings() -> String {
    let brains = rows("brains-two-core/answer-brains.csv");
    let setting = setting("bell", "");
    let own = |name: &str| {
        let wanted = [("setting", &*setting), ("trained_with", name), ("read_by", name)];
        // A linear brain reads by shorter memories, too: the longest comes first.
        change(of(&brains, &wanted).next().unwrap())
    };
    let placed = rows("placed-two-core/answer-placed.csv");
    let place = |m: &str| {
        one(&placed, &[("setting", "K = 4, linear, stimuli.kind = bell"), ("set", "holdout"), ("M", m)])
    };
    let claims = rows("claims/claims.csv");
    let all = claims.iter().filter(|row| row["rating"].starts_with("holds")).count();
    let some =
        |row: &&Row| ["holds", "compatible", "in part"].iter().any(|rating| row["rating"].contains(rating));
    let some = claims.iter().filter(some).count() - all;
    let [with, without] = [3, 2].map(|channels| super::elbow_law::fallen(6, channels));
    let cast = rows("robust-two-core/answer-casts.csv");
    let left = |body: &str, read_by: &str, records: &str| {
        let wanted =
            [("setting", "K = 2, M = 1, linear"), ("body", body), ("read_by", read_by), ("records", records)];
        one(&cast, &wanted)
    };
    let longer = "mean, one, iterations = 225";
    let senses = who_senses::finding();
    format!(
        "{senses}\n\
         - **A body has to be trained for its casts.** One sensor, two forces, one linear decoder for all casts, median [90th \
         percentile]: of a body that promises {} once trained as designed {} is left, of the untouched one {}. Trained over casts at the \
         same cost it reads at {}, at three times the cost at {}, and calibrated on ten records of each cast at {} \
         ([details](results/README.md#a-body-that-can-be-cast)).\n\
         - **A decoder with memory gains more than a trained body; both together gain most.** One sensor, two forces, error of the \
         initial → the trained body: {} with the paper's network, which sees 25 ms, and {} with a linear decoder of the whole second \
         ([details](results/README.md#body-or-decoder)).\n\
         - **Placing sensors well is worth as much as more sensors; training the body pays on top.** Four placed sensors have {} error \
         on the untouched body, six at random {}; on a trained body the four have {} \
         ([details](results/README.md#where-the-sensors-are)).\n\
         - **Of {} claims of the paper {} hold with every decoder tried in our scenes, {} more with some or in part;** for the others \
         we see no effect, or cannot tell ([claim by claim](results/README.md#the-paper-claim-by-claim); [what our scenes \
         are](results/DEVIATIONS.md)). A linear decoder's error falls until sensors have a channel a force: six forces need {with} sensors, \
         {without} without gyroscopes ([details](results/README.md#how-many-sensors-k-forces-need)).",
        percent(left("nominal", "casts", ""), "designed"),
        spread(left("nominal", "casts", "")),
        spread(left("initial", "casts", "")),
        spread(left("mean, one, iterations = 75", "casts", "")),
        spread(left(longer, "casts", "")),
        spread(left(longer, "records", "10")),
        own("cnn"),
        own("linear"),
        percent(place("4"), "placed_initial"),
        percent(place("6"), "random_initial"),
        percent(place("4"), "placed_optimised"),
        claims.len(),
        all,
        some,
    )
}

/// `setting` of a table of answers.
fn setting(stimuli: &str, noise: &str) -> String {
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
    let mut lines = Vec::new();
    for (file, forces) in [("four-forces", "K = 4"), ("eight-forces", "K = 8")] {
        let all = rows(&format!("claims/{file}-answer-sensors.csv"));
        for name in ["cnn", "linear"] {
            let setting = format!("{forces}, {name}");
            let error = |body: &str, m: &str| {
                let row = one(&all, &[("setting", &setting), ("body", body), ("set", "holdout"), ("M", m)]);
                short(&row["error"])
            };
            let cells = ["1", "2", "3", "4", "5", "6"]
                .map(|m| format!("{} → {} %", error("initial", m), error("optimised", m)));
            lines.push([vec![format!("{forces}, {}", brain(name))], cells.to_vec()].concat());
        }
    }
    table(&["", "M = 1", "2", "3", "4", "5", "6"], lines)
}

/// The brain of a row of evidence and what else sets the row apart; `None` for rows beside the main ones.
fn with(text: &str) -> Option<(&str, &str)> {
    match text.split_once(", ").unwrap_or((text, "")) {
        (brain @ ("cnn" | "long" | "linear"), "" | "evaluation.seeds = 3") => Some((brain, "")),
        ("cnn", "evaluation.seeds = 1") => Some(("cnn", "one network a body")),
        (brain @ ("cnn" | "long" | "linear"), height @ ("in %" | "in logarithms")) => Some((brain, height)),
        ("linear", rest) => Some(("linear", rest)),
        _ => None,
    }
}

/// The verdict of a brain on a claim: the ratio, or what the row says in words.
fn verdict(row: &Row) -> String {
    let note = row["note"].split([';', '(']).next().unwrap().trim();
    let ratio = ratio(row, "found", "low", "high");
    let words = match note {
        note if note.is_empty() || note.starts_with("worst over best") => ratio,
        note if ratio == "–" => note.to_owned(),
        note => format!("{ratio}, {note}"),
    };
    format!("{words}: {}", row["rating"])
}

pub fn claims() -> String {
    let evidence = rows("claims/evidence.csv");
    let mut lines = Vec::new();
    for claim in rows("claims/claims.csv") {
        let of_claim: Vec<&Row> = evidence
            .iter()
            .filter(|row| row["claim"] == claim["claim"])
            .filter(|row| row["set"].starts_with("holdout"))
            .collect();
        let kinds = |row: &&Row| with(&row["with"]).map(|(_, kind)| kind.to_owned());
        let mut found: Vec<String> = Vec::new();
        for kind in of_claim.iter().filter_map(kinds) {
            if !found.contains(&kind) {
                found.push(kind);
            }
        }
        // Single networks count where there are no others.
        if found.len() > 1 {
            found.retain(|kind| kind != "one network a body");
        }
        for kind in found {
            let cell = |name: &str| {
                let row = of_claim.iter().find(|row| with(&row["with"]) == Some((name, &kind)));
                row.map_or(String::new(), |row| verdict(row))
            };
            let says = if kind.is_empty() { String::new() } else { format!(" ({kind})") };
            let mut cells = vec![format!("{}{says}", claim["says"]), claim["source"].clone()];
            cells.extend(["cnn", "long", "linear"].map(cell));
            lines.push(cells);
        }
    }
    table(&["claim", "in the paper", "the paper's network", "long network", "linear brain"], lines)
}

pub fn evaluate() -> String {
    let all = rows("evaluate/table.csv");
    let line = |body: &str| {
        let [measured, simulated] =
            ["measured", "simulated"].map(|signals| one(&all, &[("body", body), ("signals", signals)]));
        let interval = ratio(measured, "error_test", "test_low", "test_high");
        let gain = |row: &Row| ratio(row, "ratio", "ratio_low", "ratio_high");
        vec![body.to_owned(), interval, percent(simulated, "error_test"), gain(measured), gain(simulated)]
    };
    table(
        &[
            "body",
            "error on unseen records (%, 95 % interval over records)",
            "expected from the model",
            "initial error over this one",
            "expected from the model",
        ],
        ["initial", "optimised"].map(line),
    )
}

/// The rows that a bench has written, a JSON object a line.
fn lines(file: &str) -> Vec<Value> {
    let text = super::read(&format!("results/committed/{file}"));
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Error against run time, protocol by protocol.
pub fn protocols() -> String {
    let line = |row: &Value| {
        let protocol = match row["protocol"].as_str().unwrap() {
            "initial" => "(initial body)".into(),
            "warm" => "`warm`, since removed".into(),
            other => format!("`{other}`"),
        };
        let seconds = format!("{:.0}", row["cpu_seconds"].as_f64().unwrap());
        let error = short(&row["holdout_error_percent"].to_string());
        vec![protocol, seconds, row["step"].to_string(), format!("{error} %")]
    };
    table(
        &["protocol", "CPU seconds of outer steps", "outer steps", "holdout error"],
        lines("protocols.jsonl").iter().map(line),
    )
}

/// The change of the loss on the holdout by a step against each gradient.
pub fn downhill() -> String {
    let all = lines("implicit.jsonl");
    let names = [
        ("random", "random direction"),
        ("direct", "direct term of the test loss"),
        ("truncate", "with the implicit term after 20 products"),
        ("gauss_newton", "the same with Gauss–Newton products"),
        ("training", "training loss at fixed weights"),
    ];
    let line = |(name, words): (&str, &str)| {
        let cell = |network: u64| {
            let row = all.iter().find(|row| row["gradient"] == name && row["network"] == network).unwrap();
            let change = row["holdout_change_percent"].as_f64().unwrap();
            let sign = if change < 0.0 { "−" } else { "+" };
            let residual = row["residual"].as_f64().map(|r| format!(" (residual {r:.2})"));
            format!("{sign}{:.1} %{}", change.abs(), residual.unwrap_or_default())
        };
        [vec![words.to_owned()], (0..3).map(cell).collect()].concat()
    };
    table(&["gradient", "network 0", "network 1", "network 2"], names.map(line))
}
