//! The products that a convolution and its derivatives are made of, in register tiles.
//!
//! ```text
//! product: C[t, c] = start + Σ_i Σ_d A[t·lda + i·step + d] B[i, d, c]   rows may overlap: no im2col
//! outer:   C[j, c] += Σ_t A[t·lda + j] B[t, c]
//! pairs:   a k = 3 convolution's rows 2h and 2h + 1 by Winograd's F(2, 3), 4 products instead of 6 (`winograd`)
//! ```
//! B of `product` comes in panels of some registers' columns (`panel`), each all its rows long, so that a panel stays in L1.

use super::real::Real;
use super::winograd;
use crate::lanes::{Avx512, Half, Pair, SingleAvx2, SingleAvx512, SingleSse2, Sse2, Vector};
use crate::simd::Width;

/// Columns of activations and packed weights are padded to a multiple of this: the widest register.
pub const COLUMNS: usize = 16;

/// Registers of the panel that begins where so many columns are left: two, or the three or the one that an odd number of
/// registers ends with, where a register is as wide as `COLUMNS`.
#[inline(always)]
pub(super) fn panel(columns: usize, lanes: usize) -> usize {
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
    fn check_result(&self, panel_rows: usize) {
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

/// The kernels of one precision on one instruction set.
#[derive(Debug, Clone, Copy)]
pub struct Kernels<F> {
    lanes: usize,
    product: unsafe fn(&mut Product<F>),
    pairs: unsafe fn(&mut Product<F>),
    outer: unsafe fn(&mut Outer<F>),
    spread: unsafe fn(&[F], &mut [F], usize),
    fold: unsafe fn(&[F], &mut [F], usize),
    dots: unsafe fn(&mut Dots<F>),
    sums: unsafe fn(&[F], &mut [F]),
    burst: unsafe fn(u64) -> F,
    burst_work: u64,
}

impl<F: Real> Kernels<F> {
    /// C = start + A·B.
    ///
    /// # Panics
    /// If an operand is too short.
    pub fn product(&self, mut p: Product<F>) {
        assert!(p.rows > 0 && p.columns.is_multiple_of(COLUMNS), "{} rows, {} columns", p.rows, p.columns);
        let reach = (p.rows - 1) * p.lda + (p.taps - 1) * p.step + p.depth;
        assert!(p.a.len() >= reach, "A: {} of {reach}", p.a.len());
        p.check_result(p.taps * p.depth);
        // SAFETY: lengths checked above; the machine has the instruction set, or these kernels would not exist.
        unsafe { (self.product)(&mut p) }
    }

    /// C = start + a ∗ w for even `rows`, where A is the `spread` of a and the panels hold w's four forms.
    ///
    /// # Panics
    /// If an operand is too short or `rows` odd.
    pub fn pairs(&self, mut p: Product<F>) {
        assert!(p.rows > 0 && p.columns.is_multiple_of(COLUMNS), "{} rows, {} columns", p.rows, p.columns);
        assert!(p.rows.is_multiple_of(2) && p.lda >= p.depth, "{} rows, stride {}", p.rows, p.lda);
        assert!(p.a.len() >= 2 * p.rows * p.lda, "A: {}", p.a.len());
        p.check_result(4 * p.depth);
        // SAFETY: as above.
        unsafe { (self.pairs)(&mut p) }
    }

    /// out[·, h] = (a₀ − a₂, a₁ + a₂, a₂ − a₁, a₁ − a₃) of the rows 2h … 2h + 3 of `a`, (T + 2, columns).
    ///
    /// # Panics
    /// If a length does not fit, or T is odd.
    pub fn spread(&self, a: &[F], out: &mut [F], columns: usize) {
        let pairs = (a.len() / columns - 2) / 2;
        assert!(
            columns.is_multiple_of(COLUMNS) && a.len() == (2 * pairs + 2) * columns,
            "{} {columns}",
            a.len()
        );
        assert!(out.len() == 4 * pairs * columns, "{} for {pairs} pairs", out.len());
        // SAFETY: as above.
        unsafe { (self.spread)(a, out, columns) }
    }

    /// out[·, h] = (a₀, a₀ + a₁, a₀ − a₁, a₁) of the rows 2h and 2h + 1 of `a`, (T, columns).
    ///
    /// # Panics
    /// If a length does not fit, or T is odd.
    pub fn fold(&self, a: &[F], out: &mut [F], columns: usize) {
        assert!(
            columns.is_multiple_of(COLUMNS) && a.len().is_multiple_of(2 * columns),
            "{} {columns}",
            a.len()
        );
        assert_eq!(out.len(), 2 * a.len());
        // SAFETY: as above.
        unsafe { (self.fold)(a, out, columns) }
    }

    /// C += Aᵀ·B.
    ///
    /// # Panics
    /// If an operand is too short.
    pub fn outer(&self, mut p: Outer<F>) {
        assert!(p.rows > 0 && p.columns.is_multiple_of(COLUMNS), "{} rows, {} columns", p.rows, p.columns);
        assert!(p.a.len() >= (p.rows - 1) * p.lda + p.depth, "A: {}", p.a.len());
        assert!(p.b.len() >= p.rows * p.columns && p.c.len() >= p.depth * p.columns);
        // SAFETY: as above.
        unsafe { (self.outer)(&mut p) }
    }

    /// C = bias + A·Wᵀ.
    ///
    /// # Panics
    /// If an operand is too short.
    pub fn dots(&self, mut p: Dots<F>) {
        assert!(p.columns.is_multiple_of(COLUMNS), "{} columns", p.columns);
        assert!(p.a.len() >= p.rows * p.columns + (p.taps - 1) * p.step, "A: {}", p.a.len());
        assert!(p.w.len() >= p.taps * p.bias.len() * p.columns);
        assert!(p.c.len() >= p.rows * p.bias.len());
        // SAFETY: as above.
        unsafe { (self.dots)(&mut p) }
    }

    /// Adds the rows of A, as long as `c`, to `c`.
    ///
    /// # Panics
    /// If `c` is no multiple of `COLUMNS` long.
    pub fn add_rows(&self, a: &[F], c: &mut [F]) {
        assert!(
            c.len().is_multiple_of(COLUMNS) && a.len().is_multiple_of(c.len()),
            "{} {}",
            a.len(),
            c.len()
        );
        // SAFETY: as above.
        unsafe { (self.sums)(a, c) }
    }

    /// Multiply-adds on registers alone, the yardstick of the other kernels; returns how many operations they were.
    pub fn burst(&self, rounds: u64) -> u64 {
        // SAFETY: as above.
        std::hint::black_box(unsafe { (self.burst)(rounds) });
        rounds * self.burst_work
    }

    /// Writes B (depth, columns), given row by row by its entries, in panels.
    pub fn pack<E: Fn(usize) -> F>(
        &self,
        depth: usize,
        columns: usize,
        row: impl Fn(usize) -> E,
        out: &mut [F],
    ) {
        let mut column = 0;
        while column < columns {
            let width = panel(columns - column, self.lanes) * self.lanes;
            let rows = &mut out[column * depth..(column + width) * depth];
            for (d, out) in rows.chunks_exact_mut(width).enumerate() {
                let entry = row(d);
                out.iter_mut().zip(column..).for_each(|(to, c)| *to = entry(c));
            }
            column += width;
        }
    }
}

#[inline(always)]
unsafe fn product<V: Vector, const R: usize, const R3: usize>(p: &mut Product<V::Scalar>) {
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
#[inline(always)]
pub(super) unsafe fn accumulate<V: Vector, const R: usize, const W: usize>(
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
#[inline(always)]
pub(super) unsafe fn close<V: Vector, const R: usize, const W: usize>(
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

#[inline(always)]
unsafe fn outer<V: Vector, const R: usize, const R3: usize>(p: &mut Outer<V::Scalar>) {
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

#[inline(always)]
unsafe fn dots<V: Vector>(p: &mut Dots<V::Scalar>) {
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

#[inline(always)]
unsafe fn sums<V: Vector>(a: &[V::Scalar], c: &mut [V::Scalar]) {
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
const CHAINS: usize = 12;

#[inline(always)]
fn burst<V: Vector>(rounds: u64) -> V::Scalar {
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

macro_rules! entries {
    // Rows of a tile of `product`, `outer` and `pairs`: two registers wide, and three.
    ($name:ident, $vector:ty, [$rows:literal, $outer_rows:literal, $pair_rows:literal],
     [$rows3:literal, $outer_rows3:literal, $pair_rows3:literal] $(, $features:literal)?) => {
        mod $name {
            use super::*;
            type F = <$vector as Vector>::Scalar;
            $(#[target_feature(enable = $features)])?
            unsafe fn product(p: &mut Product<F>) {
                // SAFETY: the caller's promise.
                unsafe { super::product::<$vector, $rows, $rows3>(p) }
            }
            $(#[target_feature(enable = $features)])?
            unsafe fn outer(p: &mut Outer<F>) {
                // SAFETY: the caller's promise.
                unsafe { super::outer::<$vector, $outer_rows, $outer_rows3>(p) }
            }
            $(#[target_feature(enable = $features)])?
            unsafe fn pairs(p: &mut Product<F>) {
                // SAFETY: the caller's promise.
                unsafe { winograd::pairs::<$vector, $pair_rows, $pair_rows3>(p) }
            }
            $(#[target_feature(enable = $features)])?
            unsafe fn spread(a: &[F], out: &mut [F], columns: usize) {
                // SAFETY: the caller's promise.
                unsafe { winograd::spread::<$vector>(a, out, columns) }
            }
            $(#[target_feature(enable = $features)])?
            unsafe fn fold(a: &[F], out: &mut [F], columns: usize) {
                // SAFETY: the caller's promise.
                unsafe { winograd::fold::<$vector>(a, out, columns) }
            }
            $(#[target_feature(enable = $features)])?
            unsafe fn dots(p: &mut Dots<F>) {
                // SAFETY: the caller's promise.
                unsafe { super::dots::<$vector>(p) }
            }
            $(#[target_feature(enable = $features)])?
            unsafe fn sums(a: &[F], c: &mut [F]) {
                // SAFETY: the caller's promise.
                unsafe { super::sums::<$vector>(a, c) }
            }
            $(#[target_feature(enable = $features)])?
            unsafe fn burst(rounds: u64) -> F {
                super::burst::<$vector>(rounds)
            }
            const LANES: usize = <$vector as Vector>::LANES;
            pub const KERNELS: Kernels<F> = Kernels {
                lanes: LANES,
                product,
                pairs,
                spread,
                fold,
                outer,
                dots,
                sums,
                burst,
                burst_work: 2 * (CHAINS * LANES) as u64,
            };
        }
    };
}

entries!(plain_f32, SingleSse2, [4, 4, 2], [1, 1, 1]);
entries!(plain_f64, Pair<Sse2>, [2, 2, 1], [1, 1, 1]);
entries!(avx2_f32, SingleAvx2, [6, 6, 3], [1, 1, 1], "avx2,fma");
entries!(avx2_f64, Half, [6, 6, 3], [1, 1, 1], "avx2,fma");
entries!(avx512_f32, SingleAvx512, [10, 12, 5], [8, 8, 4], "avx512f,avx512dq,avx512vl,avx512bw,fma");
entries!(avx512_f64, Avx512, [10, 12, 5], [1, 1, 1], "avx512f,avx512dq,avx512vl,avx512bw,fma");

macro_rules! choose {
    ($name:ident, $type:ty, $plain:ident, $avx2:ident, $avx512:ident) => {
        /// The kernels of this precision.
        ///
        /// # Panics
        /// If the machine lacks the instruction set.
        pub fn $name(width: Width) -> Kernels<$type> {
            width.check();
            match width {
                Width::Avx512 => $avx512::KERNELS,
                Width::Avx2 => $avx2::KERNELS,
                Width::Baseline => $plain::KERNELS,
            }
        }
    };
}
choose!(of_f32, f32, plain_f32, avx2_f32, avx512_f32);
choose!(of_f64, f64, plain_f64, avx2_f64, avx512_f64);
