//! States of submitted shards in the scheduler's queue. Accounting is not required.

use std::collections::{BTreeMap, HashMap};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::process::{Command, ExitStatus};

use serde::{Deserialize, Serialize};

use super::scheduler::queue_named;
use crate::files;

/// File in a folder of shards that lists submitted jobs, one per line.
const JOBS: &str = "jobs.jsonl";

/// A submitted job.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Job {
    /// `slurm`, `hq`, `local` or `ssh`.
    pub scheduler: String,
    /// Job id; empty while it is unknown.
    #[serde(default)]
    pub job: String,
    /// Unique job name: finds the job if its id could not be recorded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Slurm cluster, if there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cluster: Option<String>,
    /// Job id of the merge, once submitted.
    #[serde(default)]
    pub merge_job: Option<String>,
    /// Number of shards of the sweep.
    pub shards: u32,
    /// Shard number = offset + index in the job array.
    #[serde(default)]
    pub offset: u32,
}

/// The list of jobs of a folder. It is opened before submission, to ensure that accepted jobs can be recorded.
#[derive(Debug)]
pub struct Notes(File);

impl Notes {
    /// Opens and locks the list; removes an incomplete last line.
    ///
    /// # Errors
    /// If it is not writable or another `submit` uses it.
    pub fn open(folder: &Path) -> io::Result<Self> {
        let path = folder.join(JOBS);
        let mut file = OpenOptions::new().create(true).append(true).open(&path)?;
        // Continue on network file systems without locks.
        if let Err(TryLockError::WouldBlock) = file.try_lock() {
            let why = "another `metasense cluster submit` is using it";
            return Err(io::Error::new(ErrorKind::ResourceBusy, why));
        }
        let bytes = std::fs::read(&path)?;
        let (whole, rest) = lines(&bytes);
        match rest.is_empty() {
            true => file.set_len(whole as u64)?,
            false => file.write_all(b"\n")?,
        }
        Ok(Self(file))
    }

    /// Records a job; a second record with its merge replaces the first.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn note(&mut self, job: &Job) -> io::Result<()> {
        let line = serde_json::to_string(job).expect("strings and numbers are JSON") + "\n";
        self.0.write_all(line.as_bytes())?;
        self.0.sync_data()
    }
}

/// Whether a `submit` uses a folder.
pub fn is_held(folder: &Path) -> bool {
    File::open(folder.join(JOBS)).is_ok_and(|file| files::is_held(&file))
}

/// Number of bytes in complete lines, and the rest if it is a complete job without a line end.
fn lines(bytes: &[u8]) -> (usize, &[u8]) {
    let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
    let rest = &bytes[whole..];
    (whole, if serde_json::from_slice::<Job>(rest).is_ok() { rest } else { &[] })
}

/// The jobs of a folder, oldest first; empty if nothing was submitted. Ignores an incomplete last line.
///
/// # Errors
/// If the list cannot be read.
pub fn jobs(folder: &Path) -> io::Result<Vec<Job>> {
    let file = folder.join(JOBS);
    let damaged = |number: usize, error: serde_json::Error| {
        let text = format!(
            "{}:{}: not a valid job ({error}); check the scheduler's queue for this job, then remove the line",
            file.display(),
            number + 1
        );
        io::Error::new(ErrorKind::InvalidData, text)
    };
    let bytes = match std::fs::read(&file) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        bytes => {
            bytes.map_err(|error| io::Error::new(error.kind(), format!("{}: {error}", file.display())))?
        }
    };
    let (whole, rest) = lines(&bytes);
    let mut jobs: Vec<Job> = Vec::new();
    let all = bytes[..whole].split(|byte| *byte == b'\n').chain([rest]).enumerate();
    for (number, line) in all.filter(|(_, line)| !line.trim_ascii().is_empty()) {
        let job: Job = serde_json::from_slice(line).map_err(|error| damaged(number, error))?;
        match jobs.iter_mut().find(|known| known.is(&job)) {
            Some(known) => *known = job,
            None => jobs.push(job),
        }
    }
    Ok(jobs)
}

impl Job {
    /// Whether `other` is a later record of the same job.
    fn is(&self, other: &Self) -> bool {
        fn numbered(job: &Job) -> (&str, &str, &Option<String>) {
            (&job.scheduler, &job.job, &job.cluster)
        }
        match (&self.name, &other.name) {
            (Some(name), Some(other)) => name == other,
            _ => numbered(self) == numbered(other),
        }
    }
}

/// Unfinished jobs in the queues of schedulers.
#[derive(Debug, Default, PartialEq)]
pub struct Queue {
    /// State of each running or waiting shard, in the scheduler's words.
    pub shards: HashMap<u32, String>,
    /// Ids of jobs, including merges.
    pub jobs: Vec<String>,
    /// Slurm cluster of the jobs, if there are several.
    pub cluster: Option<String>,
}

/// Errors of a queue. The state of shards is unknown then.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum QueueError {
    /// The program cannot be started.
    #[error("cannot start `{command}`, so the state of the queue is unknown")]
    Start { command: String, source: io::Error },
    /// The command failed.
    #[error("`{command}` failed ({status}), so the state of the queue is unknown: {said}")]
    Failed { command: String, status: ExitStatus, said: String },
    /// The output cannot be parsed.
    #[error("`{command}` printed unexpected output: {answer}")]
    Answer { command: String, answer: String },
}

/// Queries the schedulers of these jobs. Looks up missing ids; removes jobs that are not found, because they were not accepted
/// or have ended.
///
/// # Errors
/// If a scheduler does not answer.
pub fn ask(jobs: &mut Vec<Job>) -> Result<Queue, QueueError> {
    for job in jobs.iter_mut().filter(|job| job.job.is_empty()) {
        if let (Some(commands), Some(name)) = (queue_named(&job.scheduler), job.name.clone()) {
            commands.look_up(&name, job)?;
        }
    }
    jobs.retain(|job| !job.job.is_empty());
    let mut queue = Queue::default();
    let mut groups: BTreeMap<(&str, Option<&str>), Vec<&Job>> = BTreeMap::new();
    for job in jobs.iter() {
        groups.entry((&job.scheduler, job.cluster.as_deref())).or_default().push(job);
    }
    for ((scheduler, cluster), jobs) in groups {
        if let Some(commands) = queue_named(scheduler) {
            commands.add_states(&jobs, cluster, &mut queue)?;
        }
    }
    Ok(queue)
}

/// Comma-separated ids of jobs and their merges.
pub(super) fn numbers(jobs: &[&Job]) -> String {
    let numbers = jobs.iter().flat_map(|job| std::iter::once(&*job.job).chain(job.merge_job.as_deref()));
    numbers.collect::<Vec<_>>().join(",")
}

pub(super) fn output(words: &[String]) -> Result<String, QueueError> {
    let command = || words.join(" ");
    let output = Command::new(&words[0]).args(&words[1..]).output();
    let output = output.map_err(|source| QueueError::Start { command: command(), source })?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    // `hq` prints errors as JSON.
    let said = [&output.stderr[..], &output.stdout].concat();
    let said = String::from_utf8_lossy(&said).trim().chars().take(500).collect();
    Err(QueueError::Failed { command: command(), status: output.status, said })
}

impl Queue {
    /// Whether every queued job of shards has a queued merge.
    pub fn has_merge(&self, jobs: &[Job]) -> bool {
        let is_queued = |job: &String| self.jobs.contains(job);
        let mut of_shards = jobs.iter().filter(|job| is_queued(&job.job));
        of_shards.all(|job| job.merge_job.as_ref().is_some_and(is_queued))
    }

    pub(super) fn add_job(&mut self, job: &str) {
        if !self.jobs.iter().any(|known| known == job) {
            self.jobs.push(job.to_owned());
        }
    }
}

#[cfg(test)]
mod tests;
