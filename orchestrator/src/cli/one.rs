//! One trial of a spec, for commands that look at its body.

use std::fmt::Display;
use std::path::PathBuf;

use metasense_worker::{design, simulate};

use super::{Error, read_plan, trial};
use crate::plan::{Plan, Trial};

/// Which trial, and which design of its body.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct One {
    /// The spec file (TOML)
    pub spec: PathBuf,
    /// The trial, by its hash or the beginning of it; `metasense expand SPEC` lists them [default: the first]
    #[arg(long)]
    pub hash: Option<String>,
    /// The design (.npy or .csv) [default: the trial's initial one]
    #[arg(long, value_name = "FILE")]
    pub design: Option<PathBuf>,
}

impl One {
    /// The trial, by default the first, and its design.
    pub fn read(&self) -> Result<(Trial, Vec<f64>), Error> {
        let plan = read_plan(&self.spec)?;
        self.of(&plan, &plan.trials[0])
    }

    /// The trial of the spec's plan, by default this one, and its design.
    pub fn of(&self, plan: &Plan, default: &Trial) -> Result<(Trial, Vec<f64>), Error> {
        let hash = self.hash.as_ref().unwrap_or(&default.hash);
        let trial = trial::find(plan, hash, &self.spec)?.clone();
        let (layout, initial) = simulate::body(&trial.spec).map_err(|e| self.refused(e))?;
        let design = self.design.as_ref().map(|file| design::read(file, &layout)).transpose()?;
        Ok((trial, design.unwrap_or(initial)))
    }

    /// What cannot be done with it.
    pub fn refused(&self, why: impl Display) -> Error {
        Error::Usage(format!("{}: {why}", self.spec.display()))
    }
}
