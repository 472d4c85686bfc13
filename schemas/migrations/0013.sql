-- Version 13: what a brain of its kind has on the body as designed stands beside what is left of it in a cast: of networks, of inverse brains and
-- where the trial's own brain is linear that is the trial's error, else the linear brain's of the whole sample.
DROP VIEW v_cast;
CREATE VIEW v_cast AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  coalesce(t.spec->>'$.brain.kind', 'cnn') AS brain, coalesce(t.spec->>'$.optimise.brain', 'cnn') AS trained_with,
  coalesce(t.spec->>'$.optimise.objective', 'nominal') AS objective, t.spec->>'$.optimise.reader' AS trained_for,
  c.body, c.casting, c.reader, c.records, c.error,
  CASE WHEN c.reader IN ('network', 'network_casts', 'inverse', 'twin') OR coalesce(t.spec->>'$.brain.kind', 'cnn') = 'linear'
    THEN CASE c.body WHEN 'initial' THEN t.holdout_error_initial ELSE t.holdout_error_optimised END
    ELSE r.error_holdout END AS nominal_error,
  c.outcome, i.coverage AS instants_covered, s.coverage AS samples_covered
FROM cast_reading c JOIN trial t ON t.id = c.trial_id
LEFT JOIN reading r ON r.trial_id = c.trial_id AND r.body = c.body AND r.whole
LEFT JOIN band i ON i.trial_id = c.trial_id AND i.body = c.body AND i.casting = c.casting AND i.reader = c.reader
  AND i.records = c.records AND i.kind = 'instant'
LEFT JOIN band s ON s.trial_id = c.trial_id AND s.body = c.body AND s.casting = c.casting AND s.reader = c.reader
  AND s.records = c.records AND s.kind = 'sample';
