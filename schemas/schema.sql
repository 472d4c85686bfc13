-- Schema of release 1.0. Units: mm, N, s, Mg; errors in %, losses in N² (test) or normalised (train). Absent numbers are NULL.
-- Databases have `PRAGMA user_version` 15: fourteen schemas came before the release.

CREATE TABLE sweep (
  id INTEGER PRIMARY KEY,
  name TEXT NOT NULL,
  text TEXT NOT NULL,                 -- the spec file as it was written
  spec TEXT NOT NULL,                 -- the spec with every default in place, JSON
  version TEXT NOT NULL,              -- of the program that began it
  created_at TEXT NOT NULL,
  UNIQUE (name, text)
) STRICT;

CREATE TABLE trial (
  id INTEGER PRIMARY KEY,
  hash TEXT NOT NULL UNIQUE,
  spec TEXT NOT NULL,                 -- TrialSpec, JSON: everything that the trial is
  state TEXT NOT NULL DEFAULT 'pending' CHECK (state IN ('pending', 'running', 'done', 'failed')),
  reason TEXT,                        -- why it failed
  layout TEXT NOT NULL,
  columns INTEGER NOT NULL,
  rows INTEGER NOT NULL,
  units INTEGER NOT NULL,
  panels INTEGER NOT NULL,
  sensors INTEGER NOT NULL,
  placement INTEGER NOT NULL,
  seed INTEGER NOT NULL,
  protocol TEXT NOT NULL,
  design_parameters INTEGER NOT NULL,
  brain_parameters INTEGER NOT NULL,
  cost REAL NOT NULL,                 -- estimated before the run (s)
  -- the result: means over the evaluation's networks
  error_initial REAL, error_optimised REAL,
  train_error_initial REAL, train_error_optimised REAL,
  holdout_error_initial REAL, holdout_error_optimised REAL,
  best_step INTEGER,
  seconds_evaluation REAL,
  simd TEXT, solver TEXT,
  result TEXT,                        -- TrialResult without designs and loss curves, JSON
  created_at TEXT NOT NULL,
  finished_at TEXT,
  training TEXT,                      -- equal where trials train the same body
  -- how holdout errors spread over samples (%): means over the networks; samples above 100 %, largest number of all networks
  holdout_median_initial REAL, holdout_p90_initial REAL, holdout_above_initial INTEGER,
  holdout_median_optimised REAL, holdout_p90_optimised REAL, holdout_above_optimised INTEGER
) STRICT;

CREATE INDEX trial_state ON trial (state);

CREATE TABLE sweep_trial (             -- sweeps share trials
  sweep_id INTEGER NOT NULL REFERENCES sweep (id),
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  position INTEGER NOT NULL,
  PRIMARY KEY (sweep_id, trial_id)
) STRICT, WITHOUT ROWID;

CREATE INDEX sweep_trial_trial ON sweep_trial (trial_id);

CREATE TABLE attempt (
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  number INTEGER NOT NULL,
  state TEXT NOT NULL DEFAULT 'running' CHECK (state IN ('running', 'done', 'failed')),
  reason TEXT,
  steps INTEGER NOT NULL DEFAULT 0,   -- outer steps recorded by this attempt
  version TEXT NOT NULL,
  started_at TEXT NOT NULL,
  ended_at TEXT,
  code TEXT,                          -- digest of the sources that compute
  revision TEXT,                      -- commit, and `-dirty` with changes that it lacks; NULL: built without git
  rustc TEXT, host TEXT, cpu TEXT, simd TEXT, threads INTEGER,
  redone INTEGER NOT NULL DEFAULT 0,  -- 1: its results were discarded, to be computed again by other code
  cpu_seconds REAL,                   -- of its worker, all threads
  saves INTEGER NOT NULL DEFAULT 0,   -- checkpoints recorded within the comparison at the end
  seconds REAL,                       -- wall-clock
  PRIMARY KEY (trial_id, number)
) STRICT, WITHOUT ROWID;

CREATE TABLE step (
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  step INTEGER NOT NULL,
  attempt INTEGER NOT NULL,
  loss_test REAL, loss_train REAL, error_test REAL, error_train REAL,
  gradient_norm REAL, step_length REAL,
  projection TEXT NOT NULL, projection_distance REAL,
  implicit_iterations INTEGER, implicit_residual REAL, implicit_smallest_curvature REAL, implicit_outcome TEXT,
  outcome TEXT NOT NULL,
  fresh_samples INTEGER NOT NULL,
  force_evaluations INTEGER NOT NULL, integrator_steps INTEGER NOT NULL, rejected_steps INTEGER NOT NULL,
  brain_iterations INTEGER NOT NULL, hessian_products INTEGER NOT NULL, projection_iterations INTEGER NOT NULL,
  seconds_simulate REAL NOT NULL, seconds_train REAL NOT NULL, seconds_differentiate REAL NOT NULL,
  seconds_implicit REAL NOT NULL, seconds_project REAL NOT NULL, seconds_store REAL NOT NULL,
  recorded_at TEXT NOT NULL, ridge REAL,
  PRIMARY KEY (trial_id, step)
) STRICT, WITHOUT ROWID;

CREATE TABLE network (                 -- a fresh network on a body, for the comparison at the end
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  body TEXT NOT NULL CHECK (body IN ('initial', 'optimised')),
  network INTEGER NOT NULL,           -- evaluation seed, from 0
  error_train REAL, error_test REAL, error_holdout REAL,
  iterations INTEGER NOT NULL,
  outcome TEXT NOT NULL, median REAL, p90 REAL, above INTEGER,
  PRIMARY KEY (trial_id, body, network)
) STRICT, WITHOUT ROWID;

CREATE TABLE curve (                   -- its training loss, thinned; whole curves are artifacts
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  body TEXT NOT NULL,
  network INTEGER NOT NULL,
  iteration INTEGER NOT NULL,         -- from 1
  loss REAL, error_holdout REAL,
  PRIMARY KEY (trial_id, body, network, iteration)
) STRICT, WITHOUT ROWID;

CREATE TABLE artifact (
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  name TEXT NOT NULL,
  shape TEXT NOT NULL,                -- JSON list
  bytes BLOB NOT NULL,                -- NPY
  digest BLOB,                        -- BLAKE3 of the bytes
  PRIMARY KEY (trial_id, name)
) STRICT;

CREATE TABLE checkpoint (
  trial_id INTEGER PRIMARY KEY REFERENCES trial (id),
  step INTEGER NOT NULL,              -- the next outer step
  bytes BLOB NOT NULL,                -- a version byte, then postcard
  digest BLOB                         -- BLAKE3 of the bytes
) STRICT;

-- an array of a trial as the bytes of an NPY file: designs, loss curves, weights
CREATE VIEW v_artifact AS
SELECT t.hash, a.name, a.shape, a.bytes FROM artifact a JOIN trial t ON t.id = a.trial_id;

CREATE TABLE run (
  sweep_id INTEGER NOT NULL REFERENCES sweep (id),
  started_at TEXT NOT NULL,
  host TEXT NOT NULL,
  shard INTEGER NOT NULL,             -- of `shards`, from 1; 1 of 1 is the whole sweep
  shards INTEGER NOT NULL,
  job TEXT,                           -- of the cluster's scheduler
  version TEXT NOT NULL,
  workers INTEGER NOT NULL, threads INTEGER NOT NULL,
  trials INTEGER NOT NULL,            -- that were open when it began
  estimated_seconds REAL NOT NULL,    -- that they were to take on all workers
  ended_at TEXT,                      -- NULL: it was killed, or goes on
  outcome TEXT,                       -- complete, interrupted, or what went wrong
  done INTEGER, failed INTEGER, seconds REAL,       -- trials of this run
  PRIMARY KEY (sweep_id, started_at, host, shard, shards)
) STRICT, WITHOUT ROWID;

-- a point of the training of such a network: loss (normalised) and held-out error (%); thinned: complete losses are in
-- v_artifact
CREATE VIEW v_curve AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol, c.body, c.network, c.iteration, c.loss,
  c.error_holdout
FROM curve c JOIN trial t ON t.id = c.trial_id;

CREATE TABLE reading (
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  body TEXT NOT NULL CHECK (body IN ('initial', 'optimised')),
  before INTEGER NOT NULL, after INTEGER NOT NULL, -- how far it looks back and ahead (instants)
  whole INTEGER NOT NULL,                          -- 1: as far as any, by default over the whole sample
  ridge REAL NOT NULL,
  error_train REAL, error_test REAL, error_holdout REAL, median REAL, p90 REAL, above INTEGER,
  PRIMARY KEY (trial_id, body, before, after)
) STRICT, WITHOUT ROWID;

CREATE TABLE log (                     -- what was said of an attempt, as much as is kept of it
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  attempt INTEGER NOT NULL,
  line INTEGER NOT NULL,              -- from 1
  at TEXT NOT NULL,
  level TEXT NOT NULL CHECK (level IN ('info', 'warn', 'error')),
  text TEXT NOT NULL,
  PRIMARY KEY (trial_id, attempt, line)
) STRICT, WITHOUT ROWID;

-- a line of the log of an attempt: errors, and the standard error of its worker
CREATE VIEW v_log AS
SELECT t.hash, t.state, t.reason, t.panels, t.sensors, t.placement, t.seed, l.attempt, l.line, l.at, l.level, l.text
FROM log l JOIN trial t ON t.id = l.trial_id;

CREATE TABLE source (                  -- files that a merge has read
  id INTEGER PRIMARY KEY,
  file TEXT NOT NULL UNIQUE,
  state TEXT                           -- what it was then; not read again while it is that. NULL: to be read again
) STRICT;

CREATE TABLE elsewhere (               -- a trial without its steps, curves, arrays and checkpoint: they are in that file
  trial_id INTEGER PRIMARY KEY REFERENCES trial (id),
  source_id INTEGER NOT NULL REFERENCES source (id),
  reached INTEGER NOT NULL             -- how far it had come there, as merges compare it
) STRICT;

CREATE TABLE cast_reading (            -- how one brain reads one cast of a body
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  body TEXT NOT NULL CHECK (body IN ('initial', 'optimised')),
  casting INTEGER NOT NULL,           -- which, from 0
  reader TEXT NOT NULL,               -- network, nominal, casts, records
  records INTEGER NOT NULL,           -- samples of this cast that it was fitted to
  error REAL,                         -- on the holdout (%)
  outcome TEXT NOT NULL, median REAL, p90 REAL, above INTEGER, ridge REAL, kappa REAL,
  PRIMARY KEY (trial_id, body, casting, reader, records)
) STRICT, WITHOUT ROWID;

CREATE TABLE band (
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  body TEXT NOT NULL CHECK (body IN ('initial', 'optimised')),
  casting INTEGER NOT NULL,           -- which cast, from 0; -1: the body as designed
  reader TEXT NOT NULL,               -- own; of casts as in cast_reading
  records INTEGER NOT NULL,           -- as in cast_reading
  method TEXT NOT NULL,               -- conformal, posterior
  kind TEXT NOT NULL,                 -- instant, sample
  level REAL NOT NULL,
  samples INTEGER NOT NULL,           -- that calibrated it, or that an inverse brain's model explains
  coverage REAL,                      -- a part of 1
  width REAL,                         -- in the mean (N)
  outcome TEXT NOT NULL,
  PRIMARY KEY (trial_id, body, casting, reader, records, method, kind)
) STRICT, WITHOUT ROWID;

CREATE INDEX trial_training ON trial (training);

CREATE VIEW spent AS
SELECT a.trial_id, a.number AS attempt, a.redone,
  CAST(coalesce(a.cpu_seconds, CASE a.state WHEN 'done' THEN coalesce(t.seconds_evaluation, 0) ELSE 0 END
    + coalesce((SELECT sum(p.seconds_simulate + p.seconds_train + p.seconds_differentiate + p.seconds_implicit
                           + p.seconds_project + p.seconds_store)
                FROM step p WHERE p.trial_id = a.trial_id AND p.attempt = a.number), 0)) AS REAL) AS seconds
FROM attempt a JOIN trial t ON t.id = a.trial_id;

-- best test error so far (%) against the CPU seconds of training the body, step by step, as if each trial had trained its body
-- itself
CREATE VIEW v_error_time AS
SELECT hash, units, panels, sensors, placement, seed, protocol, step,
  CAST(sum(seconds) OVER w AS REAL) AS seconds, error_test, CAST(min(error_test) OVER w AS REAL) AS best_error_test
FROM v_step
WINDOW w AS (PARTITION BY hash ORDER BY step ROWS UNBOUNDED PRECEDING);

-- a band around the estimated forces of the initial or the trained body, or of a cast of it (with the widths of the body as
-- designed): the part of the held-out instants and panels (`instant`) or samples (`sample`) within the band, its level, and its
-- mean width (N). `conformal`: calibrated on `samples` samples; `posterior`: that of an inverse decoder, over the samples that
-- its model explains
CREATE VIEW v_band AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with,
  b.body, CAST(nullif(b.casting, -1) AS INTEGER) AS casting, b.reader, b.records, b.method, b.kind, b.level, b.samples, b.coverage, b.width,
  b.outcome
FROM band b JOIN trial t ON t.id = b.trial_id;

-- a call of `run`: its shard and host, the estimated time (s), and what was done
CREATE VIEW v_run AS
SELECT s.name AS sweep, r.shard, r.shards, r.host, r.job, r.version, r.workers, r.threads, r.trials, r.done, r.failed,
  r.outcome, r.estimated_seconds,
  CAST(coalesce(r.seconds, (julianday(r.ended_at) - julianday(r.started_at)) * 86400) AS REAL) AS seconds,
  r.started_at, r.ended_at
FROM run r JOIN sweep s ON s.id = r.sweep_id;

-- an attempt at a trial: how it ended and why (stopped: by Ctrl-C; the trial can be resumed), wall-clock and CPU seconds, its
-- code and host
CREATE VIEW v_attempt AS
SELECT t.hash, t.panels, t.sensors, t.placement, t.seed, a.number AS attempt, a.state, a.reason, a.steps, a.version,
  a.started_at, a.ended_at,
  CAST(coalesce(a.seconds, (julianday(a.ended_at) - julianday(a.started_at)) * 86400) AS REAL) AS seconds,
  a.code, a.revision, a.rustc, a.host, a.cpu, a.simd, a.threads, a.redone, s.seconds AS cpu_seconds
FROM attempt a JOIN trial t ON t.id = a.trial_id JOIN spent s ON s.trial_id = a.trial_id AND s.attempt = a.number;

-- a trial: settings, state, errors (%, mean over evaluation networks; error_… on the test set), CPU seconds; holdout_median_…,
-- holdout_p90_… and holdout_above_…: median and 90th percentile over held-out samples (%, mean over evaluation networks) and
-- the number of samples above 100 % (largest of all networks); holdout_rms_…: 10 times the square root of the held-out
-- error, which is a ratio of energies; trials with equal `training` share a body, which one of them has trained
CREATE VIEW v_trial AS
SELECT
  t.hash, CAST((SELECT s.name FROM sweep_trial x JOIN sweep s ON s.id = x.sweep_id
                WHERE x.trial_id = t.id ORDER BY s.id DESC LIMIT 1) AS TEXT) AS sweep,
  t.state, t.reason, t.layout, t.columns, t.rows, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  t.design_parameters, t.brain_parameters,
  t.error_initial, t.error_optimised, t.holdout_error_initial, t.holdout_error_optimised,
  t.train_error_initial, t.train_error_optimised, t.best_step,
  CAST(CASE WHEN EXISTS (SELECT 1 FROM elsewhere e WHERE e.trial_id = t.id)
    THEN CASE t.state WHEN 'done' THEN CAST(t.spec->>'$.optimise.iterations' AS INTEGER)
      ELSE (SELECT e.reached >> 32 FROM elsewhere e WHERE e.trial_id = t.id) END
    ELSE (SELECT count(*) FROM step p WHERE p.trial_id = t.id) END AS INTEGER) AS steps,
  CAST((SELECT count(*) FROM attempt a WHERE a.trial_id = t.id) AS INTEGER) AS attempts,
  CAST((SELECT sum(s.seconds) FROM spent s WHERE s.trial_id = t.id AND NOT s.redone) AS REAL) AS seconds,
  t.seconds_evaluation, t.cost, t.simd, t.solver, t.finished_at, t.spec,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with,
  i.error_test AS linear_test_error_initial, o.error_test AS linear_test_error_optimised,
  i.error_holdout AS linear_holdout_error_initial, o.error_holdout AS linear_holdout_error_optimised,
  CAST(coalesce(t.spec->>'$.sensors.search', 'random') AS TEXT) AS placed,
  CAST(coalesce(t.result->'$.placed.units', t.spec->'$.sensor_units') AS TEXT) AS sensor_units,
  CAST(coalesce(t.result->'$.moves[#-1][1]', t.result->'$.placed.units', t.spec->'$.sensor_units') AS TEXT) AS sensor_units_optimised,
  CAST(t.result->>'$.nonlinear[0][0]' AS REAL) AS nonlinear_acceleration_initial,
  CAST(t.result->>'$.nonlinear[0][1]' AS REAL) AS nonlinear_rotation_initial,
  CAST(t.result->>'$.nonlinear[1][0]' AS REAL) AS nonlinear_acceleration_optimised,
  CAST(t.result->>'$.nonlinear[1][1]' AS REAL) AS nonlinear_rotation_optimised,
  CAST((SELECT group_concat(code, ' ') FROM (SELECT coalesce(a.code, 'unknown') AS code FROM attempt a
     WHERE a.trial_id = t.id AND NOT a.redone AND (a.steps > 0 OR a.saves > 0 OR a.state = 'done')
     GROUP BY 1 ORDER BY min(a.number))) AS TEXT) AS code,
  t.training,
  t.holdout_median_initial, t.holdout_p90_initial, t.holdout_above_initial, CAST(10 * sqrt(t.holdout_error_initial) AS REAL) AS holdout_rms_initial,
  t.holdout_median_optimised, t.holdout_p90_optimised, t.holdout_above_optimised, CAST(10 * sqrt(t.holdout_error_optimised) AS REAL) AS holdout_rms_optimised
FROM trial t
LEFT JOIN reading i ON i.trial_id = t.id AND i.body = 'initial' AND i.whole
LEFT JOIN reading o ON o.trial_id = t.id AND o.body = 'optimised' AND o.whole;

-- an outer step: losses, errors (%), gradient, projection, implicit term, work, CPU seconds by part, λ of the linear decoder
-- (`ridge`); `attempt` is 0 if another trial that trains the same body computed the step
CREATE VIEW v_step AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol, p.step, p.attempt,
  p.loss_test, p.loss_train, p.error_test, p.error_train, p.gradient_norm, p.step_length,
  p.projection, p.projection_distance,
  p.implicit_iterations, p.implicit_residual, p.implicit_smallest_curvature, p.implicit_outcome,
  p.outcome, p.fresh_samples, p.force_evaluations, p.integrator_steps, p.rejected_steps,
  p.brain_iterations, p.hessian_products, p.projection_iterations,
  p.seconds_simulate, p.seconds_train, p.seconds_differentiate, p.seconds_implicit, p.seconds_project, p.seconds_store,
  CAST(p.seconds_simulate + p.seconds_train + p.seconds_differentiate + p.seconds_implicit + p.seconds_project
    + p.seconds_store AS REAL) AS seconds,
  p.recorded_at, p.ridge
FROM step p JOIN trial t ON t.id = p.trial_id;

-- a new network on the initial or the trained body, with its errors (%) and their spread over the held-out set as in v_reading
CREATE VIEW v_network AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol, n.body, n.network,
  n.error_train, n.error_test, n.error_holdout, n.iterations, n.outcome,
  n.median AS median_holdout, n.p90 AS p90_holdout, n.above AS above_holdout, CAST(10 * sqrt(n.error_holdout) AS REAL) AS rms_holdout
FROM network n JOIN trial t ON t.id = n.trial_id;

-- errors (%) of a linear decoder of one memory (s before and after an instant) on the initial or the trained body, for any
-- decoder of the trial; its λ (`ridge`), in the row with the trial's memory also that of the linear part of a stacked decoder;
-- median, 90th percentile (%), samples above 100 % and RMS error (%) on the held-out set
CREATE VIEW v_reading AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with, r.body,
  CAST(r.before * (t.spec->>'$.time.duration') / (t.spec->>'$.time.samples') AS REAL) AS before,
  CAST(r.after * (t.spec->>'$.time.duration') / (t.spec->>'$.time.samples') AS REAL) AS after,
  r.whole, r.ridge, r.error_train, r.error_test, r.error_holdout,
  r.median AS median_holdout, r.p90 AS p90_holdout, r.above AS above_holdout, CAST(10 * sqrt(r.error_holdout) AS REAL) AS rms_holdout
FROM reading r JOIN trial t ON t.id = r.trial_id;

-- error (%) of one decoder on one cast of the initial or the trained body: `nominal` (linear, fitted to the body as designed),
-- `casts` (linear, fitted to other casts), `records` (linear, calibrated on `records` samples of this cast), `network`,
-- `network_casts` (trained on other casts), `inverse` (the model of the design, inverted), `twin` (a twin calibrated on
-- `records` samples of this cast, inverted), `twin_linear` (linear, fitted to that twin); the error is over the whole held-out
-- set, but for `inverse` and `twin` over its first 16 samples; `nominal_error`: error on the body as designed, of the trial's
-- own decoder (mean over its networks) for networks, inverse decoders and linear trials, otherwise of the linear decoder of the
-- whole sample; instants_covered and samples_covered: the part of the held-out set within the
-- bands of the body as designed, or within the bands of an inverse decoder; median and 90th percentile (%) over held-out
-- samples, samples above 100 %, RMS error (%); λ (`ridge`) of linear decoders, also beneath stacked networks, and κ (`kappa`)
-- of linear decoders calibrated on samples of this cast
CREATE VIEW v_cast AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with,
  CAST(coalesce(t.spec->>'$.optimise.objective', 'nominal') AS TEXT) AS objective,
  c.body, c.casting, c.reader, c.records, c.error,
  CAST(CASE WHEN c.reader IN ('network', 'network_casts', 'inverse', 'twin') OR coalesce(t.spec->>'$.brain.kind', 'cnn') = 'linear'
    THEN CASE c.body WHEN 'initial' THEN t.holdout_error_initial ELSE t.holdout_error_optimised END
    ELSE r.error_holdout END AS REAL) AS nominal_error,
  c.outcome, i.coverage AS instants_covered, s.coverage AS samples_covered,
  c.median, c.p90, c.above, CAST(10 * sqrt(c.error) AS REAL) AS rms, c.ridge, c.kappa
FROM cast_reading c JOIN trial t ON t.id = c.trial_id
LEFT JOIN reading r ON r.trial_id = c.trial_id AND r.body = c.body AND r.whole
LEFT JOIN band i ON i.trial_id = c.trial_id AND i.body = c.body AND i.casting = c.casting AND i.reader = c.reader
  AND i.records = c.records AND i.kind = 'instant'
LEFT JOIN band s ON s.trial_id = c.trial_id AND s.body = c.body AND s.casting = c.casting AND s.reader = c.reader
  AND s.records = c.records AND s.kind = 'sample';

-- error of a readout of a sensing task on the initial or the trained body (`evaluation.tasks`), in `unit`, with its 95 %
-- interval over held-out samples: `direct`: fitted to the signals, or to those of `window` (s) from the contact on; `network`: in a
-- window, a small network; `decoded`: from the forces that a linear decoder estimates;
-- `trivial`: error of the best estimate without signals; `least`: resolution of the error; `score`: balanced accuracy (%) of
-- classes, R² of values; `detail` (JSON): of a class [true, estimated, samples], of a position [struck panel, mean error (mm),
-- samples]; `casts`: mean error over casts (`evaluation.casts`) of the readout fitted to the body as designed; of
-- classes, except decoded ones, `log_loss`: mean of −ln p of the true class (probabilities by temperature scaling); `calibration_error`:
-- expected difference between probability and frequency (%); `reliability` (JSON), per tenth of the probability: [mean probability
-- of the estimated class, its frequency, samples]
CREATE VIEW v_task AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with,
  CAST(coalesce(t.spec->>'$.brain.task', 'forces') AS TEXT) AS trained_for,
  CAST(CASE WHEN r.value->>'$.readout' <> 'decoded' THEN t.spec->>'$.brain.window' END AS REAL) AS window,
  CAST(r.value->>'$.body' AS TEXT) AS body,
  CAST(r.value->>'$.task' AS TEXT) AS task, CAST(r.value->>'$.readout' AS TEXT) AS readout,
  CAST(r.value->>'$.unit' AS TEXT) AS unit, CAST(r.value->>'$.error' AS REAL) AS error,
  CAST(r.value->>'$.interval[0]' AS REAL) AS low, CAST(r.value->>'$.interval[1]' AS REAL) AS high,
  CAST(r.value->>'$.least' AS REAL) AS least, CAST(r.value->>'$.trivial' AS REAL) AS trivial,
  CAST(r.value->>'$.samples' AS INTEGER) AS samples, CAST(r.value->>'$.score' AS REAL) AS score,
  CAST(r.value->'$.detail' AS TEXT) AS detail, CAST(r.value->>'$.casts' AS REAL) AS casts,
  CAST(r.value->>'$.log_loss' AS REAL) AS log_loss,
  CAST(r.value->>'$.calibration_error' AS REAL) AS calibration_error,
  CAST(r.value->'$.reliability' AS TEXT) AS reliability
FROM trial t, json_each(t.result, '$.tasks') r;

-- error (%) of a linear decoder on the initial or the trained body under one kind of forces (`evaluation.under`), for any
-- training forces of the body: `own`: fitted under these forces; `carried`: fitted under those of the trial; a body that cannot
-- be simulated counts as 100 %; median, p90, above and rms as in v_cast
CREATE VIEW v_under AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with,
  CAST(t.spec->>'$.stimuli.kind' AS TEXT) AS trained_under, CAST(u.value->>'$.body' AS TEXT) AS body,
  CAST(u.value->>'$.stimuli' AS TEXT) AS stimuli, CAST(u.value->>'$.reader' AS TEXT) AS reader,
  CAST(u.value->>'$.error' AS REAL) AS error, CAST(u.value->>'$.outcome' AS TEXT) AS outcome,
  CAST(u.value->>'$.spread.median' AS REAL) AS median, CAST(u.value->>'$.spread.p90' AS REAL) AS p90,
  CAST(u.value->>'$.spread.above' AS INTEGER) AS above, CAST(10 * sqrt(u.value->>'$.error') AS REAL) AS rms
FROM trial t, json_each(t.result, '$.under') u;
