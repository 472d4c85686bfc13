//! The body: units and the ligaments between them, and the geometry that a design gives them.
//!
//! A layout says who is joined to whom; the design α moves node groups; geometry follows from both.

mod freedom;
mod geometry;
mod layout;
mod pattern;
mod rigid;

pub use freedom::Freedom;
pub use geometry::{Geometry, edges, moments, void_angles_vjp};
pub use layout::{GroupCell, Layout, Ligament};
pub use pattern::{End, Pattern};
pub use rigid::{Follower, Follows};
