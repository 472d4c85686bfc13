//! `watch`: a run as it goes on, seen from its database, from any terminal.

use std::io::{IsTerminal, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::status::newest;
use super::{Error, Format, duration, print_rows};
use crate::exit::Exit;
use crate::store::{Reader, Table};

/// Watches a run from another terminal: trials, steps, errors so far, rate and time to go; ends with the run
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database; by default the one under results/ that was written last
    db: Option<PathBuf>,
    /// Time between two looks (s)
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    every: f64,
    /// Look once
    #[arg(long)]
    once: bool,
}

/// The trials that run, with their last step.
const RUNNING: &str = "
SELECT t.panels AS K, t.sensors AS M, t.placement, t.seed, t.units, 1 + p.step AS steps,
  json_extract(t.spec, '$.optimise.iterations') AS of, round(p.error_test, 2) AS error_now,
  (SELECT round(min(b.error_test), 2) FROM step b WHERE b.trial_id = t.id) AS error_best,
  CAST(round((julianday('now') - julianday(coalesce(p.recorded_at, a.started_at))) * 86400) AS INTEGER) AS seconds_ago,
  a.number AS attempt, substr(t.hash, 1, 8) AS hash
FROM trial t JOIN attempt a ON a.trial_id = t.id AND a.state = 'running'
LEFT JOIN step p ON p.trial_id = t.id AND p.step = (SELECT max(step) FROM step m WHERE m.trial_id = t.id)
WHERE t.state = 'running' ORDER BY 1, 2, 3, 4, 5";

/// All trials by state, and the estimated seconds of those that are open; steps, attempts, and how long the successful
/// attempts took against what was estimated.
const WHOLE: &str = "
SELECT count(*), sum(state = 'done'), sum(state = 'failed'), sum(state = 'running'),
  sum(CASE WHEN state IN ('pending', 'running') THEN cost ELSE 0 END),
  (SELECT sum(steps) FROM attempt), (SELECT count(*) FROM attempt),
  (SELECT sum((julianday(a.ended_at) - julianday(a.started_at)) * 86400) / nullif(sum(t.cost), 0)
   FROM attempt a JOIN trial t ON t.id = a.trial_id WHERE a.state = 'done')
FROM trial";

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let db = args.db.or_else(|| newest(Path::new("results")));
    let db = db.ok_or_else(|| {
        Error::Usage("there is no database under results/; name one: metasense watch DB".into())
    })?;
    if !(0.1..=3600.0).contains(&args.every) {
        return Err(Error::Usage(format!("--every {} is not between 0.1 and 3600 s", args.every)));
    }
    let live = std::io::stdout().is_terminal() && !args.once;
    let mut first: Option<(Instant, f64)> = None;
    loop {
        let mut reader = Reader::open(&db).await?;
        let whole = reader.query(WHOLE).await?;
        let running = reader.query(RUNNING).await?;
        reader.close().await;
        if live {
            // Home, and clear to the end of the screen.
            print!("\x1b[H\x1b[2J");
        }
        println!("{}: {}", db.display(), summary(&whole, &mut first));
        if !running.rows.is_empty() {
            print_rows(&running, Format::Table)?;
        }
        std::io::stdout().flush()?;
        if args.once || !in_use(&db) {
            return Ok(Exit::Done);
        }
        tokio::time::sleep(Duration::from_secs_f64(args.every)).await;
    }
}

/// `first`: when the watch began, and the steps there were then.
fn summary(whole: &Table, first: &mut Option<(Instant, f64)>) -> String {
    let row = &whole.rows[0];
    let number = |i: usize| row[i].as_f64().unwrap_or(0.0);
    let (total, done, failed, running) = (number(0), number(1), number(2), number(3));
    let mut text = format!(
        "{done} of {total} trials done, {failed} failed, {running} running, {} waiting; {} steps in {} attempts",
        total - done - failed - running,
        number(5),
        number(6),
    );
    let (began, steps) = *first.get_or_insert((Instant::now(), number(5)));
    if number(5) > steps {
        text += &format!(", {:.1} a minute", 60.0 * (number(5) - steps) / began.elapsed().as_secs_f64());
    }
    let (left, correction) = (number(4), number(7));
    if correction > 0.0 && running > 0.0 {
        text += &format!("; some {} to go", duration(left * correction / running));
    }
    text
}

/// Whether a run writes to it. Asked of the kernel: to try the lock would keep a run that begins just then from it.
fn in_use(db: &Path) -> bool {
    let Ok(file) = db.metadata() else { return false };
    let inode = format!(":{} ", file.ino());
    let locks = std::fs::read_to_string("/proc/locks").unwrap_or_default();
    locks.lines().any(|line| line.contains("FLOCK") && line.contains("WRITE") && line.contains(&inode))
}
