use super::*;
use metasense_numerics::random::Purpose;

/// p of u.
fn part(u: f64) -> f64 {
    (1.0 + (-u).exp()).recip()
}

fn stream(number: u64) -> Stream {
    Stream::new(Purpose::Batch, 3, [number, 0])
}

/// (mean of w ½ |g(u₀) − g(uₙ)|², its standard error) of walks from truths that are drawn from the prior.
fn found(model: &dyn Fn(f64) -> ModelOutput, count: usize) -> [f64; 2] {
    let mut draws = stream(0);
    let truths: Vec<Vec<f64>> =
        (0..count).map(|_| draws.uniform()).map(|p| vec![(p / (1.0 - p)).ln()]).collect();
    let weights: Vec<f64> = truths.iter().map(|u| model(u[0]).weight.exp()).collect();
    let mut all = |at: &[Vec<f64>]| at.iter().map(|u| Some(model(u[0]))).collect();
    let errors: Vec<f64> = walks(truths, &mut all, &mut stream(1))
        .into_iter()
        .zip(weights)
        .map(|(e, w)| w * e.unwrap())
        .collect();
    let mean = errors.iter().sum::<f64>() / count as f64;
    let square: f64 = errors.iter().map(|e| (e - mean).powi(2)).sum();
    [mean, square.sqrt() / count as f64]
}

/// Many readings of the parameter itself: the posterior is normal with variance 1/(n a²), every proposal is accepted, and after
/// four steps a sixteenth of the start remains.
#[test]
fn walks_find_the_known_variance_of_a_linear_model() {
    let model = |u: f64| ModelOutput { readings: vec![50.0 * u; 4], targets: vec![u, 2.0 * u], weight: 0.0 };
    let truth = 5.0 / (4.0 * 2500.0) * (1.0 - PERSISTENCE.powi(STEPS as i32));
    let [mean, deviation] = found(&model, 3000);
    assert!(
        deviation < 0.04 * truth && (mean - truth).abs() < 3.5 * deviation,
        "{mean} ± {deviation}, not {truth}"
    );
}

/// A pulse at a uniformly drawn place, in noise that permits several places: the walks' bound does not exceed the least weighted
/// error by quadrature over all places.
#[test]
fn walks_bound_the_least_error_of_a_place_from_below() {
    // A posterior with one place, and one with several, of which a short walk reaches only its own.
    for (noise, near) in [(0.1, 0.8), (0.5, 0.4)] {
        let pulse = |u: f64| -> Vec<f64> {
            (0..30).map(|n| (-(f64::from(n) - 5.0 - 20.0 * part(u)).powi(2) / 8.0).exp()).collect()
        };
        let model = |u: f64| ModelOutput {
            readings: pulse(u).iter().map(|f| f / noise).collect(),
            targets: pulse(u),
            weight: (1.0 + part(u)).ln(),
        };
        let grid: Vec<ModelOutput> =
            (0..400).map(|i| (f64::from(i) + 0.5) / 400.0).map(|p| model((p / (1.0 - p)).ln())).collect();
        let mut draws = stream(2);
        let mut errors = Vec::new();
        for _ in 0..1000 {
            let truth = &grid[draws.below(400)];
            let x: Vec<f64> = truth.readings.iter().map(|s| s + draws.normal()).collect();
            let density = |seen: &ModelOutput| {
                let off: f64 = seen.readings.iter().zip(&x).map(|(s, x)| (s - x).powi(2)).sum();
                (seen.weight - 0.5 * off).exp()
            };
            let densities: Vec<f64> = grid.iter().map(density).collect();
            let total: f64 = densities.iter().sum();
            let best =
                |n: usize| grid.iter().zip(&densities).map(|(s, d)| d * s.targets[n]).sum::<f64>() / total;
            let error: f64 = (0..30).map(|n| (best(n) - truth.targets[n]).powi(2)).sum();
            errors.push(truth.weight.exp() * error);
        }
        let least = errors.iter().sum::<f64>() / errors.len() as f64;
        let spread = errors.iter().map(|e| (e - least).powi(2)).sum::<f64>().sqrt() / errors.len() as f64;
        let [mean, deviation] = found(&model, 2000);
        let apart = spread.hypot(deviation);
        println!("noise {noise}: least error {least:.5} ± {spread:.5}, walks {mean:.5} ± {deviation:.5}");
        assert!(apart < 0.07 * least, "{apart} of {least}");
        assert!(mean < least + 3.0 * apart && mean > near * least, "{mean} of {least}");
    }
}
