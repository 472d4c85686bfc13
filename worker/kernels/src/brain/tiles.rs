//! Matrix products of convolutions and of their derivatives, in register tiles, for any vector type.
//!
//! ```text
//! product: C[t, c] = start + Σ_i Σ_d A[t·lda + i·step + d] B[i, d, c]   rows may overlap: no im2col
//! outer:   C[j, c] += Σ_t A[t·lda + j] B[t, c]
//! ```
//! B of `product` is stored in panels, each with all rows and the columns of a few registers (`panel`), so that a panel stays in
//! L1.
//!
//! The unsafe functions require the checks of `Kernels`, and a machine that supports the vector's instruction set.

#![expect(unsafe_op_in_unsafe_fn, reason = "each whole body relies on the checks of its caller")]

use crate::lanes::Vector;

/// Columns of activations and packed weights are padded to a multiple of this, the number of lanes of the widest register.
pub const COLUMNS: usize = 16;

/// Registers of the next panel when `columns` columns are left: two. For registers as wide as `COLUMNS`, the last panel has
/// three or one if the number of registers is odd.
#[inline(always)]
pub fn panel(columns: usize, lanes: usize) -> usize {
    match columns / lanes {
        odd @ (1 | 3) if lanes == COLUMNS => odd,
        _ => 2,
    }
}

/// Initial value of a product.
#[derive(Clone, Copy)]
pub enum Start<'a, F> {
    /// 0.
    Zero,
    /// The same row for all t.
    Bias(&'a [F]),
    /// The present C.
    Add,
}

/// Final operation on a sum.
#[derive(Clone, Copy)]
pub enum Finish<'a, F> {
    /// None.
    Plain,
    /// max(·, 0).
    Relu,
    /// Keeps the sum where the corresponding entry (same layout as C) is positive; else 0.
    Gate(&'a [F]),
}

/// Operands of `product`.
pub struct Product<'a, F> {
    /// A, starting with its first row.
    pub a: &'a [F],
    /// Distance between rows of A.
    pub lda: usize,
    /// Rows of A and C.
    pub rows: usize,
    /// Elements of a row of A that a tap reads.
    pub depth: usize,
    /// Number of taps: pieces of A that a row of C reads.
    pub taps: usize,
    /// Distance between taps in A.
    pub step: usize,
    /// B in panels.
    pub panels: &'a [F],
    /// C, rows of `columns`.
    pub c: &'a mut [F],
    /// Columns of B and C, a multiple of `COLUMNS`.
    pub columns: usize,
    /// Initial value.
    pub start: Start<'a, F>,
    /// Last operation.
    pub finish: Finish<'a, F>,
}

/// Operands of `outer`.
pub struct Outer<'a, F> {
    /// A, starting with its first row.
    pub a: &'a [F],
    /// Distance between rows of A.
    pub lda: usize,
    /// Rows of A and B, over which `outer` sums.
    pub rows: usize,
    /// Rows of C.
    pub depth: usize,
    /// B, rows of `columns`.
    pub b: &'a [F],
    /// Columns of B and C, a multiple of `COLUMNS`.
    pub columns: usize,
    /// C, to which the product is added.
    pub c: &'a mut [F],
}

/// Operands of `dots`, for few k: C[t, k] = bias[k] + Σ_i Σ_c A[t·columns + i·step + c] W[i, k, c].
pub struct Dots<'a, F> {
    /// A, rows of `columns`.
    pub a: &'a [F],
    /// Columns of A and W, a multiple of `COLUMNS`.
    pub columns: usize,
    /// Rows of C.
    pub rows: usize,
    /// Number of taps: rows of A that a row of C reads.
    pub taps: usize,
    /// Distance between taps in A.
    pub step: usize,
    /// W.
    pub w: &'a [F],
    /// Bias, one per k.
    pub bias: &'a [F],
    /// C, rows of `bias.len()`.
    pub c: &'a mut [F],
}

impl<F> Product<'_, F> {
    /// # Panics
    /// If an operand of the result is too short.
    pub fn check_result(&self, panel_rows: usize) {
        let (elements, found) = (self.rows * self.columns, self.c.len());
        assert!(self.panels.len() >= self.columns * panel_rows && found >= elements, "C: {found}");
        if let Start::Bias(bias) = self.start {
            assert!(bias.len() >= self.columns);
        }
        if let Finish::Gate(gate) = self.finish {
            assert!(gate.len() >= elements);
        }
    }
}

/// Computes a [`Product`].
#[inline(always)]
pub unsafe fn product<V: Vector, const R: usize, const R3: usize>(p: &mut Product<V::Scalar>) {
    // A constant stride saves the registers of row addresses.
    match p.lda {
        64 => product_by_stride::<V, R, R3>(p, 64),
        stride => product_by_stride::<V, R, R3>(p, stride),
    }
}

#[inline(always)]
unsafe fn product_by_stride<V: Vector, const R: usize, const R3: usize>(
    p: &mut Product<V::Scalar>,
    lda: usize,
) {
    let mut column = 0;
    while column < p.columns {
        let registers = panel(p.columns - column, V::LANES);
        match registers {
            1 => product_panel::<V, R, 1>(p, lda, column),
            3 => product_panel::<V, R3, 3>(p, lda, column),
            _ => product_panel::<V, R, 2>(p, lda, column),
        }
        column += registers * V::LANES;
    }
}

#[inline(always)]
unsafe fn product_panel<V: Vector, const R: usize, const W: usize>(
    p: &mut Product<V::Scalar>,
    lda: usize,
    column: usize,
) {
    let b = p.panels.as_ptr().add(column * p.taps * p.depth);
    let mut t = 0;
    while t + R <= p.rows {
        product_tile::<V, R, W>(p, lda, b, t, column);
        t += R;
    }
    while t + 2 <= p.rows {
        product_tile::<V, 2, W>(p, lda, b, t, column);
        t += 2;
    }
    if t < p.rows {
        product_tile::<V, 1, W>(p, lda, b, t, column);
    }
}

#[inline(always)]
unsafe fn product_tile<V: Vector, const R: usize, const W: usize>(
    p: &mut Product<V::Scalar>,
    lda: usize,
    mut b: *const V::Scalar,
    t: usize,
    column: usize,
) {
    let mut sum = [[V::ZERO; W]; R];
    let mut a = p.a.as_ptr().add(t * lda);
    for _ in 0..p.taps {
        accumulate::<V, R, W>(&mut sum, a, lda, b, p.depth);
        a = a.wrapping_add(p.step);
        b = b.wrapping_add(p.depth * W * V::LANES);
    }
    close::<V, R, W>(p, sum, t * p.columns + column, p.columns, column);
}

/// sum[r] += Σ_d a[r·lda + d] b[d].
#[inline(always)]
pub unsafe fn accumulate<V: Vector, const R: usize, const W: usize>(
    sum: &mut [[V; W]; R],
    a: *const V::Scalar,
    lda: usize,
    b: *const V::Scalar,
    depth: usize,
) {
    for d in 0..depth {
        let mut row = [V::ZERO; W];
        for w in 0..W {
            row[w] = V::load(b.add((d * W + w) * V::LANES));
        }
        for r in 0..R {
            let x = V::from_scalar(*a.add(r * lda + d));
            for w in 0..W {
                sum[r][w] = x.mul_add(row[w], sum[r][w]);
            }
        }
    }
}

/// Adds the initial values to the sums of R rows of C, applies the final operation, and stores them. Rows start at `at` and are
/// `ldc` apart.
#[inline(always)]
pub unsafe fn close<V: Vector, const R: usize, const W: usize>(
    p: &mut Product<V::Scalar>,
    mut sum: [[V; W]; R],
    at: usize,
    ldc: usize,
    column: usize,
) {
    let c = p.c.as_mut_ptr().add(at);
    // The initial value is added last, as in the reference implementation: a trained network may have units exactly at the
    // kink of the ReLU.
    match p.start {
        Start::Zero => {}
        Start::Bias(bias) => {
            let from = bias.as_ptr().add(column);
            for w in 0..W {
                let b = V::load(from.add(w * V::LANES));
                for r in 0..R {
                    sum[r][w] = sum[r][w] + b;
                }
            }
        }
        Start::Add => {
            for r in 0..R {
                for w in 0..W {
                    sum[r][w] = sum[r][w] + V::load(c.add(r * ldc + w * V::LANES));
                }
            }
        }
    }
    match p.finish {
        Finish::Plain => {}
        Finish::Relu => {
            for r in 0..R {
                for w in 0..W {
                    sum[r][w] = V::ZERO.max(sum[r][w]);
                }
            }
        }
        Finish::Gate(gate) => {
            let gate = gate.as_ptr().add(at);
            for r in 0..R {
                for w in 0..W {
                    let by = V::load(gate.add(r * ldc + w * V::LANES));
                    sum[r][w] = sum[r][w].where_less(V::ZERO, by, V::ZERO);
                }
            }
        }
    }
    for r in 0..R {
        for w in 0..W {
            sum[r][w].store(c.add(r * ldc + w * V::LANES));
        }
    }
}

/// Computes an [`Outer`].
#[inline(always)]
pub unsafe fn outer<V: Vector, const R: usize, const R3: usize>(p: &mut Outer<V::Scalar>) {
    let mut column = 0;
    while column < p.columns {
        let registers = panel(p.columns - column, V::LANES);
        match registers {
            1 => outer_panel::<V, R, 1>(p, column),
            3 => outer_panel::<V, R3, 3>(p, column),
            _ => outer_panel::<V, R, 2>(p, column),
        }
        column += registers * V::LANES;
    }
}

#[inline(always)]
unsafe fn outer_panel<V: Vector, const R: usize, const W: usize>(p: &mut Outer<V::Scalar>, column: usize) {
    let mut j = 0;
    while j + R <= p.depth {
        outer_tile::<V, R, W>(p, j, column);
        j += R;
    }
    while j + 4 <= p.depth {
        outer_tile::<V, 4, W>(p, j, column);
        j += 4;
    }
    if j + 2 <= p.depth {
        outer_tile::<V, 2, W>(p, j, column);
        j += 2;
    }
    if j < p.depth {
        outer_tile::<V, 1, W>(p, j, column);
    }
}

#[inline(always)]
unsafe fn outer_tile<V: Vector, const R: usize, const W: usize>(
    p: &mut Outer<V::Scalar>,
    j: usize,
    column: usize,
) {
    let (lda, ldc) = (p.lda, p.columns);
    let mut sum = [[V::ZERO; W]; R];
    let mut a = p.a.as_ptr().add(j);
    let mut b = p.b.as_ptr().add(column);
    for _ in 0..p.rows {
        let mut row = [V::ZERO; W];
        for w in 0..W {
            row[w] = V::load(b.add(w * V::LANES));
        }
        for r in 0..R {
            let x = V::from_scalar(*a.add(r));
            for w in 0..W {
                sum[r][w] = x.mul_add(row[w], sum[r][w]);
            }
        }
        a = a.wrapping_add(lda);
        b = b.wrapping_add(ldc);
    }
    let c = p.c.as_mut_ptr().add(j * ldc + column);
    for r in 0..R {
        for w in 0..W {
            let at = c.add(r * ldc + w * V::LANES);
            (V::load(at) + sum[r][w]).store(at);
        }
    }
}

/// Computes [`Dots`].
#[inline(always)]
pub unsafe fn dots<V: Vector>(p: &mut Dots<V::Scalar>) {
    let outputs = p.bias.len();
    for t in 0..p.rows {
        for k in 0..outputs {
            let mut sum = [V::ZERO; 2];
            for tap in 0..p.taps {
                let row = p.a.as_ptr().add(t * p.columns + tap * p.step);
                let w = p.w.as_ptr().add((tap * outputs + k) * p.columns);
                let mut column = 0;
                while column + 2 * V::LANES <= p.columns {
                    sum[0] = V::load(row.add(column)).mul_add(V::load(w.add(column)), sum[0]);
                    let next = column + V::LANES;
                    sum[1] = V::load(row.add(next)).mul_add(V::load(w.add(next)), sum[1]);
                    column += 2 * V::LANES;
                }
                if column < p.columns {
                    sum[0] = V::load(row.add(column)).mul_add(V::load(w.add(column)), sum[0]);
                }
            }
            *p.c.get_unchecked_mut(t * outputs + k) = *p.bias.get_unchecked(k) + (sum[0] + sum[1]).sum();
        }
    }
}

/// Adds the rows of A to c.
#[inline(always)]
pub unsafe fn sums<V: Vector>(a: &[V::Scalar], c: &mut [V::Scalar]) {
    let mut column = 0;
    while column < c.len() {
        match panel(c.len() - column, V::LANES) {
            2 => {
                sums_of::<V, 2>(a, c, column);
                column += 2 * V::LANES;
            }
            _ => {
                sums_of::<V, 1>(a, c, column);
                column += V::LANES;
            }
        }
    }
}

#[inline(always)]
unsafe fn sums_of<V: Vector, const W: usize>(a: &[V::Scalar], c: &mut [V::Scalar], column: usize) {
    let rows = a.len() / c.len();
    let mut sum = [[V::ZERO; W]; 4];
    for t in 0..rows {
        let at = a.as_ptr().add(t * c.len() + column);
        let into = &mut sum[t % 4];
        for w in 0..W {
            into[w] = into[w] + V::load(at.add(w * V::LANES));
        }
    }
    for w in 0..W {
        let total = (sum[0][w] + sum[1][w]) + (sum[2][w] + sum[3][w]);
        let at = c.as_mut_ptr().add(column + w * V::LANES);
        (V::load(at) + total).store(at);
    }
}

/// Independent chains of multiply-adds, enough to hide the latency.
pub const CHAINS: usize = 12;

/// Multiply-adds on registers only.
#[inline(always)]
pub unsafe fn burst<V: Vector>(rounds: u64) -> V::Scalar {
    let factor = V::splat(std::hint::black_box(0.5));
    let mut sum = [factor; CHAINS];
    for _ in 0..rounds {
        for chain in &mut sum {
            *chain = chain.mul_add(factor, factor);
        }
    }
    let mut total = factor;
    for chain in sum {
        total = total + chain;
    }
    total.sum()
}
