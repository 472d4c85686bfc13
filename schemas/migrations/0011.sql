-- Version 11: bands of brains that were made from so many records of a cast, all of them kept; those of inverse brains beside their errors.

DROP VIEW v_cast;
DROP VIEW v_band;
ALTER TABLE band RENAME TO former;

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

-- of twins only that of 30 records was kept
INSERT INTO band
SELECT trial_id, body, casting, reader, CASE reader WHEN 'twin' THEN 30 ELSE 0 END, method, kind, level, samples, coverage, width, outcome
FROM former;
DROP TABLE former;

CREATE VIEW v_band AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  coalesce(t.spec->>'$.brain.kind', 'cnn') AS brain, coalesce(t.spec->>'$.optimise.brain', 'cnn') AS trained_with,
  b.body, nullif(b.casting, -1) AS casting, b.reader, b.records, b.method, b.kind, b.level, b.samples, b.coverage, b.width, b.outcome
FROM band b JOIN trial t ON t.id = b.trial_id;

CREATE VIEW v_cast AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  coalesce(t.spec->>'$.brain.kind', 'cnn') AS brain, coalesce(t.spec->>'$.optimise.brain', 'cnn') AS trained_with,
  coalesce(t.spec->>'$.optimise.objective', 'nominal') AS objective, t.spec->>'$.optimise.reader' AS trained_for,
  c.body, c.casting, c.reader, c.records, c.error, r.error_holdout AS nominal_error, c.outcome,
  i.coverage AS instants_covered, s.coverage AS samples_covered
FROM cast_reading c JOIN trial t ON t.id = c.trial_id
LEFT JOIN reading r ON r.trial_id = c.trial_id AND r.body = c.body AND r.whole
LEFT JOIN band i ON i.trial_id = c.trial_id AND i.body = c.body AND i.casting = c.casting AND i.reader = c.reader
  AND i.records = c.records AND i.kind = 'instant'
LEFT JOIN band s ON s.trial_id = c.trial_id AND s.body = c.body AND s.casting = c.casting AND s.reader = c.reader
  AND s.records = c.records AND s.kind = 'sample';
