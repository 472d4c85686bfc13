//! `submit`: a sweep as shards on a cluster, with the merge behind them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::named::Spec;
use super::{Error, duration, make_folder, write};
use crate::cluster::home::{SUBMITTED_SPEC, attempts};
use crate::cluster::queue::{self, Job, Notes};
use crate::cluster::state::{State, states};
use crate::cluster::submit::{Scheduler, Submission, estimate, line, planned, seconds};
use crate::cluster::{Assignment, Shard, ranges};
use crate::exit::Exit;
use crate::plan::{Plan, counted};

/// Submits a sweep to Slurm or HyperQueue as shards, with a merge behind them
///
/// A shard is an ordinary run on one node; they are merged when all have ended. Leave the spec unchanged until then.
/// Called again, it submits the shards that are not complete; they go on from where they were.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The cluster's scheduler
    scheduler: Scheduler,
    #[command(flatten)]
    spec: Spec,
    /// Shards; by default so many that each takes half of its time limit, by estimate
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(Shard::MOST)))]
    shards: Option<u32>,
    /// Cores of a shard
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1024))]
    cpus: u32,
    /// Time limit of a shard: minutes, H:MM:SS or D-HH:MM:SS
    #[arg(long, value_name = "TIME", default_value = "4:00:00", value_parser = seconds)]
    time: u64,
    /// Slurm's partition
    #[arg(long, value_name = "NAME")]
    partition: Option<String>,
    /// Where scripts, outputs and databases of shards go; by default results/NAME.shards
    #[arg(long, value_name = "DIR")]
    out_dir: Option<PathBuf>,
    /// The merged database; by default results/NAME.sqlite
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Runs failed trials again, from their last step
    #[arg(long)]
    retry_failed: bool,
    /// Prints scripts and commands; writes and submits nothing
    #[arg(long)]
    dry_run: bool,
    /// Options for sbatch or `hq submit`, for instance --account=NAME
    #[arg(last = true, value_name = "OPTIONS")]
    further: Vec<String>,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let plan = args.spec.plan()?;
    super::run::not_in_shards(&plan)?;
    if args.partition.is_some() && args.scheduler == Scheduler::Hq {
        return Err(Error::Usage("--partition: HyperQueue has none; leave it out".into()));
    }
    let results = Path::new("results");
    let folder = args.out_dir.clone().unwrap_or_else(|| results.join(format!("{}.shards", plan.spec.name)));
    let jobs = submitted(&folder)?;
    let before = shards_of(&folder, &jobs);
    let shards = match (args.shards, before) {
        (Some(asked), Some(before)) if asked != before => {
            return Err(Error::Usage(format!(
                "--shards {asked}: {} holds shards of {before}; leave --shards out to go on with them, or merge them \
                 and choose another --out-dir",
                folder.display()
            )));
        }
        (asked, before) => asked.or(before).unwrap_or_else(|| planned(&plan.trials, args.cpus, args.time)),
    };
    let mut assignment = Assignment::in_folder(&folder, &plan.trials, shards)?;
    assignment.keep(&plan.trials);
    // In this order: what ends in between has been handed in when that is looked at.
    let queue = queue::ask(&jobs)?;
    let states = states(&folder, &assignment, &HashMap::new()).await;
    let failed: Vec<&State> = states.iter().filter(|state| state.failed() > 0).collect();
    if !failed.is_empty() && !args.retry_failed {
        let trials = counted(failed.iter().map(|state| state.failed()).sum(), "trial");
        let shards: Vec<u32> = failed.iter().map(|state| state.shard.index()).collect();
        say!("{trials} of shards {} failed: --retry-failed runs them again", ranges(&shards));
    }
    let open = |state: &&State| !state.is_settled() || args.retry_failed && state.failed() > 0;
    let (queued, which): (Vec<u32>, Vec<u32>) = states
        .iter()
        .filter(open)
        .map(|state| state.shard.index())
        .partition(|shard| queue.shards.contains_key(shard));
    if !queued.is_empty() {
        say!("running or waiting already, and left out: shards {}", ranges(&queued));
    }
    if which.is_empty() && !queued.is_empty() {
        say!("nothing to submit; metasense status --cluster {} says how they are", folder.display());
        return Ok(Exit::Done);
    }
    if which.is_empty() {
        say!(
            "nothing left to do: all {shards} shards are settled; metasense merge {} --out FILE",
            folder.display()
        );
        return Ok(Exit::Done);
    }
    let threads = plan.spec.run.threads.unwrap_or(1).clamp(1, args.cpus as usize) as u32;
    let absolute = |path: &Path| std::path::absolute(path).map_err(Error::io("finding", path));
    let program = std::env::current_exe().map_err(Error::io("finding", "/proc/self/exe"))?;
    let submission = Submission {
        scheduler: args.scheduler,
        name: plan.spec.name.clone(),
        program,
        spec: absolute(&args.spec.file)?,
        changes: args.spec.changes.clone(),
        folder: absolute(&folder)?,
        out: absolute(&args.out.clone().unwrap_or_else(|| plan.default_database()))?,
        shards,
        which,
        cpus: args.cpus,
        threads,
        seconds: args.time,
        partition: args.partition.clone(),
        retry_failed: args.retry_failed,
        further: args.further.clone(),
    };
    if let Some(unfit) = submission.unfit() {
        return Err(Error::Usage(format!("{unfit}; it would stand in a script")));
    }
    say(&plan, &assignment, &submission);
    match args.dry_run {
        true => print(&submission)?,
        false => submit(&plan, &assignment, &submission, &queue.jobs)?,
    }
    Ok(Exit::Done)
}

/// What is going to be submitted, and how long it is thought to take.
fn say(plan: &Plan, assignment: &Assignment, submission: &Submission) {
    let Submission { shards, which, cpus, seconds, .. } = submission;
    let (mean, longest) = estimate(&plan.trials, assignment, *cpus);
    say!(
        "{} in {}, each about {} on {}, the longest {}; the time limit is {}",
        counted(plan.trials.len(), "trial"),
        counted(*shards as usize, "shard"),
        duration(mean),
        counted(*cpus as usize, "core"),
        duration(longest),
        duration(*seconds as f64)
    );
    if which.len() < *shards as usize {
        say!("{} of them are not complete: {}", which.len(), ranges(which));
    }
    if longest > *seconds as f64 {
        say!("that is more than the limit: what is cut off goes on with the next `submit`");
    }
}

fn print(submission: &Submission) -> std::io::Result<()> {
    for script in submission.scripts() {
        print_line!("# {}\n{}", submission.folder.join(script.name).display(), script.text)?;
    }
    print_line!("$ {}", line(&submission.submit_shards()))?;
    print_line!("$ {}", line(&submission.submit_merge("JOB", &[])))
}

fn submit(
    plan: &Plan,
    assignment: &Assignment,
    submission: &Submission,
    others: &[String],
) -> Result<(), Error> {
    let folder = &submission.folder;
    make_folder(folder)?;
    write(&folder.join(SUBMITTED_SPEC), &plan.source.text)?;
    assignment.write(folder)?;
    assignment.write_trials(folder, &plan.trials)?;
    for script in submission.scripts() {
        write(&folder.join(script.name), script.text)?;
    }
    let noting = Error::io("noting what was submitted in", folder);
    let mut notes = Notes::open(folder).map_err(&noting)?;
    let job = run(&submission.submit_shards())?;
    say!("submitted: job {job}, shards {}", ranges(&submission.which));
    let scheduler = match submission.scheduler {
        Scheduler::Slurm => "slurm",
        Scheduler::Hq => "hq",
    };
    let mut job = Job { scheduler: scheduler.into(), job, merge_job: None, shards: submission.shards };
    notes.note(&job).map_err(&noting)?;
    say!("metasense status --cluster {} says how they are", folder.display());
    let merge_job = run(&submission.submit_merge(&job.job, others)).inspect_err(|_| {
        let (folder, out) = (folder.display(), submission.out.display());
        say!("the shards are submitted, what merges them is not: metasense merge {folder} --out {out}");
    })?;
    say!("submitted: job {merge_job}, which merges them into {}", submission.out.display());
    job.merge_job = Some(merge_job);
    notes.note(&job).map_err(noting)
}

/// Runs a scheduler's command; the number of the job that it prints.
fn run(words: &[String]) -> Result<String, Error> {
    let output =
        Command::new(&words[0]).args(&words[1..]).output().map_err(Error::io("starting", &words[0]))?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    // Slurm: `NUMBER` or `NUMBER;CLUSTER`.
    let job = said.trim().split(';').next().unwrap_or_default();
    if output.status.success() && job.parse::<u64>().is_ok() {
        return Ok(job.to_owned());
    }
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    Err(Error::Usage(format!(
        "`{}` failed ({}): {}{}",
        line(words),
        output.status,
        said.trim(),
        errors.trim()
    )))
}

/// What was submitted from a folder.
pub(super) fn submitted(folder: &Path) -> Result<Vec<Job>, Error> {
    queue::jobs(folder).map_err(Error::io("reading what was submitted from", folder))
}

/// Of how many shards a folder holds databases, or has had some submitted.
fn shards_of(folder: &Path, jobs: &[Job]) -> Option<u32> {
    let submitted = jobs.last().map(|job| job.shards);
    submitted.or_else(|| attempts(folder).keys().next_back().map(|shard| shard.count()))
}
