//! The database: what marks it, how each version grows out of the one before, and the views that users build on.

/// `PRAGMA application_id`: "mtsn".
pub const APPLICATION_ID: i32 = 0x6d74_736e;

/// Entry v − 1 makes version v (`PRAGMA user_version`) out of version v − 1. Entries are never changed, only added.
pub const MIGRATIONS: &[&str] = &[
    include_str!("../migrations/0001.sql"),
    include_str!("../migrations/0002.sql"),
    include_str!("../migrations/0003.sql"),
    include_str!("../migrations/0004.sql"),
    include_str!("../migrations/0005.sql"),
    include_str!("../migrations/0006.sql"),
];

/// The stable views, and what a row of each is.
pub const VIEWS: &[(&str, &str)] = &[
    (
        "v_trial",
        "a trial: what it is, its state, errors (%, mean over evaluation networks; error_… are of the test set), CPU seconds",
    ),
    (
        "v_step",
        "an outer step: losses, errors, gradient, projection, implicit term, work, where the time went (CPU seconds)",
    ),
    (
        "v_reading",
        "what a linear brain of one memory (s before and after the instant) makes of a body, whatever the trial's brain (%)",
    ),
    ("v_network", "a fresh network on the initial or the optimised body, with its errors (%)"),
    (
        "v_curve",
        "a point of such a network's training loss (normalised) and holdout error (%); thinned, whole losses are artifacts",
    ),
    ("v_run", "a call of `run`: which shard, where, what was estimated (s) and what came of it"),
    (
        "v_attempt",
        "an attempt at a trial, how it ended and why (stopped: by Ctrl-C; the trial goes on), its seconds by the wall clock \
         and the CPU's, \
         and by what code and where it was made",
    ),
    (
        "v_log",
        "a line of what was said of an attempt: what went wrong, in words, and what its worker wrote to standard error",
    ),
    ("v_artifact", "an array of a trial as the bytes of an NPY file: designs, loss curves, weights"),
    ("v_error_time", "best test error so far (%) against CPU seconds spent, step by step"),
];
