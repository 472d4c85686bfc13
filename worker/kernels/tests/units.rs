//! Unit tests of independent parts. Private modules with tests are included here by path, because testing the whole crate
//! would compile its kernels a second time.
#![allow(dead_code, missing_docs, unused_imports, reason = "items that only the crate uses")]

#[path = "../src/lanes.rs"]
mod lanes;
#[path = "../src/dynamics/tsit5/steps.rs"]
mod steps;
#[path = "../src/dynamics/trigonometry.rs"]
mod trigonometry;

use metasense_kernels::body::{Freedom, Layout, Pattern};
use metasense_kernels::brain::{SolveOutcome, conjugate_gradient};
use metasense_kernels::random::{Purpose, Stream};

/// ⟨w, P z⟩ = ⟨Pᵀ w, z⟩, and z has two numbers per free block. With 4 × 3 units tied in pairs along x: 3 · 3 blocks of
/// horizontal groups, 2 · 4 of vertical ones.
#[test]
fn what_is_pulled_back_is_the_transpose_of_what_is_spread() {
    let planar = Layout::planar(4, 3, 15.0, 2.25);
    let kagome = Layout::sheet(&Pattern::kagome(), 4, 3, 15.0, 2.25);
    let hexagons = Layout::circular(&Pattern::triangular(0.4), 5, 15.0, 2.25);
    let mut stream = Stream::new(Purpose::Design, 1, [0, 0]);
    for (layout, tie, frozen, parameters) in [
        (&planar, [1, 1], &[][..], planar.design_len()),
        (&planar, [2, 1], &[], 2 * (3 * 3 + 2 * 4)),
        (&planar, [9, 9], &[], 4),
        (&planar, [1, 1], &[5], planar.design_len() - 8),
        (&planar, [9, 9], &[5], 4),
        // one shift per kind of ligament, also for oblique rows
        (&kagome, [9, 9], &[], 6),
        (&hexagons, [9, 9], &[], 6),
        (&hexagons, [1, 1], &[9], hexagons.design_len() - 12),
    ] {
        let freedom = Freedom::new(layout, tie, frozen);
        assert_eq!(freedom.parameters(), parameters, "{tie:?} {frozen:?}");
        let mut draw = || -> Vec<f64> { (0..layout.design_len()).map(|_| stream.normal()).collect() };
        let (w, initial, mut z) = (draw(), draw(), vec![0.0; layout.design_len()]);
        freedom.coordinates().into_iter().zip(draw()).for_each(|(i, x)| z[i] = x);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let pairs = [dot(&w, &freedom.spread(&z)), dot(&freedom.vjp(&w), &z)];
        assert!((pairs[0] - pairs[1]).abs() < 1e-12 && pairs[0] != 0.0, "{tie:?} {pairs:?}");
        let moved: Vec<f64> = initial.iter().zip(freedom.spread(&z)).map(|(a, b)| a + b).collect();
        let snapped = freedom.snap(&initial, moved.clone());
        let off = snapped.iter().zip(&moved).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-15 * 10.0, "{tie:?}: {off}");
    }
}

/// Equal keys give equal draws; a change in any part of the key changes the draws.
#[test]
fn a_stream_is_its_key() {
    let draw = |p, s, c| Stream::new(p, s, c).uniform();
    let base = draw(Purpose::Stimulus, 1, [2, 3]);
    assert_eq!(base, draw(Purpose::Stimulus, 1, [2, 3]));
    for other in [
        draw(Purpose::Holdout, 1, [2, 3]),
        draw(Purpose::Stimulus, 2, [2, 3]),
        draw(Purpose::Stimulus, 1, [3, 3]),
        draw(Purpose::Stimulus, 1, [2, 4]),
    ] {
        assert_ne!(base, other);
    }
}

/// Mean 0 within four standard errors of 10 000 draws, variance 1 within 0.06.
#[test]
fn normal_draws_have_unit_variance() {
    let mut stream = Stream::new(Purpose::Weights, 7, [0, 0]);
    let draws: Vec<f64> = (0..10_000).map(|_| stream.normal()).collect();
    let mean = draws.iter().sum::<f64>() / 1e4;
    let variance = draws.iter().map(|x| x * x).sum::<f64>() / 1e4;
    assert!(mean.abs() < 0.04 && (variance - 1.0).abs() < 0.06, "{mean} {variance}");
}

fn diagonal<'a>(d: &'a [f64]) -> impl FnMut(&[f64], &mut [f64]) + 'a {
    move |v, out| out.iter_mut().zip(v).zip(d).for_each(|((o, v), d)| *o = d * v)
}

/// The number of iterations equals the number of distinct eigenvalues.
#[test]
fn three_eigenvalues_take_three_iterations() {
    let solve = conjugate_gradient(diagonal(&[1.0, 1.0, 4.0, 9.0]), &[1.0, 2.0, 4.0, 9.0], 0.0, 1e-10, 20);
    assert_eq!((solve.outcome, solve.iterations), (SolveOutcome::Converged, 3), "{solve:?}");
    let error: f64 = solve.z.iter().zip([1.0, 2.0, 1.0, 1.0]).map(|(z, x)| (z - x).abs()).sum();
    assert!(error < 1e-9, "{error}");
}

/// An indefinite matrix stops the iteration with the preceding iterate; a large enough shift avoids this; NaN is reported, not
/// returned.
#[test]
fn negative_curvature_and_nan_are_named() {
    let (d, b) = ([5.0, 1.0, -0.5], [1.0, 1.0, 1.0]);
    let solve = conjugate_gradient(diagonal(&d), &b, 0.0, 1e-10, 20);
    assert_eq!(solve.outcome, SolveOutcome::NegativeCurvature, "{solve:?}");
    assert!(solve.smallest_curvature <= 0.0 && solve.z.iter().all(|z| z.is_finite()), "{solve:?}");
    let solve = conjugate_gradient(diagonal(&d), &b, 1.0, 1e-10, 20);
    assert_eq!(solve.outcome, SolveOutcome::Converged, "{solve:?}");
    let solve = conjugate_gradient(|_, out| out.fill(f64::NAN), &b, 0.0, 1e-10, 20);
    assert_eq!(solve.outcome, SolveOutcome::NonFinite, "{solve:?}");
    assert!(solve.z.iter().all(|&z| z == 0.0), "{solve:?}");
    let solve = conjugate_gradient(diagonal(&d), &[0.0; 3], 0.0, 1e-10, 20);
    assert_eq!((solve.outcome, solve.iterations), (SolveOutcome::Converged, 0), "{solve:?}");
}
