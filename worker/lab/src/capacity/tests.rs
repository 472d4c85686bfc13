use super::*;
use crate::prepare::prepared;
use crate::replay::tests::small_trial;
use serde_json::json;

/// A damped body on a clock of 400 Hz, with other values of some keys.
fn trial(changes: &[(&str, &str, serde_json::Value)]) -> TrialSpec {
    let mut trial = serde_json::to_value(small_trial()).unwrap();
    let damped = [("time", "samples", json!(120)), ("body", "damping_ratio", json!(0.2))];
    for (table, key, value) in damped.iter().chain(changes) {
        trial[table][key] = value.clone();
    }
    serde_json::from_value(trial).unwrap()
}

fn of(trial: &TrialSpec, threads: usize) -> Vec<Measure> {
    let design = prepared(trial).unwrap().initial;
    capacity(trial, &design, hold(trial).unwrap(), threads).unwrap()
}

/// The same bits with any number of threads. Capacities stay below the number of state variables; noise reduces them.
#[test]
fn a_body_has_capacities() {
    let quiet = trial(&[]);
    let found = of(&quiet, 1);
    assert_eq!(found, of(&quiet, 2));
    let [memory, _, _, total, two, _, ten] = &found[..] else { panic!("{found:?}") };
    let bound = 3.0 * hold(&quiet).unwrap().min(NODES) as f64;
    assert_eq!(total.bound, Some(bound));
    assert!(memory.value > 2.0 && total.value < bound, "{found:?}");
    assert!(two.value < 0.8 && two.value < ten.value, "{found:?}");
    let noisy = of(&trial(&[("sensors", "noise", json!(10.0))]), 1);
    assert!(noisy[3].value < 0.8 * total.value, "{noisy:?}");
}

/// Forces of some µN move a body linearly; large ones give it capacities of higher degree, at the cost of memory.
#[test]
fn large_motions_are_nonlinear() {
    let of = |most: f64| of(&trial(&[("stimuli", "amplitude", json!([most, most]))]), 2);
    let [linear, other] = [of(1e-6), of(0.5)];
    assert_eq!([1, 2].map(|i| linear[i].value), [0.0; 2], "{linear:?}");
    assert!(other[1].value > 0.5 && other[0].value < linear[0].value, "{other:?}");
}

/// All drives end within ± the largest force, and only the first panel moves.
#[test]
fn one_panel_is_driven() {
    let (inputs, forces) = drives(7, 0.4, 3, 4);
    assert_eq!((inputs.len(), forces.instants), (DRIVES * HOLDS, 4 * HOLDS));
    for (drive, own) in inputs.chunks_exact(HOLDS).enumerate() {
        let (first, others) = forces.sample(drive).split_at(forces.instants + 1);
        assert!(others.iter().all(|f| *f == 0.0) && first[0] == 0.0);
        assert!(first[1..].chunks_exact(4).zip(own).all(|(held, u)| held.iter().all(|f| *f == 0.4 * u)));
        assert!(own.iter().all(|u| u.abs() < 1.0) && own.iter().fold(0.0f64, |m, u| m.max(u.abs())) > 0.95);
    }
    let mut firsts: Vec<u64> = inputs.iter().map(|u| u.to_bits()).collect();
    firsts.sort_unstable();
    firsts.dedup();
    assert_eq!(firsts.len(), inputs.len(), "drives differ");
}
