//! `projection`: time to project a design onto the feasible set, with a check of the results.
//!
//! Shows whether the projection takes less than 2 % of an outer step. A walk keeps its direction, with noise, so that it runs
//! into and along the constraints, as an optimiser does. Single steps start from rotated squares.

use std::time::Instant;

use metasense::cli::{Error, Format, print_rows};
use metasense::exit::Exit;
use metasense::look::Table;
use metasense::look::row;
use metasense_worker::design::{
    Feasible, Layout, Limits, Pattern, Projection, Purpose, Stage, Status, Stream,
};
use rayon::prelude::*;
use serde_json::Value;

const SPACING: f64 = 15.0;
const LIGAMENT: f64 = 2.25;
const ANGLE: f64 = 25.0;

/// Time of a projection by size and step length, share of its stages, iterations of Clarabel
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Bodies, columns × rows
    #[arg(long, value_delimiter = ',', value_parser = size, default_value = "2x2,6x6,12x12,24x16,40x40")]
    sizes: Vec<(usize, usize)>,
    /// Largest displacement per step (mm): single steps above 1 mm, a walk below
    #[arg(long, value_delimiter = ',', default_value = "0.1,0.15,4,7.5")]
    steps: Vec<f64>,
    /// Projections per row
    #[arg(long, default_value_t = 100)]
    calls: u64,
    /// Instead, run N random projections of random planar and circular bodies, and count violations
    #[arg(long, value_name = "N")]
    random: Option<u64>,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

fn stream(which: u64, number: u64) -> Stream {
    Stream::new(Purpose::Design, which, [1, number])
}

fn size(text: &str) -> Result<(usize, usize), String> {
    let parse = |part: &str| part.parse().ok().filter(|n| (2..=200).contains(n));
    let (columns, rows) = text.split_once(['x', '×']).ok_or("must be COLUMNSxROWS, for instance 6x6")?;
    parse(columns).zip(parse(rows)).ok_or_else(|| "columns and rows must be from 2 to 200".into())
}

pub fn execute(args: &Args) -> Result<Exit, Error> {
    if let Some(count) = args.random {
        return random(count, args.format);
    }
    let mut table = Table::new(
        "units step_mm calls median_ms p90_ms max_ms untouched sequence path repair \
        kept programs iterations active violations",
        [],
    );
    let mut violations = 0;
    for &(columns, rows) in &args.sizes {
        for &step in &args.steps {
            // Large bodies get fewer single steps, which take seconds each.
            let calls = if step > 1.0 {
                (args.calls * 36 / (columns * rows) as u64).clamp(1, args.calls)
            } else {
                args.calls
            };
            let (row, broken) = measure(columns, rows, step, calls);
            violations += broken;
            table.rows.push(row);
        }
    }
    print_rows(&table, args.format)?;
    Ok(if violations == 0 { Exit::Done } else { Exit::Failed })
}

fn measure(columns: usize, rows: usize, step: f64, calls: u64) -> (Vec<Value>, usize) {
    let layout = Layout::planar(columns, rows, SPACING, LIGAMENT);
    let start = layout.initial_design(ANGLE.to_radians());
    let mut feasible = Feasible::new(&layout, Limits::default(), &[]);
    let mut draw = stream(1, 0);
    let direction: Vec<f64> = start.iter().map(|_| draw.between([-1.0, 1.0]).signum()).collect();
    let walk = step <= 1.0;
    let mut x = start;
    // Measure a walk only after it has reached the constraints.
    let ahead = if walk { (2.5 / step) as u64 } else { 0 };
    let (mut times, mut found, mut broken) = (Vec::new(), Vec::new(), 0);
    for call in 0..ahead + calls {
        let mut noise = stream(2, call);
        let mut shift =
            |d: &f64| if walk { 0.7 * d + noise.between([-0.3, 0.3]) } else { noise.between([-1.0, 1.0]) };
        let target: Vec<f64> = x.iter().zip(&direction).map(|(x, d)| x + step * shift(d)).collect();
        let begin = Instant::now();
        let out = feasible.project(&x, &target, None);
        let ms = begin.elapsed().as_secs_f64() * 1e3;
        if walk {
            x.clone_from(&out.design);
        }
        if call >= ahead {
            broken += usize::from(!feasible.violations(&out.design).is_empty());
            times.push(ms);
            found.push(out);
        }
    }
    times.sort_by(f64::total_cmp);
    let at = |part: f64| times[((times.len() - 1) as f64 * part).round() as usize];
    let share = |holds: &dyn Fn(&Projection) -> bool| found.iter().filter(|p| holds(p)).count();
    let stage = |s: Stage| share(&|p| p.status == Status::Projected && p.stage == s);
    let mean = |of: &dyn Fn(&Projection) -> f64| found.iter().map(of).sum::<f64>() / found.len() as f64;
    let row = row![
        format!("{columns} × {rows}"),
        step,
        calls,
        at(0.5),
        at(0.9),
        at(1.0),
        share(&|p| p.status == Status::Untouched),
        stage(Stage::Sequence),
        stage(Stage::Path),
        stage(Stage::Repair),
        share(&|p| p.status == Status::Kept),
        mean(&|p| p.programs as f64),
        mean(&|p| p.iterations as f64),
        mean(&|p| p.active.len() as f64),
        broken
    ];
    (row, broken)
}

/// Random projections: bodies of 2 × 2 to 8 × 8 units and discs, steps up to the spacing, from rotated squares or random
/// designs.
fn random(count: u64, format: Format) -> Result<Exit, Error> {
    let begin = Instant::now();
    let outcomes: Vec<(Status, usize)> = (0..count).into_par_iter().map(project_random).collect();
    let count_status = |status: Status| outcomes.iter().filter(|o| o.0 == status).count();
    let violations: usize = outcomes.iter().map(|o| o.1).sum();
    let columns = "projections untouched projected kept infeasible violations seconds";
    let row = row![
        count,
        count_status(Status::Untouched),
        count_status(Status::Projected),
        count_status(Status::Kept),
        count_status(Status::Infeasible),
        violations,
        (begin.elapsed().as_secs_f64() * 10.0).round() / 10.0
    ];
    print_rows(&Table::new(columns, [row]), format)?;
    Ok(if violations == 0 { Exit::Done } else { Exit::Failed })
}

fn project_random(number: u64) -> (Status, usize) {
    let mut draw: Stream = stream(3, number);
    let (columns, rows) = (2 + draw.below(7), 2 + draw.below(7));
    let layout = match draw.below(3) {
        0 => Layout::circular(&Pattern::square(), columns.max(3), SPACING, LIGAMENT),
        _ => Layout::planar(columns, rows, SPACING, LIGAMENT),
    };
    let mut feasible = Feasible::new(&layout, Limits::default(), &[]);
    let regular = layout.initial_design(draw.between([0.2, 0.5]));
    // Log-uniform from 0.1 mm to the spacing.
    let size = 0.1 * (SPACING / 0.1).powf(draw.uniform());
    let start = match draw.below(2) {
        0 => regular,
        _ => feasible.random_design(&regular, number, 0.25 * SPACING).unwrap_or(regular),
    };
    let target: Vec<f64> = start.iter().map(|x| x + draw.between([-size, size])).collect();
    let out = feasible.project(&start, &target, None);
    (out.status, feasible.violations(&out.design).len())
}
