//! Each form of export is read back by a reader that is not ours.

use std::path::Path;
use std::process::Command;

use crate::common::skip;
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
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(synthetic::fill(&db));
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
    assert_eq!(shape("forces.npy"), Some(vec![25, 4, 201]));
    assert_eq!(shape("w1_optimised.npy"), Some(vec![3, 6, 64]));
    assert_eq!(shape("scene.npy"), Some(vec![]));
    let csv = std::fs::read_to_string(file("t.csv")).unwrap();
    assert!(csv.starts_with("sample,set,time,force_0,") && csv.lines().count() == 1 + 25 * 200);
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
