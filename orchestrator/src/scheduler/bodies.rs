//! Which bodies are trained, and which trial trains which: others with the same body wait for it.

use std::collections::{BTreeMap, BTreeSet};

/// Bodies by their numbers.
#[derive(Debug, Clone, Default)]
pub(super) struct Bodies {
    trained: BTreeSet<u32>,
    /// With the trial that trains them.
    in_training: BTreeMap<u32, u32>,
}

impl Bodies {
    /// Whether somebody trains it.
    pub fn is_in_training(&self, body: u32) -> bool {
        self.in_training.contains_key(&body)
    }

    /// A worker has this trial, which trains the body unless that is done.
    pub fn handed_out(&mut self, body: u32, trial: u32) {
        if !self.trained.contains(&body) {
            self.in_training.insert(body, trial);
        }
    }

    /// No worker has this trial any more.
    pub fn given_back(&mut self, body: u32, trial: u32) {
        if self.in_training.get(&body) == Some(&trial) {
            self.in_training.remove(&body);
        }
    }

    /// It is trained to the end.
    pub fn trained(&mut self, body: u32) {
        self.in_training.remove(&body);
        self.trained.insert(body);
    }
}
