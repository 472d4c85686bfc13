//! The body: rigid units joined by elastic ligaments.
//!
//! A layout defines units and ligaments, the design α shifts node groups, and both together determine the geometry.

mod freedom;
mod geometry;
mod layout;
mod pattern;
mod rigid;

pub use freedom::Freedom;
pub use geometry::{Geometry, difference, dot, edges, moments, void_angles_vjp};
pub use layout::{GroupCell, Groups, Layout, Ligament};
pub use pattern::{End, Pattern};
pub use rigid::{FollowRule, Follower};
