//! Geometry of a design: centroids, arms, areas, masses and moments of inertia of the units, and their adjoint.
//!
//! ```text
//! A = ½ Σ q_p × q_p+1,   c = Σ (q_p + q_p+1)(q_p × q_p+1) / 6A,   r_p = q_p − c
//! m = ρ A,   J = ρ/12 Σ (r_p × r_p+1)(r_p·r_p + r_p·r_p+1 + r_p+1·r_p+1)
//! ```
//! The two ends of a ligament shift together, so its reference vector does not depend on the design.

use super::Layout;

/// Geometric quantities that the dynamics use.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry {
    /// Absolute node positions of each unit (mm).
    pub vertices: Vec<Vec<[f64; 2]>>,
    /// Area centroids (mm).
    pub centroids: Vec<[f64; 2]>,
    /// r: vector from the unit's centroid to each node (mm).
    pub arms: Vec<[f64; 2]>,
    /// Areas (mm²).
    pub area: Vec<f64>,
    /// Masses (Mg).
    pub mass: Vec<f64>,
    /// Polar moments of inertia about the centroid (Mg·mm²).
    pub moment: Vec<f64>,
}

pub(super) fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}
/// Scalar product.
pub fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}
fn sum(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] + b[0], a[1] + b[1]]
}
/// a − b.
pub fn difference(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}
fn add_scaled(to: &mut [f64; 2], s: f64, a: [f64; 2]) {
    to[0] += s * a[0];
    to[1] += s * a[1];
}

impl Geometry {
    /// Geometry of `design`. The density of unit u is `density` (Mg/mm²) times `layout.density[u]`.
    pub fn new(layout: &Layout, design: &[f64], density: f64) -> Self {
        let vertices = layout.vertices(design);
        let n = layout.units();
        let mut g = Self {
            vertices,
            centroids: vec![[0.0; 2]; n],
            arms: vec![[0.0; 2]; layout.nodes()],
            area: vec![0.0; n],
            mass: vec![0.0; n],
            moment: vec![0.0; n],
        };
        for u in 0..n {
            let r = &mut g.arms[layout.first[u]..layout.first[u + 1]];
            layout.place(design, u, r);
            let (doubled, centroid) = doubled_and_centroid(r);
            r.iter_mut().for_each(|r| *r = difference(*r, centroid));
            let polar = polar(r);
            g.centroids[u] = sum(layout.centres[u], centroid);
            g.area[u] = doubled / 2.0;
            let density = density * layout.density[u];
            g.mass[u] = density * g.area[u];
            g.moment[u] = density * polar / 12.0;
        }
        g
    }

    /// Gradient in α of Σ bar_arms·r + Σ bar_mass·m + Σ bar_moment·J.
    pub fn vjp(
        &self,
        layout: &Layout,
        density: f64,
        bar_arms: &[[f64; 2]],
        bar_mass: &[f64],
        bar_moment: &[f64],
    ) -> Vec<f64> {
        let mut design = vec![0.0; layout.design_len()];
        let (mut bar, mut q) = (Vec::new(), Vec::new());
        for u in 0..layout.units() {
            let nodes = layout.first[u]..layout.first[u + 1];
            let r = &self.arms[nodes.clone()];
            bar.clear();
            bar.extend_from_slice(&bar_arms[nodes]);
            let bar_r = &mut bar;
            let density = density * layout.density[u];
            let scale = density * bar_moment[u] / 12.0;
            for (p, s) in edges(r.len()) {
                let (a, b) = (r[p], r[s]);
                let (area, square) = (cross(a, b), dot(a, a) + dot(a, b) + dot(b, b));
                add_scaled(&mut bar_r[p], scale * square, [b[1], -b[0]]);
                add_scaled(&mut bar_r[s], scale * square, [-a[1], a[0]]);
                add_scaled(&mut bar_r[p], scale * area, [2.0 * a[0] + b[0], 2.0 * a[1] + b[1]]);
                add_scaled(&mut bar_r[s], scale * area, [2.0 * b[0] + a[0], 2.0 * b[1] + a[1]]);
            }
            // r = q − c, c = first/(6A), all relative to the unit's reference point
            let centroid = difference(self.centroids[u], layout.centres[u]);
            q.clear();
            q.extend(r.iter().map(|r| sum(*r, centroid)));
            let bar_c = bar_r.iter().fold([0.0; 2], |s, r| difference(s, *r));
            let area = self.area[u];
            let bar_first = [bar_c[0] / (6.0 * area), bar_c[1] / (6.0 * area)];
            let bar_area = density * bar_mass[u] - dot(bar_c, centroid) / area;
            let bar_q = bar_r;
            for (p, s) in edges(q.len()) {
                let (a, b) = (q[p], q[s]);
                let bar_cross = dot(sum(a, b), bar_first) + 0.5 * bar_area;
                add_scaled(&mut bar_q[p], cross(a, b), bar_first);
                add_scaled(&mut bar_q[s], cross(a, b), bar_first);
                add_scaled(&mut bar_q[p], bar_cross, [b[1], -b[0]]);
                add_scaled(&mut bar_q[s], bar_cross, [-a[1], a[0]]);
            }
            layout.place_vjp(u, &q, bar_q, &mut design);
        }
        design
    }

    /// The two void angles of each ligament at rest, in (−π, π]: from e⁻ of b to e⁺ of a, and from e⁻ of a to e⁺ of b.
    pub fn void_angles(&self, layout: &Layout) -> Vec<[f64; 2]> {
        let angle = |ends: [(usize, usize); 2]| {
            let [e, f] = ends.map(|(p, s)| difference(self.arms[s], self.arms[p]));
            cross(e, f).atan2(dot(e, f))
        };
        void_edges(layout).map(|pair| pair.map(angle)).collect()
    }
}

/// Index pairs of the edges of a polygon with `count` nodes.
pub fn edges(count: usize) -> impl Iterator<Item = (usize, usize)> + Clone {
    (0..count).map(move |p| (p, if p + 1 == count { 0 } else { p + 1 }))
}

/// 12 times the polar second moment of area about the origin.
fn polar(r: &[[f64; 2]]) -> f64 {
    let edge =
        |(p, s): (usize, usize)| cross(r[p], r[s]) * (dot(r[p], r[p]) + dot(r[p], r[s]) + dot(r[s], r[s]));
    edges(r.len()).map(edge).fold(0.0, |sum, edge| sum + edge)
}

/// Twice the signed area of a polygon (negative if clockwise), and its centroid.
fn doubled_and_centroid(nodes: &[[f64; 2]]) -> (f64, [f64; 2]) {
    let (mut doubled, mut first) = (0.0, [0.0; 2]);
    for (p, s) in edges(nodes.len()) {
        doubled += cross(nodes[p], nodes[s]);
        add_scaled(&mut first, cross(nodes[p], nodes[s]), sum(nodes[p], nodes[s]));
    }
    (doubled, first.map(|x| x / (3.0 * doubled)))
}

/// Moments of a polygon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PolygonMoments {
    /// Signed area; negative if clockwise.
    pub area: f64,
    /// 12 times the polar second moment of area about the centroid.
    pub polar: f64,
}

/// Computes the moments of a polygon.
pub fn moments(nodes: &[[f64; 2]]) -> PolygonMoments {
    let (doubled, centroid) = doubled_and_centroid(nodes);
    PolygonMoments { area: 0.5 * doubled, polar: polar(nodes) - 6.0 * doubled * dot(centroid, centroid) }
}

/// The two edges of each void angle of each ligament, first and second, as pairs (node, other node) of node numbers.
fn void_edges(layout: &Layout) -> impl Iterator<Item = [[(usize, usize); 2]; 2]> + '_ {
    layout.ligaments.iter().map(|l| {
        let next = |e| (layout.number(e), layout.number(layout.next(e)));
        let previous = |e| (layout.number(e), layout.number(layout.previous(e)));
        [[previous(l.b), next(l.a)], [previous(l.a), next(l.b)]]
    })
}

/// Adds to `bar_arms` the gradient of Σ bar_angles·ψ in the arms.
pub fn void_angles_vjp(
    geometry: &Geometry,
    layout: &Layout,
    bar_angles: &[[f64; 2]],
    bar_arms: &mut [[f64; 2]],
) {
    for (pair, bars) in void_edges(layout).zip(bar_angles) {
        for (ends, &bar) in pair.iter().zip(bars) {
            // ψ decreases with the direction of the first edge and increases with that of the second.
            for (&(p, s), sign) in ends.iter().zip([-bar, bar]) {
                let e = difference(geometry.arms[s], geometry.arms[p]);
                let turn = [-e[1] / dot(e, e), e[0] / dot(e, e)];
                add_scaled(&mut bar_arms[s], sign, turn);
                add_scaled(&mut bar_arms[p], -sign, turn);
            }
        }
    }
}
