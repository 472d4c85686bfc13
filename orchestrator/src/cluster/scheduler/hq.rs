//! `HyperQueue`: scripts, and commands of its queue.

use serde_json::Value;

use super::own::NO_MERGE_JOB;
use super::{QueueCommands, Scheduler, SubmitOption};
use crate::cluster::queue::{Job, Queue, QueueError, numbers, output};
use crate::cluster::submit::{ABOUT, JobArray, Submission, words};
use crate::cluster::{Shard, ranges};

/// The scheduler.
#[derive(Debug)]
pub(super) struct Hq;

impl Scheduler for Hq {
    fn name(&self) -> &'static str {
        "hq"
    }

    fn program(&self) -> &'static str {
        "hq"
    }

    fn refusal(&self, option: SubmitOption) -> Option<&'static str> {
        match option {
            SubmitOption::AtMost => Some("HyperQueue starts as many shards as fit on its workers"),
            SubmitOption::Hosts => Some("it is for `cluster submit ssh`"),
            SubmitOption::FurtherForMerge => Some(NO_MERGE_JOB),
            SubmitOption::Time | SubmitOption::Further => None,
        }
    }

    fn queue(&self) -> Option<&dyn QueueCommands> {
        Some(self)
    }

    fn shard_script(&self, submission: &Submission) -> String {
        let notice = submission.notice();
        let stop_after = submission.limits.seconds.saturating_sub(notice).max(1);
        format!(
            "#!/bin/sh\n\
             {ABOUT}\
             # by itself {notice} s before the time limit, of which HyperQueue gives no notice.\n\
             exec {} {}\n",
            submission.run("$HQ_TASK_ID", Some(stop_after)),
            submission.output("$HQ_TASK_ID"),
        )
    }
}

impl QueueCommands for Hq {
    fn most_index(&self) -> u32 {
        Shard::MOST
    }

    fn submit_shards(&self, submission: &Submission, array: &JobArray, name: &str) -> Vec<String> {
        let script = submission.folder.join("shard.sh").display().to_string();
        let indices = ranges(&array.indices);
        let (cpus, limit) = (submission.limits.cpus.to_string(), format!("{}s", submission.limits.seconds));
        let options = ["--cpus", &cpus, "--time-limit", &limit, "--stdout", "none", "--stderr", "none"];
        let head = ["hq", "--output-mode=quiet", "submit", "--name", name, "--array", &indices];
        words(&[&head[..], &options].concat(), &submission.queue.for_shards, &["--", "sh", &script])
    }

    /// A queued merge would keep a core from a shard.
    fn submit_merge(&self, _: &Submission, _: &[String]) -> Option<Vec<String>> {
        None
    }

    fn has_merge_job(&self) -> bool {
        false
    }

    fn after_limit(&self) -> &'static str {
        "is resumed by the next `cluster submit`"
    }

    fn look_up(&self, name: &str, job: &mut Job) -> Result<(), QueueError> {
        let command = ["hq", "--output-mode=json", "job", "list", "--all"].map(str::to_owned);
        let text = output(&command)?;
        match serde_json::from_str(&text) {
            Ok(Value::Array(jobs)) => {
                if let Some(known) = jobs.iter().find(|job| job["name"] == *name) {
                    job.job = known["id"].to_string();
                }
                Ok(())
            }
            _ => Err(QueueError::Answer { command: command.join(" "), answer: text }),
        }
    }

    fn add_states(&self, jobs: &[&Job], _: Option<&str>, queue: &mut Queue) -> Result<(), QueueError> {
        let command = ["hq", "--output-mode=json", "task", "list", &numbers(jobs)].map(str::to_owned);
        let text = output(&command)?;
        match serde_json::from_str(&text) {
            Ok(Value::Object(tasks)) => add(queue, &tasks, jobs),
            _ => return Err(QueueError::Answer { command: command.join(" "), answer: text }),
        }
        Ok(())
    }
}

/// Adds lists of tasks per job.
fn add(queue: &mut Queue, tasks: &serde_json::Map<String, Value>, jobs: &[&Job]) {
    for (job, tasks) in tasks {
        for task in tasks.as_array().into_iter().flatten() {
            let state = task["state"].as_str().filter(|state| ["waiting", "running"].contains(state));
            let Some((state, index)) = state.zip(task["id"].as_u64()) else { continue };
            queue.add_job(job);
            if jobs.iter().any(|known| known.job == *job) {
                queue.shards.insert(index as u32, state.to_owned());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_are_read() {
        let job = |job: &str| Job { scheduler: "hq".into(), job: job.into(), shards: 4, ..Job::default() };
        let mut queue = Queue::default();
        let text = r#"{"7": [{"id": 1, "state": "finished"}, {"id": 2, "state": "running", "worker": 1}],
                       "8": [{"id": 0, "state": "waiting"}], "9": [{"id": 1, "state": "canceled"}]}"#;
        let tasks = serde_json::from_str::<Value>(text).unwrap();
        add(&mut queue, tasks.as_object().unwrap(), &[&job("7"), &job("9")]);
        assert_eq!(queue.shards, [(2, "running".into())].into());
        assert_eq!(queue.jobs, ["7", "8"]);
    }
}
