use super::*;
use crate::setting::{SharedSettings, flatten};
use serde_json::json;

/// Returns a trial with additional settings.
fn with(trial: Trial, more: &Value) -> Trial {
    let leaves = trial.setting.leaves().into_iter().map(|(path, value)| (path.to_owned(), value.clone()));
    let setting = leaves.chain(flatten(more)).collect();
    Trial { setting, ..trial }
}

fn trial(panels: u64, columns: u64, sensors: u64, placement: u64) -> Trial {
    let spec = json!({"body": {"columns": columns, "rows": 4}, "point": {"panels": panels, "sensors": sensors,
        "placement": placement, "seed": 1}, "sensor_units": [placement]});
    Trial {
        setting: flatten(&spec).into_iter().collect(),
        panels,
        sensors,
        cluster: Cluster { placement, seed: 1 },
        ..Trial::default()
    }
}

#[test]
fn groups_differ_in_what_their_labels_say() {
    let trials: Vec<Trial> = [(2, 5, 1, 0), (2, 5, 2, 1), (2, 6, 1, 0), (4, 6, 1, 0)]
        .map(|(k, c, m, p)| trial(k, c, m, p))
        .to_vec();
    let trials: Vec<&Trial> = trials.iter().collect();
    let labels = |but: &[&str]| -> Vec<(String, usize)> {
        groups(&trials, but).into_iter().map(|g| (g.label, g.trials.len())).collect()
    };
    assert_eq!(
        labels(SENSORS),
        [
            ("K = 2, 5 × 4 units".to_owned(), 2),
            ("K = 2, 6 × 4 units".to_owned(), 1),
            ("K = 4, 6 × 4 units".to_owned(), 1)
        ]
    );
    assert_eq!(
        labels(COMPLEXITY),
        [("K = 2, M = 1".to_owned(), 2), ("K = 2, M = 2".to_owned(), 1), ("K = 4, M = 1".to_owned(), 1)]
    );
    let cut = |columns: u64, spacing: f64, bend: f64| {
        with(trial(2, columns, 1, 0), &json!({"body": {"spacing": spacing, "stiffness": {"bend": bend}}}))
    };
    let sheet = [cut(5, 30.0, 4.0), cut(10, 15.0, 1.0), cut(12, 12.5, 25.0 / 36.0), cut(12, 12.5, 1.0)];
    let found = groups(&sheet.iter().collect::<Vec<_>>(), COMPLEXITY);
    let found: Vec<(&str, usize)> = found.iter().map(|g| (&*g.label, g.trials.len())).collect();
    let told = |bend: &str| format!("K = 2, M = 1, body.stiffness.bend = {bend}");
    assert_eq!(found, [(&*told("4.0"), 3), (&*told("5.76"), 1)]);
    // also if the first trial's spacing is not a round number
    let found = groups(&sheet.iter().rev().skip(1).collect::<Vec<_>>(), COMPLEXITY);
    assert_eq!(found.len(), 1, "{found:?}");
    let ways =
        [("cnn", json!({"seeds": 3, "batch": 30})), ("linear", json!({"seeds": 1}))].map(|(kind, judged)| {
            with(trial(2, 5, 1, 0), &json!({"brain": {"kind": kind}, "evaluation": judged}))
        });
    assert_eq!(groups(&ways.iter().collect::<Vec<_>>(), TRAINING).len(), 1);
    let struck = |kind: &str, width: f64, double: Option<f64>| {
        let stimuli = json!({"stimuli": {"kind": kind, "width": [width], "double": double}});
        with(trial(2, 5, 1, 0), &stimuli)
    };
    let kinds = [struck("bell", 0.1, None), struck("irregular", 0.02, Some(0.1))];
    let labels = |trials: &[Trial]| -> Vec<String> {
        groups(&trials.iter().collect::<Vec<_>>(), &[]).into_iter().map(|g| g.label).collect()
    };
    let [bell, irregular] = ["bell", "irregular"].map(|kind| format!("K = 2, M = 1, stimuli.kind = {kind}"));
    assert_eq!(labels(&kinds), [bell.clone(), irregular.clone()]);
    let wider = [&kinds[..], &[struck("bell", 0.2, None)]].concat();
    let told = |width: &str| format!("{bell}, stimuli.width = [{width}]");
    assert_eq!(labels(&wider), [told("0.1"), irregular, told("0.2")]);
    let given = |first: f64| {
        let shifts = [vec![first], vec![0.0; 31]].concat();
        with(trial(2, 5, 1, 0), &json!({"body": {"design": {"shifts": shifts}}}))
    };
    let told = labels(&[given(0.5), given(0.6)]);
    let named = |label: &String| label.starts_with("K = 2, M = 1, body.design.shifts = 32 numbers (");
    assert!(told.iter().all(named) && told[0] != told[1] && told[0].len() < 60, "{told:?}");
    // a body from a file is one value
    let from_file = |x: f64| {
        let units = json!([[[x, 0.0], [1.0, 0.0], [0.0, 1.0]], [[2.0, 0.0], [3.0, 0.0], [2.0, 1.0]]]);
        with(
            trial(2, 5, 1, 0),
            &json!({"body": {"file": {"units": units, "clamp": [], "panels": [{"unit": 0}]}}}),
        )
    };
    let told = labels(&[from_file(0.0), from_file(0.1)]);
    let named = |label: &String| label.starts_with("K = 2, M = 1, body.file = 2 units (");
    assert!(told.iter().all(named) && told[0] != told[1] && told[0].len() < 50, "{told:?}");
}

/// Evaluation on casts in some trials does not separate them from the others; different variations do.
#[test]
fn what_judges_bodies_tells_no_trials_apart_where_none_disagree() {
    let cast = |scatter: f64| {
        with(
            trial(2, 5, 1, 0),
            &json!({"evaluation": {"casts": 8}, "variation": {"nodes": scatter, "bend": 0.1}}),
        )
    };
    let labels = |trials: &[Trial]| -> Vec<String> {
        groups(&trials.iter().collect::<Vec<_>>(), &[]).into_iter().map(|g| g.label).collect()
    };
    assert_eq!(labels(&[trial(2, 5, 1, 0), cast(0.1)]), ["K = 2, M = 1"]);
    let told = [0.1, 0.2].map(|scatter| format!("K = 2, M = 1, variation.nodes = {scatter}"));
    assert_eq!(labels(&[cast(0.1), cast(0.2)]), told);
    // so do variations of other quantities, and per ligament
    let by_parts =
        json!({"evaluation": {"casts": 8}, "variation": {"nodes": 0.1, "bend": {"ligament": 0.1}}});
    let told = ["K = 2, M = 1, variation.bend = 0.1", "K = 2, M = 1, variation.bend.ligament = 0.1"];
    assert_eq!(labels(&[cast(0.1), with(trial(2, 5, 1, 0), &by_parts), trial(2, 5, 1, 1)])[..2], told);
}

/// A trial that is repeated with casts counts once. Recorded forces are identified by content, not by file.
#[test]
fn a_trial_that_is_judged_again_counts_once() {
    let mut settings = SharedSettings::default();
    let mut trial = |seed: u64, errors: [f64; 2], more: &Value| {
        let recorded = |folder: &str| json!({"files": [format!("{folder}/f.npy")], "digest": "ab"});
        let mut spec = json!({"point": {"panels": 2, "sensors": 1, "placement": 0, "seed": seed},
            "stimuli": {"recorded": recorded(&format!("{more}"))}});
        more.as_object().unwrap().iter().for_each(|(key, value)| spec[key] = value.clone());
        Trial {
            setting: settings.of(&spec),
            panels: 2,
            sensors: 1,
            cluster: Cluster { placement: 0, seed },
            errors: errors.map(|error| [Some(error), Some(error), None]),
            ..Trial::default()
        }
    };
    let casts = json!({"variation": {"stretch": 0.05}, "evaluation": {"casts": 3}});
    let mut trials = [
        trial(1, [20.0, 10.0], &json!({})),
        trial(1, [20.0, 10.0], &casts),
        trial(2, [30.0, 10.0], &casts),
        trial(2, [30.0, 10.0], &json!({"evaluation": {"long_iterations": 10}})),
        // without outer steps there is no trained body
        trial(3, [40.0, 40.0], &json!({"optimise": {"iterations": 0}})),
    ];
    trials.iter_mut().for_each(Trial::remove_trained_results);
    let refs: Vec<&Trial> = trials.iter().collect();
    let found = groups(&refs, SENSORS);
    assert_eq!(found.iter().map(|group| group.trials.len()).collect::<Vec<_>>(), [4, 1]);
    let of = |group: usize, body| {
        let found = observations(&found[group].trials, body, Set::Test, |t| t.sensors);
        found.iter().map(|o| (o.cluster.seed, o.error)).collect::<Vec<_>>()
    };
    assert_eq!(of(0, BodyState::Initial), [(1, 20.0), (2, 30.0)]);
    assert_eq!((of(1, BodyState::Initial), of(1, BodyState::Optimised)), (vec![(3, 40.0)], vec![]));
    let ratio = super::super::paired::error_ratio(&refs, Set::Holdout).unwrap();
    assert_eq!((ratio.trials, ratio.above_one), (2, 2));

    // each variation in training over casts gives another body
    let mut over = |stretch: f64| {
        let more = json!({"variation": {"stretch": stretch}, "optimise": {"objective": "mean"}});
        trial(1, [20.0, 100.0 * stretch], &more)
    };
    let trained = [over(0.02), over(0.2)];
    let ratio = super::super::paired::error_ratio(&trained.iter().collect::<Vec<_>>(), Set::Holdout).unwrap();
    assert_eq!((ratio.trials, ratio.above_one), (2, 1));
}
