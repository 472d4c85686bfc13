//! Tests of `trials`.

use super::*;
use serde_json::json;

fn trials() -> Trials {
    let mut settings = Settings::default();
    let row = |(i, state): (usize, &&str)| {
        let mut numbers = [f64::NAN; NUMBERS.len()];
        numbers[1] = (i + 1) as f64;
        numbers[6] = if *state == "done" { 10.0 / (i + 1) as f64 } else { f64::NAN };
        let brain = ["cnn", "linear"][i % 2];
        let mut spec = json!({"optimise": {"brain": brain}, "x": (i as f64 / 2.0)});
        if i == 3 {
            spec["optimise"]["objective"] = json!({"cvar": 0.9});
        }
        let setting = settings.of(&spec);
        Arc::new(Row {
            hash: format!("{i}abc"),
            state: (*state).into(),
            reason: String::new(),
            numbers,
            setting,
        })
    };
    let rows = ["done", "failed", "done", "pending"].iter().enumerate().map(row).collect();
    Trials { rows, ..Trials::default() }
}

fn found(text: &str, sort: &str) -> String {
    let (trials, terms) = (trials(), terms(text).unwrap());
    trials.found(&terms, sort).iter().map(|row| &row.hash[..1]).collect()
}

#[test]
fn terms_choose_and_keys_sort() {
    for (text, sort, expected) in [
        ("", "", "0123"),
        ("state=done", "", "02"),
        ("M>=2 M<4", "-M", "21"),
        ("optimise.brain=linear", "", "13"),
        ("optimise.brain!=linear", "-x", "20"),
        ("x=0.5", "", "1"),
        // what a trial leaves out is the usual
        ("brain.kind=cnn", "", "0123"),
        ("optimise.objective=nominal", "", "012"),
        ("optimise.objective.cvar>0.5", "", "3"),
        ("x>0.5", "", "23"),
        ("hash~3a", "", "3"),
        ("holdout_optimised<100", "", "02"),
        ("no.such.key>1", "", ""),
        // those without an error come last, either way
        ("", "holdout_optimised", "2013"),
        ("", "-holdout_optimised", "0213"),
    ] {
        assert_eq!(found(text, sort), expected, "{text} {sort}");
    }
    assert!(terms("M").is_err() && terms("=3").is_err());
}

/// What is compared with a number is one: as texts all numbers are less than `two`.
#[test]
fn numbers_are_compared_with_numbers() {
    let trials = trials();
    for text in ["M<two", "M!=one", "holdout_optimised>20%", "x<1,5"] {
        let wrong = trials.chosen(text).unwrap_err();
        assert!(wrong.contains("is a number, `"), "{text}: {wrong}");
        assert_eq!(trials.asked(text, "").1, Some(wrong), "{text}");
    }
    let wrong = trials.chosen("state!=doen").unwrap_err();
    assert_eq!(wrong, "no trial can be `doen`: state is pending, running, done, failed");
    for text in ["M<2.5", "M~1", "x=", "state=done", "state~do", "optimise.brain<d", "reason!=7x"] {
        assert!(trials.chosen(text).is_ok() && trials.asked(text, "").1.is_none(), "{text}");
    }
}
