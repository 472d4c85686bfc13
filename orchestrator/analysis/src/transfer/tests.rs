use super::super::trial::UnderErrors;
use super::*;
use crate::Cluster;
use crate::setting::flatten;
use serde_json::json;

/// Initial body 16 %. Specialists have 1 % under their own forces and 16 or 8 % under the others; a body trained on the mixture
/// has 4 and 2 %. Factors per seed cancel.
#[test]
fn gains_under_other_forces_are_told_against_the_specialists() {
    let mut trials = Vec::new();
    for seed in 1..=4u64 {
        let factor = [0.5, 2.0, 0.8, 1.25][seed as usize - 1];
        for (kind, errors) in [("bell", [1.0, 16.0]), ("irregular", [8.0, 1.0]), ("mix", [4.0, 2.0])] {
            let spec = json!({"stimuli": {"kind": kind}, "point": {"panels": 2, "sensors": 1, "seed": seed}});
            let read = |body, own, errors: [f64; 2]| {
                ["bell", "irregular"].into_iter().zip(errors).map(move |(stimuli, error)| UnderErrors {
                    body,
                    stimuli: stimuli.into(),
                    own,
                    error: factor * error,
                    median: Some(factor * if body == BodyState::Initial { 4.0 } else { error }),
                })
            };
            let carried = read(BodyState::Optimised, false, errors.map(|error| 2.0 * error));
            trials.push(Trial {
                setting: flatten(&spec).into_iter().collect(),
                cluster: Cluster { placement: 0, seed },
                under: read(BodyState::Initial, true, [16.0; 2])
                    .chain(read(BodyState::Optimised, true, errors))
                    .chain(carried)
                    .collect(),
                ..Trial::default()
            });
        }
    }
    trials.push(Trial::default());
    // a trial without a trained body
    let mut untouched = trials[0].clone();
    untouched.setting = untouched
        .setting
        .leaves()
        .into_iter()
        .map(|(path, value)| (path.to_owned(), value.clone()))
        .chain([("optimise.iterations".to_owned(), json!(0))])
        .collect();
    trials.push(untouched);
    let refs: Vec<&Trial> = trials.iter().collect();
    let found = settings(&refs);
    assert_eq!((found.len(), &found[0].label[..]), (1, "K = 2, M = 1"));
    let setting = &found[0];
    let names: Vec<(&str, usize)> = setting.bodies.iter().map(|b| (&b.name[..], b.trials.len())).collect();
    assert_eq!(names, [("initial", 4), ("bell", 4), ("irregular", 4), ("mix", 4)]);
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-9, "{found} for {expected}");
    let expected = [
        ([16.0; 2], None),
        ([1.0, 16.0], Some([1.0, 0.0])),
        ([8.0, 1.0], Some([0.25, 1.0])),
        ([4.0, 2.0], Some([0.5, 0.75])),
    ];
    for (body, (errors, kept)) in setting.bodies.iter().zip(expected) {
        for (i, kind) in ["bell", "irregular"].into_iter().enumerate() {
            let read = setting.read(body, kind).unwrap();
            near(read.own.ratio, errors[i]);
            assert_eq!((read.carried.is_some(), read.kept.is_some()), (kept.is_some(), kept.is_some()));
            if let (Some(kept), Some(carried)) = (kept, &read.carried) {
                near(read.kept.unwrap().part, kept[i]);
                near(carried.ratio, 2.0 * errors[i]);
                assert!(read.kept.unwrap().interval.is_some(), "four seeds have an interval");
            }
        }
        assert!(setting.read(body, "recorded").is_none());
    }
    // by medians (4 → 8 %) the body trained with blows loses what it keeps by means
    let notes = ["bell", "irregular"].map(|kind| setting.read(&setting.bodies[2], kind).unwrap().note);
    assert_eq!(notes, [Some("kept by means, lost by medians".to_owned()), None]);
    let worst: Vec<_> = setting.bodies.iter().map(|body| setting.worst(body).map(|w| w.0)).collect();
    assert_eq!(worst, [None, Some("irregular"), Some("bell"), Some("bell")]);
}
