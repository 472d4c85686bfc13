//! Analyses of a body before training: modes, linear model, bounds.

use crate::common::{Bench, TINY, light};
use metasense::look::digits;
use serde_json::Value;

fn json(text: &str) -> Vec<Value> {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}: {text}"))
}

fn refused(bench: &Bench, args: &[&str], expected: &str) {
    let output = bench.metasense(args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains(expected), "{args:?}: {said}");
}

/// Modes are sorted and drawn; a unit's response is greatest near one; invalid arguments are refused by name.
#[test]
fn a_body_rings() {
    let bench = Bench::new();
    bench.file("s.toml", TINY);
    let modes = json(
        &bench.output(&["body", "modes", "s.toml", "--count", "5", "--out", "m.svg", "--format", "json"]),
    );
    let of = |key: &str| modes.iter().map(|mode| mode[key].as_f64().unwrap()).collect::<Vec<_>>();
    assert!(modes.len() == 5 && of("frequency").is_sorted() && of("frequency")[0] > 5.0, "{modes:?}");
    assert!(of("damping_ratio").iter().all(|ratio| (0.005..0.5).contains(ratio)), "{modes:?}");
    let svg = std::fs::read_to_string(bench.path("m.svg")).unwrap();
    assert_eq!(svg.matches("<polygon class=\"unit s").count(), 5 * 16);
    let asked =
        ["body", "modes", "s.toml", "--count", "5", "--response", "9", "--out", "r.svg", "--format", "json"];
    let responses = json(&bench.output(&asked));
    assert_eq!(responses.len(), 2 * 200);
    let first = responses.iter().filter(|row| row["panel"] == 0);
    let size = |row: &Value| row["a_x"].as_f64().unwrap().hypot(row["a_y"].as_f64().unwrap());
    let most = first.max_by(|a, b| size(a).total_cmp(&size(b))).unwrap()["frequency"].as_f64().unwrap();
    assert!(of("frequency").iter().any(|f| (f / most - 1.0).abs() < 0.1), "{most} {modes:?}");
    assert!(std::fs::read_to_string(bench.path("r.svg")).unwrap().contains("panel 1"));

    let free = ["body", "modes", "s.toml", "body.damping_ratio=0.0", "--count", "45", "--format", "json"];
    let undamped = json(&bench.output(&free));
    assert!(
        undamped.iter().all(|mode| mode["damping_ratio"] == 0.0 && mode["decay_time"].is_null()),
        "{undamped:?}"
    );

    refused(&bench, &["body", "modes", "s.toml", "--response", "16"], "--response 16: ");
    refused(&bench, &["body", "modes", "s.toml", "--response", "0"], "unit 0: it is clamped");
    refused(&bench, &["body", "modes", "s.toml", "zz"], "trial zz: no hash begins with this text");
    bench.file("loose.toml", &TINY.replacen("[time]", "clamp = []\n[time]", 1));
    let loose = json(&bench.output(&["body", "modes", "loose.toml", "--format", "json"]));
    assert!(loose[..3].iter().all(|mode| mode["frequency"] == 0.0), "{loose:?}");
    assert!(loose[3]["frequency"].as_f64().unwrap() > 0.0);
    refused(
        &bench,
        &["body", "modes", "loose.toml", "body.damping_ratio=0.0"],
        "neither stiffness nor damping",
    );
}

/// Every trial contains the error of a linear model; the bounds of both bodies are printed beside the errors of decoders, including
/// an inverse one, and are below them.
#[test]
fn a_finished_trial_stands_beside_its_bounds() {
    let bench = Bench::new();
    let spec = light()
        .replace("sensors = [1, 2]", "sensors = [1]\n\"brain.kind\" = [\"linear\", \"inverse\"]")
        .replace("holdout = 2", "holdout = 8")
        .replace("[brain]\niterations = 10\nwidth = 16\n", "[sensors]\nnoise = 0.1\n");
    bench.file("s.toml", &spec);
    bench.output(&["run", "s.toml", "--workers", "1"]);
    let sql = "SELECT nonlinear_acceleration_initial AS a, nonlinear_rotation_optimised AS b FROM v_trial";
    let shares = json(&bench.output(&["query", "results/tiny.sqlite", sql, "--format", "json"]));
    let share = |key: &str| shares[0][key].as_f64().unwrap();
    assert!(["a", "b"].iter().all(|key| (0.1..500.0).contains(&share(key))), "{shares:?}");
    let asked = ["analyse", "results/tiny.sqlite", "--question", "nonlinear", "--format", "json"];
    let answer = json(&bench.output(&asked));
    assert!(answer.len() == 8 && answer[0]["nonlinear"].as_f64() == Some(share("a")), "{answer:?}");

    let own = ["body", "bound", "s.toml", "--samples", "2", "--format", "json"];
    let alone = json(&bench.output(&own));
    let beside = json(&bench.output(&[&own[..], &["--db", "results/tiny.sqlite"]].concat()));
    let find = |rows: &[Value], body: &str, by: &str| {
        let row = rows.iter().find(|row| {
            row["body"] == body && row["read_by"].as_str().unwrap().starts_with(by) && row["sample"] == "mean"
        });
        row.unwrap_or_else(|| panic!("{body} by {by}: {rows:?}"))["error"].as_f64().unwrap()
    };
    let bounds = ["best linear", "any decoder"];
    for by in bounds {
        assert_eq!(find(&alone, "initial", by), find(&beside, "initial", by));
        for body in ["initial", "optimised"] {
            let [bound, linear, deaf] = [by, "linear", "no signal"].map(|by| find(&beside, body, by));
            assert!(0.0 < bound && bound < linear && bound < deaf && deaf < 120.0, "{by}: {beside:?}");
        }
    }
    for body in ["initial", "optimised"] {
        let sql = format!("SELECT holdout_error_{body} AS error FROM v_trial WHERE brain = 'inverse'");
        let own = json(&bench.output(&["query", "results/tiny.sqlite", &sql, "--format", "json"]));
        let [least, inverse, linear] = ["any decoder", "inverse", "linear"].map(|by| find(&beside, body, by));
        assert_eq!(own[0]["error"].as_f64(), Some(inverse));
        assert!(least < inverse && inverse < linear, "{beside:?}");
    }
    let informed = alone.iter().find(|row| row["sample"] == "mean information").unwrap();
    assert!(informed["error"].as_f64().unwrap() <= find(&alone, "initial", "best linear"), "{alone:?}");
    let quieter = json(&bench.output(&[&own[..], &["--noise", "0.01"]].concat()));
    assert!(
        bounds.iter().all(|by| find(&quieter, "initial", by) < find(&alone, "initial", by)),
        "{quieter:?}"
    );

    let why = bench.output(&["body", "operator", "results/tiny.sqlite", "--out", "operator.svg"]);
    let rows = json(&bench.output(&["body", "operator", "results/tiny.sqlite", "--format", "json"]));
    assert!(
        why.lines().count() == 2 + 12
            && rows.len() == 4
            && std::fs::read_to_string(bench.path("operator.svg")).unwrap().contains("<circle"),
        "{why}"
    );
    let number = |row: &Value, column: &str| row[column].as_f64().unwrap();
    let initial = rows.iter().find(|row| row["body"] == "initial").unwrap();
    let own = digits(number(initial, "wiener_error"), 4);
    assert!(why.contains(&format!(" {own} |")), "{own}: {why}");
    for row in &rows {
        let (left, ranks) = (number(row, "wiener_error"), number(row, "distinguishable_forces"));
        assert!(0.0 < left && left < 100.0 && (1.0..=2.0).contains(&ranks), "{row:?}");
        assert!(number(row, "bits") > 0.0 && number(row, "memory") > 0.0, "{row:?}");
        assert!((1.0..=96.0).contains(&number(row, "modes")), "{row:?}");
    }
    refused(&bench, &["body", "operator", "s.toml"], "s.toml");

    bench.file("silent.toml", TINY);
    refused(&bench, &["body", "bound", "silent.toml"], "sensors.noise");
    refused(
        &bench,
        &["body", "bound", "silent.toml", "--db", "results/tiny.sqlite"],
        "no finished trial with the scene",
    );
    refused(&bench, &["body", "bound", "s.toml", "--noise", "0"], "must be above 0");
    // noise below the resolution of f64, a prior of one sample, no force: an answer or an error with the key
    let exact = bench.metasense(&["body", "bound", "s.toml", "--noise", "1e-300", "--samples", "1"]);
    assert!(matches!(exact.status.code(), Some(0 | 2)), "{}", String::from_utf8_lossy(&exact.stderr));
    let one = ["body", "bound", "s.toml", "stimuli.samples=3", "stimuli.test=2"];
    refused(&bench, &one, "stimuli.samples: there must be two training samples");
    let late = "stimuli.onset=[0.1999, 1000.0]";
    for command in ["body bound", "body place", "trial"] {
        refused(
            &bench,
            &[command.split(' ').collect(), vec!["s.toml", late]].concat(),
            "no training sample has a force",
        );
    }
    refused(
        &bench,
        &["trial", "s.toml", late, "sensors.search=\"greedy\""],
        "no training sample has a force",
    );
}

/// Compression as an axis of a sweep: other signals, other modes. A straight body that buckles is refused with a remedy.
#[test]
fn a_press_is_an_axis() {
    let bench = Bench::new();
    let linear = light()
        .replace("iterations = 10\nwidth = 16\n", "kind = \"linear\"\n")
        .replace("sensors = [1, 2]", "sensors = [1]")
        .replacen("[time]", "clamp = \"sides\"\n[time]", 1);
    let pressed =
        linear.replace("sensors = [1]", "sensors = [1]\n\"body.compression\" = [[0.0, 0.0], [0.05, 0.0]]");
    bench.file("s.toml", &pressed);
    let rows = json(&bench.output(&["run", "s.toml", "--workers", "1", "--format", "json"]));
    let error = |row: usize, body: &str| rows[row][format!("holdout_error_{body}")].as_f64().unwrap();
    assert!(rows.len() == 2 && rows.iter().all(|row| row["state"] == "done"), "{rows:?}");
    assert!(
        ["initial", "optimised"].iter().all(|body| (error(0, body) / error(1, body) - 1.0).abs() > 1e-2),
        "{rows:?}"
    );

    bench.file("cast.toml", &linear);
    bench.file("pressed.toml", &linear.replacen("[time]", "compression = [0.05, 0.0]\n[time]", 1));
    let slowest = ["cast.toml", "pressed.toml"].map(|spec| {
        let modes = json(&bench.output(&["body", "modes", spec, "--count", "1", "--format", "json"]));
        modes[0]["frequency"].as_f64().unwrap()
    });
    assert!((slowest[0] / slowest[1] - 1.0).abs() > 1e-2, "{slowest:?}");

    let straight = "clamp = \"ends\"\npanel_units = [4, 11]\ninitial_angle = 0\ncompression = [0.0, 0.1]";
    bench.file("straight.toml", &linear.replacen("clamp = \"sides\"", straight, 1));
    let output = bench.metasense(&["run", "straight.toml", "--workers", "1", "--db", "straight.sqlite"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() != Some(0) && said.contains("buckled"), "{said}");
    assert!(said.contains("`body.compression` nearer to 0"), "{said}");
}

/// Strong pulses cause motion that no step resolves: running, showing and exporting such a trial gives a warning, and `solver` in
/// v_trial contains it.
#[test]
fn motion_that_no_step_resolves_is_warned_of() {
    let bench = Bench::new();
    let strong = TINY
        .replace("sensors = [1, 2]", "sensors = [1]")
        .replace("[solver]", "amplitude = [5.0, 5.5]\n[solver]");
    bench.file("s.toml", &strong);
    bench.file("calm.toml", &TINY.replace("sensors = [1, 2]", "sensors = [1]"));
    let forces: Vec<f64> =
        (0..42).map(|n| 12.0 * (std::f64::consts::PI * f64::from(n % 21) / 20.0).sin()).collect();
    bench.write_array("f.npy", &[1, 2, 21], &forces);
    let db = "results/tiny.sqlite";
    let said = |args: &[&str]| {
        let output = bench.metasense(args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{args:?}: {said}");
        said.matches("no time step reaches solver.tolerance").count()
    };
    // when the trial is done, and at the end
    assert_eq!(said(&["run", "s.toml", "--workers", "1"]), 2);
    let hash = bench.output(&["query", db, "SELECT hash FROM v_trial", "--format", "csv"]);
    let hash = hash.lines().nth(1).unwrap();
    for shown in [
        &["run", "s.toml"][..],
        &["status", db],
        &["status", db, hash],
        &["analyse", db, "--question", "seconds"],
        &["export", db, hash, "--format", "npy", "--out", "d.npy"],
        &["body", "simulate", "s.toml", "--forces", "f.npy", "--out-dir", "a"],
    ] {
        assert_eq!(said(shown), 1, "{shown:?}");
    }
    bench.output(&["report", db, "--out", "r.html"]);
    let page = std::fs::read_to_string(bench.path("r.html")).unwrap();
    assert!(page.contains("no time step reaches solver.tolerance"));
    let solver = bench.output(&["query", db, "SELECT solver FROM v_trial", "--format", "csv"]);
    assert!(solver.contains("gave the requested error"), "{solver}");
    assert_eq!(said(&["trial", "calm.toml"]), 0);
}
