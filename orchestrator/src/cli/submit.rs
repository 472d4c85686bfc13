//! `submit`: runs a sweep as shards on a cluster or on several machines, and merges them.

mod queued;
mod rounds;

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use metasense_lab::cost;

use super::named::Spec;
use super::warnings::warn_of;
use super::{Error, duration, make_folder, write};
use crate::cluster::home::{SUBMITTED_SPEC, attempts};
use crate::cluster::places::{self, HostSlot, LaunchConfig, ShardsOutcome};
use crate::cluster::queue::{self, Job, Notes};
use crate::cluster::scheduler::{QueueCommands, SchedulerName, SubmitOption};
use crate::cluster::state::{ShardState, states};
use crate::cluster::submit::{
    MERGE, QueueOptions, ShardLimits, Submission, estimate, line, planned, seconds,
};
use crate::cluster::{Assignment, Shard, ranges};
use crate::exit::Exit;
use crate::files;
use crate::plan::{Plan, PlannedTrial, counted};
use crate::reader::Reader;
use crate::signals::Signals;

/// Runs a sweep as shards on a cluster or on several machines, and merges them
///
/// A shard is an ordinary run on one node. Shards are merged when all have ended. `slurm` and `hq` put shards into a queue;
/// `local` and `ssh` run shards until all have ended. The same command resumes incomplete shards. With [until] or --goal,
/// trials depend on earlier results and are distributed in rounds: the command stays active until the answer is final.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The program that starts shards
    scheduler: SchedulerName,
    #[command(flatten)]
    spec: Spec,
    /// Number of shards; by default, each takes half of its time limit by estimate, and `local` and `ssh` have four per
    /// place. With rounds: one per place, and four for `slurm` and `hq`
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(Shard::MOST)), help_heading = "Shards")]
    shards: Option<u32>,
    #[command(flatten)]
    nodes: Nodes,
    /// Options for each shard's `run`, such as '--simd avx2 --copy-every 300'
    #[arg(long, value_name = "OPTIONS", allow_hyphen_values = true, default_value = "")]
    run: String,
    /// The folder of the shards: their scripts, outputs and databases; by default results/NAME.shards
    #[arg(long, value_name = "DIR", help_heading = "Shards")]
    folder: Option<PathBuf>,
    /// The merged database; by default results/NAME.sqlite
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Searches for the cheapest design that meets the requirement in [goal], as `design` does
    #[arg(long)]
    goal: bool,
    /// Resumes failed trials from their last step
    #[arg(long, help_heading = "Trials to repeat")]
    retry_failed: bool,
    /// Prints scripts and commands; writes and submits nothing
    #[arg(long)]
    dry_run: bool,
    /// Options for sbatch, `hq submit` or ssh: --partition=NAME --account=NAME --mem=16G. Options after a second `--` are for the merge,
    /// which otherwise gets the same options
    #[arg(last = true, value_name = "OPTIONS")]
    further: Vec<String>,
}

/// Where shards run, and how long.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Nodes")]
struct Nodes {
    /// Cores per shard
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1024))]
    cpus: u32,
    /// Time limit of a shard: minutes, H:MM:SS or D-HH:MM:SS; by default 4:00:00. At the limit, Slurm queues an unfinished
    /// shard again
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    time: Option<u64>,
    /// Largest number of simultaneous shards (not for HyperQueue); for `local` by default as many as the cores allow
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    at_most: Option<u32>,
    /// For `ssh`: a file with one host per line, followed by its number of simultaneous shards. All hosts must see the
    /// folder under the same path
    #[arg(long, value_name = "FILE", required_if_eq("scheduler", "ssh"))]
    hosts: Option<PathBuf>,
    /// Prefix of the program on a node, in shell syntax: 'apptainer exec image.sif', or 'env TMPDIR=/scratch/$USER'
    #[arg(long, value_name = "COMMAND")]
    prefix: Option<String>,
}

/// Default time limit of a shard (s).
const LIMIT: u64 = 4 * 3600;
/// Default number of shards per place, because places differ in speed.
const SHARDS_A_PLACE: usize = 4;
/// Default number of shards in a queue with rounds, each of about eight trials.
const SHARDS_OF_ROUNDS: u32 = 4;

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let mut plan = args.spec.plan()?;
    warn_of(&plan);
    args.check()?;
    let places = args.places()?;
    let folder = args.folder(&plan);
    let in_rounds = args.goal || plan.spec.until.is_some();
    let mut jobs = submitted(&folder)?;
    // Before the files are read: shards that end in between have handed in by then.
    let queue = queue::ask(&mut jobs)?;
    let earlier_count = shards_of(&folder, &jobs);
    let out = args.out(&plan);
    let settled = if in_rounds { HashMap::new() } else { settled(&out).await? };
    let is_settled = |hash: &str| settled.get(hash).is_some_and(|failed| !(*failed && args.retry_failed));
    let left_out: Vec<PlannedTrial> = plan.trials.extract_if(.., |trial| is_settled(&trial.hash)).collect();
    cost::first_trains(&mut plan.trials);
    let shards = match (args.shards, earlier_count) {
        (Some(asked), Some(earlier_count)) if asked != earlier_count => {
            return usage!(
                "--shards {asked}: {} contains a sweep of {earlier_count} shards; leave --shards out to resume them, or merge them \
                 and choose another --folder",
                folder.display()
            );
        }
        (asked, earlier_count) => asked.or(earlier_count).unwrap_or_else(|| match places.len() {
            0 if in_rounds => SHARDS_OF_ROUNDS,
            0 => planned(&plan.trials, args.nodes.cpus, args.nodes.time.unwrap_or(LIMIT)),
            places if in_rounds => places as u32,
            places => (SHARDS_A_PLACE * places).min(plan.trials.len()).max(1) as u32,
        }),
    };
    if in_rounds {
        return rounds::execute(&args, plan, places, shards, jobs, &queue).await;
    }
    if !left_out.is_empty() {
        say!("{} skipped: settled in {}", counted(left_out.len(), "trial"), out.display());
        let failed = left_out.iter().filter(|trial| settled[&trial.hash]).count();
        if failed > 0 {
            say!("{} of them failed: --retry-failed resumes them", counted(failed, "trial"));
        }
    }
    if plan.trials.is_empty() {
        say!("nothing left to do");
        return Ok(Exit::Done);
    }
    let mut assignment = Assignment::in_folder(&folder, &plan.trials, shards)?;
    assignment.keep(plan.trials.iter().chain(&left_out));
    let states = states(&folder, &assignment, &HashMap::new()).await;
    let never_begun = states.iter().flat_map(|state| &state.never).map(String::as_str);
    assignment.leave_out(&never_begun.filter(|hash| is_settled(hash)).collect());
    let failed = |state: &ShardState| state.failures.iter().filter(|hash| !is_settled(hash)).count();
    let with_failures: Vec<&ShardState> = states.iter().filter(|state| failed(state) > 0).collect();
    if !with_failures.is_empty() && !args.retry_failed {
        let trials = counted(with_failures.iter().map(|state| failed(state)).sum(), "trial");
        let shards: Vec<u32> = with_failures.iter().map(|state| state.shard.index()).collect();
        say!("{trials} of shards {} failed: --retry-failed resumes them", ranges(&shards));
    }
    let unsettled = |hashes: &[String]| hashes.iter().any(|hash| !is_settled(hash));
    // a shard that has handed in nothing still needs a database, even without trials
    let has_work = |state: &&ShardState| {
        let nothing = state.trials.is_none() && state.open.is_empty();
        nothing || unsettled(&state.open) || args.retry_failed && unsettled(&state.failures)
    };
    let open = states.iter().filter(has_work).map(|state| state.shard.index());
    let (queued, which): (Vec<u32>, Vec<u32>) = open.partition(|shard| queue.shards.contains_key(shard));
    if !queued.is_empty() {
        say!("skipped, because they are running or queued: shards {}", ranges(&queued));
    }
    // an earlier `submit` could not queue the merge
    let commands = args.scheduler.scheduler().queue();
    let merge_is_missing = commands.is_some_and(QueueCommands::has_merge_job) && !queue.has_merge(&jobs);
    if which.is_empty() && !queued.is_empty() && !merge_is_missing {
        say!("nothing to submit; metasense status --folder {} shows the shards", files::quoted(&folder));
        return Ok(Exit::Done);
    }
    if which.is_empty() && queued.is_empty() {
        say!(
            "nothing left to do: all {shards} shards are settled; metasense cluster merge {} --out FILE",
            files::quoted(&folder)
        );
        return Ok(Exit::Done);
    }
    let program = Program::of_this_process()?;
    let mut submission = Submission { which, ..args.submission(&plan, shards, &program)? };
    if !submission.which.is_empty() {
        say(&plan.trials, &assignment, &submission);
    }
    if args.dry_run {
        print(&submission)?;
        return Ok(Exit::Done);
    }
    let mut notes = prepare(&plan, &submission, &program, &queue.jobs)?;
    assignment.write(&submission.folder)?;
    assignment.write_trials(&submission.folder, &plan.trials)?;
    if let Some(commands) = commands {
        queued::submit(&mut submission, commands, &mut notes, jobs, &queue)?;
        return Ok(Exit::Done);
    }
    run_here(&submission, &places, &mut notes).await
}

/// Settled trials of a database, with whether they failed; empty if there is no database.
async fn settled(out: &Path) -> Result<HashMap<String, bool>, Error> {
    if !out.metadata().is_ok_and(|file| file.len() > 0) {
        return Ok(HashMap::new());
    }
    let sql = "SELECT hash, state = 'failed' AS failed FROM trial WHERE state IN ('done', 'failed')";
    let settled = Reader::with_reader(out, async |reader| {
        reader.rows(sql, |row| (row.text("hash").to_owned(), row.count("failed") > 0)).await
    });
    Ok(settled.await?.into_iter().collect())
}

impl Args {
    fn folder(&self, plan: &Plan) -> PathBuf {
        let named = || Path::new("results").join(format!("{}.shards", plan.spec.name));
        self.folder.clone().unwrap_or_else(named)
    }

    fn out(&self, plan: &Plan) -> PathBuf {
        self.out.clone().unwrap_or_else(|| plan.default_database())
    }

    fn submission(&self, plan: &Plan, shards: u32, program: &Program) -> Result<Submission, Error> {
        let threads = plan.spec.run.threads.unwrap_or(1).clamp(1, self.nodes.cpus as usize) as u32;
        let absolute = |path: &Path| std::path::absolute(path).map_err(Error::io("finding", path));
        let further = match self.further.iter().position(|word| word == "--") {
            Some(at) => [&self.further[..at], &self.further[at + 1..]],
            None => [&self.further[..]; 2],
        };
        let [for_shards, for_merge] = further.map(<[String]>::to_vec);
        let scheduler = self.scheduler.scheduler();
        let most_index = scheduler.queue().map_or(Shard::MOST, QueueCommands::most_index);
        let (cpus, seconds, grace) = (self.nodes.cpus, self.nodes.time.unwrap_or(LIMIT), plan.spec.run.grace);
        let again = self.retry_failed.then_some("--retry-failed");
        let folder = absolute(&self.folder(plan))?;
        let submission = Submission {
            scheduler,
            name: plan.spec.name.clone(),
            program: folder.join(&program.name),
            prefix: self.nodes.prefix.clone(),
            out: absolute(&self.out(plan))?,
            folder,
            shards,
            which: (1..=shards).collect(),
            limits: ShardLimits { cpus, threads, seconds, grace },
            merges: true,
            queue: QueueOptions {
                cluster: None,
                at_most: self.nodes.at_most,
                for_shards,
                for_merge,
                most_index,
            },
            run: self.run.split_whitespace().chain(again).map(str::to_owned).collect(),
        };
        if let Some(unfit) = submission.unfit() {
            return usage!("{unfit}, because it is written into a script");
        }
        let (notice, limit) = (submission.notice(), submission.limits.seconds);
        if submission.has_queue() && submission.limits.grace.is_some() && notice >= limit {
            return Err(plan
                .source
                .error("run.grace", &format!("a shard is stopped {notice} s before its time limit of {limit} s: lower it, or raise --time"))
                .into());
        }
        let first = format!("{}", submission.which[0]);
        let words = [&["metasense".to_owned()][..], &submission.run_words(&first, None)].concat();
        super::command().try_get_matches_from(words).map_err(|error| {
            let what = error.to_string();
            Error::Usage(format!("--run {:?}: {}", self.run, what.lines().next().unwrap_or_default()))
        })?;
        Ok(submission)
    }

    /// Refuses options that the scheduler does not have, and a scheduler that is not installed.
    fn check(&self) -> Result<(), Error> {
        let scheduler = self.scheduler.scheduler();
        let for_merge = self.further.iter().any(|word| word == "--");
        let given = [
            (SubmitOption::Time, "time", self.nodes.time.is_some()),
            (SubmitOption::AtMost, "at-most", self.nodes.at_most.is_some()),
            (SubmitOption::Hosts, "hosts", self.nodes.hosts.is_some()),
            (SubmitOption::Further, "further options", !self.further.is_empty()),
            (SubmitOption::FurtherForMerge, "further options after a second --", for_merge),
        ];
        for (option, name, _) in given.into_iter().filter(|(.., is_given)| *is_given) {
            if let Some(why) = scheduler.refusal(option) {
                return usage!("--{name}: {why}; leave it out");
            }
        }
        let program = scheduler.program();
        if !self.dry_run && !files::is_in_path(program) {
            return usage!(
                "cluster submit {}: `{program}` is not in PATH; use a machine that has it, or run the shards here: `metasense cluster submit \
                 local`",
                scheduler.name()
            );
        }
        Ok(())
    }

    /// Places for shards; none if a scheduler has a queue.
    fn places(&self) -> Result<Vec<HostSlot>, Error> {
        let most = self.nodes.at_most.unwrap_or(u32::MAX) as usize;
        match (self.scheduler, &self.nodes.hosts) {
            (SchedulerName::Local, _) => {
                let cores = super::cores();
                let count = self
                    .nodes
                    .at_most
                    .map_or((cores / self.nodes.cpus as usize).max(1), |most| most as usize);
                Ok(vec![None; count])
            }
            (SchedulerName::Ssh, Some(file)) => {
                let text = std::fs::read_to_string(file).map_err(Error::unreadable(file))?;
                let wrong = |why| Error::Usage(format!("{}:{why}", file.display()));
                let mut places = places::places(&text).map_err(wrong)?;
                if places.is_empty() {
                    return Err(wrong(" contains no host".into()));
                }
                places.truncate(most);
                Ok(places)
            }
            _ => Ok(Vec::new()),
        }
    }
}

/// The copy of this program in the folder; each build has its own file name.
struct Program {
    name: String,
}

impl Program {
    const SELF: &str = "/proc/self/exe";
    const STEM: &str = "metasense-";

    fn of_this_process() -> Result<Self, Error> {
        let mut hasher = blake3::Hasher::new();
        let file = File::open(Self::SELF).map_err(Error::io("reading", Self::SELF))?;
        hasher.update_reader(file).map_err(Error::io("reading", Self::SELF))?;
        Ok(Self { name: format!("{}{}", Self::STEM, &hasher.finalize().to_hex()[..8]) })
    }

    /// Copies and tests the program. If `alone`, removes other builds, which no job needs.
    fn put(&self, folder: &Path, alone: bool) -> Result<(), Error> {
        let path = folder.join(&self.name);
        if !path.exists() {
            files::copy(Path::new(Self::SELF), &path).map_err(Error::io("writing", &path))?;
        }
        let tried = Command::new(&path).arg("--version").stdout(Stdio::null()).status();
        match tried {
            Ok(status) if status.success() => {}
            Err(e) if e.kind() == ErrorKind::PermissionDenied => {
                return usage!(
                    "{}: programs cannot be started there, because its disk is mounted noexec: choose another --folder",
                    folder.display()
                );
            }
            Err(e) => return Err(Error::io("starting", &path)(e)),
            Ok(status) => return Err(Error::io("starting", &path)(io::Error::other(status.to_string()))),
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

/// Prints what will be submitted, with estimated times.
fn say(trials: &[PlannedTrial], assignment: &Assignment, submission: &Submission) {
    let Submission { shards, which, limits: ShardLimits { cpus, seconds, .. }, .. } = submission;
    let (mean, longest) = estimate(trials, assignment, *cpus);
    let limit = match submission.has_queue() {
        true => format!("; the time limit is {}", duration(*seconds as f64)),
        false => String::new(),
    };
    let (all, of) = (counted(trials.len(), "trial"), counted(*shards as usize, "shard"));
    let (cores, mean, most) = (counted(*cpus as usize, "core"), duration(mean), duration(longest));
    say!("{all} in {of}, each about {mean} on {cores}, the longest {most}{limit}");
    if which.len() < *shards as usize {
        say!("{} of them are incomplete: {}", which.len(), ranges(which));
    }
    if let Some(commands) = submission.scheduler.queue().filter(|_| longest > *seconds as f64) {
        say!("this exceeds the limit: an interrupted shard {}", commands.after_limit());
    }
}

/// Prints scripts and commands; with rounds, those of the first round, without the merge.
fn print(submission: &Submission) -> io::Result<()> {
    for script in submission.scripts().into_iter().filter(|script| submission.merges || script.name != MERGE)
    {
        print_line!("# {}\n{}", submission.folder.join(script.name).display(), script.text)?;
    }
    if let Some(commands) = submission.scheduler.queue() {
        for array in submission.arrays() {
            let name = format!("{}.MARK", submission.name);
            print_line!("$ {}", line(&commands.submit_shards(submission, &array, &name)))?;
        }
        let merge = commands.submit_merge(submission, &["JOB".to_owned()]);
        if let Some(merge) = merge.filter(|_| submission.merges) {
            print_line!("$ {}", line(&merge))?;
        }
    }
    Ok(())
}

/// Writes the files that shards need into the folder, which is then locked against other `submit`s.
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

/// Notes that this process runs the shards.
fn note_here(submission: &Submission, notes: &mut Notes) -> Result<(), Error> {
    let Submission { folder, shards, .. } = submission;
    let (scheduler, job) = (submission.scheduler.name().into(), files::own_mark());
    let job = Job { scheduler, job, shards: *shards, ..Job::default() };
    notes.note(&job).map_err(Error::io("noting what is run in", folder))?;
    say!("metasense status --folder {} shows the shards; Ctrl-C stops all of them", files::quoted(folder));
    Ok(())
}

fn launch_config(submission: &Submission) -> LaunchConfig {
    let Submission { folder, shards, queue, .. } = submission;
    let (folder, options) = (folder.clone(), queue.for_shards.clone());
    LaunchConfig { folder, shards: *shards, options, grace: submission.grace() }
}

/// Runs the shards, then merges their databases.
async fn run_here(submission: &Submission, places: &[HostSlot], notes: &mut Notes) -> Result<Exit, Error> {
    let Submission { folder, which, .. } = submission;
    let mut signals = Signals::new()?;
    note_here(submission, notes)?;
    let ended =
        places::run(places, which, &launch_config(submission), &mut signals, |line| say!("{line}")).await;
    if attempts(folder).is_empty() && !ended.asked {
        return Err(Error::Shards { folder: folder.clone(), shards: ranges(&ended.unfinished) });
    }
    let merged = match attempts(folder).is_empty() {
        true => Exit::Done,
        false => super::merge::execute(super::merge::Args::folder(folder, &submission.out)).await?,
    };
    if !ended.unfinished.is_empty() {
        say!("left: shards {}; the same command resumes them", ranges(&ended.unfinished));
    }
    Ok(match ended {
        ShardsOutcome { asked: true, .. } => Exit::Interrupted,
        ShardsOutcome { deserted: true, .. } => Exit::Unfit,
        ShardsOutcome { failed: true, .. } => Exit::Failed,
        ShardsOutcome { unfinished: left, .. } if !left.is_empty() => Exit::Failed,
        _ => merged,
    })
}

/// Jobs submitted from a folder.
pub(super) fn submitted(folder: &Path) -> Result<Vec<Job>, Error> {
    queue::jobs(folder).map_err(Error::io("reading what was submitted from", folder))
}

/// Number of shards in the jobs or databases of a folder.
fn shards_of(folder: &Path, jobs: &[Job]) -> Option<u32> {
    let submitted = jobs.last().map(|job| job.shards);
    submitted.or_else(|| attempts(folder).keys().next_back().map(|shard| shard.count()))
}
