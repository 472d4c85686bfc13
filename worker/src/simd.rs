//! The instruction set of this process's kernels.

use metasense_numerics::simd::Width;
use std::sync::OnceLock;

/// Names of all instruction sets, narrowest first.
pub const NAMES: [&str; 3] = ["baseline", "avx2", "avx512"];

/// Why an instruction set cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum SimdError {
    /// The name is unknown.
    #[error("`{0}` is not an instruction set of the kernels; expected baseline, avx2 or avx512")]
    Unknown(String),
    /// The machine does not support it.
    #[error("this machine does not support {asked}; its widest set is {has}")]
    Lacking { asked: &'static str, has: &'static str },
}

/// The instruction set of this process; kernels use that of their pool.
static CHOSEN: OnceLock<Width> = OnceLock::new();

/// The instruction set of new pools: the one set by [`choose`], else the widest of this machine.
pub fn width() -> Width {
    *CHOSEN.get_or_init(Width::detect)
}

/// Name of this instruction set.
pub fn name() -> &'static str {
    width().name()
}

/// Sets the instruction set; call it before the first use.
///
/// # Errors
/// If the name is unknown, or the machine does not support it.
///
/// # Panics
/// If another set is already in use.
pub fn choose(name: &str) -> Result<(), SimdError> {
    let asked = find(name, Width::detect())?;
    let chosen = *CHOSEN.get_or_init(|| asked);
    assert_eq!(chosen, asked, "another instruction set is in use");
    Ok(())
}

fn find(name: &str, has: Width) -> Result<Width, SimdError> {
    let asked = Width::ALL
        .into_iter()
        .find(|width| width.name() == name)
        .ok_or_else(|| SimdError::Unknown(name.to_owned()))?;
    if asked > has {
        return Err(SimdError::Lacking { asked: asked.name(), has: has.name() });
    }
    Ok(asked)
}

#[cfg(test)]
mod tests;
