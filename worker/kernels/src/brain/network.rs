//! Loss, predictions and gradients of the network, one sample at a time, forward and backward, while it is in cache.
//!
//! ```text
//! L = 1/(N T K) Σ σ_k² (f̂ − f)²      σ_k² the weights of the outputs, 1 unless set in `Data`
//! ```
//! Threads process chunks of `CHUNK` samples. Each chunk has its own sums, which are added in the order of chunks.

use super::data::Batch;
use super::kernels::{Kernels, Real};
use super::layout::{Packed, Panels, padded_len, padded_range, pairs_range, unpad};
use super::shape::{Convolution, Shape};
use super::tiles::{Dots, Finish, Outer, Product, Start};
use super::winograd;
use crate::simd::Width;
use rayon::prelude::*;
use std::sync::Mutex;

/// Samples per chunk. Sums per chunk make results independent of the number of threads.
pub const CHUNK: usize = 15;

/// Scratch memory and sums for one shape. Grows to the largest batch and pool used; then allocates no more.
#[derive(Debug)]
pub struct Workspace<F> {
    pub(super) shape: Shape,
    pub(super) kernels: Kernels<F>,
    pub(super) packed: Packed<F>,
    pub(super) chunks: Vec<Chunk<F>>,
    pub(super) scratch: Vec<Mutex<Scratch<F>>>,
}

/// Results of a chunk.
#[derive(Debug, Clone, Default)]
pub(super) struct Chunk<F> {
    pub gradient: Vec<F>,
    /// Q₀, Q₁, Q₂, −Q₃ of the layers computed by `winograd`.
    pub pairs: Vec<F>,
    pub loss: f64,
    pub out: Vec<F>,
}

impl<F: Real> Chunk<F> {
    pub fn clear(&mut self) {
        self.gradient.fill(F::ZERO);
        self.pairs.fill(F::ZERO);
        self.out.clear();
    }
}

/// Activations and cotangents of one sample, padded by the rows of zeros that convolutions read (`Conv`).
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch<F> {
    /// a₁ … a_(n−1).
    pub a: Vec<Vec<F>>,
    pub out: Vec<F>,
    /// g_l = ∂L/∂z_l, l = 1 … n, z_l the input of the ReLU of layer l.
    pub g: Vec<Vec<F>>,
    pub wide: Vec<F>,
    /// Inputs and cotangents of the layers computed by `winograd`, transformed.
    pub spread_a: Vec<Vec<F>>,
    pub spread_g: Vec<Vec<F>>,
    pub fold: Vec<F>,
    /// Scratch memory of the tangent; allocated by the first curvature product.
    pub tangent: Option<Box<Scratch<F>>>,
}

impl<F: Real> Scratch<F> {
    pub fn new(shape: Shape) -> Self {
        let (t, n) = (shape.instants, shape.layers());
        let each = |length: &dyn Fn(usize) -> usize| -> Vec<Vec<F>> {
            (0..n).map(|l| vec![F::ZERO; length(l)]).collect()
        };
        let forms = |l: usize| if shape.conv(l).paired { 2 * t * shape.stride() } else { 0 };
        Self {
            a: (1..n).map(|l| vec![F::ZERO; shape.conv(l).input_len()]).collect(),
            out: vec![F::ZERO; t * shape.outputs],
            g: each(&|l| shape.conv(l).output_len()),
            wide: vec![F::ZERO; t * shape.conv(0).back().columns],
            spread_a: each(&forms),
            spread_g: each(&forms),
            fold: vec![F::ZERO; (0..n).map(forms).max().unwrap_or(0)],
            tangent: None,
        }
    }
}

/// Requested results of a pass over a batch.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Request {
    Loss,
    Outputs,
    Weights,
    Inputs,
    Both,
}

impl<F: Real> Workspace<F> {
    /// Scratch memory for this instruction set.
    ///
    /// # Panics
    /// If the machine does not support `width`, or a size is 0.
    pub fn new(shape: Shape, width: Width) -> Self {
        assert!(shape.instants * shape.inputs * shape.outputs > 0, "{shape:?}");
        let (kernels, packed) = (F::kernels(width), Packed::zeros(shape));
        Self { shape, kernels, packed, chunks: Vec::new(), scratch: Vec::new() }
    }

    /// Runs `task` on every chunk of the batch: (scratch memory of the thread, results of the chunk, positions of its
    /// samples).
    pub(super) fn over_chunks(
        &mut self,
        batch: Batch<F>,
        pool: &crate::Pool,
        task: impl Fn(&Kernels<F>, &Packed<F>, &mut Scratch<F>, &mut Chunk<F>, std::ops::Range<usize>) + Sync,
    ) {
        assert_eq!(batch.shape(), self.shape, "shapes of batch and workspace differ");
        let count = batch.len().div_ceil(CHUNK);
        let last = self.shape.layers() - 1;
        let (gradient, pairs) = (padded_len(self.shape), pairs_range(self.shape, last).end);
        while self.chunks.len() < count {
            let (gradient, pairs) = (vec![F::ZERO; gradient], vec![F::ZERO; pairs]);
            self.chunks.push(Chunk { gradient, pairs, loss: 0.0, out: Vec::new() });
        }
        while self.scratch.len() < pool.threads() {
            self.scratch.push(Mutex::new(Scratch::new(self.shape)));
        }
        let (kernels, packed, scratch) = (&self.kernels, &self.packed, &self.scratch);
        let chunks = &mut self.chunks[..count];
        pool.install(|| {
            chunks.par_iter_mut().with_max_len(1).enumerate().for_each(|(i, chunk)| {
                let thread = rayon::current_thread_index().unwrap_or(0);
                let mut scratch = scratch[thread].lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                chunk.loss = 0.0;
                pool.heartbeat().beat();
                task(kernels, packed, &mut scratch, chunk, i * CHUNK..batch.len().min((i + 1) * CHUNK));
            });
        });
    }

    fn pass(&mut self, weights: &[F], batch: Batch<F>, want: Request, pool: &crate::Pool) -> f64 {
        let shape = self.shape;
        self.packed.fill(&self.kernels, shape, weights);
        let elements = batch.len() * shape.instants * shape.outputs;
        self.over_chunks(batch, pool, |kernels, packed, s, chunk, samples| {
            chunk.clear();
            for i in samples {
                let (x, y) = batch.sample(i);
                forward(kernels, shape, packed, x, s);
                chunk.loss += residual(shape, y, batch.output_weights(), elements, s);
                if want == Request::Outputs {
                    chunk.out.extend_from_slice(&s.out);
                }
                if matches!(want, Request::Weights | Request::Inputs | Request::Both) {
                    backward(kernels, shape, packed, s);
                }
                if matches!(want, Request::Weights | Request::Both) {
                    add_weight_gradient(kernels, shape, x, s, chunk);
                }
                if matches!(want, Request::Inputs | Request::Both) {
                    input_product(kernels, shape, packed, &s.g[0], &mut s.wide, Start::Zero);
                    take_inputs(shape, &s.wide, &mut chunk.out);
                }
            }
        });
        self.chunks[..batch.len().div_ceil(CHUNK)].iter().map(|chunk| chunk.loss).sum::<f64>()
            / elements as f64
    }

    /// Sums the gradients of the chunks in order, in the flat order of weights.
    pub(super) fn sum_gradients(&mut self, samples: usize, gradient: &mut [F]) {
        assert_eq!(gradient.len(), self.shape.weights(), "gradient of {:?}", self.shape);
        let Some((first, rest)) = self.chunks[..samples.div_ceil(CHUNK)].split_first_mut() else {
            return gradient.fill(F::ZERO);
        };
        let add = |sum: &mut [F], part: &[F]| sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += *part);
        for chunk in rest {
            add(&mut first.gradient, &chunk.gradient);
            add(&mut first.pairs, &chunk.pairs);
        }
        for l in (0..self.shape.layers()).filter(|&l| self.shape.conv(l).paired) {
            let weights = padded_range(self.shape, self.shape.layers() + l);
            winograd::add_gradient(&first.pairs[pairs_range(self.shape, l)], &mut first.gradient[weights]);
        }
        unpad(self.shape, &first.gradient, gradient);
    }

    /// Concatenates the outputs of the chunks.
    pub(super) fn join_outputs(&self, samples: usize) -> Vec<F> {
        self.chunks[..samples.div_ceil(CHUNK)].iter().flat_map(|chunk| chunk.out.iter().copied()).collect()
    }
}

/// L of the batch.
///
/// # Panics
/// As all functions here: if the shapes of workspace and batch differ, or a length does not match the shape.
pub fn loss<F: Real>(weights: &[F], batch: Batch<F>, ws: &mut Workspace<F>, pool: &crate::Pool) -> f64 {
    ws.pass(weights, batch, Request::Loss, pool)
}

/// Returns L of the batch and writes ∂L/∂β to `gradient`, in the flat order. Allocates nothing once the workspace has
/// grown.
pub fn loss_gradient<F: Real>(
    weights: &[F],
    batch: Batch<F>,
    gradient: &mut [F],
    ws: &mut Workspace<F>,
    pool: &crate::Pool,
) -> f64 {
    let loss = ws.pass(weights, batch, Request::Weights, pool);
    ws.sum_gradients(batch.len(), gradient);
    loss
}

/// L of the batch and ∂L/∂x (N, T, 3M).
pub fn input_gradient<F: Real>(
    weights: &[F],
    batch: Batch<F>,
    ws: &mut Workspace<F>,
    pool: &crate::Pool,
) -> (f64, Vec<F>) {
    let loss = ws.pass(weights, batch, Request::Inputs, pool);
    (loss, ws.join_outputs(batch.len()))
}

/// Returns L of the batch and ∂L/∂x (N, T, 3M), and writes ∂L/∂β to `gradient`, in one pass.
pub fn full_gradient<F: Real>(
    weights: &[F],
    batch: Batch<F>,
    gradient: &mut [F],
    ws: &mut Workspace<F>,
    pool: &crate::Pool,
) -> (f64, Vec<F>) {
    let loss = ws.pass(weights, batch, Request::Both, pool);
    ws.sum_gradients(batch.len(), gradient);
    (loss, ws.join_outputs(batch.len()))
}

/// Predictions (N, T, K) in the units of the targets. Targets are ignored.
pub fn predict<F: Real>(weights: &[F], batch: Batch<F>, ws: &mut Workspace<F>, pool: &crate::Pool) -> Vec<F> {
    ws.pass(weights, batch, Request::Outputs, pool);
    ws.join_outputs(batch.len())
}

/// Transforms a padded activation or cotangent for `convolve`, if the layer uses `winograd`.
pub(super) fn spread<F: Real>(kernels: &Kernels<F>, sweep: Convolution, a: &[F], spread: &mut [F]) {
    if sweep.paired {
        kernels.spread(a, spread, sweep.lda);
    }
}

/// c = finish(start + a ∗ w) with padded `a`; `panels` contains w for the direction of the sweep.
pub(super) fn convolve<F: Real>(
    kernels: &Kernels<F>,
    sweep: Convolution,
    [a, spread]: [&[F]; 2],
    panels: &Panels<F>,
    c: &mut [F],
    start: Start<F>,
    finish: Finish<F>,
) {
    let Convolution { rows, channels, lda, columns, taps, step, depth, paired } = sweep;
    if paired {
        let (depth, panels) = (channels, &panels.pairs);
        let (taps, step) = (1, 0);
        kernels.pairs(Product { a: spread, lda, rows, depth, taps, step, panels, c, columns, start, finish });
    } else {
        let panels = &panels.direct;
        kernels.product(Product { a, lda, rows, depth, taps, step, panels, c, columns, start, finish });
    }
}

/// c = bias + a ∗ w of the last layer.
pub(super) fn last_layer<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    a: &[F],
    w: &Packed<F>,
    bias: &[F],
    c: &mut [F],
) {
    let n = shape.layers();
    let (conv, w) = (shape.conv(n - 1), w.block(shape, 2 * n - 1));
    let (columns, taps) = (conv.input_stride, conv.kernel);
    kernels.dots(Dots { a, columns, rows: shape.instants, taps, step: conv.dilation * columns, w, bias, c });
}

/// Computes a₁ … a_(n−1) and f̂ of one sample.
pub(super) fn forward<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    w: &Packed<F>,
    x: &[F],
    s: &mut Scratch<F>,
) {
    let last = shape.layers() - 1;
    for l in 0..last {
        let (below, above) = s.a.split_at_mut(l);
        let a = below.last().map_or(x, |a| &a[..]);
        let mut sweep = shape.conv(l).forward();
        spread(kernels, sweep, a, &mut s.spread_a[l]);
        sweep.paired &= !F::REFERENCE_ORDER;
        let c = &mut above[0][shape.conv(l + 1).input_start()..];
        let bias = Start::Bias(w.block(shape, l));
        convolve(kernels, sweep, [a, &s.spread_a[l]], &w.forward[l], c, bias, Finish::Relu);
    }
    last_layer(kernels, shape, &s.a[last - 1], w, w.block(shape, last), &mut s.out);
}

/// Returns Σ σ² (f̂ − f)² of one sample and writes g_n = ∂L/∂f̂ to the scratch memory.
pub(super) fn residual<F: Real>(
    shape: Shape,
    y: &[F],
    output_weights: &[F],
    elements: usize,
    s: &mut Scratch<F>,
) -> f64 {
    let scale = F::from_f64(2.0 / elements as f64);
    let mut sum = 0.0;
    let (k, last) = (shape.outputs, shape.layers() - 1);
    let g = &mut s.g[last][shape.conv(last).output_start()..];
    for ((g, out), y) in g.chunks_exact_mut(k).zip(s.out.chunks_exact(k)).zip(y.chunks_exact(k)) {
        for i in 0..k {
            let error = out[i] - y[i];
            let weighted = output_weights[i] * error;
            sum += (weighted * error).to_f64();
            g[i] = scale * weighted;
        }
    }
    sum
}

/// Computes g_(n−1) … g₁ from g_n.
pub(super) fn backward<F: Real>(kernels: &Kernels<F>, shape: Shape, w: &Packed<F>, s: &mut Scratch<F>) {
    for l in (1..shape.layers()).rev() {
        let (below, above) = s.g.split_at_mut(l);
        let (conv, sweep) = (shape.conv(l), shape.conv(l).back());
        spread(kernels, sweep, &above[0], &mut s.spread_g[l]);
        let c = &mut below[l - 1][shape.conv(l - 1).output_start()..];
        let gate = Finish::Gate(&s.a[l - 1][conv.input_start()..]);
        convolve(kernels, sweep, [&above[0], &s.spread_g[l]], &w.back[l], c, Start::Zero, gate);
    }
}

/// wide = start + g₁ ∗ w₁ᵀ.
pub(super) fn input_product<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    w: &Packed<F>,
    g1: &[F],
    wide: &mut [F],
    start: Start<F>,
) {
    convolve(kernels, shape.conv(0).back(), [g1, &[]], &w.back[0], wide, start, Finish::Plain);
}

/// Appends the inputs' part (T, 3M) of the padded rows of `wide`.
pub(super) fn take_inputs<F: Real>(shape: Shape, wide: &[F], out: &mut Vec<F>) {
    for row in wide.chunks_exact(shape.conv(0).back().columns) {
        out.extend_from_slice(&row[..shape.inputs]);
    }
}

/// Adds ∂L/∂β of one sample, in the padded order.
fn add_weight_gradient<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    x: &[F],
    s: &mut Scratch<F>,
    chunk: &mut Chunk<F>,
) {
    for l in 0..shape.layers() {
        let a = if l == 0 { x } else { &s.a[l - 1] };
        add_layer(kernels, shape, l, [a, &s.spread_a[l], &s.g[l]], &mut s.fold, chunk);
        add_biases(kernels, shape, l, &s.g[l], chunk);
    }
}

/// Adds aᵀ·g to the gradient of w of layer l + 1, with the padded input a and cotangent g; `fold` is scratch memory.
pub(super) fn add_layer<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    l: usize,
    [a, spread, g]: [&[F]; 3],
    fold: &mut [F],
    chunk: &mut Chunk<F>,
) {
    let (conv, n, rows) = (shape.conv(l), shape.layers(), shape.instants);
    let (lda, columns) = (conv.input_stride, conv.output_stride);
    let g = &g[conv.output_start()..][..rows * columns];
    let gradient = &mut chunk.gradient[padded_range(shape, n + l)];
    if conv.paired {
        kernels.fold(g, fold, columns);
        let forms = spread.chunks_exact(rows / 2 * lda).zip(fold.chunks_exact(rows / 2 * columns));
        let forms_of = chunk.pairs[pairs_range(shape, l)].chunks_exact_mut(conv.inputs * columns);
        for ((a, b), c) in forms.zip(forms_of) {
            kernels.outer(Outer { a, lda, rows: rows / 2, depth: conv.inputs, b, columns, c });
        }
    } else if l + 1 == n {
        // transposed, because there are few outputs and many inputs
        let taps = gradient.chunks_exact_mut(conv.outputs * lda);
        for (tap, c) in taps.enumerate() {
            let b = &a[tap * conv.dilation * lda..];
            kernels.outer(Outer { a: g, lda: columns, rows, depth: columns, b, columns: lda, c });
        }
    } else {
        let Convolution { step, depth, .. } = conv.forward();
        for (tap, c) in gradient.chunks_exact_mut(depth * columns).enumerate() {
            kernels.outer(Outer { a: &a[tap * step..], lda, rows, depth, b: g, columns, c });
        }
    }
}

/// Adds the sum over instants of a padded cotangent to the gradient of the bias of layer l + 1.
pub(super) fn add_biases<F: Real>(
    kernels: &Kernels<F>,
    shape: Shape,
    l: usize,
    g: &[F],
    chunk: &mut Chunk<F>,
) {
    let bias = &mut chunk.gradient[padded_range(shape, l)];
    if l + 1 < shape.layers() {
        return kernels.add_rows(g, bias);
    }
    for row in g.chunks_exact(shape.outputs) {
        bias.iter_mut().zip(row).for_each(|(sum, g)| *sum += *g);
    }
}
