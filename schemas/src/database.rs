//! The database: its version, its schema and its documented views.

/// `PRAGMA application_id`: "mtsn".
pub const APPLICATION_ID: i32 = 0x6d74_736e;

/// `PRAGMA user_version` of the databases that this program reads and writes.
pub const VERSION: usize = 15;

/// SQL that creates the tables and views of this version in an empty file.
pub const SCHEMA: &str = include_str!("../schema.sql");

/// SQL that creates one of the views.
///
/// # Panics
/// If there is no such view.
pub fn view_sql(view: &str) -> &'static str {
    let start = SCHEMA.find(&format!("CREATE VIEW {view} AS")).expect("the schema creates the view");
    let end = SCHEMA[start..].find(';').expect("a statement ends");
    &SCHEMA[start..=start + end]
}

/// Stable views, each with a description of its rows.
pub const VIEWS: &[(&str, &str)] = &[
    (
        "v_trial",
        "a trial: settings, state, errors (%, mean over evaluation networks; error_… on the test set), CPU seconds; holdout_median_…, \
         holdout_p90_… and holdout_above_…: median and 90th percentile over held-out samples (%, mean over evaluation networks) and \
         the number of samples above 100 % (of the network with the most); holdout_rms_…: 10 times the square root of the held-out error, \
         which is a ratio of energies; trials with equal `training` share a body, which one of them has trained",
    ),
    (
        "v_step",
        "an outer step: losses, errors (%), gradient, projection, implicit term, work, CPU seconds by part, λ of the linear decoder (`ridge`); `attempt` \
         is 0 if another trial that trains the same body computed the step",
    ),
    (
        "v_reading",
        "errors (%) of a linear decoder of one memory (s before and after an instant) on the initial or the trained body, \
         for any decoder of the trial; its λ (`ridge`); median, 90th percentile (%), samples above 100 % and RMS error (%) on the held-out set",
    ),
    (
        "v_cast",
        "error (%) of one decoder on one cast of the initial or the trained body: `nominal` (linear, fitted to the body as \
         designed), `casts` (linear, fitted to other casts), `records` (linear, calibrated on `records` samples of this cast), \
         `network`, `network_casts` (trained on other casts), `inverse` (the model of the design, inverted), `twin` (a twin \
         calibrated on `records` samples of this cast, inverted), `twin_linear` (linear, fitted to that twin); the error is over the whole \
         held-out set, but for `inverse` and `twin` over its first 16 samples; `nominal_error` is the error of such a decoder \
         on the body as designed: that of the trial's own decoder (mean over its networks) for networks, inverse decoders and linear trials, \
         else that of the linear decoder of the whole sample; \
         instants_covered and samples_covered: the part of the held-out set within the bands of the body as designed, or within the \
         bands of an inverse decoder; median and 90th percentile (%) over held-out samples, samples above 100 %, RMS error (%); λ \
         (`ridge`) of linear decoders, and κ (`kappa`) of linear decoders calibrated on samples of this cast",
    ),
    (
        "v_band",
        "a band around the estimated forces of the initial or the trained body, or of a cast of it (with the widths of \
         the body as designed): the part of the held-out instants and panels (`instant`) or samples (`sample`) within the band, \
         its level, and its mean width (N). `conformal`: calibrated on `samples` samples; `posterior`: that of an inverse decoder, \
         over the samples that its model explains",
    ),
    (
        "v_under",
        "error (%) of a linear decoder on the initial or the trained body under one kind of forces (`evaluation.under`), for any \
         training forces of the body: `own`: fitted under these forces; `carried`: fitted under those of the trial; a body that cannot \
         be simulated counts as 100 %; median, p90, above and rms as in v_cast",
    ),
    (
        "v_task",
        "error of a readout of a sensing task on the initial or the trained body (`evaluation.tasks`), in `unit`, with its 95 % interval \
         over held-out samples: `direct`: fitted to the signals; `decoded`: from the forces that a linear decoder estimates; `trivial`: \
         error of the best estimate without signals; `least`: resolution of the error; `score`: balanced accuracy (%) of classes, R² of \
         values; `detail` (JSON): of a class [true, estimated, samples], of a position [struck panel, mean error (mm), samples]; `casts`: \
         mean error over casts (`evaluation.casts`) of the readout fitted to the body as designed; of direct \
         readouts of classes, `log_loss`: mean of −ln p of the true class (probabilities by temperature scaling); `calibration_error`: \
         expected difference between probability and frequency (%); `reliability` (JSON), per tenth of the probability: [mean probability \
         of the estimated class, its frequency, samples]",
    ),
    (
        "v_network",
        "a new network on the initial or the trained body, with its errors (%) and their spread over the held-out set as in v_reading",
    ),
    (
        "v_curve",
        "a point of the training of such a network: loss (normalised) and held-out error (%); thinned: complete losses are in v_artifact",
    ),
    ("v_run", "a call of `run`: its shard and host, the estimated time (s), and what was done"),
    (
        "v_attempt",
        "an attempt at a trial: how it ended and why (stopped: by Ctrl-C; the trial can be resumed), wall-clock and CPU seconds, \
         its code and host",
    ),
    ("v_log", "a line of the log of an attempt: errors, and the standard error of its worker"),
    ("v_artifact", "an array of a trial as the bytes of an NPY file: designs, loss curves, weights"),
    (
        "v_error_time",
        "best test error so far (%) against the CPU seconds of training the body, step by step, as if each trial had trained its body itself",
    ),
];
