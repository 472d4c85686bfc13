//! Tests of `trials`.

use super::*;
use serde_json::json;

fn trials() -> Trials {
    let mut settings = SharedSettings::default();
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
        Arc::new(TrialRow {
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
        // a key that a trial omits has its usual value
        ("brain.kind=cnn", "", "0123"),
        ("optimise.objective=nominal", "", "012"),
        ("optimise.objective.cvar>0.5", "", "3"),
        ("x>0.5", "", "23"),
        ("hash~3a", "", "3"),
        ("holdout_optimised<100", "", "02"),
        ("no.such.key>1", "", ""),
        // trials without an error come last in both directions
        ("", "holdout_optimised", "2013"),
        ("", "-holdout_optimised", "0213"),
    ] {
        assert_eq!(found(text, sort), expected, "{text} {sort}");
    }
    assert!(terms("M").is_err() && terms("=3").is_err() && terms("reason=\"took").is_err());
}

/// Only numbers are compared with numbers: as texts, all numbers are less than `two`.
#[test]
fn numbers_are_compared_with_numbers() {
    let trials = trials();
    for text in [
        "M<two",
        "M!=one",
        "holdout_optimised>20%",
        "x<1,5",
        "M<=nan",
        "M>-inf",
        "M>=",
        "M~1",
        "hash>1",
        "hash~",
    ] {
        let wrong = trials.chosen(&[text.to_owned()]).unwrap_err();
        assert!(wrong.contains(text), "{text}: {wrong}");
        assert_eq!(trials.asked(text, "").1, Some(wrong), "{text}");
    }
    let wrong = trials.asked("state!=doen", "").1.unwrap();
    assert_eq!(wrong, "no trial can be `doen`: the states are pending, running, done, failed");
    for text in ["M<2.5", "x=", "state=done", "state~do", "optimise.brain=linear", "reason!=7x", "reason="] {
        assert!(trials.asked(text, "").1.is_none(), "{text}");
    }
}

/// Integers are compared exactly.
#[test]
fn large_seeds_differ_by_one() {
    let mut settings = SharedSettings::default();
    let row = |seed: i64| TrialRow {
        hash: seed.to_string(),
        state: "done".into(),
        reason: String::new(),
        numbers: [f64::NAN; NUMBERS.len()],
        setting: settings.of(&json!({"body": {"design": {"random": seed}}})),
    };
    let rows = [9_007_199_254_740_992, 9_007_199_254_740_993].map(row).map(Arc::new).to_vec();
    let trials = Trials { rows, ..Trials::default() };
    let found = trials.chosen(&["body.design.random=9007199254740993".into()]).unwrap();
    assert_eq!(found.iter().map(|row| row.hash.as_str()).collect::<Vec<_>>(), ["9007199254740993"]);
}

/// Conditions that would select all trials by mistake are refused.
#[test]
fn nothing_is_chosen_by_accident() {
    let trials = trials();
    for text in [
        "M>",
        "M>=",
        "K!=",
        "M=",
        "reason~",
        "hash~",
        "hash!=",
        "reason=",
        "reason!=",
        "optimise.brain!=lineer",
        "M!=7",
    ] {
        assert!(trials.chosen(&[text.to_owned()]).is_err(), "{text}");
    }
    for (text, count) in [
        ("reason=\"\"", 4),
        ("holdout_optimised=\"\"", 2),
        ("optimise.brain!=linear", 2),
        ("M != 2", 3),
        ("reason=took too long", 0),
        ("reason=\"took too long\"", 0),
    ] {
        assert_eq!(trials.chosen(&[text.to_owned()]).map(|found| found.len()), Ok(count), "{text}");
    }
}
