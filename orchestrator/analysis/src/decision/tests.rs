use super::*;
use crate::Cluster;

fn curve(errors: &[f64], placements: u64) -> Vec<Observation> {
    let of = |placement: u64| {
        // a level per placement, which does not affect decisions
        let level = 1.0 + 0.02 * placement as f64;
        let at = move |(i, e): (usize, &f64)| Observation {
            at: (i + 1) as f64,
            cluster: Cluster { placement, seed: 1 },
            error: e * level,
        };
        errors.iter().enumerate().map(at).collect::<Vec<_>>()
    };
    (0..placements).flat_map(of).collect()
}

/// 10.9 is within 10 % of 10, 12 is not. Without the largest M, the smallest error is 10.9, and 12 is just not within 10 %.
#[test]
fn the_smallest_within_ten_percent_and_what_it_hangs_on() {
    let errors = [30.0, 20.0, 12.0, 10.9, 10.0];
    let found = decisions(&curve(&errors, 5), DecisionTerms::default()).unwrap();
    assert_eq!((found.within.at, found.within.without_largest), (4.0, 4.0), "{found:?}");
    assert_eq!((found.within.share(4.0), found.priced.clone()), (Some(1.0), None), "{found:?}");
    let falling = decisions(&curve(&[16.0, 8.0, 4.0, 2.0], 5), DecisionTerms::default()).unwrap();
    assert_eq!((falling.within.at, falling.within.without_largest), (4.0, 3.0), "{falling:?}");
    let wide =
        decisions(&curve(&errors, 5), DecisionTerms { within: 0.25, ..DecisionTerms::default() }).unwrap();
    assert_eq!(wide.within.at, 3.0, "{wide:?}");
}

/// Of a fall from 100 to 10.4 %, nine tenths are reached at 19.4 %, eight at 28.3 %. If all errors exceed 100 %, the smallest
/// is chosen.
#[test]
fn the_fall_from_nothing_ends_where_nine_tenths_of_it_are_done() {
    let of = |errors: &[f64], fall| {
        decisions(&curve(errors, 5), DecisionTerms { fall, ..DecisionTerms::default() }).unwrap().fall.at
    };
    let errors = [30.0, 20.0, 12.0, 10.9, 10.0];
    assert_eq!([0.9, 0.8, 0.75, 1.0].map(|fall| of(&errors, fall)), [3.0, 2.0, 1.0, 5.0]);
    assert_eq!(of(&[150.0, 120.0, 130.0], 0.9), 2.0);
}

/// Levels are 1 … 1.08, mean 1.04. With falls of 10.4, 8.3, 1.1, 0.9 a price of 1 % stops at the fourth sensor, 9 % at the
/// second.
#[test]
fn a_sensor_has_its_price() {
    let of = |price| {
        let terms = DecisionTerms { price: Some(price), ..DecisionTerms::default() };
        decisions(&curve(&[30.0, 20.0, 12.0, 10.9, 10.0], 5), terms).unwrap().priced.unwrap().at
    };
    assert_eq!([0.0, 1.0, 2.0, 9.0, 99.0].map(of), [5.0, 4.0, 3.0, 2.0, 1.0]);
}

/// Two of five placements need the fourth sensor, three do not: votes are split. Too few placements have no votes.
#[test]
fn votes_are_split_where_placements_disagree() {
    let mut observations = curve(&[30.0, 20.0, 10.0, 10.0], 5);
    for o in observations.iter_mut().filter(|o| o.cluster.placement < 2 && o.at == 4.0) {
        o.error *= 0.8;
    }
    let found = decisions(&observations, DecisionTerms::default()).unwrap();
    let [three, four] = [3.0, 4.0].map(|m| found.within.share(m).unwrap());
    assert!(three > 0.3 && four > 0.2 && (three + four - 1.0).abs() < 1e-12, "{found:?}");
    let few = decisions(&curve(&[30.0, 20.0], 3), DecisionTerms::default()).unwrap();
    assert_eq!((few.within.votes, &few.over[..]), (None, "no interval, too few units: 3 placements"));
}

/// In an incomplete grid of four placements and four seeds, replicates without trials at some M have no vote.
#[test]
fn a_grid_on_its_way_is_decided_on() {
    let of = |(placement, seed): (u64, u64)| {
        let cluster = Cluster { placement, seed };
        let at = |m: u64| Observation { at: m as f64, cluster, error: [30.0, 12.0][m as usize - 1] };
        // only the first placement has the second M
        (1..=if placement == 0 { 2 } else { 1 }).map(at).collect::<Vec<_>>()
    };
    let there =
        (0..4).flat_map(|placement| (0..4).map(move |seed| (placement, seed))).filter(|(p, s)| p + s < 4);
    let observations: Vec<Observation> = there.flat_map(of).collect();
    let found = decisions(&observations, DecisionTerms::default()).unwrap();
    let votes: f64 = found.within.votes.unwrap().iter().map(|vote| vote.1).sum();
    assert!((votes - 1.0).abs() < 1e-9 && found.within.at == 2.0, "{votes}");
}
