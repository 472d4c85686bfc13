//! Beyond one machine: shards of a sweep, and their databases merged.
//!
//! A shard is an ordinary run, with its own orchestrator, workers and database on a disk of its node; the cluster's own
//! scheduler starts it. Shards know nothing of each other: trials are assigned to them, and what comes back is a database
//! each.

mod assignment;
pub mod facts;
pub mod home;
pub mod merge;
pub mod places;
pub mod queue;
mod shard;
pub mod state;
pub mod submit;

pub use assignment::{Assignment, AssignmentError, trials_of};
pub use shard::{Shard, ShardError, ranges};
