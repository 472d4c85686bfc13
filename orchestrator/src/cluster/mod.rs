//! Shards of a sweep on several machines, and merging of their databases.
//!
//! A shard is an ordinary run with its own orchestrator, workers and database on a disk of its node, started by the cluster's
//! scheduler. Shards do not communicate: each gets a list of trials and returns a database.

mod assignment;
pub mod facts;
pub mod home;
pub mod merge;
pub mod places;
pub mod queue;
pub mod scheduler;
mod shard;
pub mod state;
pub mod submit;

pub use assignment::{Assignment, AssignmentError, trials_of};
pub use shard::{Shard, ShardError, ranges};
