//! What starts shards, one file each: Slurm, `HyperQueue`, and this process (here or by `ssh`).

mod hq;
mod own;
mod slurm;

use std::fmt::Debug;

use super::queue::{Job, Queue, QueueError};
use super::submit::{JobArray, Submission};

/// Names of schedulers on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum SchedulerName {
    /// Slurm, by `sbatch`
    Slurm,
    /// `HyperQueue`, by `hq`
    Hq,
    /// This machine, until all have ended
    Local,
    /// Machines that share the folder, by `ssh`, until all have ended
    Ssh,
}

impl SchedulerName {
    /// The scheduler of this name.
    pub fn scheduler(self) -> &'static dyn Scheduler {
        match self {
            Self::Slurm => &slurm::Slurm,
            Self::Hq => &hq::Hq,
            Self::Local => &own::Own::Local,
            Self::Ssh => &own::Own::Ssh,
        }
    }
}

/// The queue of the scheduler with this name in the list of jobs, if it has one.
pub fn queue_named(name: &str) -> Option<&'static dyn QueueCommands> {
    <SchedulerName as clap::ValueEnum>::from_str(name, false).ok()?.scheduler().queue()
}

/// A program that starts shards.
pub trait Scheduler: Debug + Sync {
    /// Name on the command line and in the list of jobs.
    fn name(&self) -> &'static str;

    /// Program that must be in PATH.
    fn program(&self) -> &'static str;

    /// Why an option of `cluster submit` (without its hyphens) has no effect here, if so.
    fn refusal(&self, option: SubmitOption) -> Option<&'static str>;

    /// The queue, if it outlives `submit`.
    fn queue(&self) -> Option<&dyn QueueCommands> {
        None
    }

    /// Characters that the path of the folder must not contain.
    fn unfit_in_paths(&self) -> &'static [char] {
        &[]
    }

    /// The script of a shard.
    fn shard_script(&self, submission: &Submission) -> String;

    /// The script of the merge.
    fn merge_script(&self, submission: &Submission) -> String {
        format!("#!/bin/sh\n# Merges the databases of the folder.\nexec {}\n", submission.merge())
    }
}

/// Options of `cluster submit` that some schedulers refuse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SubmitOption {
    /// `--time`
    Time,
    /// `--at-most`
    AtMost,
    /// `--hosts`
    Hosts,
    /// Options after `--`
    Further,
    /// Options after a second `--`
    FurtherForMerge,
}

/// Commands of a scheduler's queue.
pub trait QueueCommands: Sync {
    /// Largest index in a job array.
    fn most_index(&self) -> u32;

    /// The cluster for jobs with these options, if there are several.
    fn cluster(&self, _options: &[String]) -> Option<String> {
        None
    }

    /// The command that submits shards under a name and prints the job id.
    fn submit_shards(&self, submission: &Submission, array: &JobArray, name: &str) -> Vec<String>;

    /// The command that submits the merge after these jobs; `None` if the last shard merges.
    fn submit_merge(&self, submission: &Submission, jobs: &[String]) -> Option<Vec<String>>;

    /// Whether a job merges the databases.
    fn has_merge_job(&self) -> bool;

    /// What happens to a shard that its time limit has interrupted.
    fn after_limit(&self) -> &'static str;

    /// Looks up the id of a job by its name; leaves it empty if the job is not in the queue.
    ///
    /// # Errors
    /// If the scheduler does not answer.
    fn look_up(&self, name: &str, job: &mut Job) -> Result<(), QueueError>;

    /// Adds the unfinished shards and jobs among `jobs`, which are on the same cluster.
    ///
    /// # Errors
    /// If the scheduler does not answer.
    fn add_states(&self, jobs: &[&Job], cluster: Option<&str>, queue: &mut Queue) -> Result<(), QueueError>;
}
