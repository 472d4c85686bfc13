//! Regions in which the paper's claims hold: the `…-map.toml` specs, each by the rules at its head.

use metasense::analysis::numbers::{deviation, geometric_mean, mean};
use metasense::analysis::resample::holm;
use metasense::look::{Axis, Plot, Scale, file, legend};
use metasense_schemas::spec::Design;
use metasense_worker::{chance_above, student_above};

use super::elbow_law::{by_fall, curve, errors, readings, verdict, words};
use super::rows::{Row, geometric, interval, number, of, rows, seeds, short, with_interval};
use super::table;

/// Columns that distinguish settings, with the values of the base scene.
const MIDDLE: [(&str, &str); 5] = [
    ("noise", "0.03"),
    ("damping_ratio", "0.02"),
    ("training_samples", "120"),
    ("width", "[0.06,0.25]"),
    ("columns", "8"),
];

/// Settings: words, column, value.
pub(super) const SETTINGS: [(&str, &str, &str); 10] = [
    ("base scene", "noise", "0.03"),
    ("without noise", "noise", "0.0"),
    ("10 % noise", "noise", "0.1"),
    ("a quarter of the damping", "damping_ratio", "0.005"),
    ("30 training samples instead of 120", "training_samples", "30"),
    ("pulses of 20 to 80 ms", "width", "[0.02,0.08]"),
    ("4 columns instead of 8", "columns", "4"),
    ("four times the damping", "damping_ratio", "0.08"),
    ("370 training samples instead of 120", "training_samples", "370"),
    ("14 columns instead of 8", "columns", "14"),
];

/// Whether the row has its seed's placement for which all numbers of sensors exist.
pub(super) fn is_first_placement(row: &Row) -> bool {
    !["4", "5"].contains(&row["placement"].as_str())
}

/// Logarithms of ratios by seed: few against many sensors, placements in per cent and in logarithms, training.
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

/// Two-sided p-value of the mean, if the true mean is 0.
fn p_value(values: &[f64]) -> f64 {
    let error = deviation(values).unwrap() / (values.len() as f64).sqrt();
    2.0 * chance_above(values.len() - 1, (mean(values).unwrap() / error).abs())
}

/// The true mean that 80 % of such sweeps would distinguish from 0 at the p-value `none`.
fn detectable_mean(values: &[f64], none: f64) -> f64 {
    let (free, count) = (values.len() - 1, values.len() as f64);
    let quantiles = student_above(free, none / 2.0) + student_above(free, 0.2);
    quantiles * deviation(values).unwrap() / count.sqrt()
}

/// Values by seed with their interval and one of two words (above 0, below 0); for an open one the mean that would have been
/// detected. A star marks significance after Holm's correction.
fn rated(all: &[Vec<f64>], shown: fn(f64) -> f64, words: [&'static str; 2]) -> Vec<String> {
    rated_each(&all.iter().map(|values| (values.clone(), shown, words)).collect::<Vec<_>>(), 0.05)
}

/// Values by seed, conversion for display, words for above and below 0.
type Rated = (Vec<f64>, fn(f64) -> f64, [&'static str; 2]);

/// The same with conversions and words for each, at the p-value `none`.
fn rated_each(all: &[Rated], none: f64) -> Vec<String> {
    let plain: Vec<f64> = all.iter().map(|(values, ..)| p_value(values)).collect();
    let corrected = holm(&plain);
    let cell = |(at, (values, shown, words)): (usize, &Rated)| {
        let told = match plain[at] <= none {
            true => words[usize::from(mean(values).unwrap() < 0.0)].to_owned(),
            false => {
                format!("open (detectable {})", short(&shown(detectable_mean(values, none)).to_string()))
            }
        };
        let star = if corrected[at] <= none { "*" } else { "" };
        format!("{}: {told}{star}", with_interval(values, *shown))
    };
    all.iter().enumerate().map(cell).collect()
}

/// Bodies trained and evaluated with the linear decoder.
pub fn four_forces() -> String {
    four_forces_of("four-forces-map/trials.csv", &SETTINGS)
}

/// The same with the paper's network, with and without noise.
pub fn four_forces_network() -> String {
    four_forces_of("four-forces-map-network/trials.csv", &SETTINGS[..2])
}

/// The rows of a setting.
pub(super) fn of_setting<'a>(all: &'a [Row], (_, moved, value): (&str, &str, &str)) -> Vec<&'a Row> {
    let cell = |name: &str, middle| if name == moved { value } else { middle };
    let is_of = |row: &&Row| MIDDLE.iter().all(|(name, middle)| row[*name] == cell(name, *middle));
    all.iter().filter(is_of).collect()
}

/// Three of the ratios by setting with 95 % intervals, coloured if above or below 1.
pub fn four_forces_drawn() -> String {
    let files = [("linear", "four-forces-map"), ("network", "four-forces-map-network")];
    let all = files.map(|(_, folder)| rows(&format!("{folder}/trials.csv")));
    let mut lines: Vec<(String, [[f64; 3]; 4])> = Vec::new();
    for ((reader, _), (rows, settings)) in
        files.iter().zip([(&all[0], &SETTINGS[..]), (&all[1], &SETTINGS[..2])])
    {
        for setting in settings {
            let ratios = ratios(&of_setting(rows, *setting)).map(|values| interval(&values).map(f64::exp));
            lines.push((format!("{}, {reader}", setting.0), ratios));
        }
    }
    let plot = |(title, which): (&str, usize)| {
        let x = Axis::new(
            "ratio (above 1: as claimed)",
            Scale::Log,
            lines.iter().flat_map(|line| line.1[which]).chain([1.0]),
        );
        let y = Axis::new("", Scale::Linear, [1.0 - lines.len() as f64, 0.0]).with_names(Vec::new());
        let height = 60.0 + 17.0 * lines.len() as f64;
        let mut plot =
            Plot::new(title, x, y).sized(560.0, height).with_room(lines.iter().map(|line| &*line.0));
        plot.vertical("", 1.0, "", 0);
        for (row, (words, ratios)) in lines.iter().enumerate() {
            let ([at, low, high], y) = (ratios[which], -(row as f64));
            let class = if low > 1.0 {
                "fifth"
            } else if high < 1.0 {
                "optimised"
            } else {
                "truth"
            };
            plot.line(class, [(low, y), (high, y)]);
            plot.dots(class, [((at, y), words.clone())]);
            plot.note((high, y), words);
        }
        plot.picture()
    };
    let plots = [
        ("Initial body with six sensors / trained body with two", 0),
        ("Scatter over placements in %, initial / trained, two sensors", 1),
        ("Gain, two sensors", 3),
    ]
    .map(plot);
    let keys = [("fifth", "holds"), ("truth", "open"), ("optimised", "fails")];
    file(&plots, 1, 560.0, &legend(&keys)) + "\n"
}

/// One line per setting: errors, elbows, end of the fall, and four ratios. A star marks significance after Holm's correction.
fn four_forces_of(file: &str, settings: &[(&str, &str, &str)]) -> String {
    let all = rows(file);
    let settings: Vec<(&str, Vec<&Row>)> =
        settings.iter().map(|setting| (setting.0, of_setting(&all, *setting))).collect();
    let found: Vec<[Vec<f64>; 4]> = settings.iter().map(|(_, rows)| ratios(rows)).collect();
    let ratios = rated(&found.concat(), f64::exp, ["holds", "fails"]);
    let line = |(s, (words_of, rows)): (usize, &(&str, Vec<&Row>))| {
        let curve = curve(rows.iter().copied().filter(|row| is_first_placement(row)), "optimised");
        let told = readings(&curve)
            .map(|votes| format!("{} ({})", words(&votes), in_map(verdict(&votes, 2.0, false))));
        let mut cells = vec![(*words_of).to_owned(), errors(&curve)];
        cells.extend(told);
        cells.extend_from_slice(&ratios[4 * s..][..4]);
        cells
    };
    let head = [
        "",
        "error with 1, 2, 3, 6 sensors",
        "elbow in % at M = 2",
        "elbow in logarithms at M = 2",
        "nine tenths of the fall at M = 2",
        "six initial / two trained",
        "scatter over placements, in %",
        "scatter, in logarithms",
        "gain, two sensors",
    ];
    table(&head, settings.iter().enumerate().map(line))
}

/// One line per decoder: errors with eight forces, end of the fall, and four sensors on the trained body against four and six on
/// the initial one.
pub fn eight_forces() -> String {
    let all = rows("eight-forces-map/trials.csv");
    let brains = [("linear", "linear decoder"), ("cnn", "the paper's network")];
    let error = |brain, sensors, body| logs(&all, &[("brain", brain), ("sensors", sensors)], body);
    let of_brain =
        |(brain, _)| ["4", "6"].map(|m| less(error(brain, m, INITIAL), &error(brain, "4", TRAINED)));
    let said = rated(&brains.map(of_brain).concat(), f64::exp, ["holds", "fails"]);
    let line = |(b, (brain, words_of)): (usize, (&str, &str))| {
        let curve = curve(of(&all, &[("brain", brain)]), "optimised");
        let votes = by_fall(&curve);
        let fall = format!("{} ({})", words(&votes), in_map(verdict(&votes, 4.0, false)));
        [vec![words_of.to_owned(), errors(&curve), fall], said[2 * b..][..2].to_vec()].concat()
    };
    let head = [
        "decoder",
        "error with 1, 2, 3, 4, 6 sensors",
        "nine tenths of the fall at M = 4",
        "gain, four sensors",
        "six initial / four trained",
    ];
    table(&head, brains.into_iter().enumerate().map(line))
}

/// A disc with finer units, and the finest tied in blocks: errors, slopes of ln(error) on ln(columns), errors relative to the
/// untied disc.
pub fn discs() -> String {
    let all = rows("disc-map/trials.csv");
    let columns = ["5", "8", "12"];
    let ties = ["[6,6]", "[3,3]"];
    let of_kind = |columns, tie| [("columns", columns), ("tie", tie)];
    let slopes = [INITIAL, TRAINED].map(|column| {
        slopes_over(&columns, &columns.map(|columns| logs(&all, &of_kind(columns, ""), column)))
    });
    let untied = logs(&all, &of_kind("12", ""), TRAINED);
    let tied = ties.map(|tie| less(logs(&all, &of_kind("12", tie), TRAINED), &untied));
    let plain: fn(f64) -> f64 = |x| x;
    let all_of = slopes
        .into_iter()
        .map(|slope| (slope, plain, ["fails", "holds"]))
        .chain(tied.into_iter().map(|ratio| (ratio, f64::exp as fn(f64) -> f64, ["holds", "fails"])));
    // the second of two looks at the data: half of 5 %
    let said = rated_each(&all_of.collect::<Vec<_>>(), 0.025);
    let error =
        |columns, tie, column| geometric(of(&all, &of_kind(columns, tie)).map(|row| number(row, column)));
    let errors = |column| columns.map(|columns| error(columns, "", column)).join(", ") + " %";
    let gain_of = |columns| with_interval(&gain(&all, &of_kind(columns, "")), f64::exp);
    let none = String::new;
    let mut lines = vec![
        vec!["untrained".to_owned(), errors(INITIAL), said[0].clone(), none(), none(), none()],
        vec!["trained".to_owned(), errors(TRAINED), said[1].clone(), none(), gain_of("5"), gain_of("12")],
    ];
    let blocks = ["6 × 6", "3 × 3"].iter().zip(ties).zip(&said[2..]);
    lines.extend(blocks.map(|((block, tie), said)| {
        let error = error("12", tie, TRAINED) + " %";
        vec![
            format!("trained, 12 columns tied in blocks of {block}"),
            error,
            none(),
            said.clone(),
            none(),
            none(),
        ]
    }));
    let head = [
        "",
        "error with 5, 8, 12 columns",
        "slope of ln(error) on ln(columns)",
        "error / error of the untied disc",
        "gain with 5",
        "with 12",
    ];
    table(&head, lines)
}

/// The verdict on a law in the words for claims.
fn in_map(verdict: &str) -> &str {
    match verdict {
        "confirmed" => "holds",
        "refuted" => "fails",
        open => open,
    }
}

/// Rows with an additional column, computed from the others.
fn with_column(mut rows: Vec<Row>, name: &str, of: impl Fn(&Row) -> String) -> Vec<Row> {
    for row in &mut rows {
        let cell = of(row);
        row.insert(name.to_owned(), cell);
    }
    rows
}

/// Logarithm of a column's geometric mean over matching rows, by seed.
fn logs(rows: &[Row], wanted: &[(&str, &str)], column: &str) -> Vec<f64> {
    let own = |seed| of(rows, wanted).filter(move |row| row["seed"] == seed).map(|row| number(row, column));
    seeds(rows).into_iter().map(|seed| geometric_mean(&own(seed).collect::<Vec<_>>()).ln()).collect()
}

/// Least-squares slope on ln(size) of logarithms by size and seed; one slope per seed.
pub(super) fn slopes_over(sizes: &[&str], logs: &[Vec<f64>]) -> Vec<f64> {
    let x: Vec<f64> = sizes.iter().map(|size| size.parse::<f64>().unwrap().ln()).collect();
    let centred: Vec<f64> = x.iter().map(|value| value - mean(&x).unwrap()).collect();
    let power: f64 = centred.iter().map(|x| x * x).sum();
    let slope = |seed: usize| centred.iter().zip(logs).map(|(x, e)| x * e[seed]).sum::<f64>() / power;
    (0..logs[0].len()).map(slope).collect()
}

/// ln(initial/trained) of matching rows, by seed.
fn gain(rows: &[Row], wanted: &[(&str, &str)]) -> Vec<f64> {
    less(logs(rows, wanted, INITIAL), &logs(rows, wanted, TRAINED))
}

fn less(mut from: Vec<f64>, values: &[f64]) -> Vec<f64> {
    from.iter_mut().zip(values).for_each(|(a, b)| *a -= b);
    from
}

/// Initial → trained, geometric means of matching rows.
fn before_and_after(rows: &[Row], wanted: &[(&str, &str)]) -> String {
    let error = |column| geometric(of(rows, wanted).map(|row| number(row, column)));
    format!("{} → {} %", error(INITIAL), error(TRAINED))
}

const INITIAL: &str = "holdout_error_initial";
const TRAINED: &str = "holdout_error_optimised";

/// One line per angle: the regular body before and after training, and random bodies by the spread of their nodes.
pub fn random_bodies() -> String {
    let spread = |row: &Row| match (row["body.design.random"].as_str(), row["body.design.spread"].as_str()) {
        ("", _) => "none".to_owned(),
        (_, "") => Design::SPREAD.to_string(),
        (_, spread) => spread.to_owned(),
    };
    let all = with_column(rows("random-bodies-map/trials.csv"), "spread", spread);
    let angles = ["10.0", "20.0", "30.0", "40.0"];
    let ratios = angles.map(|angle| {
        let kind = |spread: &'static str| [("body.initial_angle", angle), ("spread", spread)];
        let regular = logs(&all, &kind("none"), INITIAL);
        let random = ["0.1", "0.25", "0.5"].map(|spread| less(logs(&all, &kind(spread), INITIAL), &regular));
        [vec![gain(&all, &kind("none"))], random.to_vec()].concat()
    });
    let said = rated(&ratios.concat(), f64::exp, ["holds", "fails"]);
    let line = |(a, angle): (usize, &str)| {
        let own = before_and_after(&all, &[("body.initial_angle", angle), ("spread", "none")]);
        [vec![format!("{}°", angle.trim_end_matches(".0")), own], said[4 * a..][..4].to_vec()].concat()
    };
    let head = [
        "rotation of squares",
        "error, initial → trained",
        "gain",
        "random / regular, nodes moved by up to 0.1 of the spacing",
        "0.25",
        "0.5",
    ];
    table(&head, angles.into_iter().enumerate().map(line))
}

/// Keys that distinguish the settings of `blows-map.toml`.
const STIMULI: [&str; 5] =
    ["stimuli.kind", "stimuli.roughness", "stimuli.double", "stimuli.width", "stimuli.amplitude"];

/// These settings with their names.
const BLOWS: [(&str, [&str; 5]); 7] = [
    ("blows", ["irregular", "[0.1,0.35]", "0.25", "[0.02,0.08]", "[0.3,1.0]"]),
    ("smooth blows", ["irregular", "[0.0,0.0]", "0.25", "[0.02,0.08]", "[0.3,1.0]"]),
    ("no second blow", ["irregular", "[0.1,0.35]", "0.0", "[0.02,0.08]", "[0.3,1.0]"]),
    ("as wide as pulses", ["irregular", "[0.1,0.35]", "0.25", "[0.06,0.25]", "[0.3,1.0]"]),
    ("as weak as pulses", ["irregular", "[0.1,0.35]", "0.25", "[0.02,0.08]", "[0.15,0.5]"]),
    ("all four", ["irregular", "[0.0,0.0]", "0.0", "[0.06,0.25]", "[0.15,0.5]"]),
    ("pulses", ["bell", "", "", "[0.06,0.25]", "[0.15,0.5]"]),
];

/// One line per setting: errors, gain from training, and its difference from the gain under blows.
pub fn blows() -> String {
    let all = rows("blows-map/trials.csv");
    let kind = |setting: [&'static str; 5], noise| -> Vec<(&str, &str)> {
        STIMULI.into_iter().zip(setting).chain([("sensors.noise", noise)]).collect()
    };
    let noises = ["0.03", ""];
    let gains = BLOWS.map(|(_, setting)| noises.map(|noise| gain(&all, &kind(setting, noise))));
    let changes = gains[1..].iter().flat_map(|own| [0, 1].map(|n| less(own[n].clone(), &gains[0][n])));
    let said = rated(&changes.collect::<Vec<_>>(), f64::exp, ["more", "less"]);
    let line = |(s, (words, setting)): (usize, (&str, [&'static str; 5]))| {
        let mut cells = vec![words.to_owned()];
        for (n, noise) in noises.into_iter().enumerate() {
            cells.push(before_and_after(&all, &kind(setting, noise)));
            cells.push(with_interval(&gains[s][n], f64::exp));
            cells.push(if s == 0 { String::new() } else { said[2 * (s - 1) + n].clone() });
        }
        cells
    };
    let head = [
        "forces",
        "3 % noise: initial → trained",
        "gain",
        "gain / gain under blows",
        "without noise",
        "gain",
        "gain / gain under blows",
    ];
    table(&head, BLOWS.into_iter().enumerate().map(line))
}

/// Bodies trained and evaluated with the linear decoder.
pub fn sizes() -> String {
    sizes_of("size-map/trials.csv")
}

/// The same with the paper's network.
pub fn sizes_network() -> String {
    sizes_of("size-map-network/trials.csv")
}

/// A body that grows with its number of units, and a body with finer units: errors by units, and slopes of ln(error) on ln(units).
fn sizes_of(file: &str) -> String {
    let way = |row: &Row| match (row["body.columns"].as_str(), row["body.spacing"].as_str()) {
        ("6", _) => "both".to_owned(),
        (_, "15.0") => "grows".to_owned(),
        _ => "finer".to_owned(),
    };
    let all = with_column(rows(file), "way", way);
    let units = ["16", "36", "64", "100"];
    let kind = |way, units| [("way", if units == "36" { "both" } else { way }), ("units", units)];
    let lines = [
        ["grows", INITIAL, "units of 15 mm, initial"],
        ["grows", TRAINED, "units of 15 mm, trained"],
        ["finer", INITIAL, "90 mm, smaller units, initial"],
        ["finer", TRAINED, "90 mm, smaller units, trained"],
    ];
    let slopes = lines.map(|[way, column, _]| {
        slopes_over(&units, &units.map(|units| logs(&all, &kind(way, units), column)))
    });
    let said = rated(&slopes, |x| x, ["fails", "holds"]);
    let line = |([way, column, words], said): ([&'static str; 3], String)| {
        let error = |units| geometric(of(&all, &kind(way, units)).map(|row| number(row, column)));
        let gains = ["16", "100"].map(|units| match column {
            TRAINED => with_interval(&gain(&all, &kind(way, units)), f64::exp),
            _ => String::new(),
        });
        let errors = units.map(error).join(", ") + " %";
        [vec![words.to_owned(), errors, said], gains.to_vec()].concat()
    };
    let head = [
        "",
        "error with 16, 36, 64, 100 units",
        "slope of ln(error) on ln(units)",
        "gain with 16",
        "with 100",
    ];
    table(&head, lines.into_iter().zip(said).map(line))
}

/// Keys that distinguish the settings of `protocol-map.toml`.
const TRAINING: [&str; 4] = ["batch", "schedule", "samples", "brain"];

/// These settings with their names.
const TRAININGS: [(&str, [&str; 4]); 5] = [
    ("base setting", ["68", "cosine", "300", ""]),
    ("a constant rate", ["68", "constant", "300", ""]),
    ("the same, all samples in each iteration", ["", "constant", "300", ""]),
    ("1000 samples instead of 300", ["68", "cosine", "1000", ""]),
    ("bodies trained with the linear decoder", ["68", "cosine", "300", "linear"]),
];

/// Networks of a kind on both bodies, by number of iterations.
struct Networks {
    rows: Vec<Row>,
    wanted: Vec<(&'static str, &'static str)>,
}

impl Networks {
    /// ln(held-out error), by seed.
    fn errors(&self, body: &str, iterations: &str) -> Vec<f64> {
        let kind = [&self.wanted[..], &[("iterations", iterations)]].concat();
        let own: Vec<Row> = of(&self.rows, &kind).filter(|row| row["body"] == body).cloned().collect();
        logs(&own, &[], "error_holdout")
    }

    fn gain(&self, iterations: &str) -> Vec<f64> {
        less(self.errors("initial", iterations), &self.errors("optimised", iterations))
    }

    /// Initial → trained, and their ratio beside the paper's number; empty without networks.
    fn cells(&self, iterations: &str, stated: f64) -> [String; 2] {
        let errors = ["initial", "optimised"].map(|body| self.errors(body, iterations));
        if errors[0].is_empty() {
            return [String::new(), String::new()];
        }
        let [before, after] = errors.map(|logs| geometric(logs.into_iter().map(f64::exp)));
        let gain = self.gain(iterations);
        let [_, low, high] = interval(&gain).map(f64::exp);
        let told = match () {
            () if low >= stated => "reached",
            () if high < stated => "below",
            () => "compatible",
        };
        [format!("{before} → {after} %"), format!("{}: {told}", with_interval(&gain, f64::exp))]
    }
}

/// One line per setting of protocol, schedule and samples, under pulses and under blows: gain from training the body, and its
/// ratio to the gain of the base setting.
pub fn protocols() -> String {
    let own = |stimuli, setting: [&'static str; 4]| Networks {
        rows: rows("protocol-map/networks.csv"),
        wanted: TRAINING.into_iter().zip(setting).chain([("stimuli", stimuli)]).collect(),
    };
    let papers = |folder: &str| Networks { rows: rows(&format!("{folder}/networks.csv")), wanted: vec![] };
    let mut settings: Vec<(&str, [Networks; 2])> = TRAININGS
        .into_iter()
        .map(|(words, setting)| (words, ["bell", "irregular"].map(|stimuli| own(stimuli, setting))))
        .collect();
    settings
        .push(("the paper's protocol, over all samples at a constant rate", ["fig2", "fig3"].map(papers)));
    let gain = |setting: usize, stimuli: usize| settings[setting].1[stimuli].gain("1000");
    // the base setting under blows against pulses; the paper's protocol against the setting with the same evaluation
    let beside = |setting, stimuli| match setting {
        0 => gain(0, 0),
        5 => gain(2, stimuli),
        _ => gain(0, stimuli),
    };
    let changes: Vec<Vec<f64>> = (0..2)
        .flat_map(|stimuli| (0..6).map(move |setting| (setting, stimuli)))
        .skip(1)
        .map(|(setting, stimuli)| less(gain(setting, stimuli), &beside(setting, stimuli)))
        .collect();
    let said = [vec![String::new()], rated(&changes, f64::exp, ["more", "less"])].concat();
    let line = |(s, (words, [pulses, blows])): (usize, &(&str, [Networks; 2]))| {
        [
            vec![(*words).to_owned()],
            pulses.cells("1000", 2.0).to_vec(),
            vec![said[s].clone()],
            pulses.cells("10000", 5.8).to_vec(),
            blows.cells("1000", 5.3).to_vec(),
            vec![said[6 + s].clone()],
        ]
        .concat()
    };
    let head = [
        "",
        "pulses: initial → trained",
        "gain (paper: 2)",
        "gain / gain of the base setting",
        "after 10 000 iterations",
        "gain (paper: 5.8)",
        "blows: initial → trained",
        "gain (paper: 5.3)",
        "gain / gain of the base setting (first row: under pulses)",
    ];
    table(&head, settings.iter().enumerate().map(line))
}
