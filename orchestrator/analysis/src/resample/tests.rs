use super::*;

fn grid(placements: u64, seeds: u64) -> Vec<Cluster> {
    (0..placements).flat_map(|placement| (0..seeds).map(move |seed| Cluster { placement, seed })).collect()
}

#[test]
fn a_replicate_draws_one_placement_and_seed_fewer_than_there_are() {
    let resampling = Resampling::new(&grid(5, 4));
    for replicate in 0..50 {
        let weights = resampling.weights(replicate);
        let sum = weights.iter().sum::<f64>();
        assert!((sum - 20.0).abs() < 1e-12, "replicate {replicate}: {weights:?}");
    }
    assert_ne!(resampling.weights(0), resampling.weights(1));
    assert_eq!(resampling.weights(7), Resampling::new(&grid(5, 4)).weights(7));
}

/// The variance of a mean over replicates is exactly Σ (x − x̄)²/n(n − 1), because all ways to draw are used.
#[test]
fn replicates_vary_as_means_do() {
    let x = [1.0, 2.0, 4.0, 8.0];
    let mean = |w: Vec<f64>| Some(w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>() / 4.0);
    let means = Resampling::new(&grid(4, 1)).replicates(mean);
    let variance = means.iter().map(|m| (m - 3.75).powi(2)).sum::<f64>() / means.len() as f64;
    let truth = x.map(|x| (x - 3.75) * (x - 3.75)).iter().sum::<f64>() / 12.0;
    assert_eq!(means.len(), 64);
    assert!((variance / truth - 1.0).abs() < 1e-12, "{variance} {truth}");
}

#[test]
fn fewer_than_four_units_of_every_kind_are_too_few_to_tell() {
    for (placements, seeds, over) in [
        (1, 1, "no interval, too few units: 1 placement × 1 seed"),
        (3, 1, "no interval, too few units: 3 placements"),
        (3, 2, "no interval, too few units: 3 placements × 2 seeds"),
        (5, 1, "5 placements"),
        (1, 4, "4 seeds"),
        (5, 3, "5 placements at 3 seeds"),
        (5, 4, "5 placements × 4 seeds"),
    ] {
        let resampling = Resampling::new(&grid(placements, seeds));
        let tells = placements > 3 || seeds > 3;
        assert_eq!(resampling.over(), over);
        let replicates = match (placements, seeds) {
            (5, 4) => REPLICATES,
            (5, _) => 625,
            (_, 4) => 64,
            _ => 0,
        };
        assert_eq!(resampling.replicates(Some).len(), replicates, "{over}");
        assert_eq!(resampling.interval(|w| Some(w.iter().sum())).is_some(), tells, "{over}");
    }
}

/// With one or two own placements per seed, seeds are the units, and means vary as with common placements.
#[test]
fn seeds_with_placements_of_their_own_are_one_kind_of_unit() {
    for each in 1..=2 {
        let trial = |i: u64| Cluster { placement: 7 - i, seed: i % 4 };
        let own: Vec<Cluster> = (0..4 * each).map(trial).collect();
        let [own, shared] = [Resampling::new(&own), Resampling::new(&grid(each, 4))];
        assert_eq!(own.over(), "4 seeds, each with its own placements");
        assert_eq!(own.replicates(Some), shared.replicates(Some));
    }
    let few: Vec<Cluster> = (0..6).map(|i| Cluster { placement: i, seed: i % 2 }).collect();
    assert_eq!(Resampling::new(&few).over(), "6 placements at 2 seeds");
}

/// With one trial per unit, the interval is Student's: values 1, 2, 4, 8, s² = 28.75/3, t₃ = 3.182. Nested trials change
/// nothing.
#[test]
fn the_interval_of_a_mean_is_student_s_over_units() {
    let x = [1.0, 2.0, 4.0, 8.0];
    for nested in [1, 6] {
        let trial = |i: usize| (Cluster { placement: (i % 4) as u64, seed: 1 }, x[i % 4]);
        let trials: Vec<(Cluster, f64)> = (0..4 * nested).map(trial).collect();
        let resampling = Resampling::new(&trials.iter().map(|t| t.0).collect::<Vec<_>>());
        let mean = |w: &[f64]| {
            Some(w.iter().zip(&trials).map(|(w, t)| w * t.1).sum::<f64>() / w.iter().sum::<f64>())
        };
        let Inference { interval: found, chance, tells } = resampling.judged(mean).unwrap();
        // t = 3.75/1.548 = 2.42 with three degrees of freedom
        assert!((chance - 0.0939).abs() < 1e-3, "{chance}");
        // 80 % quantile of t: 0.978
        assert!((tells - (3.18245 + 0.97847) * (28.75f64 / 3.0 / 4.0).sqrt()).abs() < 1e-3, "{tells}");
        let half = 3.182_446_305_284_263 * (28.75f64 / 3.0 / 4.0).sqrt();
        assert!((found.low - (3.75 - half)).abs() < 1e-9, "{found:?}");
        assert!((found.high - (3.75 + half)).abs() < 1e-9, "{found:?}");
    }
}
