//! Where in the space of scenes is what the paper claims of four forces and few sensors true: `four-forces-map.toml` by its own rules.

use metasense::analysis::numbers::{deviation, mean};
use metasense::analysis::resample::holm;
use metasense_worker::chance_above;

use super::elbow_law::{by_fall, curve, errors, verdict, words};
use super::rows::{Row, number, rows, with_interval};
use super::table;

/// The columns that tell settings apart, and the scene in the middle.
const MIDDLE: [(&str, &str); 5] = [
    ("noise", "0.03"),
    ("damping_ratio", "0.02"),
    ("samples", "150"),
    ("width", "[0.06,0.25]"),
    ("columns", "8"),
];

/// What is moved, in words.
const SETTINGS: [(&str, &str, &str); 7] = [
    ("the middle", "noise", "0.03"),
    ("without noise", "noise", "0.0"),
    ("10 % noise", "noise", "0.1"),
    ("a quarter of the damping", "damping_ratio", "0.005"),
    ("60 samples in place of 150", "samples", "60"),
    ("pulses of 20 to 80 ms", "width", "[0.02,0.08]"),
    ("4 columns in place of 8", "columns", "4"),
];

/// Of a setting, in logarithms and by seed: few beat many, placements in per cent and in logarithms, training.
fn ratios(of_setting: &[&Row]) -> [Vec<f64>; 4] {
    let error = |seed: u64, placement: u64, sensors: &str, body: &str| {
        let placed = [seed, placement].map(|x| x.to_string());
        let wanted = [("seed", &*placed[0]), ("placement", &*placed[1]), ("sensors", sensors)];
        let row = of_setting.iter().find(|row| wanted.iter().all(|(name, cell)| row[*name] == *cell));
        number(row.unwrap_or_else(|| panic!("{wanted:?}")), &format!("holdout_error_{body}"))
    };
    let seeds = 131..=134;
    let by_seed = |ratio: &dyn Fn(u64, u64) -> f64| -> Vec<f64> {
        seeds.clone().map(|seed| ratio(seed, seed - 131).ln()).collect()
    };
    let scatter = |seed, own, body: &str, shown: fn(f64) -> f64| {
        deviation(&[own, 4, 5].map(|placement| shown(error(seed, placement, "2", body)))).unwrap()
    };
    let placements = |shown: fn(f64) -> f64| {
        by_seed(&|seed, own| scatter(seed, own, "initial", shown) / scatter(seed, own, "optimised", shown))
    };
    [
        by_seed(&|seed, own| error(seed, own, "6", "initial") / error(seed, own, "2", "optimised")),
        placements(|error| error),
        placements(f64::ln),
        by_seed(&|seed, own| error(seed, own, "2", "initial") / error(seed, own, "2", "optimised")),
    ]
}

/// The chance of such a mean, to either side, if the true one is 0.
fn chance(values: &[f64]) -> f64 {
    let error = deviation(values).unwrap() / (values.len() as f64).sqrt();
    2.0 * chance_above(values.len() - 1, (mean(values).unwrap() / error).abs())
}

/// A line a setting: errors, where the fall ends, and four ratios; a star where a ratio stands beside all others (Holm).
pub fn all() -> String {
    let all = rows("four-forces-map/trials.csv");
    let settings: Vec<(&str, Vec<&Row>)> = SETTINGS
        .iter()
        .map(|(words, moved, value)| {
            let cell = |name: &str, middle| if name == *moved { *value } else { middle };
            let is_of = |row: &&Row| MIDDLE.iter().all(|(name, middle)| row[*name] == cell(name, *middle));
            (*words, all.iter().filter(is_of).collect())
        })
        .collect();
    let found: Vec<[Vec<f64>; 4]> = settings.iter().map(|(_, rows)| ratios(rows)).collect();
    let chances: Vec<f64> = found.iter().flatten().map(|values| chance(values)).collect();
    let (corrected, plain) = (holm(&chances), chances);
    let line = |(s, (words_of, rows)): (usize, &(&str, Vec<&Row>))| {
        let main = |row: &&&Row| !["4", "5"].contains(&row["placement"].as_str());
        let curve = curve(rows.iter().filter(main).copied(), "optimised");
        let votes = by_fall(&curve);
        let told = match verdict(&votes, 2.0, false) {
            "confirmed" => "holds",
            "refuted" => "fails",
            open => open,
        };
        let ratio = |q: usize| {
            let (values, at) = (&found[s][q], 4 * s + q);
            let rated = match (plain[at] <= 0.05, mean(values).unwrap() > 0.0) {
                (false, _) => "open",
                (true, true) => "holds",
                (true, false) => "fails",
            };
            let star = if corrected[at] <= 0.05 { "*" } else { "" };
            format!("{}: {rated}{star}", with_interval(values, f64::exp))
        };
        let mut cells = vec![(*words_of).to_owned(), errors(&curve)];
        cells.push(format!("{}: {told}", words(&votes)));
        cells.extend((0..4).map(ratio));
        cells
    };
    let head = [
        "",
        "error with 1, 2, 3, 6 sensors",
        "nine tenths of the fall: with two",
        "two trained by six untrained",
        "scatter of placements, in %",
        "in logarithms",
        "trained by untrained, two sensors",
    ];
    table(&head, settings.iter().enumerate().map(line))
}
