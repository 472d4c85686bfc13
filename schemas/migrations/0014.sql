-- Version 14: checksums of checkpoints and arrays; elapsed times that a stepped clock does not change; one definition of the CPU seconds of an
-- attempt; a declared type for every column of a view.

ALTER TABLE checkpoint ADD COLUMN digest BLOB; -- BLAKE3 of bytes; NULL: written by an earlier version, and not checked
ALTER TABLE artifact ADD COLUMN digest BLOB;   -- likewise
ALTER TABLE run ADD COLUMN seconds REAL;       -- elapsed, by a monotonic clock; NULL: an earlier version, or killed
ALTER TABLE attempt ADD COLUMN seconds REAL;   -- likewise

DROP VIEW v_trial;
DROP VIEW v_step;
DROP VIEW v_error_time;
DROP VIEW v_reading;
DROP VIEW v_cast;
DROP VIEW v_band;
DROP VIEW v_under;
DROP VIEW v_run;
DROP VIEW v_attempt;

-- CPU seconds of each attempt: measured, or the sum of its parts if a version before 6 wrote it. All other views and reports sum these. Steps that
-- were taken over from another trial have attempt 0 and do not count.
CREATE VIEW spent AS
SELECT a.trial_id, a.number AS attempt, a.redone,
  CAST(coalesce(a.cpu_seconds, CASE a.state WHEN 'done' THEN coalesce(t.seconds_evaluation, 0) ELSE 0 END
    + coalesce((SELECT sum(p.seconds_simulate + p.seconds_train + p.seconds_differentiate + p.seconds_implicit
                           + p.seconds_project + p.seconds_store)
                FROM step p WHERE p.trial_id = a.trial_id AND p.attempt = a.number), 0)) AS REAL) AS seconds
FROM attempt a JOIN trial t ON t.id = a.trial_id;

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
  t.training
FROM trial t
LEFT JOIN reading i ON i.trial_id = t.id AND i.body = 'initial' AND i.whole
LEFT JOIN reading o ON o.trial_id = t.id AND o.body = 'optimised' AND o.whole;

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
  p.recorded_at
FROM step p JOIN trial t ON t.id = p.trial_id;

CREATE VIEW v_error_time AS
SELECT hash, units, panels, sensors, placement, seed, protocol, step,
  CAST(sum(seconds) OVER w AS REAL) AS seconds, error_test, CAST(min(error_test) OVER w AS REAL) AS best_error_test
FROM v_step
WINDOW w AS (PARTITION BY hash ORDER BY step ROWS UNBOUNDED PRECEDING);

CREATE VIEW v_reading AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with, r.body,
  CAST(r.before * (t.spec->>'$.time.duration') / (t.spec->>'$.time.samples') AS REAL) AS before,
  CAST(r.after * (t.spec->>'$.time.duration') / (t.spec->>'$.time.samples') AS REAL) AS after,
  r.whole, r.ridge, r.error_train, r.error_test, r.error_holdout
FROM reading r JOIN trial t ON t.id = r.trial_id;

CREATE VIEW v_cast AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with,
  CAST(coalesce(t.spec->>'$.optimise.objective', 'nominal') AS TEXT) AS objective,
  CAST(t.spec->>'$.optimise.reader' AS TEXT) AS trained_for,
  c.body, c.casting, c.reader, c.records, c.error,
  CAST(CASE WHEN c.reader IN ('network', 'network_casts', 'inverse', 'twin') OR coalesce(t.spec->>'$.brain.kind', 'cnn') = 'linear'
    THEN CASE c.body WHEN 'initial' THEN t.holdout_error_initial ELSE t.holdout_error_optimised END
    ELSE r.error_holdout END AS REAL) AS nominal_error,
  c.outcome, i.coverage AS instants_covered, s.coverage AS samples_covered
FROM cast_reading c JOIN trial t ON t.id = c.trial_id
LEFT JOIN reading r ON r.trial_id = c.trial_id AND r.body = c.body AND r.whole
LEFT JOIN band i ON i.trial_id = c.trial_id AND i.body = c.body AND i.casting = c.casting AND i.reader = c.reader
  AND i.records = c.records AND i.kind = 'instant'
LEFT JOIN band s ON s.trial_id = c.trial_id AND s.body = c.body AND s.casting = c.casting AND s.reader = c.reader
  AND s.records = c.records AND s.kind = 'sample';

CREATE VIEW v_band AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with,
  b.body, CAST(nullif(b.casting, -1) AS INTEGER) AS casting, b.reader, b.records, b.method, b.kind, b.level, b.samples, b.coverage, b.width,
  b.outcome
FROM band b JOIN trial t ON t.id = b.trial_id;

CREATE VIEW v_under AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with,
  CAST(t.spec->>'$.stimuli.kind' AS TEXT) AS trained_under, CAST(u.value->>'$.body' AS TEXT) AS body,
  CAST(u.value->>'$.stimuli' AS TEXT) AS stimuli, CAST(u.value->>'$.reader' AS TEXT) AS reader,
  CAST(u.value->>'$.error' AS REAL) AS error, CAST(u.value->>'$.outcome' AS TEXT) AS outcome
FROM trial t, json_each(t.result, '$.under') u;

CREATE VIEW v_run AS
SELECT s.name AS sweep, r.shard, r.shards, r.host, r.job, r.version, r.workers, r.threads, r.trials, r.done, r.failed,
  r.outcome, r.estimated_seconds,
  CAST(coalesce(r.seconds, (julianday(r.ended_at) - julianday(r.started_at)) * 86400) AS REAL) AS seconds,
  r.started_at, r.ended_at
FROM run r JOIN sweep s ON s.id = r.sweep_id;

CREATE VIEW v_attempt AS
SELECT t.hash, t.panels, t.sensors, t.placement, t.seed, a.number AS attempt, a.state, a.reason, a.steps, a.version,
  a.started_at, a.ended_at,
  CAST(coalesce(a.seconds, (julianday(a.ended_at) - julianday(a.started_at)) * 86400) AS REAL) AS seconds,
  a.code, a.revision, a.rustc, a.host, a.cpu, a.simd, a.threads, a.redone, s.seconds AS cpu_seconds
FROM attempt a JOIN trial t ON t.id = a.trial_id JOIN spent s ON s.trial_id = a.trial_id AND s.attempt = a.number;
