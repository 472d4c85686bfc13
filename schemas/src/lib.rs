//! The types that metasense stores or sends between processes, and nothing else.

pub mod database;
pub mod reason;
pub mod record;
pub mod spec;
pub mod wire;
