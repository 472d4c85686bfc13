-- Version 3: the prediction error on the holdout (%) of a fresh network on its way, beside its training loss.

ALTER TABLE curve ADD COLUMN error_holdout REAL; -- by the weights whose loss it is; NULL: an older trial

DROP VIEW v_curve;
CREATE VIEW v_curve AS
SELECT t.hash, t.units, t.panels, t.sensors, t.placement, t.seed, t.protocol, c.body, c.network, c.iteration, c.loss,
  c.error_holdout
FROM curve c JOIN trial t ON t.id = c.trial_id;
