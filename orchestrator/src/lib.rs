//! metasense: trains bodies of flexible metamaterial together with the neural networks that read them.

pub mod analysis;
pub mod cli;
pub mod cluster;
pub mod draw;
pub mod engine;
pub mod exit;
pub mod export;
pub mod fleet;
pub mod link;
pub mod plan;
pub mod report;
pub mod scheduler;
pub mod store;
