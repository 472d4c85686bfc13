//! Every type of metasense that crosses a process or disk boundary, and nothing else.

pub mod database;
pub mod reason;
pub mod record;
pub mod source;
pub mod spec;
pub mod twin;
pub mod wire;
