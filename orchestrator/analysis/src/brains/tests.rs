use super::super::trial::LinearErrors;
use super::*;
use serde_json::json;

fn trial(brain: Option<&str>, with: Option<&str>, seed: u64, own: [f64; 2], whole: [f64; 2]) -> Trial {
    let keys = [("brain.kind", brain), ("optimise.brain", with)];
    let pair = |e: [f64; 2]| e.map(|e| [Some(2.0 * e), Some(e), None]);
    // by medians training makes every linear decoder worse
    let read = |[a, b]: [f64; 2]| [[Some(2.0 * a), Some(a), Some(b)], [Some(2.0 * b), Some(b), Some(a)]];
    Trial {
        setting: keys.into_iter().filter_map(|(k, v)| Some((k.to_owned(), json!(v?)))).collect(),
        cluster: Cluster { placement: 0, seed },
        errors: pair(own),
        readings: vec![
            LinearErrors { memory: [1.0, 1.0], is_longest: true, errors: read(whole) },
            LinearErrors { memory: [1.0, 0.0], is_longest: false, errors: read(whole.map(|e| 3.0 * e)) },
        ],
        ..Trial::default()
    }
}

/// Own decoders are separated by decoder in training and in evaluation, linear ones by decoder in training. Both bodies have
/// the same trials.
#[test]
fn bodies_stand_by_what_trained_and_what_read_them() {
    let trials = [
        trial(None, None, 1, [20.0, 10.0], [8.0, 4.0]),
        trial(None, None, 2, [20.0, 10.0], [2.0, 1.0]),
        trial(None, Some("linear"), 1, [20.0, 5.0], [8.0, 0.5]),
        trial(Some("linear"), Some("linear"), 1, [8.0, 0.5], [8.0, 0.5]),
    ];
    let found = errors_by_decoder(&trials.iter().collect::<Vec<_>>());
    let rows: Vec<(&str, &str, bool, [f64; 2], usize)> = found
        .iter()
        .map(|r| {
            let errors = r.errors.map(|e| (1e6 * e).round() / 1e6);
            (&r.trained_with[..], &r.decoder[..], r.whole, errors, r.ratio.trials)
        })
        .collect();
    assert_eq!(
        rows,
        [
            ("cnn", "cnn", false, [20.0, 10.0], 2),
            ("linear", "cnn", false, [20.0, 5.0], 1),
            ("linear", "linear", false, [8.0, 0.5], 1),
            ("cnn", "linear", true, [4.0, 2.0], 2),
            ("cnn", "linear", false, [12.0, 6.0], 2),
            ("linear", "linear", true, [8.0, 0.5], 1),
            ("linear", "linear", false, [24.0, 1.5], 1),
        ]
    );
    let more: Vec<Trial> = (1..=4).map(|seed| trial(None, None, seed, [20.0, 10.0], [8.0, 4.0])).collect();
    let found = errors_by_decoder(&more.iter().collect::<Vec<_>>());
    let notes: Vec<Option<&str>> = found.iter().map(|r| r.note.as_deref()).collect();
    assert_eq!(
        notes,
        [None, Some("above 1 by means, below 1 by medians"), Some("above 1 by means, below 1 by medians")]
    );
}
