//! Each form of export is read back by a reader that is not ours.

use std::path::Path;
use std::process::Command;

use crate::common::{Bench, TINY, skip};
use crate::synthetic;
use metasense_worker::files::content;

fn export(db: &Path, what: &str, format: &str, out: &Path) {
    let run = Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args(["export", db.to_str().unwrap(), what, "--format", format, "--out", out.to_str().unwrap()])
        .output()
        .unwrap();
    assert!(run.status.success(), "{what} {format}: {}", String::from_utf8_lossy(&run.stderr));
}

/// numpy, pyarrow, ezdxf and trimesh where Python has them; the arrays by npyz wherever the test runs.
#[test]
fn what_is_exported_is_read_back_by_others() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("synthetic.sqlite");
    synthetic::write(&db);
    // The second trial: K = 4, M = 2, 8 × 6 units.
    let trial = format!("{:032x}", 1);
    let file = |name: &str| folder.path().join(name);
    for format in ["npz", "csv", "parquet", "svg", "dxf", "stl"] {
        export(&db, &trial, format, &file(&format!("t.{format}")));
    }
    export(&db, "v_trial", "parquet", &file("v.parquet"));
    let asked = Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args(["query", db.to_str().unwrap(), "SELECT * FROM v_trial", "--format", "parquet"])
        .output()
        .unwrap();
    assert!(asked.stdout == std::fs::read(file("v.parquet")).unwrap(), "query and export differ");

    // More rows than a group holds, and a column that turns out to be one of texts.
    let many = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 150000)
        SELECT i, 0.5 * i AS half, CASE i WHEN 150000 THEN 'much' ELSE i END AS either, NULL AS none FROM n";
    let asked = Command::new(env!("CARGO_BIN_EXE_metasense"))
        .args(["query", db.to_str().unwrap(), many, "--format", "parquet", "--out"])
        .arg(file("many.parquet"))
        .status()
        .unwrap();
    assert!(asked.success());

    let arrays = npz_arrays(&std::fs::read(file("t.npz")).unwrap());
    let shape = |name: &str| arrays.iter().find(|a| a.0 == name).map(|a| a.1.clone());
    assert_eq!(shape("forces.npy"), Some(vec![25, 4, 41]));
    assert_eq!(shape("w1_optimised.npy"), Some(vec![3, 6, 64]));
    assert_eq!(shape("scene.npy"), Some(vec![]));
    let csv = std::fs::read_to_string(file("t.csv")).unwrap();
    assert!(csv.starts_with("sample,set,time,force_0,") && csv.lines().count() == 1 + 25 * 40);
    assert!(std::fs::read_to_string(file("t.svg")).unwrap().starts_with("<svg xmlns"));

    let test = "what_is_exported_is_read_back_by_others";
    match Command::new("python3").args(["-c", "import numpy"]).output() {
        Ok(run) if run.status.success() => {}
        _ => return skip::skipped(test, "there is no Python with numpy"),
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/readback.py");
    let run = Command::new("python3").arg(script).arg(folder.path()).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let readers = String::from_utf8_lossy(&run.stdout);
    let ours = |name: &str| content(Path::new(name), &std::fs::read(file(name)).unwrap()).unwrap();
    assert!(ours("t.npz") == ours("packed.npz"), "what numpy.savez_compressed wrote reads otherwise");
    for reader in ["numpy", "pyarrow", "ezdxf", "trimesh"] {
        if !readers.lines().any(|line| line == reader) {
            skip::skipped(test, &format!("there is no {reader}"));
        }
    }
}

/// Names and shapes of the arrays of an archive.
fn npz_arrays(bytes: &[u8]) -> Vec<(String, Vec<u64>)> {
    let mut zip = zip::ZipArchive::new(std::io::Cursor::new(bytes)).unwrap();
    let files = zip.len();
    let mut array = |i: usize| {
        let file = zip.by_index(i).unwrap();
        let name = file.name().unwrap().into_owned();
        (name, npyz::NpyFile::new(file).unwrap().shape().to_vec())
    };
    (0..files).map(&mut array).collect()
}

/// Compiles an exported brain with its test, with nothing to warn of, and runs it: whether it says what the trial's brain says.
fn holds(source: &str, folder: &Path) -> (bool, String) {
    let (file, program) = (folder.join("brain.c"), folder.join("brain"));
    std::fs::write(&file, source).unwrap();
    let compiler = Command::new("cc")
        .args(["-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror", "-DBRAIN_TEST"])
        .args([&file, Path::new("-o"), &program])
        .output()
        .unwrap();
    assert!(compiler.status.success(), "{}", String::from_utf8_lossy(&compiler.stderr));
    let run = Command::new(&program).output().unwrap();
    (run.status.success(), String::from_utf8(run.stdout).unwrap())
}

/// A linear brain with a memory, the paper's network, and one that is dilated and looks back alone, as C: each says what it said in the
/// trial, reading by reading, to a few parts in 10⁵; with another bias its own test fails; what is neither is refused.
#[test]
fn a_brain_in_c_says_what_it_said_in_the_trial() {
    let bench = Bench::new();
    let kinds = "points = [
        { \"brain.kind\" = \"linear\", \"brain.memory\" = [0.1, 0.03] },
        { \"brain.kind\" = \"cnn\" },
        { \"brain.kind\" = \"cnn\", \"brain.kernels\" = [2, 3, 2], \"brain.dilations\" = [1, 2, 4], \"brain.causal\" = true },
        { \"brain.kind\" = \"stacked\" },
    ]\n";
    bench.file("s.toml", &(TINY.replace("sensors = [1, 2]", "sensors = [1]") + kinds));
    bench.output(&["run", "s.toml", "--workers", "2"]);
    let delays =
        bench.output(&["query", "results/tiny.sqlite", "SELECT hash, brain FROM v_trial", "--format", "csv"]);
    let mut found = Vec::new();
    for (hash, kind) in delays.lines().skip(1).map(|line| line.split_once(',').unwrap()) {
        let call = ["export", "results/tiny.sqlite", hash, "--format", "c", "--out", "b.c"];
        if kind == "stacked" {
            let refused = bench.metasense(&call);
            let said = String::from_utf8_lossy(&refused.stderr);
            assert!(
                refused.status.code() == Some(2) && said.contains("linear brains and networks"),
                "{said}"
            );
            continue;
        }
        bench.output(&call);
        let source = std::fs::read_to_string(bench.path("b.c")).unwrap();
        let (good, said) = holds(&source, &bench.path(""));
        assert!(good, "{kind}: {said}");
        let numbers: Vec<f64> = said.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        assert!(numbers[0] < 0.05 * numbers[1], "{kind}: {said}");
        let delay = source.lines().find_map(|line| line.strip_prefix("#define BRAIN_DELAY ")).unwrap();
        found.push((kind.to_owned(), delay.parse::<usize>().unwrap()));
        let last = source.split("#ifdef").next().unwrap().rfind("static const float B").unwrap();
        let begin = last + source[last..].find("{\n    ").unwrap() + 6;
        let end = begin + source[begin..].find('f').unwrap();
        let other = format!("{}7e0{}", &source[..begin], &source[end..]);
        assert!(!holds(&other, &bench.path("")).0, "{kind} with another bias");
    }
    found.sort();
    assert_eq!(found, [("cnn".into(), 0), ("cnn".into(), 2), ("linear".into(), 3)]);
}
