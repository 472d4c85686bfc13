//! The one writer: a queue in front of the store, whose entries share transactions.
//!
//! What waits when a transaction begins goes into it together, so that one fsync serves many records. `Written` is
//! said after the commit alone.

use std::sync::Arc;

use metasense_schemas::record::{Checkpoint, StepRecord, TrialResult};
use metasense_schemas::wire::{Array, Lease};
use tokio::sync::mpsc::{Receiver, UnboundedSender};

use crate::scheduler::{Mark, Reason, WorkerId};
use crate::store::{self, Store, StoreError, Values};

/// Most entries of one transaction.
const BATCH: usize = 128;

/// An entry of the queue.
#[derive(Debug)]
pub enum Write {
    /// An attempt begins.
    Begin(Lease),
    /// A step.
    Step(Lease, Box<StepRecord>, Arc<Checkpoint>),
    /// A result with its arrays, which stay in shared memory until they are recorded.
    Result(Lease, Box<TrialResult>, Vec<NamedArray>),
    /// An attempt has come to nothing.
    Failure(Lease, Reason, bool),
    /// A checkpoint is wanted for a worker.
    Load(WorkerId, Lease),
}

/// An array of a result.
#[derive(Debug)]
pub struct NamedArray {
    /// Its name within the trial.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its values, in shared memory.
    pub values: Array,
}

/// What the writer says.
#[derive(Debug)]
pub enum Written {
    /// It is on disk.
    Recorded(Lease, Mark),
    /// The checkpoint that was wanted.
    Loaded(WorkerId, Lease, Option<Checkpoint>),
    /// Nothing can be recorded any more.
    Broken(StoreError),
}

/// Writes until the queue is closed, and hands the store back. `hashes` are those of the run's trials.
pub async fn write(
    mut store: Store,
    hashes: Vec<String>,
    mut queue: Receiver<Write>,
    said: UnboundedSender<Written>,
) -> Store {
    let mut batch = Vec::with_capacity(BATCH);
    while queue.recv_many(&mut batch, BATCH).await > 0 {
        match transact(&mut store, &hashes, &batch).await {
            Ok(written) => written.into_iter().for_each(|word| drop(said.send(word))),
            Err(error) => {
                let _ = said.send(Written::Broken(error));
                return store;
            }
        }
        // Releases the arrays.
        batch.clear();
    }
    store
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
            Write::Result(lease, result, arrays) => {
                let arrays: Vec<_> = arrays
                    .iter()
                    .map(|array| store::Array {
                        name: &array.name,
                        shape: &array.shape,
                        values: Values::F64(array.values.payload()),
                    })
                    .collect();
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
            Write::Load(worker, lease) => {
                written.push(Written::Loaded(*worker, *lease, store.checkpoint(hash(lease)).await?));
            }
        }
    }
    store.commit_batch().await?;
    Ok(written)
}
