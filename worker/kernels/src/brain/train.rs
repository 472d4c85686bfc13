//! Adam (Kingma and Ba 2015) on the network, and the names of what may go wrong.

use super::data::Batch;
use super::kernels::Real;
use super::network::{Workspace, loss_gradient};

/// Moments and count of steps; β₁ = 0.9, ε = 1e-8 added to the root of the bias-corrected second moment.
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
    /// Moments of zero.
    pub fn new(weights: usize) -> Self {
        Self { m: vec![F::ZERO; weights], v: vec![F::ZERO; weights], t: 0 }
    }

    /// One step down the gradient, β₂ = 0.999.
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn step(&mut self, weights: &mut [F], gradient: &[F], rate: f64) {
        self.step_with(weights, gradient, rate, 0.999);
    }

    /// One step down the gradient with another β₂, the same in all calls.
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

/// How a training ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrainOutcome {
    /// As planned.
    Ok,
    /// No unit of this hidden layer (1 … n − 1) fired for any sample: its gradient is zero, so it stays so. Training ended there.
    DeadLayer(usize),
    /// The loss exceeded a hundred times that of the start and of the answer 0. Training ended there.
    Diverged,
    /// NaN or infinity in the loss; the weights are the last whose loss was finite.
    NonFinite,
}

impl TrainOutcome {
    /// As it stands in the record.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::DeadLayer(_) => "dead_layer",
            Self::Diverged => "diverged",
            Self::NonFinite => "loss_non_finite",
        }
    }
}

/// Takes Adam steps on the whole batch, at rate `schedule(i)` for i = 0…; appends the loss before each to `losses`.
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
    outcome.expect("nobody pauses it")
}

/// As [`train`], each iteration on a batch of its own, with the iterations that are left of `iterations` after those whose `losses`
/// are there: a training that has paused goes on to the same bits. Shows `watch` the number, from 0, of each iteration whose loss is finite and the
/// weights before its step; where that says `false`, it pauses before the iteration: `None`.
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
    // Where it goes on after a pause, the loss is finite: it was before.
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
        // A dead layer leaves the weights behind it without a gradient, and its biases without one.
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

/// A rate that falls from `rate` to 0 by a cosine over `iterations`.
pub fn cosine(rate: f64, iterations: usize) -> impl Fn(usize) -> f64 {
    move |i| 0.5 * rate * (1.0 + (std::f64::consts::PI * i as f64 / iterations as f64).cos())
}

/// Iterations, from 1, at which a curve of `n` points is kept: all of a short one, some 200 of a long one, closer
/// together where a loss falls fastest.
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
