//! Before a run: the sweep is recorded, and what earlier runs have left of its trials is read.

use std::collections::{HashMap, HashSet};
use std::hash::Hash;

use metasense_schemas::spec::{Prune, SweepSpec};

use super::Signals;
use crate::plan::Trial;
use crate::provenance;
use crate::scheduler::{Prior, State};
use crate::store::{Attempted, Reopen, Store, StoreError};

/// Which settled trials are run again.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Again {
    /// Those that were given up as hopeless.
    pub pruned: bool,
    /// Those that have failed.
    pub failed: bool,
    /// Those that other code than this program's has worked on, from the beginning.
    pub other_code: bool,
}

/// Records a sweep with its trials, and returns those that are open; `None` where a signal came first: then nothing of
/// the sweep was recorded that was not there before.
///
/// # Errors
/// Where SQLite fails.
pub async fn begin<'a>(
    store: &mut Store,
    (spec, text): (&SweepSpec, &str),
    trials: &'a [Trial],
    again: Again,
    signals: &mut Signals,
) -> Result<Option<Vec<&'a Trial>>, StoreError> {
    let work = async {
        store.set_provenance(provenance::here(1));
        store.begin_sweep(spec, text, trials).await?;
        let hashes: Vec<&str> = trials.iter().map(|trial| trial.hash.as_str()).collect();
        reopen(store, &hashes, again).await?;
        let settled: HashSet<String> = store.settled().await?.into_iter().collect();
        Ok(trials.iter().filter(|trial| !settled.contains(&trial.hash)).collect())
    };
    signals.unless(work).await.transpose()
}

/// Opens settled trials among these.
///
/// # Errors
/// Where SQLite fails.
pub async fn reopen(store: &mut Store, hashes: &[&str], again: Again) -> Result<(), StoreError> {
    for (wanted, which) in [(again.pruned, Reopen::Pruned), (again.failed, Reopen::Failed)] {
        if wanted {
            let reopened = store.reopen(which, hashes).await?;
            tracing::info!(reopened, ?which, "trials are run again");
        }
    }
    if again.other_code {
        store.set_provenance(provenance::here(1));
        let reopened = store.redo_other_code(hashes).await?;
        tracing::info!(reopened, "trials that other code has made are made again");
    }
    Ok(())
}

/// What earlier runs have left of these trials.
pub(super) async fn priors(
    store: &mut Store,
    trials: &[&Trial],
    state: impl FnOnce(&[Prior]) -> State,
    prune: Option<&Prune>,
) -> Result<(Vec<Prior>, State, Kinds), StoreError> {
    let (known, bodies) = (store.attempted().await?, store.bodies().await?);
    let mut kinds = Kinds::new();
    let prior = |trial: &&Trial| {
        kinds.prior(trial, known.get(&trial.hash).copied().unwrap_or_default(), bodies.get(&trial.training))
    };
    let mut priors: Vec<Prior> = trials.iter().map(prior).collect();
    let mut reached = Vec::new();
    for part in prune.map_or(&[][..], |prune| &prune.at) {
        reached.push(store.reached(*part).await?);
    }
    let places: HashMap<&str, usize> =
        trials.iter().enumerate().map(|(place, trial)| (trial.hash.as_str(), place)).collect();
    for (mark, trials) in reached.iter().enumerate() {
        for trial in trials {
            if let Some(place) = places.get(trial.hash.as_str()) {
                priors[*place].judged = mark + 1;
            }
        }
    }
    let mut state = state(&priors);
    for (mark, trials) in reached.iter().enumerate() {
        trials.iter().for_each(|trial| state.remember(kinds.points.number(trial.point), mark, trial.error));
    }
    Ok((priors, state, kinds))
}

/// Numbers things in the order in which they come.
#[derive(Debug)]
struct Numbers<T>(HashMap<T, u32>);

impl<T: Eq + Hash> Numbers<T> {
    fn number(&mut self, thing: T) -> u32 {
        let next = self.0.len() as u32;
        *self.0.entry(thing).or_insert(next)
    }
}

/// What trials share: pairs of K and M, and bodies, with those that some trial has begun to train.
#[derive(Debug)]
pub(super) struct Kinds {
    points: Numbers<(u32, u32)>,
    bodies: Numbers<String>,
    pub begun: HashSet<u32>,
}

impl Kinds {
    fn new() -> Self {
        Self { points: Numbers(HashMap::new()), bodies: Numbers(HashMap::new()), begun: HashSet::new() }
    }

    /// A trial that has come so far, and whose body has come so far by any trial.
    pub fn prior(&mut self, trial: &Trial, known: Attempted, body_steps: Option<&u32>) -> Prior {
        let (point, steps) = (trial.spec.point, trial.spec.optimise.steps());
        let body = self.bodies.number(trial.training.clone());
        if body_steps.is_some() {
            self.begun.insert(body);
        }
        Prior {
            attempts: known.attempts,
            steps: known.steps,
            kind: self.points.number((point.panels as u32, point.sensors as u32)),
            body,
            trained: steps <= body_steps.map_or(0, |steps| *steps as usize),
            judged: 0,
        }
    }
}
