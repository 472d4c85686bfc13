//! Instruction sets of the numerical kernels. The choice is made at run time, so one binary runs on every
//! machine of its architecture.

/// An instruction set that the kernels are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Width {
    /// SSE2 or NEON, which every x86-64 or aarch64 machine supports.
    Baseline,
    /// AVX2 and FMA of x86-64: 4 × f64, 8 × f32.
    Avx2,
    /// AVX-512 F, DQ, VL, BW of x86-64: 8 × f64, 16 × f32.
    Avx512,
}

impl Width {
    /// All instruction sets, narrowest first.
    pub const ALL: [Self; 3] = [Self::Baseline, Self::Avx2, Self::Avx512];

    /// # Panics
    /// If the machine does not support this instruction set.
    pub(crate) fn check(self) {
        assert!(self <= Self::detect(), "this machine does not support the instruction set {}", self.name());
    }

    /// The widest instruction set that this machine supports.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("fma")
        {
            return Self::Avx512;
        }
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            return Self::Avx2;
        }
        Self::Baseline
    }

    /// `"baseline"`, `"avx2"` or `"avx512"`.
    pub fn name(self) -> &'static str {
        ["baseline", "avx2", "avx512"][self as usize]
    }
}
