//! Deviations of a cast's chips: each is rotated in the plane, and each channel has a gain.
//!
//! ```text
//! (a_x, a_y)′ = diag(g_x, g_y) R(−φ) (a_x, a_y)      ω′ = g_ω ω      g = e^{σz}
//! ```

/// The chips of one cast.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Chips {
    /// g per channel (3M); empty if gains are exact.
    pub gain: Vec<f64>,
    /// φ per chip (M) (rad); empty if none is rotated.
    pub turn: Vec<f64>,
}

impl Chips {
    /// Replaces signals (N, T, 3M) by the chips' readings.
    pub(crate) fn read(&self, signals: &mut [f64]) {
        self.rotate(signals, -1.0);
        self.amplify(signals);
    }

    /// Replaces a cotangent (N, T, 3M) on the readings by that on the signals.
    pub(crate) fn read_vjp(&self, cotangent: &mut [f64]) {
        self.amplify(cotangent);
        self.rotate(cotangent, 1.0);
    }

    /// Gradient in ln g and φ, for the readings `read` and a cotangent (N, T, 3M) on them.
    pub(crate) fn own_vjp(&self, read: &[f64], cotangent: &[f64]) -> Self {
        let mut gain = vec![0.0; self.gain.len()];
        let mut turn = vec![0.0; self.turn.len()];
        let channels = gain.len().max(3 * turn.len()).max(1);
        let by = |channel: usize| self.gain.get(channel).copied().unwrap_or(1.0);
        for (read, bar) in read.chunks_exact(channels).zip(cotangent.chunks_exact(channels)) {
            gain.iter_mut().zip(read).zip(bar).for_each(|((sum, a), bar)| *sum += a * bar);
            for (chip, sum) in turn.iter_mut().enumerate() {
                let (x, y) = (3 * chip, 3 * chip + 1);
                *sum += bar[x] * by(x) * read[y] / by(y) - bar[y] * by(y) * read[x] / by(x);
            }
        }
        Self { gain, turn }
    }

    fn amplify(&self, values: &mut [f64]) {
        values.iter_mut().zip(self.gain.iter().cycle()).for_each(|(value, gain)| *value *= gain);
    }

    /// Rotates by φ of each chip times `way`.
    fn rotate(&self, values: &mut [f64], way: f64) {
        let turns: Vec<(f64, f64)> = self.turn.iter().map(|turn| (way * turn).sin_cos()).collect();
        for (reading, (s, c)) in values.chunks_exact_mut(3).zip(turns.iter().cycle()) {
            let (x, y) = (reading[0], reading[1]);
            (reading[0], reading[1]) = (c * x - s * y, s * x + c * y);
        }
    }
}
