//! Simulation and reverse sweep of samples, distributed over lanes and threads.

use super::dispatch::{Machine, Swept, machine};
use super::jobs::{Backward, SampleJob};
use super::model::{Model, ModelCotangent};
use super::simulation::SampleTape;
use super::{
    Forces, Gradient, IntegrationPlan, Integrator, IntegratorSettings, Outcome, Scene, Simulation,
    SimulationCounts, Steps, Tape, Wrt, choose, equilibrium, splitting,
};
use rayon::prelude::*;
use std::sync::Mutex;

/// Largest number of vectors of samples per reverse sweep of Tsit5, which groups their samples.
const BLOCKS: usize = 5;

/// Integrates all samples and computes the signals.
///
/// # Panics
/// If lengths or indices of scene, design and forces do not match.
pub fn simulate(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    solver: &IntegratorSettings,
    keep_tape: bool,
    pool: &crate::Pool,
) -> Simulation {
    run(scene, design, forces, &planned(scene, design, forces, solver), keep_tape, pool)
}

/// The plan that [`simulate`] uses.
pub fn planned(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    solver: &IntegratorSettings,
) -> IntegrationPlan {
    choose::choose_under(scene, design, forces.kinks(scene), solver)
}

/// Integrates with `plan`. Its steps are rounded up to a multiple of the forces' kinks per interval.
///
/// # Panics
/// As `simulate`.
pub fn run(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    plan: &IntegrationPlan,
    keep_tape: bool,
    pool: &crate::Pool,
) -> Simulation {
    check(scene, design, forces);
    assert!(!keep_tape || scene.relaxation.is_none(), "a scene with relaxing ligaments has no gradient");
    let model = Model::new(scene, design).without_fixed_bars();
    let steps = match plan.steps {
        Steps::Equal(steps) => Steps::Equal(steps.next_multiple_of(forces.kinks(scene))),
        adaptive @ Steps::Adaptive(_) => adaptive,
    };
    let plan = &IntegrationPlan { steps, ..plan.clone() };
    let n = forces.samples;
    let machine = machine(pool.width(), plan.precision, n);
    let len = scene.instants * 3 * scene.sensors.len();
    let mut signals = vec![0.0; n * len];
    let mut outcomes = vec![Outcome::Ok; n];
    let parts = match plan.steps {
        Steps::Equal(steps) => splitting::segments(scene, &model, steps),
        Steps::Adaptive(_) => 1,
    };
    let mut tapes: Vec<SampleTape> = Vec::new();
    if keep_tape {
        // until its first force, a sample stays in its starting state
        let states = || {
            let mut states = vec![0.0; scene.instants * parts * 6 * model.free.len()];
            if !model.start().is_empty() {
                let of_units = states.chunks_exact_mut(6).zip(model.free.iter().cycle());
                of_units.for_each(|(state, &u)| state[..3].copy_from_slice(&model.start()[u]));
            }
            states
        };
        tapes.resize_with(n, || SampleTape { states: states(), refined: 1, ..SampleTape::default() });
    }
    let mut kept: Vec<Option<&mut SampleTape>> = tapes.iter_mut().map(Some).collect();
    kept.resize_with(n, || None);
    // a scene without sensors needs one empty slice per sample
    let mut rest = signals.as_mut_slice();
    let mut jobs: Vec<SampleJob<'_>> = Vec::with_capacity(n);
    for (index, (outcome, tape)) in outcomes.iter_mut().zip(kept).enumerate() {
        let (signals, others) = rest.split_at_mut(len);
        rest = others;
        jobs.push(SampleJob { signals, outcome, tape, index });
    }
    let adaptive = matches!(plan.steps, Steps::Adaptive(_));
    if !adaptive {
        // samples that start together share a vector, so all its lanes wait together
        jobs.sort_by_key(|s| forces.onset(scene, forces.sample(s.index)));
    }
    if let Err(outcome) = model.start {
        jobs.drain(..).for_each(|job| *job.outcome = outcome);
    }
    let mut total = integrate(&machine, scene, &model, forces, plan, parts, &mut jobs, pool);
    // samples for which equal steps are too long are repeated with finer steps
    for refined in [2, 4, 8] {
        let mut failed: Vec<SampleJob<'_>> = Vec::new();
        for job in &mut jobs {
            if !adaptive && *job.outcome != Outcome::Ok {
                *job.outcome = Outcome::Ok;
                if let Some(tape) = &mut job.tape {
                    tape.refined = refined;
                }
                let tape = job.tape.as_deref_mut();
                failed.push(SampleJob { signals: job.signals, outcome: job.outcome, tape, index: job.index });
            }
        }
        if failed.is_empty() {
            break;
        }
        let finer = IntegrationPlan { steps: plan.steps.times(refined), ..plan.clone() };
        total.rejected += failed.len() as u64;
        total += integrate(&machine, scene, &model, forces, &finer, parts, &mut failed, pool);
    }
    for (i, outcome) in outcomes.iter().enumerate() {
        if *outcome != Outcome::Ok {
            // signals before a failure are useless to a decoder
            signals[i * len..][..len].fill(0.0);
        }
    }
    Simulation {
        signals,
        outcomes,
        counters: total,
        plan: plan.clone(),
        width: pool.width(),
        tape: keep_tape.then(|| Tape {
            scene: scene.clone(),
            design: design.to_vec(),
            forces: forces.clone(),
            start: model.start().to_vec(),
            parts,
            samples: tapes,
        }),
    }
}

fn integrate(
    machine: &Machine,
    scene: &Scene,
    model: &Model,
    forces: &Forces,
    plan: &IntegrationPlan,
    parts: usize,
    jobs: &mut [SampleJob<'_>],
    pool: &crate::Pool,
) -> SimulationCounts {
    let forward = if scene.relaxation.is_some() { machine.relaxing } else { machine.forward };
    let tasks = pool.threads().min(jobs.len().div_ceil(machine.lanes));
    let queue = Mutex::new(jobs);
    let counters: Vec<SimulationCounts> = pool.install(|| {
        (0..tasks)
            .into_par_iter()
            // SAFETY: `machine` has checked that this machine supports its width.
            .map(|_| unsafe { forward(scene, model, forces, plan, parts, &queue, pool.heartbeat()) })
            .collect()
    });
    let mut total = SimulationCounts::default();
    counters.into_iter().for_each(|c| total += c);
    total
}

impl Simulation {
    /// Gradient of Σ cotangent·signals, cotangent (N, T, 3M), with the method and instruction set of the simulation.
    /// Failed samples contribute zero.
    ///
    /// # Panics
    /// If the simulation has no tape, or the length does not match.
    pub fn vjp(&self, cotangent: &[f64], wrt: Wrt, pool: &crate::Pool) -> Gradient {
        let tape = self.tape.as_ref().expect("the simulation kept its tape");
        let Tape { scene, forces, parts, samples, .. } = tape;
        let len = scene.instants * 3 * scene.sensors.len();
        assert_eq!(cotangent.len(), forces.samples * len, "length of the cotangent");
        let model = tape.model().without_fixed_bars();
        let plan = &self.plan;
        let machine = machine(self.width, plan.precision, forces.samples);
        let sweeps: Vec<Backward<'_>> = (0..forces.samples)
            .filter(|i| self.outcomes[*i] == Outcome::Ok)
            .map(|at| Backward {
                at,
                tape: &samples[at],
                history: forces.sample(at),
                cotangent: &cotangent[at * len..][..len],
            })
            .collect();
        // all lanes of a vector have the same number of steps
        let mut blocks: Vec<(IntegrationPlan, Vec<Backward<'_>>)> = Vec::new();
        for refined in [1, 2, 4, 8] {
            let finer = IntegrationPlan { steps: plan.steps.times(refined), ..plan.clone() };
            let mut group: Vec<&Backward<'_>> = sweeps.iter().filter(|s| s.tape.refined == refined).collect();
            group.sort_by_key(|s| match plan.method {
                Integrator::Tsit5 => s.tape.counts.iter().sum::<u32>() as usize,
                _ => forces.onset(scene, s.history),
            });
            let lanes: Vec<&[&Backward<'_>]> = group.chunks(machine.lanes).collect();
            // Tsit5 groups samples with similar numbers of steps, but threads need equal work: each task receives samples
            // of all lengths.
            let tasks = match plan.method {
                Integrator::Tsit5 => lanes.len().div_ceil(BLOCKS).max(lanes.len().min(4)),
                _ => lanes.len(),
            };
            let dealt: Vec<&Backward<'_>> = (0..tasks)
                .flat_map(|t| lanes[t..].iter().step_by(tasks).copied().flatten().copied())
                .collect();
            let end = |t: usize| (lanes.len() * t / tasks * machine.lanes).min(dealt.len());
            blocks.extend((0..tasks).map(|t| {
                (finer.clone(), dealt[end(t)..end(t + 1)].iter().map(|s| **s).collect::<Vec<Backward<'_>>>())
            }));
        }
        let swept: Vec<Swept> = pool.install(|| {
            blocks
                .par_iter()
                // SAFETY: `machine` has checked that this machine supports the simulation's width.
                .map(|(plan, sweeps)| unsafe {
                    (machine.reverse)(scene, &model, forces, plan, *parts, sweeps, wrt, pool.heartbeat())
                })
                .collect()
        });
        let mut total = ModelCotangent::new(&model, 0.0);
        let mut counters = SimulationCounts::default();
        let history = forces.panels * (forces.instants + 1);
        let mut pushed = (wrt == Wrt::Forces).then(|| vec![0.0; forces.samples * history]);
        for ((cotangent, histories, work), (_, sweeps)) in swept.iter().zip(&blocks) {
            total.add(cotangent);
            counters += *work;
            if let Some(pushed) = &mut pushed {
                for (sweep, of) in sweeps.iter().zip(histories.chunks(history.max(1))) {
                    pushed[sweep.at * history..][..history].copy_from_slice(of);
                }
            }
        }
        equilibrium::add_start_vjp(scene, &model, &mut total);
        let parameters = (wrt == Wrt::Parameters).then(|| total.parameters(&model, scene));
        let parts = (wrt == Wrt::Parameters).then(|| total.parts(&model, scene));
        let design = total.design(&model, scene);
        Gradient { design, parameters, parts, forces: pushed, counters }
    }
}

fn check(scene: &Scene, design: &[f64], forces: &Forces) {
    let units = scene.layout.units();
    assert_eq!(design.len(), scene.layout.design_len(), "length of the design");
    assert_eq!(forces.panels, scene.panels.len(), "panels of the forces");
    let (own, instants) = (forces.instants, scene.instants);
    assert!(
        own > 0 && own.is_multiple_of(instants),
        "the forces have {own} instants; must be a multiple of the scene's {instants}"
    );
    let len = forces.samples * forces.panels * (forces.instants + 1);
    assert_eq!(forces.values.len(), len, "length of the forces");
    let strikes = forces.strikes.len();
    assert!([0, forces.samples * forces.panels].contains(&strikes), "{strikes} strikes");
    let named =
        scene.clamped.iter().chain(&scene.sensors).copied().chain(scene.panels.iter().map(|p| p.unit));
    assert!(named.into_iter().all(|u| u < units), "index of a unit out of range: the body has {units} units");
}
