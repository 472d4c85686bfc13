//! The plan: a spec becomes an ordered list of trials with stable hashes. Pure.

use std::path::{Path, PathBuf};

use metasense_schemas::spec::{SweepSpec, TrialSpec};

/// A trial to run.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Names the trial for ever.
    pub hash: String,
    /// All that it is.
    pub spec: TrialSpec,
    /// Position in the order of running, from 0.
    pub order: usize,
    /// Units of its body.
    pub units: usize,
    /// Length of α.
    pub design_parameters: usize,
    /// Weights of its brain.
    pub brain_parameters: usize,
    /// Estimated seconds on one core.
    pub cost: f64,
}

/// A spec file, read, and the trials it stands for.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The file.
    pub path: PathBuf,
    /// The file's text.
    pub text: String,
    /// What it says.
    pub spec: SweepSpec,
    /// The trials in the order of running.
    pub trials: Vec<Trial>,
}

impl Plan {
    /// The database where none is named.
    #[must_use]
    pub fn default_database(&self) -> PathBuf {
        Path::new("results").join(format!("{}.sqlite", self.spec.name))
    }
}
