//! Rounds of shards: trials that a search or questions need are assigned to shards, run and merged, until the answer is final.
//!
//! A trial stays with the shard that started it, which has its steps. Decisions are made here, from the merged database.

use std::collections::{BTreeSet, HashSet};
use std::path::Path;
use std::time::Duration;

use metasense_schemas::record::PlannedTrial;

use super::queued::submit_shards;
use super::{Args, Program, launch_config, note_here, prepare, print};
use crate::analysis::until::TrialErrors;
use crate::cli::results::Results;
use crate::cli::{Error, Format, design, run};
use crate::cluster::home::attempts;
use crate::cluster::merge::{Extent, FindingKind, merge};
use crate::cluster::places::{self, HostSlot};
use crate::cluster::queue::{self, Job, Notes, Queue, QueueError};
use crate::cluster::submit::Submission;
use crate::cluster::{Assignment, ranges};
use crate::engine::RerunPolicy;
use crate::exit::Exit;
use crate::plan::{Plan, counted};
use crate::reader::Reader;
use crate::rounds::{self, Runs};
use crate::scheduler::RunOutcome;
use crate::signals::Signals;
use crate::store::Store;

/// Time between two queries of a queue.
const LOOK: Duration = Duration::from_secs(5);
/// Maximum number of consecutive failed queries of a queue.
const UNANSWERED_MOST: u32 = 60;

pub(super) async fn execute(
    args: &Args,
    plan: Plan,
    places: Vec<HostSlot>,
    shards: u32,
    jobs: Vec<Job>,
    queue: &Queue,
) -> Result<Exit, Error> {
    if args.retry_failed {
        return usage!(
            "--retry-failed: not for rounds, which depend on earlier results; leave it out, or use `run`, or `design` for a [goal]"
        );
    }
    let space = if args.goal { Some(design::space(&plan)?) } else { None };
    let program = Program::of_this_process()?;
    let mut submission = Submission { merges: false, ..args.submission(&plan, shards, &program)? };
    submission.queue.cluster.clone_from(&queue.cluster);
    if args.dry_run {
        print(&submission)?;
        return Ok(Exit::Done);
    }
    let mut notes = prepare(&plan, &submission, &program, &queue.jobs)?;
    if !submission.has_queue() {
        note_here(&submission, &mut notes)?;
    }
    let (db, folder, signals) = (submission.out.clone(), submission.folder.clone(), Signals::new()?);
    Store::open(&db).await?.close().await?;
    let mut shards = Shards { plan: &plan, submission, places, notes, jobs, signals };
    let room = shards.workers();
    if let Some(few) = space.as_ref().map(|space| space.goal.at_a_time).filter(|few| *few < room as usize) {
        let shards = counted(shards.submission.shards as usize, "shard");
        say!("goal.at_a_time = {few}: {few} trials per round, but {shards} have room for {room}");
    }
    // shards that an earlier `submit` left running
    let outcome = match shards.wait().await? {
        false => Some(RunOutcome::Interrupted),
        true => {
            shards.gather().await?;
            match &space {
                Some(space) => rounds::search(shards, space, RerunPolicy::default()).await?,
                None => rounds::rounds(shards, RerunPolicy::default()).await?,
            }
        }
    };
    let outcome = outcome.unwrap_or(RunOutcome::Complete);
    match space {
        Some(space) => design::end(&db, plan, space, Format::default(), outcome).await,
        None => {
            let results = Results { db: &db, named: &db, log: &folder };
            run::end(results, &plan, Format::default(), outcome).await
        }
    }
}

/// Shards of a folder and the database into which they are merged.
struct Shards<'a> {
    plan: &'a Plan,
    submission: Submission,
    places: Vec<HostSlot>,
    notes: Notes,
    /// Jobs that may still be in a queue.
    jobs: Vec<Job>,
    signals: Signals,
}

impl Runs for Shards<'_> {
    type Error = Error;

    fn plan(&self) -> &Plan {
        self.plan
    }

    fn database(&self) -> &Path {
        &self.submission.out
    }

    fn workers(&self) -> u32 {
        self.submission.shards * self.submission.workers()
    }

    async fn trial_results(&mut self) -> Result<Vec<TrialErrors>, Error> {
        let mut store = Store::open(self.database()).await?;
        let found = store.trial_errors().await;
        store.close().await?;
        Ok(found?)
    }

    async fn reopen(&mut self, _: &[&str], _: RerunPolicy) -> Result<(), Error> {
        Ok(()) // `submit` refuses --retry-failed with rounds
    }

    async fn run(&mut self, trials: &[PlannedTrial], _: RerunPolicy) -> Result<Option<RunOutcome>, Error> {
        let settled: HashSet<_> = self.trial_results().await?.into_iter().map(|found| found.hash).collect();
        let open: Vec<PlannedTrial> =
            trials.iter().filter(|trial| !settled.contains(&trial.hash)).cloned().collect();
        if open.is_empty() {
            say!("nothing left to do: {} settled", counted(trials.len(), "trial"));
            return Ok(None);
        }
        let folder = self.submission.folder.clone();
        let assignment = Assignment::in_folder(&folder, &open, self.submission.shards)?;
        assignment.write(&folder)?;
        assignment.write_trials(&folder, &open)?;
        let which: BTreeSet<u32> = open.iter().map(|trial| assignment.shard(&trial.hash)).collect();
        self.submission.which = which.into_iter().collect();
        say!("{} in shards {}", counted(open.len(), "trial"), ranges(&self.submission.which));
        let before = self.progress().await?;
        let goes_on = if let Some(commands) = self.submission.scheduler.queue() {
            self.jobs = submit_shards(&mut self.submission, commands, &mut self.notes)?;
            self.wait().await?
        } else {
            let how = launch_config(&self.submission);
            let ended = places::run(&self.places, &self.submission.which, &how, &mut self.signals, |line| {
                say!("{line}")
            });
            !ended.await.asked
        };
        self.gather().await?;
        if !goes_on {
            return Ok(Some(RunOutcome::Interrupted));
        }
        if self.progress().await? == before {
            return Err(Error::Shards { folder, shards: ranges(&self.submission.which) });
        }
        Ok(Some(RunOutcome::Complete))
    }

    fn is_stopping(&self) -> bool {
        false // a stop interrupts the round
    }

    fn say(&self, line: &str) {
        say!("{line}");
    }
}

impl Shards<'_> {
    /// Waits until the queue contains no shard; returns false if the user asks for the end.
    async fn wait(&mut self) -> Result<bool, Error> {
        let mut unanswered = 0;
        loop {
            match queue::ask(&mut self.jobs) {
                Ok(queue) if queue.shards.is_empty() => return Ok(true),
                Ok(_) => unanswered = 0,
                Err(QueueError::Failed { .. }) if unanswered < UNANSWERED_MOST => unanswered += 1,
                Err(error) => return Err(error.into()),
            }
            if self.signals.or_signal(tokio::time::sleep(LOOK)).await.is_none() {
                say!("the shards in the queue continue; the same command resumes with their results");
                return Ok(false);
            }
        }
    }

    /// Merges the databases that were handed in.
    async fn gather(&self) -> Result<(), Error> {
        let Submission { folder, out, .. } = &self.submission;
        if attempts(folder).is_empty() {
            return Ok(());
        }
        let summary = merge(Extent::Whole, std::slice::from_ref(folder), out).await?;
        for (file, why) in &summary.refused {
            say!("refused: {}: {why}", file.display());
        }
        for finding in summary.findings.iter().filter(|finding| finding.kind == FindingKind::Bits) {
            say!("results of trial {} disagree: {}", finding.hash, finding.what);
        }
        Ok(())
    }

    async fn progress(&self) -> Result<u64, Error> {
        Ok(Reader::with_reader(self.database(), async |reader| reader.progress().await).await?)
    }
}
