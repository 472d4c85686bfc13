//! Decoders as an axis of the sweep: training and evaluation with linear decoders and networks, from the spec to exports.

use crate::common::{Bench, TINY, light, results};

/// TINY with a network and with a linear decoder, each with either decoder in training.
fn spec() -> String {
    TINY.replace(
        "sensors = [1, 2]",
        "sensors = [1]\n\"brain.kind\" = [\"cnn\", \"linear\"]\n\"optimise.brain\" = [\"cnn\", \"linear\"]",
    )
}

/// Random and searched placements side by side. Each trial states its units and its kind of placement; exports and replays use
/// these units; one and two workers give equal results; `place` finds the same units.
#[test]
fn sensors_are_searched_for() {
    let bench = Bench::new();
    let searched = "sensors = [2]\n\"sensors.search\" = [\"random\", \"greedy\"]";
    let spec = light()
        .replace("sensors = [1, 2]", searched)
        .replace("[brain]\niterations = 10\nwidth = 16", "[brain]\nkind = \"linear\"");
    bench.file("s.toml", &spec);
    bench.output(&["run", "s.toml", "--workers", "2"]);
    let found = rows(
        &bench,
        "SELECT placed, replace(sensor_units, ',', ' '), hash, holdout_error_initial FROM v_trial ORDER BY placed",
    );
    let ways: Vec<&str> = found.iter().map(|row| row[0].as_str()).collect();
    assert_eq!(ways, ["greedy", "random"]);
    assert!(found.iter().all(|row| row[1].split_whitespace().count() == 2), "{found:?}");
    let table =
        bench.output(&["body", "place", "s.toml", &found[0][2], "--out", "p.svg", "--format", "json"]);
    let units = found[0][1].trim_matches(['[', ']']);
    assert!(table.contains(&format!("\"units\":\"{units}\"")), "{units}: {table}");
    let svg = std::fs::read_to_string(bench.path("p.svg")).unwrap();
    assert_eq!(svg.matches("class=\"number\"").count(), 2);
    bench.output(&["export", "results/tiny.sqlite", &found[0][2], "--format", "npz", "--out", "t.npz"]);
    let one = Bench::new();
    one.file("s.toml", &spec);
    one.output(&["run", "s.toml", "--workers", "1"]);
    let all = "SELECT hash, sensor_units, holdout_error_optimised FROM v_trial ORDER BY hash";
    assert_eq!(rows(&bench, all), rows(&one, all));
}

/// The inverse decoder on a body trained with a linear decoder: its errors are smaller than a linear decoder's, both bodies have
/// posterior bands, and casts are decoded with the model of the design and with twins. The bits do not depend on the number of
/// threads.
#[test]
fn a_body_is_read_by_its_own_model() {
    let spec = TINY
        .replace("sensors = [1, 2]", "sensors = [1]")
        .replace("[brain]\niterations = 10\nwidth = 16", "[brain]\nkind = \"inverse\"")
        .replace("samples = 8\n", "samples = 16\n")
        .replace(
            "[sweep]",
            "[sensors]\nnoise = 0.03\n[variation]\nstretch = 0.05\n[evaluation]\ncasts = 1\n[sweep]",
        );
    let bench = Bench::new();
    bench.file("s.toml", &spec);
    bench.output(&["run", "s.toml", "--workers", "2"]);
    let errors =
        "SELECT trained_with, holdout_error_initial, linear_holdout_error_initial, holdout_error_optimised,
        linear_holdout_error_optimised FROM v_trial ORDER BY hash";
    for row in rows(&bench, errors) {
        let errors: Vec<f64> = row[1..].iter().map(|cell| cell.parse().expect("an error")).collect();
        assert!(row[0] == "linear" && errors[0] < errors[1] && errors[2] < errors[3], "{row:?}");
    }
    let read =
        "SELECT reader, records, count(instants_covered), count(*), min(error) > 0, min(outcome) FROM v_cast
        WHERE reader IN ('inverse', 'twin', 'twin_linear') GROUP BY 1, 2 ORDER BY 1, 2";
    let read = rows(&bench, read);
    let expected = [["inverse", "0", "2"], ["twin", "10", "2"], ["twin_linear", "10", "0"]];
    assert_eq!(read.iter().map(|row| [row[0].as_str(), &row[1], &row[2]]).collect::<Vec<_>>(), expected);
    assert!(read.iter().all(|row| row[3..] == ["2", "1", "ok"]), "{read:?}");
    let bands = "SELECT body, reader, samples, coverage BETWEEN 0 AND 1, width > 0 FROM v_band
        WHERE method = 'posterior' AND kind = 'instant' AND casting IS NULL ORDER BY hash, body";
    let bands = rows(&bench, bands);
    let own = |body: &str| vec![body.to_owned(), "own".into(), "2".into(), "1".into(), "1".into()];
    assert_eq!(bands, [own("initial"), own("optimised")]);
    let second_bench = Bench::new();
    second_bench.file("s.toml", &spec);
    second_bench.output(&["run", "s.toml", "--workers", "1", "--threads", "2"]);
    for all in [
        "SELECT * FROM v_cast ORDER BY 1, body, reader, records",
        "SELECT * FROM v_band ORDER BY 1, body, reader, kind",
    ] {
        assert_eq!(rows(&bench, all), rows(&second_bench, all));
    }
    assert_eq!(rows(&bench, errors), rows(&second_bench, errors));
    let hash = &rows(&bench, "SELECT hash FROM v_trial")[0][0];
    // `evaluate` decodes the same held-out set with the same decoder
    let call = ["lab", "evaluate", "results/tiny.sqlite", hash, "--records", "initial=holdout", "--records"];
    let csv = bench.output(&[&call[..], &["optimised=holdout", "--format", "csv"]].concat());
    let stored =
        "SELECT v.holdout_error_initial, v.holdout_error_optimised, a.coverage, b.coverage FROM v_trial v
        JOIN v_band a ON a.hash = v.hash AND a.body = 'initial' AND a.casting IS NULL
        JOIN v_band b ON b.hash = v.hash AND b.body = 'optimised' AND b.casting IS NULL";
    let stored: Vec<f64> = rows(&bench, stored)[0].iter().map(|cell| cell.parse().unwrap()).collect();
    let columns: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    for (b, line) in csv.lines().skip(1).enumerate() {
        let cell =
            |name: &str| line.split(',').nth(columns.iter().position(|c| *c == name).unwrap()).unwrap();
        let number = |name: &str| cell(name).parse::<f64>().unwrap();
        assert_eq!((cell("signals"), cell("records"), cell("unexplained")), ("holdout", "2", "0"), "{csv}");
        assert!((number("error_test") / stored[b] - 1.0).abs() < 1e-9, "{csv}\n{stored:?}");
        assert!((number("coverage") - 100.0 * stored[2 + b]).abs() < 1e-9, "{csv}\n{stored:?}");
        assert!(number("cpu_seconds") > 0.0 && number("not_converged") <= 2.0, "{csv}");
    }
    // exports compute predictions for test and held-out set again, with finer steps
    for form in ["npz", "csv", "parquet"] {
        let out = format!("t.{form}");
        bench.output(&["export", "results/tiny.sqlite", hash, "--format", form, "--out", &out]);
    }
    let npz = std::fs::read(bench.path("t.npz")).unwrap();
    let (split, forces) = (array(&npz, "split").1, array(&npz, "forces").1);
    let csv = std::fs::read_to_string(bench.path("t.csv")).unwrap();
    let columns: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    for (b, body) in ["initial", "optimised"].into_iter().enumerate() {
        let arrays =
            ["predictions", "forces_low", "forces_high"].map(|of| array(&npz, &format!("{of}_{body}")).1);
        let [said, low, high] = &arrays;
        let (mut inside, mut all) = (0, 0);
        for (i, (n, k)) in
            (0..split.len()).flat_map(|i| (0..20).flat_map(move |n| [(i, (n, 0)), (i, (n, 1))]))
        {
            let (at, f) = ((i * 20 + n) * 2 + k, forces[(i * 2 + k) * 21 + n + 1]);
            let line: Vec<&str> = csv.lines().nth(1 + i * 20 + n).unwrap().split(',').collect();
            for (of, values) in ["prediction", "forces_low", "forces_high"].into_iter().zip(&arrays) {
                let column = format!("{of}_{k}_{body}");
                let cell = line[columns.iter().position(|name| *name == column).unwrap()];
                assert_eq!(cell.parse::<f64>().ok(), (split[i] > 0.0).then_some(values[at]), "{column}, {i}");
            }
            // nothing is uncertain before the earliest possible force
            assert!(split[i] == 0.0 || (low[at] <= said[at] && said[at] <= high[at]), "{i}, {n}, {k}");
            (inside, all) = match split[i] == 2.0 {
                true => (inside + usize::from(low[at] <= f && f <= high[at]), all + 1),
                false => (inside, all),
            };
        }
        let coverage = f64::from(inside as u32) / f64::from(all as u32);
        assert!((coverage - stored[2 + b]).abs() < 0.05, "{coverage}, {stored:?}");
    }
    bench.output(&["report", "results/tiny.sqlite", "--out", "r.html"]);
    let page = std::fs::read_to_string(bench.path("r.html")).unwrap();
    assert!(page.contains("True and predicted forces") && page.contains("class=\"band optimised\""));
}

/// Rows of a query as lists of cells.
fn rows(bench: &Bench, sql: &str) -> Vec<Vec<String>> {
    let csv = bench.output(&["query", "results/tiny.sqlite", sql, "--format", "csv"]);
    csv.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

/// Four trials, each also decoded from the whole sample. The errors of a trial with a linear decoder equal that reading; equally
/// trained bodies have equal readings; one and two workers give the same bits.
#[test]
fn every_body_is_read_by_both_brains() {
    let bench = Bench::new();
    bench.file("s.toml", &spec());
    bench.output(&["run", "s.toml", "--workers", "2"]);
    let found = rows(
        &bench,
        "SELECT brain, trained_with, holdout_error_initial, holdout_error_optimised, linear_holdout_error_initial,
           linear_holdout_error_optimised, linear_test_error_initial, linear_test_error_optimised
         FROM v_trial ORDER BY brain, trained_with",
    );
    let kinds: Vec<[&str; 2]> = found.iter().map(|row| [row[0].as_str(), row[1].as_str()]).collect();
    assert_eq!(kinds, [["cnn", "cnn"], ["cnn", "linear"], ["linear", "cnn"], ["linear", "linear"]]);
    for row in &found {
        assert!(row[2..].iter().all(|cell| cell.parse::<f64>().is_ok_and(|e| e > 0.0)), "{row:?}");
        assert_eq!(row[4], found[0][4], "the initial body is the same");
        if row[0] == "linear" {
            assert_eq!((&row[2], &row[3]), (&row[4], &row[5]));
        }
    }
    // one body per decoder in training, whatever decodes it
    assert_eq!((&found[0][5], &found[1][5]), (&found[2][5], &found[3][5]));
    assert_ne!(found[0][5], found[1][5]);
    let readings = rows(
        &bench,
        "SELECT t.hash, sum(r.whole), count(*), max(r.before), min(r.after) FROM v_trial t JOIN v_reading r USING (hash)
         GROUP BY 1",
    );
    for row in &readings {
        assert_eq!(row[1], "2", "a whole sample a body: {row:?}");
        assert!(row[2].parse::<u32>().unwrap() > 8, "{row:?}");
        assert_eq!((row[3].parse::<f64>().unwrap() * 1e3).round(), 190.0, "19 of 20 instants of 10 ms");
    }

    let table = bench.output(&["analyse", "results/tiny.sqlite", "--question", "brains", "--format", "csv"]);
    for row in [
        "\"cnn, width 16\",\"cnn, width 16\",",
        "linear,\"cnn, width 16\",",
        "linear,linear,0.19,0.19",
        "\"cnn, width 16\",linear,0.19,0.0",
    ] {
        assert!(table.lines().any(|line| line.contains(row)), "{row}\n{table}");
    }
    bench.output(&["report", "results/tiny.sqlite", "--out", "r.html"]);
    let page = std::fs::read_to_string(bench.path("r.html")).unwrap();
    assert!(page.contains("the error of a linear decoder of the whole sample is"), "{page}");
    assert!(page.contains("Body or decoder?"));

    let once = results(&bench, "results/tiny.sqlite");
    bench.output(&["run", "s.toml", "--workers", "1", "--db", "again.sqlite"]);
    assert_eq!(results(&bench, "again.sqlite"), once);
}

/// Shape and values of an array in an archive.
fn array(npz: &[u8], name: &str) -> (Vec<usize>, Vec<f64>) {
    let file = format!("{name}.npy");
    // entry heads end with the name, which may be the end of another name
    let at =
        (0..npz.len() - file.len()).find(|&i| npz[i..].starts_with(file.as_bytes()) && npz[i - 1] != b'_');
    let start = at.unwrap_or_else(|| panic!("{name}")) + file.len();
    let array = npyz::NpyFile::new(&npz[start..]).unwrap();
    let shape = array.shape().iter().map(|n| *n as usize).collect();
    let kind = array.dtype().descr();
    let values = match kind {
        _ if kind.contains('i') => array.into_vec::<i64>().unwrap().into_iter().map(|x| x as f64).collect(),
        _ if kind.contains('u') => array.into_vec::<u8>().unwrap().into_iter().map(f64::from).collect(),
        _ => array.into_vec().unwrap(),
    };
    (shape, values)
}

/// The exported linear decoder gives the exported predictions: f̂ = b + Σ W · signal / scale on the window.
#[test]
fn an_exported_linear_brain_says_what_is_exported() {
    let bench = Bench::new();
    bench.file("s.toml", &spec());
    bench.output(&["run", "s.toml"]);
    let hash =
        &rows(&bench, "SELECT hash FROM v_trial WHERE brain = 'linear' AND trained_with = 'linear'")[0][0];
    bench.output(&["export", "results/tiny.sqlite", hash, "--format", "npz", "--out", "t.npz"]);
    let npz = std::fs::read(bench.path("t.npz")).unwrap();
    let array = |name: &str| array(&npz, name);
    let (shape, w) = array("linear_w_optimised");
    let (b, lags) = (array("linear_b_optimised").1, array("linear_lags").1);
    let (signals, scale) = (array("signals_optimised"), array("signal_scale").1);
    let predicted = array("linear_predictions_optimised").1;
    let [panels, count, channels] = shape[..] else { panic!("{shape:?}") };
    let [samples, instants, _] = signals.0[..] else { panic!("{:?}", signals.0) };
    assert_eq!((panels, count, channels, lags), (2, 39, 3, vec![-19.0, 19.0]));
    for (i, n, k) in (0..samples).flat_map(|i| (0..instants).map(move |n| (i, n, (i + n) % 2))) {
        let mut said = b[k];
        for l in 0..count {
            if let Some(t) = (n + l).checked_sub(19).filter(|t| *t < instants) {
                for c in 0..channels {
                    said += w[(k * count + l) * channels + c] * signals.1[(i * instants + t) * channels + c]
                        / scale[c];
                }
            }
        }
        let expected = predicted[(i * instants + n) * panels + k];
        assert!((said - expected).abs() < 1e-9, "{i} {n} {k}: {said} {expected}");
    }
    // this is the trial's own decoder
    assert_eq!(array("predictions_optimised").1, predicted);

    // the fraction of held-out forces within the bands equals the trial's, except for the repeated simulation
    let (forces, split) = (array("forces").1, array("split").1);
    for (kind, of) in [("instant", "forces"), ("sample", "sample")] {
        let sql = format!(
            "SELECT coverage, width, samples FROM v_band WHERE hash = '{hash}' AND body = 'optimised' AND kind = '{kind}'"
        );
        let told: Vec<f64> = rows(&bench, &sql)[0].iter().map(|x| x.parse().unwrap()).collect();
        let [low, high] = ["low", "high"].map(|end| array(&format!("{of}_{end}_optimised")).1);
        let at = |i: usize, n: usize, k: usize| (i * instants + n) * panels + k;
        let within = |i: usize| {
            let all = (0..instants).flat_map(|n| (0..panels).map(move |k| (n, k)));
            let inside = all.filter(|&(n, k)| {
                let f = forces[(i * panels + k) * (instants + 1) + n + 1];
                low[at(i, n, k)] <= f && f <= high[at(i, n, k)]
            });
            let part = inside.count() as f64 / (instants * panels) as f64;
            if kind == "sample" { part.floor() } else { part }
        };
        let holdout: Vec<usize> = (0..samples).filter(|&i| split[i] == 2.0).collect();
        let coverage = holdout.iter().map(|&i| within(i)).sum::<f64>() / holdout.len() as f64;
        let width = low.iter().zip(&high).map(|(low, high)| high - low).sum::<f64>() / low.len() as f64;
        assert!((coverage - told[0]).abs() < 0.05, "{kind}: {coverage} in the arrays, {} stored", told[0]);
        assert!(width > 0.0 && (width / told[1] - 1.0).abs() < 1e-9, "{kind}: {width}, {}", told[1]);
        assert_eq!(told[2], 99.0);
    }
}

/// Keys that a trial's decoder does not use do not make trials differ; they are refused if no decoder of the sweep uses them.
#[test]
fn keys_of_another_brain_make_no_difference_or_are_refused() {
    let bench = Bench::new();
    let hashes = |spec: &str| -> Vec<String> {
        bench.file("s.toml", spec);
        let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
        csv.lines().skip(1).map(|line| line[..32].to_owned()).collect()
    };
    let both = spec();
    let longer = both.replace("iterations = 10\n", "iterations = 11\n");
    let (a, b) = (hashes(&both), hashes(&longer));
    assert_eq!(a.len(), 4);
    assert_eq!(a.iter().filter(|hash| b.contains(hash)).count(), 1, "linear alone: {a:?} {b:?}");

    let said = |brain: &str| {
        let linear = TINY
            .replace("[brain]\niterations = 10\nwidth = 16", &format!("[brain]\nkind = \"linear\"\n{brain}"));
        hashes(&linear)
    };
    for other in ["ridge = \"auto\"", "memory = [0.2, 0.2]", "memory = [0.19, 0.2]"] {
        assert_eq!(said(other), said(""), "{other}");
    }
    assert_ne!(said("memory = [0.2, 0.0]"), said(""));

    let linear = TINY.replace("[brain]\niterations = 10\nwidth = 16", "[brain]\nkind = \"linear\"");
    assert_eq!(hashes(&linear).len(), 2);
    let edits = [
        (
            &linear,
            "kind = \"linear\"",
            "kind = \"linear\"\nmemory = [0.3, 0.0]",
            "brain.memory = [0.3, 0.0]: must be two times",
        ),
        (
            &linear,
            "kind = \"linear\"",
            "kind = \"linear\"\nmemory = [-0.1, 0.0]",
            "brain.memory = [-0.1, 0.0]: must be two times",
        ),
        (&linear, "kind = \"linear\"", "kind = \"linear\"\nridge = -1.0", "brain.ridge = -1: must be 0"),
        (&linear, "kind = \"linear\"", "kind = \"linear\"\nridge = \"most\"", "brain.ridge = \"most\": "),
        (&linear, "kind = \"linear\"", "kind = \"lineal\"", "brain.kind = \"lineal\": "),
        (
            &linear,
            "kind = \"linear\"",
            "kind = \"linear\"\niterations = 20",
            "brain.iterations = 20: has no effect: no trial has",
        ),
        (
            &linear,
            "batch = 4",
            "batch = 4\nbrain_iterations = 3",
            "optimise.brain_iterations = 3: has no effect",
        ),
        (
            &linear,
            "batch = 4",
            "batch = 4\nbrain = \"inverse\"",
            "optimise.brain = \"inverse\": stacked and inverse decoders cannot train bodies",
        ),
        (&linear, "[solver]", "[evaluation]\nseeds = 2\n[solver]", "evaluation.seeds = 2: has no effect"),
        (
            &TINY.to_owned(),
            "iterations = 10",
            "iterations = 10\nmemory = [0.1, 0.1]",
            "brain.memory = [0.1, 0.1]: has no effect",
        ),
        (
            &TINY.to_owned(),
            "iterations = 10",
            "iterations = 10\nridge = 0.1",
            "brain.ridge = 0.1: has no effect",
        ),
    ];
    for (spec, from, to, said) in edits {
        bench.file("s.toml", &spec.replacen(from, to, 1));
        let output = bench.metasense(&["run", "s.toml"]);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{to}: {errors}");
        assert!(errors.contains("s.toml:") && errors.contains(said), "{errors}\n{said}");
    }
}
