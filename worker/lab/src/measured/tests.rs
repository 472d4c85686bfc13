use metasense_worker::files::npy_bytes as npy;
use serde_json::json;

use super::*;
use crate::simulate::simulate;

fn trial(panels: &[usize], sensors: &[usize]) -> TrialSpec {
    serde_json::from_value(json!({
        "body": { "columns": 3, "rows": 3, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
            "stiffness": { "stretch": 3.0, "shear": 0.5, "bend": 1.0 } },
        "time": { "duration": 0.1, "samples": 20 }, "solver": {}, "sensors": {},
        "stimuli": { "kind": "bell" }, "brain": {}, "optimise": {}, "evaluation": {}, "feasible": {},
        "point": { "panels": panels.len(), "sensors": sensors.len(), "placement": 0, "seed": 3 },
        "panel_units": panels, "sensor_units": sensors,
    }))
    .unwrap()
}

/// A temporary folder with `records.toml` and data files.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new(files: &[(&str, &[u8])]) -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        files.iter().for_each(|(name, bytes)| folder.file(name, bytes));
        folder
    }

    fn file(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.0.path().join(name), bytes).unwrap();
    }

    fn read(&self, text: &str, trial: &TrialSpec) -> Result<Measured, String> {
        self.file("records.toml", text.as_bytes());
        read(&self.0.path().join("records.toml"), trial).map_err(|e| e.to_string())
    }
}

fn furthest(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let scale = b.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    a.iter().zip(b).fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) / scale
}

/// Simulated signals can be read back, with channels along either axis.
#[test]
fn simulated_signals_are_read_back_as_measured_ones() {
    let trial = trial(&[6, 8], &[4, 3]);
    let design = crate::simulate::body(&trial).unwrap().1;
    let forces: Vec<f64> = (0..3 * 2 * 21).map(|i| (f64::from(i) * 0.7).sin()).collect();
    let signals = simulate(&trial, &design, (&[3, 2, 21], &forces), None, 1).unwrap().signals;
    let turned: Vec<f64> = (0..3 * 6 * 20)
        .map(|at| {
            let (i, c, n) = (at / 120, at / 20 % 6, at % 20);
            signals[(i * 20 + n) * 6 + c]
        })
        .collect();
    let folder = Folder::new(&[
        ("forces.npy", &npy(&[3, 2, 21], &forces)),
        ("signals.npy", &npy(&[3, 20, 6], &signals)),
        ("turned.npy", &npy(&[3, 6, 20], &turned)),
    ]);
    for name in ["signals.npy", "turned.npy"] {
        let text = format!(
            "[recorded]\nfiles = [\"forces.npy\"]\nrate = 200.0\n[signals]\nfiles = [\"{name}\"]\nstart = 0.005\n"
        );
        let found = folder.read(&text, &trial).unwrap();
        let far = [furthest(&found.forces.values, &forces), furthest(&found.signals, &signals)];
        assert!(far.iter().all(|far| *far < 1e-9), "{name}: {far:?}");
        assert_eq!((found.forces.samples, found.forces.panels, found.forces.instants), (3, 2, 20));
    }
}

/// 201 lines at 1 kHz: a blow of 2 N at 30 ms on an offset; the chip measures g and °/s.
fn csv() -> String {
    let line = |n: i32| {
        let ring = f64::from(n - 30).max(0.0) * 1e-3;
        let blow = if n == 30 { 2000.0 } else { 0.0 };
        format!("{n},{},{},{},{}\n", blow + 7.0, ring + 1.0, -ring, 180.0 * ring)
    };
    "ms,F,x,y,w\n".to_owned() + &(0..=200).map(line).collect::<String>()
}

const CSV: &str = r#"[recorded]
files = ["a.csv"]
time = "ms"
time_unit = "ms"
force = ["F"]
force_unit = "mN"
resample = "linear"
panels = [1]
trigger = { threshold = 1.0, before = 0.02 }
[signals]
channels = ["x", "y", "w"]
acceleration_unit = "g"
angular_velocity_unit = "deg/s"
factors = [1, -1, 1]
"#;

/// Units, factors, the struck panel, and the trigger, which shifts force and signals.
#[test]
fn a_chip_s_record_comes_in_the_trial_s_units_and_where_the_trigger_wants_it() {
    let folder = Folder::new(&[("a.csv", csv().as_bytes())]);
    let found = folder.read(CSV, &trial(&[6, 8], &[4])).unwrap();
    let [quiet, struck] = [0, 1].map(|k| &found.forces.values[k * 21..][..21]);
    assert!(quiet.iter().all(|f| *f == 0.0) && (struck[4] - 2.007).abs() < 1e-12, "{struck:?}");
    for (n, signals) in found.signals.chunks_exact(3).enumerate() {
        // 5 ms per instant, the blow 10 ms earlier than in the file.
        let ring = (f64::from(n as u32 + 1) * 0.005 - 0.02).max(0.0);
        let expected = [(ring + 1.0) * 9806.65, ring * 9806.65, std::f64::consts::PI * ring];
        let wrong = signals.iter().zip(expected).any(|(a, b)| (a - b).abs() > 1e-9 * (1.0 + b.abs()));
        assert!(!wrong, "{n}: {signals:?} {expected:?}");
    }
    let without = CSV.replace("[signals]", "remove_offset = true\n[signals]");
    let found = folder.read(&without, &trial(&[6, 8], &[4])).unwrap();
    assert!((found.forces.values[21 + 4] - 2.0).abs() < 1e-12, "{:?}", found.forces.values);
    assert!(found.signals[1].abs() < 2e3, "{}", found.signals[1]);
}

/// For a decoder of some channels, records contain only these, in their units.
#[test]
fn records_hold_the_channels_that_are_read() {
    let folder = Folder::new(&[("a.csv", csv().as_bytes())]);
    let mut some = trial(&[6, 8], &[4]);
    some.sensors.channels = Some(vec![Channel::Ay, Channel::Omega]);
    let text = CSV.replace("[\"x\", \"y\", \"w\"]", "[\"y\", \"w\"]").replace("[1, -1, 1]", "[-1, 1]");
    let [found, all] = [(&text[..], &some), (CSV, &trial(&[6, 8], &[4]))]
        .map(|(text, trial)| folder.read(text, trial).unwrap().signals);
    let wanted: Vec<f64> = all.chunks_exact(3).flat_map(|all| [all[1], all[2]]).collect();
    assert_eq!(found, wanted);
    let refused = folder.read(CSV, &some).unwrap_err().to_string();
    assert!(refused.contains("must be 2 numbers other than 0"), "{refused}");
}

/// The chip has its own clock: 5 kHz, started 12 ms after the hammer's. The low-pass removes what 200 Hz cannot represent.
#[test]
fn signals_have_a_clock_of_their_own_and_pass_the_low_pass() {
    let tone = |hertz: f64, t: f64| (std::f64::consts::TAU * hertz * t).sin();
    let lines = |t: f64| format!("{},{},{}\n", tone(20.0, t), tone(1300.0, t), 3.0);
    let chip =
        "x,y,w\n".to_owned() + &(0..600).map(|n| lines(f64::from(n) * 2e-4 + 0.012)).collect::<String>();
    // A force sensor whose noise is below the threshold of a blow.
    let force: Vec<f64> = (0..21).map(|n| if n < 3 { 0.01 } else { 0.5 }).collect();
    let folder = Folder::new(&[("f.npy", &npy(&[1, 1, 21], &force)), ("a.csv", chip.as_bytes())]);
    let text = "[recorded]\nfiles = [\"f.npy\"]\nrate = 200.0\n[signals]\nfiles = [\"a.csv\"]\nrate = 5000.0\nstart = 0.012\n";
    let found = folder.read(text, &trial(&[7], &[4])).unwrap();
    for (n, signals) in found.signals.chunks_exact(3).enumerate().skip(8) {
        let t = f64::from(n as u32 + 1) * 0.005;
        let far = [signals[0] - tone(20.0, t), signals[1], signals[2] - 3.0];
        assert!(far.iter().all(|far| far.abs() < 0.05), "{t}: {signals:?} {far:?}");
    }
}

/// Each error names file, line, key, value and remedy.
#[test]
fn what_is_no_measured_record_is_refused_by_name() {
    let folder = Folder::new(&[
        ("a.csv", csv().as_bytes()),
        ("short.csv", csv().lines().take(90).collect::<Vec<_>>().join("\n").as_bytes()),
        ("nan.csv", csv().replace("\n7,7,1,", "\n7,7,NaN,").as_bytes()),
        ("s.npy", &npy(&[1, 20, 3], &[1.0; 60])),
        ("two.npy", &npy(&[2, 201, 3], &[1.0; 1206])),
        ("four.npy", &npy(&[1, 201, 4], &[1.0; 804])),
    ]);
    let trial = trial(&[6, 8], &[4]);
    let beside = |name: &str| format!("[signals]\nfiles = [\"{name}\"]\nrate = 1000.0\n");
    let own = &CSV[CSV.find("[signals]").unwrap()..];
    for (from, to, said) in [
        ("panels = [1]", "", "records.toml:1: recorded.panels: must name the panel, from 0 to 1"),
        (
            "panels = [1]",
            "panels = [2]",
            "records.toml:8: recorded.panels = [2]: must name one of panels 0 to 1",
        ),
        (
            "panels = [1]",
            "panel = [1]",
            "records.toml:8: recorded.panel = [1]: unknown key; the nearest known one",
        ),
        ("\"w\"]", "\"o\"]", "records.toml:2: recorded.files = "),
        ("\"w\"]", "\"o\"]", "has no signal \"o\"; signals are ms, F, x, y, w"),
        (", \"w\"]", "]", "contains 2 signals per record; must be 3: ax, ay, omega of each sensor"),
        ("\"g\"", "\"G\"", "records.toml:12: signals.acceleration_unit = \"G\": must be "),
        (
            "[1, -1, 1]",
            "[1, -1]",
            "records.toml:14: signals.factors = [1.0, -1.0]: must be 3 numbers other than 0",
        ),
        ("a.csv", "none.csv", "none.csv\": cannot be read"),
        (
            "a.csv",
            "short.csv",
            "short.csv\": contains signals that end at 0.0780 s, but a sample lasts 0.1 s",
        ),
        ("a.csv", "nan.csv", "nan.csv\": line 9: x = \"NaN\": must be a finite number"),
        (
            "[\"x\", \"y\", \"w\"]",
            "[\"x\", \"y\", \"w\"]\nstart = 5.0",
            "contains signals that begin at 4.9900 s of a sample, the force at 0.0200 s",
        ),
        ("panels", "augment = { shift = [0, 0] }\npanels", "recorded.augment = { … }: must be left out"),
        (own, &beside("s.npy"), "contains signals that end at 0.0090 s"),
        (
            own,
            &beside("s.npy").replace("rate", "start"),
            "s.npy\": has three dimensions, so no clock: set rate",
        ),
        (own, &beside("two.npy"), "two.npy\": contains signals of 2 records, but forces of 1"),
        (own, &beside("four.npy"), "four.npy\": contains 201 signals per record; must be 3"),
        (
            own,
            &beside("s.npy").replace("npy\"]", "npy\", \"s.npy\"]"),
            "signals.files = 2 files: must contain one file for each of the 1",
        ),
        (own, &(beside("s.npy") + "time = \"t\"\n"), "signals.rate = 1000: set either time or rate"),
    ] {
        assert!(CSV.contains(from), "{from}");
        let error = folder.read(&CSV.replacen(from, to, 1), &trial).unwrap_err();
        assert!(error.contains(said), "{error}\n{said}");
    }
    let short = "[recorded]\nfiles = [\"f.npy\"]\nrate = 200.0\n[signals]\nfiles = [\"s.npy\"]\n";
    folder.file("f.npy", &npy(&[1, 2, 21], &[0.5; 42]));
    let error = folder.read(short, &trial).unwrap_err();
    assert!(
        error.contains(
            "contains 20 entries of signals and 21 of force: set the clock of the signals with signals.start"
        ),
        "{error}"
    );
}

/// Rejects copies under any name and format, the force as a signal, and equal signals under two forces.
#[test]
fn a_record_is_read_once() {
    let (a, b) = (csv(), csv().replace("\n50,7,", "\n50,8,"));
    let other_signals = csv().replace("\n50,7,1.02,", "\n50,7,1.03,");
    assert!(a != b && a != other_signals);
    let folder = Folder::new(&[
        ("a.csv", a.as_bytes()),
        ("b.csv", b.as_bytes()),
        ("other.csv", other_signals.as_bytes()),
        ("copy.csv", a.as_bytes()),
        ("blanks.csv", a.replace(',', " , ").as_bytes()),
        ("semicolons.CSV", a.replace(',', ";").replace('.', ",").as_bytes()),
        ("later.csv", a.replace("\n0,", "\n0.0,").as_bytes()),
    ]);
    let at = |name: &str| folder.0.path().join(name);
    std::os::unix::fs::symlink(at("a.csv"), at("soft.csv")).unwrap();
    std::fs::hard_link(at("a.csv"), at("hard.csv")).unwrap();
    let trial = trial(&[6, 8], &[4]);
    let read = |files: &str, more: &str| {
        let text = CSV.replace("[\"a.csv\"]", files).replace("panels = [1]", "panels = [1, 1]");
        folder.read(&text.replace("[signals]", &format!("[signals]\n{more}")), &trial)
    };
    for second in
        ["a.csv", "./a.csv", "copy.csv", "blanks.csv", "semicolons.CSV", "later.csv", "soft.csv", "hard.csv"]
    {
        let error = read(&format!("[\"a.csv\", \"{second}\"]"), "").unwrap_err();
        assert!(
            error.contains("recorded.files = ") && error.contains("is the same record as"),
            "{second}: {error}"
        );
    }
    // Accepts equal forces with other signals; rejects equal signals with another force.
    assert_eq!(read("[\"a.csv\", \"other.csv\"]", "").unwrap().forces.samples, 2);
    let error = read("[\"a.csv\", \"b.csv\"]", "").unwrap_err();
    assert!(
        error.contains("b.csv\": contains the signals of ") && error.contains("under another force"),
        "{error}"
    );
    let error = read("[\"a.csv\", \"other.csv\"]", "files = [\"other.csv\", \"other.csv\"]").unwrap_err();
    assert!(error.contains("signals.files = ") && error.contains("is the same record as"), "{error}");
    let forces = CSV.replace("[\"x\", \"y\", \"w\"]", "[\"F\", \"y\", \"w\"]");
    let error = folder.read(&forces, &trial).unwrap_err();
    assert!(error.contains("signal 0 equals the force"), "{error}");
    let twice = CSV.replace("[\"x\", \"y\", \"w\"]", "[\"x\", \"x\", \"w\"]");
    let error = folder.read(&twice, &trial).unwrap_err();
    assert!(error.contains("x is read twice"), "{error}");
    let one: Vec<f64> = (0..63).map(|n| f64::from(n * n % 7)).collect();
    folder.file("s.npy", &npy(&[2, 21, 3], &[&one[..], &one].concat()));
    folder.file("f.npy", &npy(&[2, 1, 21], &[0.5; 42]));
    let text =
        "[recorded]\nfiles = [\"f.npy\"]\nrate = 200.0\npanels = [0, 0]\n[signals]\nfiles = [\"s.npy\"]\n";
    let error = folder.read(text, &trial).unwrap_err();
    assert!(error.contains("record 0"), "{error}");
}

/// Clocks of forces and signals may have different units; an invalid unit is rejected with its key.
#[test]
fn each_file_has_its_unit_of_time() {
    let lines = |step: f64, fields: &str| {
        (0..=100).map(|n| format!("{}{fields}\n", step * f64::from(n))).collect::<String>()
    };
    let ramp = |step: f64| {
        (0..=100)
            .map(|n| format!("{},{},{},1\n", step * f64::from(n), f64::from(n), -f64::from(n)))
            .collect::<String>()
    };
    let folder = Folder::new(&[
        ("f.csv", ("t,f\n-0.001,0\n".to_owned() + &lines(0.001, ",0.5")).as_bytes()),
        ("s.csv", ("t,x,y,w\n".to_owned() + &ramp(1.0)).as_bytes()),
        ("slow.csv", ("t,x,y,w\n".to_owned() + &ramp(0.02)).as_bytes()),
        ("seconds.csv", ("t,x,y,w\n".to_owned() + &ramp(0.001)).as_bytes()),
    ]);
    let trial = trial(&[7], &[4]);
    let text = "[recorded]\nfiles = [\"f.csv\"]\ntime = \"t\"\nforce = [\"f\"]\n[signals]\nfiles = [\"s.csv\"]\ntime = \"t\"\n\
                channels = [\"x\", \"y\", \"w\"]\n";
    let right = folder.read(&format!("{text}time_unit = \"ms\"\n"), &trial).unwrap();
    let seconds = folder.read(&text.replace("s.csv", "seconds.csv"), &trial).unwrap();
    assert!(furthest(&right.signals, &seconds.signals) < 1e-9);
    for (text, key, said) in [
        (text.to_owned(), "signals.files = ", "check signals.time_unit"),
        (
            text.replace("\ntime = \"t\"\nchannels", "\nrate = 2.0\nchannels"),
            "signals.files = ",
            "check signals.rate",
        ),
        (
            text.replace("\ntime = \"t\"\nforce", "\nrate = 5.0\nforce"),
            "recorded.files = ",
            "check recorded.rate",
        ),
        (
            format!("{text}start = 0.0\n")
                .replace("\ntime = \"t\"\nchannels", "\ntime_unit = \"ms\"\nchannels"),
            "signals.time_unit",
            "has no effect without signals.time",
        ),
        (
            text.replace("s.csv", "seconds.csv")
                .replace("[signals]", "trigger = { threshold = 0.1, before = 0.3 }\n[signals]"),
            "recorded.files = ",
            "has its blow outside of the sample",
        ),
        (
            text.replace("files = [\"s.csv\"]\n", "header = true\n"),
            "signals.header",
            "none of signals.files is a CSV",
        ),
    ] {
        let error = folder.read(&text, &trial).unwrap_err();
        assert!(error.contains(key) && error.contains(said), "{error}\n{key} {said}\n{text}");
    }
}

/// Rejects a square array: its axes cannot be told apart.
#[test]
fn an_array_whose_axes_cannot_be_told_apart_is_refused() {
    let signals: Vec<f64> = (0..9).map(f64::from).collect();
    let folder = Folder::new(&[
        ("f.npy", &npy(&[1, 1, 3], &[0.5; 3])),
        ("s.npy", &npy(&[1, 3, 3], &signals)),
        ("flat.npy", &npy(&[3, 3], &signals)),
    ]);
    let trial = trial(&[7], &[4]);
    for name in ["s.npy", "flat.npy"] {
        let text = format!("[recorded]\nfiles = [\"f.npy\"]\nrate = 20.0\n[signals]\nfiles = [\"{name}\"]\n");
        let error = folder.read(&text, &trial).unwrap_err();
        assert!(
            error.contains(name) && error.contains("signals.files = ") && error.contains("has shape"),
            "{error}"
        );
    }
}

/// A check names an unreadable file of several records. Later records keep their entries, or are not checked if these are unknown.
#[test]
fn an_unreadable_file_of_several_records_is_named() {
    let values = |n: u32| -> Vec<f64> { (1..=n).map(|n| f64::from(n * n % 97)).collect() };
    let folder = Folder::new(&[
        ("bad.npy", b"no array"),
        ("f.npy", &npy(&[2, 1, 21], &values(42))),
        ("s.npy", &npy(&[2, 21, 3], &values(126))),
    ]);
    let look = |files: &[&str], panels: &[usize], start: &[f64]| -> Vec<_> {
        let text = format!(
            "[recorded]\nfiles = {files:?}\nrate = 200.0\npanels = {panels:?}\n[signals]\nfiles = {:?}\nstart = {start:?}\n",
            vec!["s.npy"; files.len()]
        );
        folder.file("records.toml", text.as_bytes());
        let records = read_raw(&folder.0.path().join("records.toml"), &trial(&[6, 8], &[4])).unwrap().records;
        let of = |raw: Result<Raw, String>| raw.map(|raw| (raw.panel, raw.start));
        records.into_iter().map(|(number, raw)| (number, of(raw))).collect()
    };
    let is_named = |of: &Result<_, String>, what: &str| of.as_ref().is_err_and(|e| e.contains(what));
    let (bad, hidden) = ("bad.npy\": is not an NPY", "f.npy\": is not checked");
    let found = look(&["bad.npy", "f.npy"], &[0, 0, 1, 0], &[0.0, 0.0, 0.005, 0.01]);
    assert!(found[0].0 == Some(0) && is_named(&found[0].1, bad), "{found:?}");
    assert!(found.len() == 2 && found[1].0.is_none() && is_named(&found[1].1, hidden), "{found:?}");
    // with as many entries as files, an unreadable file has one record
    let found = look(&["bad.npy", "bad.npy"], &[1; 2], &[0.01; 2]);
    let named = found.iter().map(|(number, raw)| (*number, is_named(raw, bad)));
    assert_eq!(named.collect::<Vec<_>>(), [(Some(0), true), (Some(1), true)]);
}
