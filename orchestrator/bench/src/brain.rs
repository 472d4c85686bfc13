//! `brain`: time of a training iteration and of a Hessian-vector product, relative to the machine's multiply-add peak.
//!
//! Shows how much faster the kernels could be.

use std::path::PathBuf;
use std::time::Instant;

use metasense::cli::{Error, Format, print_rows};
use metasense::exit::Exit;
use metasense::look::Table;
use metasense::look::row;
use metasense_numerics::brain::{
    Adam, Architecture, Curvature, Data, Real, Shape, Workspace, initial_weights, loss, loss_gradient,
};
use metasense_numerics::random::{Purpose, Stream};
use metasense_numerics::simd::Width;
use metasense_schemas::spec::{Brain, Preset};
use serde_json::{Value, json};

use crate::{append, pool, widths};

/// Time of a training iteration and of second derivatives, share of the multiply-add peak
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Samples N of the batch
    #[arg(long, default_value_t = 270, value_parser = clap::value_parser!(u16).range(1..))]
    samples: u16,
    /// Instants T
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u16).range(1..))]
    instants: u16,
    /// Sensors M
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=100))]
    sensors: u16,
    /// Panels K
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=100))]
    panels: u16,
    /// Repetitions; the fastest counts
    #[arg(long, default_value_t = 20)]
    repeat: usize,
    /// Threads of the second pair of rows; rows of narrower instruction sets use one
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: u16,
    /// File to which the rows are appended as JSON lines
    #[arg(long, value_name = "FILE", default_value = "results/bench.jsonl")]
    append: PathBuf,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

const COLUMNS: &str = "network precision simd threads forward_ms iteration_ms hessian_ms \
    hessian_iterations gflop peak_gflops share_of_peak";

pub fn execute(args: &Args) -> Result<Exit, Error> {
    let table = Table::new(COLUMNS, rows(args));
    print_rows(&table, args.format)?;
    let head = json!({"bench": "brain", "samples": args.samples, "instants": args.instants,
        "sensors": args.sensors, "panels": args.panels});
    append(&args.append, &head, &table)?;
    Ok(Exit::Done)
}

/// Rows for both precisions, on one thread and on `args.threads`; on one thread for narrower instruction sets; and for the long
/// network in f32 on one thread.
fn rows(args: &Args) -> Vec<Vec<Value>> {
    let mut rows = Vec::new();
    for width in widths() {
        let most = if rows.is_empty() { args.threads } else { 1 };
        for threads in if most > 1 { vec![1, most] } else { vec![1] } {
            rows.push(measured::<f32>(args, threads, width, Preset::Paper));
            rows.push(measured::<f64>(args, threads, width, Preset::Paper));
        }
    }
    rows.extend(widths().map(|width| measured::<f32>(args, 1, width, Preset::Long)));
    rows
}

/// Measures a row. Peak and kernels alternate, so that both see the same load of the machine.
fn measured<F: Real>(args: &Args, threads: u16, width: Width, preset: Preset) -> Vec<Value> {
    let [samples, instants, sensors, panels] =
        [args.samples, args.instants, args.sensors, args.panels].map(usize::from);
    let network = Brain { preset: Some(preset), ..Brain::default() }.network();
    let architecture = Architecture::new(network.width, &network.kernels, &network.dilations, network.causal);
    let shape = Shape { instants, inputs: 3 * sensors, outputs: panels, architecture };
    let pool = pool(threads.into(), width);
    let mut stream = Stream::new(Purpose::Batch, 1, [0, 0]);
    let mut draw = |n: usize| (0..n).map(|_| F::from_f64(stream.normal())).collect::<Vec<F>>();
    let data = Data::new(shape, &draw(samples * instants * shape.inputs), &draw(samples * instants * panels));
    let mut weights: Vec<F> = initial_weights(shape, 1, 0).into_iter().map(F::from_f64).collect();
    let direction = weights.clone();
    let (mut gradient, mut adam) = (weights.clone(), Adam::new(weights.len()));
    let (ws, kernels) = (&mut Workspace::new(shape, width), F::kernels(width));
    let layers: usize = (shape.layers()..2 * shape.layers()).map(|block| shape.range(block).len()).sum();

    let timed = |work: &mut dyn FnMut()| {
        let begin = Instant::now();
        work();
        begin.elapsed().as_secs_f64()
    };
    let mut least = [f64::INFINITY; 3];
    let mut peak = 0.0f64;
    for _ in 0..args.repeat.max(1) {
        let mut work = 0;
        let seconds = timed(&mut || work = pool.broadcast(|| kernels.burst(300_000)).iter().sum());
        peak = peak.max(work as f64 / seconds);
        // A step of length 0 takes as long and keeps the weights.
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
        let product = timed(&mut || curvature.product(&direction, &mut gradient, ws, &pool));
        for (least, time) in least.iter_mut().zip(times.into_iter().chain([product])) {
            *least = least.min(time * 1e3);
        }
    }
    let network = match preset {
        Preset::Paper => "paper",
        Preset::Long => "long",
    };
    let precision = if size_of::<F>() == 4 { "f32" } else { "f64" };
    let [forward, iteration, hessian] = least;
    // Counts direct convolutions; Winograd's algorithm needs fewer, so the share of the peak can exceed 1.
    let gflop = (6 * samples * instants * layers) as f64 * 1e-9;
    let peak = peak * 1e-9;
    row![
        network,
        precision,
        width.name(),
        threads,
        forward,
        iteration,
        hessian,
        hessian / iteration,
        gflop,
        peak,
        gflop / (iteration * 1e-3) / peak
    ]
}
