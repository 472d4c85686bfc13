//! Motion with relaxing ligaments: a spring g k and a dashpot in series (Maxwell branch) parallel to each of k_l, k_s, k_θ.
//!
//! ```text
//! σ = k ε + g k (ε − q),   τ q̇ = ε − q           ε = Δl, l₀γ, Δθ of each ligament, q = 0 at rest
//! kick b:  M δv = −b h (∂U − f) − Bᵀ g k (ε − q) τ (1 − e),   q → ε − (ε − q) e,   e = exp(−b h/τ),   B = ∂ε/∂s
//! ```
//! A kick is exact for units at rest; drifts are those of `splitting`. The force of a kick depends on past strains, so the
//! conditions of Runge–Kutta–Nyström schemes do not hold. The scheme is S₆, which holds for arbitrary flows: S. Blanes, P. C.
//! Moan, J. Comput. Appl. Math. 142 (2002) 313–330. There is no reverse sweep.

use super::jobs::{SampleJob, SampleQueue, take};
use super::ligaments::relax;
use super::loads::LockstepForces;
use super::readings::read_lane;
use super::schemes::{Drift, Scheme};
use super::system::{System, Unit};
use super::{Forces, MaxwellBranch, Outcome, SimulationCounts};
use crate::Heartbeat;
use crate::lanes::Vector;

/// Integrates the samples of `queue` with `substeps` steps per interval. `system` must be undamped.
#[inline(always)]
pub fn forward<V: Vector, const LINEAR: bool>(
    mut system: System<'_, V>,
    relaxation: MaxwellBranch,
    substeps: usize,
    forces: &Forces,
    queue: &SampleQueue<'_, '_>,
    heartbeat: &Heartbeat,
) -> SimulationCounts {
    let mut counters = SimulationCounts::default();
    loop {
        let jobs = take(queue, V::LANES);
        if jobs.is_empty() {
            return counters;
        }
        counters += block::<V, LINEAR>(&mut system, relaxation, substeps, forces, jobs, heartbeat);
    }
}

#[inline(always)]
fn block<V: Vector, const LINEAR: bool>(
    system: &mut System<'_, V>,
    MaxwellBranch { share, time }: MaxwellBranch,
    substeps: usize,
    forces: &Forces,
    jobs: &mut [SampleJob<'_>],
    heartbeat: &Heartbeat,
) -> SimulationCounts {
    let (scene, model) = (system.scene, system.model);
    let (width, moving) = (3 * scene.sensors.len(), model.moving_range());
    let histories: Vec<&[f64]> = jobs.iter().map(|s| forces.sample(s.index)).collect();
    jobs.iter().enumerate().for_each(|(lane, job)| system.set_strike(lane, forces, job.index));
    let mut loads = LockstepForces::<V>::new(scene, forces, histories, substeps);
    let scheme = Scheme::any_fourth();
    let h = scene.duration / (scene.instants * substeps) as f64;
    let gamma = |u: usize, d: usize| model.inverse_mass[u][d] * model.damping[d];
    let drifts: Vec<Vec<[Drift<V::Scalar>; 3]>> = scheme
        .drifts
        .iter()
        .map(|a| {
            let of = |u: usize| [0, 1, 2].map(|d| Drift::new(gamma(u, d), a * h).rounded());
            (0..model.units()).map(of).collect()
        })
        .collect();
    let memory: Vec<Drift> = scheme.kicks.iter().map(|b| Drift::new(1.0 / time, b * h)).collect();

    let (mut x, mut v, mut g, mut pull) = (system.start(), system.places(), system.zeros(), system.zeros());
    let mut past = vec![[V::ZERO; 3]; model.bars.len()];
    let mut force = vec![V::ZERO; forces.panels];
    let mut margin = V::splat(1.0);
    loads.at(0, 0.0, &mut force);
    system.prepare(&x, &mut g);
    // the branches are relaxed in the starting state
    relax::<V, LINEAR>(&system.bars, &x, &system.turn, (0.0, 0.0), &mut past, &mut pull);
    system.add_forces(&x, &force, &mut g, &mut margin);
    for interval in 0..scene.instants {
        heartbeat.beat();
        for step in 0..substeps {
            let mut clock = 0.0;
            for (j, (b, memory)) in scheme.kicks.iter().zip(&memory).enumerate() {
                pull.fill([V::ZERO; 3]);
                let by = (share * memory.reach, memory.keep);
                relax::<V, LINEAR>(&system.bars, &x, &system.turn, by, &mut past, &mut pull);
                let b = V::splat(b * h);
                for u in moving.clone() {
                    for d in 0..3 {
                        let impulse = b.mul_add(g[u][d], pull[u][d]);
                        v[u][d] = V::Wide::from_scalar(model.inverse_mass[u][d])
                            .mul_sub_from(impulse.widen(), v[u][d]);
                    }
                }
                let Some(drifts) = drifts.get(j) else { break };
                for u in moving.clone() {
                    for d in 0..3 {
                        x[u][d] = V::Wide::from_scalar(drifts[u][d].reach).mul_add(v[u][d], x[u][d]);
                        v[u][d] = V::Wide::from_scalar(drifts[u][d].keep) * v[u][d];
                    }
                }
                clock += scheme.drifts[j];
                loads.at(interval * substeps + step, clock, &mut force);
                system.prepare(&x, &mut g);
                system.add_forces(&x, &force, &mut g, &mut margin);
            }
        }
        // a = −M⁻¹(∂U − f + Bᵀ g k (ε − q)) − γ v at the instant
        let mut a: Vec<Unit<V>> = g.clone();
        relax::<V, LINEAR>(&system.bars, &x, &system.turn, (share, 1.0), &mut past, &mut a);
        let mut size = V::Wide::ZERO;
        for u in moving.clone() {
            for d in 0..3 {
                let net = V::splat(model.damping[d]).mul_add(V::narrow(v[u][d]), a[u][d]);
                a[u][d] = -(V::from_scalar(system.inverse_mass[u][d]) * net);
                size = size + x[u][d].abs() + v[u][d].abs();
            }
        }
        for (l, job) in jobs.iter_mut().enumerate().filter(|(_, job)| *job.outcome == Outcome::Ok) {
            if margin.lane(l) < 0.0 {
                *job.outcome = Outcome::ForbiddenContact;
            } else if !size.lane(l).is_finite() {
                *job.outcome = Outcome::NonFinite;
            } else {
                let base = scene.base_at(forces.sample(job.index), (interval + 1) * forces.kinks(scene));
                read_lane(scene, (&x, &v), &a, base, l, &mut job.signals[interval * width..][..width]);
            }
        }
        if jobs.iter().all(|job| *job.outcome != Outcome::Ok) {
            break;
        }
    }
    let (lanes, steps) = (jobs.len() as u64, (scene.instants * substeps) as u64);
    let evaluations = 1 + steps * scheme.stages() as u64;
    SimulationCounts { force_evaluations: lanes * evaluations, steps: lanes * steps, rejected: 0 }
}
