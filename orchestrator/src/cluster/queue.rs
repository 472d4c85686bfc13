//! What the scheduler says of the shards that were submitted. Only its queue is asked: there need be no accounting.

use std::collections::{BTreeMap, HashMap};
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
    /// Its number there; empty from before it is submitted until it has one.
    #[serde(default)]
    pub job: String,
    /// Its name there, which no other job has: by it a job is found whose number could not be written down any more.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Slurm's cluster, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cluster: Option<String>,
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
    /// For this process alone, as long as it is open. A last line that was not written to its end goes.
    ///
    /// # Errors
    /// If nothing can be written there, or another `submit` is at work.
    pub fn open(folder: &Path) -> io::Result<Self> {
        let path = folder.join(JOBS);
        let mut file = OpenOptions::new().create(true).append(true).open(&path)?;
        // Not every network file system has locks.
        if let Err(TryLockError::WouldBlock) = file.try_lock() {
            return Err(io::Error::new(
                ErrorKind::ResourceBusy,
                "another `metasense cluster submit` is using it",
            ));
        }
        let bytes = std::fs::read(&path)?;
        let (whole, rest) = lines(&bytes);
        match rest.is_empty() {
            true => file.set_len(whole as u64)?,
            false => file.write_all(b"\n")?,
        }
        Ok(Self(file))
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

/// The bytes of the lines that have an end, and what stands behind them, where that is a whole job.
fn lines(bytes: &[u8]) -> (usize, &[u8]) {
    let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
    let rest = &bytes[whole..];
    (whole, if serde_json::from_slice::<Job>(rest).is_ok() { rest } else { &[] })
}

/// The jobs of a folder, oldest first; none where nothing was submitted. A last line that was not written to its end is none.
///
/// # Errors
/// If they cannot be read.
pub fn jobs(folder: &Path) -> io::Result<Vec<Job>> {
    let file = folder.join(JOBS);
    let damaged = |number: usize, error: serde_json::Error| {
        let text = format!(
            "{}:{}: is no job ({error}); look for its job in the scheduler's queue, and take the line out",
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
    /// Whether both are the same job, of which more is known by now.
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

/// What schedulers have of jobs that have not ended.
#[derive(Debug, Default, PartialEq)]
pub struct Queue {
    /// Shards that run or wait, in the scheduler's own words.
    pub shards: HashMap<u32, String>,
    /// Jobs, those of merges included.
    pub jobs: Vec<String>,
    /// Slurm's cluster that they are on, where there are several.
    pub cluster: Option<String>,
}

/// A queue that does not answer: nothing is known of the shards then.
#[derive(Debug, thiserror::Error)]
pub enum QueueError {
    /// There is no such program here.
    #[error("cannot start `{command}`, so the state of the queue is unknown")]
    Start {
        /// The command.
        command: String,
        /// What the system said.
        source: io::Error,
    },
    /// It says that something is wrong.
    #[error("`{command}` failed ({status}), so the state of the queue is unknown: {said}")]
    Failed {
        /// The command.
        command: String,
        /// How it ended.
        status: ExitStatus,
        /// What it said.
        said: String,
    },
    /// It says what we do not understand.
    #[error("`{command}` printed unexpected output: {answer}")]
    Answer {
        /// The command.
        command: String,
        /// Its answer.
        answer: String,
    },
}

/// Asks the schedulers of these jobs. Those whose numbers could not be written down get them; those that nobody knows are left out:
/// they were not accepted, or have ended.
///
/// # Errors
/// If one does not answer.
pub fn ask(jobs: &mut Vec<Job>) -> Result<Queue, QueueError> {
    for job in jobs.iter_mut().filter(|job| job.job.is_empty()) {
        look_up(job)?;
    }
    jobs.retain(|job| !job.job.is_empty());
    let mut queue = Queue::default();
    let mut groups: BTreeMap<(&str, Option<&str>), Vec<&Job>> = BTreeMap::new();
    for job in jobs.iter() {
        groups.entry((&job.scheduler, job.cluster.as_deref())).or_default().push(job);
    }
    for ((scheduler, cluster), jobs) in groups {
        match scheduler {
            "slurm" => slurm(&jobs, cluster, &mut queue)?,
            "hq" => hq(&jobs, &mut queue)?,
            _ => {}
        }
    }
    Ok(queue)
}

/// Gives a job its number, by its name, where it is in its queue.
///
/// # Errors
/// If the scheduler does not answer.
pub fn look_up(job: &mut Job) -> Result<(), QueueError> {
    let Some(name) = &job.name else { return Ok(()) };
    if job.scheduler == "slurm" {
        let text = output(&squeue("--format=%F", &format!("--name={name}"), job.cluster.as_deref()))?;
        for line in text.lines().map(str::trim) {
            match line.strip_prefix("CLUSTER: ") {
                Some(cluster) => job.cluster = Some(cluster.to_owned()),
                None if line.parse::<u64>().is_ok() => {
                    job.job = line.to_owned();
                    break;
                }
                None => {}
            }
        }
        return Ok(());
    }
    let command = ["hq", "--output-mode=json", "job", "list", "--all"].map(str::to_owned);
    let text = output(&command)?;
    match serde_json::from_str(&text) {
        Ok(Value::Array(jobs)) => {
            if let Some(known) = jobs.iter().find(|job| job["name"] == **name) {
                job.job = known["id"].to_string();
            }
            Ok(())
        }
        _ => Err(QueueError::Answer { command: command.join(" "), answer: text }),
    }
}

fn squeue(format: &str, which: &str, cluster: Option<&str>) -> Vec<String> {
    let words = ["squeue", "--noheader", "--array", format, which].map(str::to_owned);
    words.into_iter().chain(cluster.map(|name| format!("--clusters={name}"))).collect()
}

/// Numbers of jobs and of the merges behind them.
fn numbers(jobs: &[&Job]) -> String {
    let numbers = jobs.iter().flat_map(|job| std::iter::once(&*job.job).chain(job.merge_job.as_deref()));
    numbers.collect::<Vec<_>>().join(",")
}

fn slurm(jobs: &[&Job], cluster: Option<&str>, queue: &mut Queue) -> Result<(), QueueError> {
    let ids = format!("--jobs={}", numbers(jobs));
    let before = queue.jobs.len();
    match output(&squeue("--format=%F|%K|%T|%r", &ids, cluster)) {
        Ok(text) => queue.add_slurm(&text, jobs),
        // What it says of a job that has left the queue, where no other is asked for.
        Err(QueueError::Failed { said, .. }) if said.contains("Invalid job id") => {}
        Err(error) => return Err(error),
    }
    if queue.jobs.len() > before {
        queue.cluster = cluster.map(str::to_owned);
    }
    Ok(())
}

fn hq(jobs: &[&Job], queue: &mut Queue) -> Result<(), QueueError> {
    let command = ["hq", "--output-mode=json", "task", "list", &numbers(jobs)].map(str::to_owned);
    let text = output(&command)?;
    match serde_json::from_str(&text) {
        Ok(Value::Object(tasks)) => queue.add_hq(&tasks, jobs),
        _ => return Err(QueueError::Answer { command: command.join(" "), answer: text }),
    }
    Ok(())
}

fn output(words: &[String]) -> Result<String, QueueError> {
    let command = || words.join(" ");
    let output = Command::new(&words[0])
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
    let config = output(&["scontrol", "show", "config"].map(str::to_owned)).ok()?;
    let line = config.lines().find_map(|line| line.trim().strip_prefix("MaxArraySize"))?;
    line.split_once('=')?.1.trim().parse().ok()
}

impl Queue {
    /// Whether a merge waits behind every job of shards.
    #[must_use]
    pub fn has_merge(&self, jobs: &[Job]) -> bool {
        let is_queued = |job: &String| self.jobs.contains(job);
        let mut of_shards = jobs.iter().filter(|job| is_queued(&job.job));
        of_shards.all(|job| job.merge_job.as_ref().is_some_and(is_queued))
    }

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
