//! Entry points for each instruction set and precision.

use super::jobs::{Backward, SampleQueue, take};
use super::ligaments::{self, Place, ShapeCotangent, Turn};
use super::model::{Bar, Model, ModelCotangent};
use super::system::{EnergyKernel, GradientKernel, Kernels, ProductKernel, System, Unit};
use super::{
    Forces, IntegrationPlan, Precision, Scene, SimulationCounts, Steps, Wrt, relaxing, splitting, tsit5,
};
use crate::Heartbeat;
#[cfg(target_arch = "x86_64")]
use crate::lanes::{Avx2, Avx512, HalfSingleAvx512, SingleAvx2, SingleAvx512};
use crate::lanes::{Base, SingleBase, Vector};
use crate::simd::Width;

/// Arguments: (scene, model, forces, plan, checkpoints per interval, queue, heartbeat).
pub type Forward = unsafe fn(
    &Scene,
    &Model,
    &Forces,
    &IntegrationPlan,
    usize,
    &SampleQueue<'_, '_>,
    &Heartbeat,
) -> SimulationCounts;
/// Arguments: (scene, model, forces, plan, checkpoints per interval, samples, requested gradient, heartbeat).
pub type Reverse =
    unsafe fn(&Scene, &Model, &Forces, &IntegrationPlan, usize, &[Backward<'_>], Wrt, &Heartbeat) -> Swept;

/// Cotangents of the model, cotangents of the histories (n, K, R+1) if requested, and the work done.
pub type Swept = (ModelCotangent, Vec<f64>, SimulationCounts);

/// Compiled code of one instruction set and precision.
pub struct Machine {
    /// Integrates the samples of a queue.
    pub forward: Forward,
    /// As `forward`, with relaxing ligaments.
    pub relaxing: Forward,
    /// Runs the reverse sweep of several samples.
    pub reverse: Reverse,
    repeat: unsafe fn(&Scene, &Model, usize, bool),
    /// Number of samples integrated together.
    pub lanes: usize,
}

macro_rules! machine {
    ($module:ident, $vector:ty, $tsit5:ident $(, $feature:literal)?) => {
        mod $module {
            use super::*;

            type Bars<'a> = &'a [Bar<<$vector as Vector>::Scalar>];

            $(#[target_feature(enable = $feature)])?
            unsafe fn gradient<const LINEAR: bool, const CONTACT: bool>(
                model: &Model,
                bars: Bars<'_>,
                x: &[Place<$vector>],
                turn: &[Turn<$vector>],
                g: &mut [Unit<$vector>],
                margin: &mut $vector,
            ) {
                ligaments::gradient::<$vector, LINEAR, CONTACT, false>(model, bars, x, turn, g, margin, &mut []);
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn energy<const LINEAR: bool, const CONTACT: bool>(
                model: &Model,
                bars: Bars<'_>,
                x: &[Place<$vector>],
                turn: &[Turn<$vector>],
            ) -> $vector {
                ligaments::energy::<$vector, LINEAR, CONTACT>(model, bars, x, turn)
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn product<const LINEAR: bool, const CONTACT: bool, const GRADIENT: bool, const PARAMETERS: bool>(
                model: &Model,
                bars: Bars<'_>,
                x: &[Place<$vector>],
                w: &[Unit<$vector>],
                turn: &[Turn<$vector>],
                g: &mut [Unit<$vector>],
                h: &mut [Unit<$vector>],
                shape: ShapeCotangent<'_, $vector>,
            ) {
                ligaments::product::<$vector, LINEAR, CONTACT, GRADIENT, PARAMETERS>(model, bars, x, w, turn, g, h, shape);
            }

            /// Selects compiled variants. To limit their number, kernels for parameters always compute ∂U/∂s, and those for linear
            /// strains compute everything.
            fn kernels(scene: &Scene, parameters: bool) -> Kernels<$vector> {
                type Of = (GradientKernel<$vector>, [ProductKernel<$vector>; 2]);
                let energy: EnergyKernel<$vector> = match (scene.linearised, scene.contact.is_some()) {
                    (false, false) => energy::<false, false>,
                    (false, true) => energy::<false, true>,
                    (true, _) => energy::<true, true>,
                };
                let (gradient, [second, alone]): Of = match (scene.linearised, scene.contact.is_some(), parameters) {
                    (false, false, false) => {
                        (gradient::<false, false>, [product::<false, false, true, false>, product::<false, false, false, false>])
                    }
                    (false, false, true) => (gradient::<false, false>, [product::<false, false, true, true>; 2]),
                    (false, true, false) => {
                        (gradient::<false, true>, [product::<false, true, true, false>, product::<false, true, false, false>])
                    }
                    (false, true, true) => (gradient::<false, true>, [product::<false, true, true, true>; 2]),
                    (true, ..) => (gradient::<true, true>, [product::<true, true, true, true>; 2]),
                };
                Kernels { gradient, energy, second, product: alone }
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn forward(
                scene: &Scene,
                model: &Model,
                forces: &Forces,
                plan: &IntegrationPlan,
                parts: usize,
                queue: &SampleQueue<'_, '_>,
                heartbeat: &Heartbeat,
            ) -> SimulationCounts {
                let scheme = plan.method.scheme();
                let damped = scheme.is_none();
                let mut system = System::<$vector>::new(scene, model, kernels(scene, false), damped, false);
                match (scheme, plan.steps) {
                    (None, Steps::Adaptive(tolerance)) => $tsit5::forward(system, forces, tolerance, queue, heartbeat),
                    (Some(scheme), Steps::Equal(steps)) => {
                        let mut counters = SimulationCounts::default();
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
            unsafe fn relaxing(
                scene: &Scene,
                model: &Model,
                forces: &Forces,
                plan: &IntegrationPlan,
                _parts: usize,
                queue: &SampleQueue<'_, '_>,
                heartbeat: &Heartbeat,
            ) -> SimulationCounts {
                let relaxation = scene.relaxation.expect("a scene with relaxing ligaments");
                let system = System::<$vector>::new(scene, model, kernels(scene, false), false, false);
                let steps = plan.steps.count();
                match scene.linearised {
                    false => relaxing::forward::<$vector, false>(system, relaxation, steps, forces, queue, heartbeat),
                    true => relaxing::forward::<$vector, true>(system, relaxation, steps, forces, queue, heartbeat),
                }
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn reverse(
                scene: &Scene,
                model: &Model,
                forces: &Forces,
                plan: &IntegrationPlan,
                parts: usize,
                sweeps: &[Backward<'_>],
                wrt: Wrt,
                heartbeat: &Heartbeat,
            ) -> Swept {
                let (parameters, asked) = (wrt == Wrt::Parameters, wrt == Wrt::Forces);
                let scheme = plan.method.scheme();
                let kernels = kernels(scene, parameters);
                let mut system = System::<$vector>::new(scene, model, kernels, scheme.is_none(), parameters);
                let (histories, counters) = match scheme {
                    None => $tsit5::reverse(&mut system, forces, sweeps, asked, heartbeat),
                    Some(scheme) => {
                        splitting::reverse(&mut system, &scheme, plan.steps.count(), parts, forces, sweeps, asked, heartbeat)
                    }
                };
                (system.take_cotangent(), histories, counters)
            }

            $(#[target_feature(enable = $feature)])?
            unsafe fn repeat(scene: &Scene, model: &Model, times: usize, second: bool) {
                let mut system = System::<$vector>::new(scene, model, kernels(scene, false), true, false);
                let (mut x, mut w) = (system.places(), system.zeros());
                for (i, (x, w)) in x.as_flattened_mut().iter_mut().zip(w.as_flattened_mut()).enumerate() {
                    // Typical rotations; far larger ones would take the slow path of the trigonometry.
                    *x = <$vector as Vector>::Wide::splat(0.01 * (i as f64).sin());
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

            pub const MACHINE: Machine = Machine { forward, relaxing, reverse, repeat, lanes: <$vector as Vector>::LANES };
        }
    };
}

/// Replaces `tsit5` for f32: plans use adaptive steps only in f64, because rounding must not affect step sizes.
mod no_tsit5 {
    use super::*;
    use crate::dynamics::Tolerance;

    pub fn forward<V: Vector>(
        _: System<'_, V>,
        _: &Forces,
        _: Tolerance,
        _: &SampleQueue<'_, '_>,
        _: &Heartbeat,
    ) -> SimulationCounts {
        unreachable!("adaptive steps require f64")
    }

    pub fn reverse<V: Vector>(
        _: &mut System<'_, V>,
        _: &Forces,
        _: &[Backward<'_>],
        _: bool,
        _: &Heartbeat,
    ) -> (Vec<f64>, SimulationCounts) {
        unreachable!("adaptive steps require f64")
    }
}

machine!(baseline, Base, tsit5);
machine!(single_baseline, SingleBase, no_tsit5);
#[cfg(target_arch = "x86_64")]
machine!(avx2, Avx2, tsit5, "avx2,fma");
#[cfg(target_arch = "x86_64")]
machine!(single_avx2, SingleAvx2, no_tsit5, "avx2,fma");
#[cfg(target_arch = "x86_64")]
machine!(avx512, Avx512, tsit5, "avx512f,avx512dq,avx512vl,avx512bw,fma");
#[cfg(target_arch = "x86_64")]
machine!(single_avx512, SingleAvx512, no_tsit5, "avx512f,avx512dq,avx512vl,avx512bw,fma");
#[cfg(target_arch = "x86_64")]
machine!(half_single_avx512, HalfSingleAvx512, no_tsit5, "avx512f,avx512dq,avx512vl,avx512bw,fma");

/// The code for `samples` samples. Few samples use a narrower vector: a half-empty vector costs as much as a full one, and a training
/// step over casts has few samples per cast. Results are identical bit by bit.
///
/// # Panics
/// If the machine does not support `width`.
pub fn machine(width: Width, precision: Precision, samples: usize) -> Machine {
    width.check();
    match (width, precision, samples) {
        #[cfg(target_arch = "x86_64")]
        (Width::Avx512, Precision::Single, few) if few <= half_single_avx512::MACHINE.lanes => {
            half_single_avx512::MACHINE
        }
        #[cfg(target_arch = "x86_64")]
        (Width::Avx512, Precision::Double, _) => avx512::MACHINE,
        #[cfg(target_arch = "x86_64")]
        (Width::Avx512, Precision::Single, _) => single_avx512::MACHINE,
        #[cfg(target_arch = "x86_64")]
        (Width::Avx2, Precision::Double, _) => avx2::MACHINE,
        #[cfg(target_arch = "x86_64")]
        (Width::Avx2, Precision::Single, _) => single_avx2::MACHINE,
        // of other machines' sets `check` lets none pass
        (_, Precision::Double, _) => baseline::MACHINE,
        (_, Precision::Single, _) => single_baseline::MACHINE,
    }
}

/// Evaluates the forces (with `second`, their derivatives along a direction) `times` times on all lanes, for timing. Returns
/// ligaments × lanes × `times`; ligaments between held units are not evaluated.
///
/// # Panics
/// If the machine does not support `width`.
pub fn repeat_kernel(
    (width, precision): (Width, Precision),
    scene: &Scene,
    design: &[f64],
    times: usize,
    second: bool,
) -> u64 {
    let model = Model::new(scene, design).without_fixed_bars();
    let machine = machine(width, precision, usize::MAX);
    // SAFETY: `machine` has checked that this machine has `width`.
    unsafe { (machine.repeat)(scene, &model, times, second) };
    (times * machine.lanes * model.bars.len()) as u64
}
