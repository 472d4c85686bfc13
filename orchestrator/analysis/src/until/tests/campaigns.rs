//! Campaigns of known truth: rate of wrong answers with and without correction for repeated looks, and the part of the grid
//! that runs. `CAMPAIGNS=10000 cargo test -p metasense-analysis --lib campaigns -- --nocapture` prints the table.

use metasense_numerics::random::Draw;

use crate::until::ask::{UntilAnswer, UntilQuestion};
use crate::until::looks::{Looks, at_least};
use crate::until::settle;

/// Campaigns per question, unless `CAMPAIGNS` is set.
const CAMPAIGNS: u64 = 2500;
/// Campaigns of the question whose error rate is near 5 %; others have at most half of this rate.
const AT_ITS_LIMIT: u64 = 10_000;
/// Units of the grid.
const GRID: usize = 12;
const ALPHA: f64 = 0.05;

/// ln e by place on the trained body, then on the initial one. Each unit has its own level and its own ratio of the two bodies;
/// each trial has noise.
struct World {
    truth: Vec<f64>,
    places: Vec<f64>,
    level: f64,
    ratio: f64,
    noise: f64,
    /// Whether noise has Student's t with three degrees of freedom instead of a normal distribution.
    heavy: bool,
}

impl World {
    fn new(optimised: &[f64], initial: &[f64]) -> Self {
        let places = (1..=optimised.len()).map(|m| m as f64).collect();
        let truth = optimised.iter().chain(initial).map(|e| e.ln()).collect();
        Self { truth, places, level: 0.15, ratio: 0.1, noise: 0.1, heavy: false }
    }

    fn unit(&self, draw: &mut Draw) -> Vec<f64> {
        let (level, ratio) = (self.level * draw.normal(), self.ratio * draw.normal());
        let half = self.places.len();
        let of = |(i, y): (usize, &f64)| {
            let shared = if i < half { level } else { level + ratio };
            let tail = if self.heavy {
                (3.0 / (0..3).map(|_| draw.normal().powi(2)).sum::<f64>()).sqrt() / 3f64.sqrt()
            } else {
                1.0
            };
            y + shared + self.noise * tail * draw.normal()
        };
        self.truth.iter().enumerate().map(of).collect()
    }
}

/// Fractions of campaigns that settle, and that settle on a wrong answer; mean fraction of the grid that runs.
#[derive(Debug, Clone, Copy)]
struct Outcome {
    settled: f64,
    wrong: f64,
    run: f64,
}

fn campaigns(
    question: UntilQuestion,
    world: &World,
    is_right: &(dyn Fn(UntilAnswer) -> bool + Sync),
    (looks, part): (&mut Looks, u64),
) -> Outcome {
    let said = std::env::var("CAMPAIGNS").ok().and_then(|count| count.parse().ok());
    let usual = if question == UntilQuestion::Complexity { AT_ITS_LIMIT } else { CAMPAIGNS };
    let count: u64 = said.unwrap_or(usual / part);
    let [mut settled, mut wrong, mut run] = [0.0; 3];
    for campaign in 0..count {
        let mut draw = Draw::numbered(29, campaign);
        let curves: Vec<Option<Vec<f64>>> = (0..GRID).map(|_| Some(world.unit(&mut draw))).collect();
        match settle(question, &curves, &world.places, ALPHA, looks) {
            Some((answer, units)) => {
                settled += 1.0;
                wrong += f64::from(u8::from(!is_right(answer)));
                run += units as f64;
            }
            None => run += GRID as f64,
        }
    }
    let all = count as f64;
    Outcome { settled: settled / all, wrong: wrong / all, run: run / all / GRID as f64 }
}

#[expect(clippy::print_stdout, reason = "the numbers of docs/explanation/statistics.md")]
fn told(line: &str) {
    println!("{line}");
}

/// At most 5 % of answers are wrong with correction for repeated looks, but more without.
#[test]
fn looks_that_are_paid_for_are_wrong_in_one_campaign_of_twenty_at_most() {
    let falling = [43.0, 22.0, 10.4, 4.1, 2.1, 1.64];
    let trained = [23.0, 2.0, 0.96, 0.12, 0.07, 0.08];
    let bent = [16.0, 8.0, 4.0, 3.6, 3.3, 3.0];
    let ratio = |x: f64| move |answer: UntilAnswer| matches!(answer, UntilAnswer::Ratio([_, low, high]) if (low..=high).contains(&x));
    let sensors = |m: Option<f64>| move |answer: UntilAnswer| answer == UntilAnswer::Sensors(m);
    let mean = |e: &[f64]| e.iter().map(|e| e.ln()).sum::<f64>() / e.len() as f64;
    let linear = (mean(&falling) - mean(&trained)).exp();
    type Right = Box<dyn Fn(UntilAnswer) -> bool + Sync>;
    let heavy = World { heavy: true, ..World::new(&trained, &falling) };
    let cases: Vec<(&str, UntilQuestion, World, Right)> = vec![
        (
            "paired, like four-forces",
            UntilQuestion::Paired(0.25),
            World::new(&trained, &falling),
            Box::new(ratio(linear)),
        ),
        ("the same, heavy tails", UntilQuestion::Paired(0.25), heavy, Box::new(ratio(linear))),
        (
            "paired, units differ more",
            UntilQuestion::Paired(0.5),
            World { ratio: 0.3, ..World::new(&trained, &falling) },
            Box::new(ratio(linear)),
        ),
        (
            "within 10 %: clear",
            UntilQuestion::Within(0.1),
            World::new(&trained, &falling),
            Box::new(sensors(Some(5.0))),
        ),
        (
            "within 10 %: 10.5 % off",
            UntilQuestion::Within(0.1),
            World::new(&[20.0, 10.0, 5.0, 4.42, 4.0, 4.0], &falling),
            Box::new(sensors(Some(5.0))),
        ),
        (
            "within 10 %: just within",
            UntilQuestion::Within(0.1),
            World::new(&[20.0, 10.0, 5.0, 4.38, 4.0, 4.0], &falling),
            Box::new(sensors(Some(4.0))),
        ),
        ("elbow at 3", UntilQuestion::Elbow, World::new(&bent, &falling), Box::new(sensors(Some(3.0)))),
        (
            "no elbow: just too steep beyond",
            UntilQuestion::Elbow,
            World::new(&[16.0, 8.0, 4.0, 2.8, 1.96, 1.372], &falling),
            Box::new(sensors(None)),
        ),
        (
            "fewer: 3 beat 6",
            UntilQuestion::Fewer,
            World::new(&trained, &falling),
            Box::new(sensors(Some(3.0))),
        ),
        (
            "fewer: 2 are as good, 3 better",
            UntilQuestion::Fewer,
            World::new(&[23.0, 1.641, 0.9, 0.5, 0.4, 0.3], &falling),
            Box::new(sensors(Some(3.0))),
        ),
        (
            "complexity: all the same",
            UntilQuestion::Complexity,
            World::new(&[4.0; 5], &[8.0; 5]),
            Box::new(|_| false),
        ),
        (
            "complexity: falls",
            UntilQuestion::Complexity,
            World::new(&[6.0, 5.0, 4.5, 4.2, 4.0], &[8.0; 5]),
            Box::new(|answer| answer == UntilAnswer::Falls(true)),
        ),
    ];
    told(&format!(
        "{:34} {:>8} {:>7} {:>9}   {:>14} {:>9}",
        "", "settled", "wrong", "of grid", "naive: wrong", "of grid"
    ));
    let all = |mut looks: Looks, part| {
        let of = |(_, question, world, is_right): &(_, _, _, Right)| {
            campaigns(*question, world, is_right, (&mut looks, part))
        };
        cases.iter().map(of).collect::<Vec<Outcome>>()
    };
    // a tenth of the campaigns suffices to show the error rate without correction
    let (paid_for, naive) = rayon::join(|| all(Looks::new(GRID), 1), || all(Looks::uncorrected(GRID), 10));
    let (mut worst, mut naive_worst) = (0.0f64, 0.0f64);
    for (((name, ..), paid), naive) in cases.iter().zip(paid_for).zip(naive) {
        told(&format!(
            "{name:34} {:7.1} % {:5.2} % {:7.0} %   {:12.2} % {:7.0} %",
            100.0 * paid.settled,
            100.0 * paid.wrong,
            100.0 * paid.run,
            100.0 * naive.wrong,
            100.0 * naive.run
        ));
        (worst, naive_worst) = (worst.max(paid.wrong), naive_worst.max(naive.wrong));
    }
    assert!(worst <= ALPHA && naive_worst > 2.0 * ALPHA, "{worst} {naive_worst}");
}

/// The bound is below the exact probability, and close to it with many units.
#[test]
fn a_chance_is_not_below_its_bound() {
    for t in (-30..=50).map(|t| f64::from(t) / 10.0) {
        let above = |free| metasense_numerics::student::chance_above(free, t);
        assert!([1, 2, 3, 10, 200].into_iter().all(|free| above(free) >= at_least(t)), "{t}");
        assert!(t <= 0.0 || at_least(t) > 0.5 * above(1000), "{t}");
    }
}
