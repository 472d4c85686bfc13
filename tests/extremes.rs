//! Every number of a spec at its extremes: it is refused with its key, or gives a plan that this machine can hold. Nothing panics,
//! overflows or allocates too much.

use std::collections::BTreeSet;

use crate::common::{Bench, TINY};
use metasense::plan::Plan;
use metasense_lab::cost;
use metasense_source::{Source, spec_schema};
use serde_json::Value;

/// Keys of numbers in the schema of a spec, with the number of entries of a list, and whether the numbers are integers.
fn numbers(node: &Value, root: &Value, path: &str, found: &mut BTreeSet<(String, usize, bool)>) {
    if let Some(name) = node["$ref"].as_str() {
        return numbers(&root["$defs"][name.trim_start_matches("#/$defs/")], root, path, found);
    }
    for alternatives in ["anyOf", "oneOf", "allOf"].map(|of| node[of].as_array()).into_iter().flatten() {
        alternatives.iter().for_each(|node| numbers(node, root, path, found));
    }
    for (name, inner) in node["properties"].as_object().into_iter().flatten() {
        let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
        numbers(inner, root, &path, found);
    }
    let has = |node: &Value, name: &str| {
        let kinds = node["type"].as_array().cloned().unwrap_or_else(|| vec![node["type"].clone()]);
        kinds.iter().any(|kind| kind == name)
    };
    for (name, whole) in [("integer", true), ("number", false)] {
        if has(node, name) {
            found.insert((path.to_owned(), 0, whole));
        } else if has(&node["items"], name) {
            found.insert((path.to_owned(), node["minItems"].as_u64().unwrap_or(1) as usize, whole));
        }
    }
}

/// Optional tables of a spec, each complete except for one key.
const TABLES: &[(&str, &str)] = &[
    ("body.contact", "body.contact={ cutoff_angle = 5.0, stiffness = 1.0 }"),
    ("variation", "variation.stretch=0.05"),
    ("variation.relaxation", "variation.relaxation={ share = 0.1, time = 0.02 }"),
    ("variation.nodes", "variation.nodes={ scatter = 0.1, correlation = 20.0 }"),
    ("optimise.coarse", "optimise.coarse={ tolerance = 0.01 }"),
    ("optimise.casts", "optimise.objective=\"mean\""),
    ("until", "until.elbow=true"),
    ("goal", "goal={ error = 20.0 }"),
];

const VALUES: [&str; 7] = ["0", "1", "-1", "2147483648", "9223372036854775807", "1e-300", "1e300"];

/// Numbers without an upper limit: seeds, limits that nothing reaches, and counts that are capped at what there is.
const UNLIMITED: &[&str] = &[
    "body.design.random",
    "evaluation.batch",
    "goal.operations",
    "run.memory",
    "sensors.relative_to.random",
];

#[test]
fn every_number_of_a_spec_is_refused_or_can_be_held() {
    let schema = spec_schema();
    let mut found = BTreeSet::new();
    numbers(&schema, &schema, "", &mut found);
    assert!(found.len() > 150, "{found:?}");
    let mut accepted = BTreeSet::new();
    for (key, count, whole) in &found {
        for value in VALUES {
            let value =
                if *count > 0 { format!("[{}]", [value].repeat(*count).join(", ")) } else { value.into() };
            let needed =
                |(table, set): &&(&str, &str)| key.starts_with(table) && !set.starts_with(&format!("{key}="));
            let tables = TABLES.iter().filter(needed).map(|(_, table)| (*table).into());
            let changes: Vec<String> = tables.chain([format!("{key}={value}")]).collect();
            let plan = Source::spec("s.toml", TINY.into(), &changes).and_then(Plan::of);
            match plan.and_then(|plan| plan.check_memory().map(|()| plan)) {
                Ok(plan) => {
                    assert!(cost::total(&plan.trials).is_finite(), "{key} = {value}");
                    if *whole && value.contains("9223372036854775807") {
                        accepted.insert(key.as_str());
                    }
                }
                Err(e) => assert!(!e.key.is_empty() || e.what.contains("TOML"), "{key} = {value}: {e}"),
            }
        }
    }
    assert_eq!(accepted.into_iter().collect::<Vec<_>>(), UNLIMITED);
}

/// A trial that no machine can hold is refused before any command starts it.
#[test]
fn a_trial_that_no_memory_holds_is_refused_before_it_starts() {
    let bench = Bench::new();
    bench.file("s.toml", TINY);
    let many = ["stimuli.samples=1000000", "time.samples=100000"];
    for command in ["expand", "run", "trial", "body place", "body bound"] {
        let output = bench.metasense(&[command.split(' ').collect(), vec!["s.toml"], many.to_vec()].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{command}: {said}");
        assert!(said.contains("stimuli.samples = 1000000") && said.contains("TB"), "{command}: {said}");
    }
    assert!(!bench.path("results/tiny.sqlite").exists());
}
