//! Matrix products of the network for each instruction set and precision: f32 for training, f64 for Hessian products and checks.
//!
//! `tiles` contains `product`, `outer` and `dots`; `winograd` contains `pairs`, a k = 3 convolution with 4 products per pair of
//! rows instead of 6.

use super::tiles::{self, COLUMNS, Dots, Outer, Product, panel};
use super::winograd;
#[cfg(target_arch = "x86_64")]
use crate::lanes::{Avx512, Half, SingleAvx2, SingleAvx512};
use crate::lanes::{Base, Pair, Scalar, SingleBase, Vector};
use crate::simd::Width;

/// Kernels of one precision and instruction set.
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

impl<F: Scalar> Kernels<F> {
    /// C = start + A·B.
    ///
    /// # Panics
    /// If an operand is too short.
    pub fn product(&self, mut p: Product<F>) {
        assert!(p.rows > 0 && p.columns.is_multiple_of(COLUMNS), "{} rows, {} columns", p.rows, p.columns);
        let reach = (p.rows - 1) * p.lda + (p.taps - 1) * p.step + p.depth;
        assert!(p.a.len() >= reach, "A: {} of {reach}", p.a.len());
        p.check_result(p.taps * p.depth);
        // SAFETY: lengths are checked above; these kernels exist only if the machine supports the instruction set.
        unsafe { (self.product)(&mut p) }
    }

    /// C = start + a ∗ w for even `rows`; A is the `spread` of a, and the panels contain the four forms of w.
    ///
    /// # Panics
    /// If an operand is too short or `rows` is odd.
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
    /// If a length does not match, or T is odd.
    pub fn spread(&self, a: &[F], out: &mut [F], columns: usize) {
        let (length, pairs) = (a.len(), (a.len() / columns - 2) / 2);
        let whole = columns.is_multiple_of(COLUMNS) && length == (2 * pairs + 2) * columns;
        assert!(whole, "{length} {columns}");
        assert!(out.len() == 4 * pairs * columns, "{} for {pairs} pairs", out.len());
        // SAFETY: as above.
        unsafe { (self.spread)(a, out, columns) }
    }

    /// out[·, h] = (a₀, a₀ + a₁, a₀ − a₁, a₁) of the rows 2h and 2h + 1 of `a`, (T, columns).
    ///
    /// # Panics
    /// If a length does not match, or T is odd.
    pub fn fold(&self, a: &[F], out: &mut [F], columns: usize) {
        let length = a.len();
        assert!(columns.is_multiple_of(COLUMNS) && length.is_multiple_of(2 * columns), "{length} {columns}");
        assert_eq!(out.len(), 2 * length);
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

    /// Adds the rows of A, each as long as `c`, to `c`.
    ///
    /// # Panics
    /// If the length of `c` is not a multiple of `COLUMNS`.
    pub fn add_rows(&self, a: &[F], c: &mut [F]) {
        let (length, columns) = (a.len(), c.len());
        assert!(columns.is_multiple_of(COLUMNS) && length.is_multiple_of(columns), "{length} {columns}");
        // SAFETY: as above.
        unsafe { (self.sums)(a, c) }
    }

    /// Multiply-adds on registers only, a reference for the speed of the other kernels. Returns the number of operations.
    pub fn burst(&self, rounds: u64) -> u64 {
        // SAFETY: as above.
        std::hint::black_box(unsafe { (self.burst)(rounds) });
        rounds * self.burst_work
    }

    /// Stores B (depth, columns) in panels; `row` returns the entries of a row.
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

/// Compiles a generic function for an instruction set, with all callees inlined.
macro_rules! entry {
    ($features:tt $name:ident($($argument:ident: $type:ty),*) $(-> $result:ty)? = $generic:expr) => {
        entry!(@ $features
            unsafe fn $name($($argument: $type),*) $(-> $result)? {
                // SAFETY: guaranteed by the caller.
                unsafe { $generic($($argument),*) }
            });
    };
    (@ [] $function:item) => { $function };
    (@ [$features:literal] $function:item) => { #[target_feature(enable = $features)] $function };
}

macro_rules! entries {
    // rows of a tile of `product`, `outer` and `pairs`: for panels of up to two registers, and of three
    ($name:ident, $vector:ty, [$rows:literal, $outer_rows:literal, $pair_rows:literal],
     [$rows3:literal, $outer_rows3:literal, $pair_rows3:literal], $features:tt) => {
        mod $name {
            use super::*;
            type F = <$vector as Vector>::Scalar;
            entry!($features product(p: &mut Product<F>) = tiles::product::<$vector, $rows, $rows3>);
            entry!($features outer(p: &mut Outer<F>) = tiles::outer::<$vector, $outer_rows, $outer_rows3>);
            entry!($features pairs(p: &mut Product<F>) = winograd::pairs::<$vector, $pair_rows, $pair_rows3>);
            entry!($features spread(a: &[F], out: &mut [F], columns: usize) = winograd::spread::<$vector>);
            entry!($features fold(a: &[F], out: &mut [F], columns: usize) = winograd::fold::<$vector>);
            entry!($features dots(p: &mut Dots<F>) = tiles::dots::<$vector>);
            entry!($features sums(a: &[F], c: &mut [F]) = tiles::sums::<$vector>);
            entry!($features burst(rounds: u64) -> F = tiles::burst::<$vector>);
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
                burst_work: 2 * (tiles::CHAINS * LANES) as u64,
            };
        }
    };
}

entries!(plain_f32, SingleBase, [4, 4, 2], [1, 1, 1], []);
entries!(plain_f64, Pair<Base>, [2, 2, 1], [1, 1, 1], []);
#[cfg(target_arch = "x86_64")]
entries!(avx2_f32, SingleAvx2, [6, 6, 3], [1, 1, 1], ["avx2,fma"]);
#[cfg(target_arch = "x86_64")]
entries!(avx2_f64, Half, [6, 6, 3], [1, 1, 1], ["avx2,fma"]);
#[cfg(target_arch = "x86_64")]
entries!(avx512_f32, SingleAvx512, [10, 12, 5], [8, 8, 4], ["avx512f,avx512dq,avx512vl,avx512bw,fma"]);
#[cfg(target_arch = "x86_64")]
entries!(avx512_f64, Avx512, [10, 12, 5], [1, 1, 1], ["avx512f,avx512dq,avx512vl,avx512bw,fma"]);

/// A scalar type with kernels.
pub trait Real: Scalar {
    /// Whether the forward pass must add in the order of the reference implementation, as f64 checks require. A unit that
    /// training left at the kink of its ReLU is on or off depending on its last bit, and H with it.
    const REFERENCE_ORDER: bool;
    /// Kernels for this instruction set.
    ///
    /// # Panics
    /// If the machine does not support `width`.
    fn kernels(width: Width) -> Kernels<Self>;
}

macro_rules! real {
    ($type:ty, $reference_order:literal, [$plain:ident, $avx2:ident, $avx512:ident]) => {
        impl Real for $type {
            const REFERENCE_ORDER: bool = $reference_order;
            fn kernels(width: Width) -> Kernels<Self> {
                width.check();
                match width {
                    #[cfg(target_arch = "x86_64")]
                    Width::Avx512 => $avx512::KERNELS,
                    #[cfg(target_arch = "x86_64")]
                    Width::Avx2 => $avx2::KERNELS,
                    _ => $plain::KERNELS,
                }
            }
        }
    };
}
real!(f32, false, [plain_f32, avx2_f32, avx512_f32]);
real!(f64, true, [plain_f64, avx2_f64, avx512_f64]);
