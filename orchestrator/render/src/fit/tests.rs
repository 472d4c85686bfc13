//! Tests of `fit`.

use serde_json::{Value, json};

use super::super::row;
use super::*;

/// A table as wide as those of `expand`, `run` and `query`: long names, numbers, hashes, texts of several lines.
fn wide(rows: usize) -> Table {
    let columns = "hash state seed brain.kind holdout_error_initial holdout_error_optimised cost_seconds panel_units sensor_units \
                   nonlinear_acceleration_optimised over";
    let row = |i: usize| {
        row![
            format!("8e5398512060a36f867ebd40ec1c4ba{i}"),
            "done",
            i,
            if i > 1 { Value::Null } else { json!("linear") },
            12.345678 + i as f64,
            -1.234e-17,
            1234567.0,
            "31 34",
            "13 20",
            1e300,
            "no interval, too few units: 1 placement × 1 seed\nand another line of it"
        ]
    };
    Table::new(columns, (0..rows).map(row))
}

#[test]
fn every_width_shows_every_value_and_breaks_no_number() {
    for rows in [0, 1, 2, 7] {
        let table = wide(rows);
        let full = text(&table, None);
        assert_eq!(full, text(&table, Some(10_000)));
        for screen in [1, 20, 40, 60, 79, 80, 100, 120, 160, 200, 250, 300] {
            let shown = text(&table, Some(screen));
            let widest = shown.lines().map(width).max().unwrap();
            assert!(widest <= screen || screen < 40, "{screen}: {widest}\n{shown}");
            if screen < 40 {
                continue;
            }
            for row in &table.rows {
                for value in row.iter().filter(|value| value.is_number()) {
                    assert!(shown.contains(&rounded(value)), "{screen}: {value}\n{shown}");
                }
                for word in row.iter().filter_map(Value::as_str).flat_map(str::split_whitespace) {
                    assert!(shown.contains(word) || width(word) > screen - 2, "{screen}: {word}\n{shown}");
                }
            }
            for name in &table.columns {
                assert!(parts(name).all(|part| shown.contains(part)), "{screen}: {name}\n{shown}");
            }
        }
    }
}

#[test]
fn what_all_rows_share_stands_in_front_of_a_grid() {
    let columns = "placement brain holdout_error_initial holdout_error_optimised seconds";
    let table = Table::new(columns, (0..3).map(|i| row![0, "linear", 10.0 + f64::from(i), i, 2.5]));
    let shown = text(&table, Some(36));
    assert!(shown.starts_with("in all rows: placement = 0; brain =\nlinear; seconds = 2.500\n"), "{shown}");
    assert!(shown.lines().all(|line| width(line) <= 36) && shown.lines().count() <= 2 + 3 + 1 + 3, "{shown}");
    assert!(shown.ends_with(" 2") && shown.contains(" 12.00  "), "{shown}");
}

#[test]
fn long_words_are_parted_between_numbers() {
    let text = r#"a {"density":4e-8,"onset":[0.125,0.25],"samples":123456} b"#;
    for most in 17..60 {
        let lines = wrapped(text, most);
        assert!(lines.iter().all(|line| width(line) <= most), "{most}: {lines:?}");
        for number in ["4e-8", "0.125", "0.25", "123456"] {
            assert!(lines.iter().any(|line| line.contains(number)), "{most}: {lines:?}");
        }
    }
    assert_eq!(wrapped("abcdef g", 4), ["abcd", "ef g"]);
}

#[test]
fn texts_move_no_cursor() {
    let shown = text(&Table::new("a", [row!["\u{1b}[2J\tx\u{7}"]]), None);
    assert!(shown.chars().all(|c| c == '\n' || !c.is_control()) && shown.contains("u{1b}"), "{shown}");
}
