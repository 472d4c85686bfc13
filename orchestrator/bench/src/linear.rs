//! `linear`: time to fit a linear decoder, by sensors and memory.
//!
//! Shows which memory a step can afford: the factorisation takes D³/3 operations for D unknowns, everything else at most O(D²).

use std::path::PathBuf;
use std::time::Instant;

use metasense::cli::{Error, Format, print_rows};
use metasense::exit::Exit;
use metasense::look::Table;
use metasense::look::row;
use metasense_numerics::Pool;
use metasense_numerics::brain::linear::{Fit, Lags, Moments, Order, Sizes};
use metasense_numerics::random::{Purpose, Stream};
use serde_json::{Value, json};

use crate::append;

/// Time to fit a linear decoder on one thread: moments, normal matrix with factorisation, estimates, gradient
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Samples N
    #[arg(long, default_value_t = 270, value_parser = clap::value_parser!(u16).range(1..))]
    samples: u16,
    /// Instants T
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u16).range(2..=1000))]
    instants: u16,
    /// Numbers of sensors M
    #[arg(long, value_delimiter = ',', default_value = "1,2,3,4,5,6")]
    sensors: Vec<u8>,
    /// Panels K
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=100))]
    panels: u16,
    /// Memories before and after an instant, in instants
    #[arg(long, value_delimiter = ',', default_value = "40,100,199")]
    memories: Vec<u16>,
    /// File to which the rows are appended as JSON lines
    #[arg(long, value_name = "FILE", default_value = "results/bench.jsonl")]
    append: PathBuf,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

pub fn execute(args: &Args) -> Result<Exit, Error> {
    let sizes = args.sensors.iter().flat_map(|m| args.memories.iter().map(move |l| (*m, *l)));
    let columns = "sensors memory unknowns moments_ms solve_ms answers_ms pull_back_ms factor_gflops";
    let table = Table::new(columns, sizes.map(|(sensors, memory)| measured(args, sensors, memory)));
    print_rows(&table, args.format)?;
    let head =
        json!({"bench": "linear", "samples": args.samples, "instants": args.instants, "panels": args.panels});
    append(&args.append, &head, &table)?;
    Ok(Exit::Done)
}

/// Measures a row with white noise.
fn measured(args: &Args, sensors: u8, memory: u16) -> Vec<Value> {
    let [samples, instants, panels] = [args.samples, args.instants, args.panels].map(usize::from);
    let reach = usize::from(memory).min(instants - 1);
    let sizes = Sizes { instants, channels: 3 * usize::from(sensors.max(1)), outputs: panels };
    let mut stream = Stream::new(Purpose::Batch, 1, [0, 0]);
    let mut draw = |n: usize| -> Vec<f64> { (0..n).map(|_| stream.normal()).collect() };
    let (x, f) = (draw(samples * instants * sizes.channels), draw(samples * instants * panels));
    let pool = Pool::new(1).expect("a thread");
    let mut last = Instant::now();
    let mut passed = || {
        let spent = last.elapsed().as_secs_f64();
        last = Instant::now();
        1e3 * spent
    };
    let mut moments = Moments::new(sizes, &pool);
    moments.add(&x, &f, &vec![1.0; samples]);
    let first = passed();
    let lags = Lags { before: reach, after: reach };
    let linear = Fit::new(moments.normal(lags), 1e-6, Order::Ascending).expect("white noise").linear();
    let second = passed();
    let answers = linear.predict(&x);
    let third = passed();
    std::hint::black_box(linear.predict_vjp(&answers));
    let unknowns = lags.groups().len() * sizes.channels;
    // Counts the factorisation only
    let gflops = (unknowns as f64).powi(3) / 3.0 / (1e6 * second);
    row![sensors, memory, unknowns, first, second, third, passed(), gflops]
}
