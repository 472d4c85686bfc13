//! `bench implicit`: whether gradients of the paper's protocol point downhill on the holdout.
//!
//! It decides what the implicit term is worth after 20 products, beside the direct term alone, the training loss's
//! gradient, a random direction and no step at all. A network answers each move from the same trained weights.

use std::path::PathBuf;

use metasense_worker::course::downhill;
use serde_json::json;

use super::super::{Error, Format, print_rows, read_plan};
use super::{append, file_name};
use crate::exit::Exit;
use crate::look::{Table, row};

/// Holdout loss after a step against each gradient, network by network
#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Args {
    /// The spec file (TOML), whose first trial is the scene and whose initial body is moved
    spec: PathBuf,
    /// Length of a step (mm, Euclidean)
    #[arg(long, default_value_t = 1.0)]
    step: f64,
    /// Fresh networks, each with its own gradients
    #[arg(long, default_value_t = 3)]
    networks: u64,
    /// Iterations by which a trained network answers a move
    #[arg(long, default_value_t = 300)]
    iterations: usize,
    /// Where the rows are appended as JSON lines
    #[arg(long, value_name = "FILE", default_value = "results/implicit.jsonl")]
    append: PathBuf,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

const COLUMNS: &str = "network gradient step_mm train_change_percent holdout_change_percent \
    cosine_to_direct iterations residual smallest_curvature outcome";

pub(in crate::cli) fn execute(args: &Args) -> Result<Exit, Error> {
    let plan = read_plan(&args.spec)?;
    let spec = &plan.trials.first().ok_or_else(|| Error::Usage("the spec has no trial".into()))?.spec;
    let mut table = Table::new(COLUMNS, []);
    for network in 0..args.networks {
        say!("network {} of {}", network + 1, args.networks);
        let steps = downhill(spec, network, args.step, args.iterations, 1)
            .map_err(|failure| Error::Usage(failure.to_string()))?;
        let still = &steps[0];
        let percent = |now: f64, before: f64| 100.0 * (now / before - 1.0);
        for step in &steps[1..] {
            let solve = step.implicit;
            table.rows.push(row![
                network,
                step.gradient,
                args.step,
                percent(step.loss_train, still.loss_train),
                percent(step.loss_holdout, still.loss_holdout),
                step.cosine,
                solve.map(|s| s.iterations),
                solve.map(|s| s.residual),
                solve.map(|s| s.smallest_curvature),
                solve.map(|s| s.outcome.name()),
            ]);
        }
    }
    print_rows(&table, args.format)?;

    let head = json!({"bench": "implicit", "spec": file_name(&args.spec)});
    append(&args.append, &head, &table)?;
    Ok(Exit::Done)
}
