//! The option that selects the instruction set.

use super::Error;
use clap::builder::PossibleValuesParser;
use metasense_worker::simd::{NAMES, choose};

/// Instruction set of a command.
#[derive(Debug, clap::Args)]
pub struct Simd {
    /// Instruction set of the kernels; by default the widest that the machine supports
    #[arg(long, global = true, value_name = "SET", value_parser = PossibleValuesParser::new(NAMES), help_heading = "Workers")]
    simd: Option<String>,
}

impl Simd {
    /// Selects the instruction set of this process; call before any computation.
    pub fn choose(&self) -> Result<(), Error> {
        match &self.simd {
            Some(name) => choose(name).map_err(|e| Error::Usage(format!("--simd {name}: {e}"))),
            None => Ok(()),
        }
    }
}
