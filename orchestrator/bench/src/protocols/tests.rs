use super::*;

/// Rows of two runs: one line per protocol through all its points, sorted by time.
#[test]
fn rows_of_several_runs_make_one_line_a_protocol() {
    let row = |name: &str, seconds: f64, error: f64| {
        json!({ "protocol": name, "cpu_seconds": seconds, "holdout_error_percent": error }).to_string()
    };
    let rows = [row("initial", 0.0, 22.0), row("joint", 100.0, 8.0), row("joint", 50.0, 10.0)];
    let more = [row("paper", 900.0, 15.0), row("joint", 25.0, 12.0), "no row".into()];
    let svg = draw(&[rows.join("\n"), more.join("\n")].join("\n"));
    assert_eq!(svg.matches("<path class=\"line").count(), 3, "{svg}");
    let order: Vec<usize> = ["25 s, 12", "50 s, 10", "100 s, 8"]
        .map(|told| svg.find(&format!("joint: {told}")).unwrap())
        .to_vec();
    assert!(order.is_sorted(), "{order:?}");
}
