use super::*;
use crate::Cluster;
use crate::setting::flatten;
use serde_json::json;

/// Initial body: 20 % as designed, 40 [80] % on casts. The body trained as designed gains a factor of 20 and keeps the fraction
/// that corresponds to 2² of 4²; the body trained over casts gains 10 and keeps all at the median. Factors per seed cancel.
#[test]
fn gains_over_casts_are_told_by_body_and_brain() {
    let mut trials = Vec::new();
    let of_records = CastDecoder::Records(120);
    for seed in 1..=4u64 {
        let factor = [0.5, 2.0, 0.8, 1.25][seed as usize - 1];
        for (optimise, designed, cast) in [
            (json!({"iterations": 75, "batch": 32}), 1.25, [10.0, 40.0]),
            (
                json!({"iterations": 75, "batch": 8, "objective": "mean", "reader": "one", "casts": 4}),
                2.0,
                [4.0, 16.0],
            ),
            (
                json!({"iterations": 225, "batch": 8, "objective": "mean", "reader": "one", "casts": 4}),
                2.0,
                [4.0, 8.0],
            ),
        ] {
            let spec = json!({"optimise": optimise, "brain": {"kind": "linear"}, "point": {"panels": 2, "sensors": 1, "seed": seed}});
            let reading = |(body, by, errors): (BodyState, CastDecoder, [f64; 2])| ReadingOnCasts {
                body,
                decoder: by,
                casts: 24,
                failed: u64::from(body == BodyState::Initial),
                errors: errors.map(|error| factor * error),
                // the median sample is worse on casts of trained bodies
                median: Some(factor * if body == BodyState::Initial { 20.0 } else { 40.0 }),
            };
            let read = [
                (BodyState::Initial, CastDecoder::Casts, [40.0, 80.0]),
                (BodyState::Initial, of_records, [20.0, 40.0]),
                (BodyState::Optimised, CastDecoder::Casts, cast),
                (BodyState::Optimised, of_records, cast.map(|error| 0.5 * error)),
            ];
            trials.push(Trial {
                setting: flatten(&spec).into_iter().collect(),
                cluster: Cluster { placement: 0, seed },
                errors: [20.0, designed].map(|e| [None, Some(factor * e), Some(factor * e)]),
                casts: read.into_iter().map(reading).collect(),
                ..Trial::default()
            });
        }
    }
    trials.push(Trial::default());
    let refs: Vec<&Trial> = trials.iter().collect();
    let found = settings(&refs);
    assert_eq!((found.len(), &found[0].label[..]), (1, "K = 2, M = 1"));
    let bodies = &found[0].bodies;
    let names: Vec<(&str, usize)> = bodies.iter().map(|b| (&b.name[..], b.trials.len())).collect();
    let expected = [
        ("initial", 4),
        ("nominal", 4),
        ("mean of casts, iterations = 225", 4),
        ("mean of casts, iterations = 75", 4),
    ];
    assert_eq!(names, expected);
    assert_eq!(bodies[1].brains(), [CastDecoder::Casts, of_records]);
    let near =
        |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-9, "{found} for {expected}");
    for (body, designed, errors, kept) in [
        (0, 20.0, [40.0, 80.0], [None, None]),
        (1, 1.25, [10.0, 40.0], [Some(0.5), Some(0.25)]),
        (2, 2.0, [4.0, 8.0], [Some(1.0), Some(1.0)]),
        (3, 2.0, [4.0, 16.0], [Some(1.0), Some(5f64.ln() / 10f64.ln())]),
    ] {
        for (by, half) in [(CastDecoder::Casts, 1.0), (of_records, 0.5)] {
            let left = bodies[body].errors_of(by).unwrap();
            let differs = matches!(left.kept[0], Some(kept) if kept.part > 0.0);
            assert_eq!(left.note.is_some(), differs);
            assert_eq!(left.casts, [96, if body == 0 { 4 } else { 0 }]);
            near(left.designed.unwrap().ratio, designed);
            for quantile in [0, 1] {
                near(left.errors[quantile].ratio, half * errors[quantile]);
                assert_eq!(left.kept[quantile].is_some(), kept[quantile].is_some());
                if let (Some(found), Some(expected)) = (left.kept[quantile], kept[quantile]) {
                    near(found.part, expected);
                    assert!(found.interval.is_some(), "four seeds have an interval");
                }
            }
        }
    }
    assert!(bodies[1].errors_of(CastDecoder::Network).is_none());
}
