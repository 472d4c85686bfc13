use serde_json::json;

use super::*;
use crate::questions::check::{ChannelFinding, RecordFinding};

fn history(dt: f64, values: Vec<Vec<f64>>) -> History {
    History { start: 0.0, dt, values }
}

/// Findings for one record of a force and three channels at 200 Hz, given its comparison with the model.
fn find(force: Vec<f64>, correlation: f64, gain: f64, aliased: Option<f64>) -> Vec<Finding> {
    let spec = serde_json::from_value(json!({ "recorded": { "files": [], "rate": 200.0 } })).unwrap();
    let described = Described { spec, records: Vec::new() };
    let signal: Vec<f64> = (0..force.len()).map(|n| if n < 20 { 0.0 } else { (n as f64).sin() }).collect();
    let signals = history(0.005, vec![signal; 3]);
    let record = CheckedRecord { force: history(0.005, vec![force]), panel: Some(0), signals };
    let looked = Looked {
        number: 0,
        place: "a.csv".into(),
        instruments: Instruments::of(&record),
        record,
        jitter: 0.0,
        clipped: [vec![0], vec![0; 3]],
    };
    let channel = ChannelFinding { correlation: [correlation; 2], gain, silent: false, aliased };
    let explanation = Explanation {
        stiffness: 1.0,
        correlation: [correlation; 2],
        panels: vec![0],
        lags: vec![0.0],
        source: (0..3).map(|c| (c, 1.0)).collect(),
        units: vec![None],
        channels: vec![channel; 3],
        records: vec![RecordFinding { correlation, lag: 0.0, panel: None, clock: None }],
        dt: 0.005,
        simulated: Vec::new(),
    };
    let channels = ["a_x", "a_y", "ω"].map(str::to_owned);
    findings::findings(&described, &channels, &[looked], Some(&explanation), &[0, 1, 2])
}

/// A blow of 0.4 N on this level.
fn blow(level: f64) -> Vec<f64> {
    let hump = |n: usize| 0.4 * (std::f64::consts::PI * (n - 20) as f64 / 20.0).sin();
    (0..200).map(|n| level + if (20..40).contains(&n) { hump(n) } else { 0.0 }).collect()
}

fn of<'a>(found: &'a [Finding], check: &str) -> Vec<&'a Finding> {
    found.iter().filter(|finding| finding.check == check).collect()
}

#[test]
fn an_offset_of_the_force_and_a_record_without_force_are_faults() {
    assert_eq!(of(&find(blow(0.0), 0.9, 1.0, None), "offset")[0].level, Severity::Ok);
    let found = find(blow(0.125), 0.9, 1.0, None);
    let [offset] = of(&found, "offset")[..] else { panic!("{found:?}") };
    assert!(offset.level == Severity::Fault && offset.place == "force 0", "{offset:?}");
    assert!(offset.found.contains("0.125 N") && offset.remedy.contains("remove_offset = true"), "{offset:?}");
    let found = find(vec![0.0; 200], 0.9, 1.0, None);
    let [none] = of(&found, "blow")[..] else { panic!("{found:?}") };
    assert!(none.level == Severity::Fault && none.found == "the force is 0 throughout", "{none:?}");
}

#[test]
fn units_are_proposed_only_if_they_explain_the_signals() {
    let found = find(blow(0.0), 0.9, 1e-3, None);
    assert_eq!(of(&found, "unit")[0].remedy, "set recorded.force_unit = \"mN\"");
    let found = find(blow(0.0), 0.05, 1e-3, None);
    assert!(of(&found, "unit").iter().all(|unit| unit.level == Severity::NotChecked), "{found:?}");
}

#[test]
fn a_check_that_is_not_made_is_not_ok() {
    let found = find(blow(0.0), 0.0, 0.0, Some(0.3));
    for check in ["unit", "clock", "panel", "axis", "sensor", "model"] {
        let [finding] = of(&found, check)[..] else { panic!("{check}: {found:?}") };
        assert!(finding.level.name() == "not checked" && finding.place == "a_x, a_y, ω", "{finding:?}");
    }
    for check in ["file", "blow", "range", "offset"] {
        assert_eq!(of(&found, check)[0].level, Severity::Ok, "{check}");
    }
}

/// Entries at rest repeat, too, but are not clipped.
#[test]
fn only_the_far_end_of_a_force_is_clipped() {
    let force = |n: usize| if (20..180).contains(&n) { (0.7 * n as f64).sin().abs() + 0.01 } else { 0.0 };
    let force: Vec<f64> = (0..200).map(force).collect();
    assert_eq!(clipped(&[&force[..]]), [0]);
    let force: Vec<f64> = force.iter().map(|f| f.min(0.5)).collect();
    assert!(clipped(&[&force[..]])[0] > 3);
}

/// A thinned history keeps its slow part.
#[test]
fn fast_readings_are_thinned_by_a_low_pass() {
    let tone = |hertz: f64, t: f64| (std::f64::consts::TAU * hertz * t).sin();
    let value = |n: usize| tone(20.0, n as f64 / 4000.0) + tone(1300.0, n as f64 / 4000.0);
    let fast = history(1.0 / 4000.0, vec![(0..=4000).map(value).collect()]);
    let thin = fast.thinned(0.0026);
    assert!(thin.entries() == 401 && (thin.dt - 0.0025).abs() < 1e-12, "{} {}", thin.entries(), thin.dt);
    let far = (50..350).map(|n| (thin.values[0][n] - tone(20.0, thin.time(n))).abs()).fold(0.0, f64::max);
    assert!(far < 0.01, "{far}");
    assert_eq!(thin.thinned(0.003), thin);
}
