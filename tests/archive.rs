//! `archive` writes a folder from which its results can be reproduced.

use crate::common::{Bench, TINY};
use serde_json::Value;
use sha2::{Digest, Sha256};

/// The manifest contains every file with its digest, and the README's commands give the same bits.
#[test]
fn an_archive_runs_again_to_the_same_bits() {
    let bench = Bench::new();
    bench.file("s.toml", TINY);
    bench.output(&["run", "s.toml", "--db", "s.sqlite", "--simd", "baseline"]);
    bench.output(&["archive", "s.sqlite", "kept/tiny"]);
    let read = |name: &str| std::fs::read(bench.path(&format!("kept/tiny/{name}"))).unwrap();
    let manifest: Value = serde_json::from_slice(&read("ro-crate-metadata.json")).unwrap();
    let graph = manifest["@graph"].as_array().unwrap();
    let named =
        |id: &str| graph.iter().find(|entity| entity["@id"] == id).unwrap_or_else(|| panic!("no {id}"));
    let parts = named("./")["hasPart"].as_array().unwrap();
    for part in parts {
        let name = part["@id"].as_str().unwrap();
        let bytes = read(name);
        let digest: String = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let file = named(name);
        assert_eq!(
            (&file["sha256"], &file["contentSize"]),
            (&digest.into(), &bytes.len().to_string().into())
        );
    }
    for name in [
        "README.md",
        "report.html",
        "results.sqlite",
        "provenance.json",
        "results/tiny.toml",
        "results/trials.csv",
    ] {
        assert!(parts.iter().any(|part| part["@id"] == name), "{name}: {parts:?}");
    }
    assert_eq!(named("#run")["object"][0]["@id"], "results/tiny.toml");

    // another place that contains only the folder
    let readme = String::from_utf8(read("README.md")).unwrap();
    let commands: Vec<&str> = readme.lines().filter_map(|line| line.strip_prefix("    metasense ")).collect();
    assert_eq!(commands.len(), 2, "{readme}");
    let there = Bench::new();
    copy(&bench.path("kept/tiny"), &there.path(""));
    for line in commands {
        let ran = there.metasense(&line.split(' ').collect::<Vec<_>>());
        let said = String::from_utf8_lossy(&ran.stderr);
        assert!(
            ran.status.success() && (line.starts_with("run") || said.contains("with nothing new")),
            "{said}"
        );
    }

    // a changed digit is found
    let change = "UPDATE trial SET error_optimised = 1.001 * error_optimised";
    let changed = std::process::Command::new("python3")
        .args([
            "-c",
            "import sqlite3, sys; c = sqlite3.connect(sys.argv[1]); c.execute(sys.argv[2]); c.commit()",
        ])
        .arg(there.path("again.sqlite"))
        .arg(change)
        .status();
    if changed.is_ok_and(|status| status.success()) {
        let merge =
            there.metasense(&["cluster", "merge", "results.sqlite", "again.sqlite", "--out", "new.sqlite"]);
        assert_eq!(merge.status.code(), Some(1), "{}", String::from_utf8_lossy(&merge.stderr));
    }

    // no file is overwritten
    let refused = bench.metasense(&["archive", "s.sqlite", "kept/tiny"]);
    assert_eq!(refused.status.code(), Some(2));
}

fn copy(from: &std::path::Path, to: &std::path::Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().map(Result::unwrap) {
        let to = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copy(&entry.path(), &to),
            false => drop(std::fs::copy(entry.path(), to).unwrap()),
        }
    }
}
