//! Random feasible designs: a baseline of arbitrary geometries.

use super::{FeasibleSet, Status};
use crate::random::{Purpose, Stream};

/// Number of draws.
const ATTEMPTS: u64 = 8;

impl FeasibleSet {
    /// Design number `seed`: adds a uniform random number in ± `size` (mm) to each shift of the feasible design `regular`, then
    /// projects; fixed units stay. `None` if no draw gives a feasible design.
    pub fn random_design(&mut self, regular: &[f64], seed: u64, size: f64) -> Option<Vec<f64>> {
        (0..ATTEMPTS).find_map(|attempt| {
            let mut stream = Stream::new(Purpose::Design, seed, [0, attempt]);
            let draw: Vec<f64> = regular.iter().map(|x| x + stream.between([-size, size])).collect();
            let out = self.project(regular, &draw, None);
            matches!(out.status, Status::Untouched | Status::Projected).then_some(out.design)
        })
    }
}
