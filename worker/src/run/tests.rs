use super::*;
use metasense_numerics::brain::TrainOutcome;
use metasense_numerics::dynamics::Outcome;
use metasense_numerics::trial::Trouble;

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
        let failure = NoResult::from(trial::Failure::Stuck(3, *trouble));
        let NoResult::Numerical { cause, detail } = failure else { panic!("{failure:?}") };
        assert_eq!(cause.name(), trouble.name());
        assert!(detail.starts_with("3 consecutive steps were undone: "), "{detail}");
    }
    assert_eq!(all.len(), Cause::ALL.len());
    assert!(Cause::ALL.iter().all(|cause| Trouble::named(cause.name()).is_some()));
}
