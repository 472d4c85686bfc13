//! Shards that `submit` starts itself and waits for: on this machine, or on others by `ssh`.

use super::{Scheduler, SubmitOption};
use crate::cluster::submit::{ABOUT, Submission};

/// Where the shards run.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Own {
    /// On this machine.
    Local,
    /// On machines that share the folder.
    Ssh,
}

pub(super) const NO_MERGE_JOB: &str = "no job merges";

impl Scheduler for Own {
    fn name(&self) -> &'static str {
        if *self == Self::Local { "local" } else { "ssh" }
    }

    fn program(&self) -> &'static str {
        if *self == Self::Local { "sh" } else { "ssh" }
    }

    fn refusal(&self, option: SubmitOption) -> Option<&'static str> {
        match option {
            SubmitOption::Time => Some("shards run here without a limit"),
            SubmitOption::FurtherForMerge => Some(NO_MERGE_JOB),
            SubmitOption::Hosts if *self == Self::Local => Some("it is for `cluster submit ssh`"),
            SubmitOption::Further if *self == Self::Local => Some("no scheduler receives them"),
            SubmitOption::AtMost | SubmitOption::Hosts | SubmitOption::Further => None,
        }
    }

    fn shard_script(&self, submission: &Submission) -> String {
        format!(
            "#!/bin/sh\n\
             {ABOUT}\
             # also after SIGTERM. Argument: number of the shard.\n\
             exec {} {}\n",
            submission.run("$1", None),
            submission.output("$1")
        )
    }
}
