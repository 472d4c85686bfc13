use super::*;

#[test]
fn an_interval_can_be_read_from_the_table() {
    let row = |fitted: f64, part: f64| {
        let (low, high) = (fitted * (1.0 - part), fitted * (1.0 + part));
        row!["p", "u", 1.3 * fitted, fitted, low, high, part]
    };
    let rows = vec![row(3.0, 1e-5), row(1e-8, 1e-3), row(250.0, 0.2)];
    let shown = readable(&Table { columns: Vec::new(), rows }).rows;
    let shown: Vec<Vec<&str>> =
        shown.iter().map(|row| row[2..=5].iter().filter_map(Value::as_str).collect()).collect();
    assert_eq!(shown[0], ["3.900000", "3.000000", "2.999970", "3.000030"]);
    assert_eq!(shown[1], ["1.3000e-8", "1.0000e-8", "9.9900e-9", "1.0010e-8"]);
    assert_eq!(shown[2], ["325.0", "250.0", "200.0", "300.0"]);
}
