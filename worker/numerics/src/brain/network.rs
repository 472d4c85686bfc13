//! Loss, predictions and gradients of the network: one sample forward and backward at a time, while it is in cache.
//!
//! ```text
//! L = 1/(N T K) Σ σ_k² (f̂ − f)²      σ_k² the weights of the outputs, 1 unless `Data` says otherwise
//! ```
//! Threads take chunks of `CHUNK` samples; each chunk has its own sums, added in chunk order.

use super::data::Batch;
use super::kernels::{COLUMNS, Dots, Finish, Kernels, Outer, Product, Start};
use super::layout::{Packed, padded_len, padded_range, unpad};
use super::real::Real;
use super::shape::Shape;
use super::winograd;
use crate::simd::Width;
use rayon::prelude::*;
use std::sync::Mutex;

/// Samples of a chunk: what is summed apart, whatever the number of threads.
pub const CHUNK: usize = 15;

/// Scratch and sums of the sweeps, for one shape. Grows to the largest batch and pool it meets, and then allocates no more.
#[derive(Debug)]
pub struct Workspace<F> {
    pub(super) shape: Shape,
    pub(super) kernels: Kernels<F>,
    pub(super) packed: Packed<F>,
    pub(super) slots: Vec<Slot<F>>,
    pub(super) scratch: Vec<Mutex<Scratch<F>>>,
}

/// What a chunk leaves behind.
#[derive(Debug, Clone, Default)]
pub(super) struct Slot<F> {
    pub gradient: Vec<F>,
    /// Q₀, Q₁, Q₂, −Q₃ of the second layer (`winograd`).
    pub pairs: Vec<F>,
    pub loss: f64,
    pub out: Vec<F>,
}

impl<F: Real> Slot<F> {
    pub fn clear(&mut self) {
        self.gradient.fill(F::ZERO);
        self.pairs.fill(F::ZERO);
        self.out.clear();
    }
}

/// One sample's activations and cotangents; (T + 2, stride) where a convolution reads them, with rows of zeros at the ends.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch<F> {
    pub a1: Vec<F>,
    pub a2: Vec<F>,
    pub out: Vec<F>,
    pub g3: Vec<F>,
    pub g2: Vec<F>,
    pub g1: Vec<F>,
    pub wide: Vec<F>,
    /// a₁ and g₂ as `winograd` multiplies them.
    pub spread1: Vec<F>,
    pub spread2: Vec<F>,
    pub fold2: Vec<F>,
    /// The same of the tangent, empty until a curvature asks.
    pub tangent: Option<Box<Scratch<F>>>,
}

impl<F: Real> Scratch<F> {
    pub fn new(shape: Shape) -> Self {
        let (t, p) = (shape.instants, shape.stride());
        let zeros = |n| vec![F::ZERO; n];
        Self {
            a1: zeros((t + 2) * p),
            a2: zeros(t * p),
            out: zeros(t * shape.outputs),
            g3: zeros(t * shape.outputs),
            g2: zeros((t + 2) * p),
            g1: zeros((t + 2) * p),
            wide: zeros(t * shape.inputs.next_multiple_of(COLUMNS)),
            spread1: zeros(t / 2 * 4 * p),
            spread2: zeros(t / 2 * 4 * p),
            fold2: zeros(t / 2 * 4 * p),
            tangent: None,
        }
    }
}

/// What a pass over a batch leaves in the slots.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Want {
    Loss,
    Outputs,
    Weights,
    Inputs,
    Both,
}

impl<F: Real> Workspace<F> {
    /// For the instruction set of the process.
    pub fn new(shape: Shape) -> Self {
        Self::with_width(shape, Width::chosen())
    }

    /// For this instruction set.
    ///
    /// # Panics
    /// If the machine lacks it, or a size is 0.
    pub fn with_width(shape: Shape, width: Width) -> Self {
        assert!(shape.instants * shape.inputs * shape.width * shape.outputs > 0, "{shape:?}");
        let (kernels, packed) = (F::kernels(width), Packed::zeros(shape));
        Self { shape, kernels, packed, slots: Vec::new(), scratch: Vec::new() }
    }

    /// Runs `task` on every chunk of the batch: (scratch of the thread, slot of the chunk, its samples' positions).
    pub(super) fn over_chunks(
        &mut self,
        batch: Batch<F>,
        pool: &rayon::ThreadPool,
        task: impl Fn(&Kernels<F>, &Packed<F>, &mut Scratch<F>, &mut Slot<F>, std::ops::Range<usize>) + Sync,
    ) {
        assert_eq!(batch.shape(), self.shape, "a batch of another shape");
        let chunks = batch.len().div_ceil(CHUNK);
        let gradient = padded_len(self.shape);
        while self.slots.len() < chunks {
            let pairs = if self.shape.paired() { 4 * self.shape.stride() * self.shape.stride() } else { 0 };
            let (gradient, pairs) = (vec![F::ZERO; gradient], vec![F::ZERO; pairs]);
            self.slots.push(Slot { gradient, pairs, loss: 0.0, out: Vec::new() });
        }
        while self.scratch.len() < pool.current_num_threads() {
            self.scratch.push(Mutex::new(Scratch::new(self.shape)));
        }
        let (kernels, packed, scratch) = (&self.kernels, &self.packed, &self.scratch);
        let slots = &mut self.slots[..chunks];
        pool.install(|| {
            slots.par_iter_mut().with_max_len(1).enumerate().for_each(|(i, slot)| {
                let thread = rayon::current_thread_index().unwrap_or(0);
                let mut scratch = scratch[thread].lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                slot.loss = 0.0;
                task(kernels, packed, &mut scratch, slot, i * CHUNK..batch.len().min((i + 1) * CHUNK));
            });
        });
    }

    fn pass(&mut self, weights: &[F], batch: Batch<F>, want: Want, pool: &rayon::ThreadPool) -> f64 {
        let shape = self.shape;
        self.packed.fill(&self.kernels, shape, weights);
        let elements = batch.len() * shape.instants * shape.outputs;
        self.over_chunks(batch, pool, |kernels, packed, s, slot, samples| {
            slot.clear();
            for i in samples {
                let (x, y) = batch.sample(i);
                forward(kernels, shape, packed, x, s);
                slot.loss += residual(y, batch.output_weights(), elements, s);
                if want == Want::Outputs {
                    slot.out.extend_from_slice(&s.out);
                }
                if matches!(want, Want::Weights | Want::Inputs | Want::Both) {
                    backward(kernels, shape, packed, s);
                }
                if matches!(want, Want::Weights | Want::Both) {
                    add_weight_gradient(kernels, shape, x, s, slot);
                }
                if matches!(want, Want::Inputs | Want::Both) {
                    input_product(kernels, shape, &packed.w1_back, &s.g1, &mut s.wide, Start::Zero);
                    take_inputs(shape, &s.wide, &mut slot.out);
                }
            }
        });
        let chunks = batch.len().div_ceil(CHUNK);
        self.slots[..chunks].iter().map(|slot| slot.loss).sum::<f64>() / elements as f64
    }

    /// The chunks' gradients, summed in order, in the flat order of weights.
    pub(super) fn sum_gradients(&mut self, samples: usize, gradient: &mut [F]) {
        assert_eq!(gradient.len(), self.shape.weights(), "gradient of {:?}", self.shape);
        let Some((first, rest)) = self.slots[..samples.div_ceil(CHUNK)].split_first_mut() else {
            return gradient.fill(F::ZERO);
        };
        let add = |sum: &mut [F], part: &[F]| sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += *part);
        for slot in rest {
            add(&mut first.gradient, &slot.gradient);
            add(&mut first.pairs, &slot.pairs);
        }
        if self.shape.paired() {
            winograd::add_gradient(&first.pairs, &mut first.gradient[padded_range(self.shape, 4)]);
        }
        unpad(self.shape, &first.gradient, gradient);
    }

    /// The chunks' outputs, in order.
    pub(super) fn join_outputs(&self, samples: usize) -> Vec<F> {
        self.slots[..samples.div_ceil(CHUNK)].iter().flat_map(|slot| slot.out.iter().copied()).collect()
    }
}

/// L of the batch.
///
/// # Panics
/// As all functions here: if the workspace is for another shape than the batch, or a length is not of that shape.
pub fn loss<F: Real>(weights: &[F], batch: Batch<F>, ws: &mut Workspace<F>, pool: &rayon::ThreadPool) -> f64 {
    ws.pass(weights, batch, Want::Loss, pool)
}

/// L of the batch; ∂L/∂β into `gradient`, in the flat order. Allocates nothing once the workspace has grown.
pub fn loss_gradient<F: Real>(
    weights: &[F],
    batch: Batch<F>,
    gradient: &mut [F],
    ws: &mut Workspace<F>,
    pool: &rayon::ThreadPool,
) -> f64 {
    let loss = ws.pass(weights, batch, Want::Weights, pool);
    ws.sum_gradients(batch.len(), gradient);
    loss
}

/// L of the batch and ∂L/∂x (N, T, 3M).
pub fn input_gradient<F: Real>(
    weights: &[F],
    batch: Batch<F>,
    ws: &mut Workspace<F>,
    pool: &rayon::ThreadPool,
) -> (f64, Vec<F>) {
    let loss = ws.pass(weights, batch, Want::Inputs, pool);
    (loss, ws.join_outputs(batch.len()))
}

/// L of the batch and ∂L/∂x (N, T, 3M); ∂L/∂β into `gradient`: both in one pass.
pub fn full_gradient<F: Real>(
    weights: &[F],
    batch: Batch<F>,
    gradient: &mut [F],
    ws: &mut Workspace<F>,
    pool: &rayon::ThreadPool,
) -> (f64, Vec<F>) {
    let loss = ws.pass(weights, batch, Want::Both, pool);
    ws.sum_gradients(batch.len(), gradient);
    (loss, ws.join_outputs(batch.len()))
}

/// What the network answers, (N, T, K), in the units of the targets. Targets are not looked at.
pub fn predict<F: Real>(
    weights: &[F],
    batch: Batch<F>,
    ws: &mut Workspace<F>,
    pool: &rayon::ThreadPool,
) -> Vec<F> {
    ws.pass(weights, batch, Want::Outputs, pool);
    ws.join_outputs(batch.len())
}

/// Prepares a padded activation or cotangent for `convolve` and `add_second_layer`.
pub(super) fn spread<F: Real>(kernels: &Kernels<F>, shape: Shape, a: &[F], spread: &mut [F]) {
    if shape.paired() {
        kernels.spread(a, spread, shape.stride());
    }
}

/// c = finish(start + a ∗ w) with the second layer's w, given in panels of both kinds.
pub(super) fn convolve<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    a: &[F],
    spread: &[F],
    [direct, pairs]: [&[F]; 2],
    c: &mut [F],
    start: Start<F>,
    finish: Finish<F>,
) {
    let (columns, rows) = (shape.stride(), shape.instants);
    if shape.paired() {
        let (lda, depth) = (columns, columns);
        kernels.pairs(Product { a: spread, lda, rows, depth, panels: pairs, c, columns, start, finish });
    } else {
        let (lda, depth) = (columns, 3 * columns);
        kernels.product(Product { a, lda, rows, depth, panels: direct, c, columns, start, finish });
    }
}

/// Adds aᵀ·g₂ to the gradient of w₂; `fold` is scratch.
pub(super) fn add_second_layer<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    a: &[F],
    spread: &[F],
    g2: &[F],
    fold: &mut [F],
    slot: &mut Slot<F>,
) {
    let p = shape.stride();
    let (g2, rows) = (&g2[p..(shape.instants + 1) * p], shape.instants / 2);
    if !shape.paired() {
        return add_outer(kernels, shape, a, p, 3 * p, g2, &mut slot.gradient[padded_range(shape, 4)]);
    }
    kernels.fold(g2, fold, p);
    let forms = spread.chunks_exact(rows * p).zip(fold.chunks_exact(rows * p));
    for ((a, b), c) in forms.zip(slot.pairs.chunks_exact_mut(p * p)) {
        kernels.outer(Outer { a, lda: p, rows, depth: p, b, columns: p, c });
    }
}

/// a₁, a₂ and f̂ of one sample.
pub(super) fn forward<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    w: &Packed<F>,
    x: &[F],
    s: &mut Scratch<F>,
) {
    let (p, rows) = (shape.stride(), shape.instants);
    kernels.product(Product {
        a: x,
        lda: shape.inputs,
        rows,
        depth: 3 * shape.inputs,
        panels: &w.w1,
        c: &mut s.a1[p..],
        columns: p,
        start: Start::Bias(w.block(shape, 0)),
        finish: Finish::Relu,
    });
    spread(kernels, shape, &s.a1, &mut s.spread1);
    let (start, finish) = (Start::Bias(w.block(shape, 1)), Finish::Relu);
    if F::REFERENCE_ORDER {
        let panels = &w.w2;
        kernels.product(Product {
            a: &s.a1,
            lda: p,
            rows,
            depth: 3 * p,
            panels,
            c: &mut s.a2,
            columns: p,
            start,
            finish,
        });
    } else {
        convolve(kernels, shape, &s.a1, &s.spread1, [&w.w2, &w.w2_pairs], &mut s.a2, start, finish);
    }
    let (w, bias) = (w.block(shape, 5), w.block(shape, 2));
    kernels.dots(Dots { a: &s.a2, columns: p, rows, w, bias, c: &mut s.out });
}

/// Σ σ² (f̂ − f)² of one sample; g₃ = ∂L/∂f̂ into the scratch.
pub(super) fn residual<F: Real>(y: &[F], output_weights: &[F], elements: usize, s: &mut Scratch<F>) -> f64 {
    let scale = F::from_f64(2.0 / elements as f64);
    let mut sum = 0.0;
    let k = output_weights.len();
    for ((g, out), y) in s.g3.chunks_exact_mut(k).zip(s.out.chunks_exact(k)).zip(y.chunks_exact(k)) {
        for i in 0..k {
            let error = out[i] - y[i];
            let weighted = output_weights[i] * error;
            sum += (weighted * error).to_f64();
            g[i] = scale * weighted;
        }
    }
    sum
}

/// g₂ = ∂L/∂z₂ and g₁ = ∂L/∂z₁ from g₃.
pub(super) fn backward<F: Real>(kernels: &Kernels<F>, shape: Shape, w: &Packed<F>, s: &mut Scratch<F>) {
    last_layer_back(kernels, shape, &w.w3_back, &s.g3, &s.a2, &mut s.g2, Start::Zero);
    spread(kernels, shape, &s.g2, &mut s.spread2);
    let (p, panels) = (shape.stride(), [&w.w2_back[..], &w.w2_back_pairs]);
    convolve(
        kernels,
        shape,
        &s.g2,
        &s.spread2,
        panels,
        &mut s.g1[p..],
        Start::Zero,
        Finish::Gate(&s.a1[p..]),
    );
}

/// g₂ = [a₂ > 0] (start + g₃ w₃ᵀ).
pub(super) fn last_layer_back<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    w3_back: &[F],
    g3: &[F],
    a2: &[F],
    g2: &mut [F],
    start: Start<F>,
) {
    let (p, rows) = (shape.stride(), shape.instants);
    kernels.product(Product {
        a: g3,
        lda: shape.outputs,
        rows,
        depth: shape.outputs,
        panels: w3_back,
        c: &mut g2[p..],
        columns: p,
        start,
        finish: Finish::Gate(a2),
    });
}

/// wide = start + g₁ ∗ w₁ᵀ.
pub(super) fn input_product<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    w1_back: &[F],
    g1: &[F],
    wide: &mut [F],
    start: Start<F>,
) {
    let (p, rows) = (shape.stride(), shape.instants);
    let columns = shape.inputs.next_multiple_of(COLUMNS);
    let finish = Finish::Plain;
    kernels.product(Product {
        a: g1,
        lda: p,
        rows,
        depth: 3 * p,
        panels: w1_back,
        c: wide,
        columns,
        start,
        finish,
    });
}

/// Appends the (T, 3M) that stand in the padded rows of `wide`.
pub(super) fn take_inputs<F: Real>(shape: Shape, wide: &[F], out: &mut Vec<F>) {
    for row in wide.chunks_exact(shape.inputs.next_multiple_of(COLUMNS)) {
        out.extend_from_slice(&row[..shape.inputs]);
    }
}

/// Adds one sample's ∂L/∂β, in the padded order.
pub(super) fn add_weight_gradient<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    x: &[F],
    s: &mut Scratch<F>,
    slot: &mut Slot<F>,
) {
    let (p, k) = (shape.stride(), shape.outputs);
    add_second_layer(kernels, shape, &s.a1, &s.spread1, &s.g2, &mut s.fold2, slot);
    let gradient = &mut slot.gradient;
    add_biases(kernels, shape, &s.g1, &s.g2, &s.g3, gradient);
    add_outer(
        kernels,
        shape,
        x,
        shape.inputs,
        3 * shape.inputs,
        &s.g1[p..],
        &mut gradient[padded_range(shape, 3)],
    );
    add_outer(kernels, shape, &s.g3, k, k, &s.a2, &mut gradient[padded_range(shape, 5)]);
}

/// c += aᵀ·b over the instants.
pub(super) fn add_outer<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    a: &[F],
    lda: usize,
    depth: usize,
    b: &[F],
    c: &mut [F],
) {
    let columns = shape.stride();
    kernels.outer(Outer { a, lda, rows: shape.instants, depth, b, columns, c });
}

/// Adds the sums over the instants of g₁, g₂ (padded) and g₃ to the biases' gradient.
pub(super) fn add_biases<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    g1: &[F],
    g2: &[F],
    g3: &[F],
    gradient: &mut [F],
) {
    kernels.add_rows(g1, &mut gradient[padded_range(shape, 0)]);
    kernels.add_rows(g2, &mut gradient[padded_range(shape, 1)]);
    let b3 = &mut gradient[padded_range(shape, 2)];
    for row in g3.chunks_exact(shape.outputs) {
        b3.iter_mut().zip(row).for_each(|(sum, g)| *sum += *g);
    }
}
