-- Version 8: what is left of a body once it is cast.

CREATE TABLE cast_reading (            -- how one brain reads one cast of a body
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  body TEXT NOT NULL CHECK (body IN ('initial', 'optimised')),
  casting INTEGER NOT NULL,           -- which, from 0
  reader TEXT NOT NULL,               -- network, nominal, casts, records
  records INTEGER NOT NULL,           -- samples of this cast that it was fitted to
  error REAL,                         -- on the holdout (%)
  outcome TEXT NOT NULL,
  PRIMARY KEY (trial_id, body, casting, reader, records)
) STRICT, WITHOUT ROWID;

CREATE VIEW v_cast AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  coalesce(t.spec->>'$.brain.kind', 'cnn') AS brain, coalesce(t.spec->>'$.optimise.brain', 'cnn') AS trained_with,
  coalesce(t.spec->>'$.optimise.objective', 'nominal') AS objective, t.spec->>'$.optimise.reader' AS trained_for,
  c.body, c.casting, c.reader, c.records, c.error, r.error_holdout AS nominal_error, c.outcome
FROM cast_reading c JOIN trial t ON t.id = c.trial_id
LEFT JOIN reading r ON r.trial_id = c.trial_id AND r.body = c.body AND r.whole;
