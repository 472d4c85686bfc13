//! `trial`: runs one trial in the foreground, without scheduler, workers and database.

use std::time::Instant;

use metasense_schemas::record::{BodyRecord, Checkpoint, NetworkRecord, StepRecord, StepSeconds};
use metasense_worker::run::{LoopControl, NoResult, ObserveTrial, pool, run_trial};
use serde_json::json;

use super::named::Named;
use super::simd::Simd;
use super::{Error, Format, duration, end_on_signal, print_rows};
use crate::analysis::numbers::{most_above, network_mean};
use crate::exit::Exit;
use crate::look::Table;
use crate::provenance;

/// Runs one trial in the foreground without a database, to reproduce or profile it
///
/// The result is bit-identical to that of a run. Each step is printed to standard error.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    trial: Named,
    /// Threads
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "Workers")]
    threads: u16,
    #[command(flatten)]
    simd: Simd,
    /// Format of the result
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    end_on_signal(None);
    args.simd.choose()?;
    let (hash, spec) = args.trial.read().await?;
    args.trial.check_memory(&spec)?;
    let start = Instant::now();
    let result = match pool(args.threads.into()).and_then(|pool| run_trial(&spec, None, &pool, &mut Steps)) {
        Ok(result) => result,
        Err(failure @ (NoResult::Numerical { .. } | NoResult::Body { .. } | NoResult::Stopped)) => {
            say!("failed: trial {hash}: {failure}");
            return Ok(Exit::Failed);
        }
        Err(NoResult::Shortage(what)) => return Err(Error::Short(what)),
        Err(failure @ NoResult::Rejected(_)) => return usage!("trial {hash}: {failure}"),
    };
    let seconds = start.elapsed().as_secs_f64();
    let mut table = Table::default();
    let mut row = Vec::new();
    let mut add = |name: &str, value| {
        table.columns.push(name.into());
        row.push(value);
    };
    add("hash", json!(hash));
    for (name, error) in ERRORS {
        add(&format!("{name}_initial"), json!(network_mean(&result.initial.networks, *error)));
        add(&format!("{name}_optimised"), json!(network_mean(&result.optimised.networks, *error)));
    }
    add("holdout_above_initial", json!(most_above(&result.initial.networks)));
    add("holdout_above_optimised", json!(most_above(&result.optimised.networks)));
    let long = |body: &BodyRecord| network_mean(&body.long, |n| n.error_holdout);
    if !result.initial.long.is_empty() {
        add("long_holdout_error_initial", json!(long(&result.initial)));
        add("long_holdout_error_optimised", json!(long(&result.optimised)));
    }
    add("best_step", json!(result.best_step));
    add("seconds", json!(seconds));
    add("simd", json!(result.simd));
    table.rows.push(row);
    print_rows(&table, args.format)?;
    provenance::unresolved(&result.solver).iter().for_each(|caveat| say!("warning: {caveat}"));
    say!("{}", duration(seconds));
    Ok(Exit::Done)
}

type ErrorOf = fn(&NetworkRecord) -> Option<f64>;
const ERRORS: &[(&str, ErrorOf)] = &[
    ("test_error", |n| n.error_test),
    ("holdout_error", |n| n.error_holdout),
    ("holdout_median", |n| n.spread?.median),
];

/// Prints one line per step.
struct Steps;

impl ObserveTrial for Steps {
    fn progress(&mut self) -> LoopControl {
        LoopControl::Continue
    }

    fn save(&mut self, _: Checkpoint) {}

    fn step(&mut self, record: StepRecord, _: Checkpoint) -> LoopControl {
        let number = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.4}"));
        let [test, training, moved] = [record.error_test, record.error_train, record.step_length].map(number);
        let StepSeconds { simulate, train, differentiate, implicit, project, .. } = record.seconds;
        let (step, projection) = (record.step, record.projection);
        say!(
            "step {step:>4}: test error {test} %, training error {training} %, moved {moved} mm, {projection}; \
             simulate {simulate:.2} s, train {train:.2} s, differentiate {differentiate:.2} s, \
             implicit {implicit:.2} s, project {project:.3} s"
        );
        LoopControl::Continue
    }
}
