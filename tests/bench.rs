//! Benches, and the engine under kills, stops and lack of space. The trials compute nothing: they are those of `metasense-bench
//! engine`. One binary, like `program.rs`.

mod common {
    pub mod processes;
    pub mod roll;
    pub mod skip;
}

mod benches;
mod engine;
