//! Start of a run: records the sweep and reads the state of its trials from earlier runs.

use std::collections::{HashMap, HashSet};

use metasense_schemas::spec::SweepSpec;

use super::View;
use crate::plan::PlannedTrial;
use crate::provenance;
use crate::scheduler::Prior;
use crate::signals::Signals;
use crate::store::{PriorProgress, Store, StoreError};

/// Which finished trials run again.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RerunPolicy {
    /// Resume failed trials.
    pub failed: bool,
    /// Restart trials that other code has computed, even in part.
    pub other_code: bool,
}

/// Records a sweep with its trials and returns the open ones. `None`: a signal came first, and nothing new of the sweep was
/// recorded.
pub async fn begin<'a>(
    store: &mut Store,
    (spec, text): (&SweepSpec, &str),
    trials: &'a [PlannedTrial],
    again: RerunPolicy,
    signals: &mut Signals,
) -> Result<Option<Vec<&'a PlannedTrial>>, StoreError> {
    let work = async {
        store.set_provenance(provenance::this_machine(1));
        store.begin_sweep(spec, text, trials).await?;
        let hashes: Vec<&str> = trials.iter().map(|trial| trial.hash.as_str()).collect();
        reopen(store, &hashes, again).await?;
        let settled: HashSet<String> = store.settled().await?.into_iter().collect();
        Ok(trials.iter().filter(|trial| !settled.contains(&trial.hash)).collect())
    };
    signals.or_signal(work).await.transpose()
}

/// Reopens finished trials among these.
pub async fn reopen(store: &mut Store, hashes: &[&str], again: RerunPolicy) -> Result<(), StoreError> {
    if again.failed {
        let reopened = store.reopen(hashes).await?;
        tracing::info!(reopened, "failed trials are resumed");
    }
    if again.other_code {
        store.set_provenance(provenance::this_machine(1));
        let reopened = store.redo_other_code(hashes).await?;
        tracing::info!(reopened, "trials computed by other code are repeated");
    }
    Ok(())
}

/// State of these trials from earlier runs.
pub(super) async fn priors(
    store: &mut Store,
    trials: &[&PlannedTrial],
) -> Result<(Vec<Prior>, Bodies), StoreError> {
    let (known, trained) = (store.attempted().await?, store.bodies().await?);
    let mut bodies = Bodies::default();
    let prior = |trial: &&PlannedTrial| {
        bodies.prior(trial, known.get(&trial.hash).copied().unwrap_or_default(), trained.get(&trial.training))
    };
    let priors = trials.iter().map(prior).collect();
    Ok((priors, bodies))
}

/// Adds a trial to the progress of the run.
pub(super) fn show(view: &mut View, trial: &PlannedTrial, prior: &Prior) {
    view.add(trial, prior.body, prior.steps.unwrap_or(0), prior.trained);
}

/// Numbers of the trials' bodies, in order of appearance.
#[derive(Debug, Default)]
pub(super) struct Bodies {
    numbers: HashMap<String, u32>,
    /// Bodies with recorded steps of any trial.
    pub begun: HashSet<u32>,
}

impl Bodies {
    /// State of a trial, given its attempts and the steps that any trial has trained its body.
    pub fn prior(&mut self, trial: &PlannedTrial, known: PriorProgress, body_steps: Option<&u32>) -> Prior {
        let (next, steps) = (self.numbers.len() as u32, trial.spec.optimise.steps());
        let body = *self.numbers.entry(trial.training.clone()).or_insert(next);
        if body_steps.is_some() {
            self.begun.insert(body);
        }
        let trained = steps <= body_steps.map_or(0, |steps| *steps as usize);
        Prior { attempts: known.attempts, steps: known.steps, body, trained }
    }
}
