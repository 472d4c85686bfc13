//! What the scheduler says of the shards that were submitted. Only its queue is asked: there need be no accounting.

use std::collections::HashMap;
use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::process::Command;

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// In a folder of shards: what was submitted, a line each time.
const JOBS: &str = "jobs.jsonl";

/// A job that was submitted.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Job {
    /// `slurm` or `hq`.
    pub scheduler: String,
    /// Its number there.
    pub job: String,
    /// That of the merge behind it, once that has been submitted.
    #[serde(default)]
    pub merge_job: Option<String>,
    /// Shards of the sweep.
    pub shards: u32,
}

/// What was submitted from a folder, open before anything is: what a scheduler has accepted can be written down.
#[derive(Debug)]
pub struct Notes(File);

impl Notes {
    /// # Errors
    /// If nothing can be written there.
    pub fn open(folder: &Path) -> io::Result<Self> {
        OpenOptions::new().create(true).append(true).open(folder.join(JOBS)).map(Self)
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

/// State of each shard that the schedulers still know of, in their own words.
///
/// # Errors
/// If a scheduler's command cannot be run.
pub fn states(jobs: &[Job]) -> io::Result<HashMap<u32, String>> {
    let mut states = HashMap::new();
    let slurm: Vec<&str> = jobs.iter().filter(|j| j.scheduler == "slurm").map(|j| j.job.as_str()).collect();
    if !slurm.is_empty() {
        // Of a job that has left the queue it says `Invalid job id`, where no other is asked for: nothing to add.
        let ids = format!("--jobs={}", slurm.join(","));
        let text = output("squeue", &["--noheader", "--array", "--format=%K|%T|%r", &ids])?;
        states.extend(slurm_states(&text));
    }
    for job in jobs.iter().filter(|j| j.scheduler == "hq") {
        let text = output("hq", &["--output-mode=json", "task", "list", &job.job])?;
        states.extend(hq_states(&text));
    }
    Ok(states)
}

fn output(program: &str, arguments: &[&str]) -> io::Result<String> {
    let output = Command::new(program).args(arguments).output()?;
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Lines of `squeue`: index, state, and why it waits.
fn slurm_states(text: &str) -> HashMap<u32, String> {
    let shard = |line: &str| {
        let mut parts = line.split('|');
        let (index, state) = (parts.next()?.trim().parse().ok()?, parts.next()?.to_lowercase());
        let reason = parts.next().unwrap_or("None").trim();
        Some((index, if reason == "None" { state } else { format!("{state} ({reason})") }))
    };
    text.lines().filter_map(shard).collect()
}

/// Tasks that have not ended, wherever they stand in the answer.
fn hq_states(text: &str) -> HashMap<u32, String> {
    fn collect(value: &Value, states: &mut HashMap<u32, String>) {
        match value {
            Value::Array(values) => values.iter().for_each(|value| collect(value, states)),
            Value::Object(map) => {
                if let (Some(id), Some(state)) = (map.get("id").and_then(Value::as_u64), map.get("state"))
                    && let Some(state) = state.as_str().filter(|s| ["waiting", "running"].contains(s))
                {
                    states.insert(id as u32, state.to_owned());
                }
                map.values().for_each(|value| collect(value, states));
            }
            _ => {}
        }
    }
    let mut states = HashMap::new();
    collect(&serde_json::from_str(text).unwrap_or_default(), &mut states);
    states
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_queue_is_read() {
        let slurm = slurm_states("3|RUNNING|None\n4|PENDING|Resources\nN/A|PENDING|Dependency\n");
        assert_eq!(slurm.len(), 2);
        assert_eq!((slurm[&3].as_str(), slurm[&4].as_str()), ("running", "pending (Resources)"));
        let hq = hq_states(
            r#"{"1": [{"id": 1, "state": "finished"}, {"id": 2, "state": "running", "worker": 1}]}"#,
        );
        assert_eq!(hq, HashMap::from([(2, "running".to_owned())]));
    }
}
