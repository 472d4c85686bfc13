//! Training of the network by Adam (Kingma and Ba 2015), and its outcomes.

use super::data::Batch;
use super::kernels::Real;
use super::network::{Workspace, loss_gradient};

/// State of Adam: moments and number of steps. β₁ = 0.9; ε = 1e-8 is added to the root of the bias-corrected second moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Adam<F> {
    /// First moment.
    pub m: Vec<F>,
    /// Second moment.
    pub v: Vec<F>,
    /// Steps taken.
    pub t: u64,
}

impl<F: Real> Adam<F> {
    /// Zero moments.
    pub fn new(weights: usize) -> Self {
        Self { m: vec![F::ZERO; weights], v: vec![F::ZERO; weights], t: 0 }
    }

    /// One step along the negative gradient with β₂ = 0.999.
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn step(&mut self, weights: &mut [F], gradient: &[F], rate: f64) {
        self.step_with(weights, gradient, rate, 0.999);
    }

    /// One step with β₂ = `beta`, which must be the same in all calls.
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn step_with(&mut self, weights: &mut [F], gradient: &[F], rate: f64, beta: f64) {
        let n = self.m.len();
        assert!(weights.len() == n && gradient.len() == n && self.v.len() == n, "{n} moments");
        self.t += 1;
        let correction = |beta: f64| 1.0 - beta.powf(self.t as f64);
        let step = F::from_f64(-rate / correction(0.9));
        let root = F::from_f64(1.0 / correction(beta).sqrt());
        let [b1, b2, a1, a2, epsilon] = [0.9, beta, 0.1, 1.0 - beta, 1e-8].map(F::from_f64);
        for i in 0..n {
            let g = gradient[i];
            let (m, v) = (b1 * self.m[i] + a1 * g, b2 * self.v[i] + a2 * g * g);
            (self.m[i], self.v[i]) = (m, v);
            weights[i] += step * m / (v.sqrt() * root + epsilon);
        }
    }
}

/// Outcome of a training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrainOutcome {
    /// Completed.
    Ok,
    /// All units of this hidden layer (1 … n − 1) were inactive in all samples. Its gradient then stays zero; training stopped.
    DeadLayer(usize),
    /// The loss exceeded a hundred times both the initial loss and the loss of the prediction 0; training stopped.
    Diverged,
    /// The loss was NaN or infinite. The weights are the last with a finite loss.
    NonFinite,
}

impl TrainOutcome {
    /// Name in records.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::DeadLayer(_) => "dead_layer",
            Self::Diverged => "diverged",
            Self::NonFinite => "loss_non_finite",
        }
    }
}

/// Takes Adam steps on the whole batch at the rates `schedule(i)`, i = 0…, and appends the loss before each step to `losses`.
///
/// After `Ok` and `iterations` steps, moments and weights are those of an uninterrupted run: calls can be chained.
pub fn train<F: Real>(
    weights: &mut [F],
    adam: &mut Adam<F>,
    batch: Batch<F>,
    schedule: &dyn Fn(usize) -> f64,
    iterations: usize,
    losses: &mut Vec<f32>,
    ws: &mut Workspace<F>,
    pool: &crate::Pool,
) -> TrainOutcome {
    let mut more = Vec::new();
    let same = |_: usize| batch;
    let outcome = train_on(weights, adam, &same, schedule, iterations, &mut more, ws, pool, &mut |_, _| true);
    losses.append(&mut more);
    outcome.expect("train never pauses")
}

/// As [`train`], with a separate batch per iteration. `losses` contains the losses of completed iterations; the remaining ones of
/// `iterations` follow, with the same results bit by bit as without a pause. For each iteration with a finite loss, calls `watch` with its
/// number (from 0) and the weights before its step. If `watch` returns `false`, pauses before this iteration and returns `None`.
pub fn train_on<'a, F: Real>(
    weights: &mut [F],
    adam: &mut Adam<F>,
    batch: &dyn Fn(usize) -> Batch<'a, F>,
    schedule: &dyn Fn(usize) -> f64,
    iterations: usize,
    losses: &mut Vec<f32>,
    ws: &mut Workspace<F>,
    pool: &crate::Pool,
    watch: &mut dyn FnMut(usize, &[F]) -> bool,
) -> Option<TrainOutcome> {
    let shape = ws.shape;
    let n = shape.layers();
    let mut gradient = vec![F::ZERO; weights.len()];
    // after a pause, the loss of these weights is finite, as before the pause
    let mut last = weights.to_vec();
    losses.reserve(iterations.saturating_sub(losses.len()));
    for i in losses.len()..iterations {
        let batch = batch(i);
        let loss = loss_gradient(weights, batch, &mut gradient, ws, pool);
        if !loss.is_finite() {
            weights.copy_from_slice(&last);
            return Some(TrainOutcome::NonFinite);
        }
        if !watch(i, weights) {
            return None;
        }
        losses.push(loss as f32);
        if loss > 100.0 * f64::from(losses[0]) && loss > 100.0 * batch.target_power() {
            return Some(TrainOutcome::Diverged);
        }
        // The gradient of a dead layer's biases is zero, as is that of the next layer's weights.
        let silent = |block| gradient[shape.range(block)].iter().all(|&g| g == F::ZERO);
        let dead = |layer: &usize| silent(n + layer) && (layer + 1 == n || silent(layer - 1));
        if let Some(layer) = (1..n).rev().find(|layer| loss > 0.0 && dead(layer)) {
            return Some(TrainOutcome::DeadLayer(layer));
        }
        last.copy_from_slice(weights);
        adam.step(weights, &gradient, schedule(i));
    }
    Some(TrainOutcome::Ok)
}

/// A rate that decreases from `rate` to 0 as a cosine over `iterations`.
pub fn cosine(rate: f64, iterations: usize) -> impl Fn(usize) -> f64 {
    move |i| 0.5 * rate * (1.0 + (std::f64::consts::PI * i as f64 / iterations as f64).cos())
}

/// Iterations, counted from 1, at which a curve of `n` points is kept: all up to 200, otherwise about 200, denser at the start.
pub fn milestones(n: usize) -> Vec<usize> {
    const KEPT: usize = 200;
    if n <= KEPT {
        return (1..=n).collect();
    }
    let mut kept: Vec<usize> =
        (0..KEPT).map(|i| (n as f64).powf(i as f64 / (KEPT - 1) as f64).round() as usize).collect();
    kept.dedup();
    kept
}
