-- Version 12: which trials train the same body, so that one of them trains it for all.

ALTER TABLE trial ADD COLUMN training TEXT; -- digest of all that trains the body; NULL: of an earlier version, and not run since
CREATE INDEX trial_training ON trial (training);

DROP VIEW v_trial;
CREATE VIEW v_trial AS
SELECT
  t.hash, (SELECT s.name FROM sweep_trial x JOIN sweep s ON s.id = x.sweep_id
           WHERE x.trial_id = t.id ORDER BY s.id DESC LIMIT 1) AS sweep,
  t.state, t.reason, t.layout, t.columns, t.rows, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  t.design_parameters, t.brain_parameters,
  t.error_initial, t.error_optimised, t.holdout_error_initial, t.holdout_error_optimised,
  t.train_error_initial, t.train_error_optimised, t.best_step,
  CASE WHEN EXISTS (SELECT 1 FROM elsewhere e WHERE e.trial_id = t.id)
    THEN CASE t.state WHEN 'done' THEN CAST(t.spec->>'$.optimise.iterations' AS INTEGER)
      ELSE (SELECT e.reached >> 32 FROM elsewhere e WHERE e.trial_id = t.id) END
    ELSE (SELECT count(*) FROM step p WHERE p.trial_id = t.id) END AS steps,
  (SELECT count(*) FROM attempt a WHERE a.trial_id = t.id) AS attempts,
  (SELECT sum(coalesce(a.cpu_seconds, CASE a.state WHEN 'done' THEN coalesce(t.seconds_evaluation, 0) ELSE 0 END
       + coalesce((SELECT sum(p.seconds_simulate + p.seconds_train + p.seconds_differentiate + p.seconds_implicit
                              + p.seconds_project + p.seconds_store)
                   FROM step p WHERE p.trial_id = t.id AND p.attempt = a.number), 0)))
   FROM attempt a WHERE a.trial_id = t.id AND NOT a.redone) AS seconds,
  t.seconds_evaluation, t.cost, t.simd, t.solver, t.finished_at, t.spec,
  coalesce(t.spec->>'$.brain.kind', 'cnn') AS brain, coalesce(t.spec->>'$.optimise.brain', 'cnn') AS trained_with,
  i.error_test AS linear_test_error_initial, o.error_test AS linear_test_error_optimised,
  i.error_holdout AS linear_holdout_error_initial, o.error_holdout AS linear_holdout_error_optimised,
  coalesce(t.spec->>'$.sensors.search', 'random') AS placed,
  coalesce(t.result->'$.placed.units', t.spec->'$.sensor_units') AS sensor_units,
  coalesce(t.result->'$.moves[#-1][1]', t.result->'$.placed.units', t.spec->'$.sensor_units') AS sensor_units_optimised,
  t.result->>'$.nonlinear[0][0]' AS nonlinear_acceleration_initial,
  t.result->>'$.nonlinear[0][1]' AS nonlinear_rotation_initial,
  t.result->>'$.nonlinear[1][0]' AS nonlinear_acceleration_optimised,
  t.result->>'$.nonlinear[1][1]' AS nonlinear_rotation_optimised,
  (SELECT group_concat(code, ' ') FROM (SELECT coalesce(a.code, 'unknown') AS code FROM attempt a
     WHERE a.trial_id = t.id AND NOT a.redone AND (a.steps > 0 OR a.saves > 0 OR a.state = 'done')
     GROUP BY 1 ORDER BY min(a.number))) AS code,
  t.training
FROM trial t
LEFT JOIN reading i ON i.trial_id = t.id AND i.body = 'initial' AND i.whole
LEFT JOIN reading o ON o.trial_id = t.id AND o.body = 'optimised' AND o.whole;
