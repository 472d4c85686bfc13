//! Tests of `npz`.

use super::*;

/// All weights are assigned, biases first, each with the sizes of its layer.
#[test]
fn the_parts_are_those_of_the_network() {
    let brain = Brain { width: Some(2), kernels: Some(vec![4, 2, 3, 1]), ..Brain::default() };
    let weights: Vec<f32> =
        (0..2 + 2 + 2 + 5 + 4 * 3 * 2 + 2 * 2 * 2 + 3 * 2 * 2 + 2 * 5).map(|i| i as f32).collect();
    let parts = parts(&weights, &brain, 3, 5);
    let found: Vec<_> =
        parts.iter().map(|(name, shape, values)| (&name[..], &shape[..], values[0])).collect();
    let expected: [(&str, &[usize], f32); 8] = [
        ("b1", &[2], 0.0),
        ("b2", &[2], 2.0),
        ("b3", &[2], 4.0),
        ("b4", &[5], 6.0),
        ("w1", &[4, 3, 2], 11.0),
        ("w2", &[2, 2, 2], 35.0),
        ("w3", &[3, 2, 2], 43.0),
        ("w4", &[1, 2, 5], 55.0),
    ];
    assert_eq!(found, expected);
    assert_eq!(parts[7].2.last(), weights.last());
}

#[test]
fn a_text_array_starts_its_data_at_a_multiple_of_64() {
    for text in ["", "ä", "a much longer text than the others, to be sure"] {
        let bytes = text_array(text);
        assert_eq!((bytes.len() - 4 * text.chars().count()) % 64, 0, "{text}");
    }
}
