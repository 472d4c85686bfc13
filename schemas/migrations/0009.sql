-- Version 9: a body under forces of other kinds than its trial's.

CREATE VIEW v_under AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol,
  coalesce(t.spec->>'$.brain.kind', 'cnn') AS brain, coalesce(t.spec->>'$.optimise.brain', 'cnn') AS trained_with,
  t.spec->>'$.stimuli.kind' AS trained_under, u.value->>'$.body' AS body, u.value->>'$.stimuli' AS stimuli,
  u.value->>'$.reader' AS reader, u.value->>'$.error' AS error, u.value->>'$.outcome' AS outcome
FROM trial t, json_each(t.result, '$.under') u;
