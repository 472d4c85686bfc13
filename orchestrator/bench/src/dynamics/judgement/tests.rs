use super::*;

/// Interpolates half a decade on a line of slope −2 in logarithms; `None` beyond the curve, the first point before it.
#[test]
fn costs_lie_on_lines_between_logarithms() {
    let curve = [(1.0, 1e-2), (10.0, 1e-4)];
    let middle = cost(&curve, 1e-3).expect("within");
    assert!((middle - 10f64.sqrt()).abs() < 1e-12, "{middle}");
    assert_eq!([cost(&curve, 1e-5), cost(&curve, 1e-1), cost(&[], 1.0)], [None, Some(1.0), None]);
}

/// One of three methods never reaches the error. The line names the cheapest, with Tsit5 at equal error and `auto`.
#[test]
fn the_cheapest_is_named() {
    let mark = |method: &str, setting: &str, points: [Option<(f64, f64)>; 2]| MeasuredRun {
        scene: "contact".into(),
        method: method.into(),
        setting: setting.into(),
        auto: setting.starts_with("auto"),
        points,
    };
    let marks = [
        mark("leapfrog", "1", [Some((1.0, 1e-2)), None]),
        mark("nystrom6", "1", [Some((2.0, 1e-2)), Some((5.0, 2e-2))]),
        mark("nystrom6", "2", [Some((4.0, 1e-4)), Some((9.0, 5e-3))]),
        mark("tsit5", "1", [Some((20.0, 1e-3)), Some((60.0, 5e-3))]),
        mark("nystrom6", "auto 1e-3: 7 steps", [Some((3.0, 9e-4)), Some((7.0, 8e-3))]),
    ];
    let said = lines(&marks);
    assert_eq!(said.len(), 2, "{said:#?}");
    assert_eq!(
        said[0],
        "contact, 8 × 4, signals: at 1.0e-3 nystrom6 2.828 ms, tsit5 20.000 ms, 7.07 times as long; \
             auto 3.000 ms at 9.0e-4, 1.06 of the cheapest"
    );
    assert!(said[1].contains("dα: at 5.0e-3 (the smallest error that Tsit5"), "{}", said[1]);
}
