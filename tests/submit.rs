//! What is handed to a cluster's scheduler, to the letter; and that it is handed over.

mod common;

use std::os::unix::fs::PermissionsExt;
use std::process::Command;

use common::{Bench, SPEC};

/// Without the paths of this machine.
fn dry_run(bench: &Bench, arguments: &[&str]) -> String {
    bench.file("s.toml", SPEC);
    let text = bench.output(&[&["submit"], arguments, &["s.toml", "--dry-run"]].concat());
    let folder = bench.path("").canonicalize().unwrap();
    assert!(!bench.path("results").exists(), "a dry run writes nothing");
    text.replace(env!("CARGO_BIN_EXE_metasense"), "/opt/metasense")
        .replace(folder.to_str().unwrap(), "/home/user")
}

#[test]
fn scripts_for_slurm_are_readable() {
    let bench = Bench::new();
    insta::assert_snapshot!(dry_run(
        &bench,
        &["slurm", "--shards", "12", "--partition", "main", "--time", "1-12", "--cpus", "8"]
    ));
}

#[test]
fn scripts_for_hyperqueue_run_the_same_shard() {
    let bench = Bench::new();
    insta::assert_snapshot!(dry_run(&bench, &["hq", "--shards", "3"]));
}

/// A stand-in for `hq` writes down how it is called.
#[test]
fn hyperqueue_is_handed_shards_and_a_merge() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    let hq = bench.file("hq", "#!/bin/sh\necho \"$@\" >> calls\necho 7\n");
    std::fs::set_permissions(&hq, PermissionsExt::from_mode(0o755)).unwrap();
    let call = |arguments: &[&str]| {
        let path = format!("{}:{}", bench.path("").display(), std::env::var("PATH").unwrap());
        let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
        let output = command.args(arguments).current_dir(bench.path("")).env("PATH", path).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    call(&["submit", "hq", "s.toml", "--shards", "2", "--", "--pin", "taskset"]);
    let calls = std::fs::read_to_string(bench.path("calls")).unwrap();
    let calls: Vec<&str> = calls.lines().collect();
    assert!(
        calls[0].contains("--array 1-2 --cpus 4 --time-limit 14400s")
            && calls[0].contains("--pin taskset -- sh"),
        "{calls:?}"
    );
    assert!(calls[1].ends_with("merge.sh 7"), "{calls:?}");
    let again = bench.metasense(&["submit", "hq", "s.toml", "--shards", "3"]);
    let said = String::from_utf8_lossy(&again.stderr).into_owned();
    assert!(again.status.code() == Some(2) && said.contains("holds shards of 2"), "{said}");
    let status = call(&["status", "--cluster"]);
    assert!(status.contains("0 of 2 shards complete"), "{status}");
}
