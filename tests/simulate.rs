//! `simulate`: arrays in, arrays out.

mod common;

use common::{Bench, SPEC};
use npyz::WriterBuilder;

fn write(bench: &Bench, name: &str, shape: &[u64], values: &[f64]) {
    let mut bytes = Vec::new();
    let mut npy =
        npyz::WriteOptions::new().default_dtype().shape(shape).writer(&mut bytes).begin_nd().unwrap();
    npy.extend(values.iter().copied()).unwrap();
    npy.finish().unwrap();
    std::fs::write(bench.path(name), bytes).unwrap();
}

fn read(bench: &Bench, name: &str) -> (Vec<u64>, Vec<f64>) {
    let bytes = std::fs::read(bench.path(name)).unwrap();
    let file = npyz::NpyFile::new(&bytes[..]).unwrap();
    (file.shape().to_vec(), file.into_vec().unwrap())
}

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
        let call = [&["simulate", "s.toml", "--hash", hash, "--out", out], more].concat();
        bench.output(&call)
    };
    let force = |s: f64, k: usize| 0.3 * (std::f64::consts::PI * s * (1.0 + k as f64)).sin().powi(2);
    let knots: Vec<f64> = (0..2).flat_map(|k| (0..=200).map(move |n| force(n as f64 / 200.0, k))).collect();
    let halves: Vec<f64> = (0..2)
        .flat_map(|k| (0..=400).map(move |n| (k, n)))
        .map(|(k, n)| 0.5 * (knots[201 * k + n / 2] + knots[201 * k + n.div_ceil(2)]))
        .collect();
    write(&bench, "f.npy", &[1, 2, 201], &knots);
    write(&bench, "fine.npy", &[1, 2, 401], &halves);

    let summary = simulate("a", &["--forces", "f.npy", "--format", "csv"]);
    assert!(summary.contains("0,ok,") && summary.contains("measured"), "{summary}");
    let (shape, signals) = read(&bench, "a/signals.npy");
    assert_eq!(shape, [1, 200, 3]);
    assert_eq!(read(&bench, "a/displacements.npy").0, [1, 200, 36, 3]);
    assert_eq!(read(&bench, "a/velocities.npy").0, [1, 200, 36, 3]);
    let (shape, energies) = read(&bench, "a/energies.npy");
    assert!(shape == [1, 200] && energies.iter().all(|e| *e > 0.0), "{shape:?}");
    assert!(!bench.path("a/gradient.npy").exists());

    simulate("b", &["--forces", "fine.npy"]);
    let other = read(&bench, "b/signals.npy").1;
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let off = norm(&mut signals.iter().zip(&other).map(|(a, b)| a - b)) / norm(&mut signals.iter().copied());
    assert!(off < 2e-3, "{off}");

    write(&bench, "c1.npy", &[1, 200, 3], &signals);
    write(&bench, "c2.npy", &[1, 200, 3], &signals.iter().map(|s| 2.0 * s).collect::<Vec<_>>());
    simulate("c", &["--forces", "f.npy", "--cotangent", "c1.npy"]);
    simulate("d", &["--forces", "f.npy", "--cotangent", "c2.npy"]);
    let (one, two) = (read(&bench, "c/gradient.npy").1, read(&bench, "d/gradient.npy").1);
    assert!(one.iter().any(|g| *g != 0.0) && one.iter().zip(&two).all(|(a, b)| 2.0 * a == *b));

    write(&bench, "short.npy", &[1, 2, 200], &knots[..400]);
    let call = ["simulate", "s.toml", "--hash", hash, "--out", "e", "--forces", "short.npy"];
    let refused = bench.metasense(&call);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("(N, 2, 201)"), "{said}");
    assert!(!bench.path("e").exists());
}
