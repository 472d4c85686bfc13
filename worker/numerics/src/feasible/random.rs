//! Random feasible designs: the baseline that arbitrary changes of geometry do not help.

use super::{Feasible, Status};
use crate::random::{Purpose, Stream};

/// Draws before giving up.
const ATTEMPTS: u64 = 8;

impl Feasible {
    /// The design number `seed`: every shift of `regular`, a feasible design, moved uniformly within ± `size` (mm) (fixed
    /// units stay), then projected. None if no draw led to a feasible design.
    pub fn random_design(&mut self, regular: &[f64], seed: u64, size: f64) -> Option<Vec<f64>> {
        (0..ATTEMPTS).find_map(|attempt| {
            let mut stream = Stream::new(Purpose::Design, seed, [0, attempt]);
            let draw: Vec<f64> = regular.iter().map(|x| x + stream.between([-size, size])).collect();
            let out = self.project(regular, &draw, None);
            matches!(out.status, Status::Untouched | Status::Projected).then_some(out.design)
        })
    }
}
