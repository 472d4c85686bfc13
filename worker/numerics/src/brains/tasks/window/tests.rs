//! Windows of two channels and six instants.

use super::*;

const QUIET: [f64; 2] = [0.0, 0.05];

fn window(len: usize, threshold: f64) -> Window {
    Window { len, thresholds: vec![threshold, 2.0 * threshold], instants: 6 }
}

/// A record whose first channel reads −1 at an instant; without: none does.
fn record(contact: Option<usize>) -> Vec<f64> {
    let reading = |n| if Some(n) == contact { [-1.0, 0.15] } else { QUIET };
    (0..6).flat_map(reading).collect()
}

#[test]
fn a_window_starts_with_the_first_contact() {
    let signals = [record(Some(2)), record(None), record(Some(5))].concat();
    let (window, whole) = (window(3, 0.1), window(6, -1.0));
    let starts = window.starts(&signals);
    assert_eq!(starts, [2, 0, 5]);
    let found = window.signals(&signals, &starts);
    assert_eq!(found[..6], signals[4..10]);
    assert_eq!(found[6..12], signals[12..18], "without contact, it starts with the record");
    assert_eq!(found[12..], [-1.0, 0.15, 0.0, 0.0, 0.0, 0.0], "nothing follows the record");
    assert_eq!(whole.starts(&signals), [0; 3]);
    assert_eq!(whole.signals(&signals, &[0; 3]), signals);
}

/// ⟨W x, y⟩ = ⟨x, Wᵀ y⟩.
#[test]
fn the_transpose_adds_a_window_to_its_record() {
    let window = window(3, 0.1);
    let cotangent: Vec<f64> = (1..7).map(f64::from).collect();
    for start in [0, 2, 5] {
        let record: Vec<f64> = (0..12).map(|i| f64::from(i).sin()).collect();
        let seen = window.signals(&record, &[start]);
        let mut back = vec![0.0; 12];
        window.add_vjp(&cotangent, start, &mut back);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert!((dot(&seen, &cotangent) - dot(&record, &back)).abs() < 1e-12);
    }
}

#[test]
fn times_count_from_the_window() {
    let labels = || vec![vec![50.0], vec![30.0]];
    let moved = shifted(SensingTask::Onset, labels(), &[4, 1], 0.005, -1.0);
    assert_eq!(moved, [[30.0], [25.0]]);
    assert_eq!(shifted(SensingTask::Onset, moved, &[4, 1], 0.005, 1.0), labels());
    assert_eq!(shifted(SensingTask::Peak, labels(), &[4, 1], 0.005, -1.0), labels());
}
