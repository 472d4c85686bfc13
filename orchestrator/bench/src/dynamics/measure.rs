//! Measures the integrators: error of the signals and of dα against milliseconds per sample, and the race over 300 samples for
//! comparison with another program.
//!
//! The reference solution of a scene is `nystrom6` with steps so short that its error is far below all measured ones. The
//! tightest run of Tsit5, a different method, is a point of the diagram; its error bounds that of the reference.

use metasense::look::row;
use metasense::say;
use metasense_lab::verify::relative;
use metasense_numerics::Pool;
use metasense_numerics::body::Layout;
use metasense_numerics::dynamics::{
    Accuracy, EdgeContact, Forces, IntegrationPlan, Integrator, IntegratorSettings, Outcome, Panel,
    Precision, Scene, Simulation, Tolerance, Wrt, highest_frequency, repeat_kernel, run, signal_error, tune,
};
use metasense_worker::clock::cpu_seconds;
use metasense_worker::reference::{bells, reference};
use metasense_worker::simd::width;
use serde_json::Value;
use std::time::Instant;

use crate::{pool, widths};

/// A scene of the diagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum BenchScene {
    /// K = 2, M = 1 on 6 × 6 units
    Reference,
    /// 8 × 4 units, K = 3, M = 2, contact from 30° on, which these forces reach
    Contact,
    /// The reference scene with k_stretch × 100
    Stretch100,
    /// The reference scene with k_stretch × 10 000
    Stretch10000,
}

impl BenchScene {
    fn name(self) -> &'static str {
        match self {
            Self::Reference => "reference",
            Self::Contact => "contact",
            Self::Stretch100 => "stretch100",
            Self::Stretch10000 => "stretch10000",
        }
    }

    fn scene(self) -> Scene {
        let mut scene = reference();
        match self {
            Self::Reference => {}
            Self::Contact => {
                scene.layout = Layout::planar(8, 4, 15.0, 2.25);
                scene.clamped = scene.layout.bottom();
                scene.panels = [25, 28, 30].map(|unit| Panel::central(unit, [0.0, -1.0])).to_vec();
                scene.sensors = vec![20, 11];
                let [min_angle, cutoff_angle] = [1.0, 30.0].map(f64::to_radians);
                scene.contact = Some(EdgeContact { stiffness: 1.0, min_angle, cutoff_angle });
            }
            Self::Stretch100 => scene.stiffness.stretch *= 1e2,
            Self::Stretch10000 => scene.stiffness.stretch *= 1e4,
        }
        scene
    }

    /// Tolerances of Tsit5: stiffer modes need smaller ones; with larger ones the results are noise.
    fn tolerances(self) -> &'static [f64] {
        match self {
            Self::Reference | Self::Contact => &[1e-4, 1e-5, 1e-6, 1e-7, 1e-8],
            Self::Stretch100 => &[1e-6, 1e-7, 1e-8, 1e-9],
            Self::Stretch10000 => &[1e-8, 1e-9, 1e-10],
        }
    }
}

/// Phase of the highest mode per force evaluation of the reference solution (rad); smaller for contact, which is not smooth.
fn truth(kind: BenchScene) -> f64 {
    if kind == BenchScene::Contact { 0.03 } else { 0.12 }
}

/// The same for the points of a method with equal steps.
///
/// On the stiffest scene long steps suffice: leapfrog's error stays that of the oscillations that it does not resolve.
fn ladder(kind: BenchScene, method: Integrator) -> &'static [f64] {
    match (method, kind) {
        (Integrator::Leapfrog, BenchScene::Stretch10000) => &[1.4, 0.7],
        (Integrator::Leapfrog, _) => &[1.4, 0.7, 0.35, 0.18, 0.09],
        (Integrator::Nystrom4, _) => &[0.6, 0.42, 0.3, 0.21, 0.15],
        _ => &[0.5, 0.4, 0.3, 0.22],
    }
}

/// Columns of a point of the diagram: one run with its gradient. Errors are empty if samples failed.
pub const POINT: &str = "scene method setting auto force_evaluations forward_ms gradient_ms signals_error \
    gradient_error failed";

/// Wall-clock and CPU seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Time {
    wall: f64,
    /// Of all threads of this process.
    cpu: f64,
}

fn timed<R>(work: impl FnOnce() -> R) -> (R, Time) {
    let (wall, cpu) = (Instant::now(), cpu_seconds());
    let result = work();
    (result, Time { wall: wall.elapsed().as_secs_f64(), cpu: cpu_seconds() - cpu })
}

/// A scene with its design, forces and the cotangent of the signals.
struct Subject {
    scene: Scene,
    design: Vec<f64>,
    forces: Forces,
    cotangent: Vec<f64>,
}

impl Subject {
    fn new(mut scene: Scene, samples: usize, instants: usize) -> Self {
        let part = instants as f64 / scene.instants as f64;
        scene.instants = instants;
        let forces = bells(&scene, samples as u64);
        scene.duration *= part; // the same forces, faster by this factor
        let design = scene.layout.initial_design(25f64.to_radians());
        Self { scene, design, forces, cotangent: Vec::new() }
    }

    /// Sets the cotangent, so that dα is the gradient of half the mean square of these signals, each channel divided by its
    /// RMS.
    fn differentiate(&mut self, signals: &[f64]) {
        let channels = 3 * self.scene.sensors.len();
        let mut square = vec![0.0; channels];
        for reading in signals.chunks_exact(channels) {
            square.iter_mut().zip(reading).for_each(|(sum, x)| *sum += x * x);
        }
        let scale = |k: usize| if square[k] > 0.0 { 1.0 / square[k] } else { 0.0 };
        self.cotangent = signals.iter().enumerate().map(|(i, x)| x * scale(i % channels)).collect();
    }

    fn simulate(&self, plan: &IntegrationPlan, pool: &Pool) -> (Simulation, Time) {
        timed(|| run(&self.scene, &self.design, &self.forces, plan, true, pool))
    }

    fn gradient(&self, simulation: &Simulation, pool: &Pool) -> (Vec<f64>, Time) {
        let (gradient, time) = timed(|| simulation.vjp(&self.cotangent, Wrt::Design, pool));
        (gradient.design, time)
    }

    /// Steps per interval for one force evaluation per `radians` of the highest mode.
    fn steps(&self, method: Integrator, radians: f64) -> usize {
        let interval = self.scene.duration / self.scene.instants as f64;
        let stages = method.stages().expect("equal steps") as f64;
        (highest_frequency(&self.scene, &self.design) * interval / (radians * stages)).ceil() as usize
    }

    /// A plan in f64 with one force evaluation per `radians` of the highest mode.
    fn plan(&self, method: Integrator, radians: f64) -> IntegrationPlan {
        IntegrationPlan::equal(method, self.steps(method, radians))
    }
}

/// Measures the points of a scene on one thread. `instants`: 200 are one second.
pub fn work_precision(kind: BenchScene, samples: usize, instants: usize) -> Vec<Vec<Value>> {
    let pool = pool(1, width());
    let mut subject = Subject::new(kind.scene(), samples, instants);
    let plan = subject.plan(Integrator::Nystrom6, truth(kind));
    let simulation = subject.simulate(&plan, &pool).0;
    subject.differentiate(&simulation.signals);
    let truth = subject.gradient(&simulation, &pool).0;
    let mut points = Vec::new();
    let mut measure = |plan: &IntegrationPlan, setting: String, auto: bool| {
        let (run, forward) = subject.simulate(plan, &pool);
        let (gradient, reverse) = subject.gradient(&run, &pool);
        let failed = run.outcomes.iter().filter(|o| **o != Outcome::Ok).count();
        let channels = 3 * subject.scene.sensors.len();
        let well = failed == 0;
        let n = samples as f64;
        let method =
            if plan.precision == Precision::Single && !auto { "nystrom4_f32" } else { plan.method.name() };
        let [forward, reverse] = [forward, reverse].map(|time| 1e3 * time.cpu / n);
        say!("{}: {method} {setting}, {forward:.2} ms per sample", kind.name());
        points.push(row![
            kind.name(),
            method,
            setting,
            auto,
            run.counters.force_evaluations as f64 / n,
            forward,
            forward + reverse,
            well.then(|| signal_error(&run.signals, &simulation.signals, channels)),
            well.then(|| relative(&gradient, &truth)),
            failed,
        ]);
    };
    for &tolerance in kind.tolerances() {
        measure(
            &IntegrationPlan::tsit5(Tolerance::both(tolerance)),
            format!("tolerance {tolerance:.0e}"),
            false,
        );
    }
    for method in [Integrator::Leapfrog, Integrator::Nystrom4, Integrator::Nystrom6] {
        for &at in ladder(kind, method) {
            let plan = subject.plan(method, at);
            measure(&plan, format!("{} steps", plan.steps.count()), false);
        }
    }
    for &at in ladder(kind, Integrator::Nystrom4) {
        let plan = IntegrationPlan { precision: Precision::Single, ..subject.plan(Integrator::Nystrom4, at) };
        measure(&plan, format!("{} steps in f32", plan.steps.count()), false);
    }
    for error in [3e-2, 1e-2, 1e-3, 1e-4] {
        let solver = IntegratorSettings::new(Integrator::Auto, Accuracy(error));
        let plan = tune(&subject.scene, &subject.design, &subject.forces, &solver, &pool).plan;
        let precision = if plan.precision == Precision::Single { " in f32" } else { "" };
        let setting = format!("auto {error:.0e}: {} steps{precision}", plan.steps.count());
        measure(&plan, setting, true);
    }
    points
}

/// Columns of the race: forward alone, and with gradient. Cycles are per ligament and lane: of a force evaluation with the rest
/// of its step, then of the kernels alone, without and with derivatives.
pub const LAP: &str = "solver simd threads samples forward_s forward_cpu_s gradient_s gradient_cpu_s \
    cycles_per_ligament_and_lane kernel_cycles dual_kernel_cycles";

/// Evaluations per timing of the kernels: some 10 ms.
const KERNELS: usize = 10_000;

/// Times Tsit5 at 1e-6 of its own error norm, as the other program runs, the default and the default of coarse steps, on one
/// thread and on `threads`; the last two also with narrower instruction sets on one thread. The fastest of `repeat` runs
/// counts.
pub fn race(samples: usize, instants: usize, threads: usize, repeat: usize) -> Vec<Vec<Value>> {
    let mut subject = Subject::new(reference(), samples, instants);
    let mut laps = Vec::new();
    for (method, asked) in [(Integrator::Tsit5, 1e-6), (Integrator::Auto, 1e-3), (Integrator::Auto, 3e-2)] {
        // Tuned outside the timing, because a trial tunes once before hundreds of simulations.
        let plan = match method {
            Integrator::Tsit5 => IntegrationPlan::tsit5(Tolerance::both(asked)),
            _ => {
                let solver = IntegratorSettings::new(method, Accuracy(asked));
                tune(&subject.scene, &subject.design, &subject.forces, &solver, &pool(1, width())).plan
            }
        };
        let mut rows = vec![(1, width())];
        if threads > 1 {
            rows.push((threads, width()));
        }
        if method == Integrator::Auto {
            rows.extend(widths().skip(1).map(|width| (1, width)));
        }
        for (threads, width) in rows {
            let pool = pool(threads, width);
            let mut least = [f64::INFINITY; 4];
            let (mut cycles, mut kernels) = (f64::INFINITY, [f64::INFINITY; 2]);
            for _ in 0..repeat.max(1) {
                let frequency = clock_frequency();
                let (run, there) = subject.simulate(&plan, &pool);
                if subject.cotangent.is_empty() {
                    subject.differentiate(&run.signals);
                }
                let back = subject.gradient(&run, &pool).1;
                let work =
                    (run.counters.force_evaluations * subject.scene.layout.ligaments.len() as u64) as f64;
                cycles = f64::min(cycles, frequency * there.cpu / work);
                for (second, cycles) in [false, true].into_iter().zip(&mut kernels) {
                    let (count, time) = timed(|| {
                        repeat_kernel(
                            (width, plan.precision),
                            &subject.scene,
                            &subject.design,
                            KERNELS,
                            second,
                        )
                    });
                    *cycles = f64::min(*cycles, frequency * time.cpu / count as f64);
                }
                let times = [there.wall, there.cpu, there.wall + back.wall, there.cpu + back.cpu];
                least = std::array::from_fn(|i| f64::min(least[i], times[i]));
            }
            let solver = format!("{} {asked:.0e}", method.name());
            let [plain, dual] = kernels;
            laps.push(
                row![solver, width.name(), threads, samples; least.into_iter().chain([cycles, plain, dual])],
            );
        }
    }
    laps
}

/// Cycles per second of this thread, from dependent multiplications, which take three cycles each on all x86-64 processors with
/// AVX2.
fn clock_frequency() -> f64 {
    const ROUNDS: u32 = 1_000_000;
    let (x, time) = timed(|| {
        let (mut x, mut left) = (std::hint::black_box(3u64), ROUNDS);
        // eight multiplications per round hide the cost of the loop
        while left > 0 {
            x = x.wrapping_mul(x).wrapping_mul(x).wrapping_mul(x).wrapping_mul(x);
            x = x.wrapping_mul(x).wrapping_mul(x).wrapping_mul(x).wrapping_mul(x);
            left -= 1;
        }
        x
    });
    std::hint::black_box(x);
    3.0 * f64::from(8 * ROUNDS) / time.cpu
}
