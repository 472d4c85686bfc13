//! The paper's settings beside those of our specs. The paper's supplement with sizes, material and pulses is not released.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use metasense::plan::Plan;
use metasense_schemas::spec::flatten;
use metasense_source::Source;
use serde_json::Value;

use super::{root, table};

/// A row: setting, value in the paper, value in the authors' code (empty: none), keys of the specs.
type Row = (&'static str, &'static str, &'static str, &'static [&'static str]);

/// Files of the authors' code at commits A, B, C, D, which the page names.
const ROWS: &[Row] = &[
    (
        "units (columns, rows)",
        "",
        "5, 4; also two force plates and a held plate (A `structures.py`)",
        &["body.columns", "body.rows"],
    ),
    ("pitch (mm)", "", "16.125 (A `geometry.py`)", &["body.spacing"]),
    ("ligament length (mm)", "", "1.125 (A `geometry.py`)", &["body.ligament_length"]),
    ("initial angle (°)", "", "alternately −25 and 25 (A `structures.py`)", &["body.initial_angle"]),
    (
        "stiffness: stretch, shear (N/mm), bend (N mm)",
        "identified, not printed",
        "4.0; 0.84; 0.215216 (A `structures.py`)",
        &["body.stiffness.stretch", "body.stiffness.shear", "body.stiffness.bend"],
    ),
    ("strain of ligaments", "nonlinear", "linearised in planar bodies (A `energy.py`)", &["body.linearised"]),
    ("density (Mg/mm²)", "Dragon Skin 10 Fast, cast", "3.2325226e-8 (A `structures.py`)", &["body.density"]),
    ("masses and moments of inertia", "", "kept from the initial body (A, B, C)", &["body.inertia"]),
    (
        "damping: c_u, c_v (N s/mm), c_θ (N mm s), or a ratio",
        "viscous",
        "3.48719e-4, 3.48719e-4, 6.86211e-4 for every unit (A `structures.py`)",
        &["body.damping", "body.damping_ratio"],
    ),
    ("contact energy", "optional", "off (A `structures.py`); on in a script of B", &["body.contact"]),
    ("held units", "", "the plate below all columns (A `structures.py`)", &["body.clamp"]),
    (
        "loaded units",
        "two on the top boundary",
        "one plate per two columns, at its centroid (A `structures.py`)",
        &["panel_units"],
    ),
    ("unit of the sensor", "one, near the centre", "7 (A `structures.py`)", &["sensor_units"]),
    ("frame of the accelerations", "", "fixed axes (A `solver.py`)", &["sensors.frame"]),
    (
        "mass (Mg), moment of inertia (Mg mm²) of the chip",
        "WT9011DCL",
        "8.58e-6, 1.1104e-3; 1 g and its moment by density (A `structures.py`)",
        &["sensors.mass", "sensors.inertia"],
    ),
    ("noise of the sensor", "", "none", &["sensors.noise"]),
    ("range, filter and mounting of the chip", "", "", &["sensors.range", "sensors.bandwidth"]),
    (
        "time (s), samples",
        "1, 200",
        "1, 200 with the instant 0 (A `solver.py`)",
        &["time.duration", "time.samples"],
    ),
    (
        "integrator, tolerance",
        "Tsit5 (Diffrax)",
        "Tsit5, 1e-4 (A `solver.py`): integration errors of 2 … 13 %",
        &["solver.method", "solver.tolerance"],
    ),
    ("training and test samples", "300", "300 (D `neural_networks.py`)", &["stimuli.samples"]),
    (
        "test samples",
        "30",
        "30, drawn with replacement (D `neural_networks.py`)",
        &["stimuli.test", "stimuli.replacement"],
    ),
    ("held-out samples", "none", "none", &["stimuli.holdout"]),
    (
        "kind of virtual pulses",
        "\"shapes\", \"time delays\"",
        "Gaussian (names of files in A)",
        &["stimuli.kind"],
    ),
    (
        "amplitude (N), width, onset of the pulses (s)",
        "",
        "",
        &["stimuli.amplitude", "stimuli.width", "stimuli.onset"],
    ),
    ("probability that a panel has no force", "", "", &["stimuli.silent"]),
    ("measured blows", "150 per panel", "300 per body; rate, trigger and filter are in no file", &[]),
    (
        "network",
        "filters 64, 64, K; kernels 3, 3, 1; ReLU",
        "the same (D `neural_networks.py`)",
        &["brain.preset"],
    ),
    (
        "training of the network: iterations, rate of Adam",
        "1000; 0.01",
        "1000; 0.01 (D `neural_networks.py`)",
        &["brain.iterations", "brain.learning_rate"],
    ),
    (
        "scale of signals and forces",
        "normalised",
        "to [−1, 1] and [0, 1] by the initial body's training samples (D `neural_networks.py`)",
        &["brain.scaling"],
    ),
    (
        "loss of the body",
        "mean square on the test set",
        "the same, of scaled forces (B, C `cooptimize_*`)",
        &[],
    ),
    (
        "gradient of the test loss",
        "main text: through signals; Methods: through weights",
        "both terms (B, C `cooptimize_*`)",
        &["optimise.gradient"],
    ),
    ("implicit system", "conjugate gradients, 1e-7, 20 iterations", "the same (C `cooptimize_*`)", &[]),
    (
        "outer steps, rate of Adam (mm)",
        "100; 0.1",
        "100; 0.1 (C `cooptimize_*`)",
        &["optimise.iterations", "optimise.learning_rate"],
    ),
    ("reported body", "", "step 95 (Fig. 2) or the least test loss (B notebooks)", &[]),
    ("limits of the design", "no overlap", "none (B, C `cooptimize_*`)", &["feasible.limits"]),
    (
        "prediction error",
        "mean over samples of Σ(f − f̂)²/Σf²",
        "mean square of scaled forces on the test set",
        &[],
    ),
];

/// Keys that a body's file replaces.
const FROM_FILE: [&str; 5] =
    ["body.columns", "body.rows", "body.spacing", "body.ligament_length", "body.initial_angle"];

/// A trial's spec by path.
type Spec = BTreeMap<String, Value>;

/// The value at a path.
fn at(spec: &Spec, path: &str) -> String {
    match spec.get(path).unwrap_or(&Value::Null) {
        Value::Null => "–".into(),
        Value::Number(number) if number.is_f64() => {
            let digits = format!("{:.4e}", number.as_f64().unwrap());
            format!("{:?}", digits.parse::<f64>().unwrap())
        }
        Value::Array(values) if values.len() == 3 && values.iter().all(Value::is_f64) => values
            .iter()
            .map(|value| format!("{:.5e}", value.as_f64().unwrap()))
            .collect::<Vec<_>>()
            .join(", "),
        other => other.to_string().replace(',', ", ").replace('"', ""),
    }
}

/// The trials of the spec of a figure.
fn trials(figure: &str) -> Vec<Spec> {
    let file: PathBuf = root().join(format!("schemas/sweeps/{figure}.toml"));
    let text = std::fs::read_to_string(&file).expect(figure);
    let plan = Plan::of(Source::spec(&file, text, &[]).expect("a spec")).expect("a plan");
    plan.trials.iter().map(|trial| flatten(&serde_json::to_value(&trial.spec).expect("JSON"))).collect()
}

/// The same for Figs. 2 to 5, with keys of our reference scenes.
const OTHERS: &[Row] = &[
    ("body", "Fig. 4C much larger, Fig. 5 circular", "planar; circular", &["body.layout"]),
    (
        "columns, rows",
        "",
        "K = 2: 5, 4; K = 4: 11, 6; K = 8: 23, 6; discs: 10 … 35, 11 sizes",
        &["body.columns", "body.rows"],
    ),
    (
        "pitch, ligament length (mm)",
        "",
        "16.125; 1.125, also in the discs, which grow",
        &["body.spacing", "body.ligament_length"],
    ),
    ("bending (N mm)", "", "0.215216", &["body.stiffness.bend"]),
    (
        "rate of the body's steps, least edge, clearances (mm)",
        "",
        "0.1; no limits",
        &["optimise.learning_rate", "feasible.min_edge", "feasible.clearance", "feasible.ligament_clearance"],
    ),
    ("held units", "", "planar: the plate below; discs: none", &["body.clamp"]),
    ("cells whose shifts are tied", "none: units alone vary", "none", &["optimise.tie"]),
    ("forces K", "Fig. 3: 2, 4B: 4, 4C and 5: 8", "the same", &["point.panels"]),
    (
        "sensors M",
        "Fig. 4: several, 4B to 6 at least; Fig. 5: 4",
        "Fig. 4: 1 … 6; Fig. 5: 4",
        &["point.sensors"],
    ),
    ("placements", "Fig. 4: 5 per M", "K = 4 and discs: lists; K = 8: in no file", &["point.placement"]),
    ("seeds", "", "0", &["point.seed"]),
    (
        "iterations of further networks on both bodies",
        "Fig. 2: 10 000",
        "none",
        &["evaluation.long_iterations"],
    ),
    ("kind of forces", "Fig. 3: measured blows", "Gaussian; Fig. 3: recorded", &["stimuli.kind"]),
    ("amplitude (N)", "", "", &["stimuli.amplitude"]),
    ("width (s)", "", "", &["stimuli.width"]),
    ("peak (fraction of a pulse); power of its flanks", "", "Gaussian", &["stimuli.peak", "stimuli.power"]),
    (
        "roughness; a second blow: probability, delay (s), strength",
        "measured",
        "recorded",
        &["stimuli.roughness", "stimuli.double", "stimuli.gap", "stimuli.rebound"],
    ),
];

/// Settings of the other figures' specs, beside those of Fig. 2.
pub fn other_figures() -> String {
    let figures = ["fig2", "fig3", "fig4b", "fig4c", "fig5"].map(trials);
    let values = |trials: &[Spec], key: &str| {
        let mut found: Vec<String> = Vec::new();
        for value in trials.iter().map(|spec| at(spec, key)) {
            if !found.contains(&value) {
                found.push(value);
            }
        }
        found.join(", ")
    };
    // no other key differs
    let told: Vec<&str> =
        OTHERS.iter().flat_map(|row| row.3).copied().chain(["panel_units", "sensor_units"]).collect();
    let every: BTreeSet<&String> = figures.iter().flatten().flat_map(BTreeMap::keys).collect();
    let differs = |path: &&&String| {
        let of_each = figures.each_ref().map(|trials| values(trials, path));
        !told.contains(&path.as_str()) && of_each.iter().any(|own| *own != of_each[0])
    };
    assert_eq!(every.iter().filter(differs).collect::<Vec<_>>(), Vec::<&&String>::new());
    let row = |(what, paper, code, keys): &Row| {
        let mut cells = vec![(*what).to_owned(), (*paper).to_owned(), known(paper, code)];
        cells.extend(
            figures
                .each_ref()
                .map(|trials| keys.iter().map(|key| values(trials, key)).collect::<Vec<_>>().join("; ")),
        );
        cells
    };
    let columns =
        ["setting", "the paper", "the authors' code", "`fig2`", "`fig3`", "`fig4b`", "`fig4c`", "`fig5`"];
    table(&columns, OTHERS.iter().map(row))
}

/// The value in the code; "unknown" if neither the paper nor the code has one.
fn known(paper: &str, code: &str) -> String {
    if paper.is_empty() && code.is_empty() { "*unknown*".to_owned() } else { code.to_owned() }
}

pub fn deviations() -> String {
    let specs = ["authors-fig2-paper", "fig2"].map(|figure| trials(figure).swap_remove(0));
    let row = |(what, paper, code, keys): &Row| {
        let of = |spec: &Spec| {
            let drawn = keys.iter().any(|key| FROM_FILE.contains(key)) && !spec.contains_key("body.columns");
            match drawn {
                true => "from the body file".to_owned(),
                false => keys.iter().map(|key| at(spec, key)).collect::<Vec<_>>().join("; "),
            }
        };
        let keys: Vec<String> = keys.iter().map(|key| format!("`{key}`")).collect();
        let [theirs, ours] = specs.each_ref().map(of);
        vec![(*what).to_owned(), (*paper).to_owned(), known(paper, code), theirs, ours, keys.join(", ")]
    };
    let columns = ["setting", "the paper", "the authors' code", "`authors-fig2-paper`", "`fig2`", "keys"];
    table(&columns, ROWS.iter().map(row))
}
