//! `engine`: runs trials without computation through the real engine: processes, shared memory, database.
//!
//! Shows whether the engine limits a sweep. Tests of the engine use it, too: the result of a trial depends on each of its
//! steps, and the database can be kept and resumed.

pub mod noop;

use std::path::PathBuf;
use std::time::Instant;

use metasense::cli::{self, Error};
use metasense::control::Control;
use metasense::engine::{self, Options, RerunPolicy, Silent};
use metasense::exit::Exit;
use metasense::plan::PlannedTrial;
use metasense::print_line;
use metasense::scheduler::{RunOutcome, Settings};
use metasense::signals::Signals;
use metasense::store::Store;
use metasense_schemas::record::Parts;
use metasense_schemas::spec::{SweepSpec, TrialSpec};
use metasense_worker::clock::cpu_seconds;
use noop::{Fault, Noop};
use serde_json::json;

/// Recorded trials per second and rate of arrays of an engine with empty trials
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Trials.
    #[arg(long, default_value_t = 2000)]
    trials: u32,
    /// Worker processes.
    #[arg(long, default_value_t = 2)]
    workers: u32,
    /// Steps per trial, each recorded with its checkpoint.
    #[arg(long, default_value_t = 0)]
    steps: u32,
    /// Duration of a step (ms).
    #[arg(long, default_value_t = 0)]
    step_ms: u32,
    /// Length of the array of each result (float64).
    #[arg(long, default_value_t = 0)]
    array: u64,
    /// Keep the database; resume an existing one.
    #[arg(long, value_name = "FILE")]
    db: Option<PathBuf>,
    /// Fault of every trial.
    #[arg(long, hide = true, value_enum)]
    fault: Option<Fault>,
    /// Longest time without a sign of life (ms).
    #[arg(long, hide = true, default_value_t = 60_000)]
    no_progress_ms: u64,
    /// Longest duration of an attempt (ms).
    #[arg(long, hide = true)]
    time_limit_ms: Option<u64>,
    /// Longest wait for steps in progress at a stop (ms).
    #[arg(long, hide = true, default_value_t = 10_000)]
    grace_ms: u64,
    /// Retries of a trial after deaths without a step.
    #[arg(long, hide = true, default_value_t = 5)]
    retries: u32,
}

pub async fn execute(args: Args) -> Result<Exit, Error> {
    let scratch = std::env::temp_dir().join(format!("metasense-bench-{}.sqlite", std::process::id()));
    if let Some(db) = &args.db {
        cli::log::start(&cli::log::path(db)?)?;
    }
    let db = args.db.clone().unwrap_or_else(|| scratch.clone());
    let done = measure(&args, &db).await;
    if args.db.is_none() {
        for end in ["", "-wal", "-shm"] {
            let _ = std::fs::remove_file(format!("{}{end}", scratch.display()));
        }
    }
    done
}

async fn measure(args: &Args, db: &std::path::Path) -> Result<Exit, Error> {
    let sweep = sweep();
    let trials = trials(&sweep, args.trials);
    let mut signals = Signals::new()?;
    let mut store = Store::open(db).await?;
    let text = (&sweep, "bench engine");
    let Some(pending) =
        engine::begin(&mut store, text, &trials, RerunPolicy::default(), &mut signals).await?
    else {
        store.close().await?;
        return Ok(Exit::Interrupted);
    };
    let work = |trial: &PlannedTrial| {
        let noop = Noop {
            steps: args.steps,
            millis: args.step_ms,
            array: args.array,
            seed: trial.order as u64,
            fault: args.fault,
        };
        serde_json::to_string(&noop).expect("numbers are JSON")
    };
    let options = Options {
        settings: Settings {
            workers: args.workers.max(1),
            paused: false,
            retries: args.retries,
            backoff: 50,
            no_progress: args.no_progress_ms,
            time_limit: args.time_limit_ms,
            memory_limited: false,
            grace: args.grace_ms,
        },
        threads: 1,
        niceness: 0,
        memory_mib: None,
        program: PathBuf::from("/proc/self/exe"),
    };
    let (cpu, began) = (cpu_seconds(), Instant::now());
    let control = Control::none();
    let summary =
        engine::run(&mut store, &pending, &work, &options, &mut signals, &control, &mut Silent).await;
    store.close().await?;
    let summary = summary?;
    let seconds = began.elapsed().as_secs_f64();
    let row = json!({
        "bench": "engine",
        "workers": args.workers,
        "steps": args.steps,
        "step_ms": args.step_ms,
        "array_bytes": args.array * 8,
        "trials": summary.view.done,
        "failed": summary.view.failed,
        "stale": summary.stale,
        "seconds": seconds,
        "trials_per_second": summary.view.done as f64 / seconds,
        "array_bytes_per_second": (summary.view.done as u64 * args.array * 8) as f64 / seconds,
        "orchestrator_core_percent": 100.0 * (cpu_seconds() - cpu) / seconds,
        "orchestrator_resident_mib": crate::peak_mib(),
        "version": env!("CARGO_PKG_VERSION"),
    });
    print_line!("{row}")?;
    Ok(match summary.outcome {
        RunOutcome::Interrupted => Exit::Interrupted,
        RunOutcome::Unfit(_) => Exit::Unfit,
        _ if summary.view.failed > 0 => Exit::Failed,
        _ => Exit::Done,
    })
}

fn sweep() -> SweepSpec {
    serde_json::from_value(json!({
        "name": "bench-engine",
        "body": {"columns": 2, "rows": 2, "spacing": 15.0, "ligament_length": 2.25, "density": 1e-8,
                 "stiffness": {"stretch": 3.0, "shear": 0.5, "bend": 1.0}},
        "stimuli": {"kind": "bell"},
        "sweep": {"panels": [1], "sensors": [1]},
    }))
    .expect("the sweep of this bench is a sweep")
}

fn trials(sweep: &SweepSpec, count: u32) -> Vec<PlannedTrial> {
    let spec = |order: u32| TrialSpec {
        variation: None,
        body: sweep.body.clone(),
        time: sweep.time,
        solver: sweep.solver,
        sensors: sweep.sensors.clone(),
        stimuli: sweep.stimuli.clone().resolved(),
        brain: sweep.brain.clone(),
        optimise: sweep.optimise.clone(),
        evaluation: sweep.evaluation.clone(),
        feasible: sweep.feasible,
        point: metasense_schemas::spec::SweepPoint {
            panels: 1,
            sensors: 1,
            placement: order as usize,
            seed: 1,
        },
        panel_units: vec![0],
        sensor_units: vec![1],
    };
    (0..count)
        .map(|order| PlannedTrial {
            hash: format!("noop-{order:08}"),
            training: format!("noop-{order:08}"),
            spec: spec(order),
            order: order as usize,
            units: 4,
            design_parameters: 1,
            brain_parameters: 0,
            weight: Parts { steps: 0, comparison: 1 },
            pause: None,
            trains: true,
            cost: Parts { steps: 0.0, comparison: 1.0 },
        })
        .collect()
}
