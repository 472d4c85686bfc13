//! Records, and the effects of real sensors on signals, from the spec to a result.

use std::io::{Cursor, Read, Write};

use crate::common::Bench;

const SPEC: &str = r#"name = "measured"
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
[sensors]
delay = 0.004
[stimuli]
kind = "recorded"
samples = 9
test = 2
holdout = 3
force_samples = 160
[stimuli.recorded]
files = ["blows.npz"]
time = "time"
force = ["force"]
remove_offset = true
trigger = { threshold = 0.1 }
[brain]
iterations = 10
[optimise]
iterations = 2
batch = 4
[sweep]
panels = [2]
sensors = [1]
"sensors.noise" = [0.0, 0.1]
"#;

fn bench() -> Bench {
    let bench = Bench::new();
    std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/blows.npz"), bench.path("blows.npz"))
        .unwrap();
    bench.file("s.toml", SPEC);
    bench
}

/// Both trials use twelve blows at 2 kHz; noise changes the errors, and an export has forces and signals on one clock.
#[test]
fn recorded_blows_run_from_file_to_result() {
    let bench = bench();
    bench.output(&["run", "s.toml"]);
    let sql = "SELECT hash, holdout_error_initial, spec->>'$.stimuli.recorded.digest' AS digest FROM v_trial
        WHERE state = 'done' ORDER BY spec->>'$.sensors.noise'";
    let rows = bench.output(&["query", "results/measured.sqlite", sql, "--format", "csv"]);
    let rows: Vec<Vec<&str>> = rows.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 2, "{rows:?}");
    assert_eq!((rows[0][2], rows[0][2].len()), (rows[1][2], 32), "{rows:?}");
    let errors: Vec<f64> = rows.iter().map(|row| row[1].parse().unwrap()).collect();
    assert!(errors.iter().all(|e| *e > 0.0 && *e < 200.0) && errors[0] != errors[1], "{errors:?}");
    bench.output(&["export", "results/measured.sqlite", rows[0][0], "--format", "npz", "--out", "t.npz"]);
    let bytes = std::fs::read(bench.path("t.npz")).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.contains("(12, 2, 41") && text.contains("(12, 40, 3"), "shapes of forces and signals");
}

/// After it moved with its data, a sweep finds the data once it has been run there; nothing is repeated.
#[test]
fn a_sweep_may_move_with_its_data() {
    let bench = bench();
    std::fs::create_dir(bench.path("here")).unwrap();
    for file in ["blows.npz", "s.toml"] {
        std::fs::rename(bench.path(file), bench.path("here").join(file)).unwrap();
    }
    bench.output(&["run", "here/s.toml", "--db", "s.sqlite"]);
    let hash = bench.output(&["query", "s.sqlite", "SELECT hash FROM v_trial", "--format", "csv"]);
    let hash = hash.lines().nth(1).unwrap();
    let export = || bench.metasense(&["export", "s.sqlite", hash, "--format", "npz", "--out", "t.npz"]);
    std::fs::rename(bench.path("here"), bench.path("there")).unwrap();
    let output = export();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && said.contains("here/blows.npz"), "{said}");
    bench.output(&["run", "there/s.toml", "--db", "s.sqlite"]);
    assert!(export().status.success(), "{}", String::from_utf8_lossy(&export().stderr));
    let attempts =
        bench.output(&["query", "s.sqlite", "SELECT max(attempts) FROM v_trial", "--format", "csv"]);
    assert!(attempts.ends_with("1\n"), "{attempts}");
}

/// The contents of the records, not their path, determine the hash.
#[test]
fn the_content_of_the_records_and_not_their_path_names_a_trial() {
    let bench = bench();
    let hash = || -> String {
        let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
        csv.lines().nth(1).unwrap().split(',').next().unwrap().to_owned()
    };
    let first = hash();
    std::fs::create_dir(bench.path("data")).unwrap();
    std::fs::rename(bench.path("blows.npz"), bench.path("data/blows.npz")).unwrap();
    bench.file("s.toml", &SPEC.replace("blows.npz", "data/blows.npz"));
    assert_eq!(hash(), first);
    // One changed bit of a force: other records; the same in stored records: damage
    let bytes = std::fs::read(bench.path("data/blows.npz")).unwrap();
    let mut held = zip::ZipArchive::new(Cursor::new(&bytes[..])).unwrap();
    let mut changed = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for name in ["time.npy", "force.npy"] {
        let mut array = Vec::new();
        held.by_name(name).unwrap().read_to_end(&mut array).unwrap();
        let middle = array.len() / 2;
        array[middle] ^= u8::from(name == "force.npy");
        changed.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        changed.write_all(&array).unwrap();
    }
    std::fs::write(bench.path("data/blows.npz"), changed.finish().unwrap().into_inner()).unwrap();
    assert_ne!(hash(), first);
    let mut damaged = bytes;
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    std::fs::write(bench.path("data/blows.npz"), damaged).unwrap();
    let refused = bench.metasense(&["expand", "s.toml"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("force Invalid checksum"), "{said}");
}

/// Invalid records and sensors are refused with key and file.
#[test]
fn bad_records_and_sensors_are_refused() {
    let bench = bench();
    for (from, to, said) in [
        ("blows.npz", "none.npz", "s.toml:21: stimuli.recorded.files = \"none.npz\": cannot be read"),
        (
            "samples = 9",
            "samples = 10",
            "s.toml:16: stimuli.samples = 10: with stimuli.holdout = 3, 13 records are needed; the files contain 12",
        ),
        ("force = [\"force\"]", "force = [\"F\"]", "has no array \"F\"; arrays are force, time"),
        ("threshold = 0.1", "threshold = 50.0", "never reaches the trigger threshold of 50 N"),
        (
            "threshold = 0.1",
            "threshold = 0.1, before = 0.0",
            "stimuli.recorded.augment.shift = [-0.02, 0.02]: would cut off forces of 100 % of the peak at the beginning of record 0",
        ),
        (
            "threshold = 0.1",
            "threshold = 0.1, before = 0.17",
            "of the peak at the end of record 0: lengthen time.duration, or shift less",
        ),
        (
            "force_samples = 160",
            "force_samples = 100",
            "s.toml:19: stimuli.force_samples = 100: must be a multiple",
        ),
        (
            "force_samples = 160",
            "double = 0.5",
            "s.toml:19: stimuli.double = 0.5: has no effect on this stimuli.kind",
        ),
        ("delay = 0.004", "delay = -1.0", "s.toml:13: sensors.delay = -1: "),
        ("[0.0, 0.1]", "[0.0, -0.1]", "sensors.noise = [-0.1]: "),
        ("\"recorded\"", "\"irregular\"", "stimuli.recorded = { … }: has no effect"),
    ] {
        assert!(SPEC.contains(from), "{from}");
        bench.file("s.toml", &SPEC.replacen(from, to, 1));
        let output = bench.metasense(&["expand", "s.toml"]);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{to}: {errors}");
        assert!(errors.contains(said), "{errors}\n{said}");
    }
}

/// A blow at the very beginning of a sample is refused only where fresh samples would lose it. A spec with an explicit `before`
/// keeps its hash.
#[test]
fn a_trigger_without_room_is_for_blows_that_are_not_shifted() {
    let bench = bench();
    let spec = |before: &str, rest: &str| {
        let text = SPEC.replace("threshold = 0.1", &format!("threshold = 0.1{before}"));
        bench.file("s.toml", &text.replace("batch = 4", rest));
        let csv = bench.output(&["expand", "s.toml", "--format", "csv"]);
        csv.lines().nth(1).unwrap().split(',').next().unwrap().to_owned()
    };
    let paper = "protocol = \"paper\"";
    let of_old = spec(", before = 0.0", paper);
    // a fixed hash
    assert_eq!(of_old, "99420358c68b08e3cd1f1fa09158c6da");
    assert_ne!(spec("", paper), of_old);
    spec(", before = 0.0", "batch = 4\n[stimuli.recorded.augment]\nshift = [0.0, 0.02]");
}

/// Forces from three CSV files, with keys for what the files do not contain.
fn of_tables(bench: &Bench, keys: &str) {
    let (head, tail) = SPEC.split_once("files = ").unwrap();
    let (_, tail) = tail.split_once("remove_offset").unwrap();
    let files = "files = [\"a.csv\", \"b.csv\", \"c.csv\"]\n";
    let text = format!("{head}{files}{keys}\nremove_offset{tail}");
    let text = text.replace("samples = 9\ntest = 2\nholdout = 3", "samples = 2\ntest = 1\nholdout = 1");
    bench.file("t.toml", &text);
}

/// A blow of this size: 2000 lines per second for 0.2 s, each formatted by `write`.
fn blow(size: f64, write: impl Fn(f64, f64) -> String) -> String {
    (0..400).map(|n| write(f64::from(n) / 2000.0, if (150..160).contains(&n) { size } else { 0.0 })).collect()
}

/// A record is in the training or in the held-out set, whatever its name and format.
#[test]
fn the_same_forces_under_another_name_are_refused() {
    let bench = Bench::new();
    of_tables(&bench, "time = \"t\"\nforce = [\"f\"]");
    let comma = |t: f64, f: f64| format!("{t},{f}\n");
    for (name, size) in [("a.csv", 1.0), ("b.csv", 2.0), ("c.csv", 3.0)] {
        bench.file(name, &("t,f\n".to_owned() + &blow(size, comma)));
    }
    bench.output(&["expand", "t.toml"]);
    let german = |t: f64, f: f64| format!("{t};{f}\n").replace('.', ",");
    for copy in ["t,f\n".to_owned() + &blow(1.0, comma), "t;f\r\n".to_owned() + &blow(1.0, german)] {
        bench.file("c.csv", &copy);
        let refused = bench.metasense(&["expand", "t.toml"]);
        let said = String::from_utf8_lossy(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{said}");
        assert!(said.contains("t.toml:21: stimuli.recorded.files = ") && said.contains("c.csv"), "{said}");
    }
    // records without forces
    for name in ["a.csv", "b.csv", "c.csv"] {
        bench.file(name, &("t,f\n".to_owned() + &blow(0.0, comma)));
    }
    let text = std::fs::read_to_string(bench.path("t.toml")).unwrap();
    bench.file("t.toml", &text.replace("trigger = { threshold = 0.1 }\n", ""));
    let refused = bench.metasense(&["expand", "t.toml"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        refused.status.code() == Some(2)
            && said.contains("stimuli.recorded.force = [\"f\"]: is 0 in all records"),
        "{said}"
    );
}

/// A table without names is read if the spec permits, and gives the same forces; keys that do not fit any file are refused.
#[test]
fn a_table_without_names_needs_a_word() {
    let bench = Bench::new();
    for (name, size) in [("a.csv", 1.0), ("b.csv", 2.0), ("c.csv", 3.0)] {
        bench.file(name, &blow(size, |t, f| format!("{t}\t{f}\n").replace('.', ",")));
    }
    let expand = |keys: &str| {
        of_tables(&bench, keys);
        let output = bench.metasense(&["expand", "t.toml"]);
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, said) = expand("time = 0\nforce = [1]");
    assert!(code == Some(2) && said.contains("set stimuli.recorded.header = "), "{said}");
    for keys in ["header = false", "header = false\nseparator = \"tab\"\ndecimal = \",\""] {
        assert_eq!(expand(&format!("time = 0\nforce = [1]\n{keys}")).0, Some(0), "{keys}");
    }
    let (code, said) = expand("time = 0\nforce = [1]\nheader = false\ndecimal = \".\"");
    assert!(code == Some(2) && said.contains("a.csv") && said.contains("line 2: "), "{said}");
    let arrays = bench.path("blows.npz");
    std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/blows.npz"), arrays).unwrap();
    bench.file("s.toml", &SPEC.replace("remove_offset", "header = true\nremove_offset"));
    let refused = bench.metasense(&["expand", "s.toml"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && said.contains("stimuli.recorded.header"), "{said}");
}

/// `evaluate` and `identify` share a reader: a copy, a gap and a table without names are refused with the file.
#[test]
fn every_command_refuses_records_that_mislead() {
    let bench = Bench::new();
    bench.file(
        "s.toml",
        &SPEC
            .replace("[stimuli]\nkind = \"recorded\"", "[stimuli]\nkind = \"bell\"")
            .replace("delay = 0.004", "")
            .split("force_samples")
            .next()
            .unwrap()
            .to_owned()
            .replace("[stimuli]", "[sweep]\npanels = [1]\nsensors = [1]\n[stimuli]"),
    );
    let record = |size: f64, lost: std::ops::Range<usize>| -> String {
        let line = |n: usize| {
            let ring = size * (0.3 * n as f64).sin();
            let force = if n == 4 { size } else { 0.0 };
            format!("{},{force},{ring},{},{}\n", 0.005 * n as f64, -ring, 0.1 * ring)
        };
        "t,f,x,y,w\n".to_owned() + &(0..=40).filter(|n| !lost.contains(n)).map(line).collect::<String>()
    };
    bench.file("a.csv", &record(1.0, 0..0));
    bench.file("copy.csv", &record(1.0, 0..0));
    bench.file("gap.csv", &record(2.0, 20..28));
    bench.file("bare.csv", record(2.0, 0..0).split_once('\n').unwrap().1);
    let named = "time = \"t\"\nforce = [\"f\"]\n[signals]\nchannels = [\"x\", \"y\", \"w\"]\n";
    let numbered = "time = 0\nforce = [1]\n[signals]\nchannels = [2, 3, 4]\n";
    for (file, keys, said) in [
        ("copy.csv", named, "is the same record as"),
        ("gap.csv", named, "line 22: t = 0.14 "),
        ("bare.csv", numbered, "set recorded.header = "),
    ] {
        bench.file(
            "r.toml",
            &format!("[recorded]\nfiles = [\"a.csv\", \"{file}\"]\n{keys}")
                .replace("a.csv\", \"bare", "bare"),
        );
        for call in [
            &["lab", "evaluate", "s.toml", "--brain", "linear", "--records", "initial=r.toml"][..],
            &["lab", "identify", "s.toml", "--records", "r.toml"],
        ] {
            let refused = bench.metasense(call);
            let errors = String::from_utf8_lossy(&refused.stderr);
            assert_eq!(refused.status.code(), Some(2), "{call:?}: {errors}");
            assert!(
                errors.contains("r.toml:2: recorded.files = ")
                    && errors.contains(file)
                    && errors.contains(said),
                "{errors}\n{said}"
            );
        }
    }
}
