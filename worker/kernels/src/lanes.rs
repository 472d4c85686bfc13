//! SIMD vectors of f64 or f32. A lane holds one sample in the dynamics and one column in the decoders.
//!
//! All functions are inlined into entry points that enable the instruction set, so each operation compiles to one or two
//! instructions. Closures do not inherit the enabled instruction set; therefore no closure computes with vectors
//! (`tests/disassembly.rs`). Only `sum` combines lanes. All operations are correctly rounded except `rsqrt` and, without FMA,
//! `mul_add` and `mul_sub_from`.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// Lanes of the widest f64 vector: the number of samples integrated together.
pub const LANES: usize = 8;
/// Lanes of the widest vector (f32).
pub const MOST: usize = 16;

/// Element type of a vector.
pub trait Scalar:
    Copy
    + Default
    + PartialOrd
    + Send
    + Sync
    + std::fmt::Debug
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + AddAssign
    + 'static
{
    /// 0.
    const ZERO: Self;
    /// The nearest representable value.
    fn from_f64(x: f64) -> Self;
    /// Exact conversion.
    fn to_f64(self) -> f64;
    /// √self.
    fn sqrt(self) -> Self;
}

macro_rules! scalar {
    ($type:ty) => {
        impl Scalar for $type {
            const ZERO: Self = 0.0;
            #[inline(always)]
            fn from_f64(x: f64) -> Self {
                x as Self
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
        }
    };
}
scalar!(f32);
scalar!(f64);

/// A SIMD vector.
pub trait Vector:
    Copy + Send + Sync + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
    /// Type of a lane.
    type Scalar: Scalar;
    /// The f64 vector with the same number of lanes.
    type Wide: Vector<Scalar = f64, Wide = Self::Wide>;
    /// Number of lanes.
    const LANES: usize;
    /// 0 in all lanes.
    const ZERO: Self;
    /// Whether lanes hold f32.
    const SINGLE: bool = size_of::<Self::Scalar>() == 4;
    /// A vector with `x` in all lanes.
    fn from_scalar(x: Self::Scalar) -> Self;
    /// Rounds each lane of `wide`.
    fn narrow(wide: Self::Wide) -> Self;
    /// Converts each lane to f64, exactly.
    fn widen(self) -> Self::Wide;
    /// The lanes as a slice.
    fn lanes(&self) -> &[Self::Scalar];
    /// The lanes as a mutable slice.
    fn lanes_mut(&mut self) -> &mut [Self::Scalar];
    /// self·a + b.
    fn mul_add(self, a: Self, b: Self) -> Self;
    /// b − self·a.
    fn mul_sub_from(self, a: Self, b: Self) -> Self;
    /// self / a.
    fn over(self, a: Self) -> Self;
    /// 1/√self to within about an ulp; NaN or infinite at 0.
    fn rsqrt(self) -> Self;
    /// |self|.
    fn abs(self) -> Self;
    /// The maximum; `other` where either is NaN.
    fn max(self, other: Self) -> Self;
    /// self where a < b, else other.
    fn where_less(self, a: Self, b: Self, other: Self) -> Self;
    /// Whether self < b in any lane.
    fn any_less(self, b: Self) -> bool;
    /// Whether |self| ≤ limit in every lane (false where NaN).
    fn all_within(self, limit: f64) -> bool;
    /// The sum of the lanes.
    fn sum(self) -> Self::Scalar;
    /// Reads `LANES` consecutive scalars.
    ///
    /// # Safety
    /// `LANES` scalars must be readable at `from`; any alignment.
    unsafe fn load(from: *const Self::Scalar) -> Self;
    /// Writes the lanes to consecutive scalars.
    ///
    /// # Safety
    /// `LANES` scalars must be writable at `to`; any alignment.
    unsafe fn store(self, to: *mut Self::Scalar);

    /// A vector with `x` in all lanes, for constants: they are rounded at compile time.
    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self::from_scalar(Self::Scalar::from_f64(x))
    }
    /// Value of one lane.
    #[inline(always)]
    fn lane(&self, lane: usize) -> f64 {
        self.lanes()[lane].to_f64()
    }
    /// Sets one lane.
    #[inline(always)]
    fn set_lane(&mut self, lane: usize, x: f64) {
        self.lanes_mut()[lane] = Self::Scalar::from_f64(x);
    }
    /// A vector whose lanes are the values of `from`.
    #[inline(always)]
    fn gather(from: &[f64]) -> Self {
        let mut all = Self::ZERO;
        for (lane, x) in all.lanes_mut().iter_mut().zip(from) {
            *lane = Self::Scalar::from_f64(*x);
        }
        all
    }
}

/// Two vectors, one with `x` and one with `y` in all lanes.
#[inline(always)]
pub fn pair<V: Vector>([x, y]: [V::Scalar; 2]) -> [V; 2] {
    [V::from_scalar(x), V::from_scalar(y)]
}

macro_rules! operators {
    ([$($generic:tt)*] $t:ty) => {
        impl<$($generic)*> Add for $t {
            type Output = Self;
            #[inline(always)]
            fn add(self, o: Self) -> Self {
                self.plus(o)
            }
        }
        impl<$($generic)*> Sub for $t {
            type Output = Self;
            #[inline(always)]
            fn sub(self, o: Self) -> Self {
                self.minus(o)
            }
        }
        impl<$($generic)*> Mul for $t {
            type Output = Self;
            #[inline(always)]
            fn mul(self, o: Self) -> Self {
                self.times(o)
            }
        }
        impl<$($generic)*> Neg for $t {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                Self::splat(-0.0).minus(self)
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
pub use registers::{Avx2, Avx512, Half, HalfSingleAvx512, SingleAvx2, SingleAvx512};
pub use registers::{Base, Pair, SingleBase};

mod registers {
    // SAFETY (this module): every x86-64 machine has SSE2, every aarch64 machine NEON. Values of the other types are created only
    // inside the entry points of `dispatch` and of the brain's `kernels`, which run only where `Width::detect` has found the
    // instructions. Except for `load` and `store`, whose callers guarantee the memory, the intrinsics access no memory. Slices
    // refer to the value itself.
    #![expect(clippy::undocumented_unsafe_blocks, reason = "see the SAFETY comment of this module")]
    use super::{Add, Mul, Neg, Sub, Vector};
    #[cfg(target_arch = "aarch64")]
    use std::arch::aarch64::*;
    #[cfg(target_arch = "x86_64")]
    use std::arch::x86_64::*;
    use std::slice::{from_raw_parts, from_raw_parts_mut};

    /// Operations that compile to one instruction.
    macro_rules! instructions {
        ($($operation:ident($($o:ident),*) = $instruction:ident;)*) => {
            $(
                #[inline(always)]
                fn $operation(self, $($o: Self),*) -> Self {
                    Self(unsafe { $instruction(self.0, $($o.0),*) })
                }
            )*
        };
    }

    /// Defines the vector type of one register.
    macro_rules! register {
        ($name:ident: $register:ty, $scalar:ty, $lanes:literal;
         $set:ident, $load:ident, $store:ident, $add:ident, $sub:ident, $mul:ident, $fmadd:ident, $fnmadd:ident, $div:ident, $max:ident;
         abs($a:ident): $abs:expr, rsqrt($r:ident): $rsqrt:expr,
         less($x:ident, $y:ident): $less:expr, blend($mask:ident, $yes:ident, $no:ident): $blend:expr,
         within($z:ident, $most:ident): $within:expr, any($m:ident): $any:expr, sum($all:ident): $sum:expr,
         wide: $wide:ty, narrow($n:ident): $narrow:expr, widen($w:ident): $widen:expr) => {
            /// One register.
            #[derive(Clone, Copy)]
            #[repr(transparent)]
            pub struct $name($register);

            impl $name {
                instructions! { plus(o) = $add; minus(o) = $sub; times(o) = $mul; }
            }
            operators!([] $name);

            impl Vector for $name {
                type Scalar = $scalar;
                type Wide = $wide;
                const LANES: usize = $lanes;
                const ZERO: Self = Self(unsafe { std::mem::transmute::<[$scalar; $lanes], $register>([0.0; $lanes]) });
                #[inline(always)]
                fn from_scalar(x: $scalar) -> Self {
                    Self(unsafe { $set(x) })
                }
                #[inline(always)]
                fn narrow($n: $wide) -> Self {
                    $narrow
                }
                #[inline(always)]
                fn widen(self) -> $wide {
                    let $w = self;
                    $widen
                }
                #[inline(always)]
                fn lanes(&self) -> &[$scalar] {
                    unsafe { from_raw_parts((&raw const self.0).cast(), $lanes) }
                }
                #[inline(always)]
                fn lanes_mut(&mut self) -> &mut [$scalar] {
                    unsafe { from_raw_parts_mut((&raw mut self.0).cast(), $lanes) }
                }
                instructions! { mul_add(a, b) = $fmadd; mul_sub_from(a, b) = $fnmadd; over(a) = $div; max(other) = $max; }
                #[inline(always)]
                fn rsqrt(self) -> Self {
                    let $r = self;
                    $rsqrt
                }
                #[inline(always)]
                fn abs(self) -> Self {
                    let $a = self.0;
                    Self(unsafe { $abs })
                }
                #[inline(always)]
                fn where_less(self, a: Self, b: Self, other: Self) -> Self {
                    let ($x, $y, $yes, $no) = (a.0, b.0, self.0, other.0);
                    Self(unsafe {
                        let $mask = $less;
                        $blend
                    })
                }
                #[inline(always)]
                fn any_less(self, b: Self) -> bool {
                    let ($x, $y) = (self.0, b.0);
                    unsafe {
                        let $m = $less;
                        $any
                    }
                }
                #[inline(always)]
                fn all_within(self, limit: f64) -> bool {
                    let $z = self.abs().0;
                    unsafe {
                        let $most = $set(limit as $scalar);
                        $within
                    }
                }
                #[inline(always)]
                fn sum(self) -> $scalar {
                    let $all = self.0;
                    unsafe { $sum }
                }
                #[inline(always)]
                unsafe fn load(from: *const $scalar) -> Self {
                    Self(unsafe { $load(from) })
                }
                #[inline(always)]
                unsafe fn store(self, to: *mut $scalar) {
                    unsafe { $store(to, self.0) }
                }
            }
        };
    }

    #[cfg(target_arch = "x86_64")]
    register!(Avx512: __m512d, f64, 8;
        _mm512_set1_pd, _mm512_loadu_pd, _mm512_storeu_pd, _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd, _mm512_fmadd_pd, _mm512_fnmadd_pd,
        _mm512_div_pd, _mm512_max_pd;
        abs(a): _mm512_abs_pd(a),
        rsqrt(x): {
            // initial estimate of 14 bits, then one step of fourth order: |e| < 2⁻¹³, and 35/128 e⁴ is below a third of an ulp
            let y = Self(unsafe { _mm512_rsqrt14_pd(x.0) });
            let e = x.times(y).mul_sub_from(y, Self::splat(1.0));
            let p = e.mul_add(Self::splat(0.3125), Self::splat(0.375)).mul_add(e, Self::splat(0.5));
            y.times(e).mul_add(p, y)
        },
        less(x, y): _mm512_cmp_pd_mask::<_CMP_LT_OQ>(x, y),
        blend(mask, yes, no): _mm512_mask_blend_pd(mask, no, yes),
        within(x, most): _mm512_cmp_pd_mask::<_CMP_LE_OQ>(x, most) == 0xff,
        any(mask): mask != 0,
        sum(all): _mm512_reduce_add_pd(all),
        wide: Self, narrow(x): x, widen(x): x);

    #[cfg(target_arch = "x86_64")]
    register!(SingleAvx512: __m512, f32, 16;
    _mm512_set1_ps, _mm512_loadu_ps, _mm512_storeu_ps, _mm512_add_ps, _mm512_sub_ps, _mm512_mul_ps, _mm512_fmadd_ps, _mm512_fnmadd_ps,
    _mm512_div_ps, _mm512_max_ps;
    abs(a): _mm512_abs_ps(a),
    rsqrt(x): {
        // initial estimate of 14 bits, then one step of second order: 3/8 e² is below a tenth of an ulp
        let y = Self(unsafe { _mm512_rsqrt14_ps(x.0) });
        let e = x.times(y).mul_sub_from(y, Self::splat(1.0));
        y.times(e).mul_add(Self::splat(0.5), y)
    },
    less(x, y): _mm512_cmp_ps_mask::<_CMP_LT_OQ>(x, y),
    blend(mask, yes, no): _mm512_mask_blend_ps(mask, no, yes),
    within(x, most): _mm512_cmp_ps_mask::<_CMP_LE_OQ>(x, most) == 0xffff,
    any(mask): mask != 0,
    sum(all): _mm512_reduce_add_ps(all),
    wide: Pair<Avx512>,
    narrow(x): {
        let [low, high] = [x.0.0, x.1.0].map(|half| unsafe { _mm256_castps_pd(_mm512_cvtpd_ps(half)) });
        Self(unsafe { _mm512_castpd_ps(_mm512_insertf64x4::<1>(_mm512_castpd256_pd512(low), high)) })
    },
    widen(x): unsafe {
        let high = _mm256_castpd_ps(_mm512_extractf64x4_pd::<1>(_mm512_castps_pd(x.0)));
        Pair(Avx512(_mm512_cvtps_pd(_mm512_castps512_ps256(x.0))), Avx512(_mm512_cvtps_pd(high)))
    });

    // Half of a `SingleAvx512`; results are identical bit by bit.
    #[cfg(target_arch = "x86_64")]
    register!(HalfSingleAvx512: __m256, f32, 8;
    _mm256_set1_ps, _mm256_loadu_ps, _mm256_storeu_ps, _mm256_add_ps, _mm256_sub_ps, _mm256_mul_ps, _mm256_fmadd_ps, _mm256_fnmadd_ps,
    _mm256_div_ps, _mm256_max_ps;
    abs(a): _mm256_andnot_ps(_mm256_set1_ps(-0.0), a),
    rsqrt(x): {
        let y = Self(unsafe { _mm256_rsqrt14_ps(x.0) });
        let e = x.times(y).mul_sub_from(y, Self::splat(1.0));
        y.times(e).mul_add(Self::splat(0.5), y)
    },
    less(x, y): _mm256_cmp_ps_mask::<_CMP_LT_OQ>(x, y),
    blend(mask, yes, no): _mm256_mask_blend_ps(mask, no, yes),
    within(x, most): _mm256_cmp_ps_mask::<_CMP_LE_OQ>(x, most) == 0xff,
    any(mask): mask != 0,
    sum(all): sum_of_eight(all),
    wide: Avx512,
    narrow(x): Self(unsafe { _mm512_cvtpd_ps(x.0) }),
    widen(x): Avx512(unsafe { _mm512_cvtps_pd(x.0) }));

    #[cfg(target_arch = "x86_64")]
    register!(Half: __m256d, f64, 4;
    _mm256_set1_pd, _mm256_loadu_pd, _mm256_storeu_pd, _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd, _mm256_fmadd_pd, _mm256_fnmadd_pd,
    _mm256_div_pd, _mm256_max_pd;
    abs(a): _mm256_andnot_pd(_mm256_set1_pd(-0.0), a),
    rsqrt(x): Self::splat(1.0).over(Self(unsafe { _mm256_sqrt_pd(x.0) })),
    less(x, y): _mm256_cmp_pd::<_CMP_LT_OQ>(x, y),
    blend(mask, yes, no): _mm256_blendv_pd(no, yes, mask),
    within(x, most): _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LE_OQ>(x, most)) == 0xf,
    any(mask): _mm256_movemask_pd(mask) != 0,
    sum(all): {
        let two = _mm_add_pd(_mm256_castpd256_pd128(all), _mm256_extractf128_pd::<1>(all));
        _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)))
    },
    wide: Self, narrow(x): x, widen(x): x);

    #[cfg(target_arch = "x86_64")]
    register!(SingleAvx2: __m256, f32, 8;
    _mm256_set1_ps, _mm256_loadu_ps, _mm256_storeu_ps, _mm256_add_ps, _mm256_sub_ps, _mm256_mul_ps, _mm256_fmadd_ps, _mm256_fnmadd_ps,
    _mm256_div_ps, _mm256_max_ps;
    abs(a): _mm256_andnot_ps(_mm256_set1_ps(-0.0), a),
    rsqrt(x): Self::splat(1.0).over(Self(unsafe { _mm256_sqrt_ps(x.0) })),
    less(x, y): _mm256_cmp_ps::<_CMP_LT_OQ>(x, y),
    blend(mask, yes, no): _mm256_blendv_ps(no, yes, mask),
    within(x, most): _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(x, most)) == 0xff,
    any(mask): _mm256_movemask_ps(mask) != 0,
    sum(all): sum_of_eight(all),
    wide: Pair<Half>,
    narrow(x): Self(unsafe { _mm256_set_m128(_mm256_cvtpd_ps(x.1.0), _mm256_cvtpd_ps(x.0.0)) }),
    widen(x): unsafe {
        let (low, high) = (_mm256_castps256_ps128(x.0), _mm256_extractf128_ps::<1>(x.0));
        Pair(Half(_mm256_cvtps_pd(low)), Half(_mm256_cvtps_pd(high)))
    });

    // Available on every x86-64 machine. `mul_add` is not fused, because that would be a library call.
    #[cfg(target_arch = "x86_64")]
    register!(Base: __m128d, f64, 2;
    _mm_set1_pd, _mm_loadu_pd, _mm_storeu_pd, _mm_add_pd, _mm_sub_pd, _mm_mul_pd, mul_add_pd, mul_sub_from_pd,
    _mm_div_pd, _mm_max_pd;
    abs(a): _mm_andnot_pd(_mm_set1_pd(-0.0), a),
    rsqrt(x): Self::splat(1.0).over(Self(unsafe { _mm_sqrt_pd(x.0) })),
    less(x, y): _mm_cmplt_pd(x, y),
    blend(mask, yes, no): _mm_or_pd(_mm_and_pd(mask, yes), _mm_andnot_pd(mask, no)),
    within(x, most): _mm_movemask_pd(_mm_cmple_pd(x, most)) == 0x3,
    any(mask): _mm_movemask_pd(mask) != 0,
    sum(all): _mm_cvtsd_f64(_mm_add_sd(all, _mm_unpackhi_pd(all, all))),
    wide: Self, narrow(x): x, widen(x): x);

    #[cfg(target_arch = "x86_64")]
    register!(SingleBase: __m128, f32, 4;
    _mm_set1_ps, _mm_loadu_ps, _mm_storeu_ps, _mm_add_ps, _mm_sub_ps, _mm_mul_ps, mul_add_ps, mul_sub_from_ps,
    _mm_div_ps, _mm_max_ps;
    abs(a): _mm_andnot_ps(_mm_set1_ps(-0.0), a),
    rsqrt(x): Self::splat(1.0).over(Self(unsafe { _mm_sqrt_ps(x.0) })),
    less(x, y): _mm_cmplt_ps(x, y),
    blend(mask, yes, no): _mm_or_ps(_mm_and_ps(mask, yes), _mm_andnot_ps(mask, no)),
    within(x, most): _mm_movemask_ps(_mm_cmple_ps(x, most)) == 0xf,
    any(mask): _mm_movemask_ps(mask) != 0,
    sum(all): {
        let two = _mm_add_ps(all, _mm_movehl_ps(all, all));
        _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
    },
    wide: Pair<Base>,
    narrow(x): Self(unsafe { _mm_movelh_ps(_mm_cvtpd_ps(x.0.0), _mm_cvtpd_ps(x.1.0)) }),
    widen(x): unsafe { Pair(Base(_mm_cvtps_pd(x.0)), Base(_mm_cvtps_pd(_mm_movehl_ps(x.0, x.0)))) });

    // Available on every aarch64 machine. `mul_add` is not fused, so results equal those of `Base` on x86-64.
    #[cfg(target_arch = "aarch64")]
    register!(Base: float64x2_t, f64, 2;
    vdupq_n_f64, vld1q_f64, vst1q_f64, vaddq_f64, vsubq_f64, vmulq_f64, mul_add_pd, mul_sub_from_pd, vdivq_f64, max_pd;
    abs(a): vabsq_f64(a), rsqrt(x): Self::splat(1.0).over(Self(unsafe { vsqrtq_f64(x.0) })),
    less(x, y): vcltq_f64(x, y), blend(mask, yes, no): vbslq_f64(mask, yes, no),
    within(x, most): vminvq_u32(vreinterpretq_u32_u64(vcleq_f64(x, most))) != 0,
    any(mask): vmaxvq_u32(vreinterpretq_u32_u64(mask)) != 0, sum(all): vaddvq_f64(all), wide: Self, narrow(x): x, widen(x): x);

    #[cfg(target_arch = "aarch64")]
    register!(SingleBase: float32x4_t, f32, 4;
    vdupq_n_f32, vld1q_f32, vst1q_f32, vaddq_f32, vsubq_f32, vmulq_f32, mul_add_ps, mul_sub_from_ps, vdivq_f32, max_ps;
    abs(a): vabsq_f32(a), rsqrt(x): Self::splat(1.0).over(Self(unsafe { vsqrtq_f32(x.0) })),
    less(x, y): vcltq_f32(x, y), blend(mask, yes, no): vbslq_f32(mask, yes, no),
    within(x, most): vminvq_u32(vcleq_f32(x, most)) != 0, any(mask): vmaxvq_u32(mask) != 0,
    sum(all): vaddv_f32(vadd_f32(vget_low_f32(all), vget_high_f32(all))),
    wide: Pair<Base>, narrow(x): Self(unsafe { vcombine_f32(vcvt_f32_f64(x.0.0), vcvt_f32_f64(x.1.0)) }),
    widen(x): unsafe { Pair(Base(vcvt_f64_f32(vget_low_f32(x.0))), Base(vcvt_high_f64_f32(x.0))) });

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    unsafe fn sum_of_eight(all: __m256) -> f32 {
        unsafe {
            let four = _mm_add_ps(_mm256_castps256_ps128(all), _mm256_extractf128_ps::<1>(all));
            let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_movehdup_ps(two)))
        }
    }

    /// Operations composed of several instructions.
    macro_rules! composed {
        ($($operation:ident($($o:ident),*): $register:ty = $result:expr;)*) => {
            $(
                #[inline(always)]
                unsafe fn $operation($($o: $register),*) -> $register {
                    unsafe { $result }
                }
            )*
        };
    }
    #[cfg(target_arch = "x86_64")]
    composed! {
        mul_add_pd(a, b, c): __m128d = _mm_add_pd(_mm_mul_pd(a, b), c);
        mul_sub_from_pd(a, b, c): __m128d = _mm_sub_pd(c, _mm_mul_pd(a, b));
        mul_add_ps(a, b, c): __m128 = _mm_add_ps(_mm_mul_ps(a, b), c);
        mul_sub_from_ps(a, b, c): __m128 = _mm_sub_ps(c, _mm_mul_ps(a, b));
    }
    #[cfg(target_arch = "aarch64")]
    composed! {
        mul_add_pd(a, b, c): float64x2_t = vaddq_f64(vmulq_f64(a, b), c);
        mul_sub_from_pd(a, b, c): float64x2_t = vsubq_f64(c, vmulq_f64(a, b));
        max_pd(a, b): float64x2_t = vbslq_f64(vcgtq_f64(a, b), a, b);
        mul_add_ps(a, b, c): float32x4_t = vaddq_f32(vmulq_f32(a, b), c);
        mul_sub_from_ps(a, b, c): float32x4_t = vsubq_f32(c, vmulq_f32(a, b));
        max_ps(a, b): float32x4_t = vbslq_f32(vcgtq_f32(a, b), a, b);
    }

    /// Two vectors that act as one.
    #[derive(Clone, Copy)]
    #[repr(C, align(64))]
    pub struct Pair<L>(L, L);

    /// Two registers: as many lanes as AVX-512, and two independent chains of instructions.
    #[cfg(target_arch = "x86_64")]
    pub type Avx2 = Pair<Half>;

    impl<L: Vector> Pair<L> {
        #[inline(always)]
        fn plus(self, o: Self) -> Self {
            Self(self.0 + o.0, self.1 + o.1)
        }
        #[inline(always)]
        fn minus(self, o: Self) -> Self {
            Self(self.0 - o.0, self.1 - o.1)
        }
        #[inline(always)]
        fn times(self, o: Self) -> Self {
            Self(self.0 * o.0, self.1 * o.1)
        }
    }
    operators!([L: Vector] Pair<L>);

    /// Operations applied to both halves.
    macro_rules! halves {
        ($($operation:ident($($o:ident),*);)*) => {
            $(
                #[inline(always)]
                fn $operation(self, $($o: Self),*) -> Self {
                    Self(self.0.$operation($($o.0),*), self.1.$operation($($o.1),*))
                }
            )*
        };
    }

    impl<L: Vector> Vector for Pair<L> {
        type Scalar = L::Scalar;
        type Wide = Pair<L::Wide>;
        const LANES: usize = 2 * L::LANES;
        const ZERO: Self = Self(L::ZERO, L::ZERO);
        halves! {
            mul_add(a, b);
            mul_sub_from(a, b);
            over(a);
            rsqrt();
            abs();
            max(other);
            where_less(a, b, other);
        }
        #[inline(always)]
        fn from_scalar(x: L::Scalar) -> Self {
            Self(L::from_scalar(x), L::from_scalar(x))
        }
        #[inline(always)]
        fn narrow(wide: Self::Wide) -> Self {
            Self(L::narrow(wide.0), L::narrow(wide.1))
        }
        #[inline(always)]
        fn widen(self) -> Self::Wide {
            Pair(self.0.widen(), self.1.widen())
        }
        #[inline(always)]
        fn lanes(&self) -> &[L::Scalar] {
            unsafe { from_raw_parts((&raw const *self).cast(), Self::LANES) }
        }
        #[inline(always)]
        fn lanes_mut(&mut self) -> &mut [L::Scalar] {
            unsafe { from_raw_parts_mut((&raw mut *self).cast(), Self::LANES) }
        }
        #[inline(always)]
        fn any_less(self, b: Self) -> bool {
            self.0.any_less(b.0) | self.1.any_less(b.1)
        }
        #[inline(always)]
        fn all_within(self, limit: f64) -> bool {
            self.0.all_within(limit) & self.1.all_within(limit)
        }
        #[inline(always)]
        fn sum(self) -> L::Scalar {
            (self.0 + self.1).sum()
        }
        #[inline(always)]
        unsafe fn load(from: *const L::Scalar) -> Self {
            Self(unsafe { L::load(from) }, unsafe { L::load(from.add(L::LANES)) })
        }
        #[inline(always)]
        unsafe fn store(self, to: *mut L::Scalar) {
            unsafe {
                self.0.store(to);
                self.1.store(to.add(L::LANES));
            }
        }
    }
}

#[cfg(test)]
#[path = "lanes/tests.rs"]
mod tests;
