mod campaigns;

use super::*;
use serde_json::json;

/// M = 1 … 4 in twelve placements at one seed, in the order of the plan. The error of the trained body depends on M, and a
/// little on the placement.
fn plan() -> Vec<Trial> {
    let of = |(placement, m): (u64, u64)| {
        let part = |seed: u64| 0.01 * ((7 * placement + 3 * m + seed) as f64).cos();
        let own = 1.0 + 0.03 * (placement as f64).sin();
        let error = [8.0, 4.0, 2.0, 2.0][m as usize - 1] * (own + part(0));
        let initial = 3.0 * [8.0, 4.0, 2.0, 2.0][m as usize - 1] * (own + part(5));
        let spec = json!({"point": {"panels": 4, "sensors": m, "placement": placement, "seed": 1}});
        Trial {
            setting: flatten(&spec).into_iter().collect(),
            panels: 4,
            sensors: m,
            cluster: Cluster { placement, seed: 1 },
            errors: [[None, Some(initial), None], [None, Some(error), None]],
            ..Trial::default()
        }
    };
    (0..12).flat_map(|placement| (1..=4).map(move |m| (placement, m))).map(of).collect()
}

fn until() -> Until {
    Until { paired: Some(0.3), within: Some(0.1), fewer: true, ..Until::default() }
}

/// A decision without earlier ones.
fn decide(until: &Until, trials: &[Trial], settled: &[bool], ahead: usize) -> Decision {
    super::decide(until, trials, settled, ahead, &mut KnownLooks::default())
}

/// Answers do not depend on other settled trials, their order, or earlier decisions. Looks stop at the first unit that is not
/// settled. Units with a failed trial are skipped.
#[test]
fn decisions_hang_on_leading_results_alone() {
    let trials = plan();
    let begin = decide(&until(), &trials, &[false; 48], 1);
    assert_eq!(begin.wanted, (0..16).collect::<Vec<_>>(), "four placements");
    assert!(!begin.is_settled());
    let known = |units: usize| -> Vec<bool> { (0..48).map(|i| i < 4 * units).collect() };
    let whole = decide(&until(), &trials, &known(12), 1);
    assert!(whole.is_settled(), "{whole:?}");
    let took: Vec<usize> = whole.standings.iter().map(|s| s.answer.unwrap().1).collect();
    let most = *took.iter().max().unwrap();
    assert!(most < 12 && whole.wanted == (0..4 * most).collect::<Vec<_>>(), "{whole:?}");
    assert_eq!(whole.standings[1].answer.unwrap().0, UntilAnswer::Sensors(Some(3.0)));
    let mut looks = KnownLooks::default();
    for units in 4..12 {
        let part = decide(&until(), &trials, &known(units), 1);
        assert_eq!(super::decide(&until(), &trials, &known(units), 1, &mut looks), part, "known bounds");
        for (part, whole) in part.standings.iter().zip(&whole.standings) {
            let due = whole.answer.filter(|(_, took)| *took <= units);
            assert_eq!(part.answer, due, "{units} units");
        }
    }
    // the third placement lacks a trial; then this trial has failed
    let mut gap = known(12);
    gap[9] = false;
    assert!(decide(&until(), &trials, &gap, 1).standings.iter().all(|s| s.answer.is_none()));
    let mut failed = trials.clone();
    failed[9].errors = Default::default();
    let passed_over = decide(&until(), &failed, &known(12), 1);
    assert!(passed_over.standings.iter().all(|s| s.answer.unwrap().1 > 4), "{passed_over:?}");
}

/// Three workers and one trial per unit: three units at a time.
#[test]
fn as_many_units_are_wanted_as_keep_workers_busy() {
    let trials: Vec<Trial> = plan().into_iter().filter(|t| t.sensors == 1).collect();
    let until = Until { paired: Some(1e-9), ..Until::default() };
    let settled: Vec<bool> = (0..12).map(|i| i < 5).collect();
    assert_eq!(decide(&until, &trials, &settled, 3).wanted, (0..8).collect::<Vec<_>>());
    assert_eq!(decide(&until, &trials, &[true; 12], 3).wanted.len(), 12);
}
