//! Slots of worker processes, and their states.

use metasense_schemas::reason::Reason;
use metasense_schemas::wire::Lease;

use super::Millis;

/// A worker process: its slot and the number of the process in this slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct WorkerId {
    /// From 0.
    pub slot: u32,
    /// From 1.
    pub generation: u32,
}

impl std::fmt::Display for WorkerId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}", self.slot, self.generation)
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum SlotState {
    Empty { until: Millis },
    Starting { since: Millis },
    Idle,
    Busy { lease: Lease, since: Millis, beat: Millis, asked: bool },
    Ending { lease: Option<Lease>, since: Millis, why: Option<Reason> },
    GivenUp,
}

#[derive(Debug, Clone)]
pub(super) struct Slot {
    pub generation: u32,
    pub misfires: u32,
    /// Results of this worker that are being written to disk.
    pub unrecorded: usize,
    pub work: SlotState,
}

impl Slot {
    pub const EMPTY: Self =
        Self { generation: 0, misfires: 0, unrecorded: 0, work: SlotState::Empty { until: 0 } };

    /// Whether its worker can get a trial, now or once it has started.
    pub fn is_free(&self) -> bool {
        matches!(self.work, SlotState::Starting { .. } | SlotState::Idle)
    }

    pub fn is_busy(&self) -> bool {
        matches!(self.work, SlotState::Busy { .. })
    }

    /// Ends the process of a worker that has no trial.
    pub fn close(&mut self, now: Millis) {
        self.work = SlotState::Ending { lease: None, since: now, why: None };
    }
}

/// All slots with the ids of their current worker processes.
pub(super) fn with_workers(slots: &mut [Slot]) -> impl Iterator<Item = (WorkerId, &mut Slot)> {
    slots.iter_mut().zip(0..).map(|(state, slot)| (WorkerId { slot, generation: state.generation }, state))
}
