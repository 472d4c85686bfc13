//! `submit`: a sweep as shards on a cluster or on some machines, with the merge behind them.

mod rounds;

use std::collections::HashMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::named::Spec;
use super::{Error, duration, make_folder, write};
use crate::cluster::home::{SUBMITTED_SPEC, attempts};
use crate::cluster::places::{self, Ended, How, Place};
use crate::cluster::queue::{self, Job, Notes};
use crate::cluster::state::{State, states};
use crate::cluster::submit::{
    MAX_ARRAY_SIZE, MERGE, Scheduler, Submission, estimate, line, planned, seconds,
};
use crate::cluster::{Assignment, Shard, ranges};
use crate::engine::Signals;
use crate::exit::Exit;
use crate::files;
use crate::plan::{Plan, Trial, counted};

/// Runs a sweep as shards, on a cluster or on some machines, and merges them
///
/// A shard is an ordinary run on one node; they are merged when all have ended. `slurm` and `hq` queue them; `local` and `ssh` run
/// them and end with them. Called again, it goes on with the shards that are not complete. With [until] or --design trials are dealt
/// round by round, by what earlier ones have come to: it stays until the answer stands.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Who starts shards
    scheduler: Scheduler,
    #[command(flatten)]
    spec: Spec,
    /// Shards; by default so many that each takes half of its time limit, by estimate, and four a place for `local` and `ssh`; of
    /// rounds one a place, and four for `slurm` and `hq`
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(Shard::MOST)))]
    shards: Option<u32>,
    /// Cores of a shard
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1024))]
    cpus: u32,
    /// Time limit of a shard: minutes, H:MM:SS or D-HH:MM:SS; by default 4:00:00. At its end a shard queues again by itself (Slurm)
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    time: Option<u64>,
    /// Shards at a time (not for HyperQueue); `local`: by default as many as there are cores for
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    at_most: Option<u32>,
    /// Of `ssh`: a host a line, with how many shards it may have at a time behind it; all see the folder by the same path
    #[arg(long, value_name = "FILE", required_if_eq("scheduler", "ssh"))]
    hosts: Option<PathBuf>,
    /// Slurm's partition
    #[arg(long, value_name = "NAME")]
    partition: Option<String>,
    /// What goes before the program on a node, as a shell reads it: 'apptainer exec image.sif', or 'env TMPDIR=/scratch/$USER'
    #[arg(long, value_name = "COMMAND")]
    prefix: Option<String>,
    /// Options for each shard's `run`, for instance '--simd avx2 --copy-every 300'
    #[arg(long, value_name = "OPTIONS", allow_hyphen_values = true, default_value = "")]
    run: String,
    /// Where scripts, outputs and databases of shards go; by default results/NAME.shards
    #[arg(long, value_name = "DIR")]
    out_dir: Option<PathBuf>,
    /// The merged database; by default results/NAME.sqlite
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Searches for the cheapest design that meets the requirement in [goal], as `design` does
    #[arg(long)]
    design: bool,
    /// Runs failed trials again, from their last step
    #[arg(long)]
    retry_failed: bool,
    /// Prints scripts and commands; writes and submits nothing
    #[arg(long)]
    dry_run: bool,
    /// Options for sbatch, `hq submit` or ssh: --account=NAME --mem=16G. Behind a second `--` those for the merge, else the same
    #[arg(last = true, value_name = "OPTIONS")]
    further: Vec<String>,
}

/// Time limit of a shard where none is given (s).
const LIMIT: u64 = 4 * 3600;
/// Shards a place, where places differ and nobody says how many.
const SHARDS_A_PLACE: usize = 4;
/// Shards of a queue, where trials are dealt round by round: a round is some eight trials.
const SHARDS_OF_ROUNDS: u32 = 4;

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let plan = args.spec.plan()?;
    args.check()?;
    let places = args.places()?;
    let folder = args.folder(&plan);
    let in_rounds = args.design || plan.spec.until.is_some();
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
        (asked, before) => asked.or(before).unwrap_or_else(|| match places.len() {
            0 if in_rounds => SHARDS_OF_ROUNDS,
            0 => planned(&plan.trials, args.cpus, args.time.unwrap_or(LIMIT)),
            places if in_rounds => places as u32,
            places => (SHARDS_A_PLACE * places).min(plan.trials.len()) as u32,
        }),
    };
    if in_rounds {
        return rounds::execute(&args, plan, places, shards, jobs).await;
    }
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
    let program = Program::own()?;
    let submission = Submission { which, ..args.submission(&plan, shards, &program)? };
    say(&plan, &assignment, &submission);
    if args.dry_run {
        print(&submission, false)?;
        return Ok(Exit::Done);
    }
    let mut notes = prepare(&plan, &submission, &program, &queue.jobs)?;
    deal(&assignment, &submission.folder, &plan.trials)?;
    if args.scheduler.has_queue() {
        submit(&submission, &mut notes, &queue.jobs)?;
        return Ok(Exit::Done);
    }
    run_here(&submission, &places, &mut notes).await
}

impl Args {
    /// Where shards go.
    fn folder(&self, plan: &Plan) -> PathBuf {
        let named = || Path::new("results").join(format!("{}.shards", plan.spec.name));
        self.out_dir.clone().unwrap_or_else(named)
    }

    /// All shards.
    fn submission(&self, plan: &Plan, shards: u32, program: &Program) -> Result<Submission, Error> {
        let threads = plan.spec.run.threads.unwrap_or(1).clamp(1, self.cpus as usize) as u32;
        let absolute = |path: &Path| std::path::absolute(path).map_err(Error::io("finding", path));
        let [for_shards, for_merge] = match self.further.iter().position(|word| word == "--") {
            Some(at) => [&self.further[..at], &self.further[at + 1..]],
            None => [&self.further[..]; 2],
        };
        let again = self.retry_failed.then_some("--retry-failed");
        let folder = absolute(&self.folder(plan))?;
        let submission = Submission {
            scheduler: self.scheduler,
            name: plan.spec.name.clone(),
            program: folder.join(&program.name),
            prefix: self.prefix.clone(),
            out: absolute(&self.out.clone().unwrap_or_else(|| plan.default_database()))?,
            folder,
            shards,
            which: (1..=shards).collect(),
            cpus: self.cpus,
            threads,
            seconds: self.time.unwrap_or(LIMIT),
            at_most: self.at_most,
            partition: self.partition.clone(),
            run: self.run.split_whitespace().chain(again).map(str::to_owned).collect(),
            for_shards: for_shards.to_vec(),
            for_merge: for_merge.to_vec(),
            most_index: match self.scheduler {
                Scheduler::Slurm => queue::max_array_size().unwrap_or(MAX_ARRAY_SIZE) - 1,
                _ => Shard::MOST,
            },
        };
        if let Some(unfit) = submission.unfit() {
            return Err(Error::Usage(format!("{unfit}; it would stand in a script")));
        }
        let first = format!("{}", submission.which[0]);
        let words = [&["metasense".to_owned()][..], &submission.run_words(&first, None)].concat();
        super::command().try_get_matches_from(words).map_err(|error| {
            let what = error.to_string();
            Error::Usage(format!("--run {:?}: {}", self.run, what.lines().next().unwrap_or_default()))
        })?;
        Ok(submission)
    }

    /// Options that whoever starts the shards has not.
    fn check(&self) -> Result<(), Error> {
        let given = |name: &str, is_given: bool, fits: bool, why: &str| match is_given && !fits {
            true => Err(Error::Usage(format!("--{name}: {why}; leave it out"))),
            false => Ok(()),
        };
        let (slurm, hq) = (self.scheduler == Scheduler::Slurm, self.scheduler == Scheduler::Hq);
        given("partition", self.partition.is_some(), slurm, "only Slurm has them")?;
        given("time", self.time.is_some(), slurm || hq, "shards run here without a limit")?;
        given(
            "at-most",
            self.at_most.is_some(),
            !hq,
            "HyperQueue starts as many as its workers have room for",
        )?;
        given("hosts", self.hosts.is_some(), self.scheduler == Scheduler::Ssh, "it is for `submit ssh`")?;
        given(
            "further options",
            !self.further.is_empty(),
            self.scheduler != Scheduler::Local,
            "there is nobody to have them",
        )
    }

    /// Room for shards, where no scheduler has it.
    fn places(&self) -> Result<Vec<Place>, Error> {
        let most = self.at_most.unwrap_or(u32::MAX) as usize;
        match (self.scheduler, &self.hosts) {
            (Scheduler::Local, _) => {
                let cores = std::thread::available_parallelism().map_or(1, usize::from);
                let count = self.at_most.map_or((cores / self.cpus as usize).max(1), |most| most as usize);
                Ok(vec![None; count])
            }
            (Scheduler::Ssh, Some(file)) => {
                let text = std::fs::read_to_string(file).map_err(Error::unreadable(file))?;
                let wrong = |why| Error::Usage(format!("{}:{why}", file.display()));
                let mut places = places::places(&text).map_err(wrong)?;
                if places.is_empty() {
                    return Err(wrong(" it names no host".into()));
                }
                places.truncate(most);
                Ok(places)
            }
            _ => Ok(Vec::new()),
        }
    }
}

/// This program, as it is copied to the folder: a build of the same name is another file.
struct Program {
    name: String,
}

impl Program {
    const SELF: &str = "/proc/self/exe";
    const STEM: &str = "metasense-";

    fn own() -> Result<Self, Error> {
        let mut hasher = blake3::Hasher::new();
        let file = File::open(Self::SELF).map_err(Error::io("reading", Self::SELF))?;
        hasher.update_reader(file).map_err(Error::io("reading", Self::SELF))?;
        Ok(Self { name: format!("{}{}", Self::STEM, &hasher.finalize().to_hex()[..8]) })
    }

    /// Copies it, where that has not been done; others go, where nothing can still want them.
    fn put(&self, folder: &Path, alone: bool) -> Result<(), Error> {
        let path = folder.join(&self.name);
        if !path.exists() {
            files::copy(Path::new(Self::SELF), &path).map_err(Error::io("writing", &path))?;
        }
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten().filter(|_| alone) {
            let name = entry.file_name();
            if name.to_string_lossy().starts_with(Self::STEM) && name != *self.name {
                let _ = std::fs::remove_file(entry.path());
            }
        }
        Ok(())
    }
}

/// What is going to be submitted, and how long it is thought to take.
fn say(plan: &Plan, assignment: &Assignment, submission: &Submission) {
    let Submission { shards, which, cpus, seconds, .. } = submission;
    let (mean, longest) = estimate(&plan.trials, assignment, *cpus);
    say!(
        "{} in {}, each about {} on {}, the longest {}{}",
        counted(plan.trials.len(), "trial"),
        counted(*shards as usize, "shard"),
        duration(mean),
        counted(*cpus as usize, "core"),
        duration(longest),
        match submission.scheduler.has_queue() {
            true => format!("; the time limit is {}", duration(*seconds as f64)),
            false => String::new(),
        }
    );
    if which.len() < *shards as usize {
        say!("{} of them are not complete: {}", which.len(), ranges(which));
    }
    if longest > *seconds as f64 && submission.scheduler.has_queue() {
        let then = match submission.scheduler {
            Scheduler::Slurm => "queues again by itself",
            _ => "goes on with the next `submit`",
        };
        say!("that is more than the limit: what is cut off {then}");
    }
}

/// Scripts and commands; of rounds those of the first, without a merge behind them.
fn print(submission: &Submission, in_rounds: bool) -> std::io::Result<()> {
    for script in submission.scripts().into_iter().filter(|script| !in_rounds || script.name != MERGE) {
        print_line!("# {}\n{}", submission.folder.join(script.name).display(), script.text)?;
    }
    if submission.scheduler.has_queue() {
        for array in submission.arrays() {
            print_line!("$ {}", line(&submission.submit_shards(&array)))?;
        }
        if !in_rounds {
            print_line!("$ {}", line(&submission.submit_merge(&["JOB".to_owned()])))?;
        }
    }
    Ok(())
}

/// Writes what shards need into the folder. From then on no other `submit` may.
fn prepare(
    plan: &Plan,
    submission: &Submission,
    program: &Program,
    others: &[String],
) -> Result<Notes, Error> {
    let folder = &submission.folder;
    make_folder(folder)?;
    let notes = Notes::open(folder).map_err(Error::io("noting what is submitted in", folder))?;
    write(&folder.join(SUBMITTED_SPEC), &plan.source.text)?;
    program.put(folder, others.is_empty())?;
    for script in submission.scripts() {
        write(&folder.join(script.name), script.text)?;
    }
    Ok(notes)
}

/// Says which trials are whose.
fn deal(assignment: &Assignment, folder: &Path, trials: &[Trial]) -> Result<(), Error> {
    assignment.write(folder)?;
    Ok(assignment.write_trials(folder, trials)?)
}

/// Queues shards.
fn submit_shards(submission: &Submission, notes: &mut Notes) -> Result<Vec<Job>, Error> {
    let noting = Error::io("noting what was submitted in", &submission.folder);
    let mut jobs = Vec::new();
    for array in submission.arrays() {
        let number = run(&submission.submit_shards(&array))?;
        let shards: Vec<u32> = array.indices.iter().map(|index| array.offset + index).collect();
        say!("submitted: job {number}, shards {}", ranges(&shards));
        let scheduler = submission.scheduler.name().to_owned();
        let (shards, offset) = (submission.shards, array.offset);
        jobs.push(Job { scheduler, job: number, merge_job: None, shards, offset });
        notes.note(jobs.last().expect("there is one")).map_err(&noting)?;
    }
    Ok(jobs)
}

/// Queues shards, and the merge behind them.
fn submit(submission: &Submission, notes: &mut Notes, others: &[String]) -> Result<(), Error> {
    let folder = &submission.folder;
    let noting = Error::io("noting what was submitted in", folder);
    let mut jobs = submit_shards(submission, notes)?;
    say!("metasense status --cluster {} says how they are", folder.display());
    let before: Vec<String> = jobs.iter().map(|job| job.job.clone()).chain(others.iter().cloned()).collect();
    let merge_job = run(&submission.submit_merge(&before)).inspect_err(|_| {
        let (folder, out) = (folder.display(), submission.out.display());
        say!("the shards are submitted, what merges them is not: metasense merge {folder} --out {out}");
    })?;
    say!("submitted: job {merge_job}, which merges them into {}", submission.out.display());
    for job in &mut jobs {
        job.merge_job = Some(merge_job.clone());
        notes.note(job).map_err(&noting)?;
    }
    Ok(())
}

/// Notes that shards are run from here.
fn note_here(submission: &Submission, notes: &mut Notes) -> Result<(), Error> {
    let Submission { folder, shards, .. } = submission;
    let (scheduler, job) = (submission.scheduler.name().into(), files::own_mark());
    let job = Job { scheduler, job, merge_job: None, shards: *shards, offset: 0 };
    notes.note(&job).map_err(Error::io("noting what is run in", folder))?;
    say!("metasense status --cluster {} says how they are; Ctrl-C stops all of them", folder.display());
    Ok(())
}

fn how(submission: &Submission) -> How {
    How { folder: submission.folder.clone(), options: submission.for_shards.clone() }
}

/// Runs the shards, and merges what there is when they have ended.
async fn run_here(submission: &Submission, places: &[Place], notes: &mut Notes) -> Result<Exit, Error> {
    let Submission { folder, which, .. } = submission;
    let mut signals = Signals::new()?;
    note_here(submission, notes)?;
    let ended = places::run(places, which, &how(submission), &mut signals, |line| say!("{line}")).await;
    let merged = super::merge::execute(super::merge::Args::folder(folder, &submission.out)).await?;
    if !ended.left.is_empty() {
        say!("left: shards {}; the same command goes on with them", ranges(&ended.left));
    }
    Ok(match ended {
        Ended { asked: true, .. } => Exit::Interrupted,
        Ended { deserted: true, .. } => Exit::Unfit,
        Ended { failed: true, .. } => Exit::Failed,
        Ended { left, .. } if !left.is_empty() => Exit::Failed,
        _ => merged,
    })
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
