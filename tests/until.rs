//! A sweep with [until] ends when its questions are settled, and its decisions follow from the stored results.

use crate::common::{Bench, TINY};

/// The sweep of two trials with eight placements.
fn spec(until: &str) -> String {
    TINY.to_owned() + "\n[until]\nat_most = { placements = 8 }\n" + until
}

fn trials(bench: &Bench) -> String {
    bench.output(&[
        "query",
        "results/tiny.sqlite",
        "SELECT hash, state, holdout_error_optimised FROM v_trial ORDER BY hash",
        "--format",
        "csv",
    ])
}

/// A very wide interval of a ratio is settled by the four placements that an interval needs; an unreachable width takes all eight,
/// and is reported. A second call runs nothing; one worker runs the same trials as two.
#[test]
fn a_sweep_ends_when_it_knows_or_has_run_what_it_may() {
    let bench = Bench::new();
    bench.file("s.toml", &spec("paired = 1e6\n"));
    let said = |args: &[&str]| {
        let out = bench.metasense(args);
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        String::from_utf8(out.stderr).unwrap()
    };
    let first = said(&["run", "s.toml", "--workers", "2"]);
    assert!(
        first.contains("gain to a relative width of 1000000 (K = 2), answered after 4 of 8 placements: "),
        "{first}"
    );
    let four = trials(&bench);
    assert_eq!(four.lines().count(), 1 + 2 * 4, "{four}");
    let again = said(&["run", "s.toml"]);
    assert!(
        again.contains("answered after 4 of 8") && again.contains("nothing left to do: 8 trials settled"),
        "{again}"
    );
    assert_eq!(trials(&bench), four);
    for asks in [&["analyse"][..], &["analyse", "--question", "claims"]] {
        let told = said(&[asks, &["results/tiny.sqlite"]].concat());
        assert!(told.contains("[until]") && told.contains("lower than stated"), "{told}");
    }

    bench.file("s.toml", &spec("paired = 1e-9\n"));
    let all = said(&["run", "s.toml", "--workers", "1"]);
    assert!(
        all.contains("open after 8 of 8 placements") && all.contains("some questions are still open"),
        "{all}"
    );
    assert_eq!(trials(&bench).lines().count(), 1 + 2 * 8);

    let other = Bench::new();
    other.file("s.toml", &spec("paired = 1e6\n"));
    assert!(other.metasense(&["run", "s.toml", "--workers", "1"]).status.success());
    assert_eq!(trials(&other), four);
}

/// With rounds of shards the sweep is the same; a single shard cannot decide and is refused.
#[test]
fn shards_end_when_one_run_does() {
    let bench = Bench::new();
    bench.file("s.toml", &spec("paired = 1e6\n"));
    bench.output(&["run", "s.toml", "--workers", "2"]);
    let whole = trials(&bench);
    std::fs::remove_file(bench.path("results/tiny.sqlite")).unwrap();
    let submit = || {
        let out = bench.metasense(&["cluster", "submit", "local", "s.toml", "--cpus", "1", "--at-most", "2"]);
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        String::from_utf8(out.stderr).unwrap()
    };
    let said = submit();
    assert!(
        said.contains("8 trials in shards 1-2") && said.contains("answered after 4 of 8 placements"),
        "{said}"
    );
    assert_eq!(trials(&bench), whole);
    let again = submit();
    assert!(
        again.contains("nothing left to do: 8 trials settled") && !again.contains("starts on"),
        "{again}"
    );
    let refused = bench.metasense(&["cluster", "submit", "local", "s.toml", "--retry-failed"]);
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
    let shard = bench.metasense(&["run", "s.toml", "--shard", "1/2"]);
    let said = String::from_utf8(shard.stderr).unwrap();
    assert!(
        shard.status.code() == Some(2) && said.contains("until: needs all results in one database"),
        "{said}"
    );
}

/// Nothing starts after the limit of CPU hours.
#[test]
fn hours_are_kept_to() {
    let bench = Bench::new();
    bench.file(
        "s.toml",
        &(TINY.to_owned() + "[until]\npaired = 1e-9\nat_most = { seeds = 8, hours = 1e-9 }\n"),
    );
    let out = bench.metasense(&["run", "s.toml", "--workers", "1"]);
    let said = String::from_utf8(out.stderr).unwrap();
    assert!(
        said.contains("open after 4 of 8 seeds") && said.contains("some questions are still open"),
        "{said}"
    );
    assert_eq!(trials(&bench).lines().count(), 1 + 2 * 4);
}
