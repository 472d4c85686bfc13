//! `simulate`: arrays in, arrays out.

use crate::common::{Bench, SPEC};

/// Shapes; the same forces on a clock twice as fine give the same signals; dα is linear in the cotangent.
#[test]
fn a_body_is_simulated_under_given_forces() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
    let mut lines = csv.lines().map(|line| line.split(','));
    let at = lines.next().and_then(|mut names| names.position(|name| name == "hash")).unwrap();
    let hash = lines.next().and_then(|mut row| row.nth(at)).unwrap();
    let simulate = |out: &str, more: &[&str]| {
        let call = [&["body", "simulate", "s.toml", hash, "--out-dir", out], more].concat();
        bench.output(&call)
    };
    let force = |s: f64, k: usize| 0.3 * (std::f64::consts::PI * s * (1.0 + k as f64)).sin().powi(2);
    let knots: Vec<f64> = (0..2).flat_map(|k| (0..=200).map(move |n| force(n as f64 / 200.0, k))).collect();
    let halves: Vec<f64> = (0..2)
        .flat_map(|k| (0..=400).map(move |n| (k, n)))
        .map(|(k, n)| 0.5 * (knots[201 * k + n / 2] + knots[201 * k + n.div_ceil(2)]))
        .collect();
    bench.write_array("f.npy", &[1, 2, 201], &knots);
    bench.write_array("fine.npy", &[1, 2, 401], &halves);

    let cells = |table: &str| -> Vec<String> {
        table.lines().last().unwrap().split('|').map(|cell| cell.trim().to_owned()).collect()
    };
    let summary = simulate("a", &["--forces", "f.npy"]);
    assert!(cells(&summary)[1..4] == ["ok", "1", "0"] && summary.contains("measured"), "{summary}");
    let (shape, signals) = bench.array("a/signals.npy");
    assert_eq!(shape, [1, 200, 3]);
    assert_eq!(bench.array("a/displacements.npy").0, [1, 200, 36, 3]);
    assert_eq!(bench.array("a/velocities.npy").0, [1, 200, 36, 3]);
    let (shape, energies) = bench.array("a/energies.npy");
    assert!(shape == [1, 200] && energies.iter().all(|e| *e > 0.0), "{shape:?}");
    assert!(!bench.path("a/gradient.npy").exists());

    simulate("b", &["--forces", "fine.npy"]);
    let other = bench.array("b/signals.npy").1;
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let off = norm(&mut signals.iter().zip(&other).map(|(a, b)| a - b)) / norm(&mut signals.iter().copied());
    assert!(off < 2e-3, "{off}");

    bench.write_array("c1.npy", &[1, 200, 3], &signals);
    bench.write_array("c2.npy", &[1, 200, 3], &signals.iter().map(|s| 2.0 * s).collect::<Vec<_>>());
    simulate("c", &["--forces", "f.npy", "--cotangent", "c1.npy"]);
    simulate("d", &["--forces", "f.npy", "--cotangent", "c2.npy"]);
    let (one, two) = (bench.array("c/gradient.npy").1, bench.array("d/gradient.npy").1);
    assert!(one.iter().any(|g| *g != 0.0) && one.iter().zip(&two).all(|(a, b)| 2.0 * a == *b));

    // The table has one row per outcome, other formats one row per sample.
    let many: Vec<f64> = (0..5).flat_map(|_| knots.iter().copied()).collect();
    bench.write_array("many.npy", &[5, 2, 201], &many);
    let summary = simulate("f", &["--forces", "many.npy"]);
    assert!(summary.lines().count() == 3 && cells(&summary)[1..4] == ["ok", "5", "0"], "{summary}");
    let rows = simulate("g", &["--forces", "many.npy", "--format", "csv"]);
    assert!(rows.lines().count() == 6 && rows.contains("\n4,ok,"), "{rows}");

    // evaluations per sample: the pilot runs once and is not included
    let evaluations = |summary: &str| {
        let rows: Vec<Vec<&str>> = summary.lines().map(|line| line.split(',').collect()).collect();
        let at = rows[0].iter().position(|name| name.starts_with("force_evaluations")).unwrap();
        rows[1][at].parse::<u64>().unwrap()
    };
    let alone = simulate("h", &["--forces", "f.npy", "--format", "csv"]);
    assert_eq!(evaluations(&alone), evaluations(&rows), "{alone}{rows}");
    let steps = evaluations(&alone) as f64 / 200.0;
    assert!((2.0..200.0).contains(&steps), "{steps} an interval");

    // a body with an inverted unit is refused; a design beyond the limits gives a warning
    let design: Vec<f64> = (0..168).map(|i| 20.0 * (1.7 * i as f64).sin()).collect();
    bench.write_array("inside.npy", &[168], &design);
    let call = ["body", "simulate", "s.toml", hash, "--out-dir", "i", "--forces", "f.npy", "--design"];
    let refused = bench.metasense(&[&call[..], &["inside.npy"]].concat());
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("unit ") && said.contains("mm²"), "{said}");
    bench.output(&["body", "draw", "s.toml", "--out", "d.svg", "--design-out", "own.npy"]);
    let (_, mut close) = bench.array("own.npy");
    close[84] += 8.0;
    bench.write_array("close.npy", &[168], &close);
    let warned = bench.metasense(&[&call[..], &["close.npy"]].concat());
    let said = String::from_utf8_lossy(&warned.stderr);
    assert!(warned.status.success() && said.contains("warning") && said.contains("close.npy"), "{said}");

    bench.write_array("short.npy", &[1, 2, 200], &knots[..400]);
    let call = ["body", "simulate", "s.toml", hash, "--out-dir", "e", "--forces", "short.npy"];
    let refused = bench.metasense(&call);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("(N, 2, 201)"), "{said}");
    assert!(!bench.path("e").exists());
}
