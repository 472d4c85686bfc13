//! A decoder's layers in integers: weights of 8 or 16 bits with a scale per output, values between layers of 16 bits.
//!
//! ```text
//! x = q_x s_x     w s_x = q_w s_w     y = (q_b + Σ q_w q_x) s_w     next q = min(⌊(max(Σ, 0) · factor + 2^(shift − 1)) / 2^shift⌋, 32767)
//! linear layer of a stacked decoder: next q = q_x[t], then sign(Σ) times the above for |Σ|
//! s_x: HEADROOM · (greatest value in training samples)/32767 per channel     s_w: max |w s_x|/127 or /32767 per output
//! ```
//! Sums have 32 bits if no input can make them overflow, else 64. Scales depend on training samples only.

use super::{Convolution, Replay, SinglePrecision};

/// Ratio of full scale to the greatest training value, for stronger forces than those of training.
const HEADROOM: f64 = 4.0;
/// Largest ratio of scales within a layer: channels that are silent in training may respond later.
const DORMANT: f64 = 256.0;
/// Least full scale: keeps the scales of silent channels within the range of a device's floats.
const LEAST: f64 = 1e-30;
/// Largest size of a bias (bits). Scales of weights are raised to keep it.
const BIAS_BITS: i32 = 29;
/// Largest reading or activation.
const GREATEST: i64 = i16::MAX as i64;

/// Integers of a layer.
#[derive(Debug, Clone, PartialEq)]
pub struct Rescaled {
    /// q_w, in the order of the layer's weights.
    pub weights: Vec<i64>,
    /// q_b.
    pub bias: Vec<i64>,
    /// Factor per output for the next layer; empty in the last layer.
    pub factor: Vec<i64>,
    /// Shift per output, 1 … 62; empty in the last layer.
    pub shift: Vec<u32>,
}

/// A decoder in integers.
#[derive(Debug, Clone, PartialEq)]
pub struct Integers {
    shape: Vec<Convolution>,
    /// Integers per layer.
    pub layers: Vec<Rescaled>,
    /// 2/s_x per channel: converts readings to half steps, which are then rounded to steps.
    pub half_steps: Vec<f32>,
    /// s_w of the last layer: force (N) per unit of its sums.
    pub forces: Vec<f32>,
    /// Upper bound on the magnitude of all sums, for any input.
    pub bound: i64,
    greatest: i64,
}

impl Integers {
    /// Quantises layers to weights of −`most` … `most` (127 or 32767), scaled by the training samples of a replay.
    ///
    /// # Panics
    /// If a sum could exceed 2^61.
    pub fn new(layers: &[Convolution], most: i64, replay: &Replay) -> Self {
        Self::quantise(layers, most, GREATEST, HEADROOM, replay)
    }

    /// As `new`, with readings and activations of −`greatest` … `greatest`.
    fn quantise(layers: &[Convolution], most: i64, greatest: i64, headroom: f64, replay: &Replay) -> Self {
        let channel_maxima = reached(layers, replay);
        let steps = |channels: &[f64]| -> Vec<f64> {
            let most = channels.iter().copied().fold(LEAST, f64::max);
            let step = |reached: &f64| headroom * reached.max(most / DORMANT) / greatest as f64;
            channels.iter().map(step).collect()
        };
        let half_steps: Vec<f32> = steps(&channel_maxima[0]).iter().map(|step| (2.0 / step) as f32).collect();
        // Steps from the rounded values, which the device uses.
        let readings: Vec<f64> = half_steps.iter().map(|half| 2.0 / f64::from(*half)).collect();
        // Channels that are passed on unchanged keep their steps.
        let carried = |l: usize| if layers[l].linear { layers[l].inputs } else { 0 };
        let next =
            |l: usize| [&readings[..carried(l)], &steps(&channel_maxima[l + 1][carried(l)..])].concat();
        let later = (0..layers.len() - 1).map(next);
        let mut steps: Vec<Vec<f64>> = std::iter::once(readings.clone()).chain(later).collect();
        let (mut made, mut forces, mut bound) = (Vec::new(), Vec::new(), 0);
        for (l, layer) in layers.iter().enumerate() {
            let scaled_weight = |i: usize| layer.weights[i] * steps[l][layer.of_weight(i)[0]];
            let output = |i: usize| layer.of_weight(i)[1];
            let mut scale: Vec<f64> =
                layer.bias.iter().map(|b| (b.abs() / 2f64.powi(BIAS_BITS)).max(f64::MIN_POSITIVE)).collect();
            for i in 0..layer.weights.len() {
                scale[output(i)] = scale[output(i)].max(scaled_weight(i).abs() / most as f64);
            }
            if l + 1 == layers.len() {
                forces = scale.iter().map(|scale| *scale as f32).collect();
            }
            let weights =
                (0..layer.weights.len()).map(|i| (scaled_weight(i) / scale[output(i)]).round() as i64);
            let weights: Vec<i64> = weights.collect();
            let bias: Vec<i64> =
                layer.bias.iter().zip(&scale).map(|(b, scale)| (b / scale).round() as i64).collect();
            let mut sums: Vec<i64> = bias.iter().map(|b| b.abs()).collect();
            for (i, w) in weights.iter().enumerate() {
                let [_, o, tap] = layer.of_weight(i);
                sums[o] += w.abs() * layer.spans[tap] as i64 * greatest;
            }
            let max_sum = sums.into_iter().max().expect("a layer has outputs");
            bound = max_sum.max(bound);
            let (mut factor, mut shift) = (Vec::new(), Vec::new());
            if let Some(next) = steps.get_mut(l + 1) {
                for (step, scale) in next[carried(l)..].iter_mut().zip(&scale) {
                    // At least the resolution of the sums.
                    *step = step.max(*scale);
                    let (f, s) = ratio(scale / *step, max_sum);
                    factor.push(f);
                    shift.push(s);
                }
            }
            made.push(Rescaled { weights, bias, factor, shift });
        }
        Self { shape: layers.to_vec(), layers: made, half_steps, forces, bound, greatest }
    }

    /// Sums of the last layer (T, K) for the signals (T, channels) of a sample; multiplied by `forces` they are forces (N).
    pub fn sums(&self, signals: &[f64]) -> Vec<i64> {
        let mut x: Vec<i64> = signals
            .iter()
            .zip(self.half_steps.iter().cycle())
            .map(|(reading, half)| self.steps(*reading as f32 * half))
            .collect();
        for (layer, numbers) in self.shape.iter().zip(&self.layers) {
            let mut y = layer.sums(&numbers.weights, &numbers.bias, &x);
            if !numbers.factor.is_empty() {
                for (i, y) in y.iter_mut().enumerate() {
                    let (factor, shift) =
                        (numbers.factor[i % layer.outputs], numbers.shift[i % layer.outputs]);
                    let kept = if layer.linear { *y } else { (*y).max(0) };
                    let most = (kept.abs() * factor + (1 << (shift - 1))) >> shift;
                    *y = kept.signum() * most.min(self.greatest);
                }
                y = layer.handed_on(&x, y);
            }
            x = y;
        }
        x
    }

    /// Forces (T, K) (N) for the signals (T, channels) of a sample.
    pub fn read(&self, signals: &[f64]) -> Vec<f32> {
        self.forces_of(&self.sums(signals))
    }

    /// Forces (T, K) (N) from the sums of the last layer.
    pub fn forces_of(&self, sums: &[i64]) -> Vec<f32> {
        sums.iter().zip(self.forces.iter().cycle()).map(|(sum, force)| *sum as f32 * force).collect()
    }

    /// Rounds half steps to the nearest step. The only float operation is one multiplication, which no compiler can fuse with an
    /// addition.
    fn steps(&self, half: f32) -> i64 {
        let end = 2.0 * self.greatest as f32;
        let half = half.clamp(-end, end) as i64; // NaN becomes 0
        (half + if half < 0 { -1 } else { 1 }) / 2
    }
}

/// Greatest magnitude of each layer's inputs per channel, over the training samples.
fn reached(layers: &[Convolution], replay: &Replay) -> Vec<Vec<f64>> {
    let single = SinglePrecision::new(layers);
    let mut reached: Vec<Vec<f64>> = layers.iter().map(|layer| vec![0.0; layer.inputs]).collect();
    let one = replay.signals.len() / replay.split.len();
    for (_, signals) in
        replay.split.iter().zip(replay.signals.chunks_exact(one)).filter(|(set, _)| **set == 0)
    {
        single.read_by_layers(signals, &mut |l, x| {
            for (i, x) in x.iter().enumerate() {
                let slot = &mut reached[l][i % layers[l].inputs];
                *slot = slot.max(f64::from(x.abs()));
            }
        });
    }
    reached
}

/// Factor (below 2^31) and shift of a ratio of at most 1, as exact as 64-bit products with sums up to `bound` permit.
fn ratio(ratio: f64, bound: i64) -> (i64, u32) {
    let fits = |shift: &u32| {
        let factor = (ratio * 2f64.powi(*shift as i32)).round();
        factor < 2f64.powi(31) && factor * (bound as f64) < 2f64.powi(62)
    };
    let shift = (1..=62).rev().find(fits).expect("sums are shorter than products");
    ((ratio * 2f64.powi(shift as i32)).round() as i64, shift)
}

#[cfg(test)]
mod tests;
