//! Tables of README: results of its first command, and the findings.

use super::brains::setting;
use super::rows::{Row, brain, change, of, only_row, percent, rows, spread};
use super::{table, who_senses};

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
            "decoder (training and evaluation)",
            "error, initial body",
            "trained body",
            "linear decoder afterwards: initial body",
            "trained",
        ],
        rows.iter().map(line),
    )
}

/// Findings with their numbers.
pub fn findings() -> String {
    let brains = rows("brains-two-core/answer-brains.csv");
    let setting = setting("bell", "");
    let own = |name: &str| {
        let wanted = [("setting", &*setting), ("trained_with", name), ("read_by", name)];
        // Linear decoders also have rows with shorter memories, after the longest.
        change(of(&brains, &wanted).next().unwrap())
    };
    let placed = rows("placed-two-core/answer-placed.csv");
    let place = |m: &str| {
        only_row(&placed, &[("setting", "K = 4, linear, stimuli.kind = bell"), ("set", "holdout"), ("M", m)])
    };
    let claims: Vec<Row> =
        super::claims::rated().into_iter().filter(|row| !row["says"].starts_with("not claimed")).collect();
    let all = claims.iter().filter(|row| row["rating"].starts_with("holds")).count();
    let some =
        |row: &&Row| ["holds", "compatible", "in part"].iter().any(|rating| row["rating"].contains(rating));
    let fails = claims.iter().filter(|row| !some(row) && row["rating"].contains("fails")).count();
    let some = claims.iter().filter(some).count() - all;
    let results = super::read("results/README.md");
    let apart = results.split("claims that have no row above").nth(1).unwrap().split("\n\n").nth(1).unwrap();
    let apart: Vec<&str> = apart.split("- *").skip(1).collect();
    let [with, without] = [3, 2].map(|channels| super::elbow_law::fallen(6, channels));
    let cast = rows("robust-two-core/answer-casts.csv");
    let casts_row = |body: &str, read_by: &str, records: &str| {
        let wanted =
            [("setting", "K = 2, M = 1, linear"), ("body", body), ("read_by", read_by), ("records", records)];
        only_row(&cast, &wanted)
    };
    let longer = "mean of casts, iterations = 225";
    let located = |readout| {
        let [initial, trained] =
            ["initial", "optimised"].map(|body| super::tasks::position_error(readout, body));
        format!("{initial} → {trained} mm")
    };
    let (senses, [against, network]) = (who_senses::finding(), super::authors::two_against_six());
    format!(
        "{senses}\n\
         - **Train for manufacturing tolerances.** Error of one linear decoder for all casts, one sensor, two forces, median [90th \
         percentile]: initial body {}; body trained without deviations {} ({} as designed); body trained over casts {}, after three \
         times the steps {}, and with calibration on ten records of each cast {} \
         ([details](results/README.md#manufacturing-variation)).\n\
         - **Decoder memory and training complement each other.** One sensor, two forces, initial → trained body: {} with the paper's \
         network, which uses 25 ms of the signals; {} with a linear decoder of the whole second \
         ([details](results/README.md#body-or-decoder)).\n\
         - **Good placement of sensors gains as much as more sensors; training gains again.** Four forces, linear decoder: on the initial \
         body four placed sensors have {}, six random ones {}; on a trained body the four have {} \
         ([details](results/README.md#placement-of-sensors)).\n\
         - **One sensor locates a blow 20 ms after contact.** Body of 90 mm, 3 % noise, blows anywhere along its upper edge, initial → trained \
         body: mean error {} with a linear readout, {} with a small network \
         ([details](results/README.md#tasks-other-than-forces)).\n\
         - **Of {} claims of the paper, {} hold with every decoder that we tried, {} with some or in part.** {} fails; the others show no \
         effect or stay open. Of {} further claims, {} fail ([claim by claim](results/README.md#the-paper-claim-by-claim), \
         [our scenes](results/DEVIATIONS.md)). In the scene that its authors published, two sensors on a trained body {against} six on an initial \
         one with a linear decoder. With the paper's network the six have {network} times the error of the two ([details](results/README.md#the-authors-own-scene)). With one channel per force, a linear decoder reaches 90 % of the possible reduction of the error: six forces \
         need {with} sensors, {without} without gyroscopes ([details](results/README.md#number-of-sensors-for-k-forces)).",
        spread(casts_row("initial", "casts", "")),
        spread(casts_row("nominal", "casts", "")),
        percent(casts_row("nominal", "casts", ""), "designed"),
        spread(casts_row("mean of casts, iterations = 75", "casts", "")),
        spread(casts_row(longer, "casts", "")),
        spread(casts_row(longer, "records", "10")),
        own("cnn"),
        own("linear"),
        percent(place("4"), "placed_initial"),
        percent(place("6"), "random_initial"),
        percent(place("4"), "placed_optimised"),
        located("direct"),
        located("network"),
        claims.len(),
        all,
        some,
        fails,
        apart.len(),
        apart.iter().filter(|claim| claim.contains("fails")).count(),
    )
}
