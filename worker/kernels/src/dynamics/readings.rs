//! Readings of the sensors, and states of single lanes.

use super::ligaments::Place;
use super::system::Unit;
use super::{AccelerationFrame, Mount, Scene};
use crate::lanes::{MOST, Vector};

/// A chip off the centroid of its unit, or tilted, at one instant.
pub struct Mounted<V> {
    /// Offset in fixed axes (mm).
    pub arm: [V; 2],
    /// Cosine and sine of the angle of the chip's axes.
    axes: (V, V),
}

impl<V: Vector> Mounted<V> {
    #[inline(always)]
    pub fn new(Mount { offset: [rx, ry], tilt }: Mount, frame: AccelerationFrame, theta: V) -> Self {
        let (c, s) = cos_sin(theta);
        let [rx, ry] = [V::splat(rx), V::splat(ry)];
        let axes = match frame {
            AccelerationFrame::World => (V::splat(tilt.cos()), V::splat(tilt.sin())),
            AccelerationFrame::Body => cos_sin(theta + V::splat(tilt)),
        };
        Self { arm: [c * rx - s * ry, s * rx + c * ry], axes }
    }

    /// a + α×r − ω²r along the chip's axes.
    #[inline(always)]
    pub fn read(&self, omega: V, a: Unit<V>) -> [V; 2] {
        let ([px, py], (c, s), square) = (self.arm, self.axes, omega * omega);
        let (x, y) = (a[0] - a[2] * py - square * px, a[1] + a[2] * px - square * py);
        [c * x + s * y, c * y - s * x]
    }

    /// Rotates from the chip's axes to fixed axes.
    #[inline(always)]
    pub fn back(&self, [p, q]: [V; 2]) -> [V; 2] {
        let (c, s) = self.axes;
        [c * p - s * q, s * p + c * q]
    }
}

/// (cos, sin) by the standard library; called once per sensor and instant.
#[inline(always)]
pub fn cos_sin<V: Vector>(theta: V) -> (V, V) {
    let (mut c, mut s) = (V::ZERO, V::ZERO);
    for lane in 0..V::LANES {
        let (sin, cos) = theta.lane(lane).sin_cos();
        c.set_lane(lane, cos);
        s.set_lane(lane, sin);
    }
    (c, s)
}

/// Writes the readings of one lane at one instant to `out` (3M); `base` is the acceleration of the base.
#[inline(always)]
pub fn read_lane<V: Vector>(
    scene: &Scene,
    (x, v): (&[Place<V>], &[Place<V>]),
    a: &[Unit<V>],
    base: [f64; 2],
    lane: usize,
    out: &mut [f64],
) {
    for (&u, out) in scene.sensors.iter().zip(out.chunks_exact_mut(3)) {
        let mut felt = a[u];
        for d in (0..2).filter(|d| base[*d] != 0.0) {
            let own = felt[d].lane(lane);
            felt[d].set_lane(lane, own + base[d]);
        }
        if let Some(mount) = scene.mount {
            let at = Mounted::<V>::new(mount, scene.frame, V::narrow(x[u][2]));
            let [ax, ay] = at.read(V::narrow(v[u][2]), felt).map(|read| read.lane(lane));
            out.copy_from_slice(&[ax, ay, v[u][2].lane(lane)]);
            continue;
        }
        let (ax, ay) = (felt[0].lane(lane), felt[1].lane(lane));
        let (s, c) = match scene.frame {
            AccelerationFrame::World => (0.0, 1.0),
            AccelerationFrame::Body => x[u][2].lane(lane).sin_cos(),
        };
        out.copy_from_slice(&[c * ax + s * ay, c * ay - s * ax, v[u][2].lane(lane)]);
    }
}

/// Writes the state of one lane to `out` (free units, 6).
#[inline(always)]
pub fn store_lane<W: Vector>(free: &[usize], x: &[Unit<W>], v: &[Unit<W>], lane: usize, out: &mut [f64]) {
    for (&u, out) in free.iter().zip(out.chunks_exact_mut(6)) {
        for d in 0..3 {
            out[d] = x[u][d].lane(lane);
            out[3 + d] = v[u][d].lane(lane);
        }
    }
}

/// Loads the states of the lanes, each (free units, 6). A lane without a state is at rest at `rest`, or at zero if `rest` is empty.
#[inline(always)]
pub fn load_lanes<W: Vector>(
    free: &[usize],
    rest: &[[f64; 3]],
    states: &[Option<&[f64]>; MOST],
    x: &mut [Unit<W>],
    v: &mut [Unit<W>],
) {
    for (i, &u) in free.iter().enumerate() {
        for d in 0..3 {
            (x[u][d], v[u][d]) = (rest.get(u).map_or(W::ZERO, |rest| W::splat(rest[d])), W::ZERO);
            for lane in 0..W::LANES {
                if let Some(state) = states[lane] {
                    x[u][d].set_lane(lane, state[6 * i + d]);
                    v[u][d].set_lane(lane, state[6 * i + 3 + d]);
                }
            }
        }
    }
}
