use super::*;
use crate::replay::tests::small_trial_with;
use serde_json::json;

/// Without limits a design may invert a unit. With given masses this design is valid, otherwise it is rejected.
#[test]
fn a_unit_that_is_turned_over_needs_a_given_mass() {
    let own = small_trial_with("feasible", "limits", json!(false));
    let mut given = small_trial_with("body", "inertia", json!("initial"));
    given.feasible = own.feasible;
    let problem = prepared(&own).unwrap();
    let (layout, unit) = (&problem.scene.layout, 4);
    let mut design = problem.initial.clone();
    for (base, group) in layout.shape[unit].iter().zip(&layout.groups.of_nodes[unit]) {
        design[2 * group.unwrap()] -= 2.0 * layout.half() * base[0];
    }
    assert!(problem.scene.geometry(&design).area[unit] < 0.0);
    assert!(with_design(&given, &design).is_ok());
    let Err(NoResult::Rejected(why)) = with_design(&own, &design) else { panic!("it was taken") };
    assert!(why.contains("unit 4 "), "{why}");
}
