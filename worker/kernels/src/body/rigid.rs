//! Nodes of rigid units without ligaments that follow two nodes a and b of the same unit, which have ligaments.
//!
//! ```text
//! MeanX    p = p₀ + (½ (a_x − a₀_x + b_x − b₀_x), 0)
//! Segment  p = ½ (a + b) + s t + w n      t = (b − a)/|b − a|, n = t turned by 90°; s, w from the undisplaced unit
//! Angle    p = R(φ) p₀                    φ = ½ (∠(a₀ → a) + ∠(b₀ → b)) about the origin
//! ```

use super::geometry::{cross, difference, dot};

type Point = [f64; 2];

/// How a node follows two others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FollowRule {
    /// In x, by the mean shift of both nodes.
    MeanX,
    /// Fixed to the middle and direction of the segment between both nodes.
    Segment,
    /// Rotated about the origin by the mean rotation of both nodes.
    Angle,
}

/// A node that follows two other nodes of its unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Follower {
    /// Index of the node.
    pub node: usize,
    /// Indices of the two leading nodes.
    pub of: [usize; 2],
    /// Rule of the motion.
    pub by: FollowRule,
}

/// s times a and t times a turned by 90°.
fn along(a: Point, s: f64, t: f64) -> Point {
    [s * a[0] - t * a[1], s * a[1] + t * a[0]]
}

/// Length and direction of the segment ab, and coordinates of p along and across it from its middle.
fn frame([p, a, b]: [Point; 3]) -> (f64, Point, [f64; 2]) {
    let away = difference(b, a);
    let length = away[0].hypot(away[1]);
    let t = away.map(|x| x / length);
    let from = [0, 1].map(|d| p[d] - 0.5 * (a[d] + b[d]));
    (length, t, [dot(from, t), cross(t, from)])
}

impl Follower {
    /// Position of the node (mm), given the undisplaced positions of node and leaders, and the present ones of the
    /// leaders.
    pub fn place(&self, base @ [p, a0, b0]: [Point; 3], [a, b]: [Point; 2]) -> Point {
        match self.by {
            FollowRule::MeanX => [p[0] + 0.5 * (a[0] - a0[0] + (b[0] - b0[0])), p[1]],
            FollowRule::Segment => {
                let (_, _, [s, w]) = frame(base);
                let (_, t, _) = frame([p, a, b]);
                let by = along(t, s, w);
                [0, 1].map(|d| 0.5 * (a[d] + b[d]) + by[d])
            }
            FollowRule::Angle => {
                let turn = |from: Point, to: Point| cross(from, to).atan2(dot(from, to));
                let (sin, cos) = (0.5 * (turn(a0, a) + turn(b0, b))).sin_cos();
                along(p, cos, sin)
            }
        }
    }

    /// Cotangents of a and b for the cotangent `bar` of the node.
    pub fn vjp(&self, base @ [p, _, _]: [Point; 3], now @ [a, b]: [Point; 2], bar: Point) -> [Point; 2] {
        match self.by {
            FollowRule::MeanX => [[0.5 * bar[0], 0.0]; 2],
            FollowRule::Segment => {
                let (_, _, [s, w]) = frame(base);
                let (length, t, _) = frame([p, a, b]);
                // t and the node turn by n·(db − da)/|b − a|
                let turn = dot(along(t, -w, s), bar) / length;
                let half = bar.map(|x| 0.5 * x);
                [-turn, turn].map(|turn| [0, 1].map(|d| half[d] + along(t, 0.0, turn)[d]))
            }
            FollowRule::Angle => {
                let half = 0.5 * dot(along(self.place(base, now), 0.0, 1.0), bar);
                now.map(|q| along(q, 0.0, half / dot(q, q)))
            }
        }
    }
}
