//! The products that a convolution and its derivatives are made of, in register tiles, for any vector.
//!
//! ```text
//! product: C[t, c] = start + Σ_i Σ_d A[t·lda + i·step + d] B[i, d, c]   rows may overlap: no im2col
//! outer:   C[j, c] += Σ_t A[t·lda + j] B[t, c]
//! ```
//! B of `product` comes in panels of some registers' columns (`panel`), each all its rows long, so that a panel stays in L1.

use crate::lanes::Vector;

/// Columns of activations and packed weights are padded to a multiple of this: the widest register.
pub const COLUMNS: usize = 16;

/// Registers of the panel that begins where so many columns are left: two, or the three or the one that an odd number of
/// registers ends with, where a register is as wide as `COLUMNS`.
#[inline(always)]
pub fn panel(columns: usize, lanes: usize) -> usize {
    match columns / lanes {
        odd @ (1 | 3) if lanes == COLUMNS => odd,
        _ => 2,
    }
}

/// What a product starts from.
#[derive(Clone, Copy)]
pub enum Start<'a, F> {
    /// 0.
    Zero,
    /// The same row for all t.
    Bias(&'a [F]),
    /// What C holds.
    Add,
}

/// What happens to a finished sum.
#[derive(Clone, Copy)]
pub enum Finish<'a, F> {
    /// Nothing.
    Plain,
    /// max(·, 0).
    Relu,
    /// Kept where this, laid out as C, is positive; else 0.
    Gate(&'a [F]),
}

/// Operands of `product`.
pub struct Product<'a, F> {
    /// A, from its first row.
    pub a: &'a [F],
    /// From a row of A to the next.
    pub lda: usize,
    /// Rows of A and C.
    pub rows: usize,
    /// Length of a row of A that a tap reads.
    pub depth: usize,
    /// How many pieces of A a row of C reads, and how far apart they are.
    pub taps: usize,
    /// As `taps`.
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
    /// A, from its first row.
    pub a: &'a [F],
    /// From a row of A to the next.
    pub lda: usize,
    /// Rows of A and B: the length of the sum.
    pub rows: usize,
    /// Rows of C.
    pub depth: usize,
    /// B, rows of `columns`.
    pub b: &'a [F],
    /// Columns of B and C, a multiple of `COLUMNS`.
    pub columns: usize,
    /// C, added to.
    pub c: &'a mut [F],
}

/// Operands of `dots`: C[t, k] = bias[k] + Σ_i Σ_c A[t·columns + i·step + c] W[i, k, c], for few k.
pub struct Dots<'a, F> {
    /// A, rows of `columns`.
    pub a: &'a [F],
    /// Columns of A and W, a multiple of `COLUMNS`.
    pub columns: usize,
    /// Rows of C.
    pub rows: usize,
    /// How many rows of A a row of C reads, and how far apart they are.
    pub taps: usize,
    /// As `taps`.
    pub step: usize,
    /// W.
    pub w: &'a [F],
    /// One a k.
    pub bias: &'a [F],
    /// Rows of as many as `bias`.
    pub c: &'a mut [F],
}

impl<F> Product<'_, F> {
    /// # Panics
    /// If what a result needs is too short.
    pub fn check_result(&self, panel_rows: usize) {
        let elements = self.rows * self.columns;
        assert!(
            self.panels.len() >= self.columns * panel_rows && self.c.len() >= elements,
            "C: {}",
            self.c.len()
        );
        if let Start::Bias(bias) = self.start {
            assert!(bias.len() >= self.columns);
        }
        if let Finish::Gate(gate) = self.finish {
            assert!(gate.len() >= elements);
        }
    }
}

/// `Product`.
///
/// # Safety
/// As `Kernels::product` checks it; the machine has the vector's instruction set.
#[inline(always)]
pub unsafe fn product<V: Vector, const R: usize, const R3: usize>(p: &mut Product<V::Scalar>) {
    // A known stride spares the row addresses their registers.
    // SAFETY: the caller's promise.
    unsafe {
        match p.lda {
            64 => product_by_stride::<V, R, R3>(p, 64),
            stride => product_by_stride::<V, R, R3>(p, stride),
        }
    }
}

#[inline(always)]
unsafe fn product_by_stride<V: Vector, const R: usize, const R3: usize>(
    p: &mut Product<V::Scalar>,
    lda: usize,
) {
    // SAFETY: the caller's promise.
    unsafe {
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
}

#[inline(always)]
unsafe fn product_panel<V: Vector, const R: usize, const W: usize>(
    p: &mut Product<V::Scalar>,
    lda: usize,
    column: usize,
) {
    // SAFETY: the caller's promise.
    unsafe {
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
}

#[inline(always)]
unsafe fn product_tile<V: Vector, const R: usize, const W: usize>(
    p: &mut Product<V::Scalar>,
    lda: usize,
    b: *const V::Scalar,
    t: usize,
    column: usize,
) {
    // SAFETY: the caller's promise.
    unsafe {
        let mut sum = [[V::ZERO; W]; R];
        let mut a = p.a.as_ptr().add(t * lda);
        let mut b = b;
        for _ in 0..p.taps {
            accumulate::<V, R, W>(&mut sum, a, lda, b, p.depth);
            a = a.wrapping_add(p.step);
            b = b.wrapping_add(p.depth * W * V::LANES);
        }
        close::<V, R, W>(p, sum, t * p.columns + column, p.columns, column);
    }
}

/// sum[r] += Σ_d a[r·lda + d] b[d].
///
/// # Safety
/// As `product`.
#[inline(always)]
pub unsafe fn accumulate<V: Vector, const R: usize, const W: usize>(
    sum: &mut [[V; W]; R],
    a: *const V::Scalar,
    lda: usize,
    b: *const V::Scalar,
    depth: usize,
) {
    // SAFETY: the caller's promise.
    unsafe {
        for d in 0..depth {
            let mut row = [V::ZERO; W];
            for w in 0..W {
                row[w] = V::load(b.add((d * W + w) * V::LANES));
            }
            for r in 0..R {
                let x = V::of(*a.add(r * lda + d));
                for w in 0..W {
                    sum[r][w] = x.mul_add(row[w], sum[r][w]);
                }
            }
        }
    }
}

/// Starts, finishes and stores the sums of R rows of C that begin at `at` and are `ldc` apart.
///
/// # Safety
/// As `product`.
#[inline(always)]
pub unsafe fn close<V: Vector, const R: usize, const W: usize>(
    p: &mut Product<V::Scalar>,
    mut sum: [[V; W]; R],
    at: usize,
    ldc: usize,
    column: usize,
) {
    // SAFETY: the caller's promise.
    unsafe {
        let c = p.c.as_mut_ptr().add(at);
        // What a sum starts from comes last, as in the reference: a trained network may hold a unit at its kink to the last bit.
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
}

/// `Outer`.
///
/// # Safety
/// As `Kernels` checks it; the machine has the vector's instruction set.
#[inline(always)]
pub unsafe fn outer<V: Vector, const R: usize, const R3: usize>(p: &mut Outer<V::Scalar>) {
    // SAFETY: the caller's promise.
    unsafe {
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
}

#[inline(always)]
unsafe fn outer_panel<V: Vector, const R: usize, const W: usize>(p: &mut Outer<V::Scalar>, column: usize) {
    // SAFETY: the caller's promise.
    unsafe {
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
}

#[inline(always)]
unsafe fn outer_tile<V: Vector, const R: usize, const W: usize>(
    p: &mut Outer<V::Scalar>,
    j: usize,
    column: usize,
) {
    // SAFETY: the caller's promise.
    unsafe {
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
                let x = V::of(*a.add(r));
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
}

/// `Dots`.
///
/// # Safety
/// As `Kernels` checks it; the machine has the vector's instruction set.
#[inline(always)]
pub unsafe fn dots<V: Vector>(p: &mut Dots<V::Scalar>) {
    // SAFETY: the caller's promise.
    unsafe {
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
}

/// c += the rows of A.
///
/// # Safety
/// As `Kernels` checks it; the machine has the vector's instruction set.
#[inline(always)]
pub unsafe fn sums<V: Vector>(a: &[V::Scalar], c: &mut [V::Scalar]) {
    // SAFETY: the caller's promise.
    unsafe {
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
}

#[inline(always)]
unsafe fn sums_of<V: Vector, const W: usize>(a: &[V::Scalar], c: &mut [V::Scalar], column: usize) {
    // SAFETY: the caller's promise.
    unsafe {
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
}

/// Chains of multiply-adds, enough to hide the latency.
pub const CHAINS: usize = 12;

/// Multiply-adds on registers alone.
///
/// # Safety
/// The machine has the vector's instruction set.
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
