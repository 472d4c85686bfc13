//! From a database to something to look at.

pub mod load;
