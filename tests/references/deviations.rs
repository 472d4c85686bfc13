//! Where we stand beside the paper: what it says, what the specs of its figures have. The supplement with its sizes, material and pulses is not
//! released.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use metasense::plan::Plan;
use metasense_schemas::source::Source;
use metasense_schemas::spec::flatten;
use serde_json::Value;

use super::{root, table};

/// Words, what the paper says (empty: nothing), the keys of `fig2`, and what there is to say besides.
const ROWS: &[(&str, &str, &[&str], &str)] = &[
    (
        "units (columns, rows)",
        "",
        &["body.columns", "body.rows"],
        "the pictures show lattices of some such size",
    ),
    ("pitch (mm)", "", &["body.spacing"], "its chip, 23.5 × 32.5 mm, asks for more: `real-scale`"),
    ("ligament length (mm)", "", &["body.ligament_length"], ""),
    ("initial angle (°)", "", &["body.initial_angle"], ""),
    (
        "stiffness: stretch, shear (N/mm), bend (N mm)",
        "identified, not printed",
        &["body.stiffness.stretch", "body.stiffness.shear", "body.stiffness.bend"],
        "",
    ),
    (
        "density (Mg/mm²)",
        "Dragon Skin 10 Fast, cast",
        &["body.density"],
        "its sheet: `body.material`, `real-scale`",
    ),
    (
        "damping",
        "viscous",
        &["body.damping_ratio"],
        "of the critical, by the square of angle 0, whatever the design",
    ),
    ("contact energy", "optional", &["body.contact"], "off; `body.contact` turns it on"),
    ("where the body is held", "", &["body.clamp"], ""),
    ("panels", "two on the top boundary", &["panel_units"], "which units and direction: ours"),
    (
        "sensor",
        "one, near the centre",
        &["sensor_units"],
        "which unit: ours; several are at random, five placements",
    ),
    ("frame of the accelerations", "", &["sensors.frame"], "`\"body\"` turns with the unit"),
    (
        "the chip's mass, range, noise",
        "WT9011DCL",
        &["sensors.chip"],
        "an ideal chip; `sensors.chip` has that one's figures",
    ),
    ("time (s), samples of it", "1, 200", &["time.duration", "time.samples"], ""),
    (
        "integrator",
        "Tsit5 (Diffrax), tolerance not printed",
        &["solver.method", "solver.tolerance"],
        "`auto` may choose splittings of less cost at equal error",
    ),
    ("samples that train and test the brain", "300", &["stimuli.samples"], ""),
    (
        "test samples",
        "30",
        &["stimuli.test"],
        "of these, so 270 train; whether they are in the paper's 300 is not printed",
    ),
    (
        "further samples, that no loop sees",
        "none",
        &["stimuli.holdout"],
        "the paper's errors are those of the set that steers its bodies",
    ),
    ("virtual pulses: amplitude (N)", "", &["stimuli.amplitude"], ""),
    ("duration (s)", "", &["stimuli.width"], ""),
    ("onset (s)", "\"time delays\"", &["stimuli.onset"], ""),
    ("peak, as a part of the pulse", "\"shapes\"", &["stimuli.peak"], ""),
    ("power of its flanks", "\"shapes\"", &["stimuli.power"], ""),
    (
        "blows",
        "measured, 150 on each panel",
        &[],
        "not released: `stimuli.kind = \"irregular\"` is a model of them, `\"recorded\"` reads one's own",
    ),
    (
        "network",
        "convolutions of 64, 64 and K filters, kernels 3, 3, 1, ReLU, SAME",
        &["brain.preset"],
        "the same, the default",
    ),
    (
        "its training",
        "1000 steps of Adam, rate 0.01",
        &["brain.iterations", "brain.learning_rate"],
        "the whole set in each",
    ),
    (
        "inputs of the network",
        "",
        &[],
        "each over the RMS of its kind on the initial body's training signals",
    ),
    ("training loss", "of normalised forces", &[], "each panel by mean and deviation of its training forces"),
    ("loss of the body", "mean square on the test set (N²)", &[], "the same"),
    (
        "gradient",
        "main text: through the signals; Methods: through the trained weights",
        &["optimise.gradient"],
        "the sum, which is the derivative; `\"direct\"` and `\"implicit_only\"` take what is printed there",
    ),
    (
        "implicit systems",
        "conjugate gradients, 10⁻⁷, 20 iterations",
        &["optimise.curvature"],
        "the same, stopped at negative curvature: training has not ended at a minimum",
    ),
    (
        "steps of the body",
        "100 of Adam, rate 0.1",
        &["optimise.iterations", "optimise.learning_rate"],
        "a rate in mm",
    ),
    ("which body counts", "", &[], "the best by the test set"),
    (
        "angles of corners (°), of voids, of ligaments",
        "",
        &[
            "feasible.min_block_angle",
            "feasible.max_block_angle",
            "feasible.min_void_angle",
            "feasible.min_ligament_angle",
        ],
        "no overlap in the paper; limits are ours",
    ),
    (
        "least edge, clearances (mm)",
        "",
        &["feasible.min_edge", "feasible.clearance", "feasible.ligament_clearance"],
        "",
    ),
    ("prediction error", "mean over samples of Σ(f − f̂)²/Σf²", &[], "the same, on test set and holdout"),
    (
        "fewer iterations",
        "to the same accuracy, of one training",
        &[],
        "to the worse of the two best values, by training loss and by holdout error",
    ),
];

/// A trial's spec by path.
type Spec = BTreeMap<String, Value>;

/// What stands at a path.
fn at(spec: &Spec, path: &str) -> String {
    match spec.get(path).unwrap_or(&Value::Null) {
        Value::Null => "–".into(),
        Value::Number(number) if number.is_f64() => {
            let digits = format!("{:.4e}", number.as_f64().unwrap());
            format!("{:?}", digits.parse::<f64>().unwrap())
        }
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

/// Words, what the paper says of Figs. 3 to 5, the keys whose values the figures' specs have.
const OTHERS: &[(&str, &str, &[&str])] = &[
    ("body", "Fig. 4C much larger, Fig. 5 circular", &["body.layout"]),
    ("columns, rows", "", &["body.columns", "body.rows"]),
    ("pitch, ligament length (mm)", "", &["body.spacing", "body.ligament_length"]),
    ("bending (N mm), by the pitch squared", "", &["body.stiffness.bend"]),
    (
        "by the pitch: rate of the body's steps, least edge, clearances (mm)",
        "",
        &["optimise.learning_rate", "feasible.min_edge", "feasible.clearance", "feasible.ligament_clearance"],
    ),
    ("where it is held", "", &["body.clamp"]),
    ("cells whose shifts are tied", "none: units alone vary", &["optimise.tie"]),
    ("forces K", "Fig. 3: 2, 4B: 4, 4C and 5: 8", &["point.panels"]),
    ("sensors M", "Fig. 4: several, 4B to 6 at least; Fig. 5: 4", &["point.sensors"]),
    ("placements", "Fig. 4: 5 for each M", &["point.placement"]),
    ("seeds", "", &["point.seed"]),
    ("iterations of further networks on both bodies", "Fig. 2: 10 000", &["evaluation.long_iterations"]),
    ("forces: kind", "Fig. 3: measured blows", &["stimuli.kind"]),
    ("amplitude (N)", "", &["stimuli.amplitude"]),
    ("duration (s)", "", &["stimuli.width"]),
    ("peak, as a part of a pulse; power of its flanks", "", &["stimuli.peak", "stimuli.power"]),
    (
        "roughness; a second blow: how often, after (s), how strong",
        "",
        &["stimuli.roughness", "stimuli.double", "stimuli.gap", "stimuli.rebound"],
    ),
];

/// What the specs of the other figures have; those of Fig. 2 beside them.
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
    // in nothing else
    let told: Vec<&str> =
        OTHERS.iter().flat_map(|row| row.2).copied().chain(["panel_units", "sensor_units"]).collect();
    let every: BTreeSet<&String> = figures.iter().flatten().flat_map(BTreeMap::keys).collect();
    let differs = |path: &&&String| {
        let of_each = figures.each_ref().map(|trials| values(trials, path));
        !told.contains(&path.as_str()) && of_each.iter().any(|own| *own != of_each[0])
    };
    assert_eq!(every.iter().filter(differs).collect::<Vec<_>>(), Vec::<&&String>::new());
    let row = |(what, paper, keys): &(&str, &str, &[&str])| {
        let mut cells = vec![(*what).to_owned(), unknown(paper)];
        cells.extend(
            figures
                .each_ref()
                .map(|trials| keys.iter().map(|key| values(trials, key)).collect::<Vec<_>>().join("; ")),
        );
        cells
    };
    table(&["what", "the paper", "`fig2`", "`fig3`", "`fig4b`", "`fig4c`", "`fig5`"], OTHERS.iter().map(row))
}

fn unknown(text: &str) -> String {
    if text.is_empty() { "*unknown*".to_owned() } else { text.to_owned() }
}

pub fn deviations() -> String {
    let spec = trials("fig2").swap_remove(0);
    let row = |(what, paper, keys, note): &(&str, &str, &[&str], &str)| {
        let ours: Vec<String> = keys.iter().map(|key| at(&spec, key)).collect();
        let keys: Vec<String> = keys.iter().map(|key| format!("`{key}`")).collect();
        vec![(*what).to_owned(), unknown(paper), ours.join("; "), keys.join(", "), (*note).to_owned()]
    };
    table(&["what", "the paper", "ours", "key", "besides"], ROWS.iter().map(row))
}
