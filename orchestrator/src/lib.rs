//! metasense: trains bodies of flexible metamaterial together with the decoders that estimate forces from their signals.

// These macros panic if the reader has closed the pipe; use those of `cli::say` instead.
#![warn(clippy::print_stdout, clippy::print_stderr)]

pub mod cli;
pub mod cluster;
pub mod control;
pub mod engine;
pub mod exit;
pub mod export;
pub mod files;
pub mod fleet;
pub mod hashes;
pub mod leftovers;
pub mod link;
pub mod plan;
pub mod processes;
pub mod progress;
pub mod provenance;
pub mod reader;
pub mod report;
pub mod rounds;
pub mod scheduler;
pub mod serve;
pub mod signals;
pub mod spool;
mod sql;
pub mod store;

pub use metasense_analysis as analysis;
pub use metasense_render as look;
pub use metasense_render::cell;
