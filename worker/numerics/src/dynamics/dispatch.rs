//! Entry points of each instruction set, and the division of samples among lanes and threads.

use super::ligaments::{Shape, Turn, gradient};
use super::model::{Model, ModelCotangent};
use super::real::Dual;
use super::system::{Kernels, System, Unit};
use super::tsit5::{self, Slot, Sweep};
use super::vector::{Array, LANES, Vector};
use super::{Counters, Forces, Gradient, Method, Outcome, SampleTape, Scene, Simulation, Solver, Tape};
use crate::simd::Width;
use rayon::prelude::*;

/// Samples that a task of the forward pass owns; its lanes take them up one after the other.
const CHUNK: usize = 40;

type Forward = unsafe fn(&Scene, &Model, &Forces, &Solver, &mut [Slot<'_>]) -> Counters;
type Reverse = unsafe fn(&Scene, &Model, &Forces, &Solver, &[Sweep<'_>]) -> (ModelCotangent, Counters);

/// The code of one instruction set.
struct Machine {
    forward: Forward,
    reverse: Reverse,
}

macro_rules! machine {
    ($module:ident, $vector:ty $(, $feature:literal)?) => {
        mod $module {
            use super::*;

            $(#[target_feature(enable = $feature)])?
            unsafe fn first<const LINEAR: bool, const CONTACT: bool>(
                model: &Model,
                x: &[Unit<$vector>],
                turn: &mut [Turn<$vector>],
                g: &mut [Unit<$vector>],
                margin: &mut $vector,
            ) {
                let shape = Shape { arms: &mut [], voids: &mut [] };
                gradient::<$vector, $vector, LINEAR, CONTACT, false>(model, x, &[], turn, g, &mut [], shape, margin);
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn second<const LINEAR: bool, const CONTACT: bool>(
                model: &Model,
                x: &[Unit<$vector>],
                w: &[Unit<$vector>],
                turn: &mut [Turn<$vector>],
                g: &mut [Unit<$vector>],
                h: &mut [Unit<$vector>],
                arms: &mut [[[$vector; 2]; 4]],
                voids: &mut [[$vector; 2]],
            ) {
                let mut margin = <$vector>::splat(0.0);
                let shape = Shape { arms, voids };
                gradient::<$vector, Dual<$vector>, LINEAR, CONTACT, true>(
                    model, x, w, turn, g, h, shape, &mut margin,
                );
            }

            fn kernels(scene: &Scene) -> Kernels<$vector> {
                match (scene.linearised, scene.contact.is_some()) {
                    (false, false) => Kernels { gradient: first::<false, false>, second: second::<false, false> },
                    (false, true) => Kernels { gradient: first::<false, true>, second: second::<false, true> },
                    (true, false) => Kernels { gradient: first::<true, false>, second: second::<true, false> },
                    (true, true) => Kernels { gradient: first::<true, true>, second: second::<true, true> },
                }
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn forward(
                scene: &Scene,
                model: &Model,
                forces: &Forces,
                solver: &Solver,
                slots: &mut [Slot<'_>],
            ) -> Counters {
                let system = System::<$vector>::new(scene, model, kernels(scene));
                match solver.method {
                    Method::Auto | Method::Tsit5 => tsit5::forward(system, forces, solver.tolerance, slots),
                }
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn reverse(
                scene: &Scene,
                model: &Model,
                forces: &Forces,
                solver: &Solver,
                sweeps: &[Sweep<'_>],
            ) -> (ModelCotangent, Counters) {
                let mut system = System::<$vector>::new(scene, model, kernels(scene));
                let counters = match solver.method {
                    Method::Auto | Method::Tsit5 => tsit5::reverse(&mut system, forces, sweeps),
                };
                (system.take_cotangent(), counters)
            }

            pub const MACHINE: Machine = Machine { forward, reverse };
        }
    };
}

machine!(baseline, Array);
#[cfg(target_arch = "x86_64")]
machine!(avx2, super::super::vector::Avx2, "avx2,fma");
#[cfg(target_arch = "x86_64")]
machine!(avx512, super::super::vector::Avx512, "avx512f,avx512dq,avx512vl,avx512bw,fma");

fn machine(width: Width) -> Machine {
    #[cfg(target_arch = "x86_64")]
    match width {
        Width::Avx512 => return avx512::MACHINE,
        Width::Avx2 => return avx2::MACHINE,
        Width::Baseline => {}
    }
    let _ = width;
    baseline::MACHINE
}

/// `super::simulate` with the code of `width`, which the machine must have.
pub fn simulate(
    width: Width,
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    solver: &Solver,
    keep_tape: bool,
    pool: &rayon::ThreadPool,
) -> Simulation {
    let model = Model::new(scene, design);
    let machine = machine(width);
    let n = forces.samples;
    let len = scene.instants * 3 * scene.sensors.len();
    let mut signals = vec![0.0; n * len];
    let mut outcomes = vec![Outcome::Ok; n];
    let mut tapes: Vec<SampleTape> = Vec::new();
    if keep_tape {
        let states = scene.instants * 6 * model.free.len();
        tapes.resize_with(n, || SampleTape { states: vec![0.0; states], ..SampleTape::default() });
    }
    let mut kept: Vec<Option<&mut SampleTape>> = tapes.iter_mut().map(Some).collect();
    kept.resize_with(n, || None);
    // A scene without sensors still has one empty slice a sample.
    let mut rest = signals.as_mut_slice();
    let mut slots: Vec<Slot<'_>> = Vec::with_capacity(n);
    for (index, (outcome, tape)) in outcomes.iter_mut().zip(kept).enumerate() {
        let (signals, others) = rest.split_at_mut(len);
        rest = others;
        slots.push(Slot { signals, outcome, tape, index });
    }
    let counters: Vec<Counters> = pool.install(|| {
        slots
            .par_chunks_mut(CHUNK)
            // SAFETY: `width` is what this machine has.
            .map(|slots| unsafe { (machine.forward)(scene, &model, forces, solver, slots) })
            .collect()
    });
    let mut total = Counters::default();
    counters.into_iter().for_each(|c| total += c);
    for (i, outcome) in outcomes.iter().enumerate() {
        if *outcome != Outcome::Ok {
            // What a failed sample read before it failed would teach a brain nothing.
            signals[i * len..][..len].fill(0.0);
        }
    }
    Simulation { signals, outcomes, counters: total, tape: keep_tape.then_some(Tape { samples: tapes }) }
}

/// `super::pull_back` with the code of `width`, which the machine must have.
pub fn pull_back(
    width: Width,
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    solver: &Solver,
    simulation: &Simulation,
    samples: &[usize],
    cotangent: &[f64],
    pool: &rayon::ThreadPool,
) -> Gradient {
    let model = Model::new(scene, design);
    let machine = machine(width);
    let tape = simulation.tape.as_ref().expect("the simulation kept its tape");
    let len = scene.instants * 3 * scene.sensors.len();
    let sweeps: Vec<Sweep<'_>> = samples
        .iter()
        .enumerate()
        .filter(|(_, i)| simulation.outcomes[**i] == Outcome::Ok)
        .map(|(at, &i)| Sweep {
            tape: &tape.samples[i],
            history: forces.sample(i),
            cotangent: &cotangent[at * len..][..len],
        })
        .collect();
    let blocks: Vec<(ModelCotangent, Counters)> = pool.install(|| {
        sweeps
            .par_chunks(LANES)
            // SAFETY: `width` is what this machine has.
            .map(|sweeps| unsafe { (machine.reverse)(scene, &model, forces, solver, sweeps) })
            .collect()
    });
    let mut total = ModelCotangent::new(&model);
    let mut counters = Counters::default();
    for (cotangent, work) in blocks {
        total.add(&cotangent);
        counters += work;
    }
    let design = total.design(&model, &scene.layout, scene.density);
    Gradient { design, outcomes: samples.iter().map(|&i| simulation.outcomes[i]).collect(), counters }
}
