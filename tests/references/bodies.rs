//! The tables of bodies: why training helps, lattices, compression, low-pass and designs.

use metasense::analysis::operator::MEASURES;
use metasense::look::{body, file, legend};
use metasense::plan::Plan;
use metasense::report::body::sketch;
use metasense_lab::replay::drawing;

use super::rows::{Row, geometric, number, of, only_row, ratio, rows, seeds, short, with_interval};
use super::table;
use std::collections::BTreeMap;

/// Measures of the information in the signals of initial and trained bodies, geometric means over seeds.
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
        let told = ["distinguishable_forces", "condition", "bits"].map(|column| mean(trained, column));
        let memory = format!("{} ms", values(trained, "memory", 1e3));
        let modes = mean(trained, "modes");
        [vec![words.to_owned(), errors, left], told.to_vec(), vec![memory, modes]].concat()
    };
    let bodies = [
        ("initial", "initial", None),
        ("trained with a linear decoder", "optimised", Some("linear")),
        ("trained with the paper's network", "optimised", Some("cnn")),
    ];
    let head = [
        "body",
        "error of its decoder",
        "error of Wiener's filter",
        "distinguishable forces",
        "condition",
        "bits per second",
        "memory",
        "participating modes",
    ];
    table(&head, bodies.map(line))
}

/// Rank correlations of the changes of measures with the gain.
pub fn why_correlated() -> String {
    let all = rows("why/operator.csv");
    let line = |measure: &str| {
        let cell = |setting: &str| {
            let row = only_row(&all, &[("setting", setting), ("measure", measure)]);
            ratio(row, "correlation", "correlation_low", "correlation_high")
        };
        vec![measure.to_owned(), cell("K = 2, M = 1, linear"), cell("K = 2, M = 1, cnn")]
    };
    table(&["measure", "linear decoder", "the paper's network"], MEASURES.map(line))
}

/// Bodies whose chips have a low-pass filter.
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

/// Bodies that other programs simulate.
pub fn external() -> String {
    let lines = |(body, decoder, file): (&str, &str, &str)| {
        let all = rows(&format!("{body}/{file}.csv"));
        let line = |sensors: &str| {
            let wanted = [("sensors", sensors)];
            let errors = |name: &str| of(&all, &wanted).map(|row| number(row, name)).collect::<Vec<_>>();
            let [initial, optimised] = ["initial", "optimised"].map(errors);
            let gains: Vec<f64> = initial.iter().zip(&optimised).map(|(a, b)| (a / b).ln()).collect();
            let [initial, optimised] = [initial, optimised].map(|errors| geometric(errors.into_iter()));
            let named = [body, sensors, decoder].map(str::to_owned).to_vec();
            [named, vec![format!("{initial} → {optimised} %"), with_interval(&gains, f64::exp)]].concat()
        };
        ["1", "2", "3", "4"]
            .into_iter()
            .filter(|m| of(&all, &[("sensors", *m)]).next().is_some())
            .map(line)
            .collect::<Vec<_>>()
    };
    let all =
        [("plate", "linear", "trials"), ("magnets", "linear", "trials"), ("magnets", "network", "network")];
    table(
        &["body", "M", "decoder", "error with 3 % noise, initial → trained body", "gain"],
        all.into_iter().flat_map(lines),
    )
}

/// Searches for a design, and the errors of their designs on further seeds.
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
        "required error",
        "seed",
        "CPU time (share of the grid)",
        "M, multiply-adds, units",
        "expected error, bound",
        "probability of a cheaper design",
        "8 further seeds: mean, worst; seeds within the limit",
    ];
    table(&head, searches.iter().map(line))
}

/// Cost and result of different searches of one space.
pub fn race() -> String {
    let all = rows("design/race.csv");
    let cell = |seed: &str, search: &str| {
        let row = only_row(&all, &[("seed", seed), ("search", search)]);
        match row["M"].as_str() {
            "" => format!("{} s: none", row["cpu_seconds"]),
            sensors => {
                let memory = row["memory"].trim_matches(['[', ']']).replace(',', " + ");
                format!("{} s: {sensors}, {memory} s, {}", row["cpu_seconds"], row["units"])
            }
        }
    };
    let line = |seed: &str| {
        [vec![seed.to_owned()], ["design", "halving", "optuna"].map(|search| cell(seed, search)).to_vec()]
            .concat()
    };
    table(&["seed", "`metasense design`", "halving by thirds", "Optuna"], seeds(&all).into_iter().map(line))
}

/// Training that starts from a body trained with fewer sensors or fewer parameters.
pub fn warm_starts() -> String {
    let line = |(begun, file, sensors): (&str, &str, &str)| {
        let all = rows(file);
        let error = |steps: &str, start: &str| -> Vec<f64> {
            let wanted = [("sensors", sensors), ("steps", steps), ("start", start)];
            of(&all, &wanted).map(|row| number(row, "optimised")).collect()
        };
        let kinds =
            [("30", "cold"), ("30", "warm"), ("60", "cold")].map(|(steps, start)| error(steps, start));
        let ratio = |over: &[f64]| {
            let logs: Vec<f64> = kinds[1].iter().zip(over).map(|(warm, cold)| (warm / cold).ln()).collect();
            with_interval(&logs, f64::exp)
        };
        let ratios = [ratio(&kinds[0]), ratio(&kinds[2])];
        let means = kinds.iter().map(|errors| geometric(errors.iter().copied()) + " %");
        [vec![sensors.to_owned(), begun.to_owned()], means.collect(), ratios.to_vec()].concat()
    };
    let head = [
        "M",
        "the other body",
        "30 steps from squares",
        "30 steps from the other body",
        "60 steps from squares",
        "second / first",
        "second / third",
    ];
    let begun = [
        ("body of one sensor", "warm-starts.csv", "2"),
        ("body of two sensors", "warm-starts.csv", "3"),
        ("shifts tied by 2 × 2 cells", "warm-units.csv", "2"),
    ];
    table(&head, begun.map(line))
}

/// Errors of bodies trained by successive rules of `joint` with a linear decoder.
pub fn memory() -> String {
    let all = rows("memory.csv");
    let line = |(rules, scene): ([&str; 2], String)| {
        let [old, new] = rules.map(|rule| -> BTreeMap<String, f64> {
            let wanted = [("scene", scene.as_str()), ("rule", rule)];
            of(&all, &wanted).map(|row| (row["seed"].clone(), number(row, "error"))).collect()
        });
        let pairs: Vec<[f64; 2]> =
            new.iter().filter_map(|(seed, new)| Some([*old.get(seed)?, *new])).collect();
        let means = [0, 1].map(|i| geometric(pairs.iter().map(|pair| pair[i])) + " %");
        let logs: Vec<f64> = pairs.iter().map(|[old, new]| (new / old).ln()).collect();
        let change = vec![rules.join(" → "), scene, logs.len().to_string()];
        (!logs.is_empty()).then(|| [change, means.into(), vec![with_interval(&logs, f64::exp)]].concat())
    };
    let mut scenes: Vec<String> = Vec::new();
    for row in &all {
        if !scenes.contains(&row["scene"]) {
            scenes.push(row["scene"].clone());
        }
    }
    let changes = [
        ["weight 0.8", "weight 0.4"],
        ["weight 0.4", "cross-validated"],
        ["cross-validated", "coarse lags"],
        ["rate 0.3", "rate 0.5"],
    ];
    let lines = changes.iter().flat_map(|rules| scenes.iter().map(|scene| (*rules, scene.clone())));
    table(&["change", "scene", "seeds", "before", "after", "ratio"], lines.filter_map(line))
}

const LATTICES: [(&str, &str); 4] = [
    ("square", "squares"),
    ("chiral", "squares, chiral"),
    ("kagome", "Kagome's triangles"),
    ("triangular", "hexagons"),
];

/// The same sheets by number of sensors.
pub fn families_sensors() -> String {
    let all = rows("families/trials.csv");
    let column = |lattice: &str, sensors: &str, name: &str| -> Vec<f64> {
        let wanted = [("lattice", lattice), ("sensors", sensors)];
        of(&all, &wanted).map(|row| number(row, name)).collect()
    };
    let line = |(lattice, words): (&str, &str)| {
        let mut cells = vec![words.to_owned()];
        for sensors in ["1", "2", "3", "4"] {
            let [initial, optimised] = ["initial", "optimised"].map(|name| column(lattice, sensors, name));
            let ratios = initial.iter().zip(&optimised).map(|(a, b)| (a / b).ln()).collect::<Vec<_>>();
            let gain = with_interval(&ratios, f64::exp);
            let [initial, optimised] = [initial, optimised].map(|errors| geometric(errors.into_iter()));
            cells.push(format!("{initial} → {optimised} %; {gain}"));
        }
        cells
    };
    table(&["lattice", "M = 1", "M = 2", "M = 3", "M = 4"], LATTICES.map(line))
}

/// Lattices of equal outline and mass.
pub fn families() -> String {
    let all = rows("families/trials.csv");
    let interval = |ratios: Vec<f64>| {
        with_interval(&ratios.iter().map(|ratio| ratio.ln()).collect::<Vec<_>>(), f64::exp)
    };
    let column = |lattice: &str, name: &str| -> Vec<f64> {
        of(&all, &[("lattice", lattice), ("sensors", "2")]).map(|row| number(row, name)).collect()
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
    let head = [
        "units",
        "parameters",
        "initial",
        "trained",
        "gain",
        "initial / initial squares",
        "trained / trained squares",
    ];
    table(&[&["lattice"][..], &head].concat(), LATTICES.map(line))
}

/// Bodies that are compressed before a sample, each evaluated under the other compressions.
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
        "body",
        "initial",
        "trained",
        "initial / initial as cast",
        "trained / trained as cast",
        "trained, under the other two presses",
        "this error / error under its own press",
        "this error / error of initial bodies there",
    ];
    table(&head, presses.map(line))
}

/// The lattices as sheets (above) and discs (below), with clamps and panels.
pub fn lattices() -> String {
    let draw = |outline: &str, lattice: &str| {
        let spec = format!(
            "name = \"lattices\"
[body]
lattice = \"{lattice}\"
{outline}
spacing = 15.0
ligament_length = 2.25
density = 1e-8
stiffness = {{ stretch = 3.0, shear = 0.5, bend = 1.0 }}
[stimuli]
kind = \"bell\"
[sweep]
panels = [2]
sensors = [1]
"
        );
        let trial = &Plan::new("lattices.toml", spec).expect("a spec").trials[0].spec;
        let design = metasense_worker::problem::problem(trial).expect("a body").initial;
        sketch(&drawing(trial, &design).expect("a body"), &[])
    };
    let outlines = ["columns = 6\nrows = 5", "layout = \"circular\"\ncolumns = 7"];
    let names = ["square", "kagome", "triangular", "chiral"];
    let drawn = outlines.iter().flat_map(|outline| names.map(|name| (name, draw(outline, name))));
    let pictures: Vec<_> =
        drawn.map(|(name, body)| body.picture(body::frame([&body]), name, body::Numbering::None)).collect();
    let kinds = [("unit clamped", "held"), ("arrow", "force"), ("dot sensor", "sensor")];
    file(&pictures, names.len(), 900.0, &legend(&kinds))
}
