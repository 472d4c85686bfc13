use super::*;

/// Clock with 8 simulated instants per reading of 5 ms.
const CLOCK: Clock = Clock { deviation: 2e-3, finer: 8, step: 5e-3 / 8.0, interval: 5e-3, delay: 0.3e-3 };

fn wave(t: f64, c: usize) -> [f64; 2] {
    let part = |k: usize| {
        let (hertz, phase) = (20.0 * k as f64 + 3.0 * c as f64, 0.7 * (k * c) as f64);
        let angle = std::f64::consts::TAU * hertz;
        [(angle * t + phase).sin(), angle * (angle * t + phase).cos()]
    };
    (1..=6).map(part).fold([0.0; 2], |sum, x| [sum[0] + x[0], sum[1] + x[1]])
}

fn motion() -> Vec<f64> {
    (1..=8 * 40).flat_map(|j| (0..2).map(move |c| wave(j as f64 * CLOCK.step, c)[0])).collect()
}

/// Interpolated values and slopes equal those of the waves; `read_vjp` is the transpose; the second derivative is that of the slope.
#[test]
fn readings_are_the_motion_when_they_were_taken() {
    let motion = motion();
    for offset in [-5.1e-3, -1e-3, 0.0, 1.7e-3, 4.4e-3] {
        let [values, slopes] = [0, 1].map(|derivative| CLOCK.read(&motion, 2, offset, derivative));
        for n in 3..36 {
            for c in 0..2 {
                let [value, slope] = wave((n + 1) as f64 * 5e-3 + offset - CLOCK.delay, c);
                let off = [values[2 * n + c] - value, (slopes[2 * n + c] - slope) / 750.0];
                assert!(off.iter().all(|x| x.abs() < 2e-3), "{offset} {n} {c}: {off:?}");
            }
        }
        let difference = |derivative: usize| {
            let [later, sooner] = [1e-7, -1e-7].map(|by| CLOCK.read(&motion, 2, offset + by, derivative));
            later.into_iter().zip(sooner).map(|(a, b)| (a - b) / 2e-7).collect::<Vec<f64>>()
        };
        for derivative in [1, 2] {
            let exact = CLOCK.read(&motion, 2, offset, derivative);
            let scale = exact.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            let off =
                difference(derivative - 1).iter().zip(&exact).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
            // Slopes jump between polynomials by the interpolation error.
            assert!(off < 2e-3 * scale, "{offset} {derivative}: {off} of {scale}");
        }
        let bar: Vec<f64> = (0..80).map(|i| (1.3 * f64::from(i)).sin()).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (there, back) = (dot(&values, &bar), dot(&motion, &CLOCK.read_vjp(&bar, 2, offset)));
        assert!((there - back).abs() < 1e-10 * there.abs().max(1.0), "{offset}: {there} {back}");
    }
}

/// `settle` recovers offsets despite waves; `slope` is nonzero there and 0 at the bound.
#[test]
fn an_offset_is_found_among_waves() {
    let motion = motion();
    let whiten = |own: &mut [f64]| {
        own.iter_mut().for_each(|x| *x /= 0.1);
        own[..2 * 4].fill(0.0);
        own[2 * 35..].fill(0.0);
    };
    for offset in [-3.3e-3, 0.0, 1.7e-3] {
        let recorded = CLOCK.read(&motion, 2, offset, 0);
        let settled = CLOCK.settle(&motion, &recorded, 2, &whiten);
        assert!((settled - offset).abs() < 2e-6, "{offset}: {settled}");
        assert!(CLOCK.slope(&motion, 2, settled).iter().any(|x| *x != 0.0));
    }
    assert!(CLOCK.slope(&motion, 2, CLOCK.limit()).iter().all(|x| *x == 0.0), "moves at its bound");
}

/// Interpolates a bell of twelve entries at a fraction of 0.4 between them. The error is below 0.5 % of the peak at curvature jumps, far
/// below elsewhere.
#[test]
fn a_smooth_force_is_read_between_its_entries() {
    let bell = |s: f64| (std::f64::consts::PI * ((s - 3.0) / 12.0).clamp(0.0, 1.0)).sin().powi(2);
    let history: Vec<f64> = (0..20).map(|n| bell(n as f64)).collect();
    for n in 0..19 {
        let off = between(&history, n as f64 + 0.4) - bell(n as f64 + 0.4);
        assert!(off.abs() < 5e-3, "{n}: {off}");
        assert_eq!(between(&history, n as f64), history[n]);
    }
    let middle = between(&history, 6.4) - bell(6.4);
    assert!(
        middle.abs() < 1e-4 && between(&history, -0.1) == 0.0 && between(&history, 19.1) == 0.0,
        "{middle}"
    );
}
