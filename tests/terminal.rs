//! Output fits the terminal.

use std::process::{Command, Stdio};

use crate::common::{Bench, TINY};

/// Output on a terminal of this kind and width, with `COLUMNS` and `NO_COLOR` as given.
fn on_terminal(bench: &Bench, columns: u32, term: &str, more: &[(&str, &str)], args: &str) -> String {
    let program = env!("CARGO_BIN_EXE_metasense");
    let mut command = Command::new("script");
    command
        .args(["-qec", &format!("stty cols {columns}; exec {program} {args}"), "/dev/null"])
        .current_dir(bench.path(""))
        .env_remove("COLUMNS")
        .env_remove("NO_COLOR")
        .env("TERM", term)
        .env("CI", "true") // some programs take this for a terminal with colours
        .envs(more.iter().copied())
        .stdin(Stdio::null());
    String::from_utf8(command.output().unwrap().stdout).unwrap().replace('\r', "")
}

/// A database of two trials, whose complete table is about 500 characters wide.
fn done() -> Bench {
    let bench = Bench::new();
    bench.file("tiny.toml", TINY);
    bench.output(&["run", "tiny.toml", "--db", "s.sqlite"]);
    bench
}

/// Tables fit the terminal and do not split numbers. The default width is 80 columns; COLUMNS has precedence.
#[test]
fn tables_fit_the_terminal() {
    let bench = done();
    let values = bench.output(&["query", "s.sqlite", "SELECT * FROM v_trial", "--format", "table"]);
    let numbers: Vec<&str> = values.split_whitespace().filter(|word| word.parse::<f64>().is_ok()).collect();
    for (columns, asked, fits) in
        [(0, None, 80), (40, None, 40), (80, None, 80), (120, None, 120), (120, Some("60"), 60)]
    {
        let more: Vec<(&str, &str)> = asked.map(|asked| ("COLUMNS", asked)).into_iter().collect();
        for args in [
            "query s.sqlite 'SELECT * FROM v_trial'",
            "status s.sqlite",
            "expand tiny.toml",
            "query s.sqlite",
            "watch s.sqlite",
            "run --help",
        ] {
            let shown = on_terminal(&bench, columns, "dumb", &more, args);
            // the terminal wraps sentences
            let tables = |line: &&str| !line.contains(" of ") && !line.contains(" on one core");
            let widest = shown.lines().filter(tables).map(|line| line.chars().count()).max().unwrap();
            // the longest option has 52 characters
            let least = if args.ends_with("help") { 60 } else { 0 };
            assert!(widest <= fits.max(least), "{columns} {args}: {widest}\n{shown}");
            if args.contains("SELECT") {
                assert!(numbers.iter().all(|number| shown.contains(number)), "{columns}:\n{shown}");
            }
        }
    }
    // in a pipe, one line per row
    assert!(values.lines().count() == 4 && values.lines().all(|line| line.ends_with('|')), "{values}");
}

/// No cursor movement or colours on terminals that do not support them, or if NO_COLOR is set.
#[test]
fn a_dumb_terminal_gets_no_escapes() {
    let bench = done();
    for args in
        ["watch s.sqlite", "run tiny.toml --db new.sqlite", "--help", "run --help", "status none.sqlite"]
    {
        let _ = std::fs::remove_file(bench.path("new.sqlite"));
        let shown = on_terminal(&bench, 80, "dumb", &[], args);
        assert!(!shown.contains('\u{1b}') && shown.len() > 20, "{args}: {shown:?}");
    }
    assert!(on_terminal(&bench, 80, "xterm", &[], "watch s.sqlite").contains("\u{1b}[H"));
    assert!(!on_terminal(&bench, 80, "xterm", &[("NO_COLOR", "1")], "run --help").contains('\u{1b}'));
}
