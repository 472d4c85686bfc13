//! `run`: runs the trials of a spec, or resumes an earlier run.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use metasense_lab::cost;
use metasense_schemas::spec::Run;
use metasense_source::Source;
use metasense_worker::limits::{Needs, check};
use tokio::sync::{Notify, oneshot};

use super::live::Live;
use super::named::{Spec, planned};
use super::pages::Pages;
use super::results::{Results, print_results};
use super::simd::Simd;
use super::warnings::warn_of;
use super::{Error, Format, end_with, log, merge};
use crate::analysis::until::TrialErrors;
use crate::cluster::home::{Home, SUBMITTED_SPEC, end_after};
use crate::cluster::submit::NOTICE;
use crate::cluster::{Assignment, Shard, trials_of};
use crate::control::{Control, Listener, Reread, WORKERS_MAX};
use crate::engine::{self, EngineError, GRACE, Options, RerunPolicy};
use crate::exit::{Exit, chain};
use crate::plan::{GRACE_MAX, Plan, PlannedTrial, counted};
use crate::rounds::{Runs, rounds};
use crate::scheduler::{RunOutcome, Settings};
use crate::signals::Signals;
use crate::sql::wait_for_locks;
use crate::store::{RunPlan, Store, StoreError};

/// Runs the trials of a spec, or resumes an earlier run
///
/// Each step is stored in an SQLite file as soon as it is done. After Ctrl-C, `kill -9` or a power cut, the same command
/// resumes the run. Finished trials are not repeated; trials that were added to the spec are run as well. `metasense
/// control DB` controls the run from another terminal.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    spec: Spec,
    #[command(flatten)]
    running: Running,
    /// Runs only the trials of shard I of N. Shards are balanced by estimated time, unless --folder contains an assignment
    #[arg(long, value_name = "I/N", help_heading = "Shards")]
    shard: Option<Shard>,
    /// The folder of the shards. The shard resumes from the database that an earlier attempt left there. At the end, also
    /// after a signal, it copies its database there. During the run the database is on the node's disk, in TMPDIR or at
    /// --db
    #[arg(long, value_name = "DIR", requires = "shard", help_heading = "Shards")]
    folder: Option<PathBuf>,
    /// Also copies the database to --folder at this interval (s), in case the node fails
    #[arg(long, value_name = "S", default_value_t = 900.0, requires = "folder", help_heading = "Shards")]
    copy_every: f64,
    /// Stops cleanly after this time (s), for schedulers that do not send SIGTERM before the end
    #[arg(long, hide = true, value_name = "S", requires = "folder")]
    stop_after: Option<f64>,
    /// Stops cleanly when this parent process ends
    #[arg(long, hide = true, value_name = "PID")]
    parent: Option<u32>,
    /// When all shards of the folder have ended, merges them into this database, for schedulers that cannot start a job
    /// after others
    #[arg(long, hide = true, value_name = "FILE", requires = "folder")]
    merge_into: Option<PathBuf>,
}

/// Where and how trials are run.
#[derive(Debug, clap::Args)]
pub(super) struct Running {
    /// The database; by default results/NAME.sqlite
    #[arg(long, value_name = "FILE")]
    pub db: Option<PathBuf>,
    /// Worker processes, each with one trial at a time; by default `run.workers` of the spec, else one per core
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "Workers")]
    pub workers: Option<u16>,
    /// Shows the run in a browser at this port (0: any free port). Prints an address with a token; everyone who has it can
    /// control the run. Another process serves the pages, so they do not slow the run
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true, default_missing_value = "8017")]
    pub serve: Option<u16>,
    /// Threads per worker; by default `run.threads` of the spec, else 1
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "Workers")]
    pub threads: Option<u16>,
    /// Longest wait for steps in progress when the run stops (s); by default `run.grace` of the spec, else 10
    #[arg(long, value_name = "S", value_parser = grace, help_heading = "Workers")]
    pub grace: Option<f64>,
    /// Resumes failed trials from their last step
    #[arg(long, help_heading = "Trials to repeat")]
    pub retry_failed: bool,
    /// Restarts trials of the spec that other code computed; `status` lists them
    #[arg(long, help_heading = "Trials to repeat")]
    pub redo_other_code: bool,
    #[command(flatten)]
    pub simd: Simd,
    /// Format of the final table
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    pub format: Format,
}

fn grace(text: &str) -> Result<f64, String> {
    let known = text.parse().ok().filter(|s| (0.0..=GRACE_MAX).contains(s));
    known.ok_or_else(|| format!("must be a number of seconds, at most {GRACE_MAX}"))
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    if args.parent.is_some_and(|parent| !end_with(parent)) {
        return Ok(Exit::Interrupted);
    }
    args.running.simd.choose()?;
    let seconds = |name: &str, value: f64| match (1.0..=1e9).contains(&value) {
        true => Ok(Duration::from_secs_f64(value)),
        false => usage!("--{name} {value}: must be at least 1, at most 1e9 s"),
    };
    let copy_every = seconds("copy-every", args.copy_every)?;
    let stop_after = args.stop_after.map(|s| seconds("stop-after", s)).transpose()?;
    // Before signals are received: a spec may come from a pipe, and Ctrl-C ends the wait for it.
    let source = args.spec.source()?;
    let (mut signals, asked) = (Signals::new()?, Notify::new());
    if let Some(time) = stop_after {
        end_after(time);
    }
    let Args { spec, running, shard, .. } = &args;
    let fixed = shard.map(|_| FIXED_SHARD);
    let how = RunConfig { spec, running, shard: *shard, fixed, asked: &asked };
    let Some((shard, folder)) = args.shard.zip(args.folder.as_deref()) else {
        let mut plan = planned(source)?;
        if args.shard.is_some() {
            refuse_until(&plan)?;
        }
        if let Some(shard) = args.shard {
            Assignment::new(&plan.trials, shard.count()).restrict(shard, &mut plan);
        }
        let db = args.running.db.clone().unwrap_or_else(|| match args.shard {
            Some(shard) => plan.default_database().with_extension(format!("{}.sqlite", shard.file_stem())),
            None => plan.default_database(),
        });
        let log = log::path(&db)?;
        let (outcome, plan) = run(plan, &how, &db, &log, &mut signals, run_plan).await?;
        return end(Results { db: &db, named: &db, log: &log }, &plan, args.running.format, outcome).await;
    };
    check_submitted(folder, &source)?;
    let plan = match trials_of(folder, shard)? {
        Some(trials) => Plan::listed(source, trials)?,
        None => {
            let mut plan = planned(source)?;
            refuse_until(&plan)?;
            let assignment = Assignment::in_folder(folder, &plan.trials, shard.count())?;
            super::make_folder(folder)?;
            assignment.write(folder)?;
            assignment.restrict(shard, &mut plan);
            plan
        }
    };
    let mut home = Home::new(&plan.spec.name, shard, folder, args.running.db.clone())?;
    check(&Needs { files: &[home.handed_in()], ..Needs::default() })?;
    let waiting = Notify::new();
    let waits = || {
        say!("an earlier attempt of this shard is still running on this node; waiting for it");
        waiting.notify_one();
    };
    // A signal ends the wait, but not a merge before it, which is quick and whose result must be handed in.
    let signalled = async {
        waiting.notified().await;
        signals.next().await
    };
    let merged = tokio::select! {
        merged = home.merge_earlier_copies(waits) => merged?,
        Some(()) = signalled => {
            say!("stopped before the first trial; the same command starts the shard");
            return Ok(Exit::Interrupted);
        }
    };
    if let Some(aside) = merged {
        say!(
            "the shard's database on this node was damaged and is now {}; the shard resumes from its copy in the folder",
            aside.display()
        );
    }
    let (db, log) = (home.live().to_owned(), home.log());
    let (stop, stopped) = oneshot::channel();
    let running = async {
        let outcome = run(plan, &how, &db, &log, &mut signals, all).await;
        drop(stop);
        outcome
    };
    let (outcome, ()) = tokio::join!(running, home.hand_in_every(copy_every, stopped, &asked));
    // Hands in the database also after an error, if it exists.
    let handed_in = match outcome.is_err() && !home.live().exists() {
        true => Ok(()),
        false => home.hand_in_within(Duration::from_secs(NOTICE)).await,
    };
    let (outcome, plan) = outcome?;
    let named = if handed_in.is_ok() { home.handed_in() } else { &db };
    let exit = end(Results { db: &db, named, log: &log }, &plan, args.running.format, outcome).await?;
    handed_in?;
    home.leave().await;
    if let Some(out) = args.merge_into.filter(|_| matches!(exit, Exit::Done | Exit::Failed)) {
        merge::merge_if_all_ended(folder, shard, &out).await?;
    }
    Ok(exit)
}

/// Refuses [until] in single shards: its questions need all results in one database.
pub(super) fn refuse_until(plan: &Plan) -> Result<(), Error> {
    let why = "needs all results in one database: `metasense cluster submit` runs its shards and merges them";
    match plan.spec.until {
        None => Ok(()),
        Some(_) => Err(plan.source.error("until", why).into()),
    }
}

/// Refuses a spec that has changed since its shards were submitted.
fn check_submitted(folder: &Path, source: &Source) -> Result<(), Error> {
    let submitted = folder.join(SUBMITTED_SPEC);
    match std::fs::read_to_string(&submitted) {
        Ok(text) if text != source.text => usage!(
            "{} has changed since its shards were submitted ({}): restore it, or submit again",
            source.file.display(),
            submitted.display()
        ),
        _ => Ok(()),
    }
}

/// How a plan is run.
pub(super) struct RunConfig<'a> {
    pub spec: &'a Spec,
    pub running: &'a Running,
    /// The shard to run; none: all trials.
    pub shard: Option<Shard>,
    /// Why the spec cannot be reloaded during the run; none: it can.
    pub fixed: Option<&'static str>,
    /// Notified when the user asks for the end.
    pub asked: &'a Notify,
}

/// Why a shard's spec cannot be reloaded.
const FIXED_SHARD: &str = "the trials of a shard are assigned before it starts: submit the edited spec";

/// Runs `drive` on the open database and closes it. Returns the outcome and the latest plan.
pub(super) async fn run(
    plan: Plan,
    how: &RunConfig<'_>,
    db: &Path,
    log: &Path,
    signals: &mut Signals,
    drive: impl AsyncFnOnce(Round<'_>, RerunPolicy) -> Result<Option<RunOutcome>, Error>,
) -> Result<(RunOutcome, Plan), Error> {
    warn_of(&plan);
    plan.check_memory()?;
    if let Some(limit) = plan.spec.run.lock_wait {
        wait_for_locks(Duration::from_secs_f64(limit));
    }
    check(&Needs { threads: 2, files: &[db], ..Needs::default() })?;
    let mut store = Store::open(db).await?;
    let control = Control::new(listener(db), reread(&plan, how));
    let ran = async {
        let pages = match how.running.serve {
            Some(port) => Some(Pages::start(store.path(), port).await?),
            None => None,
        };
        let again = RerunPolicy { failed: how.running.retry_failed, other_code: how.running.redo_other_code };
        let mut options = options(&plan.spec.run, how.running);
        let (store, plan, control, options) = (&mut store, &plan, &control, &mut options);
        let (shard, asked) = (how.shard, how.asked);
        let round = Round { store, plan, shard, log, signals, control, options, asked, stopping: false };
        let outcome = drive(round, again).await;
        if let Some(pages) = pages {
            pages.end().await;
        }
        outcome
    };
    let ran = ran.await;
    let plan = control.last_plan(plan);
    // Removes the socket, then closes the database, also after an error.
    drop(control);
    let closed = store.close().await;
    let outcome = match closed {
        // this error states where the recorded data is
        Err(lost @ StoreError::Lost { .. }) => return Err(lost.into()),
        closed => {
            let outcome = ran?;
            closed?;
            outcome
        }
    };
    Ok((outcome.unwrap_or(RunOutcome::Complete), plan))
}

/// The socket for commands; a run continues without it.
fn listener(db: &Path) -> Option<Listener> {
    Listener::new(db)
        .inspect_err(|error| {
            say!("`metasense control` cannot reach this run: the socket beside its database cannot be created: {error}")
        })
        .ok()
}

/// Returns a function that reloads the spec, or the reason why it must not.
fn reread(plan: &Plan, how: &RunConfig) -> Arc<Reread> {
    let (spec, name) = (how.spec.clone(), plan.spec.name.clone());
    let (fixed, asks) = (how.fixed, plan.spec.until.is_some());
    Arc::new(move || {
        if let Some(why) = fixed {
            return Err(why.into());
        }
        if spec.file.metadata().is_ok_and(|file| !file.is_file()) {
            let file = spec.file.display();
            return Err(format!("{file} is not a regular file: write the spec to one, and run that"));
        }
        let plan = spec.plan().map_err(|error| chain(&error))?;
        plan.check_memory().map_err(|error| chain(&error))?;
        if asks || plan.spec.until.is_some() {
            return Err(
                "[until] decides which trials are run: stop the run, then resume it with the edited spec"
                    .into(),
            );
        }
        if plan.spec.name != name {
            return Err(format!("name = {:?}: must be {name:?}, the name of the run", plan.spec.name));
        }
        Ok(plan)
    })
}

/// State for running trials of a plan.
pub(super) struct Round<'a> {
    store: &'a mut Store,
    plan: &'a Plan,
    shard: Option<Shard>,
    log: &'a Path,
    signals: &'a mut Signals,
    control: &'a Control,
    /// Includes the changes that users have made.
    options: &'a mut Options,
    asked: &'a Notify,
    /// Whether the user has asked for the end.
    stopping: bool,
}

/// Runs all trials of a plan; with [until], those that its questions need.
async fn run_plan(round: Round<'_>, again: RerunPolicy) -> Result<Option<RunOutcome>, Error> {
    match round.plan.spec.until {
        None => all(round, again).await,
        Some(_) => rounds(round, again).await,
    }
}

/// Runs all trials of a plan.
async fn all(mut round: Round<'_>, again: RerunPolicy) -> Result<Option<RunOutcome>, Error> {
    round.run(&round.plan.trials, again).await
}

impl Runs for Round<'_> {
    type Error = Error;

    fn plan(&self) -> &Plan {
        self.plan
    }

    fn database(&self) -> &Path {
        self.store.path()
    }

    fn workers(&self) -> u32 {
        self.options.settings.workers
    }

    async fn trial_results(&mut self) -> Result<Vec<TrialErrors>, Error> {
        Ok(self.store.trial_errors().await?)
    }

    async fn reopen(&mut self, hashes: &[&str], again: RerunPolicy) -> Result<(), Error> {
        Ok(engine::reopen(self.store, hashes, again).await?)
    }

    async fn run(
        &mut self,
        trials: &[PlannedTrial],
        again: RerunPolicy,
    ) -> Result<Option<RunOutcome>, Error> {
        let Self { store, plan, shard, log, signals, control, options, asked, .. } = self;
        let sweep = (&plan.spec, &*plan.source.text);
        let Some(open) = engine::begin(store, sweep, trials, again, signals).await? else {
            say!("stopped before the first trial; the same command starts the run");
            return Ok(Some(RunOutcome::Interrupted));
        };
        let (ours, workers, threads) = (open.len(), options.settings.workers, options.threads);
        let planned = RunPlan {
            shard: shard.map_or((1, 1), |shard| (shard.index(), shard.count())),
            workers: (workers, threads),
            trials: ours,
            estimated_seconds: cost::seconds_on(&open, workers, threads),
        };
        if open.is_empty() {
            // A shard without work records a run, so that it does not count as missing.
            if shard.is_some() {
                let run = store.begin_run(&planned).await?;
                store.end_run(&run, name(RunOutcome::Complete), 0, 0).await?;
            }
            say!("nothing left to do: {} settled", counted(trials.len(), "trial"));
            return Ok(None);
        }
        log::start(log)?;
        let run = store.begin_run(&planned).await?;
        let mut live = Live::new(ours, trials.len() - ours, workers, asked, plan.spec.sweep.keys());
        let work = |trial: &PlannedTrial| serde_json::to_string(&trial.spec).expect("a trial is JSON");
        let ended = engine::run(store, &open, &work, options, signals, control, &mut live).await;
        let noted = match &ended {
            Ok(summary) => {
                store.end_run(&run, name(summary.outcome), summary.view.done, summary.view.failed).await
            }
            Err(EngineError::NoWorkers(_) | EngineError::Short(_)) => {
                store.end_run(&run, name(RunOutcome::NoWorkers), 0, 0).await
            }
            Err(_) => Ok(()),
        };
        let summary = ended?;
        noted?;
        (options.settings.workers, options.settings.paused) = (summary.view.workers, summary.view.paused);
        self.stopping = summary.stopping;
        Ok(Some(summary.outcome))
    }

    fn is_stopping(&self) -> bool {
        self.stopping
    }

    fn say(&self, line: &str) {
        say!("{line}");
    }
}

/// The name of an outcome in the database.
fn name(outcome: RunOutcome) -> &'static str {
    match outcome {
        RunOutcome::Complete => "complete",
        RunOutcome::Interrupted => "interrupted",
        RunOutcome::StoreBroken => "store_broken",
        RunOutcome::NoWorkers => "no_workers",
        RunOutcome::Unfit(_) => "unfit",
    }
}

/// Prints the table and the database; returns the exit code.
pub(super) async fn end(
    results: Results<'_>,
    plan: &Plan,
    format: Format,
    outcome: RunOutcome,
) -> Result<Exit, Error> {
    let db = results.named.display();
    let printed = print_results(results, plan, format).await;
    let exit = exit_of(&outcome, printed.map(|failed| if failed > 0 { Exit::Failed } else { Exit::Done }))?;
    say!("database: {db}");
    Ok(exit)
}

/// The exit code of a stopped run, even if its output could not be printed; else that of its output.
pub(super) fn exit_of(outcome: &RunOutcome, printed: Result<Exit, Error>) -> Result<Exit, Error> {
    let early = match outcome {
        RunOutcome::Interrupted => Some(Exit::Interrupted),
        RunOutcome::Unfit(_) => Some(Exit::Unfit),
        _ => None,
    };
    match (printed, early) {
        (Err(error @ Error::Output(_)), Some(early)) => {
            error.say();
            Ok(early)
        }
        (printed, early) => printed.map(|exit| early.unwrap_or(exit)),
    }
}

/// The command line overrides the spec, which overrides the defaults of the machine.
fn options(run: &Run, args: &Running) -> Options {
    let cores = super::cores();
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
            memory_limited: run.memory.is_some(),
            grace: millis(args.grace.or(run.grace).unwrap_or(GRACE)),
        },
        threads: threads as u32,
        niceness: run.niceness.unwrap_or(0).into(),
        memory_mib: run.memory,
        program: PathBuf::from("/proc/self/exe"),
    }
}

/// Default limit for the silence of a worker (s). Signs of life are seconds apart, or minutes on a machine short of cores.
const PATIENCE: f64 = 600.0;
