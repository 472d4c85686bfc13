//! Eight f64 lanes, one sample each, as one AVX-512 register, two AVX2 registers or an array.
//!
//! Everything is inlined into entry points that enable the instruction set, so an operation is one instruction or two.
//! A closure would not be, for it does not take on their instruction set: none computes with vectors (`tests/disassembly.rs`).
//! Lanes never mix, and each operation is correctly rounded but `rsqrt` and, without FMA, `mul_add`.

use std::ops::{Add, Mul, Neg, Sub};

/// Lanes of a vector: samples integrated together.
pub const LANES: usize = 8;

/// Eight f64 lanes.
pub trait Vector:
    Copy + Send + Sync + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
    /// 0 in all lanes.
    const ZERO: Self;
    /// The same number in all lanes.
    fn splat(x: f64) -> Self;
    /// From an array.
    fn new(lanes: [f64; LANES]) -> Self;
    /// To an array.
    fn array(self) -> [f64; LANES];
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
    /// The larger; the second where one is NaN.
    fn max(self, other: Self) -> Self;
    /// self where a < b, else other.
    fn where_less(self, a: Self, b: Self, other: Self) -> Self;
    /// Whether self < b in any lane.
    fn any_less(self, b: Self) -> bool;
    /// Whether |self| ≤ limit in every lane (false where NaN).
    fn all_within(self, limit: f64) -> bool;
}

/// Either number in all lanes of a vector of its own.
#[inline(always)]
pub fn pair<V: Vector>([x, y]: [f64; 2]) -> [V; 2] {
    [V::splat(x), V::splat(y)]
}

macro_rules! operators {
    ($t:ty) => {
        impl Add for $t {
            type Output = Self;
            #[inline(always)]
            fn add(self, o: Self) -> Self {
                self.plus(o)
            }
        }
        impl Sub for $t {
            type Output = Self;
            #[inline(always)]
            fn sub(self, o: Self) -> Self {
                self.minus(o)
            }
        }
        impl Mul for $t {
            type Output = Self;
            #[inline(always)]
            fn mul(self, o: Self) -> Self {
                self.times(o)
            }
        }
        impl Neg for $t {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                Self::splat(-0.0).minus(self)
            }
        }
    };
}

/// An array: what every machine has.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub struct Array([f64; LANES]);

/// An array by the value of each lane.
macro_rules! lanes {
    ($i:ident: $value:expr) => {{
        let mut r = [0.0; LANES];
        for $i in 0..LANES {
            r[$i] = $value;
        }
        Self(r)
    }};
}

impl Array {
    #[inline(always)]
    fn plus(self, o: Self) -> Self {
        lanes!(i: self.0[i] + o.0[i])
    }
    #[inline(always)]
    fn minus(self, o: Self) -> Self {
        lanes!(i: self.0[i] - o.0[i])
    }
    #[inline(always)]
    fn times(self, o: Self) -> Self {
        lanes!(i: self.0[i] * o.0[i])
    }
}
operators!(Array);

impl Vector for Array {
    const ZERO: Self = Self([0.0; LANES]);
    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self([x; LANES])
    }
    #[inline(always)]
    fn new(lanes: [f64; LANES]) -> Self {
        Self(lanes)
    }
    #[inline(always)]
    fn array(self) -> [f64; LANES] {
        self.0
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        self.times(a).plus(b)
    }
    #[inline(always)]
    fn mul_sub_from(self, a: Self, b: Self) -> Self {
        b.minus(self.times(a))
    }
    #[inline(always)]
    fn over(self, a: Self) -> Self {
        lanes!(i: self.0[i] / a.0[i])
    }
    #[inline(always)]
    fn rsqrt(self) -> Self {
        lanes!(i: 1.0 / self.0[i].sqrt())
    }
    #[inline(always)]
    fn abs(self) -> Self {
        lanes!(i: self.0[i].abs())
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        lanes!(i: if self.0[i] > other.0[i] { self.0[i] } else { other.0[i] })
    }
    #[inline(always)]
    fn where_less(self, a: Self, b: Self, other: Self) -> Self {
        lanes!(i: if a.0[i] < b.0[i] { self.0[i] } else { other.0[i] })
    }
    #[inline(always)]
    fn any_less(self, b: Self) -> bool {
        let mut any = false;
        for i in 0..LANES {
            any |= self.0[i] < b.0[i];
        }
        any
    }
    #[inline(always)]
    fn all_within(self, limit: f64) -> bool {
        let mut all = true;
        for i in 0..LANES {
            all &= self.0[i].abs() <= limit;
        }
        all
    }
}

#[cfg(target_arch = "x86_64")]
pub use x86::{Avx2, Avx512};

#[cfg(target_arch = "x86_64")]
mod x86 {
    // SAFETY (this module): values of these types are made only inside the entry points of `dispatch`, which run only
    // where `Width::detect` has seen the instructions; the intrinsics touch no memory but their own arrays.
    #![expect(clippy::undocumented_unsafe_blocks, reason = "one argument for all, above")]
    use super::{Add, LANES, Mul, Neg, Sub, Vector};
    use std::arch::x86_64::*;
    use std::mem::transmute;

    /// One 512-bit register.
    #[derive(Clone, Copy)]
    #[repr(transparent)]
    pub struct Avx512(__m512d);

    impl Avx512 {
        #[inline(always)]
        fn plus(self, o: Self) -> Self {
            Self(unsafe { _mm512_add_pd(self.0, o.0) })
        }
        #[inline(always)]
        fn minus(self, o: Self) -> Self {
            Self(unsafe { _mm512_sub_pd(self.0, o.0) })
        }
        #[inline(always)]
        fn times(self, o: Self) -> Self {
            Self(unsafe { _mm512_mul_pd(self.0, o.0) })
        }
    }
    operators!(Avx512);

    impl Vector for Avx512 {
        const ZERO: Self = Self(unsafe { transmute::<[f64; LANES], __m512d>([0.0; LANES]) });
        #[inline(always)]
        fn splat(x: f64) -> Self {
            Self(unsafe { _mm512_set1_pd(x) })
        }
        #[inline(always)]
        fn new(lanes: [f64; LANES]) -> Self {
            Self(unsafe { transmute::<[f64; LANES], __m512d>(lanes) })
        }
        #[inline(always)]
        fn array(self) -> [f64; LANES] {
            unsafe { transmute(self.0) }
        }
        #[inline(always)]
        fn mul_add(self, a: Self, b: Self) -> Self {
            Self(unsafe { _mm512_fmadd_pd(self.0, a.0, b.0) })
        }
        #[inline(always)]
        fn mul_sub_from(self, a: Self, b: Self) -> Self {
            Self(unsafe { _mm512_fnmadd_pd(self.0, a.0, b.0) })
        }
        #[inline(always)]
        fn over(self, a: Self) -> Self {
            Self(unsafe { _mm512_div_pd(self.0, a.0) })
        }
        #[inline(always)]
        fn rsqrt(self) -> Self {
            // 14 bits, then a step of fourth order: e is below 2⁻¹³, and 35/128 e⁴ below an ulp's third
            let y = Self(unsafe { _mm512_rsqrt14_pd(self.0) });
            let e = self.times(y).mul_sub_from(y, Self::splat(1.0));
            let p = e.mul_add(Self::splat(0.3125), Self::splat(0.375)).mul_add(e, Self::splat(0.5));
            y.times(e).mul_add(p, y)
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self(unsafe { _mm512_abs_pd(self.0) })
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            Self(unsafe { _mm512_max_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn where_less(self, a: Self, b: Self, other: Self) -> Self {
            Self(unsafe { _mm512_mask_blend_pd(_mm512_cmp_pd_mask::<_CMP_LT_OQ>(a.0, b.0), other.0, self.0) })
        }
        #[inline(always)]
        fn any_less(self, b: Self) -> bool {
            unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(self.0, b.0) != 0 }
        }
        #[inline(always)]
        fn all_within(self, limit: f64) -> bool {
            unsafe { _mm512_cmp_pd_mask::<_CMP_LE_OQ>(self.abs().0, _mm512_set1_pd(limit)) == 0xff }
        }
    }

    /// Two 256-bit registers.
    #[derive(Clone, Copy)]
    #[repr(C, align(64))]
    pub struct Avx2(__m256d, __m256d);

    impl Avx2 {
        #[inline(always)]
        fn plus(self, o: Self) -> Self {
            unsafe { Self(_mm256_add_pd(self.0, o.0), _mm256_add_pd(self.1, o.1)) }
        }
        #[inline(always)]
        fn minus(self, o: Self) -> Self {
            unsafe { Self(_mm256_sub_pd(self.0, o.0), _mm256_sub_pd(self.1, o.1)) }
        }
        #[inline(always)]
        fn times(self, o: Self) -> Self {
            unsafe { Self(_mm256_mul_pd(self.0, o.0), _mm256_mul_pd(self.1, o.1)) }
        }
    }
    operators!(Avx2);

    impl Vector for Avx2 {
        const ZERO: Self = unsafe { transmute([0.0f64; LANES]) };
        #[inline(always)]
        fn splat(x: f64) -> Self {
            unsafe { Self(_mm256_set1_pd(x), _mm256_set1_pd(x)) }
        }
        #[inline(always)]
        fn new(lanes: [f64; LANES]) -> Self {
            unsafe { transmute(lanes) }
        }
        #[inline(always)]
        fn array(self) -> [f64; LANES] {
            unsafe { transmute(self) }
        }
        #[inline(always)]
        fn mul_add(self, a: Self, b: Self) -> Self {
            unsafe { Self(_mm256_fmadd_pd(self.0, a.0, b.0), _mm256_fmadd_pd(self.1, a.1, b.1)) }
        }
        #[inline(always)]
        fn mul_sub_from(self, a: Self, b: Self) -> Self {
            unsafe { Self(_mm256_fnmadd_pd(self.0, a.0, b.0), _mm256_fnmadd_pd(self.1, a.1, b.1)) }
        }
        #[inline(always)]
        fn over(self, a: Self) -> Self {
            unsafe { Self(_mm256_div_pd(self.0, a.0), _mm256_div_pd(self.1, a.1)) }
        }
        #[inline(always)]
        fn rsqrt(self) -> Self {
            let root = unsafe { Self(_mm256_sqrt_pd(self.0), _mm256_sqrt_pd(self.1)) };
            Self::splat(1.0).over(root)
        }
        #[inline(always)]
        fn abs(self) -> Self {
            let sign = unsafe { _mm256_set1_pd(-0.0) };
            unsafe { Self(_mm256_andnot_pd(sign, self.0), _mm256_andnot_pd(sign, self.1)) }
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            unsafe { Self(_mm256_max_pd(self.0, other.0), _mm256_max_pd(self.1, other.1)) }
        }
        #[inline(always)]
        fn where_less(self, a: Self, b: Self, other: Self) -> Self {
            unsafe {
                Self(
                    _mm256_blendv_pd(other.0, self.0, _mm256_cmp_pd::<_CMP_LT_OQ>(a.0, b.0)),
                    _mm256_blendv_pd(other.1, self.1, _mm256_cmp_pd::<_CMP_LT_OQ>(a.1, b.1)),
                )
            }
        }
        #[inline(always)]
        fn any_less(self, b: Self) -> bool {
            unsafe {
                let low = _mm256_cmp_pd::<_CMP_LT_OQ>(self.0, b.0);
                let high = _mm256_cmp_pd::<_CMP_LT_OQ>(self.1, b.1);
                _mm256_movemask_pd(_mm256_or_pd(low, high)) != 0
            }
        }
        #[inline(always)]
        fn all_within(self, limit: f64) -> bool {
            let a = self.abs();
            unsafe {
                let limit = _mm256_set1_pd(limit);
                let low = _mm256_cmp_pd::<_CMP_LE_OQ>(a.0, limit);
                let high = _mm256_cmp_pd::<_CMP_LE_OQ>(a.1, limit);
                _mm256_movemask_pd(_mm256_and_pd(low, high)) == 0xf
            }
        }
    }
}
