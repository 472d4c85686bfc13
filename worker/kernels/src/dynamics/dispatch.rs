//! Entry points of each instruction set, and the division of samples among lanes and threads.

use super::ligaments::{Shape, Turn, gradient, product};
use super::model::{Bar, Model, ModelCotangent};
use super::splitting;
use super::system::{First, Kernels, Second, System, Unit};
use super::tsit5::{self, Queue, Slot, Sweep, take};
use super::{
    Counters, Forces, Gradient, Method, Outcome, Plan, Precision, SampleTape, Scene, Simulation, Steps, Tape,
    Wrt,
};
use crate::Heartbeat;
use crate::lanes::{Avx2, Avx512, SingleAvx2, SingleAvx512, SingleSse2, Sse2, Vector};
use crate::simd::Width;
use rayon::prelude::*;
use std::sync::Mutex;

type Forward = unsafe fn(&Scene, &Model, &Forces, &Plan, usize, &Queue<'_, '_>, &Heartbeat) -> Counters;
type Reverse = unsafe fn(&Scene, &Model, &Forces, &Plan, usize, &[Sweep<'_>], Wrt, &Heartbeat) -> Swept;

/// The cotangents of a block's model and, where asked for, of each of its histories, (n, K, R+1), and the work done.
type Swept = (ModelCotangent, Vec<f64>, Counters);

/// Vectors of samples that a reverse sweep of Tsit5 has at most, to make up blocks from.
const BLOCKS: usize = 5;

/// The code of one instruction set and precision.
struct Machine {
    forward: Forward,
    reverse: Reverse,
    repeat: unsafe fn(&Scene, &Model, usize, bool),
    lanes: usize,
}

macro_rules! machine {
    ($module:ident, $vector:ty $(, $feature:literal)?) => {
        mod $module {
            use super::*;

            type Bars<'a> = &'a [Bar<<$vector as Vector>::Scalar>];

            $(#[target_feature(enable = $feature)])?
            unsafe fn first<const LINEAR: bool, const CONTACT: bool>(
                model: &Model,
                bars: Bars<'_>,
                x: &[Unit<$vector>],
                turn: &[Turn<$vector>],
                g: &mut [Unit<$vector>],
                margin: &mut $vector,
            ) {
                gradient::<$vector, LINEAR, CONTACT, false>(model, bars, x, turn, g, margin, &mut []);
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn second<const LINEAR: bool, const CONTACT: bool, const GRADIENT: bool, const PARAMETERS: bool>(
                model: &Model,
                bars: Bars<'_>,
                x: &[Unit<$vector>],
                w: &[Unit<$vector>],
                turn: &[Turn<$vector>],
                g: &mut [Unit<$vector>],
                h: &mut [Unit<$vector>],
                shape: Shape<'_, $vector>,
            ) {
                product::<$vector, LINEAR, CONTACT, GRADIENT, PARAMETERS>(model, bars, x, w, turn, g, h, shape);
            }

            /// Of what is compiled: `product` adds ∂U/∂s, too, where cotangents of parameters are asked for, and linear
            /// measures go with all that a kernel can do.
            fn kernels(scene: &Scene, parameters: bool) -> Kernels<$vector> {
                type Of = (First<$vector>, [Second<$vector>; 2]);
                let (gradient, [second, product]): Of = match (scene.linearised, scene.contact.is_some(), parameters) {
                    (false, false, false) => {
                        (first::<false, false>, [second::<false, false, true, false>, second::<false, false, false, false>])
                    }
                    (false, false, true) => (first::<false, false>, [second::<false, false, true, true>; 2]),
                    (false, true, false) => {
                        (first::<false, true>, [second::<false, true, true, false>, second::<false, true, false, false>])
                    }
                    (false, true, true) => (first::<false, true>, [second::<false, true, true, true>; 2]),
                    (true, ..) => (first::<true, true>, [second::<true, true, true, true>; 2]),
                };
                Kernels { gradient, second, product }
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn forward(
                scene: &Scene,
                model: &Model,
                forces: &Forces,
                plan: &Plan,
                parts: usize,
                queue: &Queue<'_, '_>,
                heartbeat: &Heartbeat,
            ) -> Counters {
                let scheme = plan.method.scheme();
                let damped = scheme.is_none();
                let mut system = System::<$vector>::new(scene, model, kernels(scene, false), damped, false);
                match (scheme, plan.steps) {
                    (None, Steps::Adaptive(tolerance)) if !<$vector>::SINGLE => tsit5::forward(system, forces, tolerance, queue, heartbeat),
                    (Some(scheme), Steps::Equal(steps)) => {
                        let mut counters = Counters::default();
                        loop {
                            let slots = take(queue, <$vector>::LANES);
                            if slots.is_empty() {
                                return counters;
                            }
                            counters += splitting::forward(&mut system, &scheme, steps, parts, forces, slots, heartbeat);
                        }
                    }
                    _ => unreachable!("{plan:?}"),
                }
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn reverse(
                scene: &Scene,
                model: &Model,
                forces: &Forces,
                plan: &Plan,
                parts: usize,
                sweeps: &[Sweep<'_>],
                wrt: Wrt,
                heartbeat: &Heartbeat,
            ) -> Swept {
                let (parameters, asked) = (wrt == Wrt::Parameters, wrt == Wrt::Forces);
                let scheme = plan.method.scheme();
                let kernels = kernels(scene, parameters);
                let mut system = System::<$vector>::new(scene, model, kernels, scheme.is_none(), parameters);
                let (histories, counters) = match scheme {
                    None if <$vector>::SINGLE => unreachable!("{plan:?}"),
                    None => tsit5::reverse(&mut system, forces, sweeps, asked, heartbeat),
                    Some(scheme) => {
                        splitting::reverse(&mut system, &scheme, plan.steps.count(), parts, forces, sweeps, asked, heartbeat)
                    }
                };
                (system.take_cotangent(), histories, counters)
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn repeat(scene: &Scene, model: &Model, times: usize, second: bool) {
                let mut system = System::<$vector>::new(scene, model, kernels(scene, false), true, false);
                let (mut x, mut w) = (system.zeros(), system.zeros());
                for (i, (x, w)) in x.as_flattened_mut().iter_mut().zip(w.as_flattened_mut()).enumerate() {
                    // Turns as of bodies at work: for far larger ones, trigonometry goes lane by lane.
                    *x = <$vector>::splat(0.01 * (i as f64).sin());
                    *w = <$vector>::splat((i as f64).cos());
                }
                let mut out = system.zeros();
                for _ in 0..times {
                    match second {
                        true => system.product(std::hint::black_box(&x), &w, &mut out),
                        false => system.gradient(std::hint::black_box(&x), &mut out),
                    }
                }
                std::hint::black_box(&out);
            }

            pub const MACHINE: Machine = Machine { forward, reverse, repeat, lanes: <$vector as Vector>::LANES };
        }
    };
}

machine!(baseline, Sse2);
machine!(single_baseline, SingleSse2);
machine!(avx2, Avx2, "avx2,fma");
machine!(single_avx2, SingleAvx2, "avx2,fma");
machine!(avx512, Avx512, "avx512f,avx512dq,avx512vl,avx512bw,fma");
machine!(single_avx512, SingleAvx512, "avx512f,avx512dq,avx512vl,avx512bw,fma");

/// # Panics
/// If the machine lacks `width`.
fn machine(width: Width, precision: Precision) -> Machine {
    width.check();
    match (width, precision) {
        (Width::Avx512, Precision::Double) => avx512::MACHINE,
        (Width::Avx512, Precision::Single) => single_avx512::MACHINE,
        (Width::Avx2, Precision::Double) => avx2::MACHINE,
        (Width::Avx2, Precision::Single) => single_avx2::MACHINE,
        (Width::Baseline, Precision::Double) => baseline::MACHINE,
        (Width::Baseline, Precision::Single) => single_baseline::MACHINE,
    }
}

/// `super::repeat_kernel` with the code of `width`, which the machine must have.
pub fn repeat_kernel(
    (width, precision): (Width, Precision),
    scene: &Scene,
    design: &[f64],
    times: usize,
    second: bool,
) -> u64 {
    let model = Model::new(scene, design).moving();
    let machine = machine(width, precision);
    // SAFETY: `machine` has checked that this machine has `width`.
    unsafe { (machine.repeat)(scene, &model, times, second) };
    (times * machine.lanes * model.bars.len()) as u64
}

/// `super::run` with the code of the pool's instruction set.
pub fn simulate(
    scene: &Scene,
    design: &[f64],
    forces: &Forces,
    plan: &Plan,
    keep_tape: bool,
    pool: &crate::Pool,
) -> Simulation {
    let model = Model::new(scene, design).moving();
    let steps = match plan.steps {
        Steps::Equal(steps) => Steps::Equal(steps.next_multiple_of(forces.kinks(scene))),
        adaptive @ Steps::Adaptive(_) => adaptive,
    };
    let plan = &Plan { steps, ..plan.clone() };
    let machine = machine(pool.width(), plan.precision);
    let n = forces.samples;
    let len = scene.instants * 3 * scene.sensors.len();
    let mut signals = vec![0.0; n * len];
    let mut outcomes = vec![Outcome::Ok; n];
    let parts = match plan.steps {
        Steps::Equal(steps) => splitting::segments(scene, &model, steps),
        Steps::Adaptive(_) => 1,
    };
    let mut tapes: Vec<SampleTape> = Vec::new();
    if keep_tape {
        let states = scene.instants * parts * 6 * model.free.len();
        tapes.resize_with(n, || SampleTape {
            states: vec![0.0; states],
            refined: 1,
            ..SampleTape::default()
        });
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
    let adaptive = matches!(plan.steps, Steps::Adaptive(_));
    if !adaptive {
        // Lanes that begin together wait together.
        slots.sort_by_key(|s| forces.onset(scene, forces.sample(s.index)));
    }
    let mut total = integrate(&machine, scene, &model, forces, plan, parts, &mut slots, pool);
    // Equal steps that one sample's motion or contact is too quick for are halved for it alone, and again.
    for refined in [2, 4, 8] {
        let mut failed: Vec<Slot<'_>> = Vec::new();
        for slot in &mut slots {
            if !adaptive && *slot.outcome != Outcome::Ok {
                *slot.outcome = Outcome::Ok;
                if let Some(tape) = &mut slot.tape {
                    tape.refined = refined;
                }
                let tape = slot.tape.as_deref_mut();
                failed.push(Slot { signals: slot.signals, outcome: slot.outcome, tape, index: slot.index });
            }
        }
        if failed.is_empty() {
            break;
        }
        let finer = Plan { steps: plan.steps.times(refined), ..plan.clone() };
        total.rejected += failed.len() as u64;
        total += integrate(&machine, scene, &model, forces, &finer, parts, &mut failed, pool);
    }
    for (i, outcome) in outcomes.iter().enumerate() {
        if *outcome != Outcome::Ok {
            // What a failed sample read before it failed would teach a brain nothing.
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
    plan: &Plan,
    parts: usize,
    slots: &mut [Slot<'_>],
    pool: &crate::Pool,
) -> Counters {
    let tasks = pool.threads().min(slots.len().div_ceil(machine.lanes));
    let queue = Mutex::new(slots);
    let counters: Vec<Counters> = pool.install(|| {
        (0..tasks)
            .into_par_iter()
            // SAFETY: `machine` is of a width that this machine has.
            .map(|_| unsafe {
                (machine.forward)(scene, model, forces, plan, parts, &queue, pool.heartbeat())
            })
            .collect()
    });
    let mut total = Counters::default();
    counters.into_iter().for_each(|c| total += c);
    total
}

/// `Simulation::vjp` with the code that made the simulation.
pub fn vjp(
    simulation: &Simulation,
    tape: &Tape,
    cotangent: &[f64],
    wrt: Wrt,
    pool: &crate::Pool,
) -> Gradient {
    let Tape { scene, design, forces, parts, samples } = tape;
    let model = Model::new(scene, design).moving();
    let plan = &simulation.plan;
    let machine = machine(simulation.width, plan.precision);
    let len = scene.instants * 3 * scene.sensors.len();
    let sweeps: Vec<Sweep<'_>> = (0..forces.samples)
        .filter(|i| simulation.outcomes[*i] == Outcome::Ok)
        .map(|at| Sweep {
            at,
            tape: &samples[at],
            history: forces.sample(at),
            cotangent: &cotangent[at * len..][..len],
        })
        .collect();
    // Lanes of one block take the same steps.
    let mut blocks: Vec<(Plan, Vec<Sweep<'_>>)> = Vec::new();
    for refined in [1, 2, 4, 8] {
        let finer = Plan { steps: plan.steps.times(refined), ..plan.clone() };
        let mut group: Vec<&Sweep<'_>> = sweeps.iter().filter(|s| s.tape.refined == refined).collect();
        group.sort_by_key(|s| match plan.method {
            Method::Tsit5 => s.tape.counts.iter().sum::<u32>() as usize,
            _ => forces.onset(scene, s.history),
        });
        let lanes: Vec<&[&Sweep<'_>]> = group.chunks(machine.lanes).collect();
        // Tsit5 makes up its own blocks, of samples that take about as many steps; but threads want work, too, of as
        // much each: every task gets of all lengths.
        let tasks = match plan.method {
            Method::Tsit5 => lanes.len().div_ceil(BLOCKS).max(lanes.len().min(4)),
            _ => lanes.len(),
        };
        let dealt: Vec<&Sweep<'_>> =
            (0..tasks).flat_map(|t| lanes[t..].iter().step_by(tasks).copied().flatten().copied()).collect();
        let end = |t: usize| (lanes.len() * t / tasks * machine.lanes).min(dealt.len());
        blocks.extend((0..tasks).map(|t| {
            (finer.clone(), dealt[end(t)..end(t + 1)].iter().map(|s| **s).collect::<Vec<Sweep<'_>>>())
        }));
    }
    let swept: Vec<Swept> = pool.install(|| {
        blocks
            .par_iter()
            // SAFETY: `machine` has checked that this machine has the simulation's width.
            .map(|(plan, sweeps)| unsafe {
                (machine.reverse)(scene, &model, forces, plan, *parts, sweeps, wrt, pool.heartbeat())
            })
            .collect()
    });
    let mut total = ModelCotangent::new(&model);
    let mut counters = Counters::default();
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
    let parameters = (wrt == Wrt::Parameters).then(|| total.parameters(&model, scene));
    let design = total.design(&model, &scene.layout, scene.density);
    Gradient { design, parameters, forces: pushed, counters }
}
