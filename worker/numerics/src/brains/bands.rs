//! Split-conformal bands around estimated forces; half-widths come from samples that were used in no fit.
//!
//! ```text
//! n samples exchangeable with the next: the ⌈(n + 1)(1 − a)⌉-th smallest score covers the next sample with probability ≥ 1 − a
//! `instant`   score |f − f̂| per instant and panel              `sample`   score max |f − f̂|/s over a sample
//! s² = mean of (f − f̂)² on the training samples at this instant and panel, plus a tenth of its mean over instants
//! ```
//! Vovk, Gammerman and Shafer 2005; Lei et al. 2018, doi:10.1080/01621459.2017.1307116; bands over whole curves: Diquigiovanni,
//! Fontana and Vantini 2022, arXiv:2106.01792. Coverage holds for every s.

use crate::trial::Samples;

/// Level 1 − a.
pub const LEVEL: f64 = 0.95;
/// Half-width of a normal distribution's interval at this level, in standard deviations.
pub const Z_95: f64 = 1.96;

/// Share of its mean over instants added to s², which must not vanish where the training samples have no error.
const FLOOR: f64 = 0.1;

/// What a band covers at its level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BandKind {
    /// Each instant of each panel separately.
    Instant,
    /// All instants and panels of a sample together.
    Sample,
    /// Each instant of each panel, by the posterior of an inverse decoder. Half-widths vary per sample and are not stored;
    /// `samples` counts the samples that the model explains.
    Posterior,
}

/// A band f̂ ± half-width.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// What it covers.
    pub kind: BandKind,
    /// Number of calibration samples.
    pub samples: usize,
    /// Half-widths (T, K) (N); empty if there are too few samples for the level.
    pub half_width: Vec<f64>,
}

/// |f − f̂| per sample (N, T, K) (N); infinite for failed samples.
fn residuals(samples: &Samples, predicted: &[f64]) -> Vec<Vec<f64>> {
    let one = samples.sizes.instants * samples.sizes.outputs;
    let of = samples.targets.chunks_exact(one).zip(predicted.chunks_exact(one)).zip(&samples.failed);
    let residual = |((f, said), failed): ((&[f64], &[f64]), &bool)| {
        f.iter().zip(said).map(|(f, said)| if *failed { f64::INFINITY } else { (f - said).abs() }).collect()
    };
    of.map(residual).collect()
}

/// The smallest score that covers the next sample at the level; infinite for too few scores.
fn covering(mut scores: Vec<f64>) -> f64 {
    let rank = ((scores.len() + 1) as f64 * LEVEL - 1e-9).ceil() as usize;
    scores.sort_unstable_by(f64::total_cmp);
    scores.get(rank - 1).copied().unwrap_or(f64::INFINITY)
}

/// s (T, K) (N) from training samples.
fn scale(known: &Samples, predicted: &[f64]) -> Vec<f64> {
    let (one, panels) = (known.sizes.instants * known.sizes.outputs, known.sizes.outputs);
    let mut square = vec![0.0; one];
    for residual in residuals(known, predicted).iter().zip(&known.failed).filter(|(_, failed)| !**failed) {
        square.iter_mut().zip(residual.0).for_each(|(s, r)| *s += r * r);
    }
    let mean = |k: usize| square.iter().skip(k).step_by(panels).sum::<f64>() / known.sizes.instants as f64;
    let means: Vec<f64> = (0..panels).map(mean).collect();
    let count = known.count().max(1) as f64;
    let scale = |(i, s): (usize, &f64)| ((s + FLOOR * means[i % panels]) / count).sqrt();
    square.iter().enumerate().map(scale).map(|s| s.max(f64::MIN_POSITIVE)).collect()
}

impl Band {
    /// Both kinds of band, from training samples and from calibration samples used in no fit, each with their estimates (N, T, K)
    /// (N).
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn conformal(known: (&Samples, &[f64]), calibration: (&Samples, &[f64])) -> [Self; 2] {
        let (scale, residuals) = (scale(known.0, known.1), residuals(calibration.0, calibration.1));
        let instant = (0..scale.len()).map(|i| covering(residuals.iter().map(|r| r[i]).collect()));
        let most = |r: &Vec<f64>| r.iter().zip(&scale).map(|(r, s)| r / s).fold(0.0, f64::max);
        let factor = covering(residuals.iter().map(most).collect());
        let band = |kind, half_width: Vec<f64>| {
            let bounded = half_width.iter().all(|h| h.is_finite());
            let half_width = if bounded { half_width } else { Vec::new() };
            Self { kind, samples: residuals.len(), half_width }
        };
        [
            band(BandKind::Instant, instant.collect()),
            band(BandKind::Sample, scale.iter().map(|s| factor * s).collect()),
        ]
    }

    /// Share of instants and panels, or of samples, inside the band, over the samples from `first` on. `None` without samples or
    /// half-widths.
    pub fn coverage(&self, samples: &Samples, predicted: &[f64], first: usize) -> Option<f64> {
        let within = |residual: &Vec<f64>| {
            let inside = residual.iter().zip(&self.half_width).filter(|(r, h)| r <= h).count();
            match self.kind {
                BandKind::Instant | BandKind::Posterior => inside as f64 / residual.len() as f64,
                BandKind::Sample => f64::from(inside == residual.len()),
            }
        };
        let parts: Vec<f64> = residuals(samples, predicted)[first..].iter().map(within).collect();
        let some = !self.half_width.is_empty() && !parts.is_empty();
        some.then(|| parts.iter().sum::<f64>() / parts.len() as f64)
    }

    /// Mean width over instants and panels (N); `None` without half-widths.
    pub fn width(&self) -> Option<f64> {
        let sum = self.half_width.iter().sum::<f64>();
        (!self.half_width.is_empty()).then(|| 2.0 * sum / self.half_width.len() as f64)
    }
}

#[cfg(test)]
mod tests;
