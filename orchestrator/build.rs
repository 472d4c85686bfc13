//! Embeds a digest of the sources and the git revision in the program, which records both with every attempt.

#[path = "src/provenance/source.rs"]
mod source;

use std::path::Path;
use std::process::Command;

fn main() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    // Cargo rebuilds a release of this package after each commit; a debug build gets the new revision with the next source
    // change.
    let release = std::env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let commits = if release { source::moves_with_commits(&root) } else { Vec::new() };
    for path in source::PROGRAM.map(|path| root.join(path)).into_iter().chain(commits) {
        println!("cargo:rerun-if-changed={}", path.display());
    }
    for (name, digest) in [("CODE", source::digest(&root)), ("CODE_WITH_LAB", source::digest_with_lab(&root))]
    {
        let digest = digest.unwrap_or_else(|e| panic!("reading the sources: {e}"));
        println!("cargo:rustc-env=METASENSE_{name}={digest}");
    }
    if let Some(revision) = source::revision(&root) {
        println!("cargo:rustc-env=METASENSE_REVISION={revision}");
    }
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let version =
        Command::new(rustc).arg("--version").output().map(|output| output.stdout).unwrap_or_default();
    println!("cargo:rustc-env=METASENSE_RUSTC={}", String::from_utf8_lossy(&version).trim());
}
