//! Coverage of the 95 % intervals in synthetic campaigns of known truth, with effects of placements and seeds, and M nested in
//! placements.

use super::data::Observation;
use super::elbow::gains;
use super::numbers::{mean, median};
use super::paired::{Ratio, TrainingMeasure, error_ratio, iteration_ratio, iterations};
use super::random::{random, random_groups};
use super::records::{BodyErrors, mean_interval, mean_ratio};
use super::resample::{Interval, LEAST_UNITS};
use super::run_time::{CensoredTime, median_time};
use super::scaling::{FittedLaw, scaling};
use super::sensors::fewer;
use super::trial::{Cluster, RANDOM, SPREAD, Set, Trial};
use metasense_numerics::random::Draw;
use serde_json::json;

/// Returns the share (%) of campaigns whose interval contains `truth`, among those with an interval.
fn coverage(question: &str, campaigns: u64, truth: f64, ask: impl Fn(&mut Draw) -> Option<Interval>) -> f64 {
    held(question, truth, (0..campaigns).filter_map(|c| ask(&mut Draw::numbered(17, c))).collect())
}

/// Returns and prints the share (%) of intervals that contain `truth`.
fn held(question: &str, truth: f64, found: Vec<Interval>) -> f64 {
    let holds = found.iter().filter(|i| i.low <= truth && truth <= i.high).count();
    let share = 100.0 * holds as f64 / found.len() as f64;
    let mut widths: Vec<f64> = found.iter().map(|i| i.high / i.low).collect();
    widths.sort_by(f64::total_cmp);
    let width = widths[widths.len() / 2];
    told(&format!("{question:64} {:5} campaigns  {share:5.1} %  high/low {width:.2}", found.len()));
    share
}

/// Prints a row of the table; visible with `--nocapture`.
#[expect(clippy::print_stdout, reason = "the table is for whoever runs the test by hand")]
fn told(row: &str) {
    println!("{row}");
}

/// Draws from the normal distribution, or from Student's t with five degrees of freedom; variance 1.
fn noise(draw: &mut Draw, heavy: bool) -> f64 {
    let normal = draw.normal();
    let squares = if heavy { (0..5).map(|_| draw.normal().powi(2)).sum::<f64>() } else { 3.0 };
    normal * (3.0 / squares).sqrt()
}

/// Additive effects of placement and seed on ln of a quantity per trial, of standard deviations 0.3 and 0.2.
fn effects(draw: &mut Draw, placements: u64, seeds: u64, heavy: bool) -> Vec<(Cluster, f64)> {
    let p: Vec<f64> = (0..placements).map(|_| 0.3 * noise(draw, heavy)).collect();
    let s: Vec<f64> = (0..seeds).map(|_| 0.2 * noise(draw, heavy)).collect();
    // kinds of units that are held fixed have no effect: the interval is for the given units only
    let of = |list: &[f64], i: usize| if list.len() >= LEAST_UNITS { list[i] } else { 0.0 };
    let cluster = |i: u64| Cluster { placement: i % placements, seed: i / placements };
    let sum = |c: Cluster| (c, of(&p, c.placement as usize) + of(&s, c.seed as usize));
    (0..placements * seeds).map(|i| sum(cluster(i))).collect()
}

/// Trials with one to three sensors. Without effects and noise, the error of the initial body is twice that of the trained
/// body.
fn campaign(draw: &mut Draw, placements: u64, seeds: u64, heavy: bool) -> Vec<Trial> {
    let mut trials = Vec::new();
    for (cluster, effect) in effects(draw, placements, seeds, heavy) {
        for sensors in 1..=3 {
            let ratio = 2.0 * (effect + 0.1 * noise(draw, heavy)).exp();
            // equal loss at 1/ratio of the iterations
            let curve = |factor: f64| vec![(1, 1.0), ((1e6 / factor) as u32, 0.1)];
            let iterations = [vec![], Vec::from_iter(iteration_ratio(&curve(1.0), &curve(ratio)))];
            let errors = [[None, Some(10.0 * ratio), None], [None, Some(10.0), None]];
            trials.push(Trial { cluster, sensors, errors, iterations, ..Trial::default() });
        }
    }
    trials
}

fn assert_covers(shares: &[f64]) {
    assert!(shares.iter().all(|s| (93.0..=97.0).contains(s)), "{shares:?}");
}

#[test]
fn ratios_of_trials_that_share_placement_and_seed() {
    let mut shares = Vec::new();
    for (placements, seeds, heavy) in [
        (4, 1, false),
        (5, 1, false),
        (5, 1, true),
        (12, 1, false),
        (1, 4, false),
        (1, 8, true),
        (5, 2, false),
        (5, 4, false),
        (6, 5, true),
    ] {
        let tails = if heavy { ", heavy tails" } else { "" };
        let of = format!("{placements} placements × {seeds} seeds × 3 M{tails}");
        shares.push(coverage(&format!("paired: {of}"), 1000, 2.0, |draw| {
            let trials = campaign(draw, placements, seeds, heavy);
            error_ratio(&trials.iter().collect::<Vec<_>>(), Set::Holdout)?.interval
        }));
    }
    shares.push(coverage("paired: 4 seeds × 2 placements of their own × 3 M", 1000, 2.0, |draw| {
        let mut trials = campaign(draw, 8, 4, false);
        trials.retain(|t| t.cluster.placement / 2 == t.cluster.seed);
        error_ratio(&trials.iter().collect::<Vec<_>>(), Set::Holdout)?.interval
    }));
    shares.push(coverage("iterations: 5 placements × 1 seed × 3 M", 1000, 2.0, |draw| {
        let trials = campaign(draw, 5, 1, false);
        iterations(&trials.iter().collect::<Vec<_>>(), TrainingMeasure::Error)?.interval
    }));
    assert_covers(&shares);
}

/// Errors of held-out samples: ln e is normal about ln `typical`, standard deviation 1; a fraction `outliers` is 100 times
/// larger.
fn samples(draw: &mut Draw, typical: f64, outliers: f64) -> Vec<f64> {
    let one = |_| {
        let factor = if draw.uniform() < outliers { 100.0 } else { 1.0 };
        factor * typical * draw.normal().exp()
    };
    (0..60).map(one).collect()
}

/// Ratios of means and of medians of such samples. Outliers shift the ratio of means and widen its interval, which then
/// contains the expected ratio of means. The ratio of medians stays 2.
#[test]
fn ratios_of_trials_with_outlying_samples() {
    let trials = |draw: &mut Draw, placements: u64, seeds: u64, outliers: [f64; 2]| -> Vec<Trial> {
        let mut trials = Vec::new();
        for (cluster, effect) in effects(draw, placements, seeds, true) {
            for sensors in 1..=3 {
                let bodies = [20.0 * effect.exp(), 10.0];
                let found = [0, 1].map(|body: usize| samples(draw, bodies[body], outliers[body]));
                let errors = found.map(|errors| [None, mean(&errors), Some(median(errors))]);
                trials.push(Trial { cluster, sensors, errors, ..Trial::default() });
            }
        }
        trials
    };
    let mut shares = Vec::new();
    for (placements, seeds, outliers) in [
        (5, 1, [0.0, 0.0]),
        (12, 1, [0.005, 0.005]),
        (5, 1, [0.005, 0.005]),
        (5, 1, [0.0, 0.005]),
        (1, 8, [0.0, 0.005]),
        (5, 1, [0.01, 0.0]),
        (5, 4, [0.01, 0.0]),
    ] {
        let [initial, optimised] = outliers.map(|part| 100.0 * part);
        let who = format!("{placements} placements × {seeds} seeds, outliers {initial} and {optimised} %");
        let sets = [Set::Holdout, Set::Median];
        let campaigns = |number: u64| -> Vec<[Ratio; 2]> {
            let found = (0..1000).map(|c| {
                let trials = trials(&mut Draw::numbered(number, c), placements, seeds, outliers);
                sets.map(|set| error_ratio(&trials.iter().collect::<Vec<_>>(), set).unwrap())
            });
            found.collect()
        };
        // expected ratio, from other campaigns
        let (found, others) = (campaigns(17), campaigns(18));
        for (i, set) in sets.into_iter().enumerate() {
            let logs: Vec<f64> = others.iter().map(|ratios| ratios[i].ratio.ln()).collect();
            let truth = mean(&logs).unwrap().exp();
            let question = format!("{} {truth:.2}: {who}", set.name());
            let intervals = found.iter().filter_map(|ratios| ratios[i].interval).collect();
            let share = held(&question, truth, intervals);
            // crossed units: intervals cover more if samples vary more than placements and seeds
            match seeds > 1 && placements > 1 {
                true => assert!((93.0..=99.0).contains(&share), "{question}: {share}"),
                false => shares.push(share),
            }
            assert!(set == Set::Holdout || (truth / 2.0 - 1.0).abs() < 0.03, "{question}");
        }
    }
    assert_covers(&shares);
}

/// Intervals that treat trials as independent are too narrow if trials share placements.
#[test]
fn trials_taken_for_independent_do_not_cover() {
    let share = coverage("30 trials of 5 placements taken for independent", 1000, 2.0, |draw| {
        let trials = campaign(draw, 5, 1, false);
        let each = |(i, t): (usize, &Trial)| {
            let cluster = Cluster { placement: i as u64, seed: 0 };
            Trial { cluster, ..t.clone() }
        };
        let trials: Vec<Trial> = trials.iter().enumerate().map(each).collect();
        error_ratio(&trials.iter().collect::<Vec<_>>(), Set::Holdout)?.interval
    });
    assert!(share < 85.0, "{share}");
}

/// With the second sensor, e falls by a mean factor of 2 over placements, which differ in this factor.
#[test]
fn what_the_next_sensor_brings() {
    let share = coverage("sensors, gain from M = 1 to 2: 5 placements", 1000, 2.0, |draw| {
        let mut observations = Vec::new();
        for (cluster, effect) in effects(draw, 5, 1, false) {
            for m in 1..=4 {
                let fall = if m > 1 { effect - 2f64.ln() } else { 0.0 };
                let error = 20.0 * (fall + 0.1 * draw.normal()).exp();
                observations.push(Observation { at: f64::from(m), cluster, error });
            }
        }
        gains(&observations)[0].interval
    });
    assert_covers(&[share]);
}

/// Six random bodies of one placement and seed, with 1.5 times the error of their common initial body.
#[test]
fn random_bodies() {
    let share = coverage("random: 6 bodies", 1000, 1.5, |draw| {
        let mut trials = vec![Trial { errors: [[None, Some(10.0), None]; 2], ..Trial::default() }];
        for body in 0..6 {
            let setting = [(RANDOM.to_owned(), json!(body))].into_iter().collect();
            let errors = [[None, Some(15.0 * (0.3 * draw.normal()).exp()), None]; 2];
            trials.push(Trial { setting, errors, ..Trial::default() });
        }
        let [initial, _] = random(&trials.iter().collect::<Vec<_>>(), Set::Holdout)?.ratios;
        initial?.interval
    });
    assert_covers(&[share]);
}

/// Random bodies of different spread form different groups, each with all regular bodies.
#[test]
fn random_bodies_are_told_apart_by_their_spread() {
    let of = |spread: Option<f64>, seed: u64| {
        let drawn = spread.into_iter().flat_map(|x| [(RANDOM, json!(seed)), (SPREAD, json!(x))]);
        let told = drawn.filter(|(path, value)| *path != SPREAD || value != 0.25);
        let setting = told.map(|(path, value)| (path.to_owned(), value)).collect();
        let error = 10.0 * (1.0 + spread.unwrap_or_default());
        Trial { setting, errors: [[None, Some(error), None]; 2], ..Trial::default() }
    };
    let trials = [of(None, 0), of(Some(0.5), 1), of(Some(0.25), 1), of(Some(0.25), 2)];
    let [few, both] = [2, 4].map(|count| random_groups(&trials[..count].iter().collect::<Vec<_>>()));
    assert_eq!(few.iter().map(|group| group.trials.len()).collect::<Vec<_>>(), [2]);
    let said = both.iter().map(|group| {
        let [initial, _] = random(&group.trials, Set::Holdout).unwrap().ratios;
        (group.label.clone(), group.trials.len(), initial.unwrap().ratio)
    });
    let said: Vec<(String, usize, f64)> = said.collect();
    assert!(said[0].0.ends_with("spread = 0.25") && said[1].0.ends_with("spread = 0.5"), "{said:?}");
    assert!(said[0].1 == 3 && (said[0].2 - 1.25).abs() < 1e-9, "{said:?}");
    assert!(said[1].1 == 2 && (said[1].2 - 1.5).abs() < 1e-9, "{said:?}");
}

/// Skewed errors of records: ln e with a standard deviation of 0.6, of which 0.5 is common to both bodies, or of 0.9, of which
/// 0.75 is. More skewed errors need more records, because few records dominate the mean.
#[test]
fn means_over_records() {
    let judged = |errors: Vec<f64>| BodyErrors {
        body: String::new(),
        by: super::records::SignalSource::Measured,
        errors: errors.into_iter().map(Some).collect(),
        error_train: None,
        by_seed: vec![],
        by_fold: vec![],
        progress: vec![],
        agreement: None,
        posterior: None,
    };
    let mut shares = Vec::new();
    for (records, campaigns, [shared, own]) in [(30, 600, [0.5, 0.33]), (100, 200, [0.75, 0.5])] {
        let draws = |draw: &mut Draw| -> [Vec<f64>; 2] {
            let each = |_| {
                let record = shared * draw.normal();
                [2.0, 1.0].map(|e: f64| e * (record + own * draw.normal()).exp())
            };
            let pairs: Vec<[f64; 2]> = (0..records).map(each).collect();
            [0, 1].map(|body: usize| pairs.iter().map(|p| p[body]).collect())
        };
        let skewed = format!("{records} records, ln e ± {:.1}", f64::hypot(shared, own));
        for (paired, of) in [(true, "the same blows"), (false, "blows of their own")] {
            let question = format!("evaluate, ratio of means: {skewed}, {of}");
            shares.push(coverage(&question, campaigns, 2.0, |draw| {
                let [first, mut second] = draws(draw);
                if !paired {
                    second = draws(draw)[1].clone();
                }
                mean_ratio(&judged(first), &judged(second), paired)?.interval
            }));
        }
        let mean = (0.5 * (shared * shared + own * own)).exp();
        let question = format!("evaluate, mean: {skewed}");
        shares.push(coverage(&question, campaigns, mean, |draw| mean_interval(&draws(draw)[1])));
    }
    assert_covers(&shares[..3]);
    // about 93 %; 200 campaigns show this to three standard errors
    assert!(shares[3..].iter().all(|share| (88.0..=99.0).contains(share)), "{shares:?}");
}

/// L = 30·(N/N₀)^−0.8 + 4 at seven sizes in `placements`, which differ by 10 %; noise 4 %.
#[test]
fn scaling_laws() {
    let laws = |placements: u64| -> Vec<FittedLaw> {
        let campaign = |c| {
            let mut draw = Draw::numbered(17, c);
            let mut observations = Vec::new();
            for placement in 0..placements {
                let level = 0.1 * draw.normal();
                for n in [40.0, 84.0, 144.0, 220.0, 312.0, 420.0, 612.0] {
                    let law = 30.0 * (n / 150.0f64).powf(-0.8) + 4.0;
                    let error = law * (level + 0.04 * draw.normal()).exp();
                    observations.push(Observation { at: n, cluster: Cluster { placement, seed: 1 }, error });
                }
            }
            scaling(&observations).unwrap()
        };
        (0..400).map(campaign).collect()
    };
    let mut shares = Vec::new();
    for placements in [4, 6] {
        let laws = laws(placements);
        let of = |what: &str| format!("complexity, {what}: {placements} placements");
        let mut ask = |what: &str, truth: f64, interval: &dyn Fn(&FittedLaw) -> Option<Interval>| {
            shares.push(held(&of(what), truth, laws.iter().filter_map(interval).collect()));
        };
        ask("exponent", 0.8, &|law| law.exponent);
        ask("law at N = 300", 30.0 * 2f64.powf(-0.8) + 4.0, &|law| law.band(300.0));
        ask("held-out N", 1.0, &|law| law.held_out?.interval);
    }
    assert_covers(&shares);
}

/// Times to an error with a median of 100 s and a standard deviation of ln t of 0.5. Runs end between 80 and 400 s; about one
/// in six does not reach the error. Open ends contain everything.
#[test]
fn times_to_an_error() {
    let shares: Vec<f64> = [(6, 1e9), (9, 1e9), (6, 80.0), (9, 80.0), (20, 80.0)]
        .into_iter()
        .map(|(placements, earliest)| {
            let who = if earliest > 100.0 { "all there" } else { "some never there" };
            let of = format!("time-to: {placements} placements, {who}");
            coverage(&of, 2000, 100.0, |draw| {
                let run = |placement| {
                    let (time, end) =
                        (100.0 * (0.5 * draw.normal()).exp(), earliest * 5f64.powf(draw.uniform()));
                    let cluster = Cluster { placement, seed: 1 };
                    CensoredTime { cluster, seconds: time.min(end), reached: time <= end }
                };
                let [low, high] = median_time(&(0..placements).map(run).collect::<Vec<_>>()).ends;
                low.or(high)?;
                Some(Interval { low: low.unwrap_or(0.0), high: high.unwrap_or(f64::INFINITY) })
            })
        })
        .collect();
    assert_covers(&shares);
}

/// Votes are not probabilities. If the trained body with three sensors is exactly as good as the initial body with six, a
/// calibrated 95 % vote would occur in one campaign of twenty.
#[test]
fn votes_for_what_is_not_so() {
    let wrong: Vec<f64> = [5, 12]
        .into_iter()
        .map(|placements| {
            let sure = (0..250).filter(|c| {
                let mut draw = Draw::numbered(17, *c);
                let mut errors = |at: f64| -> Vec<Observation> {
                    let error = |placement| Observation {
                        at,
                        cluster: Cluster { placement, seed: 1 },
                        error: (0.3 * draw.normal()).exp(),
                    };
                    (0..placements).map(error).collect()
                };
                fewer(&errors(6.0), &errors(3.0)).is_some_and(|f| f.share.is_some_and(|s| s >= 0.95))
            });
            let share = sure.count() as f64 / 2.5;
            told(&format!("fewer: {placements} placements, 95 % of votes for what is not so: {share:.1} %"));
            share
        })
        .collect();
    assert!(wrong.iter().all(|w| *w < 12.0), "{wrong:?}");
}
