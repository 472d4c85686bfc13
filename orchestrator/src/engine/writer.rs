//! The only writer to the store: takes entries from a queue and writes them in shared transactions.
//!
//! All entries that wait when a transaction begins share it, so that one fsync serves many records. `WriterEvent` is sent after the
//! commit.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use metasense_schemas::reason::{CANCELLED, Reason};
use metasense_schemas::record::{Checkpoint, StepRecord, TrialResult};
use metasense_schemas::wire::{ArrayHead, Lease, Sample};
use tokio::sync::mpsc::{Receiver, UnboundedSender};

use crate::control::Request;
use crate::plan::Plan;
use crate::scheduler::{RecordKind, WorkerId};
use crate::store::{LogLevel, PriorProgress, Store, StoreError, StoredArray};

/// Most entries per transaction.
const BATCH: usize = 128;

/// A record in the queue.
#[derive(Debug)]
pub enum QueuedRecord {
    Begin(Lease),
    Step(Lease, Box<StepRecord>, Arc<Checkpoint>),
    /// A checkpoint of the final evaluation.
    Checkpoint(Lease, Arc<Checkpoint>),
    /// A result with its arrays, which stay in shared memory until they are recorded.
    Result(Lease, Box<TrialResult>, Option<ResultArrays>),
    /// The end of an attempt without a result; `true`: the trial has failed.
    Failure(Lease, Reason, bool),
    /// CPU seconds of an attempt so far.
    Spent(Lease, f64),
    Log(Lease, LogLevel, String),
    /// Request for a trial's checkpoint, of at most this many steps.
    Load(WorkerId, Lease, Option<u32>),
    /// Of a pending trial.
    Cancelled(Lease),
}

/// An entry of the queue.
#[derive(Debug)]
pub enum Entry {
    /// A record; consecutive ones share a transaction.
    Write(QueuedRecord),
    /// The reloaded plan, which gets its own transactions, and the request for it.
    Plan(Arc<Plan>, Request),
}

/// New trials of a reloaded plan.
#[derive(Debug)]
pub struct NewTrials {
    pub plan: Arc<Plan>,
    /// Trials that are new to the run: index in the plan, and state after earlier runs.
    pub trials: Vec<(usize, PriorProgress)>,
    /// Recorded steps per body.
    pub bodies: HashMap<String, u32>,
    /// Number of other new trials that had ended before this run.
    pub settled: usize,
}

/// The arrays of a result, in shared memory.
#[derive(Debug)]
pub struct ResultArrays {
    /// Name, shape and place of each array.
    pub heads: Vec<ArrayHead>,
    /// The shared memory that contains them.
    pub sample: Sample,
}

impl ResultArrays {
    fn all(&self) -> Vec<StoredArray<'_>> {
        let bytes = self.sample.payload();
        let array = |head| {
            let ArrayHead { name, shape, start, end }: &ArrayHead = head;
            StoredArray { name, shape, npy: &bytes[*start..*end] }
        };
        self.heads.iter().map(array).collect()
    }
}

/// A message of the writer.
#[derive(Debug)]
pub enum WriterEvent {
    /// A record is on disk.
    Recorded(Lease, RecordKind),
    /// A result is on disk.
    Done(Lease, Box<TrialResult>),
    /// The requested checkpoint, or why the stored one cannot be used.
    Loaded(WorkerId, Lease, Result<Option<Box<Checkpoint>>, String>),
    /// New trials are on disk.
    Planned(NewTrials, Request),
    /// The database failed.
    Broken(StoreError),
}

/// Writes entries until the queue is closed. `hashes`: hashes of the run's trials, by number.
pub async fn write(
    store: &mut Store,
    mut hashes: Vec<String>,
    mut queue: Receiver<Entry>,
    event_sender: UnboundedSender<WriterEvent>,
) {
    let done = async {
        let mut batch = Vec::with_capacity(BATCH);
        while let Some(first) = queue.recv().await {
            let (mut next, mut reread) = (Some(first), None);
            while let Some(entry) = next.take() {
                match entry {
                    Entry::Plan(plan, request) => reread = Some((plan, request)),
                    Entry::Write(write) => {
                        batch.push(write);
                        next = if batch.len() < BATCH { queue.try_recv().ok() } else { None };
                    }
                }
            }
            for word in transact(store, &hashes, batch.drain(..)).await? {
                drop(event_sender.send(word));
            }
            if let Some((plan, request)) = reread {
                let fresh = add(store, &mut hashes, plan).await?;
                drop(event_sender.send(WriterEvent::Planned(fresh, request)));
            }
        }
        Ok(())
    };
    if let Err(error) = done.await {
        store.drop_batch().await;
        drop(event_sender.send(WriterEvent::Broken(error)));
    }
}

/// Records a plan, and appends the hashes of its new, open trials to `hashes`.
async fn add(store: &mut Store, hashes: &mut Vec<String>, plan: Arc<Plan>) -> Result<NewTrials, StoreError> {
    store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await?;
    let settled: HashSet<String> = store.settled().await?.into_iter().collect();
    let (attempted, bodies) = (store.attempted().await?, store.bodies().await?);
    let known: HashSet<&str> = hashes.iter().map(String::as_str).collect();
    let new = plan.trials.iter().enumerate().filter(|(_, trial)| !known.contains(trial.hash.as_str()));
    let (old, open): (Vec<_>, Vec<_>) = new.partition(|(_, trial)| settled.contains(&trial.hash));
    let found = |hash| attempted.get(hash).copied().unwrap_or_default();
    let trials: Vec<_> = open.iter().map(|(place, trial)| (*place, found(&trial.hash))).collect();
    let (settled, open): (_, Vec<_>) =
        (old.len(), open.iter().map(|(_, trial)| trial.hash.clone()).collect());
    hashes.extend(open);
    Ok(NewTrials { plan, trials, bodies, settled })
}

/// Records a batch in one transaction. Arrays stay in shared memory until it is committed.
async fn transact(
    store: &mut Store,
    hashes: &[String],
    batch: impl ExactSizeIterator<Item = QueuedRecord>,
) -> Result<Vec<WriterEvent>, StoreError> {
    let mut written = Vec::with_capacity(batch.len());
    if batch.len() == 0 {
        return Ok(written);
    }
    let mut held = Vec::new();
    let hash = |lease: Lease| hashes[lease.trial as usize].as_str();
    store.begin_batch().await?;
    for entry in batch {
        written.push(match entry {
            QueuedRecord::Begin(lease) => {
                let attempt = store.begin_attempt(hash(lease)).await?;
                assert_eq!(attempt, lease.attempt, "attempts at {} are counted twice", hash(lease));
                continue;
            }
            QueuedRecord::Step(lease, record, checkpoint) => {
                store.record_step(hash(lease), lease.attempt, &record, &checkpoint).await?;
                WriterEvent::Recorded(lease, RecordKind::Step)
            }
            QueuedRecord::Checkpoint(lease, checkpoint) => {
                store.record_checkpoint(hash(lease), lease.attempt, &checkpoint).await?;
                WriterEvent::Recorded(lease, RecordKind::Step)
            }
            QueuedRecord::Result(lease, result, arrays) => {
                let all = arrays.as_ref().map(ResultArrays::all).unwrap_or_default();
                store.finish(hash(lease), lease.attempt, &result, &all).await?;
                held.push(arrays);
                WriterEvent::Done(lease, result)
            }
            QueuedRecord::Failure(lease, reason, settled) => {
                let (hash, reason) = (hash(lease), reason.to_string());
                store.fail(hash, lease.attempt, &reason, settled).await?;
                WriterEvent::Recorded(lease, RecordKind::Failure)
            }
            QueuedRecord::Cancelled(lease) => {
                store.fail_pending(hash(lease), CANCELLED).await?;
                WriterEvent::Recorded(lease, RecordKind::Failure)
            }
            QueuedRecord::Spent(lease, seconds) => {
                store.record_cpu_seconds(hash(lease), lease.attempt, seconds).await?;
                continue;
            }
            QueuedRecord::Log(lease, level, text) => {
                store.log(hash(lease), lease.attempt, level, &text).await?;
                continue;
            }
            QueuedRecord::Load(worker, lease, pause) => {
                let checkpoint = match store.resume_checkpoint(hash(lease), lease.attempt, pause).await {
                    Err(StoreError::Unreadable { message, .. }) => Err(message),
                    Err(StoreError::Damaged(..)) => Err("it is damaged (its checksum does not match)".into()),
                    other => Ok(other?.map(Box::new)),
                };
                WriterEvent::Loaded(worker, lease, checkpoint)
            }
        });
    }
    store.commit_batch().await?;
    Ok(written)
}
