//! Memory and nonlinearity of the initial and the trained body.

use super::numbers::{in_order, mean};
use super::paired::Ratio;
use super::tables::ends;
use super::trial::Cluster;
use metasense_render::{Table, row};

/// A measure of both bodies of a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct CapacityResult {
    /// Group of the trial: equal K, M and decoder in training.
    pub setting: String,
    /// Placement and seed.
    pub cluster: Cluster,
    /// Task for which the body was trained.
    pub trained_for: String,
    /// Name of the measure.
    pub measure: &'static str,
    /// Values of the initial and the trained body.
    pub values: [f64; 2],
    /// Upper bound of a capacity; `None` for errors.
    pub bound: Option<f64>,
}

/// Returns one row per setting, training and measure: means over trials, and the change by training with its 95 % interval over
/// placements and seeds: the mean difference trained − initial of capacities, the geometric mean ratio initial/trained of errors.
pub fn table(all: &[CapacityResult]) -> Table {
    let columns = "setting trained_for measure trials bound initial optimised change change_low change_high";
    let kind = |own: &CapacityResult| (own.setting.clone(), own.trained_for.clone(), own.measure);
    let line = |wanted: (String, String, &'static str)| {
        let own: Vec<&CapacityResult> = all.iter().filter(|own| kind(own) == wanted).collect();
        let is_error = own[0].bound.is_none();
        let ratio = |[initial, trained]: [f64; 2]| match is_error {
            true => initial / trained,
            false => (trained - initial).exp(), // its logarithm is shown
        };
        let shown = |ratio: f64| if is_error { ratio } else { ratio.ln() };
        let change = |own: &&CapacityResult| (own.cluster, ratio(own.values));
        let found = Ratio::of(own.iter().map(change));
        let interval = found.as_ref().and_then(|ratio| ratio.interval).map(|interval| interval.map(shown));
        let bound = mean(&own.iter().filter_map(|own| own.bound).collect::<Vec<_>>());
        let [initial, trained] =
            [0, 1].map(|body| mean(&own.iter().map(|own| own.values[body]).collect::<Vec<_>>()));
        let means = row![wanted.0, wanted.1, wanted.2, own.len(), bound, initial, trained];
        [means, row![found.map(|ratio| shown(ratio.ratio)); ends(interval)]].concat()
    };
    Table::new(columns, in_order(all.iter().map(kind)).into_iter().map(line))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Differences of capacities, ratios of errors; both paired by trial. One row per measure, in the order of the measures.
    #[test]
    fn changes_are_paired_by_trial() {
        let of = |seed: u64, measure: &'static str, values: [f64; 2]| CapacityResult {
            setting: "K = 2".into(),
            cluster: Cluster { placement: 0, seed },
            trained_for: "forces".into(),
            measure,
            values,
            bound: (measure != "narma-2").then_some(9.0),
        };
        let all: Vec<CapacityResult> = (0..6)
            .flat_map(|seed| {
                let own = 1.0 + seed as f64;
                [of(seed, "memory", [own, own + 2.0]), of(seed, "narma-2", [0.4 * own, 0.1 * own])]
            })
            .collect();
        let table = table(&all);
        let bounds: Vec<Option<f64>> =
            table.rows.iter().map(|row| row[table.column("bound")].as_f64()).collect();
        assert_eq!(bounds, [Some(9.0), None]);
        let number = |row: usize, column: &str| table.rows[row][table.column(column)].as_f64().unwrap();
        for (row, name, change, initial) in [(0, "memory", 2.0, 3.5), (1, "narma-2", 4.0, 1.4)] {
            assert_eq!(table.rows[row][table.column("measure")], name);
            for column in ["change", "change_low", "change_high"] {
                assert!((number(row, column) - change).abs() < 1e-9, "{table:?}");
            }
            assert!((number(row, "initial") - initial).abs() < 1e-9);
        }
        let varied: Vec<CapacityResult> =
            (0..6).map(|seed| of(seed, "memory", [1.0, 1.0 + (seed % 2) as f64])).collect();
        let table = super::table(&varied);
        let number = |column: &str| table.rows[0][table.column(column)].as_f64().unwrap();
        assert!((number("change") - 0.5).abs() < 1e-9);
        assert!(number("change_low") < 0.1 && number("change_high") > 0.9, "{table:?}");
    }
}
