//! The one writer: a queue in front of the store, whose entries share transactions.
//!
//! What waits when a transaction begins goes into it together, so that one fsync serves many records. `Written` is
//! said after the commit alone.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use metasense_schemas::record::{Checkpoint, StepRecord, TrialResult};
use metasense_schemas::wire::{ArrayHead, Lease, Sample};
use tokio::sync::mpsc::{Receiver, UnboundedSender};

use super::steer::Fresh;
use crate::plan::Plan;
use crate::scheduler::{CANCELLED, Mark, Prior, Reason, WorkerId};
use crate::store::{Array, Level, Store, StoreError};

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
    /// A checkpoint is wanted for a worker.
    Load(WorkerId, Lease),
    /// A trial that waits is not to be run.
    Cancelled(Lease),
    /// The spec as it is by now.
    Plan(Arc<Plan>),
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
    /// The checkpoint that was wanted; or why the one that is there is of no use.
    Loaded(WorkerId, Lease, Result<Option<Box<Checkpoint>>, String>),
    /// Trials of a plan that are to be run beside the others; they are numbered on.
    Planned(Fresh),
    /// Nothing can be recorded any more.
    Broken(StoreError),
}

/// Writes until the queue is closed. `hashes` are those of the run's trials.
pub async fn write(
    store: &mut Store,
    mut hashes: Vec<String>,
    mut queue: Receiver<Write>,
    said: UnboundedSender<Written>,
) {
    let mut batch = Vec::with_capacity(BATCH);
    while queue.recv_many(&mut batch, BATCH).await > 0 {
        let is_plan = |entry: &Write| matches!(entry, Write::Plan(_));
        for entries in batch.chunk_by(|a, b| !is_plan(a) && !is_plan(b)) {
            let written = match entries {
                [Write::Plan(plan)] => {
                    add(store, &mut hashes, plan).await.map(|fresh| vec![Written::Planned(fresh)])
                }
                entries => transact(store, &hashes, entries).await,
            };
            match written {
                Ok(written) => written.into_iter().for_each(|word| drop(said.send(word))),
                Err(error) => {
                    let _ = said.send(Written::Broken(error));
                    return;
                }
            }
        }
        // Releases the arrays.
        batch.clear();
    }
}

/// Records a plan; the trials that are new to the run, and open, are its trials from here on.
async fn add(store: &mut Store, hashes: &mut Vec<String>, plan: &Arc<Plan>) -> Result<Fresh, StoreError> {
    store.begin_sweep(&plan.spec, &plan.source.text, &plan.trials).await?;
    let settled: HashSet<String> = store.settled().await?.into_iter().collect();
    let priors: HashMap<String, Prior> = store.priors().await?.into_iter().collect();
    let known: HashSet<&str> = hashes.iter().map(String::as_str).collect();
    let mut fresh = Fresh { plan: Arc::clone(plan), trials: Vec::new(), settled: 0 };
    for (place, trial) in plan.trials.iter().enumerate().filter(|(_, t)| !known.contains(t.hash.as_str())) {
        match settled.contains(&trial.hash) {
            true => fresh.settled += 1,
            false => fresh.trials.push((place, priors.get(&trial.hash).copied().unwrap_or_default())),
        }
    }
    hashes.extend(fresh.trials.iter().map(|(place, _)| plan.trials[*place].hash.clone()));
    Ok(fresh)
}

async fn transact(store: &mut Store, hashes: &[String], batch: &[Write]) -> Result<Vec<Written>, StoreError> {
    let mut written = Vec::with_capacity(batch.len());
    let hash = |lease: &Lease| hashes[lease.trial as usize].as_str();
    store.begin_batch().await?;
    for entry in batch {
        match entry {
            Write::Begin(lease) => {
                let attempt = store.begin_attempt(hash(lease)).await?;
                assert_eq!(attempt, lease.attempt, "attempts at {} are counted twice", hash(lease));
            }
            Write::Step(lease, record, checkpoint) => {
                store.record_step(hash(lease), lease.attempt, record, checkpoint).await?;
                written.push(Written::Recorded(*lease, Mark::Step));
            }
            Write::Checkpoint(lease, checkpoint) => {
                store.record_checkpoint(hash(lease), lease.attempt, checkpoint).await?;
                written.push(Written::Recorded(*lease, Mark::Step));
            }
            Write::Result(lease, result, arrays) => {
                let arrays = arrays.as_ref().map(Arrays::all).unwrap_or_default();
                store.finish(hash(lease), lease.attempt, result, &arrays).await?;
                written.push(Written::Recorded(*lease, Mark::Result));
            }
            Write::Failure(lease, reason, settled) => {
                let (hash, reason) = (hash(lease), reason.to_string());
                match settled {
                    true => store.fail(hash, lease.attempt, &reason).await?,
                    false => store.give_up_attempt(hash, lease.attempt, &reason).await?,
                }
                written.push(Written::Recorded(*lease, Mark::Failure));
            }
            Write::Cancelled(lease) => {
                store.settle(hash(lease), CANCELLED).await?;
                written.push(Written::Recorded(*lease, Mark::Failure));
            }
            Write::Plan(_) => unreachable!("comes alone, in transactions of its own"),
            Write::Spent(lease, seconds) => store.spend(hash(lease), lease.attempt, *seconds).await?,
            Write::Log(lease, level, text) => {
                store.log(hash(lease), lease.attempt, *level, text).await?;
            }
            Write::Load(worker, lease) => {
                let checkpoint = match store.checkpoint(hash(lease)).await {
                    Err(StoreError::Unreadable { message, .. }) => Err(message),
                    other => Ok(other?.map(Box::new)),
                };
                written.push(Written::Loaded(*worker, *lease, checkpoint));
            }
        }
    }
    store.commit_batch().await?;
    Ok(written)
}
