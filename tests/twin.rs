//! Twins: fitted to records of a cast; decoders are trained on them.

use crate::common::Bench;
use crate::identify::{SPEC, made_of};
use metasense_worker::design::{self, Layout};

/// The body of `identify`'s tests, with a linear decoder and training samples.
fn trainable() -> String {
    SPEC.replace("samples = 4\ntest = 1\n", "samples = 20\ntest = 4\n[brain]\nkind = \"linear\"\n")
}

/// Material of the recorded cast, in the order of the rows: stretch, shear, bend, damping, density.
const TRUE: [f64; 5] = [3.12, 0.48, 1.05, 0.035, 1.02e-8];
const RECORDS: usize = 10;
const INSTANTS: usize = 40;

fn hash(bench: &Bench, spec: &str) -> String {
    let csv = bench.output(&["expand", spec, "--format", "csv"]);
    csv.lines().nth(1).unwrap().split(',').next().unwrap().to_owned()
}

/// Ten records of a cast whose nodes deviate by 0.1 mm, with 2 % of noise.
fn bench() -> Bench {
    let bench = Bench::new();
    bench.file("s.toml", &trainable());
    bench.file("cast.toml", &made_of(&trainable(), TRUE));
    let layout = Layout::planar(3, 3, 15.0, 2.25);
    let mut shifted = layout.initial_design(25f64.to_radians());
    shifted.iter_mut().enumerate().for_each(|(i, a)| *a += 0.14 * (2.3 * i as f64).sin());
    let path = bench.path("cast.npy");
    std::fs::write(&path, design::bytes(&path, &layout, &shifted).unwrap()).unwrap();
    let force = |record: usize, panel: usize, n: usize| {
        let (onset, width) = (0.004 * record as f64, 0.03 + 0.004 * record as f64 + 0.02 * panel as f64);
        let z = ((0.2 * n as f64 / INSTANTS as f64 - onset) / width).clamp(0.0, 1.0);
        (0.2 + 0.1 * ((record + panel) % 3) as f64) * (std::f64::consts::PI * z).sin().powi(2)
    };
    let histories = (0..RECORDS).flat_map(|i| [(i, 0), (i, 1)]);
    let forces: Vec<f64> = histories.flat_map(|(i, k)| (0..=INSTANTS).map(move |n| force(i, k, n))).collect();
    bench.write_array("f.npy", &[RECORDS as u64, 2, INSTANTS as u64 + 1], &forces);
    let cast = hash(&bench, "cast.toml");
    let run = ["body", "simulate", "cast.toml", &cast, "--forces", "f.npy", "--design", "cast.npy"];
    bench.output(&[&run[..], &["--out-dir", "a"]].concat());
    let signals = bench.array("a/signals.npy").1;
    // equidistributed, hence equal on every machine; the sum of twelve such numbers is nearly normal
    let noise =
        |i: usize| -> f64 { (1..=12).map(|k| ((i * 12 + k) as f64 * 0.754_877_666).fract() - 0.5).sum() };
    let rms = |c: usize| {
        let of = signals[c..].iter().step_by(3);
        (of.map(|s| s * s).sum::<f64>() / (RECORDS * INSTANTS) as f64).sqrt()
    };
    let size = [0, 1, 2].map(rms);
    let noisy: Vec<f64> =
        signals.iter().enumerate().map(|(i, s)| s + 0.02 * size[i % 3] * noise(i)).collect();
    bench.write_array("y.npy", &[RECORDS as u64, INSTANTS as u64, 3], &noisy);
    let accelerations: Vec<f64> = noisy.chunks_exact(3).flat_map(|y| &y[..2]).copied().collect();
    bench.write_array("two.npy", &[RECORDS as u64, INSTANTS as u64, 2], &accelerations);
    for (name, signals) in [("r.toml", "y.npy"), ("two.toml", "two.npy")] {
        let recorded = "[recorded]\nfiles = [\"f.npy\"]\nrate = 200.0\n";
        bench.file(name, &format!("{recorded}[signals]\nfiles = [\"{signals}\"]\nstart = 0.005\n"));
    }
    bench
}

/// Checks fitted, lower and upper value of each row against the cast's material.
fn assert_true(csv: &str) {
    let number = |text: &str| text.parse::<f64>().unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), TRUE.len(), "{csv}");
    for (row, truth) in rows.iter().zip(TRUE) {
        let [value, low, high] = [3, 4, 5].map(|i| number(row[i]));
        // the noise is not quite white: twice the 95 % interval
        assert!((value - truth).abs() < high - low && low < value && value < high, "{truth}\n{csv}");
        assert!((value / truth - 1.0).abs() < 0.03, "{truth}\n{csv}");
    }
}

/// A number of a CSV by its column's name, in the row with this beginning.
fn value_of(csv: &str, row: &str, column: &str) -> f64 {
    let at = csv.lines().next().unwrap().split(',').position(|name| name == column).unwrap();
    let line = csv.lines().find(|line| line.starts_with(row)).unwrap_or_else(|| panic!("{csv}"));
    line.split(',').nth(at).unwrap().parse().unwrap()
}

/// Records determine the cast, also with fewer channels. The twin's signals equal the records'. A decoder trained on the twin
/// decodes them.
#[test]
fn a_twin_tells_the_cast_and_teaches_brains() {
    let bench = bench();
    let of = |spec: &str, records: &str, more: &[&str]| {
        let call = ["lab", "identify", spec, &hash(&bench, spec), "--records", records, "--fit", "variation"];
        bench.output(&[&call[..], more].concat())
    };
    let one = of("s.toml", "r.toml", &["--format", "csv", "--out", "t.toml"]);
    assert_true(&one);
    let two = trainable().replace("[brain]", "[sensors]\nchannels = [\"ax\", \"ay\"]\n[brain]");
    bench.file("two_channels.toml", &two);
    let table = of("two_channels.toml", "two.toml", &["--threads", "2"]);
    assert!(table.contains("converged after") && table.contains("node shifts: fitted RMS 0."), "{table}");

    let hash = hash(&bench, "s.toml");
    let call = ["lab", "evaluate", "s.toml", &hash, "--records", "initial=r.toml", "--folds", "2"];
    let csv = bench.output(&[&call[..], &["--twin", "initial=t.toml", "--format", "csv"]].concat());
    let value = |row: &str, column: &str| value_of(&csv, row, column);
    assert!(value("initial,twin", "difference") < 0.3 * value("initial,simulated", "difference"), "{csv}");
    // it is trained with the trial's own forces, not with those of the records
    assert!(
        value("initial,twin", "error_train") < 100.0 && value("initial,twin", "records") == 10.0,
        "{csv}"
    );

    // the body's model decodes them as well, and the twin's model does better
    let bells = "amplitude = [0.2, 0.4]\nwidth = [0.03, 0.1]\nonset = [0.0, 0.04]\nholdout = 6\n[sensors]\nnoise = 0.02\n[brain]";
    let noisy = trainable().replace("[brain]", bells);
    bench.file("noisy.toml", &noisy);
    let call = ["lab", "evaluate", "noisy.toml", "--twin", "initial=t.toml", "--brain", "inverse"];
    let read = |records: &str, out: &str| {
        bench.output(&[&call[..], &["--records", records, "--format", "csv", "--out-dir", out]].concat())
    };
    for (csv, begins) in [
        (read("initial=r.toml", "measured"), "initial,measured"),
        (read("initial=holdout", "holdout"), "initial,holdout"),
    ] {
        let cell = |row: &str, column: &str| value_of(&csv, row, column);
        let both = |column: &str| [begins, "initial,twin"].map(|row| cell(row, column));
        let ([error, by_twin], [covered, more]) = (both("error_test"), both("coverage"));
        let [lost, none] = both("unexplained");
        assert!(by_twin < 0.2 * error && covered < more && lost > 0.0 && none == 0.0, "{csv}");
        assert!(cell("initial,twin", "cpu_seconds") > 0.0, "{csv}");
    }
    let npz = std::fs::read(bench.path("measured/records.npz")).unwrap();
    let text = String::from_utf8_lossy(&npz);
    for held in ["forces_low_initial.npy", "twin_forces_high_initial.npy", "twin_predictions_initial.npy"] {
        assert!(text.contains(held), "{held}");
    }
    let page = std::fs::read_to_string(bench.path("measured/index.html")).unwrap();
    assert!(page.contains("with its twin, ") && page.contains("class=\"band fine initial\""), "{page}");
}

/// Refused with file, line, key and remedy.
#[test]
fn what_is_no_twin_is_refused() {
    let bench = bench();
    let twin = |stretch: &str, more: &str| {
        format!(
            "body = \"0\"\nmisfit = 1.0\nnoise = [1.0, 1.0]\nligament_length = 1.0\n{more}\n[material]\nstretch = {stretch}\nshear = 1.0\n\
             bend = 1.0\ndamping = 1.0\ndensity = 1.0\ncontact = 1.0\n"
        )
    };
    let refused = |call: &[&str], says: &[&str]| {
        let run = bench.metasense(call);
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.code() == Some(2) && says.iter().all(|s| said.contains(s)), "{said}");
    };
    let spec = hash(&bench, "s.toml");
    let with = |file: &str, says: &[&str]| {
        let call = ["lab", "evaluate", "s.toml", &spec, "--records", "initial=r.toml", "--twin"];
        refused(&[&call[..], &[&format!("initial={file}")]].concat(), says);
    };
    bench.file("other.toml", &twin("1.0", ""));
    with("other.toml", &["other.toml:1", "body = 0", "belongs to another body"]);
    bench.file("odd.toml", &twin("1.0", "mass = 3.0"));
    with("odd.toml", &["odd.toml:5", "mass"]);
    with("nowhere.toml", &["nowhere.toml"]);
    // a twin of this body, then made invalid
    bench.output(&["lab", "identify", "s.toml", &spec, "--records", "r.toml", "--out", "t.toml"]);
    let text = std::fs::read_to_string(bench.path("t.toml")).unwrap();
    let at = text.find("stretch = ").unwrap();
    let end = at + text[at..].find('\n').unwrap();
    bench.file("broken.toml", &format!("{}stretch = -1.0{}", &text[..at], &text[end..]));
    with("broken.toml", &["broken.toml:", "material.stretch = -1", "above 0"]);
    let noise = text.find("noise = ").unwrap();
    let end = noise + text[noise..].find('\n').unwrap();
    bench.file("quiet.toml", &format!("{}noise = [1.0]{}", &text[..noise], &text[end..]));
    with("quiet.toml", &["quiet.toml:", "noise = 1 entries", "must have 3 entries"]);
    let call = ["lab", "evaluate", "s.toml", &spec, "--records", "initial=r.toml", "--twin", "who=t.toml"];
    refused(&call, &["--twin who", "--records who=FILE"]);
    let identify = ["lab", "identify", "s.toml", &spec, "--records"];
    refused(&[&identify[..], &["two.toml"]].concat(), &["two.toml", "must be 3"]);
    let both = ["r.toml", "--fit", "variation,stretch"];
    refused(&[&identify[..], &both].concat(), &["--fit variation", "must stand alone"]);
    for old in [&["lab", "twin"][..], &["twin"]] {
        refused(&[old, &["s.toml"]].concat(), &["is now `metasense lab identify --fit variation`"]);
    }
}
