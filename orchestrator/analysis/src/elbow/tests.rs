use super::*;
use crate::Cluster;
use metasense_numerics::random::Draw;

/// Observations of a curve at M = 1…6 for five placements and two seeds, each with its own level, and noise.
fn curve(error: impl Fn(f64) -> f64, noise: f64) -> Vec<Observation> {
    let mut draw = Draw::numbered(11, 0);
    let mut all = Vec::new();
    for placement in 0..5 {
        for seed in 0..2 {
            let level = (0.2 * draw.normal()).exp();
            for m in 1..=6 {
                let error = error(f64::from(m)) * level * (noise * draw.normal()).exp();
                all.push(Observation { at: f64::from(m), cluster: Cluster { placement, seed }, error });
            }
        }
    }
    all
}

#[test]
fn a_curve_that_bends_at_two_has_its_elbow_there() {
    let found =
        elbow(&curve(|m| 20.0 * (-1.2 * m.min(2.0) - 0.05 * m).exp(), 0.05), ErrorScale::Logarithm).unwrap();
    assert_eq!(found.verdict, Verdict::At(2.0), "{found:?}");
    assert_eq!((found.broken_stick, found.kneedle, found.chord), (Some(2.0), Some(2.0), Some(2.0)));
    assert_eq!(found.without_largest, Some(Some(2.0)));
    let total: f64 = found.votes.iter().map(|v| v.1).sum();
    assert!(found.votes[0].1 > 0.95 && total <= 1.0, "{:?}", found.votes);
}

#[test]
fn a_curve_that_bends_at_four_has_its_elbow_there() {
    let found = elbow(&curve(|m| 30.0 * (-0.6 * m.min(4.0)).exp(), 0.08), ErrorScale::Logarithm).unwrap();
    assert_eq!(found.verdict, Verdict::At(4.0), "{found:?}");
}

#[test]
fn a_straight_fall_and_a_flat_curve_have_no_elbow() {
    for (slope, noise) in [(0.3, 0.05), (0.0, 0.05), (0.3, 0.0)] {
        let found = elbow(&curve(|m| 20.0 * (-slope * m).exp(), noise), ErrorScale::Logarithm).unwrap();
        assert_eq!(found.verdict, Verdict::NoElbow, "slope {slope}, noise {noise}: {found:?}");
    }
}

/// Equal factors are straight in logarithms and a decay in %. A fall that ends bends in both. A fall by many factors that bends
/// late in logarithms has ended earlier in %.
#[test]
fn a_curve_has_two_heights() {
    let verdicts = |error: &dyn Fn(f64) -> f64| {
        ErrorScale::ALL.map(|scale| elbow(&curve(error, 0.03), scale).unwrap().verdict)
    };
    assert_eq!(verdicts(&|m| 20.0 * (-0.5 * m).exp()), [Verdict::NoElbow; 2]);
    assert_eq!(verdicts(&|m| 20.0 - 8.0 * m.min(2.0)), [Verdict::At(2.0); 2]);
    let fall = verdicts(&|m| 40.0 * (-2.0 * m.min(4.0)).exp());
    assert!(fall[0] != Verdict::At(4.0) && fall[1] == Verdict::At(4.0), "{fall:?}");
    // a decay to a floor, without a bend
    assert_eq!(verdicts(&|m| 5.0 + 30.0 * 0.6f64.powf(m))[0], Verdict::NoElbow);
}

/// A fall between the first two M may be a bend or a fast decay; a later fall is a bend.
#[test]
fn a_bend_at_the_second_m_may_be_a_fast_decay() {
    for (error, place, any) in [
        (&(|m: f64| 5.0 + 30.0 * 0.08f64.powf(m - 1.0)) as &dyn Fn(f64) -> f64, Some(2.0), None),
        (&|m: f64| 60.0 - 18.0 * m.min(3.0), Some(3.0), Some(3.0)),
    ] {
        let found = elbow(&curve(error, 0.01), ErrorScale::Percent).unwrap();
        assert_eq!((found.broken_stick, found.any_decay), (place, any), "{found:?}");
    }
}

/// The true gain is e^0.5 before the elbow and 1 after it.
#[test]
fn gains_are_paired_within_clusters() {
    let found = elbow(&curve(|m| 20.0 * (-0.5 * m.min(3.0)).exp(), 0.02), ErrorScale::Logarithm).unwrap();
    for gain in &found.gains {
        let truth = if gain.from < 3.0 { 0.5f64.exp() } else { 1.0 };
        let interval = gain.interval.unwrap();
        assert!((gain.ratio / truth - 1.0).abs() < 0.03, "{gain:?}");
        assert!(interval.high / interval.low < 1.1, "{gain:?}");
    }
}

#[test]
fn three_values_of_m_are_too_few() {
    let few: Vec<Observation> = curve(|m| 20.0 / m, 0.0).into_iter().filter(|o| o.at < 3.5).collect();
    assert_eq!(elbow(&few, ErrorScale::Percent), Err(TooFew(3)));
}

/// "No elbow" is one of the answers; half of the votes do not decide.
#[test]
fn the_verdict_is_what_has_most_votes() {
    for (two, three, none, verdict) in [
        (0.6, 0.2, 0.2, Verdict::At(2.0)),
        (0.2, 0.6, 0.2, Verdict::At(3.0)),
        (0.2, 0.2, 0.6, Verdict::NoElbow),
        (0.3, 0.25, 0.45, Verdict::Undecided(None)),
        (0.25, 0.45, 0.3, Verdict::Undecided(Some(3.0))),
        (0.5, 0.25, 0.25, Verdict::Undecided(Some(2.0))),
        (0.25, 0.25, 0.5, Verdict::Undecided(None)),
        (0.4, 0.4, 0.2, Verdict::Undecided(Some(2.0))),
    ] {
        assert_eq!(verdict_of(&[(2.0, two), (3.0, three)], none), verdict);
    }
    let found = elbow(&curve(|m| 20.0 * (-0.6 * m.min(3.0)).exp(), 0.3), ErrorScale::Logarithm).unwrap();
    let places = found.votes.iter().map(|v| Some(v.0)).chain([None]);
    let all: f64 = places.map(|place| found.share(place).unwrap()).sum();
    assert!((all - 1.0).abs() < 1e-12, "{found:?}");
}

#[test]
fn one_placement_and_seed_gives_a_fit_without_votes() {
    let one: Vec<Observation> = curve(|m| 20.0 * (-m.min(2.0)).exp(), 0.0)
        .into_iter()
        .filter(|o| o.cluster == Cluster::default())
        .collect();
    let found = elbow(&one, ErrorScale::Logarithm).unwrap();
    assert_eq!(found.verdict, Verdict::WithoutVote(Some(2.0)), "{found:?}");
    assert_eq!((found.share(Some(2.0)), found.share(None)), (None, None));
    assert!(found.gains.iter().all(|g| g.interval.is_none()));
}
