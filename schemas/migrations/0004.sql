-- Version 4: what linear brains make of every body, whatever the trial's own brain is; which brains a trial has.

CREATE TABLE reading (
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  body TEXT NOT NULL CHECK (body IN ('initial', 'optimised')),
  before INTEGER NOT NULL, after INTEGER NOT NULL, -- how far it looks back and ahead (instants)
  whole INTEGER NOT NULL,                          -- 1: as far as any, by default over the whole sample
  ridge REAL NOT NULL,
  error_train REAL, error_test REAL, error_holdout REAL,
  PRIMARY KEY (trial_id, body, before, after)
) STRICT, WITHOUT ROWID;

CREATE VIEW v_reading AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  coalesce(t.spec->>'$.brain.kind', 'cnn') AS brain, coalesce(t.spec->>'$.optimise.brain', 'cnn') AS trained_with, r.body,
  r.before * (t.spec->>'$.time.duration') / (t.spec->>'$.time.samples') AS before,
  r.after * (t.spec->>'$.time.duration') / (t.spec->>'$.time.samples') AS after,
  r.whole, r.ridge, r.error_train, r.error_test, r.error_holdout
FROM reading r JOIN trial t ON t.id = r.trial_id;

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
  (SELECT sum(p.seconds_simulate + p.seconds_train + p.seconds_differentiate + p.seconds_implicit
              + p.seconds_project + p.seconds_store) FROM step p WHERE p.trial_id = t.id)
    + coalesce(t.seconds_evaluation, 0) AS seconds,
  t.seconds_evaluation, t.cost, t.simd, t.solver, t.finished_at, t.spec,
  coalesce(t.spec->>'$.brain.kind', 'cnn') AS brain, coalesce(t.spec->>'$.optimise.brain', 'cnn') AS trained_with,
  i.error_test AS linear_test_error_initial, o.error_test AS linear_test_error_optimised,
  i.error_holdout AS linear_holdout_error_initial, o.error_holdout AS linear_holdout_error_optimised
FROM trial t
LEFT JOIN reading i ON i.trial_id = t.id AND i.body = 'initial' AND i.whole
LEFT JOIN reading o ON o.trial_id = t.id AND o.body = 'optimised' AND o.whole;
