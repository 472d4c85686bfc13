//! The combinations of a sweep's axes, with the keys left out that overrides have made irrelevant.

use metasense_schemas::spec::SweepSpec;
use metasense_source::{Source, SpecError};

use super::axes::{self, Combination};
use super::check::check_sweep;
use super::{brains, goal, until};

/// A parsed sweep.
pub(super) struct Combinations {
    /// Without the keys left out.
    pub source: Source,
    pub spec: SweepSpec,
    pub combinations: Vec<Combination>,
    /// Keys of the file that overrides have made irrelevant, with the reason.
    pub left_out: Vec<String>,
}

impl Combinations {
    /// Parses a spec. A key that no trial uses is an error, unless the file uses it and an override has removed these trials.
    pub fn of(mut source: Source) -> Result<Self, SpecError> {
        let mut left_out = Vec::new();
        loop {
            let (spec, combinations, unread) = parsed(&source)?;
            let Some(error) = unread else { return Ok(Self { source, spec, combinations, left_out }) };
            let is_read = |file: &Source| {
                parsed(file).is_ok_and(|(.., unread)| unread.is_none_or(|unread| unread.key != error.key))
            };
            let rest =
                source.without_overrides().filter(is_read).and_then(|_| source.without_key(&error.key));
            left_out.push(error.to_string());
            source = rest.ok_or(error)?;
        }
    }
}

/// The spec, its combinations, and the error for the first key that no trial uses.
fn parsed(source: &Source) -> Result<(SweepSpec, Vec<Combination>, Option<SpecError>), SpecError> {
    let spec = until::grid(source.parse()?, source)?;
    check_sweep(&spec, source)?;
    goal::check(&spec, source)?;
    let combinations = axes::combinations(&spec, source)?;
    let unread = brains::refuse_unread(combinations.iter().map(|one| &one.spec), source).err();
    Ok((spec, combinations, unread))
}
