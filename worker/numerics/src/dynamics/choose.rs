//! Which integrator and how many steps: from the scene's own highest frequency and the accuracy asked.

use super::ligaments::{Shape, gradient};
use super::model::Model;
use super::real::Dual;
use super::vector::{Array, Vector};
use super::{Method, Plan, Scene, Solver};

/// Highest angular frequency of small motions about rest (rad/s), undamped: the largest eigenvalue of M^-½ H M^-½ by
/// Lanczos' method, whose estimate is good to a per mille long before its vectors lose orthogonality.
pub fn highest_frequency(scene: &Scene, design: &[f64]) -> f64 {
    let model = Model::new(scene, design);
    let root: Vec<f64> = model.inverse_mass.as_flattened().iter().map(|m| m.sqrt()).collect();
    let n = root.len();
    let apply = |y: &[f64]| -> Vec<f64> {
        let w: Vec<f64> = y.iter().zip(&root).map(|(y, r)| y * r).collect();
        hessian_at_rest(&model, scene, &w).iter().zip(&root).map(|(h, r)| h * r).collect()
    };
    let norm = |y: &[f64]| y.iter().map(|y| y * y).sum::<f64>().sqrt();
    // Any start that no symmetry of the lattice leaves without a part in the highest mode
    let mut q: Vec<f64> =
        (0..n).map(|i| if root[i] > 0.0 { (1.0 + 7.3 * i as f64).sin() } else { 0.0 }).collect();
    let size = norm(&q);
    if size == 0.0 {
        return 0.0;
    }
    q.iter_mut().for_each(|q| *q /= size);
    let (mut diagonal, mut beside, mut previous) = (Vec::new(), Vec::new(), vec![0.0; n]);
    for _ in 0..60.min(n) {
        let mut z = apply(&q);
        let a: f64 = z.iter().zip(&q).map(|(z, q)| z * q).sum();
        let b = beside.last().copied().unwrap_or(0.0);
        for i in 0..n {
            z[i] -= a * q[i] + b * previous[i];
        }
        diagonal.push(a);
        let size = norm(&z);
        if size <= 1e-12 * a.abs() {
            break;
        }
        beside.push(size);
        z.iter_mut().for_each(|z| *z /= size);
        previous = std::mem::replace(&mut q, z);
    }
    let k = diagonal.len();
    let tridiagonal = nalgebra::DMatrix::from_fn(k, k, |i, j| match i.abs_diff(j) {
        0 => diagonal[i],
        1 => beside[i.min(j)],
        _ => 0.0,
    });
    tridiagonal.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// Product of the Hessian of the energy at rest with w.
fn hessian_at_rest(model: &Model, scene: &Scene, w: &[f64]) -> Vec<f64> {
    let zero = Array::splat(0.0);
    let units = model.units();
    let direction: Vec<[Array; 3]> = w.as_chunks::<3>().0.iter().map(|w| w.map(Array::splat)).collect();
    let x = vec![[zero; 3]; units];
    let (mut turn, mut g, mut h) = (vec![[zero; 4]; units], x.clone(), x.clone());
    let kernel = match (scene.linearised, scene.contact.is_some()) {
        (false, false) => gradient::<Array, Dual<Array>, false, false, false>,
        (false, true) => gradient::<Array, Dual<Array>, false, true, false>,
        (true, false) => gradient::<Array, Dual<Array>, true, false, false>,
        (true, true) => gradient::<Array, Dual<Array>, true, true, false>,
    };
    let shape = Shape { arms: &mut [], voids: &mut [] };
    kernel(model, &x, &direction, &mut turn, &mut g, &mut h, shape, &mut { zero });
    h.as_flattened().iter().map(|h| h.array()[0]).collect()
}

/// Measured error of the signals, relative, against w = ω h/stages, ω the highest frequency: factor · wᵖ.
///
/// Fitted on the reference scene, where 2e-3 … 7e-8 follow the powers within a third; bodies whose highest modes ring
/// for many periods between instants have up to twice the error (stretch × 100, × 10 000), hence the second factor.
struct Law {
    method: Method,
    power: f64,
    factor: [f64; 2],
    /// Largest w that is used, for stability in motion far from rest.
    limit: f64,
    /// Cost of a step, in forces.
    work: usize,
}

const LAWS: [Law; 4] = [
    Law { method: Method::Leapfrog, power: 2.0, factor: [0.45, 0.9], limit: 0.7, work: 1 },
    Law { method: Method::Nystrom4, power: 4.0, factor: [0.25, 0.6], limit: 0.6, work: 6 },
    Law { method: Method::Nystrom6, power: 6.0, factor: [1.5, 3.2], limit: 0.5, work: 11 },
    // Of the highest soft mode; about 3.5 forces and a share of a factorisation a stage
    Law { method: Method::Implicit, power: 4.0, factor: [30.0, 30.0], limit: 0.4, work: 26 },
];
/// Radians of the highest mode in an interval from which the second factor holds.
const RINGING: f64 = 60.0;
/// Asked errors from which the ringing of stiff modes, some per cent of accelerations, may be left out.
const SOFT: f64 = 0.03;

impl Law {
    /// Steps an interval of `radians` of the highest mode that the method follows.
    fn steps(&self, radians: f64, tolerance: f64) -> usize {
        let factor = self.factor[usize::from(radians > RINGING)];
        let w = (tolerance / factor).powf(1.0 / self.power).min(self.limit);
        let stages = self.method.stages().expect("equal steps") as f64;
        (radians / (w * stages)).ceil().clamp(1.0, 1e6) as usize
    }
}

/// Turns a solver into a plan for this scene and design.
pub fn choose(scene: &Scene, design: &[f64], solver: &Solver) -> Plan {
    let Solver { method, tolerance } = *solver;
    if method == Method::Tsit5 {
        return Plan { method, tolerance, steps: 0, reason: "asked for".to_owned() };
    }
    let delta = scene.duration / scene.instants as f64;
    let all = highest_frequency(scene, design);
    // Without the stiffness by which stretching exceeds shearing more than in the reference material
    let mut soft = scene.clone();
    soft.stiffness.stretch = soft.stiffness.stretch.min(6.0 * soft.stiffness.shear);
    let soft =
        if method == Method::Implicit || tolerance >= SOFT { highest_frequency(&soft, design) } else { all };
    let followed = |law: &Law| if law.method == Method::Implicit { soft } else { all };
    let steps = |law: &Law| law.steps(followed(law) * delta, tolerance);
    let law = match method {
        Method::Auto => LAWS
            .iter()
            .filter(|law| law.method != Method::Implicit || tolerance >= SOFT)
            .min_by_key(|law| steps(law) * law.work),
        named => LAWS.iter().find(|law| law.method == named),
    };
    let law = law.expect("a law for every method of equal steps");
    let why = if method == Method::Auto { "least work" } else { "asked for" };
    let reason = format!(
        "{why}: {} steps an interval for an error of {tolerance:.0e}, highest frequency followed {:.0} Hz of {:.0} Hz",
        steps(law),
        followed(law) / std::f64::consts::TAU,
        all / std::f64::consts::TAU
    );
    Plan { method: law.method, tolerance, steps: steps(law), reason }
}
