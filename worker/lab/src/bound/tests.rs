use metasense_numerics::nested::{NoObserver, evaluate_designs};
use metasense_numerics::trial::PreparedTrial;
use metasense_worker::problem::problem;

use super::*;

/// A body of 6 × 6 units, random or not, with two panels, sensors on `units` with 3 % noise, seed 11.
fn trial(design: &str, units: &[usize]) -> TrialSpec {
    let json = format!(
        r#"{{"body": {{"columns": 6, "rows": 6, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8, {design}
            "stiffness": {{"stretch": 3.0, "shear": 0.5, "bend": 1.0}}}}, "time": {{}}, "solver": {{}},
            "sensors": {{"noise": 0.03}}, "stimuli": {{"kind": "bell", "samples": 150, "test": 30, "holdout": 60}}, "brain": {{"kind": "linear"}},
            "optimise": {{"brain": "linear"}}, "evaluation": {{}}, "feasible": {{}},
            "point": {{"panels": 2, "sensors": {}, "placement": 0, "seed": 11}}, "panel_units": [31, 34],
            "sensor_units": {units:?}}}"#,
        units.len()
    );
    serde_json::from_str(&json).unwrap()
}

/// The bound does not depend on the solver's tolerance, although a loose tolerance selects f32 forces.
#[test]
fn a_bound_is_that_of_f64() {
    let mean = |tolerance: f64| {
        let mut trial = trial("", &[13]);
        (trial.solver.tolerance, trial.stimuli.samples) = (tolerance, 60);
        let problem = problem(&trial).unwrap();
        super::bound(&trial, &problem.initial, 2, None, 2).unwrap().mean
    };
    let [coarse, fine] = [6e-4, 1e-4].map(mean);
    assert!((coarse / fine - 1.0).abs() < 0.02, "{coarse} {fine}");
}

/// Rank of each value, from 0.
fn ranks(values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| values.iter().filter(|w| *w < v).count() as f64).collect()
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let (p, q) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(a, b)| f(a - p, b - q)).sum::<f64>();
    sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
}

/// Rank correlation between the bound and the error of a linear decoder, over 24 bodies and placements with one to three sensors.
#[test]
#[ignore = "minutes: the figures that MODEL.md and README quote"]
fn bodies_that_can_tell_more_are_read_better() {
    let (mut bounds, mut errors) = (Vec::new(), Vec::new());
    for body in 0..3 {
        let design =
            if body == 0 { String::new() } else { format!("\"design\": {{\"random\": {}}},", 10 + body) };
        for placement in 0..8 {
            let sensors = 1 + placement % 3;
            let layout = metasense_numerics::body::Layout::planar(6, 6, 15.0, 2.25);
            let units = &layout.placement(placement as u64, &layout.bottom())[..sensors];
            let trial = trial(&design, units);
            let problem = problem(&trial).unwrap();
            let found = super::bound(&trial, &problem.initial, 2, None, 2).unwrap();
            let pool = pool(2).unwrap();
            let prepared = PreparedTrial::new(&placed(&problem, &pool).unwrap().0, &pool).unwrap();
            let of = evaluate_designs(&prepared, &[problem.initial], &mut NoObserver);
            let error = of[0].networks[0].error_holdout.unwrap();
            println!(
                "body {body}, units {units:?}: bound {:.3} % ({} directions), linear brain {error:.3} %, without signals {:.1} %",
                found.mean, found.directions, found.prior_only
            );
            bounds.push(found.mean.ln());
            errors.push(error.ln());
        }
    }
    let [by_rank, by_log] = [correlation(&ranks(&bounds), &ranks(&errors)), correlation(&bounds, &errors)];
    let of_equal = |m: usize| {
        let own = |values: &[f64]| -> Vec<f64> {
            values.iter().enumerate().filter(|(i, _)| i % 8 % 3 == m).map(|(_, v)| *v).collect()
        };
        correlation(&ranks(&own(&bounds)), &ranks(&own(&errors)))
    };
    println!("rank correlation {by_rank:.3}, of logarithms {by_log:.3}");
    println!("by rank at one, two and three sensors {:.3?}", [0, 1, 2].map(of_equal));
    assert!(by_rank > 0.5 && bounds.iter().zip(&errors).all(|(b, e)| b < e), "{bounds:?} {errors:?}");
}
