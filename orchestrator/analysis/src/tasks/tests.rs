use super::*;

#[test]
fn gains_are_paired_by_trial() {
    let read = |seed: u64, training: &str, task: (&'static str, &'static str), errors: [f64; 2]| TaskResult {
        setting: "K = 2".into(),
        sensors: 1,
        cluster: Cluster { placement: 0, seed },
        trained_for: training.into(),
        task: (task.0.into(), task.1.into()),
        readout: "direct".into(),
        errors,
        trivial: 50.0,
        error_min: if task.1 == "%" { 0.5 } else { 0.0 },
    };
    let (peak, panel) = (("peak", "N"), ("panel", "%"));
    let all: Vec<TaskResult> = (0..6)
        .flat_map(|seed| {
            let hard = 1.0 + seed as f64;
            [
                read(seed, "all", peak, [0.4 * hard, 0.1 * hard]),
                read(seed, "all", panel, [8.0, 0.0]),
                read(seed, "forces", peak, [0.4 * hard, 0.2 * hard]),
            ]
        })
        .collect();
    let table = table(&all);
    let number = |row: usize, column: &str| table.rows[row][table.column(column)].as_f64().unwrap();
    // rows are sorted by name: panel, peak
    for (row, gain) in [(1, 4.0), (0, 16.0)] {
        assert!((number(row, "ratio") - gain).abs() < 1e-9, "{table:?}");
        assert!(number(row, "ratio_low") <= gain + 1e-9 && gain <= number(row, "ratio_high") + 1e-9);
    }
    assert_eq!((number(0, "initial"), number(0, "optimised"), number(1, "trials")), (8.0, 0.0, 6.0));

    // one column per training, empty without trials
    let matrix = matrix(&all).unwrap();
    let cell = |row: usize, training: &str| matrix.rows[row][matrix.column(training)].as_str();
    assert_eq!([cell(0, "all"), cell(1, "all")].map(|cell| &cell.unwrap()[..4]), ["16.0", "4.00"]);
    assert_eq!((cell(0, "forces"), cell(1, "forces").map(|cell| &cell[..4])), (None, Some("2.00")));
    assert!(super::matrix(&all[..2]).is_none());

    // a second placement, on which training for all tasks gains half as much
    let place = |read: &TaskResult| TaskResult {
        cluster: Cluster { placement: 1, ..read.cluster },
        errors: [0.5 * read.errors[0], read.errors[1]],
        ..read.clone()
    };
    let both: Vec<TaskResult> = all.iter().cloned().chain(all.iter().map(place)).collect();
    let both = super::table(&both);
    assert_eq!(both.rows.len(), table.rows.len(), "placements are not settings");
    assert_eq!(both.rows[1][both.column("ratio_by_placement")], "0: 4.000, 1: 2.000");
    let pooled = both.rows[1][both.column("ratio")].as_f64().unwrap();
    assert!((pooled - 8f64.sqrt()).abs() < 1e-9, "{pooled}");
    assert!(table.rows.iter().all(|row| row[table.column("ratio_by_placement")].is_null()));
}
