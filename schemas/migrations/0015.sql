-- Version 15: how holdout errors spread, beside their means: median and 90th percentile over samples (%), samples above 100 %; the RMS error
-- (%), 10 times the root of the error, which is a ratio of energies; λ (ridge) of every fit, κ (kappa) of decoders calibrated on a cast. NULL: an
-- earlier version.

ALTER TABLE trial ADD COLUMN holdout_median_initial REAL; -- mean over the evaluation's networks
ALTER TABLE trial ADD COLUMN holdout_p90_initial REAL;
ALTER TABLE trial ADD COLUMN holdout_above_initial INTEGER; -- of the network with the most
ALTER TABLE trial ADD COLUMN holdout_median_optimised REAL;
ALTER TABLE trial ADD COLUMN holdout_p90_optimised REAL;
ALTER TABLE trial ADD COLUMN holdout_above_optimised INTEGER;
ALTER TABLE network ADD COLUMN median REAL;
ALTER TABLE network ADD COLUMN p90 REAL;
ALTER TABLE network ADD COLUMN above INTEGER;
ALTER TABLE reading ADD COLUMN median REAL;
ALTER TABLE reading ADD COLUMN p90 REAL;
ALTER TABLE reading ADD COLUMN above INTEGER;
ALTER TABLE cast_reading ADD COLUMN median REAL;
ALTER TABLE cast_reading ADD COLUMN p90 REAL;
ALTER TABLE cast_reading ADD COLUMN above INTEGER;
ALTER TABLE cast_reading ADD COLUMN ridge REAL;
ALTER TABLE cast_reading ADD COLUMN kappa REAL;
ALTER TABLE step ADD COLUMN ridge REAL;

DROP VIEW v_trial;
DROP VIEW v_step;
DROP VIEW v_network;
DROP VIEW v_reading;
DROP VIEW v_cast;
DROP VIEW v_under;

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

CREATE VIEW v_network AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol, n.body, n.network,
  n.error_train, n.error_test, n.error_holdout, n.iterations, n.outcome,
  n.median AS median_holdout, n.p90 AS p90_holdout, n.above AS above_holdout, CAST(10 * sqrt(n.error_holdout) AS REAL) AS rms_holdout
FROM network n JOIN trial t ON t.id = n.trial_id;

CREATE VIEW v_reading AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  CAST(coalesce(t.spec->>'$.brain.kind', 'cnn') AS TEXT) AS brain,
  CAST(coalesce(t.spec->>'$.optimise.brain', 'cnn') AS TEXT) AS trained_with, r.body,
  CAST(r.before * (t.spec->>'$.time.duration') / (t.spec->>'$.time.samples') AS REAL) AS before,
  CAST(r.after * (t.spec->>'$.time.duration') / (t.spec->>'$.time.samples') AS REAL) AS after,
  r.whole, r.ridge, r.error_train, r.error_test, r.error_holdout,
  r.median AS median_holdout, r.p90 AS p90_holdout, r.above AS above_holdout, CAST(10 * sqrt(r.error_holdout) AS REAL) AS rms_holdout
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
  c.outcome, i.coverage AS instants_covered, s.coverage AS samples_covered,
  c.median, c.p90, c.above, CAST(10 * sqrt(c.error) AS REAL) AS rms, c.ridge, c.kappa
FROM cast_reading c JOIN trial t ON t.id = c.trial_id
LEFT JOIN reading r ON r.trial_id = c.trial_id AND r.body = c.body AND r.whole
LEFT JOIN band i ON i.trial_id = c.trial_id AND i.body = c.body AND i.casting = c.casting AND i.reader = c.reader
  AND i.records = c.records AND i.kind = 'instant'
LEFT JOIN band s ON s.trial_id = c.trial_id AND s.body = c.body AND s.casting = c.casting AND s.reader = c.reader
  AND s.records = c.records AND s.kind = 'sample';

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
