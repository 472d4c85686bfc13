//! Gradient of the energy of ligaments and contacts, and its derivative along a direction, in lanes.
//!
//! ```text
//! U = Σ ½ k_l Δl² + ½ k_s (l₀ γ)² + ½ k_θ Δθ² + E_c    (Bordiga et al., Nat. Mater. 23, 1486)
//! γ = ∠(d) − ∠(R((θ_a+θ_b)/2) d₀),   E_c = ½ k_c w² x²/(1−x²),   x = (ψ − ψ_c)/w,   w = ψ_c − ψ_min
//! ```
//! γ is reduced to (−π, π] for any rotation. A void angle is its value at rest plus the relative rotation of the units; it is therefore
//! continuous, on the branch of the rest state.

use super::model::{Bar, Model};
use super::trigonometry::{angle, sin_cos1};
use crate::lanes::{Vector, pair};

/// Rotation of one unit.
#[derive(Clone, Copy)]
pub struct Turn<V: Vector> {
    /// sin θ and cos θ − 1.
    pub(super) exact: [V::Wide; 2],
    /// sin θ, cos θ − 1 and θ rounded to f32, once for all ligaments of the unit; unused in f64.
    rounded: [V; 3],
}

/// Position (u, v, θ) of one unit, always f64: ligaments stretch by about a hundredth of the displacement of their ends.
pub type Place<V> = [<V as Vector>::Wide; 3];

impl<V: Vector> Turn<V> {
    /// No rotation.
    pub const NONE: Self = Self { exact: [V::Wide::ZERO; 2], rounded: [V::ZERO; 3] };

    /// Sets the rotation to θ.
    #[inline(always)]
    pub fn set(&mut self, theta: V::Wide) {
        self.exact = sin_cos1(theta);
        if V::SINGLE {
            let [s, c1] = self.exact;
            self.rounded = [V::narrow(s), V::narrow(c1), V::narrow(theta)];
        }
    }

    /// sin θ, cos θ − 1 and the given θ, rounded.
    #[inline(always)]
    fn rounded(&self, theta: V::Wide) -> [V; 3] {
        if V::SINGLE {
            return self.rounded;
        }
        let [s, c1] = self.exact;
        [V::narrow(s), V::narrow(c1), V::narrow(theta)]
    }
}

/// Sums of cotangents of arms, void angles at rest and stiffnesses.
pub struct ShapeCotangent<'a, V> {
    /// One entry per node.
    pub arms: &'a mut [[V; 2]],
    /// One entry per ligament.
    pub voids: &'a mut [[V; 2]],
    /// Of k_l, k_s, k_θ, one entry per ligament; only used with `PARAMETERS`.
    pub stiffness: &'a mut [[V; 3]],
    /// Of k_c; only used with `PARAMETERS`.
    pub contact: &'a mut V,
}

/// Kinematics of a ligament.
#[derive(Clone, Copy)]
struct Kinematics<V> {
    /// R r of both ends.
    levers: [[V; 2]; 2],
    /// d; in linearised scenes d − d₀.
    d: [V; 2],
    /// |d| and 1/|d|; zero in linearised scenes, as are `along_reference` and `square`.
    size: V,
    inverse: V,
    /// d in the axes (d₀, d₀⊥).
    along_reference: [V; 2],
    /// |d|² − l₀², only in f32.
    square: V,
    /// (θ_a + θ_b)/2, θ_b − θ_a.
    mean: V,
    relative: V,
}

/// Forces and moments of a ligament on its units.
struct Reaction<V> {
    at: Kinematics<V>,
    /// 1/|d|²; zero in linearised scenes, as are `stretch` and `side`.
    inverse_square: V,
    /// The force is stretch·d + side·d⊥, d⊥ = (−d_y, d_x).
    stretch: V,
    side: V,
    /// ∂U/∂(node of b); ∂U/∂(node of a) is the negative.
    force: [V; 2],
    /// ∂U/∂θ of both units without the moment of `force`.
    moments: [V; 2],
    /// dE_c/dψ and d²E_c/dψ².
    contact: [(V, V); 2],
    /// Strains Δl, l₀γ and Δθ.
    strains: [V; 3],
}

/// Derivative of a [`Reaction`] along a direction.
struct ReactionTangent<V> {
    force: [V; 2],
    /// Derivative of ∂U/∂θ of both units.
    moments: [V; 2],
    /// Derivative of ∂U/∂ψ.
    voids: [V; 2],
    strains: [V; 3],
}

/// Adds ∂U/∂s at `x` to `g`; `turn` contains the rotations of `x`. Does not allocate.
///
/// With `CONTACT`, includes contact and lowers `margin` to the least ψ − ψ_min. With `KEEP`, stores the force on end b and ∂U/∂ψ of each
/// ligament in `kept`. A ligament of length zero yields NaN.
#[inline(always)]
pub fn gradient<V: Vector, const LINEAR: bool, const CONTACT: bool, const KEEP: bool>(
    model: &Model,
    bars: &[Bar<V::Scalar>],
    x: &[Place<V>],
    turn: &[Turn<V>],
    g: &mut [[V; 3]],
    margin: &mut V,
    kept: &mut [[[V; 2]; 2]],
) {
    let units = model.units();
    assert!(x.len() == units && turn.len() == units && g.len() == units, "one entry per unit");
    if bars.is_empty() {
        return;
    }
    let mut pipeline = Pipeline::new::<LINEAR>(bars, x, turn);
    for (q, bar) in bars.iter().enumerate() {
        let (at, gamma) = pipeline.next::<LINEAR>(q, bars, x, turn);
        let reaction = reaction::<V, LINEAR, CONTACT>(model, bar, at, gamma, margin);
        reaction.add_to(g, bar);
        if KEEP {
            kept[q] = [reaction.force, [reaction.contact[0].0, reaction.contact[1].0]];
        }
    }
}

/// U at `x`; `turn` contains the rotations of `x`. Does not allocate.
#[inline(always)]
pub fn energy<V: Vector, const LINEAR: bool, const CONTACT: bool>(
    model: &Model,
    bars: &[Bar<V::Scalar>],
    x: &[Place<V>],
    turn: &[Turn<V>],
) -> V {
    let mut sum = V::splat(0.0);
    for bar in bars {
        let at = kinematics::<V, LINEAR>(bar, x, turn);
        let gamma = shear_angle::<V, LINEAR>(&at);
        let [stretched, slid, turned] = if LINEAR {
            linear(bar, at.d, at.mean, at.relative).2
        } else {
            let length = V::from_scalar(bar.length);
            [at.size - length, length * gamma, at.relative]
        };
        for (k, strain) in bar.stiffness.into_iter().zip([stretched, slid, turned]) {
            sum = (V::splat(0.5) * V::from_scalar(k) * strain).mul_add(strain, sum);
        }
        if CONTACT && let Some(contact) = model.contact {
            let psi = [V::from_scalar(bar.voids[0]) - turned, V::from_scalar(bar.voids[1]) + turned];
            psi.into_iter().for_each(|psi| sum = sum + contact_energy(contact, psi));
        }
    }
    sum
}

/// Subtracts the derivative of ∂U/∂s along `w` from `h`: the cotangent of the state for the cotangent `w` of the forces. With `GRADIENT`,
/// adds ∂U/∂s to `g`. Does not allocate.
///
/// Adds to `shape` the derivatives along `w` of ∂U/∂r and of ∂U/∂ψ at rest and, with `PARAMETERS`, ∂²U/∂s∂k·w: Σ strain · (derivative of
/// the strain along w).
#[inline(always)]
pub fn product<
    V: Vector,
    const LINEAR: bool,
    const CONTACT: bool,
    const GRADIENT: bool,
    const PARAMETERS: bool,
>(
    model: &Model,
    bars: &[Bar<V::Scalar>],
    x: &[Place<V>],
    w: &[[V; 3]],
    turn: &[Turn<V>],
    g: &mut [[V; 3]],
    h: &mut [[V; 3]],
    shape: ShapeCotangent<'_, V>,
) {
    let units = model.units();
    assert!(x.len() == units && turn.len() == units && h.len() == units, "one entry per unit");
    assert!(w.len() == units, "one entry per unit");
    let zero = V::splat(0.0);
    if bars.is_empty() {
        return;
    }
    let mut pipeline = Pipeline::new::<LINEAR>(bars, x, turn);
    for (q, bar) in bars.iter().enumerate() {
        let (at, gamma) = pipeline.next::<LINEAR>(q, bars, x, turn);
        let &Bar::<V::Scalar> { a, b, .. } = bar;
        let turns = [turn[a].rounded(x[a][2]), turn[b].rounded(x[b][2])];
        let reaction = reaction::<V, LINEAR, CONTACT>(model, bar, at, gamma, &mut { zero });
        if GRADIENT {
            reaction.add_to(g, bar);
        }
        let tangent = reaction.tangent::<LINEAR, CONTACT>(bar, [w[a], w[b]]);
        let [fx, fy] = tangent.force;
        let [hx, hy, ht] = h[a];
        h[a] = [hx + fx, hy + fy, ht - tangent.moments[0]];
        let [hx, hy, ht] = h[b];
        h[b] = [hx - fx, hy - fy, ht - tangent.moments[1]];
        // (R − I)ᵀ ∂U/∂node at b, its negative at a; rotating R by ω is equivalent to rotating the force by −ω
        let [gx, gy] = reaction.force;
        let [s, c1, _] = turns[1];
        let omega = w[b][2];
        let (tx, ty) = (omega.mul_add(gy, fx), omega.mul_sub_from(gx, fy));
        let to = &mut shape.arms[bar.node_b];
        *to = [
            omega.mul_add(gy, s.mul_add(ty, c1.mul_add(tx, to[0]))),
            omega.mul_sub_from(gx, s.mul_sub_from(tx, c1.mul_add(ty, to[1]))),
        ];
        let [s, c1, _] = turns[0];
        let omega = w[a][2];
        let (tx, ty) = (omega.mul_add(gy, fx), omega.mul_sub_from(gx, fy));
        let to = &mut shape.arms[bar.node_a];
        *to = [
            omega.mul_sub_from(gy, s.mul_sub_from(ty, c1.mul_sub_from(tx, to[0]))),
            omega.mul_add(gx, s.mul_add(tx, c1.mul_sub_from(ty, to[1]))),
        ];
        if CONTACT {
            let to = &mut shape.voids[bar.index];
            *to = [to[0] + tangent.voids[0], to[1] + tangent.voids[1]];
        }
        if PARAMETERS {
            let to = &mut shape.stiffness[bar.index];
            for k in 0..3 {
                to[k] = reaction.strains[k].mul_add(tangent.strains[k], to[k]);
            }
            if CONTACT && let Some(contact) = model.contact {
                // ∂E_c/∂ψ is proportional to k_c
                let turned = tangent.strains[2] * V::splat(1.0 / contact.stiffness);
                let moment = reaction.contact[1].0 - reaction.contact[0].0;
                *shape.contact = moment.mul_add(turned, *shape.contact);
            }
        }
    }
}

/// Acts on Maxwell branches with units at rest at `x`: adds the gradient of the branch energies times `reach` to `g`, and multiplies the
/// difference between the ligaments' strains and the dashpots' strains `past` by `keep`.
#[inline(always)]
pub fn relax<V: Vector, const LINEAR: bool>(
    bars: &[Bar<V::Scalar>],
    x: &[Place<V>],
    turn: &[Turn<V>],
    (reach, keep): (f64, f64),
    past: &mut [[V; 3]],
    g: &mut [[V; 3]],
) {
    let zero = V::splat(0.0);
    for (bar, past) in bars.iter().zip(past) {
        let at = kinematics::<V, LINEAR>(bar, x, turn);
        let length = V::from_scalar(bar.length);
        let strains = if LINEAR {
            linear(bar, at.d, at.mean, at.relative).2
        } else {
            [at.size - length, length * shear_angle::<V, LINEAR>(&at), at.relative]
        };
        let mut pull = [zero; 3];
        for k in 0..3 {
            let ahead = strains[k] - past[k];
            pull[k] = V::splat(reach) * V::from_scalar(bar.stiffness[k]) * ahead;
            past[k] = V::splat(keep).mul_sub_from(ahead, strains[k]);
        }
        let [along, across, bend] = pull;
        let ([dx, dy], e) = (at.d, pair(bar.e));
        let (along, side) = if LINEAR {
            (along, across)
        } else {
            (along * at.inverse, length * across * at.inverse * at.inverse)
        };
        let (dx, dy) = if LINEAR { (e[0], e[1]) } else { (dx, dy) };
        let shear = V::splat(0.5) * length * across;
        let reaction = Reaction {
            at,
            inverse_square: zero,
            stretch: along,
            side,
            force: [side.mul_sub_from(dy, along * dx), side.mul_add(dx, along * dy)],
            moments: [-(shear + bend), bend - shear],
            contact: [(zero, zero); 2],
            strains,
        };
        reaction.add_to(g, bar);
    }
}

/// Sets `turn` to the rotations of `x`.
#[inline(always)]
pub fn turns<V: Vector>(x: &[Place<V>], turn: &mut [Turn<V>]) {
    for (turn, x) in turn.iter_mut().zip(x) {
        turn.set(x[2]);
    }
}

/// Computes the kinematics of a ligament, except γ.
#[inline(always)]
fn kinematics<V: Vector, const LINEAR: bool>(
    bar: &Bar<V::Scalar>,
    x: &[Place<V>],
    turn: &[Turn<V>],
) -> Kinematics<V> {
    let (xa, xb, zero) = (x[bar.a], x[bar.b], V::splat(0.0));
    let (ra, rb) = (pair(bar.arm_a), pair(bar.arm_b));

    // d − d₀
    let (ta, tb) = (&turn[bar.a], &turn[bar.b]);
    let ([sa, ca, theta_a], [sb, cb, theta_b]) = (ta.rounded(xa[2]), tb.rounded(xb[2]));
    let (du, levers);
    if V::SINGLE {
        let separation = [xb[0] - xa[0], xb[1] - xa[1]];
        du = narrow(moved_from(moved_to(separation, tb.exact, rb), ta.exact, ra));
        let (ra, rb) = (pair(bar.lever_a), pair(bar.lever_b));
        levers = [moved_to(ra, [sa, ca], ra), moved_to(rb, [sb, cb], rb)];
    } else {
        let (pa, pb) = (moved(ta.exact, ra), moved(tb.exact, rb));
        du = narrow([(xb[0] + pb[0]) - (xa[0] + pa[0]), (xb[1] + pb[1]) - (xa[1] + pa[1])]);
        levers = [narrow([pa[0] + ra[0], pa[1] + ra[1]]), narrow([pb[0] + rb[0], pb[1] + rb[1]])];
    }
    let mut at = Kinematics {
        levers,
        d: du,
        size: zero,
        inverse: zero,
        along_reference: [zero; 2],
        square: zero,
        mean: V::splat(0.5) * (theta_a + theta_b),
        relative: theta_b - theta_a,
    };
    if !LINEAR {
        let (e, length) = (pair(bar.e), V::from_scalar(bar.length));
        let (dx, dy) = (length.mul_add(e[0], du[0]), length.mul_add(e[1], du[1]));
        let square = dx.mul_add(dx, dy * dy);
        at.d = [dx, dy];
        at.inverse = square.rsqrt();
        at.size = square * at.inverse;
        if V::SINGLE {
            // from d − d₀, about a hundredth of d
            let [along, across] = [du[0].mul_add(e[0], du[1] * e[1]), du[0].mul_sub_from(e[1], du[1] * e[0])];
            at.along_reference = [length + along, across];
            at.square = along.mul_add(length + at.along_reference[0], across * across);
        } else {
            at.along_reference = [dx.mul_add(e[0], dy * e[1]), dx.mul_sub_from(e[1], dy * e[0])];
        }
    }
    at
}

/// Rounds both coordinates.
#[inline(always)]
fn narrow<V: Vector>([x, y]: [V::Wide; 2]) -> [V; 2] {
    [V::narrow(x), V::narrow(y)]
}

/// (R − I) r.
#[inline(always)]
fn moved<W: Vector>([s, c1]: [W; 2], r: [W; 2]) -> [W; 2] {
    [s.mul_sub_from(r[1], c1 * r[0]), s.mul_add(r[0], c1 * r[1])]
}

/// x + (R − I) r.
#[inline(always)]
fn moved_to<W: Vector>(x: [W; 2], [s, c1]: [W; 2], r: [W; 2]) -> [W; 2] {
    [s.mul_sub_from(r[1], c1.mul_add(r[0], x[0])), s.mul_add(r[0], c1.mul_add(r[1], x[1]))]
}

/// x − (R − I) r.
#[inline(always)]
fn moved_from<W: Vector>(x: [W; 2], [s, c1]: [W; 2], r: [W; 2]) -> [W; 2] {
    [s.mul_add(r[1], c1.mul_sub_from(r[0], x[0])), s.mul_sub_from(r[0], c1.mul_sub_from(r[1], x[1]))]
}

/// γ; zero in linearised scenes.
#[inline(always)]
fn shear_angle<V: Vector, const LINEAR: bool>(at: &Kinematics<V>) -> V {
    if LINEAR {
        return V::splat(0.0);
    }
    angle(at.along_reference[1].over(at.size + at.along_reference[0]), at.along_reference, at.mean)
}

/// Software pipelining: kinematics of the next two ligaments, and γ of the first. A ligament is a long chain of dependent operations. While
/// it waits, processors look ahead by about a hundred operations, which this order fills from three ligaments.
struct Pipeline<V> {
    /// Kinematics of ligament q at index q modulo 4, so that none is copied.
    at: [Kinematics<V>; 4],
    gamma: V,
}

impl<V: Vector> Pipeline<V> {
    #[inline(always)]
    fn new<const LINEAR: bool>(bars: &[Bar<V::Scalar>], x: &[Place<V>], turn: &[Turn<V>]) -> Self {
        let first = kinematics::<V, LINEAR>(&bars[0], x, turn);
        let second = kinematics::<V, LINEAR>(&bars[1.min(bars.len() - 1)], x, turn);
        Self { at: [first, second, first, first], gamma: shear_angle::<V, LINEAR>(&first) }
    }

    /// Returns kinematics and γ of ligament q, and starts ligament q + 2.
    #[inline(always)]
    fn next<const LINEAR: bool>(
        &mut self,
        q: usize,
        bars: &[Bar<V::Scalar>],
        x: &[Place<V>],
        turn: &[Turn<V>],
    ) -> (Kinematics<V>, V) {
        if let Some(bar) = bars.get(q + 2) {
            self.at[(q + 2) % 4] = kinematics::<V, LINEAR>(bar, x, turn);
        }
        let gamma = self.gamma;
        self.gamma = shear_angle::<V, LINEAR>(&self.at[(q + 1) % 4]);
        (self.at[q % 4], gamma)
    }
}

/// Computes the reaction of a ligament, including contact.
#[inline(always)]
fn reaction<V: Vector, const LINEAR: bool, const CONTACT: bool>(
    model: &Model,
    bar: &Bar<V::Scalar>,
    at: Kinematics<V>,
    gamma: V,
    margin: &mut V,
) -> Reaction<V> {
    let (zero, length, relative) = (V::splat(0.0), bar.length, at.relative);
    let [k_l, _, k_t] = bar.stiffness;
    let mut own = Reaction {
        at,
        inverse_square: zero,
        stretch: zero,
        side: zero,
        force: [zero; 2],
        moments: [zero; 2],
        contact: [(zero, zero); 2],
        strains: [zero; 3],
    };
    // `shear`: −∂U/∂θ of each unit, because the reference of γ turns with both units. `bend`: ∂U/∂θ_b of bending and contact, the negative
    // of ∂U/∂θ_a.
    let shear;
    let mut bend = V::from_scalar(k_t) * relative;
    if LINEAR {
        (own.force, shear, own.strains) = linear(bar, at.d, at.mean, relative);
    } else {
        let [dx, dy] = at.d;
        own.inverse_square = at.inverse * at.inverse;
        own.stretch = if V::SINGLE {
            V::from_scalar(k_l) * at.inverse * at.square.over(at.size + V::from_scalar(length))
        } else {
            V::from_scalar(bar.tension).mul_sub_from(at.inverse, V::from_scalar(k_l))
        };
        let twist = V::from_scalar(bar.twist) * gamma;
        own.side = twist * own.inverse_square;
        own.force = [own.side.mul_sub_from(dy, own.stretch * dx), own.side.mul_add(dx, own.stretch * dy)];
        shear = V::splat(0.5) * twist;
        own.strains = [at.size - V::from_scalar(length), V::from_scalar(length) * gamma, relative];
    }
    if CONTACT && let Some(contact) = model.contact {
        // ψ₁ decreases and ψ₂ increases with θ_b − θ_a
        let psi = [V::from_scalar(bar.voids[0]) - relative, V::from_scalar(bar.voids[1]) + relative];
        for (s, sign) in [(0, -1.0), (1, 1.0)] {
            *margin = -Vector::max(-*margin, V::splat(contact.min_angle) - psi[s]);
            if psi[s].any_less(V::splat(contact.cutoff_angle)) {
                own.contact[s] = contact_slope(contact, psi[s]);
                bend = V::splat(sign).mul_add(own.contact[s].0, bend);
            }
        }
    }
    own.moments = [-(shear + bend), bend - shear];
    own
}

/// Force, moment and strains of the linearised ligament.
#[inline(always)]
fn linear<V: Vector>(bar: &Bar<V::Scalar>, du: [V; 2], mean: V, relative: V) -> ([V; 2], V, [V; 3]) {
    let ([k_l, k_s, _], e, length) = (bar.stiffness, pair(bar.e), V::from_scalar(bar.length));
    let stretched = du[0].mul_add(e[0], du[1] * e[1]);
    let slid = du[0].mul_sub_from(e[1], du[1] * e[0]) - length * mean;
    let (stretch, slide) = (V::from_scalar(k_l) * stretched, V::from_scalar(k_s) * slid);
    let force = [slide.mul_sub_from(e[1], stretch * e[0]), slide.mul_add(e[0], stretch * e[1])];
    (force, V::splat(0.5) * length * slide, [stretched, slid, relative])
}

impl<V: Vector> Reaction<V> {
    /// Adds ∂U/∂s of both units.
    #[inline(always)]
    fn add_to(&self, g: &mut [[V; 3]], bar: &Bar<V::Scalar>) {
        let [fx, fy] = self.force;
        let ([la, lb], [ma, mb]) = (self.at.levers, self.moments);
        let [x, y, t] = g[bar.a];
        g[bar.a] = [x - fx, y - fy, t + la[1].mul_add(fx, la[0].mul_sub_from(fy, ma))];
        let [x, y, t] = g[bar.b];
        g[bar.b] = [x + fx, y + fy, t + lb[1].mul_sub_from(fx, lb[0].mul_add(fy, mb))];
    }

    /// Derivative along the directions `wa`, `wb` of both units:
    /// ```text
    /// δd = δu_b − δu_a + ω_b (R r_b)⊥ − ω_a (R r_a)⊥,   ρ = d·δd/|d|²,   δγ = d⊥·δd/|d|² − ½(ω_a + ω_b)
    /// δg = stretch δd + side δd⊥ + k_l l₀/|d| ρ d + (k_s l₀² δγ/|d|² − 2 side ρ) d⊥
    /// ```
    #[inline(always)]
    fn tangent<const LINEAR: bool, const CONTACT: bool>(
        &self,
        bar: &Bar<V::Scalar>,
        [wa, wb]: [[V; 3]; 2],
    ) -> ReactionTangent<V> {
        let (length, zero) = (bar.length, V::splat(0.0));
        let Kinematics { levers: [la, lb], d: [dx, dy], size, inverse, .. } = self.at;
        let p = wa[2].mul_add(la[1], wb[2].mul_sub_from(lb[1], wb[0] - wa[0]));
        let q = wa[2].mul_sub_from(la[0], wb[2].mul_add(lb[0], wb[1] - wa[1]));
        let (mean, relative) = (V::splat(0.5) * (wa[2] + wb[2]), wb[2] - wa[2]);
        let (force, shear, strains);
        if LINEAR {
            (force, shear, strains) = linear(bar, [p, q], mean, relative);
        } else {
            let rho = dx.mul_add(p, dy * q) * self.inverse_square;
            let swing = dy.mul_sub_from(p, dx * q) * self.inverse_square;
            let gamma = swing - mean;
            let twist = V::from_scalar(bar.twist) * gamma;
            let stretch = V::from_scalar(bar.tension) * inverse * rho;
            let side = (self.side + self.side).mul_sub_from(rho, self.inverse_square * twist);
            force = [
                side.mul_sub_from(dy, stretch.mul_add(dx, self.side.mul_sub_from(q, self.stretch * p))),
                side.mul_add(dx, stretch.mul_add(dy, self.side.mul_add(p, self.stretch * q))),
            ];
            shear = V::splat(0.5) * twist;
            strains = [rho * size, V::from_scalar(length) * gamma, relative];
        }
        let mut bend = V::from_scalar(bar.stiffness[2]) * relative;
        let mut voids = [zero; 2];
        if CONTACT {
            for (s, sign) in [(0, -1.0), (1, 1.0)] {
                voids[s] = V::splat(sign) * self.contact[s].1 * relative;
                bend = V::splat(sign).mul_add(voids[s], bend);
            }
        }
        let (ma, mb) = (self.lever_along(la, wa[2], force), self.lever_along(lb, wb[2], force));
        let moments = [ma - shear - bend, bend - shear - mb];
        ReactionTangent { force, moments, voids, strains }
    }

    /// Derivative of the force's moment about the centroid, for an arm that rotates with ω and a force with the derivative `along`.
    #[inline(always)]
    fn lever_along(&self, lever: [V; 2], omega: V, along: [V; 2]) -> V {
        let turned = omega * lever[0].mul_add(self.force[0], lever[1] * self.force[1]);
        lever[0].mul_sub_from(along[1], lever[1].mul_add(along[0], turned))
    }
}

/// E_c of a void angle.
#[inline(always)]
fn contact_energy<V: Vector>(contact: super::EdgeContact, psi: V) -> V {
    let width = contact.cutoff_angle - contact.min_angle;
    let (one, zero) = (V::splat(1.0), V::splat(0.0));
    let x = (psi - V::splat(contact.cutoff_angle)) * V::splat(1.0 / width);
    let square = (x * x).where_less(x, zero, zero).where_less(-one, x, zero);
    V::splat(0.5 * contact.stiffness * width * width) * square.over(one - square)
}

/// dE_c/dψ = k_c w x/(1−x²)² and d²E_c/dψ² = k_c (1+3x²)/(1−x²)³; zero for ψ ≥ ψ_c and ψ ≤ ψ_min.
#[inline(always)]
fn contact_slope<V: Vector>(contact: super::EdgeContact, psi: V) -> (V, V) {
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
    let (slope, curvature) = (slope.where_less(x, zero, zero), curvature.where_less(x, zero, zero));
    (slope.where_less(-one, x, zero), curvature.where_less(-one, x, zero))
}
