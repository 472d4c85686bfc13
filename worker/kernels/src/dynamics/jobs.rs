//! What lanes are given to do: samples to integrate, from a queue, and samples to sweep backwards.

use super::Outcome;
use super::simulation::SampleTape;
use std::sync::{Mutex, PoisonError};

/// A sample to integrate, and where its results go.
pub struct Job<'a> {
    /// (T, 3M).
    pub signals: &'a mut [f64],
    /// How it ended.
    pub outcome: &'a mut Outcome,
    /// For the reverse sweep.
    pub tape: Option<&'a mut SampleTape>,
    /// Its forces.
    pub index: usize,
}

/// Samples that nobody has taken up yet, in order.
pub type Queue<'s, 'a> = Mutex<&'s mut [Job<'a>]>;

/// The next samples of a queue, up to `most`.
pub fn take<'s, 'a>(queue: &Queue<'s, 'a>, most: usize) -> &'s mut [Job<'a>] {
    let mut queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
    let all = std::mem::take(&mut *queue);
    let (taken, left) = all.split_at_mut(most.min(all.len()));
    *queue = left;
    taken
}

/// A sample to sweep backwards.
#[derive(Clone, Copy)]
pub struct Backward<'a> {
    /// Its number.
    pub at: usize,
    /// Its tape.
    pub tape: &'a SampleTape,
    /// Its forces.
    pub history: &'a [f64],
    /// (T, 3M).
    pub cotangent: &'a [f64],
}
