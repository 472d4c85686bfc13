//! Error against run time: best test error so far over seconds of CPU, per trial and protocol.

use super::data::{Trial, geometric_mean};

/// What a run has reached: seconds, and best error (%) so far.
pub type Reached = (f64, f64);

/// The points that no other beats in both seconds and error, by rising seconds; the index of each is given too.
#[must_use]
pub fn pareto(points: &[Reached]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.retain(|&i| points[i].0.is_finite() && points[i].1.is_finite());
    order.sort_by(|&i, &j| points[i].0.total_cmp(&points[j].0).then(points[i].1.total_cmp(&points[j].1)));
    let mut least = f64::INFINITY;
    order.retain(|&i| {
        let better = points[i].1 < least;
        least = least.min(points[i].1);
        better
    });
    order
}

/// Seconds until a run's best error is no more than `error`.
#[must_use]
pub fn time_to(history: &[Reached], error: f64) -> Option<f64> {
    history.iter().find(|(_, best)| *best <= error).map(|(seconds, _)| *seconds)
}

/// The best error at some seconds; `None` before the first step's end.
#[must_use]
pub fn best_at(history: &[Reached], seconds: f64) -> Option<f64> {
    history.iter().take_while(|(s, _)| *s <= seconds).last().map(|(_, best)| *best)
}

/// Geometric mean over runs of the best error so far at `count` times, spaced evenly in ln s from when all runs have a
/// first error to the end of the longest; a run that has ended keeps its last.
#[must_use]
pub fn mean_history(histories: &[&[Reached]], count: usize) -> Vec<Reached> {
    let histories: Vec<&&[Reached]> = histories.iter().filter(|h| !h.is_empty()).collect();
    let start = histories.iter().map(|h| h[0].0).fold(0.0, f64::max);
    let end = histories.iter().map(|h| h[h.len() - 1].0).fold(0.0, f64::max);
    if histories.is_empty() || start <= 0.0 || end <= start {
        return Vec::new();
    }
    (0..count)
        .map(|i| {
            // The ends exactly: rounding must not fall short of the first error.
            let seconds = match i {
                0 => start,
                i if i + 1 == count => end,
                i => start * (end / start).powf(i as f64 / (count - 1) as f64),
            };
            let errors: Vec<f64> = histories.iter().filter_map(|h| best_at(h, seconds)).collect();
            (seconds, geometric_mean(&errors))
        })
        .collect()
}

/// Mean seconds a trial by part, with the parts in the order in which the first trial names them.
#[must_use]
pub fn mean_seconds(trials: &[&Trial]) -> Vec<(&'static str, f64)> {
    let Some(first) = trials.first() else { return Vec::new() };
    first
        .seconds
        .iter()
        .map(|&(part, _)| {
            let of = |t: &&Trial| t.seconds.iter().find(|s| s.0 == part).map_or(0.0, |s| s.1);
            (part, trials.iter().map(of).sum::<f64>() / trials.len() as f64)
        })
        .collect()
}

/// Round errors (1, 1.5, 2, 3, 5, 7 × 10^n) that all but the easiest runs reach and the best ones do: between the
/// largest first error and the least last one.
#[must_use]
pub fn round_errors(histories: &[&[Reached]]) -> Vec<f64> {
    let first = histories.iter().filter_map(|h| h.first()).map(|p| p.1).fold(0.0, f64::max);
    let last = histories.iter().filter_map(|h| h.last()).map(|p| p.1).fold(f64::INFINITY, f64::min);
    let mut errors: Vec<f64> = (-3..6)
        .flat_map(|power| [1.0, 1.5, 2.0, 3.0, 5.0, 7.0].map(|digit| digit * 10f64.powi(power)))
        .filter(|e| (last..first).contains(e))
        .collect();
    errors.reverse();
    errors.truncate(6);
    errors
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_holds_what_nothing_beats() {
        let points =
            [(1.0, 20.0), (2.0, 25.0), (3.0, 10.0), (3.0, 11.0), (0.5, 30.0), (9.0, 10.0), (f64::NAN, 1.0)];
        assert_eq!(pareto(&points), [4, 0, 2]);
    }

    #[test]
    fn time_to_an_error_is_that_of_the_first_step_which_has_it() {
        let history = [(1.0, 20.0), (2.0, 12.0), (4.0, 12.0), (5.0, 9.0)];
        assert_eq!(time_to(&history, 12.0), Some(2.0));
        assert_eq!(time_to(&history, 5.0), None);
        assert_eq!(best_at(&history, 4.5), Some(12.0));
        assert_eq!(best_at(&history, 0.5), None);
    }

    #[test]
    fn the_mean_history_runs_from_the_last_start_to_the_last_end() {
        let (a, b) = ([(1.0, 16.0), (4.0, 4.0)], [(2.0, 4.0), (8.0, 1.0)]);
        let mean = mean_history(&[&a, &b], 3);
        assert!((mean[0].0 - 2.0).abs() < 1e-12 && (mean[0].1 - 8.0).abs() < 1e-12, "{mean:?}");
        assert!((mean[1].0 - 4.0).abs() < 1e-9 && (mean[2].1 - 2.0).abs() < 1e-12, "{mean:?}");
    }

    #[test]
    fn round_errors_lie_between_where_runs_start_and_where_the_best_ends() {
        assert_eq!(
            round_errors(&[&[(1.0, 22.0), (2.0, 8.0)], &[(1.0, 18.0), (2.0, 14.0)]]),
            [20.0, 15.0, 10.0]
        );
    }
}
