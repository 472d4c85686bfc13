//! Skipped tests are listed in a file that `.ci/run` names.

use std::io::Write;

/// Records that a test, or a part of it, was skipped, and why.
pub fn skipped(what: &str, why: &str) {
    eprintln!("{what} is skipped: {why}");
    let Some(path) = std::env::var_os("METASENSE_SKIPPED") else { return };
    let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
    // One write, because other tests append at the same time.
    file.and_then(|mut file| file.write_all(format!("{what}: {why}\n").as_bytes()))
        .expect("the list of skipped tests");
}
