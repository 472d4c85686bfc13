//! Shards that `submit` starts itself and waits for: on this machine, or on others by `ssh`.

use super::{Scheduler, SubmitOption};
use crate::cluster::submit::{ABOUT, Submission};

/// This machine.
#[derive(Debug)]
pub(super) struct Local;

/// Machines that share the folder.
#[derive(Debug)]
pub(super) struct Ssh;

impl Scheduler for Local {
    fn name(&self) -> &'static str {
        "local"
    }

    fn program(&self) -> &'static str {
        "sh"
    }

    fn refusal(&self, option: SubmitOption) -> Option<&'static str> {
        match option {
            SubmitOption::Time => Some(NO_LIMIT),
            SubmitOption::AtMost => None,
            SubmitOption::Hosts => Some("it is for `cluster submit ssh`"),
            SubmitOption::Further => Some("no scheduler receives them"),
            SubmitOption::FurtherForMerge => Some(NO_MERGE_JOB),
        }
    }

    fn shard_script(&self, submission: &Submission) -> String {
        shard_script(submission)
    }
}

impl Scheduler for Ssh {
    fn name(&self) -> &'static str {
        "ssh"
    }

    fn program(&self) -> &'static str {
        "ssh"
    }

    fn refusal(&self, option: SubmitOption) -> Option<&'static str> {
        match option {
            SubmitOption::Time => Some(NO_LIMIT),
            SubmitOption::AtMost | SubmitOption::Hosts | SubmitOption::Further => None,
            SubmitOption::FurtherForMerge => Some(NO_MERGE_JOB),
        }
    }

    fn shard_script(&self, submission: &Submission) -> String {
        shard_script(submission)
    }
}

const NO_LIMIT: &str = "shards run here without a limit";
pub(super) const NO_MERGE_JOB: &str = "no job merges";

fn shard_script(submission: &Submission) -> String {
    format!(
        "#!/bin/sh\n\
         {ABOUT}\
         # also after SIGTERM. Argument: number of the shard.\n\
         exec {} {}\n",
        submission.run("$1", None),
        submission.output("$1")
    )
}
