use super::*;

#[test]
fn what_passes_unseen_does_not_count() {
    let mut clock = Clock::start();
    for seconds in [0.2, 3600.0, 0.3, 90_000.0] {
        clock.pass(Duration::from_secs_f64(seconds));
    }
    assert_eq!(clock.counted, Duration::from_millis(200 + 1000 + 300 + 1000));
}
