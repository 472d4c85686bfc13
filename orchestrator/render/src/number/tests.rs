//! Tests of `number`.

use super::*;

#[test]
fn numbers_have_three_digits_and_no_trailing_zeros() {
    let texts = [20.0, 0.125, 1234.5, 0.000012, 1e-4, 7.0, 1.5, 0.0, f64::NAN].map(number);
    assert_eq!(texts, ["20", "0.125", "1234", "1.2e-5", "1e-4", "7", "1.5", "0", "–"]);
}

#[test]
fn digits_are_as_many_as_asked_for() {
    let texts = [0.012345, 12.345678, 1e-8, -250.0, 0.0].map(|x| digits(x, 4));
    assert_eq!(texts, ["0.01235", "12.35", "1.000e-8", "-250.0", "0"]);
}
