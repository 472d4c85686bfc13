//! The scenes of the paper's authors as trials: rigid plates that follow the design, no limits, scaling by extremes.

use crate::common::Bench;

fn spec(kind: &str) -> String {
    let root = env!("CARGO_MANIFEST_DIR");
    format!(
        "name = \"a\"\nbase = \"{root}/../schemas/scenes/authors-2.toml\"\n{kind}\n[stimuli]\nsamples = 12\ntest = 4\nholdout = 6\n\
         [solver]\ntolerance = 1e-2\n[optimise]\niterations = 3\nlearning_rate = 2.0\nbatch = 4\n[sweep]\nseeds = [5]\n"
    )
}

/// Hash of the only trial.
fn hash(bench: &Bench, db: &str) -> String {
    bench
        .output(&["query", db, "SELECT hash FROM v_trial", "--format", "csv"])
        .lines()
        .nth(1)
        .unwrap()
        .to_owned()
}

/// Nodes (x, y) of one unit of a trial's body, from an export.
fn nodes(bench: &Bench, body: &str, unit: usize) -> Vec<f64> {
    let per_unit = bench.member("t.npz", &format!("unit_nodes_{body}"));
    let first: f64 = per_unit[..unit].iter().sum();
    let all = bench.member("t.npz", &format!("vertices_{body}"));
    all[2 * first as usize..2 * (first + per_unit[unit]) as usize].to_vec()
}

/// Training works with both decoders. The outer corners of a plate stay; its anchors and the node between them move.
#[test]
fn bodies_of_the_authors_are_trained_without_limits() {
    let bench = Bench::new();
    let network = "[brain]\nscaling = \"minmax\"\niterations = 20\nwidth = 16\n[evaluation]\nseeds = 1";
    for (name, kind) in [("cnn", network), ("linear", "[brain]\nkind = \"linear\"")] {
        let (file, db) = (format!("{name}.toml"), format!("{name}.sqlite"));
        bench.file(&file, &spec(kind));
        bench.output(&["run", &file, "--db", &db, "--workers", "1"]);
        let sql = "SELECT count(*) FROM v_trial WHERE state = 'done' AND holdout_error_optimised > 0";
        assert_eq!(bench.number(&db, sql), 1, "{name}");
        bench.output(&["export", &db, &hash(&bench, &db), "--format", "npz", "--out", "t.npz"]);
        let [before, after] = ["initial", "optimised"].map(|body| nodes(&bench, body, 20));
        let moved: Vec<bool> = before.chunks(2).zip(after.chunks(2)).map(|(a, b)| a != b).collect();
        assert_eq!(moved, [false, false, true, true, true, false, false], "{name}: {before:?} {after:?}");
        let middle = 0.5 * (after[4] + after[8]);
        assert!((after[6] - middle).abs() < 1e-9 && after[7] == before[7], "{name}: {after:?}");
    }
}

/// Exports describe the inputs of a network with such scaling. Formats that could not pad a signal correctly are refused.
#[test]
fn scales_by_extremes_are_exported() {
    let bench = Bench::new();
    bench.file(
        "s.toml",
        &spec("[brain]\nscaling = \"minmax\"\niterations = 20\nwidth = 16\n[evaluation]\nseeds = 1"),
    );
    bench.output(&["run", "s.toml", "--db", "s.sqlite", "--workers", "1"]);
    let hash = hash(&bench, "s.sqlite");
    bench.output(&["export", "s.sqlite", &hash, "--format", "npz", "--out", "t.npz"]);
    let of = |name: &str| bench.member("t.npz", name);
    let (offset, scale, split, signals) =
        (of("signal_offset"), of("signal_scale"), of("split"), of("signals_initial"));
    let training =
        split.iter().zip(signals.chunks(signals.len() / split.len())).filter(|(set, _)| **set == 0.0);
    let mut reached = [[0.0f64; 2]; 3];
    for x in training.flat_map(|(_, sample)| sample.chunks(3)) {
        for (c, ends) in reached.iter_mut().enumerate() {
            let scaled = (x[c] - offset[c]) / scale[c];
            *ends = [ends[0].min(scaled), ends[1].max(scaled)];
        }
    }
    assert!(reached.as_flattened().iter().all(|x| (x.abs() - 1.0).abs() < 1e-9), "{reached:?}");
    for format in ["c", "onnx"] {
        let refused = bench.metasense(&["export", "s.sqlite", &hash, "--format", format, "--out", "o"]);
        let said = String::from_utf8_lossy(&refused.stderr);
        assert!(!refused.status.success() && said.contains("brain.scaling = \"minmax\""), "{format}: {said}");
    }
}
