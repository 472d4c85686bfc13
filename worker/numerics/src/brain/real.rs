//! The two precisions of the brain: f32 to train, f64 for Hessian products and checks.

use super::kernels::Kernels;
use crate::simd::Width;
use std::ops::{Add, AddAssign, Div, Mul, Sub};

/// A scalar with kernels of its own.
pub trait Real:
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
    /// Whether the forward pass must sum in the reference's order, as checks in f64 do: a unit that training parked at
    /// its kink is on or off by its last bit, and H with it (seen: 0.7 % of z).
    const REFERENCE_ORDER: bool;
    /// 0.
    const ZERO: Self;
    /// The nearest value.
    fn from_f64(value: f64) -> Self;
    /// Exact.
    fn to_f64(self) -> f64;
    /// √self.
    fn sqrt(self) -> Self;
    /// The kernels for this instruction set.
    ///
    /// # Panics
    /// If the machine lacks it.
    fn kernels(width: Width) -> Kernels<Self>;
}

macro_rules! real {
    ($type:ty, $kernels:path, $reference_order:literal) => {
        impl Real for $type {
            const REFERENCE_ORDER: bool = $reference_order;
            const ZERO: Self = 0.0;
            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                value as Self
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            fn kernels(width: Width) -> Kernels<Self> {
                $kernels(width)
            }
        }
    };
}
real!(f32, super::kernels::of_f32, false);
real!(f64, super::kernels::of_f64, true);
