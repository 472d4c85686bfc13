//! Gradient of the energy of ligaments and contacts, and its derivative along a direction, in lanes.
//!
//! ```text
//! U = Σ ½ k_l Δl² + ½ k_s (l₀ γ)² + ½ k_θ Δθ² + E_c    (Bordiga et al., Nat. Mater. 23, 1486)
//! γ = ∠(d) − ∠(R((θ_a+θ_b)/2) d₀),   E_c = ½ k_c w² x²/(1−x²),   x = (ψ − ψ_c)/w,   w = ψ_c − ψ_min
//! ```
//! γ is the angle of d seen from the turned reference, so it stays in (−π, π] however far units turn. A void angle is
//! its value at rest plus the units' relative rotation: continuous, hence on the branch of the rest state.

use super::model::{Bar, Model};
use super::real::{Dual, Real, angle, sin_cos};
use super::vector::Vector;

/// Of one unit: sin and cos of θ/2, then sin θ and cos θ − 1.
pub type Turn<V> = [V; 4];

/// Where a kernel adds cotangents of the arms (node by node), of the void angles at rest and of the stiffnesses.
pub struct Shape<'a, V> {
    /// One entry a unit.
    pub arms: &'a mut [[[V; 2]; 4]],
    /// One entry a ligament.
    pub voids: &'a mut [[V; 2]],
    /// Of k_l, k_s, k_θ and k_c; touched with `PARAMETERS` alone.
    pub stiffness: &'a mut [V; 4],
}

/// What a ligament does to the units at its ends.
struct Pull<R> {
    /// ∂U/∂(u, v, θ) of either unit.
    ends: [[R; 3]; 2],
    /// ∂U/∂(node of b), the negative of that of a.
    force: [R; 2],
    /// (sin θ, cos θ − 1) of either unit.
    turns: [[R; 2]; 2],
    /// ∂U/∂ψ.
    voids: [R; 2],
    /// Δl, l₀γ and Δθ.
    strains: [R; 3],
}

/// Overwrites `g` by ∂U/∂s at `x` and, with duals, `h` by its derivative along `w`. Allocates nothing.
///
/// With `SHAPE` adds to `shape` ∂U/∂r and ∂U/∂ψ at rest (plain lanes) or their derivatives along `w` (duals).
/// With `PARAMETERS`, which takes duals, adds to `shape` ∂²U/∂s∂k·w, too: Σ strain · (strain's derivative along w).
/// With `CONTACT` lowers `margin` to the least ψ − ψ_min. A ligament of length zero gives NaN.
#[inline(always)]
pub fn gradient<
    V: Vector,
    R: Real<V>,
    const LINEAR: bool,
    const CONTACT: bool,
    const SHAPE: bool,
    const PARAMETERS: bool,
>(
    model: &Model,
    x: &[[V; 3]],
    w: &[[V; 3]],
    turn: &mut [Turn<V>],
    g: &mut [[V; 3]],
    h: &mut [[V; 3]],
    shape: Shape<'_, V>,
    margin: &mut V,
) {
    let zero = [V::splat(0.0); 3];
    let units = model.units();
    assert!(x.len() == units && turn.len() == units && g.len() == units, "one entry per unit");
    g.fill(zero);
    h.fill(zero);
    turns(x, turn);
    for (q, bar) in model.bars.iter().enumerate() {
        let &Bar { a, b, node_a, node_b, .. } = bar;
        let (xa, xb) = (R::load(x, w, a), R::load(x, w, b));
        let pull = pull::<V, R, LINEAR, CONTACT>(model, bar, xa, xb, turn[a], turn[b], margin);
        R::scatter(pull.ends[0], g, h, a);
        R::scatter(pull.ends[1], g, h, b);
        if SHAPE {
            let [gx, gy] = pull.force;
            let [[sa, ca], [sb, cb]] = pull.turns;
            // (R − I)ᵀ g at b, its negative at a
            let to = &mut shape.arms[b][node_b];
            *to = [to[0] + cb.mul_add(gx, sb * gy).last(), to[1] + sb.mul_sub_from(gx, cb * gy).last()];
            let to = &mut shape.arms[a][node_a];
            *to = [to[0] - ca.mul_add(gx, sa * gy).last(), to[1] - sa.mul_sub_from(gx, ca * gy).last()];
            if CONTACT {
                let to = &mut shape.voids[q];
                *to = [to[0] + pull.voids[0].last(), to[1] + pull.voids[1].last()];
            }
        }
        if PARAMETERS {
            for (to, strain) in shape.stiffness.iter_mut().zip(pull.strains) {
                *to = Vector::mul_add(strain.value(), strain.last(), *to);
            }
            if CONTACT && let Some(contact) = model.contact {
                // ∂E_c/∂ψ is k_c times what does not depend on it
                let turned = pull.strains[2].last() * V::splat(1.0 / contact.stiffness);
                let moment = pull.voids[1].value() - pull.voids[0].value();
                shape.stiffness[3] = Vector::mul_add(moment, turned, shape.stiffness[3]);
            }
        }
    }
}

/// Calls `entry(i, j, ∂²U/∂s_i∂s_j)` for the degrees of freedom (3·unit + d) of every ligament, to be summed.
#[inline(always)]
pub fn hessian<V: Vector, const LINEAR: bool, const CONTACT: bool>(
    model: &Model,
    x: &[[V; 3]],
    turn: &mut [Turn<V>],
    mut entry: impl FnMut(usize, usize, V),
) {
    turns(x, turn);
    let (zero, one) = (V::splat(0.0), V::splat(1.0));
    for bar in &model.bars {
        for column in 0..6 {
            let along = |end: usize, x: [V; 3]| -> [Dual<V>; 3] {
                [0, 1, 2].map(|d| Dual::from_parts(x[d], || if 3 * end + d == column { one } else { zero }))
            };
            let (xa, xb) = (along(0, x[bar.a]), along(1, x[bar.b]));
            let turns = (turn[bar.a], turn[bar.b]);
            let pull =
                pull::<V, Dual<V>, LINEAR, CONTACT>(model, bar, xa, xb, turns.0, turns.1, &mut { zero });
            let j = 3 * [bar.a, bar.b][column / 3] + column % 3;
            for (unit, end) in [bar.a, bar.b].into_iter().zip(pull.ends) {
                for (d, value) in end.into_iter().enumerate() {
                    entry(3 * unit + d, j, value.last());
                }
            }
        }
    }
}

/// sin and cos of the half angles first, as both the turned reference and the nodes need them.
#[inline(always)]
fn turns<V: Vector>(x: &[[V; 3]], turn: &mut [Turn<V>]) {
    for (turn, x) in turn.iter_mut().zip(x) {
        let (sh, ch) = sin_cos(V::splat(0.5) * x[2]);
        *turn = [sh, ch, (sh + sh) * ch, -((sh + sh) * sh)];
    }
}

/// One ligament, with contact.
#[inline(always)]
fn pull<V: Vector, R: Real<V>, const LINEAR: bool, const CONTACT: bool>(
    model: &Model,
    bar: &Bar,
    xa: [R; 3],
    xb: [R; 3],
    turn_a: Turn<V>,
    turn_b: Turn<V>,
    margin: &mut V,
) -> Pull<R> {
    let k = model.stiffness;
    let &Bar { arm_a, arm_b, e, length, voids, .. } = bar;
    let [sha, cha, sa, ca] = turn_a;
    let [shb, chb, sb, cb] = turn_b;
    // d sin θ = cos θ dθ, d(cos θ − 1) = −sin θ dθ
    let along = |s: V, c1: V, theta: R| {
        let sin = R::from_parts(s, || Vector::mul_add(c1, theta.last(), theta.last()));
        (sin, R::from_parts(c1, || -(s * theta.last())))
    };
    let ((sa, ca), (sb, cb)) = (along(sa, ca, xa[2]), along(sb, cb, xb[2]));

    // (R − I) r of both ends, and d − d₀
    let pa = [ca.scale(arm_a[0]) - sa.scale(arm_a[1]), sa.scale_add(arm_a[0], ca.scale(arm_a[1]))];
    let pb = [cb.scale(arm_b[0]) - sb.scale(arm_b[1]), sb.scale_add(arm_b[0], cb.scale(arm_b[1]))];
    let dux = (xb[0] + pb[0]) - (xa[0] + pa[0]);
    let duy = (xb[1] + pb[1]) - (xa[1] + pa[1]);

    let (gx, gy, shear, strains);
    if LINEAR {
        let stretch = dux.scale(k.stretch * e[0]) + duy.scale(k.stretch * e[1]);
        let slide = duy.scale(e[0]) - dux.scale(e[1]) - (xa[2] + xb[2]).scale(0.5 * length);
        strains = [dux.scale(e[0]) + duy.scale(e[1]), slide, xb[2] - xa[2]];
        let slide = slide.scale(k.shear);
        gx = stretch.scale(e[0]) - slide.scale(e[1]);
        gy = stretch.scale(e[1]) + slide.scale(e[0]);
        shear = slide.scale(0.5 * length);
    } else {
        let dx = dux + R::constant(length * e[0]);
        let dy = duy + R::constant(length * e[1]);
        let square = dx.mul_add(dx, dy * dy);
        let inverse = square.rsqrt();
        let inverse_square = inverse * inverse;
        // The reference turned by the mean rotation, from the half angles
        let cm = Vector::mul_sub_from(sha, shb, cha * chb);
        let sm = Vector::mul_add(sha, chb, cha * shb);
        let nx = Vector::mul_sub_from(sm, V::splat(e[1]), cm * V::splat(e[0]));
        let ny = Vector::mul_add(cm, V::splat(e[1]), sm * V::splat(e[0]));
        let (vx, vy) = (dx.value(), dy.value());
        let along = Vector::mul_add(nx, vx, ny * vy);
        let across = Vector::mul_sub_from(ny, vx, nx * vy);
        let gamma = R::from_parts(angle(across, along, square.value() * inverse.value()), || {
            let swing = Vector::mul_sub_from(vy, dx.last(), vx * dy.last()) * inverse_square.value();
            swing - V::splat(0.5) * (xa[2].last() + xb[2].last())
        });
        let stretch = inverse.scale_add(-k.stretch * length, R::constant(k.stretch));
        let stretched = square * inverse - R::constant(length);
        strains = [stretched, gamma.scale(length), xb[2] - xa[2]];
        let twist = gamma.scale(k.shear * length * length);
        let side = twist * inverse_square;
        gx = side.mul_sub_from(dy, stretch * dx);
        gy = side.mul_add(dx, stretch * dy);
        shear = twist.scale(0.5);
    }

    let mut bend = (xb[2] - xa[2]).scale(k.bend);
    let mut moments = [R::constant(0.0); 2];
    if CONTACT && let Some(contact) = model.contact {
        // ψ₁ falls and ψ₂ rises with θ_b − θ_a
        let relative = (xb[2] - xa[2]).value();
        let psi = [V::splat(voids[0]) - relative, V::splat(voids[1]) + relative];
        for (s, sign) in [(0, -1.0), (1, 1.0)] {
            *margin = -Vector::max(-*margin, V::splat(contact.min_angle) - psi[s]);
            if psi[s].any_less(V::splat(contact.cutoff_angle)) {
                let slope = contact_slope(contact, psi[s]);
                let turned = || slope.1 * (xb[2].last() - xa[2].last()) * V::splat(sign);
                moments[s] = R::from_parts(slope.0, turned);
                bend = moments[s].scale_add(sign, bend);
            }
        }
    }

    let lever_a = (pa[0] + R::constant(arm_a[0])).mul_sub_from(gy, (pa[1] + R::constant(arm_a[1])) * gx);
    let lever_b = (pb[0] + R::constant(arm_b[0])).mul_sub_from(gy, (pb[1] + R::constant(arm_b[1])) * gx);
    let none = R::constant(0.0);
    Pull {
        ends: [[none - gx, none - gy, lever_a - shear - bend], [gx, gy, bend - shear - lever_b]],
        force: [gx, gy],
        turns: [[sa, ca], [sb, cb]],
        voids: moments,
        strains,
    }
}

/// dE_c/dψ = k_c w x/(1−x²)² and d²E_c/dψ² = k_c (1+3x²)/(1−x²)³; zero from ψ_c on and below ψ_min.
#[inline(always)]
fn contact_slope<V: Vector>(contact: super::Contact, psi: V) -> (V, V) {
    let width = contact.cutoff_angle - contact.min_angle;
    let one = V::splat(1.0);
    let zero = V::splat(0.0);
    let x = (psi - V::splat(contact.cutoff_angle)) * V::splat(1.0 / width);
    let gap = Vector::mul_sub_from(x, x, one);
    let inverse = one.over(gap);
    let square = inverse * inverse;
    let slope = V::splat(contact.stiffness * width) * x * square;
    let curvature =
        V::splat(contact.stiffness) * Vector::mul_add(V::splat(3.0) * x, x, one) * square * inverse;
    let within = |y: V| y.where_less(x, zero, zero).where_less(-one, x, zero);
    (within(slope), within(curvature))
}
