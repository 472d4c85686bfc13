//! What the scheduler says of the shards that were submitted. Only its queue is asked: there need be no accounting.

use std::collections::HashMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::process::{Command, ExitStatus};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::files;

/// In a folder of shards: what was submitted, a line each time.
const JOBS: &str = "jobs.jsonl";

/// A job that was submitted.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Job {
    /// `slurm`, `hq`, `local` or `ssh`.
    pub scheduler: String,
    /// Its number there.
    pub job: String,
    /// That of the merge behind it, once that has been submitted.
    #[serde(default)]
    pub merge_job: Option<String>,
    /// Shards of the sweep.
    pub shards: u32,
    /// Added to the scheduler's indices, it gives the shards.
    #[serde(default)]
    pub offset: u32,
}

/// What was submitted from a folder, open before anything is: what a scheduler has accepted can be written down.
#[derive(Debug)]
pub struct Notes(File);

impl Notes {
    /// For this process alone, as long as it is open.
    ///
    /// # Errors
    /// If nothing can be written there, or another `submit` is at work.
    pub fn open(folder: &Path) -> io::Result<Self> {
        let file = OpenOptions::new().create(true).append(true).open(folder.join(JOBS))?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => {
                Err(io::Error::new(ErrorKind::ResourceBusy, "another `metasense submit` is at work on it"))
            }
            // Not every network file system has locks.
            _ => Ok(Self(file)),
        }
    }

    /// Notes a job; again, with its merge.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn note(&mut self, job: &Job) -> io::Result<()> {
        let line = serde_json::to_string(job).expect("strings and numbers are JSON") + "\n";
        self.0.write_all(line.as_bytes())?;
        self.0.sync_data()
    }
}

/// Whether a `submit` is at work on a folder.
#[must_use]
pub fn is_held(folder: &Path) -> bool {
    File::open(folder.join(JOBS)).is_ok_and(|file| files::is_held(&file))
}

/// The jobs of a folder, oldest first; none where nothing was submitted.
///
/// # Errors
/// If they cannot be read.
pub fn jobs(folder: &Path) -> io::Result<Vec<Job>> {
    let file = folder.join(JOBS);
    let at = |number: usize, what: &dyn std::fmt::Display| {
        io::Error::new(ErrorKind::InvalidData, format!("{}:{}: {what}", file.display(), number + 1))
    };
    let text = match std::fs::read_to_string(&file) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        text => text.map_err(|error| io::Error::new(error.kind(), format!("{}: {error}", file.display())))?,
    };
    let mut jobs: Vec<Job> = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let job: Job = serde_json::from_str(line).map_err(|error| at(number, &error))?;
        match jobs.iter_mut().find(|known| known.scheduler == job.scheduler && known.job == job.job) {
            Some(known) => *known = job,
            None => jobs.push(job),
        }
    }
    Ok(jobs)
}

/// What schedulers have of jobs that have not ended.
#[derive(Debug, Default, PartialEq)]
pub struct Queue {
    /// Shards that run or wait, in the scheduler's own words.
    pub shards: HashMap<u32, String>,
    /// Jobs, those of merges included.
    pub jobs: Vec<String>,
}

/// A queue that does not answer: nothing is known of the shards then.
#[derive(Debug, thiserror::Error)]
pub enum QueueError {
    /// There is no such program here.
    #[error("cannot start `{command}`: what runs or waits is not known")]
    Start {
        /// The command.
        command: String,
        /// What the system said.
        source: io::Error,
    },
    /// It says that something is wrong.
    #[error("`{command}` failed ({status}), so that what runs or waits is not known: {said}")]
    Failed {
        /// The command.
        command: String,
        /// How it ended.
        status: ExitStatus,
        /// What it said.
        said: String,
    },
    /// It says what we do not understand.
    #[error("`{command}` answered what is not understood: {answer}")]
    Answer {
        /// The command.
        command: String,
        /// Its answer.
        answer: String,
    },
}

/// Asks the schedulers of these jobs.
///
/// # Errors
/// If one does not answer.
pub fn ask(jobs: &[Job]) -> Result<Queue, QueueError> {
    let mut queue = Queue::default();
    for (scheduler, read) in [("slurm", slurm as fn(&[&Job], &mut Queue) -> _), ("hq", hq)] {
        let jobs: Vec<&Job> = jobs.iter().filter(|job| job.scheduler == scheduler).collect();
        if !jobs.is_empty() {
            read(&jobs, &mut queue)?;
        }
    }
    Ok(queue)
}

/// Numbers of jobs and of the merges behind them.
fn numbers(jobs: &[&Job]) -> String {
    let numbers = jobs.iter().flat_map(|job| std::iter::once(&*job.job).chain(job.merge_job.as_deref()));
    numbers.collect::<Vec<_>>().join(",")
}

fn slurm(jobs: &[&Job], queue: &mut Queue) -> Result<(), QueueError> {
    let ids = format!("--jobs={}", numbers(jobs));
    match output(&["squeue", "--noheader", "--array", "--format=%F|%K|%T|%r", &ids]) {
        Ok(text) => queue.add_slurm(&text, jobs),
        // What it says of a job that has left the queue, where no other is asked for.
        Err(QueueError::Failed { said, .. }) if said.contains("Invalid job id") => {}
        Err(error) => return Err(error),
    }
    Ok(())
}

fn hq(jobs: &[&Job], queue: &mut Queue) -> Result<(), QueueError> {
    let command = ["hq", "--output-mode=json", "task", "list", &numbers(jobs)];
    let text = output(&command)?;
    match serde_json::from_str(&text) {
        Ok(Value::Object(tasks)) => queue.add_hq(&tasks, jobs),
        _ => return Err(QueueError::Answer { command: command.join(" "), answer: text }),
    }
    Ok(())
}

fn output(words: &[&str]) -> Result<String, QueueError> {
    let command = || words.join(" ");
    let output = Command::new(words[0])
        .args(&words[1..])
        .output()
        .map_err(|source| QueueError::Start { command: command(), source })?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    // `hq` says in JSON what is wrong.
    let said = [&output.stderr[..], &output.stdout].concat();
    let said = String::from_utf8_lossy(&said).trim().chars().take(500).collect();
    Err(QueueError::Failed { command: command(), status: output.status, said })
}

/// Slurm's `MaxArraySize`, where it says.
#[must_use]
pub fn max_array_size() -> Option<u32> {
    let config = output(&["scontrol", "show", "config"]).ok()?;
    let line = config.lines().find_map(|line| line.trim().strip_prefix("MaxArraySize"))?;
    line.split_once('=')?.1.trim().parse().ok()
}

impl Queue {
    fn add_job(&mut self, job: &str) {
        if !self.jobs.iter().any(|known| known == job) {
            self.jobs.push(job.to_owned());
        }
    }

    /// Lines of `squeue`: job, index, state, and why it waits.
    fn add_slurm(&mut self, text: &str, jobs: &[&Job]) {
        for line in text.lines() {
            let mut parts = line.split('|').map(str::trim);
            let (Some(job), Some(index), Some(state)) = (parts.next(), parts.next(), parts.next()) else {
                continue;
            };
            let reason = parts.next().unwrap_or("None");
            let state = state.to_lowercase();
            self.add_job(job);
            if let Ok(index) = index.parse::<u32>()
                && let Some(known) = jobs.iter().find(|known| known.job == job)
            {
                let state = if reason == "None" { state } else { format!("{state} ({reason})") };
                self.shards.insert(known.offset + index, state);
            }
        }
    }

    /// Lists of tasks by job.
    fn add_hq(&mut self, tasks: &serde_json::Map<String, Value>, jobs: &[&Job]) {
        for (job, tasks) in tasks {
            for task in tasks.as_array().into_iter().flatten() {
                let state = task["state"].as_str().filter(|state| ["waiting", "running"].contains(state));
                let Some((state, index)) = state.zip(task["id"].as_u64()) else { continue };
                self.add_job(job);
                if jobs.iter().any(|known| known.job == *job) {
                    self.shards.insert(index as u32, state.to_owned());
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
