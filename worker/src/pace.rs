//! Speed of one core: times a small piece of each kind of computation.

use crate::clock::cpu_seconds;
use crate::reference::reference;
use crate::simd::width;
use metasense_numerics::brain::linear::factor;
use metasense_numerics::brain::{Architecture, Data, Shape, Workspace, initial_weights, loss_gradient};
use metasense_numerics::dynamics::{Forces, IntegrationPlan, Integrator, Scene, run};
use metasense_numerics::random::{Purpose, Stream};
use metasense_numerics::{Heartbeat, Pool};
use std::sync::OnceLock;

/// Repetitions per piece; the median counts.
const REPEAT: usize = 3;
/// Piece of dynamics: samples (one per lane), instants, steps per interval, constant force (N).
const SAMPLES: usize = 8;
const INSTANTS: usize = 20;
const STEPS: usize = 7;
const FORCE: f64 = 0.3;
/// Piece of training with the paper's network: samples, instants.
const BATCH: [usize; 2] = [30, 200];
/// Order of the matrix to factorise.
const UNKNOWNS: usize = 400;

/// Operations per second of one core.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Force evaluations of one unit in f64, including the rest of a step.
    pub evaluations: f64,
    /// Multiply-adds of a network's training, three forward passes per iteration.
    pub training: f64,
    /// Multiply-adds of a Cholesky factorisation.
    pub factor: f64,
}

impl Pace {
    /// Speed of this machine with the instruction set of this process, measured at the first call in a few hundredths of a
    /// second.
    pub fn here() -> Self {
        static HERE: OnceLock<Pace> = OnceLock::new();
        *HERE.get_or_init(|| Self { evaluations: evaluations(), training: training(), factor: factors() })
    }
}

/// CPU time of a piece (s).
fn seconds(mut work: impl FnMut()) -> f64 {
    let mut times = [0.0; REPEAT].map(|_: f64| {
        let begin = cpu_seconds();
        work();
        cpu_seconds() - begin
    });
    times.sort_by(f64::total_cmp);
    times[REPEAT / 2].max(1e-9)
}

fn pool() -> Pool {
    Pool::with(1, width(), Heartbeat::default()).expect("a thread")
}

fn evaluations() -> f64 {
    let whole = reference();
    let duration = whole.duration * INSTANTS as f64 / whole.instants as f64;
    let scene = Scene { duration, instants: INSTANTS, ..whole };
    let panels = scene.panels.len();
    let values = vec![FORCE; SAMPLES * panels * (INSTANTS + 1)];
    let forces = Forces { samples: SAMPLES, panels, instants: INSTANTS, values, strikes: Vec::new() };
    let design = scene.layout.initial_design(25f64.to_radians());
    let (plan, pool) = (IntegrationPlan::equal(Integrator::Nystrom6, STEPS), pool());
    let mut evaluations = 0;
    let seconds = seconds(|| {
        evaluations = run(&scene, &design, &forces, &plan, false, &pool).counters.force_evaluations;
    });
    evaluations as f64 * scene.layout.units() as f64 / seconds
}

fn training() -> f64 {
    let [samples, instants] = BATCH;
    let architecture = Architecture::paper(64);
    let shape = Shape { instants, inputs: 3, outputs: 2, architecture };
    let mut stream = Stream::new(Purpose::Batch, 1, [0, 0]);
    let mut draw = |n: usize| (0..n).map(|_| stream.normal() as f32).collect::<Vec<f32>>();
    let data = Data::new(shape, &draw(samples * instants * 3), &draw(samples * instants * 2));
    let weights: Vec<f32> = initial_weights(shape, 1, 0).into_iter().map(|w| w as f32).collect();
    let mut gradient = weights.clone();
    let (mut ws, pool) = (Workspace::new(shape, width()), pool());
    let seconds = seconds(|| {
        loss_gradient(&weights, data.all(), &mut gradient, &mut ws, &pool);
    });
    (3 * samples * instants * weights.len()) as f64 / seconds
}

fn factors() -> f64 {
    let n = UNKNOWNS;
    // Of a diagonally dominant matrix.
    let all: Vec<f64> = (0..n * n).map(|i| if i % (n + 1) == 0 { n as f64 } else { 0.5 }).collect();
    let (mut matrix, pool) = (all.clone(), pool());
    let seconds = seconds(|| {
        matrix.copy_from_slice(&all);
        factor(&pool, &mut matrix, n).expect("positive definite");
    });
    (n * n * n) as f64 / 6.0 / seconds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_core_does_some_work_a_second() {
        let Pace { evaluations, training, factor } = Pace::here();
        assert!([evaluations, training, factor].iter().all(|rate| (1e6..1e13).contains(rate)));
        assert_eq!(Pace::here(), Pace { evaluations, training, factor }, "measured once");
    }
}
