//! A database, or the facts of a folder of shards, read while somebody watches. Each state is published whole: pages show the last
//! one without waiting for the database.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::{Notify, watch};
use tokio::task::JoinHandle;

use super::trials::{Keeper, Trials};
use crate::analysis::DecisionTerms;
use crate::cluster::facts::Facts;
use crate::exit::chain;
use crate::look::{Answer, Figure, Table};
use crate::processes::cpu_seconds;
use crate::progress::{FAILED, Observer, Progress};
use crate::reader::Reader;
use crate::report::load::finished_trials;
use crate::report::{answers, brains, figures};
use crate::store::StoreError;

/// Time between two checks for changes.
const POLL: Duration = Duration::from_millis(100);
/// Minimum time between two reads, also as a multiple of the CPU time of the last read.
const REST: Duration = Duration::from_millis(300);
const REST_FACTOR: u32 = 30;
/// Time between two reads if only a run's processes change.
const PROCESSES: Duration = Duration::from_secs(5);
/// Maximum time that a page waits for a read; later states arrive as updates.
const PATIENCE: Duration = Duration::from_millis(700);
/// Maximum time to wait for a read at the end.
const ENDING: Duration = Duration::from_secs(5);
/// Answers are computed again after this multiple of their computing time.
const ANSWERS_FACTOR: u32 = 50;
/// Maximum number of answers on a page; there is one per setting.
const MOST_SAID: usize = 60;
/// Maximum number of trials for figures with one mark per trial.
const MOST_DRAWN: usize = 2000;

/// The known state of a database.
#[derive(Debug, Clone, Default)]
pub struct DatabaseState {
    /// Number of changes.
    pub generation: u64,
    /// Time of the last check.
    pub checked: Option<Instant>,
    /// The database; for shards, that of their facts once it exists.
    pub db: PathBuf,
    /// Why the database could not be read.
    pub read_error: Option<String>,
    /// Its progress.
    pub progress: Progress,
    /// Failures by reason and message, with one of their trials.
    pub failures: Table,
    /// The last calls of `run`.
    pub runs: Table,
    /// All trials; empty before the first read.
    pub trials: Trials,
    /// Answers from the trials.
    pub answers: Arc<Answers>,
}

/// Answers from finished trials.
#[derive(Debug, Clone, Default)]
pub struct Answers {
    /// Number of trials.
    pub trial_count: usize,
    /// The first answers.
    pub said: Vec<Answer>,
    /// Number of further answers.
    pub left: usize,
    /// Figures.
    pub figures: Vec<Figure>,
    /// Computing time (s).
    pub seconds: f64,
}

/// A database that can be watched.
#[derive(Debug)]
pub struct WatchedDatabase {
    /// Its name.
    pub name: String,
    /// The file, if a run can hold it.
    pub db: Option<PathBuf>,
    seen: watch::Receiver<Arc<DatabaseState>>,
    wanted: Arc<Notify>,
    stop: Arc<Notify>,
}

impl WatchedDatabase {
    /// Starts to watch a database, or a folder of shards.
    ///
    /// # Errors
    /// If no folder for the facts of shards can be created.
    pub fn new(path: &Path) -> std::io::Result<Self> {
        let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
        let facts = path.is_dir().then(|| Facts::for_folder(path)).transpose()?;
        let (publish, seen) = watch::channel(Arc::new(DatabaseState::default()));
        let wanted = Arc::new(Notify::new());
        let watcher = Watcher {
            path: path.to_owned(),
            facts,
            reader: None,
            version: -1,
            looks: Observer::default(),
            keeper: Keeper::default(),
            seen: DatabaseState::default(),
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

    /// Stops watching.
    pub async fn close(&self) {
        self.stop.notify_one();
        let mut seen = self.seen.clone();
        seen.mark_unchanged();
        let ended = async { while seen.changed().await.is_ok() {} };
        let _ = tokio::time::timeout(ENDING, ended).await;
    }

    /// Requests a check, and returns a receiver of later states; a slow receiver gets only the last.
    pub fn watched(&self) -> watch::Receiver<Arc<DatabaseState>> {
        let seen = self.seen.clone();
        self.wanted.notify_one();
        seen
    }

    /// The state now, or an earlier one if the read takes long.
    pub async fn current_state(&self) -> Arc<DatabaseState> {
        let asked = Instant::now();
        let mut seen = self.watched();
        let fresh = |seen: &Arc<DatabaseState>| seen.checked.is_some_and(|checked| checked >= asked);
        let _ = tokio::time::timeout(PATIENCE, seen.wait_for(fresh)).await;
        seen.borrow().clone()
    }
}

/// Reads one database.
struct Watcher {
    path: PathBuf,
    facts: Option<Facts>,
    /// With the inode of the file.
    reader: Option<(Reader, u64)>,
    version: i64,
    looks: Observer,
    keeper: Keeper,
    seen: DatabaseState,
    rest: Instant,
    read: Instant,
    answering: Option<JoinHandle<Result<Answers, StoreError>>>,
    /// Number of finished trials at the last answers, and when answers may be computed again.
    answered: (u64, Instant),
}

impl Watcher {
    async fn watch(
        mut self,
        publish: watch::Sender<Arc<DatabaseState>>,
        wanted: Arc<Notify>,
        stop: Arc<Notify>,
    ) {
        loop {
            // The source itself has one receiver.
            let unwatched = publish.receiver_count() == 1;
            tokio::select! {
                () = stop.notified() => break,
                () = wanted.notified() => {}
                () = tokio::time::sleep(POLL), if !unwatched => {}
            }
            let checked = Instant::now();
            if let Err(trouble) = self.look(&publish).await {
                self.let_go().await;
                if self.seen.read_error.as_ref() != Some(&trouble) {
                    self.seen.read_error = Some(trouble);
                    self.seen.generation += 1;
                }
            }
            self.answers().await;
            self.seen.checked = Some(checked);
            publish.send_replace(Arc::new(self.seen.clone()));
        }
        self.let_go().await;
    }

    /// Closes the file and forgets its trials: another file may replace it.
    async fn let_go(&mut self) {
        if let Some((reader, _)) = self.reader.take() {
            reader.close().await;
        }
        self.keeper = Keeper::default();
    }

    async fn look(&mut self, publish: &watch::Sender<Arc<DatabaseState>>) -> Result<(), String> {
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
            self.seen.read_error = None;
            self.seen.generation += 1;
            if first {
                // publishes progress before all trials have been read
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

    /// Takes computed answers, and starts to compute answers if more trials are done.
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
                Ok(Err(e)) => self.seen.read_error = Some(chain(&e)),
                Err(e) => self.seen.read_error = Some(format!("the answers could not be computed: {e}")),
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

/// CPU time of this process, to 0.01 s. Wall time would measure the load of the machine.
fn cpu() -> Duration {
    Duration::from_secs_f64(cpu_seconds(std::process::id()).unwrap_or(0.0))
}

async fn answer(db: PathBuf) -> Result<Answers, StoreError> {
    let begun = Instant::now();
    let trials = Reader::with_reader(&db, async |reader| finished_trials(reader).await).await?;
    let work = move || {
        let terms = DecisionTerms::default();
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
        let (figures, seconds) = (drawn.into_iter().flatten().collect(), begun.elapsed().as_secs_f64());
        Answers { trial_count: trials.len(), said, left, figures, seconds }
    };
    let worked = tokio::task::spawn_blocking(work).await;
    Ok(worked.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic())))
}

/// The last calls of `run`.
const RUNS: &str = "SELECT sweep, started_at, host, shard || ' of ' || shards AS shard, workers, threads, trials, done, failed,
  coalesce(outcome, '') AS outcome, round(estimated_seconds) AS estimated_seconds, round(seconds) AS seconds
FROM v_run ORDER BY started_at DESC LIMIT 12";
