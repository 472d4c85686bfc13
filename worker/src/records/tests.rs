use super::clock::with_clock;
use super::*;
use crate::files::npy_bytes as npy;
use serde_json::{Value, json};

/// A temporary folder of record files.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new(files: &[(&str, &[u8])]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in files {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        Self(folder)
    }

    /// Reads `stimuli.recorded` with these keys, for one training, test and held-out sample each, on two panels.
    fn read(&self, names: &[&str], keys: Value) -> Result<RecordedForces, Invalid> {
        let mut table = json!({ "files": names.iter().map(|n| self.0.path().join(n)).collect::<Vec<_>>() });
        table.as_object_mut().unwrap().extend(keys.as_object().unwrap().clone());
        let trial: TrialSpec = serde_json::from_value(json!({
            "body": { "columns": 3, "rows": 3, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
                "stiffness": { "stretch": 3.0, "shear": 0.5, "bend": 1.0 } },
            "time": { "duration": 1.0, "samples": 10 }, "solver": {}, "sensors": {},
            "stimuli": { "kind": "recorded", "samples": 2, "test": 1, "holdout": 1, "recorded": table },
            "brain": {}, "optimise": {}, "evaluation": {}, "feasible": {},
            "point": { "panels": 2, "sensors": 1, "placement": 0, "seed": 3 },
            "panel_units": [6, 8], "sensor_units": [4],
        }))
        .unwrap();
        load_records(&trial, trial.stimuli.recorded.as_ref().unwrap(), 10)
    }
}

/// 11 entries at intervals of 0.1 s, in ms and mN: a blow of `size` N at entry 3, an offset of 0.5 N.
fn csv(size: f64) -> Vec<u8> {
    let line = |n: usize| format!("{},{}\n", 100 * n + 2000, 1000.0 * if n == 3 { size + 0.5 } else { 0.5 });
    ("time,force\n".to_owned() + &(0..11).map(line).collect::<String>()).into_bytes()
}

const KEYS: &str = r#"{ "time": "time", "force": ["force"], "time_unit": "ms", "force_unit": "mN", "resample": "linear",
    "remove_offset": true, "trigger": { "threshold": 0.5, "before": 0.2 } }"#;

/// Units, offset and trigger: each blow is at 0.2 s, in N, for any clock of its file.
#[test]
fn a_record_comes_in_newtons_and_seconds_where_the_trigger_wants_it() {
    let folder = Folder::new(&[("1.csv", &csv(1.0)), ("2.csv", &csv(2.0)), ("3.csv", &csv(3.0))]);
    let found = folder.read(&["1.csv", "2.csv", "3.csv"], serde_json::from_str(KEYS).unwrap()).unwrap();
    assert_eq!((found.histories.samples, found.histories.panels, found.low_pass), (3, 1, false));
    for i in 0..3 {
        let expected: Vec<f64> = (0..11).map(|n| if n == 2 { i as f64 + 1.0 } else { 0.0 }).collect();
        let wrong = found.histories.sample(i).iter().zip(&expected).any(|(a, b)| (a - b).abs() > 1e-9);
        assert!(!wrong, "{:?}", found.histories.sample(i));
    }
}

/// Reads an array of (samples, panels, entries) with a rate; resamples an uneven clock.
#[test]
fn arrays_and_uneven_clocks_are_read() {
    let values: Vec<f64> = (0..3 * 2 * 21).map(f64::from).collect();
    let uneven = "t,f\n0,0\n0.05,0.5\n0.2,2\n1,10\n";
    let folder = Folder::new(&[("a.npy", &npy(&[3, 2, 21], &values)), ("b.csv", uneven.as_bytes())]);
    let found = folder.read(&["a.npy"], json!({ "rate": 20.0, "resample": "linear" })).unwrap();
    assert_eq!(found.histories.sample(1)[11..14], [63.0, 65.0, 67.0]);
    let keys = json!({ "time": 0, "force": [1], "resample": "linear" });
    let found = folder.read(&["b.csv", "b.csv", "b.csv"], keys).unwrap();
    let wrong = found.histories.sample(0).iter().enumerate().find(|(n, f)| (**f - *n as f64).abs() > 1e-9);
    assert_eq!(wrong, None);
}

/// A clock 1 % slow in the first half and 1 % fast in the second is 1 s off in the middle, although steps deviate by 1 % only.
/// f(t) = t is still read as t, also from pairs of entries 0.1 ms apart, which give at most four times as many.
#[test]
fn a_clock_that_drifts_is_evened_out() {
    let clock: Vec<f64> = (0..=200)
        .map(|n| if n <= 100 { 1.01 * f64::from(n) } else { 101.0 + 0.99 * f64::from(n - 100) })
        .collect();
    let pairs = (0..200).map(|n| 0.02 * f64::from(n / 2) + 1e-4 * f64::from(n % 2)).collect();
    let recorded = serde_json::from_value(json!({ "files": [], "time": "t", "force": ["f"] })).unwrap();
    for clock in [clock, pairs] {
        let pick = Pick::forces(&recorded, "recorded");
        let record = with_clock(&pick, &clock, &|n| n.to_string(), vec![clock.clone()]).unwrap();
        let off = |(n, f): (usize, &f64)| (f - record.start - n as f64 * record.dt).abs();
        let most = record.values[0].iter().enumerate().map(off).fold(0.0, f64::max);
        assert!(most < 1e-9 && record.values[0].len() <= 4 * clock.len(), "off by {most} s");
    }
}

/// Missing entries are distinguished from late entries and irregular clocks.
#[test]
fn a_clock_with_missing_entries_is_refused() {
    let recorded = serde_json::from_value(json!({ "files": [], "time": "t", "force": ["f"] })).unwrap();
    let read = |clock: &[f64]| {
        let pick = Pick::forces(&recorded, "recorded");
        with_clock(&pick, clock, &|n| n.to_string(), vec![vec![0.0; clock.len()]])
    };
    let without = |lost: std::ops::Range<usize>| -> Vec<f64> {
        (0..60).filter(|n| !lost.contains(n)).map(|n| 0.005 * n as f64).collect()
    };
    // Entries early or late by a fraction of a step.
    let jittered = |part: f64| -> Vec<f64> {
        without(0..0).iter().enumerate().map(|(n, t)| t + 0.005 * part * (2.4 * n as f64).sin()).collect()
    };
    let late = |by: f64| -> Vec<f64> {
        without(0..0).iter().enumerate().map(|(n, t)| if n == 20 { t + by } else { *t }).collect()
    };
    let fifths: Vec<f64> = (0..60).filter(|n| n % 5 != 3).map(f64::from).collect();
    for (clock, entry) in [
        (without(20..21), Some(20)),
        (without(20..30), Some(20)),
        (without(1..2), Some(1)),
        (without(58..59), Some(58)),
        (
            jittered(0.04).into_iter().enumerate().filter(|(n, _)| *n != 30).map(|(_, t)| t).collect(),
            Some(30),
        ),
        (
            jittered(0.4)
                .into_iter()
                .enumerate()
                .filter(|(n, _)| !(30..40).contains(n))
                .map(|(_, t)| t)
                .collect(),
            Some(30),
        ),
        (fifths, Some(3)),
        (without(0..0), None),
        (without(0..7), None),
        (jittered(0.04), None),
        (jittered(0.4), None),
        (late(0.004), None),
        (late(-0.004), None),
        (vec![0.0, 0.05, 0.2, 1.0], None),
        ((0..60).map(|n| 1.1f64.powi(n)).collect(), None),
    ] {
        let found = read(&clock).map(|_| ());
        let expected = match entry {
            None => found.is_ok(),
            Some(entry) => {
                found.as_ref().is_err_and(|e| e.starts_with(&format!("{entry} = ")) && e.contains("missing"))
            }
        };
        assert!(expected, "{entry:?}: {found:?}: {clock:?}");
    }
}

/// The digest depends on the contents only.
#[test]
fn what_the_files_hold_and_not_where_they_lie_makes_the_digest() {
    let (one, other) =
        (Folder::new(&[("a.csv", &csv(1.0))]), Folder::new(&[("b.csv", &csv(1.0)), ("c.csv", &csv(2.0))]));
    let of = |folder: &Folder, name: &str| {
        let recorded = serde_json::from_value(json!({ "files": [folder.0.path().join(name)] })).unwrap();
        digest(&recorded).unwrap()
    };
    assert_eq!(of(&one, "a.csv"), of(&other, "b.csv"));
    assert_ne!(of(&one, "a.csv"), of(&other, "c.csv"));
}

/// Each error names its key or file.
#[test]
fn what_is_no_record_is_refused_by_name() {
    let good = csv(1.0);
    let text = |from: &str, to: &str| String::from_utf8(good.clone()).unwrap().replace(from, to).into_bytes();
    let folder = Folder::new(&[
        ("good.csv", &good),
        ("back.csv", &text("2300,", "2200,")),
        ("nan.csv", &text("2400,500", "2400,nan")),
        ("wide.npy", &npy(&[3, 3, 4], &[1.0; 36])),
        ("deep.npy", &npy(&[1, 1, 1, 4], &[1.0; 4])),
        ("column.npy", &npy(&[30, 1, 1], &[1.0; 30])),
        ("fast.npy", &npy(&[3, 1, 4], &[1.0; 12])),
    ]);
    let keys: Value = serde_json::from_str(KEYS).unwrap();
    let with = |key: &str, value: Value| {
        let mut keys = keys.clone();
        keys[key] = value;
        keys
    };
    let thrice = ["good.csv"; 3];
    for (names, keys, said) in [
        (
            &["good.csv"; 2][..],
            keys.clone(),
            "stimuli.samples = 2: with stimuli.holdout = 1, 3 records are needed; the files contain 2",
        ),
        (&["none.csv"], keys.clone(), "none.csv\": cannot be read"),
        (
            &["back.csv"],
            keys.clone(),
            "back.csv\": line 5: time = 2200 must be later than the entry before, at 2200",
        ),
        (&["nan.csv"], keys.clone(), "nan.csv\": line 6: force = \"nan\": must be a finite number"),
        (&["wide.npy"], json!({ "rate": 10.0 }), "contains 3 forces per record; must be 1 or 2"),
        (&["deep.npy"], json!({ "rate": 10.0 }), "has shape [1, 1, 1, 4]"),
        (
            &["column.npy"],
            json!({ "rate": 10.0 }),
            "has shape [30, 1, 1]: read as (samples, signals, entries); transpose it",
        ),
        (
            &["fast.npy"],
            json!({ "rate": 1e300 }),
            "has a step of 1e-300 s, less than 1e-7 of a sample (time.duration = 1 s): check stimuli.recorded.rate",
        ),
        (
            &thrice,
            with("time_unit", json!("us")),
            "less than an instant of 0.1 s (time.duration = 1 s): check stimuli.recorded.time_unit",
        ),
        (
            &thrice,
            with("remove_offset", json!(false)),
            "has reached the trigger threshold of 0.5 N at its first entry: set remove_offset = true",
        ),
        (
            &thrice,
            with("augment", json!({ "scale": [0.0, 0.0] })),
            "stimuli.recorded.augment.scale = [0, 0]: would leave no force",
        ),
        (&thrice, with("force", json!(["F"])), "has no signal \"F\"; signals are time, force"),
        (&thrice, with("rate", json!(10.0)), "stimuli.recorded.rate = 10: set either time or rate"),
        (&thrice, with("trigger", json!({ "threshold": 9.0 })), "never reaches the trigger threshold of 9 N"),
        (
            &thrice,
            with("panels", json!([0, 1, 2])),
            "stimuli.recorded.panels = [0, 1, 2]: must name one of panels 0 to 1",
        ),
        (&thrice, with("scale", json!(0.0)), "stimuli.recorded.scale = 0: "),
        (
            &thrice,
            with("digest", json!("abc")),
            "stimuli.recorded.digest = abc: the contents of the files have changed",
        ),
        (&[], keys.clone(), "stimuli.recorded.files = []: must contain a file"),
    ] {
        let error = folder.read(names, keys).unwrap_err().to_string();
        assert!(error.contains(said), "{error}\n{said}");
    }
}

/// Rejects a pipe without a writer, an endless device and a folder, without waiting.
#[test]
fn what_is_no_ordinary_file_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe.csv");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
    assert!(made.success());
    for file in [&pipe, Path::new("/dev/zero"), folder.path()] {
        let Err(error) = open(file, &Form::default()) else { panic!("{} was read", file.display()) };
        assert!(error.contains("must be an ordinary file of at most 4 GiB"), "{error}");
    }
}
