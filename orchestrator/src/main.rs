//! The metasense command.
fn main() {}
