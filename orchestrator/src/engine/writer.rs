//! The one writer: a queue in front of the store, whose entries share transactions.
//!
//! What waits when a transaction begins goes into it together, so that one fsync serves many records. `Written` is
//! said only after the commit.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use metasense_schemas::reason::{CANCELLED, Reason};
use metasense_schemas::record::{Checkpoint, StepRecord, TrialResult};
use metasense_schemas::wire::{ArrayHead, Lease, Sample};
use tokio::sync::mpsc::{Receiver, UnboundedSender};

use crate::control::Request;
use crate::plan::Plan;
use crate::scheduler::{Mark, WorkerId};
use crate::store::{Array, Attempted, Level, Store, StoreError};

/// Most entries of one transaction.
const BATCH: usize = 128;

/// An entry of the queue.
#[derive(Debug)]
pub enum Write {
    /// An attempt begins.
    Begin(Lease),
    /// A step.
    Step(Lease, Box<StepRecord>, Arc<Checkpoint>),
    /// How far a comparison has come.
    Checkpoint(Lease, Arc<Checkpoint>),
    /// A result with its arrays, which stay in shared memory until they are recorded.
    Result(Lease, Box<TrialResult>, Option<Arrays>),
    /// An attempt has come to nothing.
    Failure(Lease, Reason, bool),
    /// CPU seconds of an attempt so far.
    Spent(Lease, f64),
    /// What is said of an attempt.
    Log(Lease, Level, String),
    /// Where a trial goes on, at most behind so many steps, is wanted for a worker.
    Load(WorkerId, Lease, Option<u32>),
    /// A trial that waits is not to be run.
    Cancelled(Lease),
}

/// What comes through the queue.
#[derive(Debug)]
pub enum Entry {
    /// What shares a transaction with its neighbours.
    Write(Write),
    /// The spec as it is by now, in transactions of its own, for whoever has asked for it.
    Plan(Arc<Plan>, Request),
}

/// Trials of a plan that was read again.
#[derive(Debug)]
pub struct Fresh {
    /// The plan.
    pub plan: Arc<Plan>,
    /// Those that are new to the run, by their places in the plan, and how far earlier runs have come with them.
    pub trials: Vec<(usize, Attempted)>,
    /// How far their bodies have come.
    pub bodies: HashMap<String, u32>,
    /// Of the others: how many were settled before this run began.
    pub settled: usize,
}

/// The arrays of a result, in shared memory.
#[derive(Debug)]
pub struct Arrays {
    /// What they are, and where.
    pub heads: Vec<ArrayHead>,
    /// Where they all lie.
    pub sample: Sample,
}

impl Arrays {
    /// Reads every byte, and does nothing with it.
    pub fn read(&self) {
        let (mut sum, bytes) = (0u64, self.sample.payload());
        let (before, words, after) = bytemuck::pod_align_to::<u8, u64>(bytes);
        for word in words {
            sum = sum.wrapping_add(*word);
        }
        std::hint::black_box((sum, before, after));
    }

    fn all(&self) -> Vec<Array<'_>> {
        let bytes = self.sample.payload();
        let array = |head| {
            let ArrayHead { name, shape, start, end }: &ArrayHead = head;
            Array { name, shape, npy: &bytes[*start..*end] }
        };
        self.heads.iter().map(array).collect()
    }
}

/// What the writer says.
#[derive(Debug)]
pub enum Written {
    /// It is on disk.
    Recorded(Lease, Mark),
    /// So is a result.
    Done(Lease, Box<TrialResult>),
    /// The checkpoint that was wanted; or why the one that is there is of no use.
    Loaded(WorkerId, Lease, Result<Option<Box<Checkpoint>>, String>),
    /// The trials that are to be run beside the others are on disk; they are numbered on.
    Planned(Fresh, Request),
    /// Nothing can be recorded any more.
    Broken(StoreError),
}

/// Writes until the queue is closed. `hashes` are those of the run's trials.
pub async fn write(
    store: &mut Store,
    mut hashes: Vec<String>,
    mut queue: Receiver<Entry>,
    said: UnboundedSender<Written>,
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
                drop(said.send(word));
            }
            if let Some((plan, request)) = reread {
                let fresh = add(store, &mut hashes, plan).await?;
                drop(said.send(Written::Planned(fresh, request)));
            }
        }
        Ok(())
    };
    if let Err(error) = done.await {
        store.drop_batch().await;
        drop(said.send(Written::Broken(error)));
    }
}

/// Records a plan; the trials that are new to the run, and open, are its trials from here on.
async fn add(store: &mut Store, hashes: &mut Vec<String>, plan: Arc<Plan>) -> Result<Fresh, StoreError> {
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
    Ok(Fresh { plan, trials, bodies, settled })
}

/// Records a batch in one transaction. Arrays stay in shared memory until it is committed.
async fn transact(
    store: &mut Store,
    hashes: &[String],
    batch: impl ExactSizeIterator<Item = Write>,
) -> Result<Vec<Written>, StoreError> {
    let mut written = Vec::with_capacity(batch.len());
    if batch.len() == 0 {
        return Ok(written);
    }
    let mut held = Vec::new();
    let hash = |lease: Lease| hashes[lease.trial as usize].as_str();
    store.begin_batch().await?;
    for entry in batch {
        written.push(match entry {
            Write::Begin(lease) => {
                let attempt = store.begin_attempt(hash(lease)).await?;
                assert_eq!(attempt, lease.attempt, "attempts at {} are counted twice", hash(lease));
                continue;
            }
            Write::Step(lease, record, checkpoint) => {
                store.record_step(hash(lease), lease.attempt, &record, &checkpoint).await?;
                Written::Recorded(lease, Mark::Step)
            }
            Write::Checkpoint(lease, checkpoint) => {
                store.record_checkpoint(hash(lease), lease.attempt, &checkpoint).await?;
                Written::Recorded(lease, Mark::Step)
            }
            Write::Result(lease, result, arrays) => {
                let all = arrays.as_ref().map(Arrays::all).unwrap_or_default();
                store.finish(hash(lease), lease.attempt, &result, &all).await?;
                held.push(arrays);
                Written::Done(lease, result)
            }
            Write::Failure(lease, reason, settled) => {
                let (hash, reason) = (hash(lease), reason.to_string());
                match settled {
                    true => store.fail(hash, lease.attempt, &reason).await?,
                    false => store.give_up_attempt(hash, lease.attempt, &reason).await?,
                }
                Written::Recorded(lease, Mark::Failure)
            }
            Write::Cancelled(lease) => {
                store.settle(hash(lease), CANCELLED).await?;
                Written::Recorded(lease, Mark::Failure)
            }
            Write::Spent(lease, seconds) => {
                store.spend(hash(lease), lease.attempt, seconds).await?;
                continue;
            }
            Write::Log(lease, level, text) => {
                store.log(hash(lease), lease.attempt, level, &text).await?;
                continue;
            }
            Write::Load(worker, lease, pause) => {
                let checkpoint = match store.goes_on_from(hash(lease), lease.attempt, pause).await {
                    Err(StoreError::Unreadable { message, .. }) => Err(message),
                    Err(StoreError::Damaged { .. }) => {
                        Err("it is damaged (its checksum does not match)".into())
                    }
                    other => Ok(other?.map(Box::new)),
                };
                Written::Loaded(worker, lease, checkpoint)
            }
        });
    }
    store.commit_batch().await?;
    Ok(written)
}
