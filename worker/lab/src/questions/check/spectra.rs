//! Frequency responses and natural frequencies of records.
//!
//! ```text
//! H₁ = S_yf S_ff⁻¹      γ_c² = (S_yf S_ff⁻¹ S_fy)_cc / S_cc      sums over records
//! ```
//! Natural frequencies: eigensystem realisation algorithm (Juang and Pappa, J. Guid. Control Dyn. 8, 620, 1985) on the signals after each
//! blow. Poles count if models of two orders agree.

use super::CheckedRecord;
use metasense_numerics::stimuli::anti_aliased;
use nalgebra::{Complex, DMatrix, SymmetricEigen};
use std::f64::consts::TAU;

/// Frequency responses and natural frequencies of records.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectra {
    /// Frequencies (Hz).
    pub frequencies: Vec<f64>,
    /// |H₁| by channel, panel and frequency (mm/s² or rad/s per N).
    pub response: Vec<Vec<Vec<f64>>>,
    /// γ² by channel and frequency; `None` with too few records, when it would always be near 1.
    pub coherence: Option<Vec<Vec<f64>>>,
    /// Frequency (Hz), damping ratio and decay time (s) of each mode.
    pub rings: Vec<[f64; 3]>,
}

/// Highest frequency relative to the sampling rate.
const UP_TO: f64 = 0.45;
/// Least number of records per panel for a coherence.
const FEWEST: usize = 3;
/// Lags of the Hankel matrix; its two orders; largest relative difference of their frequencies.
const LAGS: usize = 24;
const ORDERS: [usize; 2] = [16, 20];
const APART: f64 = 0.03;
/// Largest damping ratio of a mode.
const DAMPED: f64 = 0.25;

/// Spectra of records that last `duration` (s), with `panels` panels.
pub fn spectra(records: &[CheckedRecord], panels: usize, duration: f64) -> Spectra {
    let dt = records.iter().map(|r| r.signals.dt).fold(0.0, f64::max);
    let instants = (duration / dt).round().max(2.0) as usize;
    let channels = records[0].signals.values.len();
    let lines = (UP_TO * instants as f64) as usize;
    let frequencies: Vec<f64> = (1..=lines).map(|n| n as f64 / duration).collect();
    // Per record: (panels and channels) by frequency.
    let transforms: Vec<Vec<Vec<Complex<f64>>>> = records
        .iter()
        .map(|record| {
            let mut all = vec![vec![0.0; instants + 1]; panels];
            for (j, history) in record.force.values.iter().enumerate() {
                all[record.panel.unwrap_or(j)] =
                    anti_aliased(history, record.force.start, record.force.dt, duration, instants);
            }
            let signals = &record.signals;
            let read = |c: usize| (0..=instants).map(|n| signals.at(c, n as f64 * dt)).collect::<Vec<f64>>();
            all.extend((0..channels).map(read));
            all.iter().map(|history| transform(history, &frequencies, dt)).collect()
        })
        .collect();
    let mut response = vec![vec![Vec::new(); panels]; channels];
    let mut coherence = vec![Vec::new(); channels];
    for line in 0..lines {
        let mut sums = DMatrix::<Complex<f64>>::zeros(panels + channels, panels + channels);
        for of in &transforms {
            let x = DMatrix::from_fn(panels + channels, 1, |i, _| of[i][line]);
            sums += &x * x.adjoint();
        }
        let (ff, yf) = (sums.view((0, 0), (panels, panels)), sums.view((panels, 0), (channels, panels)));
        let ridge =
            DMatrix::identity(panels, panels) * Complex::from(1e-9 * ff.trace().re.max(f64::MIN_POSITIVE));
        let Some(inverse) = (ff + ridge).try_inverse() else { continue };
        let h = yf * inverse;
        let explained = &h * yf.adjoint();
        for c in 0..channels {
            (0..panels).for_each(|k| response[c][k].push(h[(c, k)].norm()));
            let own = sums[(panels + c, panels + c)].re;
            coherence[c].push((explained[(c, c)].re / own.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0));
        }
    }
    let enough = records.len() >= FEWEST * panels;
    Spectra { frequencies, response, coherence: enough.then_some(coherence), rings: rings(records) }
}

/// Fourier sums of a history at these frequencies (Hz).
fn transform(history: &[f64], frequencies: &[f64], dt: f64) -> Vec<Complex<f64>> {
    let of = |hertz: &f64| {
        let turn = Complex::new(0.0, -TAU * hertz * dt).exp();
        history.iter().rev().fold(Complex::from(0.0), |sum, y| sum * turn + y)
    };
    frequencies.iter().map(of).collect()
}

fn rings(records: &[CheckedRecord]) -> Vec<[f64; 3]> {
    let channels = records[0].signals.values.len();
    let size = LAGS * channels;
    let mut scale = vec![0.0f64; channels];
    let tails: Vec<(usize, &CheckedRecord)> = records
        .iter()
        .map(|record| {
            let [_, end] = record.blow();
            let first = ((end - record.signals.start) / record.signals.dt).ceil().max(0.0) as usize + 1;
            (first, record)
        })
        .collect();
    for (first, record) in &tails {
        for (scale, y) in scale.iter_mut().zip(&record.signals.values) {
            *scale += y.iter().skip(*first).map(|x| x * x).sum::<f64>();
        }
    }
    let mut sums = DMatrix::<f64>::zeros(size + channels, size + channels);
    for (first, record) in &tails {
        let y = &record.signals.values;
        for n in *first..record.signals.entries().saturating_sub(LAGS) {
            let of = |i: usize, _| {
                y[i % channels][n + i / channels] / scale[i % channels].max(f64::MIN_POSITIVE).sqrt()
            };
            let x = DMatrix::from_fn(size + channels, 1, of);
            sums.ger(1.0, &x.column(0), &x.column(0), 1.0);
        }
    }
    let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(sums);
    let mut order: Vec<usize> = (0..size + channels).collect();
    order.sort_by(|a, b| eigenvalues[*b].total_cmp(&eigenvalues[*a]));
    let dt = records[0].signals.dt;
    let poles = |count: usize| -> Vec<[f64; 3]> {
        let basis =
            DMatrix::from_fn(size + channels, count.min(order.len()), |i, j| eigenvectors[(i, order[j])]);
        let (now, next) = (basis.rows(0, size), basis.rows(channels, size));
        let Ok(inverse) = now.into_owned().pseudo_inverse(1e-12) else { return Vec::new() };
        let found = (inverse * next).complex_eigenvalues();
        let pole = |z: &Complex<f64>| {
            let s = z.ln() / dt;
            [s.norm() / TAU, -s.re / s.norm(), -s.re.recip()]
        };
        let rings = |[hertz, damping, _]: &[f64; 3]| {
            (0.0..DAMPED).contains(damping) && (1.0..UP_TO / dt).contains(hertz)
        };
        let mut poles: Vec<[f64; 3]> = found.iter().filter(|z| z.im > 0.0).map(pole).filter(rings).collect();
        poles.sort_by(|a, b| a[0].total_cmp(&b[0]));
        poles
    };
    let [few, many] = ORDERS.map(poles);
    few.into_iter().filter(|[f, ..]| many.iter().any(|[g, ..]| (f / g - 1.0).abs() < APART)).collect()
}
