//! `run`: works through the trials of a spec, or goes on where an earlier run has stopped.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use metasense_schemas::reason::{CANCELLED, PRUNED};
use metasense_schemas::spec::Run;
use serde_json::Value;
use tokio::sync::oneshot;

use super::live::Live;
use super::named::Spec;
use super::pages::Pages;
use super::simd::Simd;
use super::{Error, Format, log, print_rows};
use crate::analysis::kinds::brains;
use crate::analysis::setting::flatten;
use crate::analysis::trial;
use crate::cluster::home::{Home, SUBMITTED_SPEC, end_after};
use crate::cluster::submit::NOTICE;
use crate::cluster::{Assignment, Shard};
use crate::control::{Listener, WORKERS_MAX};
use crate::engine::{self, Again, Control, Options, Reread, Signals};
use crate::exit::{Exit, chain};
use crate::look::Table;
use crate::plan::{Plan, Trial, cost, counted};
use crate::scheduler::{Outcome, Settings};
use crate::store::{Reader, RunPlan, Store};

/// Rows of the final table that a person may want to read at once.
const MOST_ROWS: usize = 400;

/// Runs the trials of a spec, or goes on where an earlier run has stopped
///
/// Every step is kept in an SQLite file as it is done: after Ctrl-C, `kill -9` or a power cut the same command goes on.
/// Trials that are finished are never run again; trials that a changed spec adds are run beside them. `metasense control DB`
/// steers it from another terminal.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    spec: Spec,
    /// The database; by default results/NAME.sqlite
    #[arg(long, value_name = "FILE")]
    db: Option<PathBuf>,
    /// Worker processes, one trial each at a time; by default `run.workers` of the spec, else one a core
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    workers: Option<u16>,
    /// Shows pages of the run in a browser, at this port (0: any that is free), and prints their address with a token by which
    /// they can steer it. A process of its own: nobody who looks slows the run
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "8017")]
    serve: Option<u16>,
    /// Threads a worker; by default `run.threads` of the spec, else 1
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Run trials of the spec again that have failed, from their last step; otherwise they stay as they are
    #[arg(long)]
    retry_failed: bool,
    /// Make again, from the beginning, what other code than this program's has made of the spec; `status` says what has
    #[arg(long)]
    redo_other_code: bool,
    /// Only the trials of shard I of N: assigned by their estimates, as the folder of --copy-to has it, else as the spec
    /// has it now
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Of a shard: goes on from what an earlier attempt has put into this folder, and puts the database there when the run
    /// ends, whether by itself or by a signal; the live database is on the node's own disk, in TMPDIR or --db
    #[arg(long, value_name = "DIR", requires = "shard")]
    copy_to: Option<PathBuf>,
    /// Also puts it there every so often (s), should the node be lost
    #[arg(long, value_name = "S", default_value_t = 900.0, requires = "copy_to")]
    copy_every: f64,
    /// Stops in order after this time (s), where the scheduler does not announce the end by SIGTERM
    #[arg(long, value_name = "S", requires = "copy_to")]
    stop_after: Option<f64>,
    #[command(flatten)]
    simd: Simd,
    /// The form of the final table
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    args.simd.choose()?;
    let seconds = |name: &str, value: f64| match Duration::try_from_secs_f64(value) {
        Ok(time) if value >= 1.0 => Ok(time),
        _ => Err(Error::Usage(format!("--{name} {value} is not a time of at least 1 s"))),
    };
    let copy_every = seconds("copy-every", args.copy_every)?;
    let stop_after = args.stop_after.map(|s| seconds("stop-after", s)).transpose()?;
    let mut signals = Signals::new()?;
    if let Some(time) = stop_after {
        end_after(time);
    }
    let mut plan = args.spec.plan()?;
    if args.shard.is_some() {
        not_in_shards(&plan)?;
    }
    let Some((shard, folder)) = args.shard.zip(args.copy_to.as_deref()) else {
        if let Some(shard) = args.shard {
            Assignment::new(&plan.trials, shard.count()).restrict(shard, &mut plan);
        }
        let db = args.db.clone().unwrap_or_else(|| match args.shard {
            Some(shard) => plan.default_database().with_extension(format!("{}.sqlite", shard.file_stem())),
            None => plan.default_database(),
        });
        let (outcome, plan) = run(plan, &args, &db, &log::path(&db), &mut signals).await?;
        return end(&db, &plan, args.format, outcome).await;
    };
    check_submitted(folder, &plan)?;
    let assignment = Assignment::in_folder(folder, &plan.trials, shard.count())?;
    let home = Home::new(&plan.spec.name, shard, folder, args.db.clone())?;
    assignment.write(folder)?;
    assignment.restrict(shard, &mut plan);
    home.take_in().await?;
    let (db, log) = (home.live().to_owned(), home.log());
    let (stop, stopped) = oneshot::channel();
    let running = async {
        let outcome = run(plan, &args, &db, &log, &mut signals).await;
        drop(stop);
        outcome
    };
    let (outcome, ()) = tokio::join!(running, home.hand_in_every(copy_every, stopped));
    // Whatever has gone wrong: what there is, is handed in.
    let handed_in = home.hand_in_within(Duration::from_secs(NOTICE)).await;
    let (outcome, plan) = outcome?;
    let exit = end(&db, &plan, args.format, outcome).await?;
    handed_in?;
    home.leave();
    Ok(exit)
}

/// Questions want all results in one place.
pub(super) fn not_in_shards(plan: &Plan) -> Result<(), Error> {
    match plan.spec.until {
        None => Ok(()),
        Some(_) => Err(plan.source.error("until", "wants all results in one place: no shards").into()),
    }
}

/// The spec that a folder's shards were submitted with is the one they run.
fn check_submitted(folder: &Path, plan: &Plan) -> Result<(), Error> {
    let submitted = folder.join(SUBMITTED_SPEC);
    match std::fs::read_to_string(&submitted) {
        Ok(text) if text != plan.source.text => Err(Error::Usage(format!(
            "{} has changed since its shards were submitted ({}): put it back, or submit again",
            plan.source.file.display(),
            submitted.display()
        ))),
        _ => Ok(()),
    }
}

/// Runs what is open, and closes the database; with the plan as it is by then.
async fn run(
    plan: Plan,
    args: &Args,
    db: &Path,
    log: &Path,
    signals: &mut Signals,
) -> Result<(Outcome, Plan), Error> {
    let mut store = Store::open(db).await?;
    let control = Control::new(listener(db), reread(&plan, args));
    let ran = run_open(&mut store, &plan, args, log, signals, &control).await;
    let plan = control.last_plan().cloned().unwrap_or(plan);
    // The socket goes, and the database is closed in any case, and let go of when all is written.
    drop(control);
    let closed = store.close().await;
    let outcome = ran?;
    closed?;
    Ok((outcome.unwrap_or(Outcome::Complete), plan))
}

async fn run_open(
    store: &mut Store,
    plan: &Plan,
    args: &Args,
    log: &Path,
    signals: &mut Signals,
    control: &Control,
) -> Result<Option<Outcome>, Error> {
    let pages = match args.serve {
        Some(port) => Some(Pages::start(store.path(), port).await?),
        None => None,
    };
    // What was given up as hopeless is not, where nobody asks for that any more.
    let again = Again {
        pruned: plan.spec.run.prune.is_none(),
        failed: args.retry_failed,
        other_code: args.redo_other_code,
    };
    let mut options = options(&plan.spec.run, args);
    let mut round = Round { store, plan, args, log, signals, control, options: &mut options };
    let outcome = match plan.spec.until {
        None => round.run(&plan.trials, again).await,
        Some(_) => rounds(round, again).await,
    };
    if let Some(pages) = pages {
        pages.end().await;
    }
    outcome
}

/// Where commands come in; a run goes on without.
fn listener(db: &Path) -> Option<Listener> {
    Listener::new(db)
        .inspect_err(|error| {
            say!("`metasense control` cannot reach this run: no socket beside its database: {error}")
        })
        .ok()
}

/// Reads the spec again, where trials can be added to what the plan says.
fn reread(plan: &Plan, args: &Args) -> Arc<Reread> {
    let (spec, name) = (args.spec.clone(), plan.spec.name.clone());
    let (is_shard, asks) = (args.shard.is_some(), plan.spec.until.is_some());
    Arc::new(move || {
        if is_shard {
            return Err("a shard's trials are assigned before it begins: submit the edited spec".into());
        }
        let plan = spec.plan().map_err(|error| chain(&error))?;
        if asks || plan.spec.until.is_some() {
            return Err("[until] decides which trials are run: stop the run, the same command goes on by the edited spec".into());
        }
        if plan.spec.name != name {
            return Err(format!("its name is {:?}, that of the run {name:?}", plan.spec.name));
        }
        Ok(plan)
    })
}

/// What runs some trials needs.
struct Round<'a> {
    store: &'a mut Store,
    plan: &'a Plan,
    args: &'a Args,
    log: &'a Path,
    signals: &'a mut Signals,
    control: &'a Control,
    /// As people have changed them by now.
    options: &'a mut Options,
}

/// Runs what the sweep's questions want, looks at them, and so on, until they want nothing more.
async fn rounds(mut round: Round<'_>, mut again: Again) -> Result<Option<Outcome>, Error> {
    let mut said = Vec::new();
    loop {
        let workers = round.options.settings.workers;
        let (decision, wanted) =
            round.plan.decide(&round.store.found().await?, workers).expect("it has questions");
        for line in decision.standings.iter().map(ToString::to_string) {
            if !said.contains(&line) {
                say!("{line}");
                said.push(line);
            }
        }
        match round.run(&wanted, again).await? {
            Some(Outcome::Complete) => again = Again::default(),
            None if !decision.is_settled() => {
                say!("questions are left open: the most that [until] allows has been run");
                return Ok(None);
            }
            ended => return Ok(ended),
        }
    }
}

impl Round<'_> {
    /// Runs those of some trials that are open; `None` where there are none.
    async fn run(&mut self, trials: &[Trial], again: Again) -> Result<Option<Outcome>, Error> {
        let Self { store, plan, args, log, signals, control, options } = self;
        let sweep = (&plan.spec, &*plan.source.text);
        let Some(open) = engine::begin(store, sweep, trials, again, signals).await? else {
            say!("stopped before any trial was begun; the same command begins");
            return Ok(Some(Outcome::Interrupted));
        };
        let planned = RunPlan {
            shard: args.shard.map_or((1, 1), |shard| (shard.index(), shard.count())),
            workers: (options.settings.workers, options.threads),
            trials: open.len(),
            estimated_seconds: cost::seconds_on(&open, options.settings.workers, options.threads),
        };
        if open.is_empty() {
            // A shard without work is not a shard that is missing.
            if args.shard.is_some() {
                let run = store.begin_run(&planned).await?;
                store.end_run(&run, name(Outcome::Complete), 0, 0).await?;
            }
            say!("nothing left to do: {} settled", counted(trials.len(), "trial"));
            return Ok(None);
        }
        log::start(log)?;
        let run = store.begin_run(&planned).await?;
        let mut live = Live::new(open.len(), trials.len() - open.len(), options.settings.workers);
        let work = |trial: &Trial| serde_json::to_string(&trial.spec).expect("a trial is JSON");
        let ended = engine::run(store, &open, &work, options, signals, control, &mut live).await;
        let noted = match &ended {
            Ok(summary) => store.end_run(&run, name(summary.outcome), summary.done, summary.failed).await,
            Err(_) => Ok(()),
        };
        let summary = ended?;
        noted?;
        (options.settings.workers, options.settings.paused) = (summary.workers, summary.paused);
        Ok(Some(summary.outcome))
    }
}

/// As the database has it.
fn name(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Complete => "complete",
        Outcome::Interrupted => "interrupted",
        Outcome::StoreBroken => "store_broken",
        Outcome::NoWorkers => "no_workers",
    }
}

/// The table and the words at the end.
async fn end(db: &Path, plan: &Plan, format: Format, outcome: Outcome) -> Result<Exit, Error> {
    let failed = print_results(db, plan, format).await?;
    say!("database: {}", db.display());
    Ok(match outcome {
        Outcome::Interrupted => Exit::Interrupted,
        _ if failed > 0 => Exit::Failed,
        _ => Exit::Done,
    })
}

/// The command line goes before the spec, the spec before what the machine suggests.
fn options(run: &Run, args: &Args) -> Options {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = args.threads.map(usize::from).or(run.threads).unwrap_or(1).max(1);
    let workers = args.workers.map(usize::from).or(run.workers).unwrap_or((cores / threads).max(1));
    let patience = run.no_progress.unwrap_or(PATIENCE);
    let millis = |seconds: f64| (1000.0 * seconds) as u64;
    Options {
        settings: Settings {
            workers: workers.clamp(1, WORKERS_MAX as usize) as u32,
            paused: false,
            retries: run.retries.unwrap_or(5),
            backoff: millis(run.backoff.unwrap_or(0.5)),
            no_progress: millis(patience),
            time_limit: run.time_limit.map(millis),
            prune: run.prune.clone(),
        },
        threads: threads as u32,
        niceness: run.niceness.unwrap_or(0).into(),
        memory_mib: run.memory,
        keep_arrays: true,
        program: PathBuf::from("/proc/self/exe"),
    }
}

/// Longest silence of a worker (s) where the spec names none: what comes without a beat takes seconds, minutes on a machine
/// that is short of cores.
const PATIENCE: f64 = 600.0;

/// The final table; returns how many trials have failed.
async fn print_results(db: &Path, plan: &Plan, format: Format) -> Result<usize, Error> {
    let limit = if format == Format::Table { MOST_ROWS } else { usize::MAX };
    let (name, text) = (&*plan.spec.name, &*plan.source.text);
    let ((mut table, count), failures) = Reader::asked(db, async |reader| {
        Ok::<_, Error>((
            reader.results::<Table>(name, text, limit).await?,
            reader.failures(name, text).await?,
        ))
    })
    .await?;
    let (pruned, failures): (Vec<_>, Vec<_>) = failures.into_iter().partition(|(_, reason)| reason == PRUNED);
    let (cancelled, failures): (Vec<_>, Vec<_>) =
        failures.into_iter().partition(|(_, reason)| reason == CANCELLED);
    if !pruned.is_empty() {
        say!("{} given up as hopeless; without `prune` in [run] they go on", counted(pruned.len(), "trial"));
    }
    if !cancelled.is_empty() {
        say!("{} cancelled on request; --retry-failed goes on with them", counted(cancelled.len(), "trial"));
    }
    for (hash, reason) in failures.iter().take(MOST_ROWS) {
        say!("failed: trial {hash} ({reason})");
    }
    for row in &mut table.rows {
        let trial = plan.trials.iter().find(|trial| row[STATE + 2] == trial.hash.as_str());
        let spec = trial.and_then(|trial| serde_json::to_value(&trial.spec).ok());
        if let Some(spec) = spec {
            let names = brains(&trial::Trial {
                setting: flatten(&spec).into_iter().collect(),
                ..trial::Trial::default()
            });
            row[BRAINS].iter_mut().zip(names).for_each(|(cell, name)| *cell = name.into());
        }
    }
    if format == Format::Table && !table.rows.is_empty() {
        // from the right: what is left out moves what is behind it
        let same = |holds: &dyn Fn(&[Value]) -> bool| table.rows.iter().all(|row| holds(row));
        let left_out = [
            (STATE..table.columns.len(), same(&|row| row[STATE] == "done")),
            (PLACED..PLACED + 1, same(&|row| row[PLACED] == "random")),
            (BRAINS, same(&|row| row[BRAINS].iter().all(|brain| brain == "cnn"))),
        ];
        left_out.into_iter().filter(|(_, same)| *same).for_each(|(which, _)| table.drop_columns(which));
    }
    if failures.len() > MOST_ROWS {
        say!("… and {} more failed: metasense status {}", failures.len() - MOST_ROWS, db.display());
    }
    if !failures.is_empty() {
        say!(
            "their reasons and what to do stand in {}; --retry-failed runs them again",
            log::path(db).display()
        );
    }
    print_rows(&table, format)?;
    if count > table.rows.len() {
        let more = count - table.rows.len();
        say!("… and {more} more: metasense query {} \"SELECT * FROM v_trial\"", db.display());
    }
    Ok(failures.len())
}

/// Column of the state; reason and hash follow it, and are shown where not all is done.
const STATE: usize = 13;
/// Columns of the brains that read and trained, which are shown where they are not all the paper's.
const BRAINS: std::ops::Range<usize> = 5..7;
/// Column of how sensors were placed, which is shown where it is not all at random.
const PLACED: usize = 7;
