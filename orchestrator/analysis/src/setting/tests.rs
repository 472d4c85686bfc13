use super::*;
use serde_json::json;

#[test]
fn trials_that_differ_in_their_point_share_the_rest() {
    let mut settings = SharedSettings::default();
    let mut of = |seed: u64, columns: u64| {
        settings.of(&json!({"body": {"columns": columns}, "point": {"seed": seed}}))
    };
    let [a, b, c] = [of(1, 6), of(2, 6), of(2, 8)];
    assert!(Arc::ptr_eq(&a.shared, &b.shared) && !Arc::ptr_eq(&b.shared, &c.shared));
    assert_eq!(
        (b.get("point.seed"), b.get("body.columns"), b.get("x")),
        (Some(&json!(2)), Some(&json!(6)), None)
    );
    assert_eq!(
        c.leaves().into_iter().collect::<Vec<_>>(),
        [("body.columns", &json!(8)), ("point.seed", &json!(2))]
    );
}

/// Equal settings and settings of the point are not listed; settings that only some trials have are.
#[test]
fn odd_paths_are_those_that_set_trials_apart() {
    let mut settings = SharedSettings::default();
    let mut of = |columns: u64, noise: Option<f64>| {
        let noise = noise.map_or(json!({}), |noise| json!({"noise": noise}));
        settings.of(
            &json!({"body": {"columns": columns, "rows": 4}, "sensors": noise, "point": {"seed": columns}}),
        )
    };
    let all = [of(6, None), of(8, None), of(8, Some(0.1)), of(6, None)];
    assert_eq!(
        differing_paths(all.iter()).into_iter().collect::<Vec<_>>(),
        ["body.columns", "sensors.noise"]
    );
    assert!(differing_paths([].into_iter()).is_empty() && differing_paths(all[..1].iter()).is_empty());
}
