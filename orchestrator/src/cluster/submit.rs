//! What is handed to a cluster's scheduler: scripts to read, and the commands that submit them. Pure.

use std::path::{Path, PathBuf};

use super::Assignment;
use super::shard::ranges;
use crate::plan::Trial;

/// SIGTERM comes so long before the time limit (s): the run ends within two seconds, the copy has the rest.
pub const NOTICE: u64 = 60;
/// Most shards that are planned; more have to be asked for. Slurm's `MaxArraySize` is 1001 where nobody has changed it.
const MOST_PLANNED: u32 = 1000;

/// A scheduler.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Scheduler {
    /// Slurm, by `sbatch`
    Slurm,
    /// `HyperQueue`, by `hq`
    Hq,
}

/// Shards to submit.
#[derive(Debug, Clone)]
pub struct Submission {
    /// To whom.
    pub scheduler: Scheduler,
    /// The sweep.
    pub name: String,
    /// This program.
    pub program: PathBuf,
    /// The spec file.
    pub spec: PathBuf,
    /// What is changed of it, as `run` takes it.
    pub changes: Vec<String>,
    /// Where scripts, outputs and databases of shards go.
    pub folder: PathBuf,
    /// The merged database.
    pub out: PathBuf,
    /// Shards of the sweep.
    pub shards: u32,
    /// Those to submit, from 1.
    pub which: Vec<u32>,
    /// Cores of each.
    pub cpus: u32,
    /// Threads of a worker.
    pub threads: u32,
    /// Time limit (s).
    pub seconds: u64,
    /// Where the scheduler has several queues.
    pub partition: Option<String>,
    /// Failed trials are run again.
    pub retry_failed: bool,
    /// Passed on to the scheduler's command as they are.
    pub further: Vec<String>,
}

/// A file to write.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Script {
    /// Its name in the folder.
    pub name: &'static str,
    /// What it says.
    pub text: String,
}

/// As many shards as make each take half of its time limit, by an estimate that is good to a factor of two.
#[must_use]
pub fn planned(trials: &[Trial], cpus: u32, seconds: u64) -> u32 {
    let total: f64 = trials.iter().map(|trial| trial.cost).sum();
    let shards = (2.0 * total / (f64::from(cpus) * seconds as f64)).ceil();
    (shards.max(1.0) as u32).min(MOST_PLANNED).min(trials.len().try_into().unwrap_or(u32::MAX))
}

/// Estimated seconds of the mean and of the longest shard, each on its cores.
#[must_use]
pub fn estimate(trials: &[Trial], assignment: &Assignment, cpus: u32) -> (f64, f64) {
    let costs = assignment.costs(trials);
    let cores = f64::from(cpus);
    let longest_trial = trials.iter().map(|trial| trial.cost).fold(0.0, f64::max);
    let longest = costs.iter().fold(0.0_f64, |most, cost| most.max(cost / cores)).max(longest_trial);
    (costs.iter().sum::<f64>() / costs.len() as f64 / cores, longest)
}

impl Submission {
    /// What cannot stand in a script's lines, if anything: paths go into them as they are, or quoted.
    #[must_use]
    pub fn unfit(&self) -> Option<String> {
        let control = |text: &str| text.chars().any(char::is_control);
        // Slurm reads its directives itself, with quotes and backslashes of its own.
        let directive = |text: &str| self.scheduler == Scheduler::Slurm && text.contains(['"', '\\']);
        let paths =
            [("folder", &self.folder), ("out", &self.out), ("spec", &self.spec), ("program", &self.program)];
        let path = paths.into_iter().find(|(name, path)| {
            path.to_str().is_none_or(|text| control(text) || *name == "folder" && directive(text))
        });
        let partition = self.partition.as_ref().filter(|p| p.contains(char::is_whitespace) || control(p));
        let change = self.changes.iter().find(|change| control(change));
        path.map(|(name, path)| {
            format!("{name} {path:?}: must be text without line ends, quotes and backslashes")
        })
        .or_else(|| change.map(|change| format!("{change:?}: must be text without line ends")))
        .or_else(|| partition.map(|name| format!("partition {name:?}: is no name of a partition")))
    }

    /// The scripts: of a shard, and of the merge.
    #[must_use]
    pub fn scripts(&self) -> [Script; 2] {
        let (shard, merge) = match self.scheduler {
            Scheduler::Slurm => (self.slurm_shard(), self.slurm_merge()),
            Scheduler::Hq => (self.hq_shard(), self.hq_merge()),
        };
        [Script { name: "shard.sh", text: shard }, Script { name: "merge.sh", text: merge }]
    }

    fn slurm_shard(&self) -> String {
        let Self { name, cpus, shards, .. } = self;
        format!(
            "#!/bin/sh\n\
             #SBATCH --job-name={name}\n\
             #SBATCH --array={}\n\
             #SBATCH --nodes=1\n\
             #SBATCH --ntasks=1\n\
             #SBATCH --cpus-per-task={cpus}\n\
             #SBATCH --time={}\n\
             {}\
             #SBATCH --signal=B:TERM@{NOTICE}\n\
             #SBATCH --requeue\n\
             #SBATCH --open-mode=append\n\
             #SBATCH --output={}\n\
             # A shard of the sweep: an ordinary run with its database on the node's own disk, under TMPDIR. It goes on\n\
             # from what an earlier attempt has left here, and puts its database here when it ends: also by SIGTERM, which\n\
             # comes {NOTICE} s before the time limit and reaches it because of exec.\n\
             exec {} \"$SLURM_ARRAY_TASK_ID/{shards}\" {}\n",
            ranges(&self.which),
            clock(self.seconds),
            self.partition_line(),
            self.directive(&format!("shard-%a-of-{shards}.out")),
            self.run(),
            self.how()
        )
    }

    fn slurm_merge(&self) -> String {
        format!(
            "#!/bin/sh\n\
             #SBATCH --job-name={}-merge\n\
             #SBATCH --ntasks=1\n\
             #SBATCH --cpus-per-task=1\n\
             {}\
             #SBATCH --open-mode=append\n\
             #SBATCH --output={}\n\
             # When all shards have ended, however: what there is becomes one database.\n\
             exec {}\n",
            self.name,
            self.partition_line(),
            self.directive("merge.out"),
            self.merge()
        )
    }

    fn hq_shard(&self) -> String {
        let output = format!("{}/shard-\"$HQ_TASK_ID\"-of-{}.out", quoted(&self.folder), self.shards);
        format!(
            "#!/bin/sh\n\
             # A shard of the sweep: an ordinary run with its database on the node's own disk, under TMPDIR. It goes on\n\
             # from what an earlier attempt has left here, and puts its database here when it ends: by itself {NOTICE} s before\n\
             # the time limit, of which HyperQueue gives no notice.\n\
             exec {} \"$HQ_TASK_ID/{}\" {} --stop-after {} \\\n  >> {output} 2>&1\n",
            self.run(),
            self.shards,
            self.how(),
            self.seconds.saturating_sub(NOTICE).max(1),
        )
    }

    fn hq_merge(&self) -> String {
        format!(
            "#!/bin/sh\n\
             # When all shards of jobs $1 have ended, however: what there is becomes one database.\n\
             hq job wait \"$1\"\n\
             exec {} >> {} 2>&1\n",
            self.merge(),
            quoted(&self.folder.join("merge.out"))
        )
    }

    /// Up to the number of the shard.
    fn run(&self) -> String {
        let changes: String =
            self.changes.iter().map(|change| format!(" {}", quoted(Path::new(change)))).collect();
        format!("{} run {}{changes} --shard", quoted(&self.program), quoted(&self.spec))
    }

    /// From there on.
    fn how(&self) -> String {
        let workers = (self.cpus / self.threads).max(1);
        let again = if self.retry_failed { " --retry-failed" } else { "" };
        format!("--workers {workers} --threads {} --copy-to {}{again}", self.threads, quoted(&self.folder))
    }

    fn merge(&self) -> String {
        format!("{} merge {} --out {}", quoted(&self.program), quoted(&self.folder), quoted(&self.out))
    }

    fn partition_line(&self) -> String {
        self.partition.as_ref().map_or(String::new(), |p| format!("#SBATCH --partition={p}\n"))
    }

    /// A file of the folder, as a directive wants it: `%` would begin a pattern.
    fn directive(&self, file: &str) -> String {
        format!("\"{}/{file}\"", self.folder.display().to_string().replace('%', "%%"))
    }

    /// The command that submits the shards; it prints the job's number.
    #[must_use]
    pub fn submit_shards(&self) -> Vec<String> {
        let script = self.folder.join("shard.sh").display().to_string();
        match self.scheduler {
            Scheduler::Slurm => self.words(&["sbatch", "--parsable"], &[&script]),
            Scheduler::Hq => {
                let (cpus, limit) = (self.cpus.to_string(), format!("{}s", self.seconds));
                let (name, array) = (&self.name, ranges(&self.which));
                let options =
                    ["--cpus", &cpus, "--time-limit", &limit, "--stdout", "none", "--stderr", "none"];
                let head = ["hq", "--output-mode=quiet", "submit", "--name", name, "--array", &array];
                self.words(&[&head[..], &options].concat(), &["--", "sh", &script])
            }
        }
    }

    /// The command that submits the merge behind them, and behind other jobs on the same folder.
    #[must_use]
    pub fn submit_merge(&self, job: &str, others: &[String]) -> Vec<String> {
        let jobs = |between: &str| [&[job.to_owned()], others].concat().join(between);
        let script = self.folder.join("merge.sh").display().to_string();
        match self.scheduler {
            Scheduler::Slurm => {
                let after = format!("--dependency=afterany:{}", jobs(":"));
                self.words(&["sbatch", "--parsable", &after], &[&script])
            }
            Scheduler::Hq => {
                // It waits on a core, and only for one that no shard wants.
                let name = format!("{}-merge", self.name);
                let head = ["hq", "--output-mode=quiet", "submit", "--name", &name, "--cpus", "1"];
                let tail = ["--priority=-1", "--stdout", "none", "--stderr", "none"];
                self.words(&[&head[..], &tail].concat(), &["--", "sh", &script, &jobs(",")])
            }
        }
    }

    fn words(&self, head: &[&str], tail: &[&str]) -> Vec<String> {
        let own = |words: &[&str]| words.iter().map(ToString::to_string).collect::<Vec<_>>();
        [own(head), self.further.clone(), own(tail)].concat()
    }
}

/// A command as a shell reads it.
#[must_use]
pub fn line(words: &[String]) -> String {
    words.iter().map(|word| quoted(Path::new(word))).collect::<Vec<_>>().join(" ")
}

fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,@%+".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        text
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

/// Seconds as Slurm writes them.
fn clock(seconds: u64) -> String {
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    let clock = format!("{:02}:{:02}:{:02}", rest / 3600, rest / 60 % 60, rest % 60);
    if days > 0 { format!("{days}-{clock}") } else { clock }
}

/// Seconds of a time as `sbatch --time` takes it: `30` (minutes), `30:00`, `4:00:00`, `1-12`, `1-12:00:00`.
///
/// # Errors
/// If it is none.
pub fn seconds(text: &str) -> Result<u64, String> {
    let wrong = || format!("{text:?} is no time: say minutes, H:MM:SS or D-HH:MM:SS, for instance 4:00:00");
    let (days, clock) = text.split_once('-').map_or((None, text), |(days, clock)| (Some(days), clock));
    let parts: Option<Vec<u64>> = clock.split(':').map(|part| part.parse().ok()).collect();
    let days: u64 = days.map_or(Ok(0), str::parse).map_err(|_| wrong())?;
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
        Ok(total)
    } else {
        Err(format!("{text:?} is not between a minute and a year"))
    }
}

#[cfg(test)]
mod tests;
