//! Submits shards to a scheduler's queue. Each job is noted beforehand, in case the answer is lost.

use std::process::Command;

use super::Error;
use crate::cluster::queue::{Job, Notes, Queue};
use crate::cluster::ranges;
use crate::cluster::scheduler::QueueCommands;
use crate::cluster::submit::{Submission, line};
use crate::files;

/// Queues shards. Each job is noted before it is submitted, under a name by which it is found if this process ends in between.
pub(super) fn submit_shards(
    submission: &mut Submission,
    commands: &dyn QueueCommands,
    notes: &mut Notes,
) -> Result<Vec<Job>, Error> {
    let noting = Error::io("noting what was submitted in", &submission.folder);
    let cluster = commands.cluster(&submission.queue.for_shards);
    let mut jobs: Vec<Job> = Vec::new();
    for array in submission.arrays() {
        let shards: Vec<u32> = array.indices.iter().map(|index| array.offset + index).collect();
        let name = format!("{}.{}", submission.name, files::fresh_mark());
        let mut job = Job {
            scheduler: submission.scheduler.name().to_owned(),
            name: Some(name.clone()),
            cluster: submission.queue.cluster.clone().or_else(|| cluster.clone()),
            shards: submission.shards,
            offset: array.offset,
            ..Job::default()
        };
        notes.note(&job).map_err(&noting)?;
        let submitted = run(&commands.submit_shards(submission, &array, &name)).or_else(|refused| {
            // the job may have been accepted and only the answer lost
            match commands.look_up(&name, &mut job) {
                Ok(()) if !job.job.is_empty() => Ok((job.job.clone(), job.cluster.clone())),
                Ok(()) if jobs.is_empty() => Err(Error::Usage(refused)),
                _ => Err(Error::Partly(format!("{refused}; {}", left(submission, &jobs, &shards)))),
            }
        });
        let (number, cluster) = submitted?;
        (job.job, job.cluster) = (number, cluster.clone());
        submission.queue.cluster = cluster.or(submission.queue.cluster.take());
        say!("submitted: job {}, shards {}", job.job, ranges(&shards));
        notes.note(&job).map_err(&noting)?;
        jobs.push(job);
    }
    Ok(jobs)
}

/// States which shards are queued and which are not after a scheduler has refused some.
fn left(submission: &Submission, jobs: &[Job], refused: &[u32]) -> String {
    let from = submission.which.iter().position(|shard| refused.contains(shard)).unwrap_or(0);
    let queued: Vec<&str> = jobs.iter().map(|job| job.job.as_str()).collect();
    let queued = match queued.is_empty() {
        true => "it is unknown whether it was accepted".to_owned(),
        false => format!("queued: jobs {}", queued.join(", ")),
    };
    let merge = if submission.merges { " and the merge" } else { "" };
    let left = ranges(&submission.which[from..]);
    format!("{queued}; not queued: shards {left}{merge}. The same command submits them")
}

/// Queues shards, and a merge that waits for them and for the jobs already in the queue.
pub(super) fn submit(
    submission: &mut Submission,
    commands: &dyn QueueCommands,
    notes: &mut Notes,
    mut jobs: Vec<Job>,
    queue: &Queue,
) -> Result<(), Error> {
    submission.queue.cluster.clone_from(&queue.cluster);
    let new = submit_shards(submission, commands, notes)?;
    let (folder, out) = (files::quoted(&submission.folder), submission.out.display());
    say!("metasense status --folder {folder} shows the shards");
    jobs.retain(|job| queue.jobs.contains(&job.job));
    jobs.extend(new);
    let mut before: Vec<String> = jobs.iter().map(|job| job.job.clone()).collect();
    before.extend(queue.jobs.iter().filter(|job| !jobs.iter().any(|known| known.job == **job)).cloned());
    let Some(merge) = commands.submit_merge(submission, &before) else {
        say!("the last shard to end merges them into {out}; the same command resumes interrupted shards");
        return Ok(());
    };
    let (merge_job, _) = run(&merge).map_err(|refused| {
        Error::Partly(format!(
            "{refused}; the shards are queued, but not the merge: run the same command to queue it, or later `metasense cluster merge \
             {folder} --out {}`",
            files::quoted(&submission.out)
        ))
    })?;
    say!("submitted: job {merge_job}, the merge into {out}");
    for job in &mut jobs {
        job.merge_job = Some(merge_job.clone());
        notes.note(job).map_err(Error::io("noting what was submitted in", &submission.folder))?;
    }
    Ok(())
}

/// Runs a scheduler's command; returns the job number that it prints, and its cluster if it names one.
///
/// # Errors
/// The command's output, if it contains no job number.
fn run(words: &[String]) -> Result<(String, Option<String>), String> {
    let failed = |how: &str, said: &str| format!("`{}` failed ({how}): {said}", line(words));
    let output =
        Command::new(&words[0]).args(&words[1..]).output().map_err(|e| failed(&e.to_string(), ""))?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    // Slurm's last line is `NUMBER` or `NUMBER;CLUSTER`.
    let last = said.trim().lines().last().unwrap_or_default();
    let (job, cluster) = last.split_once(';').map_or((last, None), |(job, on)| (job, Some(on.to_owned())));
    if output.status.success() && job.parse::<u64>().is_ok() {
        return Ok((job.to_owned(), cluster));
    }
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    Err(failed(&output.status.to_string(), [said.trim(), errors.trim()].join(" ").trim()))
}
