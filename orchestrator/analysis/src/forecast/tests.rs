use super::*;

/// Three trials, each with ten steps of 1 s and a comparison of 4 s, on two workers; the plan assumes half of these times, and
/// one trial is half done. From the second step on, the forecast ends at 23 s, and the part done grows to 1.
#[test]
fn an_estimate_holds_for_resumed_trials_and_for_the_last_one_alone() {
    let planned = |behind| Planned { step: 0.5, comparison: 2.0, steps: 10, behind, open: true };
    let mut forecast = Forecast::new(vec![planned(5), planned(0), planned(0)], 2);
    let at = |seconds: u32| Duration::from_secs(seconds.into());
    // Trial 0: steps until 5 s, done at 9; trial 2 on the same worker until 23; trial 1 until 14.
    let mut parts = Vec::new();
    let runs = [(0u32, 0u32, 5u32), (1, 0, 10), (2, 9, 10)];
    for second in 0..=23 {
        for (trial, from, steps) in runs {
            match second {
                s if s == from => forecast.assigned(trial, at(s)),
                s if s > from && s <= from + steps => forecast.stepped(trial, at(s)),
                s if s == from + steps + 4 => {
                    forecast.returned(trial, true, at(s));
                    forecast.settled(trial);
                }
                _ => {}
            }
        }
        let to_go = forecast.to_go(at(second)).map(|to_go| to_go.as_secs_f64());
        match second {
            0 | 1 => assert_eq!(to_go, None, "at {second} s"),
            _ => {
                let error = to_go.unwrap() - f64::from(23 - second);
                assert!(error.abs() < 0.1, "{error} s off at {second} s");
            }
        }
        parts.push(forecast.part(at(second)));
    }
    assert!(parts.is_sorted() && parts[0] > 0.1 && parts[23] == 1.0, "{parts:?}");
}

/// A comparison takes ten times its planned time: once overdue, its remaining time grows, and the next trial's comparison is
/// expected to be as long.
#[test]
fn what_is_overdue_is_not_nearly_done() {
    let planned = Planned { step: 1.0, comparison: 4.0, steps: 10, behind: 0, open: true };
    let mut forecast = Forecast::new(vec![planned, planned], 1);
    let at = |seconds: u32| Duration::from_secs(seconds.into());
    forecast.assigned(0, at(0));
    (1..=10).for_each(|second| forecast.stepped(0, at(second)));
    let to_go = |forecast: &Forecast, second| forecast.to_go(at(second)).unwrap().as_secs_f64();
    assert!((to_go(&forecast, 11) - (3.0 + 14.0)).abs() < 0.1);
    let left: Vec<f64> = (20..50).step_by(5).map(|second| to_go(&forecast, second)).collect();
    assert!(left.is_sorted() && left[0] >= 0.25 * 10.0 + 10.0 + 1.25 * 10.0, "{left:?}");
    assert!((20..50).all(|second| forecast.part(at(second)) < 0.6));
    forecast.returned(0, true, at(50));
    forecast.settled(0);
    assert!((to_go(&forecast, 50) - 50.0).abs() < 0.1);
}
