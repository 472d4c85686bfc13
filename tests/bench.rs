//! What the benches promise, and what the engine promises of its trials: killed, stopped, without room. The trials are without
//! maths, `metasense-bench engine`'s. One binary, as `program.rs`.

mod common {
    pub mod processes;
    pub mod roll;
    pub mod skip;
}

mod benches;
mod engine;
