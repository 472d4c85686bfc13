//! Which instruction set the hot kernels use, chosen at run time so that one binary serves every x86-64 machine.

/// An instruction set that the kernels are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Width {
    /// What every machine of the target has.
    Baseline,
    /// AVX2 and FMA: 4 × f64, 8 × f32.
    Avx2,
    /// AVX-512 F, DQ, VL, BW: 8 × f64, 16 × f32.
    Avx512,
}

impl Width {
    /// All, narrowest first.
    pub const ALL: [Self; 3] = [Self::Baseline, Self::Avx2, Self::Avx512];

    /// # Panics
    /// If the machine lacks it.
    pub(crate) fn check(self) {
        assert!(self <= Self::detect(), "this machine has no {}", self.name());
    }

    /// The widest that this machine has.
    pub fn detect() -> Self {
        if is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("fma")
        {
            return Self::Avx512;
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            return Self::Avx2;
        }
        Self::Baseline
    }

    /// `"baseline"`, `"avx2"` or `"avx512"`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Baseline => "baseline",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }
}
