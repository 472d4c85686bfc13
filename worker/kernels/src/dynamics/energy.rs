//! Energy of one state and its gradients in state and design, for checks and reports.

use super::ligaments::{Turn, gradient, turns};
use super::model::{Model, ModelCotangent};
use super::{EdgeContact, Scene};
use crate::lanes::{Base, Vector};

/// Elastic and contact energy (N·mm).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Energy {
    /// Energy of the ligaments.
    pub elastic: f64,
    /// Energy of the contacts.
    pub contact: f64,
}

/// Energy at the displacements (u, v, θ) of all units, with the standard library's trigonometry.
pub fn energy(scene: &Scene, design: &[f64], displacement: &[[f64; 3]]) -> Energy {
    let model = Model::uncompressed(scene, design);
    let mut sum = Energy { elastic: 0.0, contact: 0.0 };
    for bar in &model.bars {
        let (xa, xb) = (displacement[bar.a], displacement[bar.b]);
        let move_of = |x: [f64; 3], r: [f64; 2]| {
            let (s, c1) = (x[2].sin(), -2.0 * (0.5 * x[2]).sin().powi(2));
            [x[0] + c1 * r[0] - s * r[1], x[1] + s * r[0] + c1 * r[1]]
        };
        let (ua, ub) = (move_of(xa, bar.arm_a), move_of(xb, bar.arm_b));
        let du = [ub[0] - ua[0], ub[1] - ua[1]];
        let ([ex, ey], l) = (bar.e, bar.length);
        let mean = 0.5 * (xa[2] + xb[2]);
        let (stretch, slide) = if scene.linearised {
            (du[0] * ex + du[1] * ey, ex * du[1] - ey * du[0] - l * mean)
        } else {
            let d = [du[0] + l * ex, du[1] + l * ey];
            let n = [mean.cos() * ex - mean.sin() * ey, mean.sin() * ex + mean.cos() * ey];
            (d[0].hypot(d[1]) - l, l * (n[0] * d[1] - n[1] * d[0]).atan2(n[0] * d[0] + n[1] * d[1]))
        };
        let bend = xb[2] - xa[2];
        let [k_l, k_s, k_t] = bar.stiffness;
        sum.elastic += 0.5 * (k_l * stretch.powi(2) + k_s * slide.powi(2) + k_t * bend.powi(2));
        if let Some(contact) = scene.contact {
            sum.contact +=
                contact_energy(contact, bar.voids[0] - bend) + contact_energy(contact, bar.voids[1] + bend);
        }
    }
    sum
}

/// E_c of one void angle.
pub fn contact_energy(contact: EdgeContact, psi: f64) -> f64 {
    let width = contact.cutoff_angle - contact.min_angle;
    let x = (psi - contact.cutoff_angle) / width;
    if !(-1.0..0.0).contains(&x) {
        return 0.0;
    }
    0.5 * contact.stiffness * width.powi(2) * x.powi(2) / (1.0 - x.powi(2))
}

/// ∂U/∂s, and ∂U/∂α at fixed displacement, computed by the kernel of the integrators.
pub fn energy_gradients(
    scene: &Scene,
    design: &[f64],
    displacement: &[[f64; 3]],
) -> (Vec<[f64; 3]>, Vec<f64>) {
    let model = Model::uncompressed(scene, design);
    let n = model.units();
    let zero = Base::splat(0.0);
    let x: Vec<[Base; 3]> = displacement.iter().map(|d| d.map(Base::splat)).collect();
    let (mut turn, mut g) = (vec![Turn::NONE; n], vec![[zero; 3]; n]);
    let mut cotangent = ModelCotangent::new(&model, 0.0);
    let mut kept = vec![[[zero; 2]; 2]; model.bars.len()];
    let kernel = match (scene.linearised, scene.contact.is_some()) {
        (false, false) => gradient::<Base, false, false, true>,
        (false, true) => gradient::<Base, false, true, true>,
        (true, _) => gradient::<Base, true, true, true>,
    };
    turns::<Base>(&x, &mut turn);
    kernel(&model, &model.bars, &x, &turn, &mut g, &mut { zero }, &mut kept);
    let first = |v: Base| v.lane(0);
    for (bar, [force, voids]) in model.bars.iter().zip(kept) {
        let [gx, gy] = force.map(first);
        // (R − I)ᵀ ∂U/∂node at b, its negative at a
        for (unit, node, sign) in [(bar.a, bar.node_a, -1.0), (bar.b, bar.node_b, 1.0)] {
            let [s, c1] = turn[unit].exact.map(first);
            let to = &mut cotangent.arms[node];
            *to = [to[0] + sign * (c1 * gx + s * gy), to[1] + sign * (c1 * gy - s * gx)];
        }
        cotangent.voids[bar.index] = voids.map(first);
    }
    let gradient = g.iter().map(|g| g.map(first)).collect();
    (gradient, cotangent.design(&model, scene))
}
