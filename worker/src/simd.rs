//! The instruction set of this process's kernels, by its name.

use metasense_numerics::simd::Width;
use std::sync::OnceLock;

/// Of all instruction sets, narrowest first.
pub const NAMES: [&str; 3] = ["baseline", "avx2", "avx512"];

/// Why kernels cannot use what was asked for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SimdError {
    /// No such name.
    #[error("`{0}` is not an instruction set of the kernels; expected baseline, avx2 or avx512")]
    Unknown(String),
    /// The machine cannot.
    #[error("this machine does not support {asked}; its widest set is {has}")]
    Lacking {
        /// Asked for.
        asked: &'static str,
        /// The widest there is.
        has: &'static str,
    },
}

/// The process's own, as its command line has it: kernels know of none but that of their pool.
static CHOSEN: OnceLock<Width> = OnceLock::new();

/// What the pools of this process use: what it was told to by `choose`, else the widest that this machine has.
pub fn width() -> Width {
    *CHOSEN.get_or_init(Width::detect)
}

/// Its name.
#[must_use]
pub fn name() -> &'static str {
    width().name()
}

/// Makes them use this; once, before they are used.
///
/// # Errors
/// An unknown name, or one that the machine lacks.
///
/// # Panics
/// If they use another already.
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
