//! Which trials are not worth finishing: the median rule.
//!
//! At given parts of its steps a trial's best error so far is compared with what others of its kind (the same K and M)
//! had there: worse than their median, and it is given up. The best of a kind is therefore never given up.

use std::collections::BTreeMap;

/// How far a trial has come with a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Standing {
    /// Part of its steps.
    pub part: f64,
    /// What of them was there when its attempt began; maybe by another trial that trains the same body.
    pub begun: f64,
    /// Its best error so far.
    pub error: Option<f64>,
}

/// The errors that trials had where they were judged, by kind and mark, ascending.
#[derive(Debug, Clone, Default)]
pub struct Standings(BTreeMap<(u32, usize), Vec<f64>>);

impl Standings {
    /// Notes what a trial of `kind` had at a mark, and says how many had been there, and their median.
    pub fn note(&mut self, kind: u32, mark: usize, error: f64) -> (usize, f64) {
        let errors = self.0.entry((kind, mark)).or_default();
        let (n, median) = (errors.len(), median(errors));
        errors.insert(errors.partition_point(|known| *known < error), error);
        (n, median)
    }
}

/// Of ascending numbers; of none, infinite.
fn median(ascending: &[f64]) -> f64 {
    match ascending.len() {
        0 => f64::INFINITY,
        n => 0.5 * (ascending[(n - 1) / 2] + ascending[n / 2]),
    }
}
