//! How well a body's sensors distinguish forces: its linear operator at small motions, before any decoder.
//!
//! ```text
//! y(ω) = G(ω) f(ω) + n(ω),   A(ω) = N^-½ G(ω) S(ω)^½ with singular values s₁ ≥ s₂ ≥ …
//! ```
//! S is the power of the training forces, equal on all panels and independent; N is white noise per channel. For stationary
//! forces, Wiener's filter leaves S Σ 1/(1 + s²), the least of all linear decoders (Kay, Fundamentals of Statistical Signal
//! Processing I, 1993, ch. 12). The information is log₂ Π(1 + s²) bits per frequency (Shannon 1949).

use super::modes::{FrequencyResponse, c64, modes_to, part_of, responses};
use faer::Mat;
use metasense_numerics::dynamics::{AccelerationFrame, Mount, Rest};
use metasense_numerics::trial::{Problem, Size};
use std::f64::consts::TAU;

/// Figures of a body's linear operator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OperatorFigures {
    /// Error of Wiener's filter (% of the forces' power).
    pub error: f64,
    /// Number of distinguishable forces, from 1 to K: exp of the entropy of s²/Σs².
    pub rank: f64,
    /// Condition: s₁ over the K-th, or last, singular value.
    pub condition: f64,
    /// Information (bit/s).
    pub bits: f64,
    /// Energy-weighted mean time of the response to an impulse (s).
    pub memory: f64,
    /// Number of participating modes, (ΣE)²/ΣE², E the energy of a mode's signals over the noise (Bell and Dean 1970,
    /// doi:10.1039/DF9705000055); NaN for a body that can move as a whole.
    pub modes: f64,
}

/// Noise of each channel, relative to its RMS on the initial body, if the trial's sensors have none.
const NOISE: f64 = 0.01;

/// Computes these figures. `rank` and ln `condition` are averaged over frequencies, weighted by the forces' power. Noise is
/// relative to the initial body's signals. Resolution and range are ignored.
///
/// # Panics
/// If the sensors are not yet placed, or the design has the wrong length.
pub fn compute_figures(problem: &Problem, design: &[f64]) -> OperatorFigures {
    assert!(problem.search.is_none(), "the sensors are not in place");
    let scene = &problem.scene;
    let (bins, panels) = (scene.instants / 2, scene.panels.len());
    let frequencies: Vec<f64> = (1..=bins).map(|b| b as f64 / scene.duration).collect();
    let power = power(&problem.targets(&problem.training_and_test()[0]), scene.instants, panels, bins);
    // G per frequency: channels of each sensor in turn, by panels.
    let operators = |rest: &Rest, found: Vec<Vec<Vec<FrequencyResponse>>>| -> Vec<Mat<c64>> {
        let (each, rows) = (problem.channels.len(), problem.channels.len() * scene.sensors.len());
        let figures_at = |(of, &hertz): (&Vec<Vec<FrequencyResponse>>, &f64)| {
            let read = |i: usize, k: usize| {
                let unit = scene.sensors[i / each];
                mounted_response(problem, rest, unit, of[k][i / each], hertz)[problem.channels[i % each]]
            };
            Mat::from_fn(rows, panels, read)
        };
        found.iter().zip(&frequencies).map(figures_at).collect()
    };
    let whole = |rest: &Rest| operators(rest, responses(scene, rest, &scene.sensors, &frequencies));
    let rms = |operators: &[Mat<c64>]| -> Vec<f64> {
        let row = |i: usize| {
            let own = |(g, s): (&Mat<c64>, &f64)| s * (0..panels).map(|k| g[(i, k)].norm_sqr()).sum::<f64>();
            operators.iter().zip(&power).map(own).sum::<f64>().sqrt()
        };
        (0..operators[0].nrows()).map(row).collect()
    };
    let rest = Rest::new(scene, design);
    let own = whole(&rest);
    let scaling = problem.relative_to.as_ref().unwrap_or(&problem.initial);
    let channels = match design == scaling {
        true => rms(&own),
        false => rms(&whole(&Rest::new(scene, scaling))),
    };
    let size = problem.disturbance.map_or(Size::Relative(0.0), |chips| chips.noise);
    let default_noise = |rms: f64| if rms > 0.0 { NOISE * rms } else { f64::INFINITY };
    let sized = size.of(&channels, &problem.channels).into_iter().zip(&channels);
    let noise: Vec<f64> = sized.map(|(own, rms)| if own > 0.0 { own } else { default_noise(*rms) }).collect();
    let energy = |mode| {
        let of_mode = operators(&rest, part_of(mode, scene, &rest, &scene.sensors, &frequencies));
        of_mode.iter().zip(&power).map(|(g, s)| s * squares(g, &noise)).sum::<f64>()
    };
    let most = frequencies.last().copied().unwrap_or(0.0);
    let modes = match modes_to(&rest, scene.layout.units(), most) {
        Ok(modes) => participation(&modes.iter().map(energy).collect::<Vec<_>>()),
        Err(_) => f64::NAN,
    };
    of(&own, &power, &noise, &frequencies, scene.duration, modes)
}

/// Response of a chip at its place on the unit and after its filter, from that of a plain chip on the centroid.
fn mounted_response(
    problem: &Problem,
    rest: &Rest,
    unit: usize,
    [x, y, turn]: FrequencyResponse,
    hertz: f64,
) -> FrequencyResponse {
    let Mount { offset, tilt } = problem.scene.mount.unwrap_or_default();
    // Along the axes of the plain chip.
    let turned = match problem.scene.frame {
        AccelerationFrame::World => rest.turned.get(unit).copied().unwrap_or(0.0),
        AccelerationFrame::Body => 0.0,
    };
    let along = |[x, y]: [c64; 2], angle: f64| {
        let (s, c) = angle.sin_cos();
        [x * c + y * s, y * c - x * s]
    };
    let [rx, ry] = along(offset.map(c64::from), -turned);
    let turning = c64::new(0.0, TAU * hertz) * turn;
    let [x, y] = along([x - turning * ry, y + turning * rx], tilt);
    let passes = problem.disturbance.map_or(c64::from(1.0), |chips| chips.passes(hertz));
    [x, y, turn].map(|channel| channel * passes)
}

/// Σ|G/n|² at a frequency.
fn squares(g: &Mat<c64>, noise: &[f64]) -> f64 {
    let row = |(i, n): (usize, &f64)| (0..g.ncols()).map(|k| g[(i, k)].norm_sqr()).sum::<f64>() / (n * n);
    noise.iter().enumerate().map(row).sum()
}

/// Effective number of these energies: (ΣE)²/ΣE².
fn participation(energies: &[f64]) -> f64 {
    energies.iter().sum::<f64>().powi(2) / energies.iter().map(|e| e * e).sum::<f64>()
}

/// Mean square (N²) of forces (N, T, K) at the frequencies b/D, b = 1 … `bins`; the mean is excluded.
fn power(forces: &[f64], instants: usize, panels: usize, bins: usize) -> Vec<f64> {
    let samples = forces.len() / (instants * panels);
    let scale = 2.0 / (instants * instants * samples * panels) as f64;
    let turn: Vec<c64> = (0..instants).map(|n| c64::cis(-TAU * n as f64 / instants as f64)).collect();
    let of = |b: usize| {
        let sum = |history: usize| {
            let (sample, panel) = (history / panels, history % panels);
            let at = |n: usize| forces[(sample * instants + n) * panels + panel];
            (0..instants).map(|n| turn[b * n % instants] * at(n)).sum::<c64>().norm_sqr()
        };
        // The Nyquist frequency has no conjugate.
        let half = if 2 * b == instants { 0.5 } else { 1.0 };
        half * scale * (0..samples * panels).map(sum).sum::<f64>()
    };
    (1..=bins).map(of).collect()
}

fn of(
    operators: &[Mat<c64>],
    power: &[f64],
    noise: &[f64],
    frequencies: &[f64],
    duration: f64,
    modes: f64,
) -> OperatorFigures {
    let (bins, panels, all) = (power.len(), operators[0].ncols(), power.iter().sum::<f64>());
    let (mut left, mut rank, mut condition, mut bits) = (0.0, 0.0, 0.0, 0.0);
    for (g, s) in operators.iter().zip(power) {
        let white = |i: usize| (s * bins as f64).sqrt() / noise[i];
        let whitened = Mat::from_fn(g.nrows(), panels, |i, k| g[(i, k)] * white(i));
        // NaN if f64 cannot represent the ratio to the noise.
        let values = whitened.singular_values().unwrap_or_else(|_| vec![f64::NAN; panels.min(g.nrows())]);
        let squares: Vec<f64> = values.iter().map(|s| s * s).collect();
        let (sum, last) =
            (squares.iter().sum::<f64>(), squares.iter().copied().fold(f64::INFINITY, f64::min));
        // Without signal, the entropy is 0.
        let entropy = |part: f64| if part > 0.0 { -part * part.ln() } else { 0.0 };
        left += s * (panels as f64 - squares.iter().map(|s| s / (1.0 + s)).sum::<f64>());
        rank += s * squares.iter().map(|s| entropy(s / sum)).sum::<f64>().exp();
        condition += s * 0.5 * (squares[0] / last).ln();
        bits += squares.iter().map(|s| s.ln_1p()).sum::<f64>() / std::f64::consts::LN_2;
    }
    let memory = memory(operators, power, noise, frequencies, duration);
    OperatorFigures {
        error: 100.0 * left / (panels as f64 * all),
        rank: rank / all,
        condition: (condition / all).exp(),
        bits: bits / duration,
        memory,
        modes,
    }
}

/// Energy-weighted mean time, over the noise, of the response to an impulse with the forces' spectrum, within the sample's
/// duration.
fn memory(operators: &[Mat<c64>], power: &[f64], noise: &[f64], frequencies: &[f64], duration: f64) -> f64 {
    let instants = 2 * power.len();
    let (mut late, mut energy) = (0.0, 0.0);
    for n in 0..instants {
        let t = duration * n as f64 / instants as f64;
        let turn: Vec<c64> =
            frequencies.iter().zip(power).map(|(hertz, s)| c64::cis(TAU * hertz * t) * s.sqrt()).collect();
        for (i, noise) in noise.iter().enumerate() {
            for k in 0..operators[0].ncols() {
                let response_value: f64 =
                    operators.iter().zip(&turn).map(|(g, turn)| (g[(i, k)] * turn).re).sum();
                let square = (response_value / noise).powi(2);
                (late, energy) = (late + t * square, energy + square);
            }
        }
    }
    late / energy
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::small::{GOING, on_lattices, small};
    use metasense_numerics::dynamics::{Accuracy, Scene, simulate};
    use metasense_numerics::random::Purpose;
    use metasense_numerics::trial::{ChipErrors, TrainingProtocol};

    /// The forces' power is their mean square about the mean. K panels in K independent channels of equal power have rank K and
    /// condition 1, one copied channel has rank 1. Wiener's error decreases with the noise and is 100 % without signals.
    #[test]
    fn a_body_is_told_by_its_operator() {
        let wave = |n: usize, k: usize| (TAU * 3.0 * n as f64 / 16.0 + k as f64).sin() * (k + 1) as f64;
        let forces: Vec<f64> = (0..16).flat_map(|n| [wave(n, 0), wave(n, 1)]).collect();
        let found = power(&forces, 16, 2, 8);
        assert!((found[2] - 0.5 * (0.5 + 2.0)).abs() < 1e-12 && found.iter().sum::<f64>() - found[2] < 1e-12);

        let one = |of: [[f64; 2]; 2]| vec![Mat::from_fn(2, 2, |i, k| c64::from(of[i][k])); 4];
        let of = |g: [[f64; 2]; 2], noise: f64| {
            super::of(&one(g), &[1.0; 4], &[noise; 2], &[1.0, 2.0, 3.0, 4.0], 1.0, 1.0)
        };
        let apart = of([[1.0, 0.0], [0.0, 1.0]], 0.1);
        assert!((apart.rank - 2.0).abs() < 1e-9 && (apart.condition - 1.0).abs() < 1e-9, "{apart:?}");
        // s² = 4 bins/noise².
        assert!(
            (apart.error - 100.0 / 401.0).abs() < 1e-9 && (apart.bits - 8.0 * 401f64.log2()).abs() < 1e-6
        );
        let alike = of([[1.0, 1.0], [1.0, 1.0]], 0.1);
        assert!((alike.rank - 1.0).abs() < 1e-9 && alike.condition > 1e6, "{alike:?}");
        assert!((alike.error - 50.0 * (1.0 + 1.0 / 1601.0)).abs() < 1e-9, "{alike:?}");
        assert!(of([[1.0, 0.0], [0.0, 1.0]], 1.0).error > apart.error);
        assert!(of([[1e-9, 0.0], [0.0, 1e-9]], 1.0).error > 99.99);
        assert_eq!(participation(&[2.0, 2.0, 0.0, 2.0]), 3.0);
    }

    /// Weak pulses on a body whose motion decays within a sample: spectra of chips off the centroid, rotated, in both frames,
    /// follow from those of plain chips by `mounted_response`.
    #[test]
    fn a_chip_off_its_centroid_hears_what_a_simulation_says() {
        let mut problem = small(TrainingProtocol::Joint(GOING));
        (problem.scene.damping_ratio, problem.scene.duration, problem.scene.instants) = (0.5, 1.5, 6000);
        problem.stimuli.instants = 6000;
        let mut forces = problem.forces(Purpose::Holdout, 0, 1);
        forces.values.iter_mut().for_each(|f| *f *= 1e-5);
        let pool = metasense_numerics::Pool::new(1).expect("a thread");
        let spectrum = |problem: &Problem, hertz: f64| -> FrequencyResponse {
            let solver = problem.solver.at_most(Accuracy(1e-6));
            let found = simulate(&problem.scene, &problem.initial, &forces, &solver, false, &pool);
            let turn = |n: usize| c64::cis(-TAU * hertz * (n + 1) as f64 / 4000.0);
            let of = |c: usize| {
                found.signals.iter().skip(c).step_by(3).enumerate().map(|(n, s)| turn(n) * *s).sum()
            };
            [0, 1, 2].map(of)
        };
        for frame in [AccelerationFrame::World, AccelerationFrame::Body] {
            let plain = Problem { scene: Scene { frame, ..problem.scene.clone() }, ..problem.clone() };
            let mount = Some(Mount { offset: [6.0, -3.0], tilt: 0.7 });
            let mounted = Problem { scene: Scene { mount, ..plain.scene.clone() }, ..problem.clone() };
            let rest = Rest::new(&plain.scene, &plain.initial);
            for hertz in [3.0, 8.0, 15.0] {
                let [read, unmoved] = [&mounted, &plain].map(|of| spectrum(of, hertz));
                let said = mounted_response(&mounted, &rest, 5, unmoved, hertz);
                for c in 0..3 {
                    let near = (said[c] - read[c]).norm() < 2e-3 * unmoved[0].norm().max(unmoved[1].norm());
                    assert!(near, "{frame:?} at {hertz} Hz, channel {c}: {} {}", said[c], read[c]);
                }
                assert!((0..2).any(|c| (read[c] - unmoved[c]).norm() > 0.1 * unmoved[c].norm()));
            }
        }
    }

    /// More sensors and less noise give more information; repeated calls give equal results.
    #[test]
    fn more_sensors_tell_more() {
        let small = small(TrainingProtocol::Joint(GOING));
        for (what, problem) in on_lattices(&small).into_iter().chain([("squares".into(), small.clone())]) {
            check_sensors(&what, problem);
        }
    }

    fn check_sensors(what: &str, mut problem: Problem) {
        let of = |problem: &Problem| compute_figures(problem, &problem.initial);
        let units = problem.scene.layout.placement(0, &problem.scene.clamped)[..2].to_vec();
        problem.scene.sensors = units[..1].to_vec();
        let (one, again) = (of(&problem), of(&problem));
        problem.scene.sensors = units;
        let two = of(&problem);
        let noise = Size::Relative(1e-3);
        problem.disturbance = Some(ChipErrors { noise, ..ChipErrors::NONE });
        let quiet = of(&problem);
        assert_eq!(one, again);
        assert!(one.modes >= 1.0, "{what}: {one:?}");
        assert!(
            one.error > two.error && two.error > quiet.error && quiet.error > 0.0,
            "{what}: {one:?} {two:?} {quiet:?}"
        );
        assert!(one.bits < two.bits && two.bits < quiet.bits);
        assert!((1.0..=2.0).contains(&one.rank) && one.condition >= 1.0);
        assert!(one.memory > 0.0 && one.memory < problem.scene.duration);
    }
}
