use super::*;
use crate::problem::tests::trial;
use metasense_numerics::brain::TrainOutcome;
use metasense_numerics::dynamics::Outcome;
use metasense_numerics::trial::Trouble;
use serde_json::json;

/// Every failure that ends a trial has its own name in the database, and every name maps back to a failure.
#[test]
fn every_trouble_is_a_cause_of_its_own() {
    let simulations = Outcome::ALL.into_iter().filter(|o| *o != Outcome::Ok).map(Trouble::Simulation);
    let trainings = [TrainOutcome::NonFinite, TrainOutcome::Diverged, TrainOutcome::DeadLayer(1)];
    let others = [
        Trouble::LossJump(2.0),
        Trouble::GradientNonFinite,
        Trouble::Singular,
        Trouble::Nowhere,
        Trouble::Saturated,
    ];
    let all: Vec<Trouble> = simulations.chain(trainings.map(Trouble::Training)).chain(others).collect();
    for trouble in &all {
        let failure = Failure::from(trial::Failure::Stuck(3, *trouble));
        let Failure::Numerical { cause, detail } = failure else { panic!("{failure:?}") };
        assert_eq!(cause.name(), trouble.name());
        assert!(detail.starts_with("3 consecutive steps were undone: "), "{detail}");
    }
    assert_eq!(all.len(), Cause::ALL.len());
    assert!(Cause::ALL.iter().all(|cause| Trouble::named(cause.name()).is_some()));
}

/// Without limits a design may invert a unit. With given masses this design is valid, otherwise it is rejected.
#[test]
fn a_unit_that_is_turned_over_needs_a_given_mass() {
    let own = trial(&[("feasible.limits", json!(false))]);
    let given = trial(&[("feasible.limits", json!(false)), ("body.inertia", json!("initial"))]);
    let problem = prepared(&own).unwrap();
    let (layout, unit) = (&problem.scene.layout, 14);
    let mut design = problem.initial.clone();
    for (base, group) in layout.shape[unit].iter().zip(&layout.groups[unit]) {
        design[2 * group.unwrap()] -= 2.0 * layout.half * base[0];
    }
    assert!(problem.scene.geometry(&design).area[unit] < 0.0);
    assert!(with_design(&given, &design).is_ok());
    let Err(Failure::Rejected(why)) = with_design(&own, &design) else { panic!("it was taken") };
    assert!(why.contains("unit 14 "), "{why}");
}
