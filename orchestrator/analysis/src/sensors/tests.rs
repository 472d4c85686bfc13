use super::*;
use crate::Cluster;

fn curve(errors: &[f64], scatter: f64) -> Vec<Observation> {
    (0..4u64)
        .flat_map(|placement| {
            errors.iter().enumerate().map(move |(i, e)| Observation {
                at: (i + 1) as f64,
                cluster: Cluster { placement, seed: 1 },
                error: e * (1.0 + scatter * (placement as f64 - 1.5)),
            })
        })
        .collect()
}

#[test]
fn the_paper_s_finding_two_against_six() {
    let initial = curve(&[30.0, 22.0, 18.0, 16.0, 15.0, 14.0], 0.02);
    let optimised = curve(&[16.0, 9.0, 8.0, 7.5, 7.5, 7.5], 0.02);
    let found = fewer(&initial, &optimised).unwrap();
    assert_eq!((found.most, found.fewest, found.share), (6.0, Some(2.0), Some(1.0)), "{found:?}");
}

#[test]
fn a_body_that_never_wins_is_said_so() {
    let found = fewer(&curve(&[9.0, 8.0], 0.0), &curve(&[20.0, 10.0], 0.0)).unwrap();
    assert_eq!((found.fewest, found.share), (None, None));
}

#[test]
fn the_spread_of_equal_placements_is_nothing() {
    let at_one = |scatter| -> Vec<Observation> {
        curve(&[10.0], scatter).into_iter().filter(|o| o.at == 1.0).collect()
    };
    let (even, uneven) = (spread(&at_one(0.0)).unwrap(), spread(&at_one(0.1)).unwrap());
    assert!(even.deviation < 1e-12 && (even.ratio - 1.0).abs() < 1e-12, "{even:?}");
    assert!((uneven.ratio - 1.15 / 0.85).abs() < 1e-12 && uneven.placements == 4, "{uneven:?}");
    assert!(spread(&at_one(0.1)[..1]).is_none());
}
