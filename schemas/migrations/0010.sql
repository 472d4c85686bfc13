-- Version 10: bands about what brains say of the forces, and how much of the holdout lies in them.

CREATE TABLE band (
  trial_id INTEGER NOT NULL REFERENCES trial (id),
  body TEXT NOT NULL CHECK (body IN ('initial', 'optimised')),
  casting INTEGER NOT NULL,           -- which cast, from 0; -1: the body as designed
  reader TEXT NOT NULL,               -- own; of casts as in cast_reading
  method TEXT NOT NULL,               -- conformal
  kind TEXT NOT NULL,                 -- instant, sample
  level REAL NOT NULL,
  samples INTEGER NOT NULL,           -- that calibrated it
  coverage REAL,                      -- a part of 1
  width REAL,                         -- in the mean (N)
  outcome TEXT NOT NULL,
  PRIMARY KEY (trial_id, body, casting, reader, method, kind)
) STRICT, WITHOUT ROWID;

CREATE VIEW v_band AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  coalesce(t.spec->>'$.brain.kind', 'cnn') AS brain, coalesce(t.spec->>'$.optimise.brain', 'cnn') AS trained_with,
  b.body, nullif(b.casting, -1) AS casting, b.reader, b.method, b.kind, b.level, b.samples, b.coverage, b.width, b.outcome
FROM band b JOIN trial t ON t.id = b.trial_id;

DROP VIEW v_cast;
CREATE VIEW v_cast AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  coalesce(t.spec->>'$.brain.kind', 'cnn') AS brain, coalesce(t.spec->>'$.optimise.brain', 'cnn') AS trained_with,
  coalesce(t.spec->>'$.optimise.objective', 'nominal') AS objective, t.spec->>'$.optimise.reader' AS trained_for,
  c.body, c.casting, c.reader, c.records, c.error, r.error_holdout AS nominal_error, c.outcome,
  i.coverage AS instants_covered, s.coverage AS samples_covered
FROM cast_reading c JOIN trial t ON t.id = c.trial_id
LEFT JOIN reading r ON r.trial_id = c.trial_id AND r.body = c.body AND r.whole
LEFT JOIN band i ON i.trial_id = c.trial_id AND i.body = c.body AND i.casting = c.casting AND i.reader = c.reader
  AND i.method = 'conformal' AND i.kind = 'instant'
LEFT JOIN band s ON s.trial_id = c.trial_id AND s.body = c.body AND s.casting = c.casting AND s.reader = c.reader
  AND s.method = 'conformal' AND s.kind = 'sample';
