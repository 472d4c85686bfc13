//! Creates the scripts for a cluster's scheduler and the commands that submit them, without I/O.

use std::path::{Path, PathBuf};

use metasense_lab::cost;

use super::Assignment;
use super::home::SUBMITTED_SPEC;
use super::scheduler::Scheduler;
use crate::engine::GRACE;
use crate::files::quoted;
use crate::plan::PlannedTrial;

/// Time before its time limit at which a shard is stopped (s), or more if `run.grace` requires it.
pub const NOTICE: u64 = 60;
/// Part of this time for the last copy of the database (s).
const HAND_IN: u64 = 15;
/// Default wait of a shard under a scheduler for steps in progress (s).
const QUEUED_GRACE: f64 = (NOTICE - HAND_IN) as f64;
/// Most shards by default; larger numbers must be requested.
const MOST_PLANNED: u32 = 1000;
/// Name of the merge script in the folder.
pub const MERGE: &str = "merge.sh";

/// Resources of a shard.
#[derive(Debug, Clone, Copy)]
pub struct ShardLimits {
    /// Cores.
    pub cpus: u32,
    /// Threads per worker.
    pub threads: u32,
    /// Time limit (s).
    pub seconds: u64,
    /// Longest wait for steps in progress after a stop (s), if given.
    pub grace: Option<f64>,
}

/// How shards are queued.
#[derive(Debug, Clone)]
pub struct QueueOptions {
    /// Slurm cluster for all jobs, if there are several.
    pub cluster: Option<String>,
    /// Most simultaneous shards, if limited.
    pub at_most: Option<u32>,
    /// Options for the command that submits shards.
    pub for_shards: Vec<String>,
    /// Options for the command that submits the merge.
    pub for_merge: Vec<String>,
    /// Largest array index.
    pub most_index: u32,
}

/// Shards to submit.
#[derive(Debug, Clone)]
pub struct Submission {
    /// The scheduler.
    pub scheduler: &'static dyn Scheduler,
    /// Name of the sweep.
    pub name: String,
    /// Copy of this program in the folder.
    pub program: PathBuf,
    /// Shell text before the program.
    pub prefix: Option<String>,
    /// Folder for scripts, spec, outputs and databases of shards.
    pub folder: PathBuf,
    /// The merged database.
    pub out: PathBuf,
    /// Number of shards of the sweep.
    pub shards: u32,
    /// Shards to submit, from 1.
    pub which: Vec<u32>,
    /// Resources of each.
    pub limits: ShardLimits,
    /// Whether a job merges the databases in the end; otherwise the submitting process does.
    pub merges: bool,
    /// How they are queued.
    pub queue: QueueOptions,
    /// Additional options of each shard's `run`.
    pub run: Vec<String>,
}

/// Shards that are submitted as one job array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobArray {
    /// Shard number = offset + index.
    pub offset: u32,
    /// Indices, from 1.
    pub indices: Vec<u32>,
}

/// A script.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Script {
    /// File name in the folder.
    pub name: &'static str,
    /// Its text.
    pub text: String,
}

/// Number of shards for which each takes half of its time limit by estimate; estimates are accurate to a factor of two.
pub fn planned(trials: &[PlannedTrial], cpus: u32, seconds: u64) -> u32 {
    let total = cost::total(trials);
    let shards = (2.0 * total / (f64::from(cpus) * seconds as f64)).ceil();
    (shards.max(1.0) as u32).min(MOST_PLANNED).min(trials.len().try_into().unwrap_or(u32::MAX))
}

/// Estimated seconds of the average and the longest shard on its cores.
pub fn estimate(trials: &[PlannedTrial], assignment: &Assignment, cpus: u32) -> (f64, f64) {
    let costs = assignment.costs(trials);
    let cores = f64::from(cpus);
    let longest_trial = trials.iter().map(PlannedTrial::seconds).fold(0.0, f64::max);
    let longest = costs.iter().fold(0.0_f64, |most, cost| most.max(cost / cores)).max(longest_trial);
    (costs.iter().sum::<f64>() / costs.len() as f64 / cores, longest)
}

impl Submission {
    /// Describes a path or prefix that scripts cannot contain, if there is one.
    pub fn unfit(&self) -> Option<String> {
        let control = |text: &str| text.chars().any(char::is_control);
        let directive = |text: &str| text.contains(self.scheduler.unfit_in_paths());
        let paths = [("folder", &self.folder), ("out", &self.out)];
        let path = paths.into_iter().find(|(name, path)| {
            path.to_str().is_none_or(|text| control(text) || *name == "folder" && directive(text))
        });
        let prefix = self.prefix.as_ref().filter(|prefix| control(prefix));
        path.map(|(name, path)| {
            format!("{name} {path:?}: must be text without line ends, quotes and backslashes")
        })
        .or_else(|| prefix.map(|prefix| format!("prefix {prefix:?}: must be text without line ends")))
    }

    /// Whether the scheduler has a queue that outlives `submit`.
    pub fn has_queue(&self) -> bool {
        self.scheduler.queue().is_some()
    }

    /// Longest wait of a stopped shard for steps in progress (s).
    pub fn grace(&self) -> f64 {
        self.limits.grace.unwrap_or(if self.has_queue() { QUEUED_GRACE } else { GRACE })
    }

    /// Time before its time limit at which a shard is stopped (s).
    pub fn notice(&self) -> u64 {
        (self.grace().ceil() as u64 + HAND_IN).max(NOTICE)
    }

    /// The scripts of shards and of the merge.
    pub fn scripts(&self) -> [Script; 2] {
        let (shard, merge) = (self.scheduler.shard_script(self), self.scheduler.merge_script(self));
        [Script { name: "shard.sh", text: shard }, Script { name: MERGE, text: merge }]
    }

    /// Number of workers of a shard.
    pub fn workers(&self) -> u32 {
        (self.limits.cpus / self.limits.threads).max(1)
    }

    /// Arguments of a shard's run; `shard`: the shell variable with its number.
    pub fn run_words(&self, shard: &str, stop_after: Option<u64>) -> Vec<String> {
        let workers = self.workers();
        let spec = self.folder.join(SUBMITTED_SPEC).display().to_string();
        let shard = format!("{shard}/{}", self.shards);
        let head = ["run", &spec, "--shard", &shard, "--workers", &workers.to_string()].map(str::to_owned);
        let tail =
            ["--threads", &self.limits.threads.to_string(), "--folder", &self.folder.display().to_string()]
                .map(str::to_owned);
        let mut more = Vec::new();
        if self.has_queue() {
            more.extend(["--grace".to_owned(), self.grace().to_string()]);
        }
        if let Some(seconds) = stop_after {
            more.extend(["--stop-after".to_owned(), seconds.to_string()]);
        }
        if self.merges && self.scheduler.queue().is_some_and(|queue| !queue.has_merge_job()) {
            more.extend(["--merge-into".to_owned(), self.out.display().to_string()]);
        }
        [&head[..], &tail, &more, &self.run].concat()
    }

    pub(super) fn run(&self, shard: &str, stop_after: Option<u64>) -> String {
        let arguments = self.run_words("SHARD", stop_after);
        let number = format!("SHARD/{}", self.shards);
        let word = |word: &String| match *word == number {
            true => format!("\"{shard}/{}\"", self.shards),
            false => quoted(Path::new(word)),
        };
        let words: Vec<String> = arguments.iter().map(word).collect();
        format!("{} {} \\\n  {}", self.command(), words[..4].join(" "), words[4..].join(" "))
    }

    /// Redirection that appends to a shard's output.
    pub(super) fn output(&self, shard: &str) -> String {
        format!("\\\n  >> {}/shard-\"{shard}\"-of-{}.out 2>&1", quoted(&self.folder), self.shards)
    }

    pub(super) fn merge(&self) -> String {
        format!("{} cluster merge {} --out {}", self.command(), quoted(&self.folder), quoted(&self.out))
    }

    /// The program with its prefix.
    fn command(&self) -> String {
        let prefix = self.prefix.as_ref().map_or(String::new(), |prefix| format!("{prefix} "));
        prefix + &quoted(&self.program)
    }

    /// The job arrays to submit; the scheduler limits their indices.
    pub fn arrays(&self) -> Vec<JobArray> {
        let most = self.queue.most_index.max(1);
        let mut arrays: Vec<JobArray> = Vec::new();
        for shard in &self.which {
            let offset = (shard - 1) / most * most;
            match arrays.last_mut().filter(|array| array.offset == offset) {
                Some(array) => array.indices.push(shard - offset),
                None => arrays.push(JobArray { offset, indices: vec![shard - offset] }),
            }
        }
        arrays
    }
}

/// Comment in every script of a shard; the times of its end follow.
pub(super) const ABOUT: &str = "\
# A shard of the sweep: an ordinary run with its database on the node's disk, under TMPDIR. It resumes from
# the database of an earlier attempt in this folder, and copies its database to this folder when it ends:
";

pub(super) fn words(head: &[&str], further: &[String], tail: &[&str]) -> Vec<String> {
    let own = |words: &[&str]| words.iter().map(ToString::to_string).collect::<Vec<_>>();
    [own(head), further.to_vec(), own(tail)].concat()
}

/// A shell command of these words.
pub fn line(words: &[String]) -> String {
    words.iter().map(|word| quoted(Path::new(word))).collect::<Vec<_>>().join(" ")
}

/// Parses a time as `sbatch --time` does, to seconds: `30` (minutes), `30:00`, `4:00:00`, `1-12`, `1-12:00:00`.
///
/// # Errors
/// If the time is invalid or not between a minute and a year.
pub fn seconds(text: &str) -> Result<u64, String> {
    let wrong = || format!("{text:?} is not a time: use minutes, H:MM:SS or D-HH:MM:SS, such as 4:00:00");
    let (days, clock) = text.split_once('-').map_or((None, text), |(days, clock)| (Some(days), clock));
    // u128, so that sums cannot overflow
    let whole = |part: &str| part.parse::<u64>().ok().map(u128::from);
    let parts: Option<Vec<u128>> = clock.split(':').map(whole).collect();
    let days = days.map_or(Some(0), whole).ok_or_else(wrong)?;
    let rest = match (parts.as_deref(), text.contains('-')) {
        (Some([minutes]), false) => minutes * 60,
        (Some([minutes, seconds]), false) => minutes * 60 + seconds,
        (Some([hours]), true) => hours * 3600,
        (Some([hours, minutes]), true) => hours * 3600 + minutes * 60,
        (Some([hours, minutes, seconds]), _) => hours * 3600 + minutes * 60 + seconds,
        _ => return Err(wrong()),
    };
    let total = days * 86_400 + rest;
    if (60..=365 * 86_400).contains(&total) {
        Ok(total as u64)
    } else {
        Err(format!("{text:?} must lie between a minute and a year"))
    }
}

#[cfg(test)]
mod tests;
