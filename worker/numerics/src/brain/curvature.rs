//! Second derivatives by forward-over-reverse (Pearlmutter 1994): H·v, its Gauss–Newton part, and ∂/∂x ⟨∂L/∂β, v⟩.
//!
//! ```text
//! ż₁ = x ∗ v₁ + ḃ₁                 Ġ₃ = 2σ²/(NTK) ḟ                   Hb = Σ Ġ
//! ż₂ = a₁ ∗ v₂ + ȧ₁ ∗ w₂ + ḃ₂      Ġ₂ = [a₂>0] (Ġ₃ w₃ᵀ + g₃ v₃ᵀ)       Hw₃ = a₂ᵀĠ₃ + ȧ₂ᵀg₃
//! ḟ  = a₂ v₃ + ȧ₂ w₃ + ḃ₃          Ġ₁ = [a₁>0] (Ġ₂ ∗ w₂ᵀ + g₂ ∗ v₂ᵀ)   Hw₂ = a₁ᵀĠ₂ + ȧ₁ᵀg₂,  Hw₁ = xᵀĠ₁
//! ```
//! The activations are kept, so a product costs six convolutions of the second layer, a Gauss–Newton one four.

use super::data::Batch;
use super::kernels::{Dots, Finish, Kernels, Product, Start};
use super::layout::{Packed, padded_range};
use super::network::{
    Scratch, Workspace, add_biases, add_outer, add_second_layer, convolve, forward, input_product,
    last_layer_back, residual, spread, take_inputs,
};
use super::real::Real;

/// Which matrix a product is with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Matrix {
    /// ∂²L/∂β², possibly indefinite.
    Hessian,
    /// Jᵀ (∂²L/∂f̂²) J, positive semidefinite.
    GaussNewton,
}

/// A batch with its network's activations: 2·T·64 numbers a sample.
#[derive(Debug)]
pub struct Curvature<'a, F> {
    batch: Batch<'a, F>,
    packed: Packed<F>,
    kept: Vec<F>,
    no_bias: Vec<F>,
}

impl<'a, F: Real> Curvature<'a, F> {
    /// Evaluates the network once and keeps its activations.
    pub fn new(weights: &[F], batch: Batch<'a, F>, ws: &mut Workspace<F>, pool: &rayon::ThreadPool) -> Self {
        let shape = batch.shape();
        ws.packed.fill(&ws.kernels, shape, weights);
        ws.over_chunks(batch, pool, |kernels, packed, s, slot, samples| {
            slot.out.clear();
            for i in samples {
                forward(kernels, shape, packed, batch.sample(i).0, s);
                slot.out.extend_from_slice(&s.a1);
                slot.out.extend_from_slice(&s.a2);
            }
        });
        let kept = ws.join_outputs(batch.len());
        Self { batch, packed: ws.packed.clone(), kept, no_bias: vec![F::ZERO; shape.outputs] }
    }

    /// `matrix`·v into `out`, both in the flat order. Allocates nothing once the workspace has grown.
    pub fn product(
        &self,
        matrix: Matrix,
        v: &[F],
        out: &mut [F],
        ws: &mut Workspace<F>,
        pool: &rayon::ThreadPool,
    ) {
        let (shape, batch) = (self.batch.shape(), self.batch);
        let (p, k) = (shape.stride(), shape.outputs);
        ws.packed.fill(&ws.kernels, shape, v);
        ws.over_chunks(batch, pool, |kernels, v, s, slot, samples| {
            slot.clear();
            for i in samples {
                let mut dot = self.tangents(kernels, v, i, matrix, s);
                let (x, (a1, a2)) = (batch.sample(i).0, self.activations(i));
                add_second_layer(kernels, shape, a1, &s.spread1, &dot.g2, &mut dot.fold2, slot);
                if matrix == Matrix::Hessian {
                    add_second_layer(kernels, shape, &dot.a1, &dot.spread1, &s.g2, &mut dot.fold2, slot);
                }
                let gradient = &mut slot.gradient;
                let [w1, w3] = [3, 5].map(|block| padded_range(shape, block));
                add_biases(kernels, shape, &dot.g1, &dot.g2, &dot.g3, gradient);
                add_outer(kernels, shape, x, shape.inputs, 3 * shape.inputs, &dot.g1[p..], &mut gradient[w1]);
                add_outer(kernels, shape, &dot.g3, k, k, a2, &mut gradient[w3.clone()]);
                if matrix == Matrix::Hessian {
                    add_outer(kernels, shape, &s.g3, k, k, &dot.a2, &mut gradient[w3]);
                }
                s.tangent = Some(dot);
            }
        });
        ws.sum_gradients(batch.len(), out);
    }

    /// ∂/∂x ⟨∂L/∂β, v⟩, (N, T, 3M).
    pub fn mixed_product(&self, v: &[F], ws: &mut Workspace<F>, pool: &rayon::ThreadPool) -> Vec<F> {
        let (shape, batch) = (self.batch.shape(), self.batch);
        ws.packed.fill(&ws.kernels, shape, v);
        ws.over_chunks(batch, pool, |kernels, v, s, slot, samples| {
            slot.out.clear();
            for i in samples {
                let mut dot = self.tangents(kernels, v, i, Matrix::Hessian, s);
                let (a1, _) = self.activations(i);
                let (p, panels) = (shape.stride(), [&self.packed.w2_back[..], &self.packed.w2_back_pairs]);
                let gate = Finish::Gate(&a1[p..]);
                convolve(kernels, shape, &s.g2, &s.spread2, panels, &mut s.g1[p..], Start::Zero, gate);
                input_product(kernels, shape, &self.packed.w1_back, &dot.g1, &mut dot.wide, Start::Zero);
                input_product(kernels, shape, &v.w1_back, &s.g1, &mut dot.wide, Start::Add);
                take_inputs(shape, &dot.wide, &mut slot.out);
                s.tangent = Some(dot);
            }
        });
        ws.join_outputs(batch.len())
    }

    /// a₁ (T + 2, stride) and a₂ (T, stride) of sample i.
    fn activations(&self, i: usize) -> (&[F], &[F]) {
        let (t, p) = (self.batch.shape().instants, self.batch.shape().stride());
        let one = (2 * t + 2) * p;
        self.kept[i * one..(i + 1) * one].split_at((t + 2) * p)
    }

    /// Tangents along v of sample i's activations and cotangents; g₃ and g₂ into the scratch, whose tangent part is taken out.
    fn tangents(
        &self,
        kernels: &Kernels<F>,
        v: &Packed<F>,
        i: usize,
        matrix: Matrix,
        s: &mut Scratch<F>,
    ) -> Box<Scratch<F>> {
        let (shape, w, exact) = (self.batch.shape(), &self.packed, matrix == Matrix::Hessian);
        let (p, rows) = (shape.stride(), shape.instants);
        let (x, y) = self.batch.sample(i);
        let (a1, a2) = self.activations(i);
        let mut dot = s.tangent.take().unwrap_or_else(|| Box::new(Scratch::new(shape)));

        // Forward.
        kernels.product(Product {
            a: x,
            lda: shape.inputs,
            rows,
            depth: 3 * shape.inputs,
            panels: &v.w1,
            c: &mut dot.a1[p..],
            columns: p,
            start: Start::Bias(v.block(shape, 0)),
            finish: Finish::Gate(&a1[p..]),
        });
        spread(kernels, shape, a1, &mut s.spread1);
        spread(kernels, shape, &dot.a1, &mut dot.spread1);
        let bias = Start::Bias(v.block(shape, 1));
        convolve(kernels, shape, a1, &s.spread1, [&v.w2, &v.w2_pairs], &mut dot.a2, bias, Finish::Plain);
        let panels = [&w.w2[..], &w.w2_pairs];
        convolve(kernels, shape, &dot.a1, &dot.spread1, panels, &mut dot.a2, Start::Add, Finish::Gate(a2));
        let last = |a: &[F], w: &[F], bias: &[F], c: &mut [F]| {
            kernels.dots(Dots { a, columns: p, rows, w, bias, c });
        };
        last(a2, w.block(shape, 5), w.block(shape, 2), &mut s.out);
        last(a2, v.block(shape, 5), v.block(shape, 2), &mut dot.out);
        last(&dot.a2, w.block(shape, 5), &self.no_bias, &mut dot.g3);

        // Backward. The loss is quadratic: ġ₃ is g₃ with f̂ − f replaced by its tangent.
        let output_weights = self.batch.output_weights();
        let elements = self.batch.len() * rows * shape.outputs;
        residual(y, output_weights, elements, s);
        let scale = F::from_f64(2.0 / elements as f64);
        for (i, (g, part)) in dot.g3.iter_mut().zip(&dot.out).enumerate() {
            *g = scale * output_weights[i % shape.outputs] * (*g + *part);
        }
        last_layer_back(kernels, shape, &w.w3_back, &s.g3, a2, &mut s.g2, Start::Zero);
        last_layer_back(kernels, shape, &w.w3_back, &dot.g3, a2, &mut dot.g2, Start::Zero);
        if exact {
            last_layer_back(kernels, shape, &v.w3_back, &s.g3, a2, &mut dot.g2, Start::Add);
        }
        spread(kernels, shape, &dot.g2, &mut dot.spread2);
        let (panels, gate) = ([&w.w2_back[..], &w.w2_back_pairs], Finish::Gate(&a1[p..]));
        let finish = if exact { Finish::Plain } else { gate };
        convolve(kernels, shape, &dot.g2, &dot.spread2, panels, &mut dot.g1[p..], Start::Zero, finish);
        if exact {
            spread(kernels, shape, &s.g2, &mut s.spread2);
            let panels = [&v.w2_back[..], &v.w2_back_pairs];
            convolve(kernels, shape, &s.g2, &s.spread2, panels, &mut dot.g1[p..], Start::Add, gate);
        }
        dot
    }
}
