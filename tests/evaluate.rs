//! Measured signals, from files to the table that compares bodies.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::Bench;
use crate::common::processes::{eventually, kill};
use metasense_worker::design::{self, Layout};

const SPEC: &str = r#"name = "s"
[body]
columns = 4
rows = 4
spacing = 15.0
ligament_length = 2.25
density = 1e-8
stiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }
[time]
duration = 0.2
samples = 40
[stimuli]
kind = "irregular"
samples = 10
test = 2
holdout = 2
onset = [0.0, 0.05]
[brain]
iterations = 60
width = 16
[optimise]
iterations = 2
batch = 4
[evaluation]
seeds = 2
[sweep]
panels = [2]
sensors = [1]
"#;

const RECORDS: usize = 12;
const INSTANTS: usize = 40;

/// A value of a CSV by its column's name, in the row with this beginning.
fn value(csv: &str, row: &str, column: &str) -> Option<f64> {
    let at = csv.lines().next().unwrap().split(',').position(|name| name == column).unwrap();
    let line = csv.lines().find(|line| line.starts_with(row)).unwrap_or_else(|| panic!("{row}\n{csv}"));
    line.split(',').nth(at).unwrap().parse().ok()
}

/// Simulated records of two bodies under twelve blows, and the files that describe them. One body has a bad chip (a CSV per record,
/// in m/s² and degrees), the other a good chip (an array). Returns the trial's hash.
fn bench() -> (Bench, String) {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
    let hash = csv.lines().nth(1).unwrap().split(',').next().unwrap().to_owned();
    let layout = Layout::planar(4, 4, 15.0, 2.25);
    let other = bench.path("other.npy");
    std::fs::write(&other, design::bytes(&other, &layout, &layout.initial_design(0.3)).unwrap()).unwrap();
    let force = |i: usize, k: usize, n: usize| -> f64 {
        let t = n as f64 / INSTANTS as f64 * (1.0 + 0.2 * i as f64) - 0.1 * k as f64;
        0.5 * (7.0 * t).sin().max(0.0) * (-3.0 * t).exp()
    };
    let mut forces = Vec::new();
    for (i, k) in (0..RECORDS).flat_map(|i| [(i, 0), (i, 1)]) {
        forces.extend((0..=INSTANTS).map(|n| force(i, k, n)));
    }
    bench.write_array("forces.npy", &[RECORDS as u64, 2, INSTANTS as u64 + 1], &forces);
    let simulate =
        ["body", "simulate", "s.toml", &hash, "--forces", "forces.npy", "--format", "csv", "--out-dir"];
    bench.output(&[&simulate[..], &["a"]].concat());
    bench.output(&[&simulate[..], &["b", "--design", "other.npy"]].concat());

    let mut state = 1u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1u64 << 23) as f64 - 1.0
    };
    let mut disturbed = |name: &str, size: f64| -> Vec<f64> {
        let signals = bench.array(name).1;
        let rms = |c: usize| {
            let channel = signals[c..].iter().step_by(3);
            (channel.map(|x| x * x).sum::<f64>() / (RECORDS * INSTANTS) as f64).sqrt()
        };
        let rms = [0, 1, 2].map(rms);
        signals.iter().enumerate().map(|(i, x)| x + size * rms[i % 3] * noise()).collect()
    };
    let (bad, good) = (disturbed("a/signals.npy", 1.5), disturbed("b/signals.npy", 0.02));
    bench.write_array("good.npy", &[RECORDS as u64, INSTANTS as u64, 3], &good);
    let mut names = Vec::new();
    for i in 0..RECORDS {
        let mut text = "ms,f0,f1,x,y,w\n0,0,0,0,0,0\n".to_owned();
        for n in 1..=INSTANTS {
            let s = &bad[(i * INSTANTS + n - 1) * 3..][..3];
            let (f, g) = (1e3 * force(i, 0, n), 1e3 * force(i, 1, n));
            text += &format!("{},{f},{g},{},{},{}\n", 5 * n, s[0] / 1e3, s[1] / 1e3, s[2].to_degrees());
        }
        bench.file(&format!("{i}.csv"), &text);
        names.push(format!("\"{i}.csv\""));
    }
    bench.file(
        "bad.toml",
        &format!(
            "[recorded]\nfiles = [{}]\ntime = \"ms\"\ntime_unit = \"ms\"\nforce = [\"f0\", \"f1\"]\nforce_unit = \"mN\"\n\
             [signals]\nchannels = [\"x\", \"y\", \"w\"]\nacceleration_unit = \"m/s2\"\nangular_velocity_unit = \"deg/s\"\n",
            names.join(", ")
        ),
    );
    bench.file(
        "good.toml",
        "[recorded]\nfiles = [\"forces.npy\"]\nrate = 200.0\n[signals]\nfiles = [\"good.npy\"]\nstart = 0.005\n",
    );
    (bench, hash)
}

/// The body with the good chip has much smaller errors; numbers do not depend on the number of threads; the body's model agrees
/// with signals that hardly differ from it.
#[test]
fn the_body_that_is_truly_better_is_found_so() {
    let (bench, hash) = bench();
    let call = |more: &[&str]| {
        let bodies = ["--records", "initial=bad.toml", "--records", "other=good.toml"];
        let rest = ["--folds", "3", "--format", "csv"];
        bench.output(&[&["lab", "evaluate", "s.toml", &hash][..], &bodies, &rest, more].concat())
    };
    let csv = call(&["--design", "other=other.npy", "--out-dir", "out"]);
    assert_eq!(csv, call(&["--design", "other=other.npy", "--threads", "2"]));
    let [bad, good, promised] = ["initial,measured", "other,measured", "other,simulated"]
        .map(|row| value(&csv, row, "error_test").unwrap());
    assert!(good < 0.7 * bad, "{csv}");
    let low = value(&csv, "other,measured", "ratio_low").unwrap();
    assert!(
        low > 1.0 && (value(&csv, "other,measured", "ratio").unwrap() - bad / good).abs() < 1e-9,
        "{csv}"
    );
    assert!((promised / good - 1.0).abs() < 0.3, "{promised} {good}");
    let [near, far] =
        ["other", "initial"].map(|body| value(&csv, &format!("{body},simulated"), "difference").unwrap());
    assert!(near < 3.0 && (60.0..110.0).contains(&far), "{near} {far}");
    assert_eq!(value(&csv, "other,measured", "records"), Some(RECORDS as f64));

    // the same with linear decoders
    let linear = |more: &[&str]| {
        let bodies = ["--records", "initial=bad.toml", "--records", "other=good.toml"];
        bench.output(
            &[
                &["lab", "evaluate", "s.toml", &hash][..],
                &bodies,
                &["--brain", "linear", "--format", "csv"],
                more,
            ]
            .concat(),
        )
    };
    let by_linear = linear(&["--folds", "3"]);
    assert_eq!(by_linear, linear(&["--folds", "3", "--threads", "2"]));
    let [first, second] =
        ["initial,measured", "other,measured"].map(|row| value(&by_linear, row, "error_test").unwrap());
    assert!(second < 0.9 * first, "{by_linear}");

    let page = std::fs::read_to_string(bench.path("out/index.html")).unwrap();
    assert!(
        page.contains("the error of the initial body is") && page.matches("<svg class=\"plot\"").count() == 9,
        "{page}"
    );
    let npz = std::fs::read(bench.path("out/records.npz")).unwrap();
    let text = String::from_utf8_lossy(&npz);
    for held in ["predictions_other.npy", "(12, 40, 2", "simulated_signals_initial.npy", "(2, 12"] {
        assert!(text.contains(held), "{held}");
    }
    let errors = std::fs::read_to_string(bench.path("out/errors.csv")).unwrap();
    let of_body = errors.lines().filter(|line| line.starts_with("other,"));
    let known: Vec<f64> = of_body.map(|line| line.split(',').nth(3).unwrap().parse().unwrap()).collect();
    let mean = known.iter().sum::<f64>() / known.len() as f64;
    assert!(known.len() == RECORDS && (mean / good - 1.0).abs() < 1e-5, "{mean} {good}");
}

/// A trial from a database and signals from its export, which are the model's own.
#[test]
fn an_export_is_read_back_as_measured() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    bench.output(&["run", "s.toml"]);
    let hash = bench.output(&["query", "results/s.sqlite", "SELECT hash FROM v_trial", "--format", "csv"]);
    let hash = hash.lines().nth(1).unwrap();
    bench.output(&["export", "results/s.sqlite", hash, "--format", "npz", "--out", "t.npz"]);
    let mut call: Vec<String> =
        ["lab", "evaluate", "results/s.sqlite", &hash[..8]].map(String::from).to_vec();
    for body in ["initial", "optimised"] {
        let text = format!(
            "[recorded]\nfiles = [\"t.npz\"]\nrate = 200.0\nforce = [\"forces\"]\n[signals]\nchannels = [\"signals_{body}\"]\n\
             start = 0.005\n"
        );
        bench.file(&format!("{body}.toml"), &text);
        call.extend(["--records".into(), format!("{body}={body}.toml")]);
    }
    // the trained body again, with its design from a file
    bench.output(&["export", "results/s.sqlite", hash, "--format", "npy", "--out", "o.npy"]);
    call.extend(["--records", "again=optimised.toml", "--design", "again=o.npy"].map(String::from));
    call.extend(["--format", "csv", "--out-dir", "out"].map(String::from));
    let call: Vec<&str> = call.iter().map(String::as_str).collect();
    let csv = bench.output(&call);
    for row in ["initial,simulated", "optimised,simulated"] {
        let [correlation, difference] = ["correlation", "difference"].map(|c| value(&csv, row, c).unwrap());
        assert!(correlation > 0.9999 && difference < 0.2, "{csv}");
    }
    for signals in ["measured", "simulated"] {
        let [again, optimised] =
            ["again", "optimised"].map(|body| value(&csv, &format!("{body},{signals}"), "error_test"));
        assert_eq!(again, optimised, "{csv}");
    }
    assert_eq!(value(&csv, "initial,measured", "records"), Some(12.0));
    let page = std::fs::read_to_string(bench.path("out/index.html")).unwrap();
    let [optimised, again] =
        ["optimised", "again"].map(|body| page.find(&format!("times that of the {body} body")).unwrap());
    assert!(optimised < again, "comparisons are in the order of the bodies");
}

/// Sensors placed by a search, which the spec does not name: records are those of their units.
#[test]
fn a_body_is_read_by_the_sensors_that_it_has() {
    let bench = Bench::new();
    let searched = "[optimise]\nbrain = \"linear\"\nlearning_rate = 1.0\niterations = 15\nbatch = 8\n\
                    [sensors]\nsearch = \"greedy\"\n";
    let spec = SPEC.replace("[optimise]\niterations = 2\nbatch = 4\n", searched);
    bench.file("s.toml", &spec.replace("[sweep]\n", "[sweep]\nseeds = [2]\n"));
    bench.output(&["run", "s.toml"]);
    let sql =
        "SELECT t.hash, v.sensor_units, t.spec->>'$.sensor_units' FROM trial t JOIN v_trial v USING (hash)";
    let row = bench.output(&["query", "results/s.sqlite", sql, "--format", "csv"]);
    let row: Vec<&str> = row.lines().nth(1).unwrap().split(',').collect();
    assert_ne!(row[1], row[2], "nothing was placed");
    bench.output(&["export", "results/s.sqlite", row[0], "--format", "npz", "--out", "t.npz"]);
    let text = "[recorded]\nfiles = [\"t.npz\"]\nrate = 200.0\nforce = [\"forces\"]\n[signals]\n\
                channels = [\"signals_optimised\"]\nstart = 0.005\n";
    bench.file("optimised.toml", text);
    let call = [
        "lab",
        "evaluate",
        "results/s.sqlite",
        row[0],
        "--records",
        "optimised=optimised.toml",
        "--brain",
        "linear",
    ];
    let csv = bench.output(&[&call[..], &["--format", "csv"]].concat());
    let [correlation, difference] =
        ["correlation", "difference"].map(|c| value(&csv, "optimised,simulated", c).unwrap());
    assert!(correlation > 0.9999 && difference < 0.2, "{csv}");
}

/// Invalid calls are refused with the argument, or file and key, before anything trains.
#[test]
fn bad_calls_are_refused() {
    let (bench, hash) = bench();
    let initial = "--records=initial=bad.toml";
    let rest: String = (1..RECORDS).map(|i| format!(", \"{i}.csv\"")).collect();
    for (arguments, said) in [
        (vec![], "--records <BODY=FILE>"),
        (vec!["--records", "bad.toml"], "must be BODY=FILE, such as initial=records.toml"),
        (vec!["--records", "a b=bad.toml"], "\"a b\": a name consists of letters, digits, - and _"),
        (vec![initial, initial], "--records initial: given twice"),
        (vec!["--records", "initial=none.toml"], "cannot read none.toml"),
        (vec![initial, "--design", "o=other.npy"], "--design o: pass --records o=FILE"),
        (vec!["--records=o=bad.toml", "--design", "o=none.npy"], "reading none.npy"),
        (
            vec![initial, "--design", "initial=other.npy"],
            "--design initial=other.npy: initial is the trial's own body; give the body another name",
        ),
        (
            vec!["--records=o=bad.toml", "--design=o=other.npy", "--design=o=none.npy"],
            "--design o: given twice; pass one file per body",
        ),
        (vec![initial, "--twin=initial=a.toml", "--twin=initial=b.toml"], "--twin initial: given twice"),
        (
            vec![initial, "--folds", "13"],
            "--records initial: --folds 13: must lie between 2 and 12, the number of records",
        ),
        (
            vec![initial, "--brain", "inverse", "--folds", "2"],
            "--folds: has no effect on an inverse decoder, which is not trained on records",
        ),
        (
            vec!["--records=o=bad.toml", "--brain", "inverse"],
            "--records o=bad.toml: an inverse decoder needs the model of the body: pass --design BODY=FILE",
        ),
        (
            vec![initial, "--brain", "inverse"],
            "s.toml:1: sensors.noise: must be set: an inverse decoder needs the noise",
        ),
        (vec!["--records=initial=holdout"], "--records initial=holdout: only for --brain inverse"),
        (vec![initial, "--folds", "1"], "invalid value '1' for '--folds <N>'"),
        (
            vec!["--records=initial=one.toml"],
            "--records initial=one.toml: contains one record: pass two or more",
        ),
        (
            vec![initial, "--records=b=bad.toml"],
            "--records b=bad.toml: contains record 0 of --records initial=bad.toml",
        ),
        (vec!["--records", "initial=typo.toml"], "typo.toml:2: recorded.file = "),
    ] {
        bench.file("one.toml", &std::fs::read_to_string(bench.path("bad.toml")).unwrap().replace(&rest, ""));
        bench.file("typo.toml", "[recorded]\nfile = [\"0.csv\"]\n");
        let output = bench.metasense(&[vec!["lab", "evaluate", "s.toml", &hash], arguments.clone()].concat());
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {errors}");
        assert!(errors.contains(said), "{errors}\n{said}");
    }
    let output = bench.metasense(&["lab", "evaluate", "s.toml", "ffff", initial]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("no hash begins with this text"));
}

/// Killed after every network or two: the files of both bodies equal those of one uninterrupted call, and the stored progress
/// serves no other command.
#[test]
fn an_evaluation_goes_on_where_it_was_killed() {
    let (bench, _) = bench();
    let call = |out: &'static str| {
        let bodies = ["--records", "initial=good.toml", "--records", "b=bad.toml"];
        let effort = ["brain.iterations=200", "--folds", "3", "--threads", "2"];
        [&["lab", "evaluate", "s.toml"], &bodies[..], &effort, &["--out-dir", out]].concat()
    };
    let (whole, again) = (bench.output(&call("whole")), call("again"));
    let (kills, last) = bench.killed_until_done(&again, "again/unfinished.bin");
    let said = String::from_utf8_lossy(&last.stderr);
    assert!(kills >= 3 && said.contains("of 18 networks trained"), "{kills} kills: {said}");
    assert!(last.status.success() && String::from_utf8_lossy(&last.stdout) == whole, "{said}");
    assert!(bench.files("again") == bench.files("whole"), "the files differ");

    std::fs::write(bench.path("again/unfinished.bin"), [7; 40]).unwrap();
    let refused = bench.metasense(&again);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("again/unfinished.bin"), "{said}");
}

/// Ctrl-C during the computation, once the handler is installed.
#[test]
fn commands_that_compute_in_one_piece_end_at_once_on_request() {
    let (bench, hash) = bench();
    let evaluate =
        ["lab", "evaluate", "s.toml", "brain.iterations=1000000", "--records", "initial=good.toml"];
    let identify = ["lab", "identify", "s.toml", &hash, "--records", "good.toml"];
    let trial = ["trial", "s.toml", &hash];
    for (arguments, signal) in [
        (&evaluate[..], libc::SIGINT),
        (&evaluate, libc::SIGTERM),
        (&identify, libc::SIGINT),
        (&trial, libc::SIGINT),
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
        command.args(arguments).current_dir(bench.path("")).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let status = format!("/proc/{}/status", child.id());
        let caught = || {
            let status = std::fs::read_to_string(&status).ok()?;
            let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:"))?.trim();
            (u64::from_str_radix(mask, 16).ok()? >> (signal - 1) & 1 == 1).then_some(())
        };
        eventually(Duration::from_secs(20), caught).expect("the program sees to signals");
        let asked = Instant::now();
        kill(child.id(), signal);
        let gone = eventually(Duration::from_secs(20), || child.try_wait().unwrap());
        let seconds = asked.elapsed().as_secs_f64();
        let _ = child.kill();
        let said = String::from_utf8(child.wait_with_output().unwrap().stderr).unwrap();
        assert_eq!(gone.map(|ended| ended.code()), Some(Some(4)), "{arguments:?}: {said}");
        assert!(seconds < 2. && said.contains("starts again"), "{arguments:?}: {seconds} s: {said}");
    }
}
