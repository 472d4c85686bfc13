//! What tests share beside `common`.

pub mod engine;
pub mod roll;
pub mod skip;
pub mod slurm;
