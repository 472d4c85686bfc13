//! Why training helps: changes of measures of a body by training, and their correlation with the gain.
//!
//! Rank correlations (Spearman) over trials are between ln(trained/initial) of a measure and ln(initial/trained) of the error.

use serde_json::Value;

use super::Resampling;
use super::numbers::{correlation, distinct, geometric_mean, ranks};
use super::trial::Cluster;
use metasense_render::{Table, row};

/// Measures of a body.
pub const MEASURES: [&str; 6] = [
    "error of Wiener's filter (%)",
    "distinguishable forces",
    "condition",
    "information (bit/s)",
    "memory (s)",
    "participating modes",
];

/// Half-width of a 95 % interval of z times √(n − 3). z of a rank correlation has the standard deviation √(1.06/(n − 3))
/// (Fieller, Hartley and Pearson 1957, doi:10.1093/biomet/44.3-4.470).
const TO_EACH_SIDE: f64 = 1.959_964 * 1.029_563;
/// Largest correlation; at ±1, z is infinite.
const MOST: f64 = 0.9999;

/// Initial and trained body of a trial.
#[derive(Debug, Clone)]
pub struct BodyPair {
    /// Group of the trial: equal K, M and decoders in training and evaluation.
    pub setting: String,
    /// Placement and seed.
    pub cluster: Cluster,
    /// Held-out errors (%) of the initial and the trained body.
    pub errors: [f64; 2],
    /// Measures of the initial and the trained body.
    pub measured: [[f64; MEASURES.len()]; 2],
}

/// Returns one row per setting and measure: geometric means, and the rank correlation of its change with the gain.
pub fn table(changes: &[BodyPair]) -> Table {
    let columns = "setting measure initial optimised ratio correlation correlation_low correlation_high over";
    let settings = distinct(changes.iter().map(|change| &change.setting));
    let of = |setting: &String| {
        let own: Vec<&BodyPair> = changes.iter().filter(|change| change.setting == *setting).collect();
        rows(setting, &own)
    };
    Table::new(columns, settings.into_iter().flat_map(of))
}

fn rows(setting: &str, changes: &[&BodyPair]) -> Vec<Vec<Value>> {
    let clusters: Vec<Cluster> = changes.iter().map(|change| change.cluster).collect();
    let resampling = Resampling::new(&clusters);
    let half =
        resampling.units().map(|units| TO_EACH_SIDE / (distinct(units.iter()).len() as f64 - 3.0).sqrt());
    let gains = ranks(&changes.iter().map(|c| (c.errors[0] / c.errors[1]).ln()).collect::<Vec<_>>());
    let of = |(m, name): (usize, &str)| {
        let mean =
            |body: usize| geometric_mean(&changes.iter().map(|c| c.measured[body][m]).collect::<Vec<_>>());
        let grown: Vec<f64> = changes.iter().map(|c| (c.measured[1][m] / c.measured[0][m]).ln()).collect();
        let grown = ranks(&grown);
        let all = correlation(&grown, &gains);
        // by Fisher's z, so that the interval stays within ±1
        let end = |sign: f64| Some((all?.clamp(-MOST, MOST).atanh() + sign * half?).tanh());
        let [low, high] = [-1.0, 1.0].map(end);
        let [initial, optimised] = [0, 1].map(mean);
        row![setting, name, initial, optimised, optimised / initial, all, low, high, resampling.over()]
    };
    MEASURES.into_iter().enumerate().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A measure that changes with the error has a correlation of ±1, an unrelated one a small correlation, a constant one
    /// none. Equal numbers share their ranks.
    #[test]
    fn what_goes_with_the_gain_is_found() {
        assert_eq!(ranks(&[3.0, 1.0, 3.0, 2.0]), [3.5, 1.0, 3.5, 2.0]);
        let change = |i: u32| {
            let gain = f64::from(i * 7 % 11 + 1);
            let chance = f64::from(i * 5 % 12 + 1);
            BodyPair {
                setting: "one".to_owned(),
                cluster: Cluster { placement: 0, seed: u64::from(i) },
                errors: [gain, 1.0],
                measured: [[1.0; 6], [1.0 / gain.powi(2), gain.ln() + 1.0, chance, 1.0, gain, gain.sqrt()]],
            }
        };
        let changes: Vec<BodyPair> = (0..12).map(change).collect();
        let table = table(&changes);
        let cell = |measure: usize, column: &str| {
            let at = table.columns.iter().position(|c| c == column).unwrap();
            table.rows[measure][at].as_f64()
        };
        let correlations: Vec<Option<f64>> = (0..5).map(|m| cell(m, "correlation")).collect();
        assert!(
            (correlations[0].unwrap() + 1.0).abs() < 1e-12 && (correlations[4].unwrap() - 1.0).abs() < 1e-12
        );
        assert!(correlations[2].unwrap().abs() < 0.6 && correlations[3].is_none(), "{correlations:?}");
        assert!(cell(2, "correlation_low") < Some(0.0) && cell(2, "correlation_high") > Some(0.0));
        // twelve trials: z ± 1.96 · 1.0296/3; correlations of ±1 have an interval too
        let (r, low) = (cell(2, "correlation").unwrap(), cell(2, "correlation_low").unwrap());
        assert!((r.atanh() - low.atanh() - 0.672_65).abs() < 1e-4, "{r} {low}");
        assert!(cell(0, "correlation_high") > Some(-1.0));
        assert_eq!(cell(3, "ratio"), Some(1.0));
        let other = BodyPair { setting: "other".to_owned(), ..changes[0].clone() };
        assert_eq!(super::table(&[&changes[..], &[other]].concat()).rows.len(), 12);
    }
}
