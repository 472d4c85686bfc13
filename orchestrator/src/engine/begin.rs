//! Before a run: the sweep is recorded, and what earlier runs have left of its trials is read.

use std::collections::{HashMap, HashSet};

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
        for (wanted, which) in [(again.pruned, Reopen::Pruned), (again.failed, Reopen::Failed)] {
            if wanted {
                let reopened = store.reopen(which).await?;
                tracing::info!(reopened, ?which, "trials are run again");
            }
        }
        if again.other_code {
            let reopened = store.redo_other_code().await?;
            tracing::info!(reopened, "trials that other code has made are made again");
        }
        let settled: HashSet<String> = store.settled().await?.into_iter().collect();
        Ok(trials.iter().filter(|trial| !settled.contains(&trial.hash)).collect())
    };
    signals.unless(work).await.transpose()
}

/// What earlier runs have left of these trials.
pub(super) async fn priors(
    store: &mut Store,
    trials: &[&Trial],
    state: impl FnOnce(&[Prior]) -> State,
    prune: Option<&Prune>,
) -> Result<(Vec<Prior>, State, Kinds), StoreError> {
    let known = store.attempted().await?;
    let mut kinds = Kinds::default();
    let prior = |trial: &&Trial| {
        let point = trial.spec.point;
        let kind = kinds.number((point.panels as u32, point.sensors as u32));
        let Attempted { attempts, steps } = known.get(&trial.hash).copied().unwrap_or_default();
        Prior { attempts, steps, kind, judged: 0 }
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
        trials.iter().for_each(|trial| state.remember(kinds.number(trial.point), mark, trial.error));
    }
    Ok((priors, state, kinds))
}

/// Numbers the pairs of K and M.
#[derive(Debug, Default)]
pub(super) struct Kinds(HashMap<(u32, u32), u32>);

impl Kinds {
    pub(super) fn number(&mut self, point: (u32, u32)) -> u32 {
        let next = self.0.len() as u32;
        *self.0.entry(point).or_insert(next)
    }
}
