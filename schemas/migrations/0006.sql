-- Version 6: by what code, where, an attempt was made, what it took, and what was said of it; where the best body's sensors
-- are, which may have moved on the way; what a linear model of the body at rest leaves of its signals.

ALTER TABLE attempt ADD COLUMN code TEXT;      -- digest of the sources that compute; NULL: an older attempt
ALTER TABLE attempt ADD COLUMN revision TEXT;  -- commit, and `-dirty` with changes that it lacks; NULL: built without git
ALTER TABLE attempt ADD COLUMN rustc TEXT;
ALTER TABLE attempt ADD COLUMN host TEXT;
ALTER TABLE attempt ADD COLUMN cpu TEXT;
ALTER TABLE attempt ADD COLUMN simd TEXT;
ALTER TABLE attempt ADD COLUMN threads INTEGER;
ALTER TABLE attempt ADD COLUMN redone INTEGER NOT NULL DEFAULT 0; -- 1: what it left was thrown away, to be made by other code
ALTER TABLE attempt ADD COLUMN cpu_seconds REAL; -- of its worker, all threads; NULL: an older attempt, or some hundredths
ALTER TABLE attempt ADD COLUMN saves INTEGER NOT NULL DEFAULT 0; -- checkpoints recorded within the comparison at the end

CREATE TABLE log (                     -- what was said of an attempt, as much as is kept of it
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  attempt INTEGER NOT NULL,
  line INTEGER NOT NULL,              -- from 1
  at TEXT NOT NULL,
  level TEXT NOT NULL CHECK (level IN ('info', 'warn', 'error')),
  text TEXT NOT NULL,
  PRIMARY KEY (trial_id, attempt, line)
) STRICT, WITHOUT ROWID;

CREATE VIEW v_log AS
SELECT t.hash, t.state, t.reason, t.panels, t.sensors, t.placement, t.seed, l.attempt, l.line, l.at, l.level, l.text
FROM log l JOIN trial t ON t.id = l.trial_id;

DROP VIEW v_attempt;
CREATE VIEW v_attempt AS
SELECT t.hash, t.panels, t.sensors, t.placement, t.seed, a.number AS attempt, a.state, a.reason, a.steps, a.version,
  a.started_at, a.ended_at,
  (julianday(a.ended_at) - julianday(a.started_at)) * 86400 AS seconds,
  a.code, a.revision, a.rustc, a.host, a.cpu, a.simd, a.threads, a.redone, a.cpu_seconds
FROM attempt a JOIN trial t ON t.id = a.trial_id;

DROP VIEW v_trial;
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
     GROUP BY 1 ORDER BY min(a.number))) AS code
FROM trial t
LEFT JOIN reading i ON i.trial_id = t.id AND i.body = 'initial' AND i.whole
LEFT JOIN reading o ON o.trial_id = t.id AND o.body = 'optimised' AND o.whole;
