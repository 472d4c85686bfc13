-- Version 2: calls of `run`: what was planned, and what came of it.

CREATE TABLE run (
  sweep_id INTEGER NOT NULL REFERENCES sweep (id),
  started_at TEXT NOT NULL,
  host TEXT NOT NULL,
  shard INTEGER NOT NULL,             -- of `shards`, from 1; 1 of 1 is the whole sweep
  shards INTEGER NOT NULL,
  job TEXT,                           -- of the cluster's scheduler
  version TEXT NOT NULL,
  workers INTEGER NOT NULL, threads INTEGER NOT NULL,
  trials INTEGER NOT NULL,            -- that were open when it began
  estimated_seconds REAL NOT NULL,    -- that they were to take on all workers
  ended_at TEXT,                      -- NULL: it was killed, or goes on
  outcome TEXT,                       -- complete, interrupted, or what went wrong
  done INTEGER, failed INTEGER,       -- trials of this run
  PRIMARY KEY (sweep_id, started_at, host, shard, shards)
) STRICT, WITHOUT ROWID;

CREATE VIEW v_run AS
SELECT s.name AS sweep, r.shard, r.shards, r.host, r.job, r.version, r.workers, r.threads, r.trials, r.done, r.failed,
  r.outcome, r.estimated_seconds, (julianday(r.ended_at) - julianday(r.started_at)) * 86400 AS seconds,
  r.started_at, r.ended_at
FROM run r JOIN sweep s ON s.id = r.sweep_id;
