//! One vector register of scalars, on each instruction set, for the tiles of `kernels`.
//!
//! Every method is `#[inline(always)]`, so that it takes on the target features of the entry that it is inlined into.

use super::real::Real;

/// Some lanes of scalars.
///
/// # Safety
/// The machine must have the instruction set of the type; pointers must be valid for `LANES` scalars (any alignment).
pub unsafe trait Vector: Copy {
    /// What a lane holds.
    type Scalar: Real;
    /// Lanes of one register.
    const LANES: usize;
    /// All lanes the same.
    unsafe fn splat(value: Self::Scalar) -> Self;
    /// Reads.
    unsafe fn load(from: *const Self::Scalar) -> Self;
    /// Writes.
    unsafe fn store(self, to: *mut Self::Scalar);
    /// self + a·b, fused where the machine can.
    unsafe fn plus_product(self, a: Self, b: Self) -> Self;
    /// self + a.
    unsafe fn plus(self, a: Self) -> Self;
    /// self − a.
    unsafe fn minus(self, a: Self) -> Self;
    /// max(self, 0); keeps NaN.
    unsafe fn relu(self) -> Self;
    /// self where `by` > 0, else 0.
    unsafe fn gate(self, by: Self) -> Self;
    /// The sum of the lanes.
    unsafe fn sum(self) -> Self::Scalar;
}

/// Four lanes in plain Rust: the baseline of every target. No fused multiply-add, which would be a library call.
#[derive(Clone, Copy)]
pub struct Plain<F>([F; 4]);

// SAFETY: no instruction set is assumed; reads and writes are unaligned.
unsafe impl<F: Real> Vector for Plain<F> {
    type Scalar = F;
    const LANES: usize = 4;
    #[inline(always)]
    unsafe fn splat(value: F) -> Self {
        Self([value; 4])
    }
    #[inline(always)]
    unsafe fn load(from: *const F) -> Self {
        // SAFETY: the caller's promise.
        Self(unsafe { from.cast::<[F; 4]>().read_unaligned() })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut F) {
        // SAFETY: the caller's promise.
        unsafe { to.cast::<[F; 4]>().write_unaligned(self.0) }
    }
    #[inline(always)]
    unsafe fn plus_product(self, a: Self, b: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + a.0[i] * b.0[i]))
    }
    #[inline(always)]
    unsafe fn plus(self, a: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + a.0[i]))
    }
    #[inline(always)]
    unsafe fn minus(self, a: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] - a.0[i]))
    }
    #[inline(always)]
    unsafe fn relu(self) -> Self {
        Self(self.0.map(|x| if x < F::ZERO { F::ZERO } else { x }))
    }
    #[inline(always)]
    unsafe fn gate(self, by: Self) -> Self {
        Self(std::array::from_fn(|i| if by.0[i] > F::ZERO { self.0[i] } else { F::ZERO }))
    }
    #[inline(always)]
    unsafe fn sum(self) -> F {
        (self.0[0] + self.0[2]) + (self.0[1] + self.0[3])
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Vector;
    use std::arch::x86_64::*;

    macro_rules! vector {
        ($type:ty, $scalar:ty, $lanes:literal, $splat:ident, $load:ident, $store:ident, $fma:ident, $add:ident, $sub:ident, $max:ident,
         $zero:ident, |$value:ident, $by:ident| $gate:expr, |$all:ident| $sum:expr) => {
            // SAFETY: intrinsics of the register's own instruction set, which the trait's contract grants.
            unsafe impl Vector for $type {
                type Scalar = $scalar;
                const LANES: usize = $lanes;
                #[inline(always)]
                unsafe fn splat(value: $scalar) -> Self {
                    // SAFETY: as above.
                    unsafe { $splat(value) }
                }
                #[inline(always)]
                unsafe fn load(from: *const $scalar) -> Self {
                    // SAFETY: as above.
                    unsafe { $load(from) }
                }
                #[inline(always)]
                unsafe fn store(self, to: *mut $scalar) {
                    // SAFETY: as above.
                    unsafe { $store(to, self) }
                }
                #[inline(always)]
                unsafe fn plus_product(self, a: Self, b: Self) -> Self {
                    // SAFETY: as above.
                    unsafe { $fma(a, b, self) }
                }
                #[inline(always)]
                unsafe fn plus(self, a: Self) -> Self {
                    // SAFETY: as above.
                    unsafe { $add(self, a) }
                }
                #[inline(always)]
                unsafe fn minus(self, a: Self) -> Self {
                    // SAFETY: as above.
                    unsafe { $sub(self, a) }
                }
                #[inline(always)]
                unsafe fn relu(self) -> Self {
                    // SAFETY: as above. The second operand is the one returned when either is NaN.
                    unsafe { $max($zero(), self) }
                }
                #[inline(always)]
                unsafe fn gate(self, by: Self) -> Self {
                    let ($value, $by) = (self, by);
                    // SAFETY: as above.
                    unsafe { $gate }
                }
                #[inline(always)]
                unsafe fn sum(self) -> $scalar {
                    let $all = self;
                    // SAFETY: as above.
                    unsafe { $sum }
                }
            }
        };
    }

    vector!(
        __m512,
        f32,
        16,
        _mm512_set1_ps,
        _mm512_loadu_ps,
        _mm512_storeu_ps,
        _mm512_fmadd_ps,
        _mm512_add_ps,
        _mm512_sub_ps,
        _mm512_max_ps,
        _mm512_setzero_ps,
        |value, by| _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(by, _mm512_setzero_ps()), value),
        |all| _mm512_reduce_add_ps(all)
    );
    vector!(
        __m512d,
        f64,
        8,
        _mm512_set1_pd,
        _mm512_loadu_pd,
        _mm512_storeu_pd,
        _mm512_fmadd_pd,
        _mm512_add_pd,
        _mm512_sub_pd,
        _mm512_max_pd,
        _mm512_setzero_pd,
        |value, by| _mm512_maskz_mov_pd(_mm512_cmp_pd_mask::<_CMP_GT_OQ>(by, _mm512_setzero_pd()), value),
        |all| _mm512_reduce_add_pd(all)
    );
    vector!(
        __m256,
        f32,
        8,
        _mm256_set1_ps,
        _mm256_loadu_ps,
        _mm256_storeu_ps,
        _mm256_fmadd_ps,
        _mm256_add_ps,
        _mm256_sub_ps,
        _mm256_max_ps,
        _mm256_setzero_ps,
        |value, by| _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(by, _mm256_setzero_ps()), value),
        |all| {
            let four = _mm_add_ps(_mm256_castps256_ps128(all), _mm256_extractf128_ps::<1>(all));
            let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_movehdup_ps(two)))
        }
    );
    vector!(
        __m256d,
        f64,
        4,
        _mm256_set1_pd,
        _mm256_loadu_pd,
        _mm256_storeu_pd,
        _mm256_fmadd_pd,
        _mm256_add_pd,
        _mm256_sub_pd,
        _mm256_max_pd,
        _mm256_setzero_pd,
        |value, by| _mm256_and_pd(_mm256_cmp_pd::<_CMP_GT_OQ>(by, _mm256_setzero_pd()), value),
        |all| {
            let two = _mm_add_pd(_mm256_castpd256_pd128(all), _mm256_extractf128_pd::<1>(all));
            _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)))
        }
    );
}
