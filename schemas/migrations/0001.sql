-- Version 1. Units: mm, N, s, Mg; errors in %, losses in N² (test) or normalised (train). Absent numbers are NULL.

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
  finished_at TEXT
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
  recorded_at TEXT NOT NULL,
  PRIMARY KEY (trial_id, step)
) STRICT, WITHOUT ROWID;

CREATE TABLE network (                 -- a fresh network on a body, for the comparison at the end
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  body TEXT NOT NULL CHECK (body IN ('initial', 'optimised')),
  network INTEGER NOT NULL,           -- evaluation seed, from 0
  error_train REAL, error_test REAL, error_holdout REAL,
  iterations INTEGER NOT NULL,
  outcome TEXT NOT NULL,
  PRIMARY KEY (trial_id, body, network)
) STRICT, WITHOUT ROWID;

CREATE TABLE curve (                   -- its training loss, thinned; whole curves are artifacts
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  body TEXT NOT NULL,
  network INTEGER NOT NULL,
  iteration INTEGER NOT NULL,         -- from 1
  loss REAL,
  PRIMARY KEY (trial_id, body, network, iteration)
) STRICT, WITHOUT ROWID;

CREATE TABLE artifact (
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  name TEXT NOT NULL,
  shape TEXT NOT NULL,                -- JSON list
  bytes BLOB NOT NULL,                -- NPY
  PRIMARY KEY (trial_id, name)
) STRICT;

CREATE TABLE checkpoint (
  trial_id INTEGER PRIMARY KEY REFERENCES trial (id),
  step INTEGER NOT NULL,              -- the next outer step
  bytes BLOB NOT NULL                 -- a version byte, then postcard
) STRICT;

CREATE VIEW v_trial AS
SELECT
  t.hash, (SELECT s.name FROM sweep_trial x JOIN sweep s ON s.id = x.sweep_id
           WHERE x.trial_id = t.id ORDER BY s.id DESC LIMIT 1) AS sweep,
  t.state, t.reason, t.layout, t.columns, t.rows, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  t.design_parameters, t.brain_parameters,
  t.error_initial, t.error_optimised, t.holdout_error_initial, t.holdout_error_optimised,
  t.train_error_initial, t.train_error_optimised, t.best_step,
  (SELECT count(*) FROM step p WHERE p.trial_id = t.id) AS steps,
  (SELECT count(*) FROM attempt a WHERE a.trial_id = t.id) AS attempts,
  (SELECT sum(p.seconds_simulate + p.seconds_train + p.seconds_differentiate + p.seconds_implicit
              + p.seconds_project + p.seconds_store) FROM step p WHERE p.trial_id = t.id)
    + coalesce(t.seconds_evaluation, 0) AS seconds,
  t.seconds_evaluation, t.cost, t.simd, t.solver, t.finished_at, t.spec
FROM trial t;

CREATE VIEW v_attempt AS
SELECT t.hash, t.panels, t.sensors, t.placement, t.seed, a.number AS attempt, a.state, a.reason, a.steps, a.version,
  a.started_at, a.ended_at,
  (julianday(a.ended_at) - julianday(a.started_at)) * 86400 AS seconds
FROM attempt a JOIN trial t ON t.id = a.trial_id;

CREATE VIEW v_step AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol, p.step, p.attempt,
  p.loss_test, p.loss_train, p.error_test, p.error_train, p.gradient_norm, p.step_length,
  p.projection, p.projection_distance,
  p.implicit_iterations, p.implicit_residual, p.implicit_smallest_curvature, p.implicit_outcome,
  p.outcome, p.fresh_samples, p.force_evaluations, p.integrator_steps, p.rejected_steps,
  p.brain_iterations, p.hessian_products, p.projection_iterations,
  p.seconds_simulate, p.seconds_train, p.seconds_differentiate, p.seconds_implicit, p.seconds_project, p.seconds_store,
  p.seconds_simulate + p.seconds_train + p.seconds_differentiate + p.seconds_implicit + p.seconds_project
    + p.seconds_store AS seconds,
  p.recorded_at
FROM step p JOIN trial t ON t.id = p.trial_id;

CREATE VIEW v_network AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol, n.body, n.network,
  n.error_train, n.error_test, n.error_holdout, n.iterations, n.outcome
FROM network n JOIN trial t ON t.id = n.trial_id;

CREATE VIEW v_curve AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol, c.body, c.network, c.iteration, c.loss
FROM curve c JOIN trial t ON t.id = c.trial_id;

CREATE VIEW v_artifact AS
SELECT t.hash, a.name, a.shape, a.bytes FROM artifact a JOIN trial t ON t.id = a.trial_id;

CREATE VIEW v_error_time AS
SELECT hash, units, panels, sensors, placement, seed, protocol, step,
  sum(seconds) OVER w AS seconds, error_test, min(error_test) OVER w AS best_error_test
FROM v_step
WINDOW w AS (PARTITION BY hash ORDER BY step ROWS UNBOUNDED PRECEDING);
