//! `init`, `completions` and `man`: files for new users.

use crate::common::Bench;

/// Every template expands, has the name of its file, and overwrites nothing.
#[test]
fn every_template_is_a_spec_of_its_own_name() {
    let bench = Bench::new();
    for template in ["quickstart", "design-two-core", "families", "pressed", "real-scale"] {
        bench.output(&["init", template, "mine.toml"]);
        let text = std::fs::read_to_string(bench.path("mine.toml")).unwrap();
        assert!(text.starts_with("# ") && text.contains("\nname = \"mine\""), "{template}: {text}");
        assert!(bench.output(&["expand", "mine.toml", "--format", "csv"]).lines().count() > 1);
        let refused = bench.metasense(&["init", template, "mine.toml"]);
        let why = String::from_utf8_lossy(&refused.stderr);
        assert!(refused.status.code() == Some(2) && why.contains("mine.toml: exists already"), "{why}");
        assert_eq!(std::fs::read_to_string(bench.path("mine.toml")).unwrap(), text);
        std::fs::remove_file(bench.path("mine.toml")).unwrap();
    }
    bench.output(&["init"]);
    assert!(bench.path("quickstart.toml").exists());
    assert_eq!(bench.metasense(&["init", "quickstart", "a b.toml"]).status.code(), Some(2));
}

/// Completions and manual pages contain the commands of groups, but no hidden ones.
#[test]
fn completions_and_manual_pages_have_all_commands() {
    let bench = Bench::new();
    for shell in ["bash", "zsh", "fish"] {
        let script = bench.output(&["setup", "completions", shell]);
        assert!(script.contains("draw") && script.contains("retry-failed"), "{shell}: {script}");
    }
    bench.output(&["setup", "man", "man1"]);
    for page in ["metasense.1", "metasense-run.1", "metasense-body.1", "metasense-body-draw.1"] {
        assert!(bench.path("man1").join(page).exists(), "{page}");
    }
    assert!(!bench.path("man1/metasense-worker.1").exists());
}

/// A group without a command prints its help; an old command name is an error that gives the new one.
#[test]
fn groups_have_help_and_old_names_are_given_as_new_ones() {
    let bench = Bench::new();
    for call in [&["help", "body"][..], &["body", "--help"]] {
        let help = bench.output(call);
        assert!(help.contains("simulate") && help.contains("project"), "{help}");
    }
    let refused = bench.metasense(&["draw", "s.toml"]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        refused.status.code() == Some(2) && said.contains("`metasense draw` is now `metasense body draw`"),
        "{said}"
    );
}
