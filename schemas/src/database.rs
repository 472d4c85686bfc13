//! The database: what marks it, its schema, and the views that users build on.

/// `PRAGMA application_id`: "mtsn".
pub const APPLICATION_ID: i32 = 0x6d74_736e;

/// `PRAGMA user_version` of the databases that this program reads and writes.
pub const VERSION: usize = 15;

/// Makes an empty file a database of this version.
pub const SCHEMA: &str = include_str!("../schema.sql");

/// The stable views, and what a row of each is.
pub const VIEWS: &[(&str, &str)] = &[
    (
        "v_trial",
        "a trial: settings, state, errors (%, mean over evaluation networks; error_… on the test set), CPU seconds; holdout_median_…, \
         holdout_p90_… and holdout_above_…: median and 90th percentile of the holdout's samples (%, mean over evaluation networks) and \
         the number of samples above 100 % (of the network with the most); holdout_rms_…: 10 times the root of the holdout error, which \
         is a ratio of energies; trials of equal `training` have the same body, which one of them has trained",
    ),
    (
        "v_step",
        "an outer step: losses, errors (%), gradient, projection, implicit term, work, where the time went (CPU seconds), λ of the linear decoder (`ridge`); `attempt` \
         is 0 where another trial that trains the same body has made it",
    ),
    (
        "v_reading",
        "errors (%) of a linear brain of one memory (s before and after an instant) on the initial or the optimised body, \
         whatever the trial's own brain; its λ (`ridge`); median, 90th percentile (%), samples above 100 % and RMS error (%) on the holdout",
    ),
    (
        "v_cast",
        "error (%) of one brain on one cast of the initial or the optimised body: `nominal` (linear, fitted to the body as \
         designed), `casts` (linear, fitted to other casts), `records` (linear, fitted to so many samples of this cast), \
         `network`, `network_casts` (trained on other casts), `inverse` (by the model of the design), `twin` (inverse, by a twin \
         calibrated on so many samples of this cast), `twin_linear` (linear, fitted to that twin); the error is over the whole holdout, but \
         for `inverse` and `twin` over its first 16 samples; `nominal_error` is such a brain's \
         on the body as designed: the trial's own (the mean over its networks) of networks, of inverse brains and where that is linear, \
         else the linear one's of the whole sample; \
         instants_covered and samples_covered: what of the holdout lies in the bands of the body as designed, or in those that an \
         inverse brain says itself; median and 90th percentile (%) over the holdout's samples, samples above 100 %, RMS error (%); λ \
         (`ridge`) of linear brains, and κ (`kappa`) of those calibrated on samples of this cast",
    ),
    (
        "v_band",
        "a band about what a brain says of the forces of the initial or the optimised body, or of a cast of it (with the widths of \
         the body as designed): the part of the holdout's instants and panels (`instant`) or samples (`sample`) that lies in it, \
         against its level, and its mean width (N). `conformal`: calibrated on so many samples; `posterior`: an inverse brain's own, \
         of so many samples that its model explains",
    ),
    (
        "v_under",
        "error (%) of a linear brain on the initial or the optimised body under one kind of forces (`evaluation.under`), whatever \
         the body was trained under: `own`, fitted to samples under these forces, `carried`, to the trial's; a body that cannot \
         be simulated counts as 100 %; median, p90, above and rms as in v_cast",
    ),
    (
        "v_network",
        "a fresh network on the initial or the optimised body, with its errors (%); their spread on the holdout as in v_reading",
    ),
    (
        "v_curve",
        "a point of such a network's training: loss (normalised) and holdout error (%); thinned, whole losses are artifacts",
    ),
    ("v_run", "a call of `run`: its shard and host, the estimated time (s), and what was done"),
    (
        "v_attempt",
        "an attempt at a trial: how it ended and why (stopped: by Ctrl-C, the trial goes on), wall-clock and CPU seconds, \
         which code made it and where",
    ),
    ("v_log", "a line of an attempt's log: what went wrong, and what its worker wrote to standard error"),
    ("v_artifact", "an array of a trial as the bytes of an NPY file: designs, loss curves, weights"),
    (
        "v_error_time",
        "best test error so far (%) against the CPU seconds of training the body, step by step, as if each trial had trained its body itself",
    ),
];
