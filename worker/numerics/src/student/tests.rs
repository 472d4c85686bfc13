use super::*;

/// One-sided values of printed tables.
#[test]
fn quantiles_of_any_chance() {
    for (freedom, chance, value) in [
        (1, 0.025, 12.7062),
        (2, 0.005, 9.9248),
        (3, 0.001, 10.2145),
        (4, 0.0005, 8.6103),
        (7, 0.05, 1.8946),
        (8, 0.25, 0.7064),
        (11, 0.0005, 4.4370),
        (30, 0.025, 2.0423),
    ] {
        let found = student_above(freedom, chance);
        assert!((found - value).abs() < 1e-4, "{freedom}, {chance}: {found}, not {value}");
        assert!((chance_above(freedom, found) / chance - 1.0).abs() < 1e-9, "{freedom}, {chance}");
    }
}

/// Values of a printed table.
#[test]
fn student_s_quantiles() {
    for (freedom, quantile) in [(1, 12.706), (10, 2.228), (11, 2.201), (30, 2.042), (120, 1.980)] {
        assert!((student(freedom) - quantile).abs() < 2e-3, "{freedom}: {}", student(freedom));
    }
}

/// Values of printed tables.
#[test]
fn quantiles_are_those_of_the_tables() {
    for (degrees, value) in [(9, 2.2622), (19, 2.0930), (100, 1.9840)] {
        let ours = student(degrees);
        assert!((ours - value).abs() < 1e-3, "{degrees}: {ours} against {value}");
    }
}
