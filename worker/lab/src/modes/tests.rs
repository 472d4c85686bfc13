use super::*;
use crate::operator::operator_figures;
use crate::replay::tests::small_trial_with;
use serde_json::json;

/// Small motions are undefined if a force drives a unit.
#[test]
fn a_driven_unit_is_refused() {
    let panels = json!([{ "base": 1e-5, "unit": 7, "direction": [1, 0] }]);
    let moved = small_trial_with("body", "panels", panels);
    let design = prepared(&moved).unwrap().initial;
    for refused in [slowest(&moved, &design, 3).err(), operator_figures(&moved, &design).err()] {
        assert!(refused.expect("driven").to_string().contains("body.panels: unit 7 is driven"));
    }
}
