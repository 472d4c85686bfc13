use super::*;
use crate::Cluster;

/// Trials of a decoder in placements 0 … 4; errors are multiplied by `factor`.
fn database(brain: &str, factor: f64, sensors: &[u64]) -> Vec<Trial> {
    let each = |(placement, m): (u64, u64)| {
        let setting = [
            ("brain.kind", json!(brain)),
            ("point.placement", json!(placement)),
            ("point.sensors", json!(m)),
            ("time.duration", json!(1.0)),
        ];
        let error = Some(factor * (10.0 + 3.0 * placement as f64) / m as f64);
        Trial {
            setting: setting.into_iter().map(|(path, value)| (path.to_owned(), value)).collect(),
            sensors: m,
            cluster: Cluster { placement, seed: 1 },
            errors: [[None, error, None], [None, error.map(|e| 0.5 * e), None]],
            ..Trial::default()
        }
    };
    (0..5).flat_map(|p| sensors.iter().map(move |m| (p, *m))).map(each).collect()
}

/// Placements differ by a factor of two, but pairs do not: the ratio is exactly 4/3. Half of the second database has no
/// partner.
#[test]
fn trials_are_paired_by_all_but_what_is_compared() {
    let (first, second) = (database("cnn", 2.0, &[1, 2]), database("linear", 1.5, &[1, 2, 3, 4]));
    let found = TrialPairs::new(&first, &second);
    assert_eq!((found.pairs.len(), found.alone), (10, [0, 10]));
    let differs: Vec<&str> = found.differs.keys().copied().collect();
    assert_eq!(differs, ["brain.kind"]);
    let table = found.table();
    // all trials, M = 1, M = 2; two bodies each
    assert_eq!(table.rows.len(), 6, "{table:?}");
    for row in &table.rows {
        let [ratio, low, high] = [5, 6, 7].map(|i| row[i].as_f64().unwrap());
        assert!((ratio - 4.0 / 3.0).abs() < 1e-12 && high - low < 1e-9, "{row:?}");
        assert_eq!((&row[4], &row[8]), (&row[3], &json!("5 placements")), "{row:?}");
    }
    assert_eq!((&table.rows[0][0], &table.rows[0][3]), (&json!("all"), &json!(10)));
}

#[test]
fn sweeps_of_other_places_or_seeds_have_no_pairs() {
    let (mut first, mut second) = (database("cnn", 2.0, &[1, 2]), database("cnn", 1.5, &[3, 4]));
    assert_eq!(TrialPairs::new(&first, &second).pairs.len(), 0);
    second = database("cnn", 1.5, &[1, 2]);
    for (seed, trials) in [(1, &mut first), (2, &mut second)] {
        for trial in &mut *trials {
            let leaves =
                trial.setting.leaves().into_iter().map(|(path, value)| (path.to_owned(), value.clone()));
            trial.setting = leaves.chain([("point.seed".to_owned(), json!(seed))]).collect();
        }
    }
    assert_eq!(TrialPairs::new(&first, &second).pairs.len(), 0);
    second.clear();
    assert_eq!(TrialPairs::new(&first, &second).alone, [10, 0]);
}
