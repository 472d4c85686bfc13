//! Coefficients of the splitting schemes, and factors of damped drifts.

use crate::lanes::Scalar;

/// Coefficients of one step. Both lists are symmetric.
#[derive(Debug, Clone, PartialEq)]
pub struct Scheme {
    /// b: one more than the drifts.
    pub kicks: Vec<f64>,
    /// a.
    pub drifts: Vec<f64>,
}

impl Scheme {
    /// Störmer–Verlet: order 2, 1 force evaluation per step.
    pub fn leapfrog() -> Self {
        Self { kicks: vec![0.5, 0.5], drifts: vec![1.0] }
    }

    /// SRKN₆ᵇ of Blanes and Moan: order 4, 6 force evaluations per step.
    pub fn fourth() -> Self {
        let kicks = symmetric(&[0.0829844064174052, 0.396309801498368, -0.0390563049223486], 1);
        Self { kicks, drifts: symmetric(&[0.245298957184271, 0.60487266571108], 2) }
    }

    /// S₆ of Blanes and Moan: order 4 for arbitrary kicks and drifts, 6 force evaluations per step.
    pub fn any_fourth() -> Self {
        let kicks = symmetric(&[0.0792036964311957, 0.353172906049774, -0.0420650803577195], 1);
        Self { kicks, drifts: symmetric(&[0.209515106613362, -0.143851773179818], 2) }
    }

    /// SRKN₁₁ᵇ of Blanes and Moan: order 6, 11 force evaluations per step.
    pub fn sixth() -> Self {
        let b = [
            0.0414649985182624,
            0.198128671918067,
            -0.0400061921041533,
            0.0752539843015807,
            -0.0115113874206879,
        ];
        let a =
            [0.123229775946271, 0.290553797799558, -0.127049212625417, -0.246331761062075, 0.357208872795928];
        Self { kicks: symmetric(&b, 2), drifts: symmetric(&a, 1) }
    }

    /// Force evaluations per step.
    pub fn stages(&self) -> usize {
        self.drifts.len()
    }
}

/// The coefficients `outer`, then one or two equal ones with which all sum to 1, then `outer` in reverse.
fn symmetric(outer: &[f64], inner: usize) -> Vec<f64> {
    let sum = outer.iter().sum::<f64>();
    let middle = vec![if inner == 1 { 1.0 - 2.0 * sum } else { 0.5 - sum }; inner];
    outer.iter().chain(&middle).chain(outer.iter().rev()).copied().collect()
}

/// e = exp(−γτ) and (1 − e)/γ of a drift over the time τ, and their derivatives in γ.
#[derive(Clone, Copy)]
pub struct Drift<S = f64> {
    /// e.
    pub keep: f64,
    /// 1/e.
    pub restore: f64,
    /// (1 − e)/γ.
    pub reach: f64,
    /// de/dγ.
    pub keep_slope: S,
    /// d((1 − e)/γ)/dγ.
    pub reach_slope: S,
}

impl Drift {
    /// Factors of a drift over the time `tau` at the damping rate `gamma`.
    pub fn new(gamma: f64, tau: f64) -> Self {
        let z = gamma * tau;
        let keep = (-z).exp();
        // (1 − e⁻ᶻ)/z and (z e⁻ᶻ − 1 + e⁻ᶻ)/z², by series where terms cancel
        let (reach, slope) = if z.abs() < 0.3 {
            let (mut reach, mut slope, mut term) = (0.0, 0.0, 1.0);
            for k in 1..16 {
                // term = (−z)^(k−1)/k!
                term *= if k == 1 { 1.0 } else { -z } / k as f64;
                reach += term;
                slope -= term * k as f64 / (k + 1) as f64;
            }
            (reach, slope)
        } else {
            (-(-z).exp_m1() / z, (z * keep + (-z).exp_m1()) / (z * z))
        };
        let (reach, keep_slope, reach_slope) = (tau * reach, -tau * keep, tau * tau * slope);
        Self { keep, restore: z.exp(), reach, keep_slope, reach_slope }
    }

    /// Rounds the slopes to a kernel's scalar type.
    pub fn rounded<S: Scalar>(self) -> Drift<S> {
        let Self { keep, restore, reach, keep_slope, reach_slope } = self;
        let [keep_slope, reach_slope] = [keep_slope, reach_slope].map(S::from_f64);
        Drift { keep, restore, reach, keep_slope, reach_slope }
    }
}
