//! The table of gains in the scenes of the paper's authors.

use std::collections::BTreeSet;

use metasense::analysis::{Cluster, Interval, Resampling};

use super::map::slopes_over;
use super::rows::{Row, geometric, in_words, number, of, rows, short, with_interval};
use super::table;

/// One line per setting, in the order of the rows: geometric mean errors of the initial and the trained body, and their ratio with
/// its interval over placements and seeds. Then the initial body with six sensors against the trained
/// body with two.
pub fn gains() -> String {
    let rows = rows("authors/trials.csv");
    let mut settings: Vec<[&str; 5]> = Vec::new();
    let of_row =
        |row: &'_ Row| ["scene", "decoder", "steps", "noise", "limits"].map(|name| row[name].clone());
    let named: Vec<[String; 5]> = rows.iter().map(of_row).collect();
    for setting in &named {
        let setting = setting.each_ref().map(String::as_str);
        if !settings.contains(&setting) {
            settings.push(setting);
        }
    }
    let pairs: Vec<([String; 5], &Row)> = named.iter().cloned().zip(&rows).collect();
    let own = |scene: &str, of_it: [&str; 4]| -> Vec<&Row> {
        let is_own = |named: &&([String; 5], &Row)| {
            named.0[0] == scene && named.0[1..].iter().zip(of_it).all(|(cell, wanted)| cell == wanted)
        };
        pairs.iter().filter(is_own).map(|(_, row)| *row).collect()
    };
    // pairs of initial and trained bodies
    let line =
        |label: String, [decoder, steps, noise, limits]: [&str; 4], initial: &[&Row], trained: &[&Row]| {
            let gain = |set: &str| {
                let errors = |of: &[&Row], body| -> Vec<f64> {
                    of.iter().map(|row| number(row, &format!("{set}_{body}"))).collect()
                };
                let (before, after) = (errors(initial, "initial"), errors(trained, "trained"));
                let logs: Vec<f64> = before.iter().zip(&after).map(|(a, b)| (a / b).ln()).collect();
                format!(
                    "{} → {} %, {}",
                    geometric(before.into_iter()),
                    geometric(after.into_iter()),
                    with_units(trained, &logs)
                )
            };
            let noise = if noise == "0" {
                "none".to_owned()
            } else {
                format!("{} %", short(&(100.0 * noise.parse::<f64>().unwrap()).to_string()))
            };
            let count = trained.len().to_string();
            let cells = [decoder, steps, &noise, limits, &count, &gain("test"), &gain("holdout")];
            std::iter::once(label).chain(cells.map(str::to_owned)).collect::<Vec<_>>()
        };
    let by_setting = settings.iter().map(|&[scene, of_it @ ..]| {
        let own = own(scene, of_it);
        line(scene.to_owned(), of_it, &own, &own)
    });
    let (few, many) = ("K = 4, M = 2", "K = 4, M = 6");
    let compared = settings.iter().filter(|setting| setting[0] == few).map(|&[_, of_it @ ..]| {
        line(format!("initial {many} / trained {few}"), of_it, &own(many, of_it), &own(few, of_it))
    });
    let columns = [
        "scene",
        "decoder",
        "outer steps",
        "noise",
        "limits",
        "trials",
        "test set, gain",
        "held-out set, gain",
    ];
    table(&columns, by_setting.chain(compared))
}

/// A geometric mean of ratios, from their logarithms, with its interval over placements and seeds.
fn with_units(rows: &[&Row], logs: &[f64]) -> String {
    let unit = |row: &Row, name: &str| row[name].parse().unwrap();
    let clusters: Vec<Cluster> = rows
        .iter()
        .map(|row| Cluster { placement: unit(row, "placement"), seed: unit(row, "seed") })
        .collect();
    let mean = |weights: &[f64]| {
        weights.iter().zip(logs).map(|(w, x)| w * x).sum::<f64>() / weights.iter().sum::<f64>()
    };
    let Interval { low, high } = Resampling::new(&clusters).interval(|weights| Some(mean(weights))).unwrap();
    in_words([mean(&vec![1.0; logs.len()]), low, high], f64::exp)
}

/// Errors of a linear decoder on each design as designed, and on its casts (medians over casts): geometric means over seeds, and for
/// each trained design the gain over the initial body with its interval.
pub fn casts() -> String {
    let rows = rows("authors/casts.csv");
    let values = |name: &str| {
        let mut values: Vec<&str> = Vec::new();
        rows.iter().map(|row| &*row[name]).for_each(|value| {
            if !values.contains(&value) {
                values.push(value);
            }
        });
        values
    };
    let errors = |noise: &str, decoder: &str, design: &str| -> Vec<f64> {
        of(&rows, &[("noise", noise), ("decoder", decoder), ("design", design)])
            .map(|row| number(row, "error"))
            .collect()
    };
    let designs = values("design");
    let cells = |noise: &str, decoder: &str| -> Vec<String> {
        let before = errors(noise, decoder, designs[0]);
        let cell = |design: &&str| {
            let after = errors(noise, decoder, design);
            let logs: Vec<f64> = before.iter().zip(&after).map(|(a, b)| (a / b).ln()).collect();
            format!("{} %, {}", geometric(after.into_iter()), with_interval(&logs, f64::exp))
        };
        let noise = if noise == "0" { "none" } else { noise };
        let head = [noise.to_owned(), decoder.to_owned(), format!("{} %", geometric(before.iter().copied()))];
        head.into_iter().chain(designs[1..].iter().map(cell)).collect()
    };
    let columns: Vec<&str> = ["noise", "error"].into_iter().chain(designs.iter().copied()).collect();
    let settings = values("noise")
        .into_iter()
        .flat_map(|noise| values("decoder").into_iter().map(move |of| (noise, of)));
    table(&columns, settings.map(|(noise, decoder)| cells(noise, decoder)))
}

/// Whether the trained body with two sensors has less held-out error than the initial body with six: with a linear decoder, by
/// geometric means over placements with and without noise; with the paper's network, the ratio and its interval.
pub fn two_against_six() -> [String; 2] {
    let rows = rows("authors/trials.csv");
    let logs = |scene: &str, decoder: &str, noise: &str, error: &str| -> Vec<f64> {
        let own = |row: &&Row| row["scene"] == scene && row["decoder"] == decoder && row["noise"] == noise;
        rows.iter().filter(own).map(|row| number(row, error).ln()).collect()
    };
    let ratios = |decoder: &str, noise: &str| -> Vec<f64> {
        let six = logs("K = 4, M = 6", decoder, noise, "holdout_initial");
        let two = logs("K = 4, M = 2", decoder, noise, "holdout_trained");
        six.iter().zip(two).map(|(six, two)| six - two).collect()
    };
    let network = [("scene", "K = 4, M = 2"), ("decoder", "the paper's network")];
    let units: Vec<&Row> = of(&rows, &network).collect();
    let less = |noise: &&str| ratios("linear", noise).iter().sum::<f64>() > 0.0;
    let linear = match ["0", "0.03"].into_iter().filter(less).count() {
        2 => "beat",
        1 => "do not always beat",
        _ => "do not beat",
    };
    [linear.to_owned(), with_units(&units, &ratios("the paper's network", "0"))]
}

/// The discs of each size, one seed: held-out errors by noise, and the slope of their logarithms on that of the number of units,
/// if there are five sizes.
pub fn discs() -> String {
    let rows = rows("authors/disc.csv");
    let (units, noises) = (|row: &Row| row["units"].parse::<u32>().unwrap(), ["0", "0.03"]);
    let sizes: BTreeSet<u32> = rows.iter().map(units).collect();
    let line = |head: String, cell: &dyn Fn(&[&Row]) -> String, size: Option<u32>| -> Vec<String> {
        let own = |noise: &str| -> Vec<&Row> {
            let is_own = |row: &&Row| row["noise"] == noise && size.is_none_or(|size| units(row) == size);
            rows.iter().filter(is_own).collect()
        };
        std::iter::once(head).chain(noises.iter().map(|noise| cell(&own(noise)))).collect()
    };
    let by_size = sizes.iter().map(|size| {
        let cell = |rows: &[&Row]| match rows {
            [row] => {
                let [before, after] = ["holdout_initial", "holdout_trained"].map(|name| number(row, name));
                let [before, after, gain] = [before, after, before / after].map(|x| short(&x.to_string()));
                format!("{before} → {after} %, {gain}")
            }
            _ => "–".to_owned(),
        };
        line(size.to_string(), &cell, Some(*size))
    });
    let slopes = ["initial", "trained"].map(|body| {
        let cell = |rows: &[&Row]| {
            if rows.len() < 5 {
                return "–".to_owned();
            }
            let sizes: Vec<&str> = rows.iter().map(|row| &*row["units"]).collect();
            let log = |row: &&Row| vec![number(row, &format!("holdout_{body}")).ln()];
            short(&slopes_over(&sizes, &rows.iter().map(log).collect::<Vec<_>>())[0].to_string())
                .replace('-', "−")
        };
        line(format!("slope, {body} body"), &cell, None)
    });
    table(&["units", "no noise", "3 % noise"], by_size.chain(slopes))
}
