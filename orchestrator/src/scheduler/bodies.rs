//! Tracks which bodies are trained or in training. Other trials with the same body wait for it.

use std::collections::{BTreeMap, BTreeSet};

/// Bodies, by number.
#[derive(Debug, Clone, Default)]
pub(super) struct Bodies {
    trained: BTreeSet<u32>,
    /// Body → the trial that trains it.
    in_training: BTreeMap<u32, u32>,
}

impl Bodies {
    /// Whether a trial is training the body.
    pub fn is_in_training(&self, body: u32) -> bool {
        self.in_training.contains_key(&body)
    }

    /// A worker got this trial, which trains the body unless it is trained already.
    pub fn handed_out(&mut self, body: u32, trial: u32) {
        if !self.trained.contains(&body) {
            self.in_training.insert(body, trial);
        }
    }

    /// The trial has left its worker.
    pub fn given_back(&mut self, body: u32, trial: u32) {
        if self.in_training.get(&body) == Some(&trial) {
            self.in_training.remove(&body);
        }
    }

    /// The body is completely trained.
    pub fn trained(&mut self, body: u32) {
        self.in_training.remove(&body);
        self.trained.insert(body);
    }
}
