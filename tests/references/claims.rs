//! The tables of the paper's claims and protocols.

use std::collections::HashMap;
use std::sync::OnceLock;

use metasense::analysis::claims::{CLAIMS, Evidence, claims_table, evidence_table, tried, tried_elsewhere};
use metasense::analysis::numbers::distinct;
use metasense::analysis::paired::iteration_ratio;
use metasense::analysis::setting::SharedSettings;
use metasense::analysis::{Cluster, Trial};
use metasense::cell::plain;
use metasense::look::{Table, file};
use metasense::plan::Plan;
use metasense::report::claims::figure;
use metasense_source::Source;
use serde_json::{Value, json};

use super::brains::with;
use super::rows::{
    Row, brain, geometric, lines, number, of, only_row, percent, ratio, rows, seeds, short, with_interval,
};
use super::table;

/// The verdict on a claim with a decoder: the ratio, or the row's words. For an open claim the ratio that would have been detected,
/// unless the claim is open only because there are too few ratios.
fn verdict(row: &Row) -> String {
    let note = row["note"].split([';', '(']).next().unwrap().trim();
    let ratio = ratio(row, "found", "low", "high");
    let words = match note {
        note if note.is_empty() || note.starts_with("largest / smallest") => ratio,
        note if ratio == "–" => note.to_owned(),
        note => format!("{ratio}, {note}"),
    };
    let told = match (row["rating"].as_str(), row["tells"].as_str()) {
        ("open", tells) if !tells.is_empty() => match number(row, "low") > 1.0 || number(row, "high") < 1.0 {
            true => " after correction".to_owned(),
            false => format!(" (detectable {})", short(tells)),
        },
        _ => String::new(),
    };
    format!("{words}: {}{told}", row["rating"])
}

/// Folders of the rows behind the claims.
const ROWS: [&str; 5] =
    ["claims", "four-forces-map", "four-forces-map-network", "eight-forces-map", "disc-map"];

/// The trials of the claims' specs for the analysis: settings from the specs, numbers from the rows.
fn trials() -> Vec<Trial> {
    let rows: Vec<Row> = ROWS.iter().flat_map(|folder| rows(&format!("{folder}/trials.csv"))).collect();
    let by_hash: HashMap<&str, &Row> = rows.iter().map(|row| (row["hash"].as_str(), row)).collect();
    let mut settings = SharedSettings::default();
    let mut trial = |of: metasense::plan::PlannedTrial| {
        let row = by_hash.get(&*of.hash).unwrap_or_else(|| panic!("no row of {}", of.hash));
        let number = |name: &str| row.get(name).and_then(|cell| cell.parse::<f64>().ok());
        let errors = |long: &str| {
            ["initial", "optimised"].map(|body| {
                let [test, holdout] =
                    ["test", "holdout"].map(|set| number(&format!("{long}{set}_error_{body}")));
                [test, holdout, None]
            })
        };
        let point = &of.spec.point;
        // With four forces, networks have as many training samples as linear decoders, but smaller test and held-out sets.
        let mut setting = serde_json::to_value(&of.spec).unwrap();
        let stimuli = setting["stimuli"].as_object_mut().unwrap();
        stimuli.retain(|key, _| !["samples", "test", "holdout"].contains(&key.as_str()));
        Trial {
            setting: settings.of(&setting),
            panels: point.panels as u64,
            sensors: point.sensors as u64,
            cluster: Cluster { placement: point.placement as u64, seed: point.seed },
            units: of.units as u64,
            design_parameters: of.design_parameters as u64,
            errors: errors(""),
            long_errors: errors("long_"),
            iterations: ["iterations_to_loss", "iterations_to_error"]
                .map(|name| number(name).into_iter().collect()),
            hash: of.hash,
            ..Trial::default()
        }
    };
    let specs = distinct(CLAIMS.iter().flat_map(|claim| claim.specs.iter().copied()));
    let planned = |spec: &&str| {
        let text = super::read(&format!("schemas/{spec}.toml"));
        let path = super::root().join(format!("schemas/{spec}.toml"));
        Plan::of(Source::spec(path, text, &[]).unwrap()).unwrap().trials
    };
    specs.iter().flat_map(planned).map(&mut trial).collect()
}

/// Evidence on every claim.
fn found() -> &'static [Vec<Evidence>] {
    static FOUND: OnceLock<Vec<Vec<Evidence>>> = OnceLock::new();
    FOUND.get_or_init(|| tried(&trials()))
}

/// Evidence from the scenes of the paper's authors, without limits of the design, as theirs are.
fn in_the_authors_scenes() -> Vec<Row> {
    let mut settings = SharedSettings::default();
    let rows = rows("authors/trials.csv");
    let trial = |row: &Row| {
        let (brain, noise) =
            (if row["decoder"] == "linear" { "linear" } else { "cnn" }, number(row, "noise"));
        let whole = |name: &str| number(row, name) as u64;
        let error = |set: &str, body: &str| Some(number(row, &format!("{set}_{body}")));
        Trial {
            setting: settings.of(&json!({
                "brain": { "kind": brain },
                "sensors": { "noise": noise },
                "point": { "sensors": row["sensors"], "placement": row["placement"], "seed": row["seed"] },
            })),
            panels: row["scene"]["K = ".len()..].split(',').next().unwrap().parse().unwrap(),
            sensors: whole("sensors"),
            cluster: Cluster { placement: whole("placement"), seed: whole("seed") },
            errors: ["initial", "trained"].map(|body| [error("test", body), error("holdout", body), None]),
            hash: row.values().cloned().collect::<Vec<_>>().join(" "),
            ..Trial::default()
        }
    };
    let trials: Vec<Trial> = rows.iter().filter(|row| row["limits"] == "no").map(trial).collect();
    as_rows(evidence_table(&tried_elsewhere(&trials)))
}

/// Converts a table into rows of text.
fn as_rows(table: Table) -> Vec<Row> {
    let row = |cells: &Vec<Value>| table.columns.iter().cloned().zip(cells.iter().map(plain)).collect();
    table.rows.iter().map(row).collect()
}

/// One row per claim.
pub(super) fn rated() -> Vec<Row> {
    as_rows(claims_table(found()))
}

/// The files of the claims: ratings, evidence and figure.
pub fn files() -> [String; 3] {
    let figure = figure(found()).unwrap();
    let drawn = file(&figure.pictures, 1, 560.0, &figure.legend) + "\n";
    [claims_table(found()).csv(), evidence_table(found()).csv(), drawn]
}

pub fn claims() -> String {
    let evidence = as_rows(evidence_table(found()));
    let authors = in_the_authors_scenes();
    let mut lines = Vec::new();
    for claim in rated() {
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
        // Single networks count only without others.
        if found.len() > 1 {
            found.retain(|kind| kind != "one network per body");
        }
        for kind in found {
            let cell = |name: &str| {
                let row = of_claim.iter().find(|row| with(&row["with"]) == Some((name, &kind)));
                row.map_or(String::new(), |row| verdict(row))
            };
            let says = if kind.is_empty() { String::new() } else { format!(" ({kind})") };
            let theirs =
                authors.iter().filter(|row| row["claim"] == claim["claim"] && row["set"] == "holdout");
            let theirs: Vec<String> = theirs.filter_map(|row| in_short(row, &kind)).collect();
            let mut cells =
                vec![format!("{}{says}", claim["says"]), claim["source"].clone(), theirs.join("; ")];
            cells.extend(["cnn", "long", "linear"].map(cell));
            lines.push(cells);
        }
    }
    let ours = ["the paper's network", "long network", "linear decoder"];
    table(&[&["claim", "in the paper", "in the authors' scenes"], &ours[..]].concat(), lines)
}

/// Decoder, noise and verdict of evidence in the authors' scenes, if it uses this height of a curve, or none.
fn in_short(row: &Row, kind: &str) -> Option<String> {
    let heights = ["in %", "in logarithms"];
    let height = heights.into_iter().find(|height| row["with"].ends_with(height));
    if height != heights.into_iter().find(|height| *height == kind) {
        return None;
    }
    let decoder = if row["with"].starts_with("cnn") { "network" } else { "linear" };
    let noise = if row["with"].contains("noise = 0.03") { ", 3 % noise" } else { "" };
    Some(format!("{decoder}{noise}: {}", verdict(row)))
}

/// Claims with another verdict on the test set, which selects the body and which the paper reports, than on the held-out set.
pub fn on_the_test_set() -> String {
    let evidence = as_rows(evidence_table(found()));
    let of_set = |set| evidence.iter().filter(move |row| row["set"] == set);
    let lines = of_set("test").filter_map(|test| {
        let holdout =
            of_set("holdout").find(|row| [&row["claim"], &row["with"]] == [&test["claim"], &test["with"]])?;
        let (reader, kind) = with(&test["with"])?;
        let says = CLAIMS[number(test, "claim") as usize - 1].says;
        let reader = match brain(reader) {
            reader if kind.is_empty() => reader.to_owned(),
            reader => format!("{reader} ({kind})"),
        };
        (test["rating"] != holdout["rating"])
            .then(|| vec![says.to_owned(), reader, verdict(test), verdict(holdout)])
    });
    table(&["claim", "decoder", "on the test set", "on the held-out set"], lines)
}

pub fn evaluate() -> String {
    let all = rows("evaluate/table.csv");
    let line = |body: &str| {
        let [measured, simulated] =
            ["measured", "simulated"].map(|signals| only_row(&all, &[("body", body), ("signals", signals)]));
        let interval = ratio(measured, "error_test", "test_low", "test_high");
        let gain = |row: &Row| ratio(row, "ratio", "ratio_low", "ratio_high");
        vec![body.to_owned(), interval, percent(simulated, "error_test"), gain(measured), gain(simulated)]
    };
    table(
        &[
            "body",
            "error on unseen records (%, 95 % interval over records)",
            "expected from the model",
            "initial error / this error",
            "expected from the model",
        ],
        ["initial", "optimised"].map(line),
    )
}

/// Bodies trained with the complete protocol of the paper, per seed and together: errors as the paper reports them, and held-out
/// errors.
pub fn paper_protocol() -> String {
    of_protocol("fig2", &["0", "1"])
}

/// The same under blows, with networks of 1000 iterations.
pub fn paper_protocol_blows() -> String {
    of_protocol("fig3", &["0"])
}

/// Four forces with the same protocol, one line per number of sensors: geometric means over the placements that were trained. Then
/// six sensors on the initial body beside two on the trained body, on the same placements.
pub fn paper_protocol_four_forces() -> String {
    let [networks, samples] = ["networks", "samples"].map(|name| rows(&format!("fig4b/{name}.csv")));
    // Errors of the initial body with `untrained` sensors and of the trained body with `trained` sensors, by placement.
    let pairs = |untrained: &str, trained: &str, set: &str| -> Vec<(f64, f64)> {
        of(&networks, &[("sensors", trained), ("body", "optimised")])
            .map(|row| {
                let beside =
                    [("sensors", untrained), ("body", "initial"), ("placement", row["placement"].as_str())];
                (number(only_row(&networks, &beside), set), number(row, set))
            })
            .collect()
    };
    let times = |pairs: &[(f64, f64)]| {
        let logs: Vec<f64> = pairs.iter().map(|(untrained, trained)| (untrained / trained).ln()).collect();
        with_interval(&logs, f64::exp)
    };
    let sets = ["error_test", "error_holdout"];
    let placements = |trained: &str| pairs(trained, trained, sets[0]).len().to_string();
    let line = |sensors: &str| {
        let change = |set| {
            let pairs = pairs(sensors, sensors, set);
            let [initial, trained] =
                [geometric(pairs.iter().map(|pair| pair.0)), geometric(pairs.iter().map(|pair| pair.1))];
            format!("{initial} → {trained} %, {}", times(&pairs))
        };
        let better = vec![better(&samples, &[("sensors", sensors)])];
        [vec![sensors.to_owned(), placements(sensors)], sets.map(change).to_vec(), better].concat()
    };
    let few = sets.map(|set| times(&pairs("6", "2", set))).to_vec();
    let last =
        [vec!["initial with six / trained with two".to_owned(), placements("2")], few, vec![String::new()]];
    table(
        &["sensors", "placements", "test set", "held-out set", "test samples with less error"],
        ["1", "2", "3", "6"].map(line).into_iter().chain([last.concat()]),
    )
}

/// Number of samples with less error on the trained body.
fn better(samples: &[Row], wanted: &[(&str, &str)]) -> String {
    let tested: Vec<&Row> = of(samples, wanted).collect();
    let better =
        tested.iter().filter(|row| number(row, "error_optimised") < number(row, "error_initial")).count();
    format!("{better} of {}", tested.len())
}

fn of_protocol(folder: &str, of_body: &[&'static str]) -> String {
    const BODIES: [&str; 2] = ["initial", "optimised"];
    let [networks, curves, samples] =
        ["networks", "curves", "samples"].map(|name| rows(&format!("{folder}/{name}.csv")));
    let errors = |seed: &str, network: &str, set: &str| {
        BODIES.map(|body| {
            number(only_row(&networks, &[("seed", seed), ("network", network), ("body", body)]), set)
        })
    };
    let fewer = |seed: &str, value: &str| {
        let [initial, optimised] = BODIES.map(|body| {
            let wanted = [("seed", seed), ("body", body)];
            of(&curves, &wanted)
                .map(|row| (number(row, "iteration") as u32, number(row, value)))
                .collect::<Vec<_>>()
        });
        iteration_ratio(&initial, &optimised).unwrap()
    };
    let both = |network: &&'static str| ["error_test", "error_holdout"].map(|set| (*network, set));
    let sets: Vec<(&str, &str)> = of_body.iter().flat_map(both).collect();
    let curved = ["loss", "error_holdout"];
    let line = |seed: &str| {
        let change = |&(network, set): &(&str, &str)| {
            let [initial, optimised] = errors(seed, network, set);
            let [a, b, times] = [initial, optimised, initial / optimised].map(|x| short(&x.to_string()));
            format!("{a} → {b} %, {times}")
        };
        let fewer = curved.map(|value| short(&fewer(seed, value).to_string())).to_vec();
        let changes = sets.iter().map(change).collect();
        [vec![seed.to_owned()], changes, vec![better(&samples, &[("seed", seed)])], fewer].concat()
    };
    let seeds = seeds(&networks);
    let all = |times: &dyn Fn(&str) -> f64| {
        let logs: Vec<f64> = seeds.iter().map(|seed| times(seed).ln()).collect();
        with_interval(&logs, f64::exp)
    };
    let times = |&(network, set): &(&str, &str)| {
        all(&|seed| {
            let [initial, optimised] = errors(seed, network, set);
            initial / optimised
        })
    };
    let last = [
        vec!["all: ratio (95 % interval)".into()],
        sets.iter().map(times).collect(),
        vec![better(&samples, &[])],
        curved.map(|value| all(&|seed| fewer(seed, value))).to_vec(),
    ];
    let errors = ["test set", "held-out set", "10 000 iterations: test set", "held-out set"];
    let others = [
        "test samples with less error",
        "fewer iterations to equal training loss",
        "to equal held-out error",
    ];
    table(
        &[&["seed"], &errors[..sets.len()], &others].concat(),
        seeds.iter().copied().map(line).chain([last.concat()]),
    )
}

/// Error against run time by protocol.
pub fn protocols() -> String {
    let line = |row: &Value| {
        let protocol = match row["protocol"].as_str().unwrap() {
            "initial" => "(initial body)".into(),
            removed @ ("warm" | "envelope") => format!("`{removed}`, since removed"),
            other => format!("`{other}`"),
        };
        let seconds = format!("{:.0}", row["cpu_seconds"].as_f64().unwrap());
        let error = short(&row["holdout_error_percent"].to_string());
        vec![protocol, seconds, row["step"].to_string(), format!("{error} %")]
    };
    table(
        &["protocol", "CPU seconds of outer steps", "outer steps", "held-out error"],
        lines("protocols.jsonl").iter().map(line),
    )
}

/// Change of the held-out loss by a step along each gradient.
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
