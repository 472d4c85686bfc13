//! The two precisions of the brain: f32 to train, f64 for Hessian products and checks.

use super::kernels::Kernels;
use crate::lanes::Scalar;
use crate::simd::Width;

/// A scalar with kernels of its own.
pub trait Real: Scalar {
    /// Whether the forward pass must sum in the reference's order, as checks in f64 do: a unit that training parked at
    /// its kink is on or off by its last bit, and H with it (seen: 0.7 % of z).
    const REFERENCE_ORDER: bool;
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
            fn kernels(width: Width) -> Kernels<Self> {
                $kernels(width)
            }
        }
    };
}
real!(f32, super::kernels::of_f32, false);
real!(f64, super::kernels::of_f64, true);
