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
    assert_eq!(first_at(&history, 12.0), Some(2.0));
    assert_eq!(first_at(&history, 5.0), None);
    assert_eq!(best_at(&history, 4.5), Some(12.0));
    assert_eq!(best_at(&history, 0.5), None);
}

/// Times 1 … 7; runs 3 and 6 are censored. Kaplan–Meier: 6/7, 5/7, then 5/7·3/4 = 0.54 and 5/7·2/4 = 0.36. Without the censored
/// runs the median would be 4.
#[test]
fn a_run_that_never_got_there_counts() {
    let runs: Vec<(f64, bool)> = (1..8).map(|i| (f64::from(i), i != 3 && i != 6)).collect();
    assert_eq!(median(&runs), Some(5.0));
    let none: Vec<(f64, bool)> = (1..8).map(|i| (f64::from(i), i < 3)).collect();
    assert_eq!(median(&none), None);
    assert_eq!(median(&[(2.0, true), (4.0, true)]), Some(3.0));
}

/// Six runs: the interval is slightly narrower than from the first to the last time (1 − 2/64 = 96.9 %). If the last run is
/// censored, it is open above.
#[test]
fn the_interval_of_a_median_is_open_where_runs_never_got_there() {
    let of = |last: bool, count: u64| {
        let run = |i: u64| CensoredTime {
            cluster: Cluster { placement: i, seed: 1 },
            seconds: (1 << i) as f64,
            reached: i < 5 || last,
        };
        median_time(&(0..count).map(run).collect::<Vec<_>>())
    };
    let all = of(true, 6);
    let [Some(low), Some(high)] = all.ends else { panic!("{all:?}") };
    assert!((1.0..1.5).contains(&low) && high > 21.0 && high <= 32.0, "{all:?}");
    assert_eq!(all.median, Some(6.0));
    assert_eq!(of(false, 6).ends, [Some(low), None]);
    let few = of(true, 5);
    assert_eq!((few.ends, &few.over[..]), ([None; 2], "no interval, too few units: 5 placements"));
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
    assert_eq!(round_errors(&[&[(1.0, 22.0), (2.0, 8.0)], &[(1.0, 18.0), (2.0, 14.0)]]), [20.0, 15.0, 10.0]);
}

/// With trained and untrained trials, every row of the table has every part; missing parts are 0.
#[test]
fn untrained_trials_have_the_parts_of_the_others_in_the_table() {
    let of = |iterations: u64, seconds: &[(&'static str, f64)]| Trial {
        setting: [("optimise.iterations".to_owned(), serde_json::json!(iterations))].into_iter().collect(),
        spent: seconds.iter().map(|part| part.1).sum(),
        seconds: seconds.to_vec(),
        ..Trial::default()
    };
    let all = [of(0, &[("evaluate", 2.0)]), of(9, &[("evaluate", 3.0), ("simulate", 5.0)])];
    let table = crate::tables::Question::Seconds.answer(&all, Default::default());
    assert_eq!(table.columns[2..], ["all", "evaluate", "simulate"]);
    let cells: Vec<String> = table.rows.iter().map(|row| format!("{:?}", &row[2..])).collect();
    assert_eq!(cells, ["[Number(2.0), Number(2.0), Number(0.0)]", "[Number(8.0), Number(3.0), Number(5.0)]"]);
}
