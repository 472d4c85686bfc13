//! Randomly damaged specs: no panic, and each error names a key or states that the file is not TOML.

use crate::common::SPEC;
use crate::common::roll;
use metasense::plan::Plan;
use proptest::prelude::*;

/// Further keys, so that every table can be damaged.
const REST: &str = r#"placements = 2
seeds = [1, 2]
"body.stiffness.bend" = [1.0, 2.0]
exclude = [{ sensors = 2, seed = 1 }]
[time]
duration = 1.0
samples = 20
[solver]
method = "tsit5"
tolerance = 1e-6
[sensors]
frame = "body"
[brain]
iterations = 10
learning_rate = 1e-2
preset = "long"
width = 8
kernels = [3, 2, 1]
dilations = [1, 4, 1]
causal = true
[optimise]
protocol = "paper"
iterations = 2
learning_rate = 0.1
gradient = "direct"
[evaluation]
seeds = 1
schedule = "constant"
[feasible]
min_edge = 3.0
clearance = 1.0
[run]
workers = 2
"#;

const VALUES: &[&str] = &[
    "0",
    "1",
    "-1",
    "2",
    "7",
    "18446744073709551616",
    "9223372036854775807",
    "-9223372036854775808",
    "1e308",
    "-1e308",
    "1e-320",
    "nan",
    "-inf",
    "0.0",
    "-0.0",
    "true",
    "\"\"",
    "\"bottom\"",
    "\"circular\"",
    "[]",
    "[0]",
    "[1, 2]",
    "[0.5, 0.1]",
    "[-1.0, nan]",
    "[[]]",
    "[[14], [14, 20]]",
    "{}",
    "{ stretch = 1.0 }",
    "1979-05-27",
    "[\"a\"]",
    "",
];

/// One damage: the line, the kind, and what is inserted.
#[derive(Debug, Clone)]
enum Damage {
    Value(usize, usize),
    Delete(usize),
    Duplicate(usize),
    Insert(usize, String),
    Swap(usize, usize),
}

fn damage() -> impl Strategy<Value = Damage> {
    let line = 0usize..50;
    prop_oneof![
        8 => (line.clone(), 0..VALUES.len()).prop_map(|(l, v)| Damage::Value(l, v)),
        1 => line.clone().prop_map(Damage::Delete),
        1 => line.clone().prop_map(Damage::Duplicate),
        2 => (line.clone(), "[a-z\"\\.\\[\\]{}= 0-9é,#'-]{0,24}").prop_map(|(l, text)| Damage::Insert(l, text)),
        1 => (line.clone(), line).prop_map(|(a, b)| Damage::Swap(a, b)),
    ]
}

fn damaged(damages: &[Damage]) -> String {
    let mut lines: Vec<String> = SPEC.lines().chain(REST.lines()).map(String::from).collect();
    for damage in damages {
        let n = lines.len();
        match damage {
            Damage::Value(line, value) => {
                let line = &mut lines[line % n];
                if let Some((key, _)) = line.split_once('=') {
                    *line = format!("{key}= {}", VALUES[*value]);
                }
            }
            Damage::Delete(line) => {
                lines.remove(line % n);
            }
            Damage::Duplicate(line) => {
                let copy = lines[line % n].clone();
                lines.insert(line % n, copy);
            }
            Damage::Insert(line, text) => lines.insert(line % n, text.clone()),
            Damage::Swap(a, b) => lines.swap(a % n, b % n),
        }
    }
    lines.join("\n")
}

#[test]
fn the_undamaged_spec_expands() {
    assert_eq!(Plan::new("f.toml", damaged(&[])).unwrap().trials.len(), 12);
}

/// A thousand specs, or `SPEC_CASES`.
fn config() -> ProptestConfig {
    let cases = roll::number("SPEC_CASES").unwrap_or(1000) as u32;
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(config())]
    #[test]
    fn damaged_specs_expand_or_are_refused_by_key(damages in prop::collection::vec(damage(), 1..4)) {
        let text = damaged(&damages);
        match Plan::new("f.toml", text.clone()) {
            Ok(plan) => prop_assert!(!plan.trials.is_empty()),
            Err(e) => {
                prop_assert!((1..=text.lines().count().max(1)).contains(&e.line), "{e}\n{text}");
                let no_toml = e.what.starts_with("not valid TOML");
                let by_key = !e.key.is_empty() && e.what.starts_with(&e.key);
                prop_assert!(no_toml || by_key, "{e}\n{text}");
            }
        }
    }
}
