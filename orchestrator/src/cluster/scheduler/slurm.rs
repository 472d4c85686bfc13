//! Slurm: scripts, and commands of its queue. Accounting is not required.

use super::{QueueCommands, Scheduler, SubmitOption};
use crate::cluster::queue::{Job, Queue, QueueError, numbers, output};
use crate::cluster::ranges;
use crate::cluster::submit::{ABOUT, JobArray, MERGE, ShardLimits, Submission, words};
use crate::exit::Exit;

/// Default `MaxArraySize`: one more than the largest array index.
const MAX_ARRAY_SIZE: u32 = 1001;
/// Most times a shard requeues itself at its time limit.
const REQUEUES: u32 = 20;

/// The scheduler.
#[derive(Debug)]
pub(super) struct Slurm;

impl Scheduler for Slurm {
    fn name(&self) -> &'static str {
        "slurm"
    }

    fn program(&self) -> &'static str {
        "sbatch"
    }

    fn refusal(&self, option: SubmitOption) -> Option<&'static str> {
        (option == SubmitOption::Hosts).then_some("it is for `cluster submit ssh`")
    }

    fn queue(&self) -> Option<&dyn QueueCommands> {
        Some(self)
    }

    /// Slurm parses its directives itself, with quoting rules other than a shell's.
    fn unfit_in_paths(&self) -> &'static [char] {
        &['"', '\\']
    }

    fn shard_script(&self, submission: &Submission) -> String {
        let (Submission { name, shards, limits: ShardLimits { cpus, .. }, .. }, notice) =
            (submission, submission.notice());
        format!(
            "#!/bin/sh\n\
             #SBATCH --job-name={name}\n\
             #SBATCH --nodes=1\n\
             #SBATCH --ntasks=1\n\
             #SBATCH --cpus-per-task={cpus}\n\
             #SBATCH --time={}\n\
             #SBATCH --signal=B:USR1@{notice}\n\
             #SBATCH --requeue\n\
             #SBATCH --open-mode=append\n\
             #SBATCH --output={}\n\
             {ABOUT}\
             # also after SIGTERM, and {notice} s before the time limit, when Slurm sends SIGUSR1. Then it queues\n\
             # again, at most {REQUEUES} times.\n\
             shard=$((SLURM_ARRAY_TASK_ID + ${{1:-0}}))\n\
             {} &\n\
             run=$!\n\
             trap : TERM # the run receives it, too\n\
             trap 'limit=reached; kill -TERM $run' USR1\n\
             while wait $run; code=$?; kill -0 $run 2>/dev/null; do :; done # a signal only interrupts wait\n\
             [ $code -le 128 ] || {{ wait $run; code=$?; }} # the run has ended meanwhile\n\
             if [ \"$code $limit\" = \"{} reached\" ] && [ \"${{SLURM_RESTART_COUNT:-0}}\" -lt {REQUEUES} ]; then\n  \
               exec scontrol requeue \"$SLURM_JOB_ID\"\n\
             fi\n\
             exit $code\n",
            clock(submission.limits.seconds),
            directive(submission, &format!("shard-%a-of-{shards}.out")),
            submission.run("$shard", None),
            Exit::Interrupted as u8,
        )
    }

    fn merge_script(&self, submission: &Submission) -> String {
        format!(
            "#!/bin/sh\n\
             #SBATCH --job-name={}-merge\n\
             #SBATCH --ntasks=1\n\
             #SBATCH --cpus-per-task=1\n\
             #SBATCH --open-mode=append\n\
             #SBATCH --output={}\n\
             # Runs when all shards have ended, successfully or not; merges the databases of the folder.\n\
             exec {}\n",
            submission.name,
            directive(submission, "merge.out"),
            submission.merge()
        )
    }
}

impl QueueCommands for Slurm {
    fn most_index(&self) -> u32 {
        max_array_size().unwrap_or(MAX_ARRAY_SIZE) - 1
    }

    fn cluster(&self, options: &[String]) -> Option<String> {
        clusters_of(options).or_else(|| std::env::var("SBATCH_CLUSTERS").ok())
    }

    fn submit_shards(&self, submission: &Submission, array: &JobArray, name: &str) -> Vec<String> {
        let script = submission.folder.join("shard.sh").display().to_string();
        let throttle = submission.queue.at_most.map_or(String::new(), |most| format!("%{most}"));
        let which = format!("--array={}{throttle}", ranges(&array.indices));
        let offset = array.offset.to_string();
        let file = format!("shard-%a+{offset}-of-{}.out", submission.shards);
        let folder = submission.folder.display().to_string().replace('%', "%%");
        let output = format!("--output={folder}/{file}");
        // Indices of further arrays start from 1, too. Slurm uses the last of repeated options.
        let (mut head, mut tail) = (vec!["sbatch", "--parsable", &which], vec![&*script]);
        if array.offset > 0 {
            head.push(&output);
            tail.push(&offset);
        }
        let named = [vec![format!("--job-name={name}")], on_cluster(submission)].concat();
        words(&head, &[&submission.queue.for_shards[..], &named].concat(), &tail)
    }

    fn submit_merge(&self, submission: &Submission, jobs: &[String]) -> Option<Vec<String>> {
        let script = submission.folder.join(MERGE).display().to_string();
        let after = format!("--dependency=afterany:{}", jobs.join(":"));
        let options = [&submission.queue.for_merge[..], &on_cluster(submission)].concat();
        Some(words(&["sbatch", "--parsable", &after], &options, &[&script]))
    }

    fn has_merge_job(&self) -> bool {
        true
    }

    fn after_limit(&self) -> &'static str {
        "is queued again by Slurm"
    }

    fn look_up(&self, name: &str, job: &mut Job) -> Result<(), QueueError> {
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
        Ok(())
    }

    fn add_states(&self, jobs: &[&Job], cluster: Option<&str>, queue: &mut Queue) -> Result<(), QueueError> {
        let ids = format!("--jobs={}", numbers(jobs));
        let before = queue.jobs.len();
        match output(&squeue("--format=%F|%K|%T|%r", &ids, cluster)) {
            Ok(text) => add(queue, &text, jobs),
            // Slurm's error if the only requested job has left the queue.
            Err(QueueError::Failed { said, .. }) if said.contains("Invalid job id") => {}
            Err(error) => return Err(error),
        }
        if queue.jobs.len() > before {
            queue.cluster = cluster.map(str::to_owned);
        }
        Ok(())
    }
}

fn squeue(format: &str, which: &str, cluster: Option<&str>) -> Vec<String> {
    let words = ["squeue", "--noheader", "--array", format, which].map(str::to_owned);
    words.into_iter().chain(cluster.map(|name| format!("--clusters={name}"))).collect()
}

/// `MaxArraySize`, if available.
fn max_array_size() -> Option<u32> {
    let config = output(&["scontrol", "show", "config"].map(str::to_owned)).ok()?;
    let line = config.lines().find_map(|line| line.trim().strip_prefix("MaxArraySize"))?;
    line.split_once('=')?.1.trim().parse().ok()
}

/// Option for the cluster: jobs can depend only on jobs of the same cluster.
fn on_cluster(submission: &Submission) -> Vec<String> {
    submission.queue.cluster.iter().map(|cluster| format!("--clusters={cluster}")).collect()
}

/// The clusters in options of `sbatch`.
fn clusters_of(options: &[String]) -> Option<String> {
    let mut words = options.iter();
    let mut found = None;
    while let Some(word) = words.next() {
        found = match word.strip_prefix("--clusters=").or_else(|| word.strip_prefix("-M")) {
            Some("") => words.next().cloned(),
            Some(name) => Some(name.to_owned()),
            None if word == "--clusters" => words.next().cloned(),
            None => found,
        };
    }
    found
}

/// A file of the folder in a directive; escapes `%`, which starts a pattern.
fn directive(submission: &Submission, file: &str) -> String {
    format!("\"{}/{file}\"", submission.folder.display().to_string().replace('%', "%%"))
}

/// Formats seconds.
fn clock(seconds: u64) -> String {
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    let clock = format!("{:02}:{:02}:{:02}", rest / 3600, rest / 60 % 60, rest % 60);
    if days > 0 { format!("{days}-{clock}") } else { clock }
}

/// Adds lines of `squeue`: job, index, state, and reason for waiting.
fn add(queue: &mut Queue, text: &str, jobs: &[&Job]) {
    for line in text.lines() {
        let mut parts = line.split('|').map(str::trim);
        let (Some(job), Some(index), Some(state)) = (parts.next(), parts.next(), parts.next()) else {
            continue;
        };
        let reason = parts.next().unwrap_or("None");
        let state = state.to_lowercase();
        queue.add_job(job);
        if let Ok(index) = index.parse::<u32>()
            && let Some(known) = jobs.iter().find(|known| known.job == job)
        {
            let state = if reason == "None" { state } else { format!("{state} ({reason})") };
            queue.shards.insert(known.offset + index, state);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_slurm() {
        assert_eq!((clock(14_400), clock(129_661)), ("04:00:00".into(), "1-12:01:01".into()));
    }

    #[test]
    fn lines_of_the_queue_are_read() {
        let job = |job: &str, merge: &str| Job {
            scheduler: "slurm".into(),
            job: job.into(),
            merge_job: Some(merge.into()),
            shards: 4,
            ..Job::default()
        };
        let (one, two) = (job("7", "8"), job("9", "10"));
        let mut queue = Queue::default();
        add(&mut queue, "7|3|RUNNING|None\n7|4|PENDING|Resources\n8|N/A|PENDING|Dependency\n", &[&one, &two]);
        assert_eq!(queue.shards, [(3, "running".into()), (4, "pending (Resources)".into())].into());
        assert_eq!(queue.jobs, ["7", "8"]);
        let mut queue = Queue::default();
        add(&mut queue, "7|3|RUNNING|None\n", &[&Job { offset: 1000, ..one }]);
        assert_eq!(queue.shards, [(1003, "running".into())].into());
    }
}
