//! Clocks around the brain's kernels and the integrators: numerics itself has none.

pub mod dynamics;

use metasense_numerics::brain::linear::{Fit, Lags, Moments, Order, Sizes};
use metasense_numerics::brain::{
    Adam, Architecture, Curvature, Data, Matrix, Real, Shape, Workspace, initial_weights, loss, loss_gradient,
};
use metasense_numerics::random::{Purpose, Stream};
use metasense_numerics::simd::Width;
use metasense_schemas::spec::{Brain, Preset};
use std::time::Instant;

/// What is measured.
#[derive(Debug, Clone, Copy)]
pub struct BrainBench {
    /// N.
    pub samples: usize,
    /// T.
    pub instants: usize,
    /// M.
    pub sensors: usize,
    /// K.
    pub panels: usize,
    /// Repetitions, of which the quickest counts.
    pub repeat: usize,
    /// Threads.
    pub threads: usize,
}

/// Milliseconds of one full batch, least of the repetitions, and what they mean.
#[derive(Debug, Clone, Copy)]
pub struct BrainTimes {
    /// `paper` or `long`, as `brain.preset`.
    pub network: &'static str,
    /// `f32` or `f64`.
    pub precision: &'static str,
    /// Instruction set.
    pub simd: &'static str,
    /// Threads.
    pub threads: usize,
    /// Loss alone.
    pub forward: f64,
    /// Loss, gradient and Adam step.
    pub iteration: f64,
    /// Hessian-vector product.
    pub hessian: f64,
    /// Gauss–Newton product.
    pub gauss_newton: f64,
    /// Operations of an iteration, direct convolutions counted, in 1e9.
    pub gflop: f64,
    /// Sustained multiply-adds on registers, on as many threads, in 1e9 operations a second.
    pub peak: f64,
}

impl BrainTimes {
    /// Operations a second of an iteration as a share of the peak; Winograd's saving can lift it above 1.
    #[must_use]
    pub fn share_of_peak(&self) -> f64 {
        self.gflop / (self.iteration * 1e-3) / self.peak
    }
}

/// Measures, peak and kernels by turns, so that all meet the same machine.
#[must_use]
pub fn brain<F: Real>(bench: BrainBench, width: Width, preset: Preset) -> BrainTimes {
    let BrainBench { samples, instants, sensors, panels, repeat, threads } = bench;
    let network = Brain { preset: Some(preset), ..Brain::default() }.network();
    let architecture = Architecture::new(network.width, &network.kernels, &network.dilations, network.causal);
    let shape = Shape { instants, inputs: 3 * sensors, outputs: panels, architecture };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let mut stream = Stream::new(Purpose::Batch, 1, [0, 0]);
    let mut draw = |n: usize| (0..n).map(|_| F::from_f64(stream.normal())).collect::<Vec<F>>();
    let data = Data::new(shape, &draw(samples * instants * shape.inputs), &draw(samples * instants * panels));
    let mut weights: Vec<F> = initial_weights(shape, 1, 0).into_iter().map(F::from_f64).collect();
    let direction = weights.clone();
    let (mut gradient, mut adam) = (weights.clone(), Adam::new(weights.len()));
    let (ws, kernels) = (&mut Workspace::with_width(shape, width), F::kernels(width));
    let layers: usize = (shape.layers()..2 * shape.layers()).map(|block| shape.range(block).len()).sum();

    let timed = |work: &mut dyn FnMut()| {
        let begin = Instant::now();
        work();
        begin.elapsed().as_secs_f64()
    };
    let mut least = [f64::INFINITY; 4];
    let mut peak = 0.0f64;
    for _ in 0..repeat.max(1) {
        let mut work = 0;
        let seconds = timed(&mut || work = pool.broadcast(|_| kernels.burst(300_000)).iter().sum());
        peak = peak.max(work as f64 / seconds);
        // A step of length 0 costs the same and leaves the weights for the next round.
        let times = [
            timed(&mut || {
                loss(&weights, data.all(), ws, &pool);
            }),
            timed(&mut || {
                loss_gradient(&weights, data.all(), &mut gradient, ws, &pool);
                adam.step(&mut weights, &gradient, 0.0);
            }),
        ];
        let curvature = Curvature::new(&weights, data.all(), ws, &pool);
        let mut product =
            |matrix| timed(&mut || curvature.product(matrix, &direction, &mut gradient, ws, &pool));
        let products = [product(Matrix::Hessian), product(Matrix::GaussNewton)];
        for (least, time) in least.iter_mut().zip(times.into_iter().chain(products)) {
            *least = least.min(time * 1e3);
        }
    }
    BrainTimes {
        network: match preset {
            Preset::Paper => "paper",
            Preset::Long => "long",
        },
        precision: if size_of::<F>() == 4 { "f32" } else { "f64" },
        simd: width.name(),
        threads,
        forward: least[0],
        iteration: least[1],
        hessian: least[2],
        gauss_newton: least[3],
        gflop: (6 * samples * instants * layers) as f64 * 1e-9,
        peak: peak * 1e-9,
    }
}

/// The instruction sets up to the process's own, that first.
pub(crate) fn widths() -> impl Iterator<Item = Width> {
    Width::ALL.into_iter().rev().filter(|width| *width <= Width::chosen())
}

/// The same in both precisions, on one thread and on `bench.threads`, and with narrower instruction sets on one; the long
/// network in f32, on one thread of each.
#[must_use]
pub fn brain_rows(bench: BrainBench) -> Vec<BrainTimes> {
    let mut rows = Vec::new();
    for width in widths() {
        let most = if rows.is_empty() { bench.threads } else { 1 };
        for threads in if most > 1 { vec![1, most] } else { vec![1] } {
            rows.push(brain::<f32>(BrainBench { threads, ..bench }, width, Preset::Paper));
            rows.push(brain::<f64>(BrainBench { threads, ..bench }, width, Preset::Paper));
        }
    }
    for width in widths() {
        rows.push(brain::<f32>(BrainBench { threads: 1, ..bench }, width, Preset::Long));
    }
    rows
}

/// Sizes of a linear brain to be solved for.
#[derive(Debug, Clone, Copy)]
pub struct LinearBench {
    /// N.
    pub samples: usize,
    /// T.
    pub instants: usize,
    /// M.
    pub sensors: usize,
    /// K.
    pub panels: usize,
    /// Reach each way (instants).
    pub memory: usize,
}

/// What it took.
#[derive(Debug, Clone, Copy)]
pub struct LinearTimes {
    /// D.
    pub unknowns: usize,
    /// Of the moments, of normal matrix, factor and weights, of the answers to all samples, of their pull-back (ms).
    pub milliseconds: [f64; 4],
    /// Operations a second of a factor, D³/3 of them, were it all that a solve does (10⁹).
    pub gflops: f64,
}

/// Solves once for white noise, on one thread.
///
/// # Panics
/// If the memory is as long as the sample.
#[must_use]
pub fn linear_rows(bench: LinearBench) -> LinearTimes {
    let LinearBench { samples, instants, sensors, panels, memory } = bench;
    assert!(memory < instants, "{bench:?}");
    let sizes = Sizes { instants, channels: 3 * sensors, outputs: panels };
    let mut stream = Stream::new(Purpose::Batch, 1, [0, 0]);
    let mut draw = |n: usize| -> Vec<f64> { (0..n).map(|_| stream.normal()).collect() };
    let (x, f) = (draw(samples * instants * sizes.channels), draw(samples * instants * panels));
    let mut last = Instant::now();
    let mut passed = || {
        let spent = last.elapsed().as_secs_f64();
        last = Instant::now();
        1e3 * spent
    };
    let mut moments = Moments::new(sizes);
    moments.add(&x, &f, &vec![1.0; samples]);
    let first = passed();
    let lags = Lags { before: memory, after: memory };
    let linear = Fit::new(&moments, lags, 1e-6, Order::Ascending).expect("white noise").linear();
    let second = passed();
    let answers = linear.predict(&x);
    let third = passed();
    std::hint::black_box(linear.predict_vjp(&answers));
    let unknowns = lags.groups().len() * sizes.channels;
    let gflops = (unknowns as f64).powi(3) / 3.0 / (1e6 * second);
    LinearTimes { unknowns, milliseconds: [first, second, third, passed()], gflops }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bench itself, tiny: every figure is a positive number.
    #[test]
    fn the_bench_of_the_brain_runs() {
        let bench = BrainBench { samples: 4, instants: 40, sensors: 1, panels: 2, repeat: 1, threads: 2 };
        let rows = brain_rows(bench);
        assert_eq!(rows.len(), 2 + 3 * widths().count(), "{rows:?}");
        for row in rows {
            let figures = [row.forward, row.iteration, row.hessian, row.gauss_newton, row.share_of_peak()];
            assert!(figures.iter().all(|x| x.is_finite() && *x > 0.0), "{row:?}");
        }
    }

    /// The same of the linear brain's.
    #[test]
    fn the_bench_of_the_linear_brain_runs() {
        let found = linear_rows(LinearBench { samples: 5, instants: 12, sensors: 1, panels: 2, memory: 4 });
        assert_eq!(found.unknowns, 27);
        assert!(found.milliseconds.iter().all(|ms| *ms >= 0.0) && found.gflops > 0.0, "{found:?}");
    }
}
