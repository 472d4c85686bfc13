//! Consecutive deaths of workers without progress of any trial in between.

use std::collections::BTreeSet;

use metasense_schemas::reason::Reason;

/// Number of deaths after which the machine counts as unfit …
pub const UNFIT_DEATHS: u32 = 10;
/// … if they include this many trials.
pub const UNFIT_TRIALS: usize = 3;

/// See the module.
#[derive(Debug, Clone, Default)]
pub(super) struct Deaths {
    in_a_row: u32,
    trials: BTreeSet<u32>,
    /// Reason of the last.
    reason: Option<Reason>,
}

impl Deaths {
    pub fn note(&mut self, trial: u32, reason: Reason) {
        self.in_a_row += 1;
        self.trials.insert(trial);
        self.reason = Some(reason);
    }

    /// The reason of the last death, if the machine counts as unfit.
    pub fn unfit(&self) -> Option<Reason> {
        let many = self.in_a_row >= UNFIT_DEATHS && self.trials.len() >= UNFIT_TRIALS;
        self.reason.filter(|_| many)
    }
}
