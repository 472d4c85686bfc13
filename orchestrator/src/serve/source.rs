//! A database, or the facts of the shards of a folder, read for as long as somebody watches. Each state is published whole:
//! pages show the last one without waiting for the database.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::{Notify, watch};
use tokio::task::JoinHandle;

use super::trials::{Keeper, Trials};
use crate::analysis::Terms;
use crate::cluster::facts::Facts;
use crate::exit::chain;
use crate::fleet::cpu_seconds;
use crate::look::{Answer, Figure, Table};
use crate::progress::{FAILED, Looks, Progress};
use crate::report::load::finished_trials;
use crate::report::{answers, brains, figures};
use crate::store::{Reader, StoreError};

/// Between two looks at whether anything has changed.
const POLL: Duration = Duration::from_millis(100);
/// Between two reads of what has changed, at least; and so many times the CPU time of the last one.
const REST: Duration = Duration::from_millis(300);
const REST_FACTOR: u32 = 30;
/// Between two reads while nothing changes but a run's processes.
const PROCESSES: Duration = Duration::from_secs(5);
/// How long a page waits for a look; what comes later comes by itself.
const PATIENCE: Duration = Duration::from_millis(700);
/// How long the end waits for one.
const ENDING: Duration = Duration::from_secs(5);
/// Answers are worked out again after so many times what they took.
const ANSWERS_FACTOR: u32 = 50;
/// Answers on a page: there is one a setting.
const MOST_SAID: usize = 60;
/// Trials up to which figures with a mark a trial are drawn.
const MOST_DRAWN: usize = 2000;

/// What is seen of a database.
#[derive(Debug, Clone, Default)]
pub struct Seen {
    /// Counts what has changed.
    pub generation: u64,
    /// When it was looked at last.
    pub checked: Option<Instant>,
    /// The database; of shards that of their facts, once there is any.
    pub db: PathBuf,
    /// Why it could not be looked at.
    pub trouble: Option<String>,
    /// How far it is.
    pub progress: Progress,
    /// Failures by reason and words, with one of their trials.
    pub failures: Table,
    /// The last calls of `run`.
    pub runs: Table,
    /// All trials; none before they have been read.
    pub trials: Trials,
    /// What the trials answer.
    pub answers: Arc<Answers>,
}

/// What finished trials answer.
#[derive(Debug, Clone, Default)]
pub struct Answers {
    /// Trials that answer.
    pub of: usize,
    /// In words, the first ones.
    pub said: Vec<Answer>,
    /// Further ones.
    pub left: usize,
    /// Drawn.
    pub figures: Vec<Figure>,
    /// Time that it took to work them out (s).
    pub seconds: f64,
}

/// A database that can be watched.
#[derive(Debug)]
pub struct Source {
    /// What it is called.
    pub name: String,
    /// The file, where it is one that a run may hold.
    pub db: Option<PathBuf>,
    seen: watch::Receiver<Arc<Seen>>,
    wanted: Arc<Notify>,
    stop: Arc<Notify>,
}

impl Source {
    /// Begins to watch a database, or a folder of shards.
    ///
    /// # Errors
    /// Where there is no folder for the facts of shards.
    pub fn new(path: &Path) -> std::io::Result<Self> {
        let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        let facts = path.is_dir().then(|| Facts::of(path)).transpose()?;
        let (publish, seen) = watch::channel(Arc::new(Seen::default()));
        let wanted = Arc::new(Notify::new());
        let watcher = Watcher {
            path: path.to_owned(),
            facts,
            reader: None,
            version: -1,
            looks: Looks::default(),
            keeper: Keeper::default(),
            seen: Seen::default(),
            rest: Instant::now(),
            read: Instant::now(),
            answering: None,
            answered: (0, Instant::now()),
        };
        let stop = Arc::new(Notify::new());
        tokio::spawn(watcher.watch(publish, Arc::clone(&wanted), Arc::clone(&stop)));
        let db = (!path.is_dir()).then(|| path.to_owned());
        Ok(Self { name, db, seen, wanted, stop })
    }

    /// Ends the watching.
    pub async fn close(&self) {
        self.stop.notify_one();
        let mut seen = self.seen.clone();
        seen.mark_unchanged();
        let ended = async { while seen.changed().await.is_ok() {} };
        let _ = tokio::time::timeout(ENDING, ended).await;
    }

    /// What is seen from now on: each change, the last one only where several have come.
    pub fn watched(&self) -> watch::Receiver<Arc<Seen>> {
        let seen = self.seen.clone();
        self.wanted.notify_one();
        seen
    }

    /// What is seen now, or before where a look takes long.
    pub async fn now(&self) -> Arc<Seen> {
        let asked = Instant::now();
        let mut seen = self.watched();
        let fresh = |seen: &Arc<Seen>| seen.checked.is_some_and(|checked| checked >= asked);
        let _ = tokio::time::timeout(PATIENCE, seen.wait_for(fresh)).await;
        seen.borrow().clone()
    }
}

/// Looks at one database.
struct Watcher {
    path: PathBuf,
    facts: Option<Facts>,
    /// With the file's number.
    reader: Option<(Reader, u64)>,
    version: i64,
    looks: Looks,
    keeper: Keeper,
    seen: Seen,
    rest: Instant,
    read: Instant,
    answering: Option<JoinHandle<Result<Answers, StoreError>>>,
    /// Trials that the last answers were to be of, and when they may be worked out again.
    answered: (u64, Instant),
}

impl Watcher {
    async fn watch(mut self, publish: watch::Sender<Arc<Seen>>, wanted: Arc<Notify>, stop: Arc<Notify>) {
        loop {
            // The source itself has one.
            let unwatched = publish.receiver_count() == 1;
            tokio::select! {
                () = stop.notified() => break,
                () = wanted.notified() => {}
                () = tokio::time::sleep(POLL), if !unwatched => {}
            }
            let checked = Instant::now();
            if let Err(trouble) = self.look(&publish).await {
                self.let_go().await;
                if self.seen.trouble.as_ref() != Some(&trouble) {
                    self.seen.trouble = Some(trouble);
                    self.seen.generation += 1;
                }
            }
            self.answers().await;
            self.seen.checked = Some(checked);
            publish.send_replace(Arc::new(self.seen.clone()));
        }
        self.let_go().await;
    }

    /// Closes the file, and forgets its trials: another may lie there next time.
    async fn let_go(&mut self) {
        if let Some((reader, _)) = self.reader.take() {
            reader.close().await;
        }
        self.keeper = Keeper::default();
    }

    async fn look(&mut self, publish: &watch::Sender<Arc<Seen>>) -> Result<(), String> {
        if Instant::now() < self.rest {
            return Ok(());
        }
        let (begun, spent) = (Instant::now(), cpu());
        let db = match &mut self.facts {
            None => self.path.clone(),
            Some(facts) => {
                facts.look().await.map_err(|e| chain(&e))?;
                facts.db().to_owned()
            }
        };
        let number = db.metadata().map(|m| m.ino()).map_err(|e| format!("{}: {e}", db.display()))?;
        if self.reader.as_ref().is_none_or(|(reader, known)| *known != number || !reader.is_current()) {
            self.let_go().await;
            self.reader = Some((Reader::open(&db).await.map_err(|e| chain(&e))?, number));
            self.version = -1;
            self.looks.begin(&db).await;
            self.seen.db = db;
        }
        let (reader, _) = self.reader.as_mut().expect("it was just opened");
        let version = reader.query::<Table>("PRAGMA data_version").await.map_err(|e| chain(&e))?;
        let version = version.rows[0][0].as_i64().unwrap_or(0);
        let ticks = self.seen.progress.run.is_some() && self.read.elapsed() > PROCESSES;
        if version == self.version && !ticks {
            return Ok(());
        }
        let first = self.seen.trials.rows.is_empty();
        let all = async {
            self.seen.progress = self.looks.look(reader).await?;
            self.seen.failures = reader.query(FAILED).await?;
            self.seen.runs = reader.query(RUNS).await?;
            self.seen.trouble = None;
            self.seen.generation += 1;
            if first {
                // what is known already need not wait for all trials
                self.seen.checked = Some(begun);
                publish.send_replace(Arc::new(self.seen.clone()));
            }
            self.seen.trials = self.keeper.look(reader).await?;
            self.seen.generation += u64::from(first);
            Ok::<_, StoreError>(())
        };
        all.await.map_err(|e| chain(&e))?;
        self.version = version;
        self.read = Instant::now();
        self.rest =
            self.read + REST.max(if first { REST } else { cpu().saturating_sub(spent) * REST_FACTOR });
        Ok(())
    }

    /// Begins to work out answers where more trials are done, and takes those that are worked out.
    async fn answers(&mut self) {
        if self.answering.as_ref().is_some_and(JoinHandle::is_finished)
            && let Some(answering) = self.answering.take()
        {
            match answering.await {
                Ok(Ok(answers)) => {
                    let rest = Duration::from_secs_f64(answers.seconds) * ANSWERS_FACTOR;
                    self.answered.1 = Instant::now() + rest;
                    self.seen.answers = Arc::new(answers);
                }
                Ok(Err(e)) => self.seen.trouble = Some(chain(&e)),
                Err(e) => self.seen.trouble = Some(format!("the answers could not be computed: {e}")),
            }
            self.seen.generation += 1;
        }
        let done = self.seen.progress.trials[1];
        if self.answering.is_none() && done != self.answered.0 && Instant::now() >= self.answered.1 {
            self.answered.0 = done;
            self.answering = Some(tokio::spawn(answer(self.seen.db.clone())));
        }
    }
}

/// CPU time of this process so far, to a hundredth of a second. Not the clock's: on a busy machine that says how busy it is.
fn cpu() -> Duration {
    Duration::from_secs_f64(cpu_seconds(std::process::id()).unwrap_or(0.0))
}

async fn answer(db: PathBuf) -> Result<Answers, StoreError> {
    let begun = Instant::now();
    let trials = Reader::asked(&db, async |reader| finished_trials(reader).await).await?;
    let work = move || {
        let terms = Terms::default();
        let drawn = match trials.len() <= MOST_DRAWN {
            true => vec![
                figures::pairs(&trials),
                brains::figure(&trials),
                figures::sensors(&trials, terms),
                figures::placed_sensors(&trials),
                figures::run_time(&trials),
            ],
            false => vec![figures::sensors(&trials, terms), figures::placed_sensors(&trials)],
        };
        let mut said = answers::answers(&trials, terms);
        let left = said.len().saturating_sub(MOST_SAID);
        said.truncate(MOST_SAID);
        Answers {
            of: trials.len(),
            said,
            left,
            figures: drawn.into_iter().flatten().collect(),
            seconds: begun.elapsed().as_secs_f64(),
        }
    };
    let worked = tokio::task::spawn_blocking(work).await;
    Ok(worked.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic())))
}

/// The last calls of `run`.
const RUNS: &str = "SELECT sweep, started_at, host, shard || ' of ' || shards AS shard, workers, threads, trials, done, failed,
  coalesce(outcome, '') AS outcome, round(estimated_seconds) AS estimated_seconds, round(seconds) AS seconds
FROM v_run ORDER BY started_at DESC LIMIT 12";
