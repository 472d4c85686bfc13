//! Second derivatives by forward-over-reverse (Pearlmutter 1994): H·v and ∂/∂x ⟨∂L/∂β, v⟩.
//!
//! ```text
//! ż_l = a_(l−1) ∗ v_l + ȧ_(l−1) ∗ w_l + ḃ_l, ȧ_l = [a_l>0] ż_l, ȧ_0 = 0     Ġ_n = 2σ²/(NTK) ż_n     Hb_l = Σ Ġ_l
//! Ġ_l = [a_l>0] (Ġ_(l+1) ∗ w_(l+1)ᵀ + g_(l+1) ∗ v_(l+1)ᵀ)                    Hw_l = a_(l−1)ᵀ Ġ_l + ȧ_(l−1)ᵀ g_l
//! ```
//! Activations are stored. A product costs about six convolutions of layer 2 and seven of each of the layers 3 … n − 1.

use super::data::Batch;
use super::kernels::{Kernels, Real};
use super::layout::Packed;
use super::network::{
    Scratch, Workspace, add_biases, add_layer, convolve, forward, input_product, last_layer, residual,
    spread, take_inputs,
};
use super::shape::Shape;
use super::tiles::{Finish, Start};

/// A batch with the activations of its network, (n − 1)·T·width numbers per sample and padding.
#[derive(Debug)]
pub struct Curvature<'a, F> {
    batch: Batch<'a, F>,
    packed: Packed<F>,
    kept: Vec<F>,
    no_bias: Vec<F>,
}

impl<'a, F: Real> Curvature<'a, F> {
    /// Evaluates the network once and stores its activations.
    pub fn new(weights: &[F], batch: Batch<'a, F>, ws: &mut Workspace<F>, pool: &crate::Pool) -> Self {
        let shape = batch.shape();
        ws.packed.fill(&ws.kernels, shape, weights);
        ws.over_chunks(batch, pool, |kernels, packed, s, chunk, samples| {
            chunk.out.clear();
            for i in samples {
                forward(kernels, shape, packed, batch.sample(i).0, s);
                s.a.iter().for_each(|a| chunk.out.extend_from_slice(a));
            }
        });
        let kept = ws.join_outputs(batch.len());
        Self { batch, packed: ws.packed.clone(), kept, no_bias: vec![F::ZERO; shape.outputs] }
    }

    /// Writes H·v to `out`, both in the flat order; H may be indefinite. Allocates nothing once the workspace has grown.
    pub fn product(&self, v: &[F], out: &mut [F], ws: &mut Workspace<F>, pool: &crate::Pool) {
        let (shape, batch) = (self.batch.shape(), self.batch);
        ws.packed.fill(&ws.kernels, shape, v);
        ws.over_chunks(batch, pool, |kernels, v, s, chunk, samples| {
            chunk.clear();
            for i in samples {
                let mut dot = self.tangents(kernels, v, i, s);
                for l in 0..shape.layers() {
                    let a = self.input(i, l);
                    add_layer(kernels, shape, l, [a, &s.spread_a[l], &dot.g[l]], &mut dot.fold, chunk);
                    if l > 0 {
                        let (da, spread) = (&dot.a[l - 1], &dot.spread_a[l]);
                        add_layer(kernels, shape, l, [da, spread, &s.g[l]], &mut dot.fold, chunk);
                    }
                    add_biases(kernels, shape, l, &dot.g[l], chunk);
                }
                s.tangent = Some(dot);
            }
        });
        ws.sum_gradients(batch.len(), out);
    }

    /// ∂/∂x ⟨∂L/∂β, v⟩, (N, T, 3M).
    pub fn mixed_product(&self, v: &[F], ws: &mut Workspace<F>, pool: &crate::Pool) -> Vec<F> {
        let (shape, batch) = (self.batch.shape(), self.batch);
        ws.packed.fill(&ws.kernels, shape, v);
        ws.over_chunks(batch, pool, |kernels, v, s, chunk, samples| {
            chunk.out.clear();
            for i in samples {
                let mut dot = self.tangents(kernels, v, i, s);
                self.back(kernels, i, 1, s);
                input_product(kernels, shape, &self.packed, &dot.g[0], &mut dot.wide, Start::Zero);
                input_product(kernels, shape, v, &s.g[0], &mut dot.wide, Start::Add);
                take_inputs(shape, &dot.wide, &mut chunk.out);
                s.tangent = Some(dot);
            }
        });
        ws.join_outputs(batch.len())
    }

    /// Padded input of layer l + 1 for sample i: x or a_l.
    fn input(&self, i: usize, l: usize) -> &[F] {
        let shape = self.batch.shape();
        if l == 0 {
            return self.batch.sample(i).0;
        }
        let len = |layers: std::ops::Range<usize>| layers.map(|l| shape.conv(l).input_len()).sum::<usize>();
        let start = i * len(1..shape.layers()) + len(1..l);
        &self.kept[start..start + len(l..l + 1)]
    }

    /// Gate of the ReLU for the activations a_l of sample i.
    fn gate(&self, i: usize, l: usize) -> Finish<'_, F> {
        Finish::Gate(&self.input(i, l)[self.batch.shape().conv(l).input_start()..])
    }

    /// Computes g_l of sample i from g_(l+1), both in the scratch memory.
    fn back(&self, kernels: &Kernels<F>, i: usize, l: usize, s: &mut Scratch<F>) {
        let shape = self.batch.shape();
        let (below, above) = s.g.split_at_mut(l);
        let (sweep, g) = (shape.conv(l).back(), [&above[0][..], &s.spread_g[l]]);
        let c = output(shape, l - 1, &mut below[l - 1]);
        convolve(kernels, sweep, g, &self.packed.back[l], c, Start::Zero, self.gate(i, l));
    }

    /// Tangents along v of the activations and cotangents of sample i. Writes g_n … g₂ to the scratch memory and takes its
    /// tangent part.
    fn tangents(&self, kernels: &Kernels<F>, v: &Packed<F>, i: usize, s: &mut Scratch<F>) -> Box<Scratch<F>> {
        let (shape, w) = (self.batch.shape(), &self.packed);
        let last = shape.layers() - 1;
        let mut dot = s.tangent.take().unwrap_or_else(|| Box::new(Scratch::new(shape)));

        for l in 0..last {
            let (a, sweep, gate) = (self.input(i, l), shape.conv(l).forward(), self.gate(i, l + 1));
            let (below, above) = dot.a.split_at_mut(l);
            let c = &mut above[0][shape.conv(l + 1).input_start()..];
            spread(kernels, sweep, a, &mut s.spread_a[l]);
            let (bias, finish) = (Start::Bias(v.block(shape, l)), if l == 0 { gate } else { Finish::Plain });
            convolve(kernels, sweep, [a, &s.spread_a[l]], &v.forward[l], c, bias, finish);
            if let Some(da) = below.last() {
                spread(kernels, sweep, da, &mut dot.spread_a[l]);
                convolve(kernels, sweep, [da, &dot.spread_a[l]], &w.forward[l], c, Start::Add, gate);
            }
        }
        let (a, g) = (self.input(i, last), output(shape, last, &mut dot.g[last]));
        last_layer(kernels, shape, a, w, w.block(shape, last), &mut s.out);
        last_layer(kernels, shape, a, v, v.block(shape, last), &mut dot.out);
        last_layer(kernels, shape, &dot.a[last - 1], w, &self.no_bias, g);

        // The loss is quadratic, so ġ_n is g_n with the tangent in place of f̂ − f.
        let output_weights = self.batch.output_weights();
        let elements = self.batch.len() * shape.instants * shape.outputs;
        residual(shape, self.batch.sample(i).1, output_weights, elements, s);
        let scale = F::from_f64(2.0 / elements as f64);
        for (j, (g, part)) in g.iter_mut().zip(&dot.out).enumerate() {
            *g = scale * output_weights[j % shape.outputs] * (*g + *part);
        }
        for l in (1..=last).rev() {
            let (sweep, gate) = (shape.conv(l).back(), self.gate(i, l));
            let (below, above) = dot.g.split_at_mut(l);
            let (dg, c) = (&above[0][..], output(shape, l - 1, &mut below[l - 1]));
            spread(kernels, sweep, dg, &mut dot.spread_g[l]);
            convolve(kernels, sweep, [dg, &dot.spread_g[l]], &w.back[l], c, Start::Zero, Finish::Plain);
            spread(kernels, sweep, &s.g[l], &mut s.spread_g[l]);
            convolve(kernels, sweep, [&s.g[l], &s.spread_g[l]], &v.back[l], c, Start::Add, gate);
            if l > 1 {
                self.back(kernels, i, l, s);
            }
        }
        dot
    }
}

/// A padded cotangent of layer l + 1 from its first instant on.
fn output<F>(shape: Shape, l: usize, g: &mut [F]) -> &mut [F] {
    &mut g[shape.conv(l).output_start()..]
}
