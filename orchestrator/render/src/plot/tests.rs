//! Tests of `plot`.

use super::*;

#[test]
fn ticks_lie_within_the_axis_and_are_few() {
    for (scale, low, high) in [
        (Scale::Linear, 0.0, 1.0),
        (Scale::Log, 4.0, 31.0),
        (Scale::Log, 1.0, 1e4),
        (Scale::Log, 20.0, 24.0),
        (Scale::Log, 89.0, 103.0),
    ] {
        let axis = Axis::new("", scale, [low, high]);
        assert!((2..=9).contains(&axis.ticks.len()), "{low} {high}: {:?}", axis.ticks);
        assert!(axis.ticks.iter().all(|t| (0.0..=1.0).contains(&axis.place(t.0))), "{:?}", axis.ticks);
    }
}

/// Number of ticks for extreme ranges.
#[test]
fn ticks_end() {
    for [low, high] in [[0.0, 5e-324], [1.0, 1.0 + f64::EPSILON], [-f64::MAX, f64::MAX]] {
        assert!(linear_ticks([low, high]).len() < 20, "{low} {high}");
    }
}

#[test]
fn text_cannot_leave_its_element() {
    let axis = || Axis::new("<b>", Scale::Linear, []);
    let svg = Plot::new("<a>&\"", axis(), axis()).picture().svg(None).into_string();
    assert!(svg.contains("&lt;a&gt;&amp;&quot;") && svg.contains("&lt;b&gt;"), "{svg}");
    assert!(!svg.contains("<a>") && !svg.contains("<b>"), "{svg}");
}
