//! What the property tests share.

pub fn norm(a: &[f64]) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// ‖a − b‖/‖b‖.
pub fn relative(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "lengths");
    let difference: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    let scale = norm(b);
    norm(&difference) / if scale > 0.0 { scale } else { 1.0 }
}

pub fn pool(threads: usize) -> metasense_kernels::Pool {
    metasense_kernels::Pool::new(threads).expect("threads")
}
