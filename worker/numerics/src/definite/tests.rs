use super::*;
use nalgebra::DVector;

/// A matrix 1 + JᵀJ beyond double precision has its eigenvalues raised to `least`, with both libraries; no element of its inverse
/// exceeds that of 1.
#[test]
fn what_rounding_leaves_below_its_least_eigenvalue_is_solved() {
    for least in [1.0, -1.0] {
        let b = Mat::from_fn(2, 2, |i, j| if i == j { [4.0, least][i] } else { 0.0 });
        let log = half_log(b.as_ref(), 1.0);
        assert!((log - 2f64.ln()).abs() < 1e-12, "{log}");
    }
    let (b, x) =
        (|i, j| if (i, j) == (2, 2) { 1.0 } else { 1e20 }, DVector::from_column_slice(&[1.0, -1.0, 2.0]));
    let found =
        solve_with_floor(Mat::from_fn(3, 3, b).as_ref(), 1.0, matrix(x.as_slice(), 3, 1)).expect("numbers");
    let own = solved_dense(DMatrix::from_fn(3, 3, b), 1.0, &x).expect("numbers");
    let inverse = inverse(DMatrix::from_fn(3, 3, b), 1.0).expect("numbers");
    assert!(found.col(0).iter().all(|x| x.abs() < 10.0), "{found:?}");
    assert!(own.iter().zip(found.col(0).iter()).all(|(a, b)| (a - b).abs() < 1e-12), "{own} {found:?}");
    assert!((inverse * &x - &own).amax() < 1e-12, "{own}");
}

/// Matrices that are not finite have no solution, and the functions return.
#[test]
fn of_what_is_no_number_there_is_no_solution() {
    for wrong in [f64::NAN, f64::INFINITY] {
        for n in [2, 5, 40] {
            let b =
                Mat::from_fn(n, n, |i, j| if i.abs_diff(j) == n - 1 { wrong } else { 1.0 + (i * j) as f64 });
            let dense = DMatrix::from_fn(n, n, |i, j| b[(i, j)]);
            let x = DVector::from_element(n, 1.0);
            assert!(solve_with_floor(b.as_ref(), 1.0, matrix(x.as_slice(), n, 1)).is_none(), "{n} {wrong}");
            assert!(solved_dense(dense.clone(), 1.0, &x).is_none(), "{n} {wrong}");
            assert!(inverse(dense, 1.0).is_none(), "{n} {wrong}");
        }
    }
}
