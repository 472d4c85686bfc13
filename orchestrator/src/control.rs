//! Commands to a running sweep: one line per connection, through a Unix socket beside its database that only its user may open.
//!
//! ```text
//! results/two-core.sqlite.control     exists while the run lives; the next run removes that of a killed one
//! cancel 3f6a\n  →                    ← done cancelled: it ends after its step in progress
//! ```

use std::cell::RefCell;
use std::collections::HashSet;
use std::ffi::OsString;
use std::fmt;
use std::fs::{File, Permissions};
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::{Mutex, Semaphore, mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio::time::timeout;

use crate::analysis::view::View;
use crate::files;
use crate::plan::{Plan, counted};
use crate::scheduler::{SchedulerState, SteerAnswer, SteerRefusal};

/// Longest request and answer (bytes).
const LINE: u64 = 4 << 10;
const ANSWER: u64 = 64 << 10;
/// Time limit for receiving a request.
const ASKING: Duration = Duration::from_secs(5);
/// Time limit for an answer: a starting run may have a large sweep to record.
const ANSWERING: Duration = Duration::from_secs(60);
/// Simultaneous connections; further ones wait.
const CONNECTIONS: usize = 8;
/// Largest number of worker processes of a run.
pub const WORKERS_MAX: u32 = 1024;

/// A command, also of the command line. `Display` and `FromStr` convert to and from its line.
#[derive(Debug, Clone, PartialEq, Eq, clap::Subcommand)]
pub enum Command {
    /// Prints the state of the run: running, paused or stopping, busy workers, finished and pending trials
    State,
    /// Stops trials after their step in progress and starts none until `resume`; workers stay idle
    Pause,
    /// Resumes the run after a pause, each trial from its last step
    Resume,
    /// Ends the run cleanly, like one Ctrl-C; `run SPEC` resumes it
    Stop,
    /// Cancels a trial; a running trial ends after its step in progress. It is stored as failed (`cancelled`), also for
    /// later runs; `run SPEC --retry-failed` resumes it from its last step
    Cancel {
        /// Hash of the trial, or the beginning of it
        hash: String,
    },
    /// Gives a pending trial to the next free worker
    Next {
        /// Hash of the trial, or the beginning of it
        hash: String,
    },
    /// Changes the number of worker processes; surplus workers end when idle
    Workers {
        /// Number of worker processes, at least 1
        #[arg(value_parser = clap::value_parser!(u32).range(1..=i64::from(WORKERS_MAX)))]
        count: u32,
    },
    /// Reads the spec again and adds its new trials. Trials that the spec no longer contains stay; [run] is not read again;
    /// a spec with an error changes nothing
    Reload,
}

/// An unknown command.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown command {0:?}; expected one of: state, pause, resume, stop, cancel HASH, next HASH, workers N (1 … {WORKERS_MAX}), reload"
)]
pub struct NoCommand(String);

/// Commands of one word.
const WORDS: [(&str, Command); 5] = [
    ("state", Command::State),
    ("pause", Command::Pause),
    ("resume", Command::Resume),
    ("stop", Command::Stop),
    ("reload", Command::Reload),
];

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cancel { hash } => write!(f, "cancel {hash}"),
            Self::Next { hash } => write!(f, "next {hash}"),
            Self::Workers { count } => write!(f, "workers {count}"),
            word => f.write_str(WORDS.iter().find(|(_, known)| known == word).map_or("", |(word, _)| word)),
        }
    }
}

impl FromStr for Command {
    type Err = NoCommand;

    fn from_str(line: &str) -> Result<Self, NoCommand> {
        let hash = |text: &str| {
            text.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-').then(|| text.to_owned())
        };
        let words: Vec<&str> = line.split_whitespace().collect();
        let command = match words[..] {
            [word] => WORDS.into_iter().find(|(known, _)| *known == word).map(|(_, command)| command),
            ["cancel", text] => hash(text).map(|hash| Self::Cancel { hash }),
            ["next", text] => hash(text).map(|hash| Self::Next { hash }),
            ["workers", count] => {
                let count = count.parse::<u32>().ok().filter(|count| (1..=WORKERS_MAX).contains(count));
                count.map(|count| Self::Workers { count })
            }
            _ => None,
        };
        command.ok_or_else(|| NoCommand(line.chars().take(80).collect()))
    }
}

/// The answer of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// Whether the command was carried out; if not, nothing has changed.
    pub done: bool,
    /// Text for people.
    pub text: String,
}

impl Reply {
    /// A refusal with its reason: nothing has changed.
    pub fn refused(why: impl Into<String>) -> Self {
        Self { done: false, text: why.into() }
    }
}

impl fmt::Display for SteerAnswer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let back = |f: &mut fmt::Formatter<'_>, running: usize| match running {
            0 => f.write_str("no trial is running"),
            1 => f.write_str("1 running trial stops after its step in progress"),
            n => write!(f, "{n} running trials stop after their steps in progress"),
        };
        match self {
            Self::Paused(running) => {
                f.write_str("paused: ")?;
                back(f, *running)
            }
            Self::Resumed(waiting) => write!(f, "resumed; pending trials: {waiting}"),
            Self::Stopping(running, grace) => {
                f.write_str("stopping: ")?;
                back(f, *running)?;
                match running {
                    0 => Ok(()),
                    _ => write!(f, ", or ended after {} s", *grace as f64 / 1000.0),
                }
            }
            Self::Cancelled(false) => f.write_str("cancelled"),
            Self::Cancelled(true) => f.write_str("cancelled: it ends after its step in progress"),
            Self::Next(false) => f.write_str("starts on the next free worker"),
            Self::Next(true) => {
                f.write_str("starts on the next free worker when another trial has trained its body")
            }
            Self::Workers([before, after]) => write!(f, "workers: {before} before, {after} from now on"),
            Self::Added(count) => write!(f, "trials added: {count}"),
            Self::Refused(SteerRefusal::Stopping) => f.write_str("the run is stopping"),
            Self::Refused(SteerRefusal::Done) => f.write_str("the trial is done"),
            Self::Refused(SteerRefusal::Failed(reason)) => {
                write!(f, "the trial has already ended ({reason})")
            }
            Self::Refused(SteerRefusal::Running) => f.write_str("the trial is already running"),
        }
    }
}

/// Why a run gave no answer.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum ControlError {
    /// The database does not exist.
    #[error("no database: {}", db.display())]
    NoDatabase { db: PathBuf, source: io::Error },
    /// No run uses the database.
    #[error("{} is not used by a run; start one with `metasense run SPEC`", db.display())]
    NoRun { db: PathBuf },
    /// A process writes to the database, but has no socket.
    #[error(
        "{} is in use by a process that takes no commands: it is starting or stopping (try again in a few seconds), or could not create its \
         socket (see its log)",
        db.display()
    )]
    NotListening { db: PathBuf },
    /// The run does not answer.
    #[error(
        "the run of {} (process {pid}) does not answer; it may be busy, or stopped (Ctrl-Z, SIGSTOP): try again, or resume it \
         with kill -CONT {pid}",
        db.display()
    )]
    NoAnswer { db: PathBuf, pid: i32 },
    /// The socket failed.
    #[error("sending a command to the run of {}", db.display())]
    Io { db: PathBuf, source: io::Error },
}

/// A command that waits for its answer.
#[derive(Debug)]
pub struct Request {
    /// The command.
    pub command: Command,
    /// Takes the answer; closed if the client has disconnected.
    pub answer: oneshot::Sender<Reply>,
}

/// Receives commands for a run until it is dropped.
#[derive(Debug)]
pub struct Listener {
    file: PathBuf,
    task: JoinHandle<()>,
    requests: Mutex<mpsc::Receiver<Request>>,
}

impl Listener {
    /// Opens the socket of a database. The caller must hold the lock of the database for longer than the listener lives.
    ///
    /// # Errors
    /// If the file system has no sockets or the database's name is too long.
    pub fn new(db: &Path) -> io::Result<Self> {
        let (_folder, address, file) = address(db)?;
        // Left by a killed run: no one else can be listening, as this process holds the database.
        let _ = std::fs::remove_file(&file);
        let listener = UnixListener::bind(&address).map_err(|error| refused(&address, error))?;
        std::fs::set_permissions(&file, Permissions::from_mode(0o600))?;
        let (out, requests) = mpsc::channel(CONNECTIONS);
        let task = tokio::spawn(listen(listener, out));
        Ok(Self { file, task, requests: Mutex::new(requests) })
    }

    /// The next command.
    pub async fn next(&self) -> Option<Request> {
        self.requests.lock().await.recv().await
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.task.abort();
        let _ = std::fs::remove_file(&self.file);
    }
}

/// Longest socket address (bytes), without the final 0.
const LONGEST: usize = 107;

/// The socket of a database: its folder, its address, its file. An address has room for `LONGEST` bytes, so it names the folder
/// by its descriptor.
fn address(db: &Path) -> io::Result<(File, PathBuf, PathBuf)> {
    let db = db.canonicalize()?;
    let mut name = OsString::from(db.file_name().unwrap_or_default());
    name.push(".control");
    let file = db.with_file_name(&name);
    let folder = File::open(db.parent().unwrap_or(Path::new("/")))?;
    let address = Path::new("/proc/self/fd").join(folder.as_raw_fd().to_string()).join(name);
    Ok((folder, address, file))
}

/// If the database's name is too long for a socket, an error that says by how much.
fn refused(address: &Path, error: io::Error) -> io::Error {
    match address.as_os_str().len().saturating_sub(LONGEST) {
        0 => error,
        bytes => io::Error::other(format!("the name of the database is {bytes} bytes too long for a socket")),
    }
}

async fn listen(listener: UnixListener, out: mpsc::Sender<Request>) {
    let room = Arc::new(Semaphore::new(CONNECTIONS));
    let own = rustix::process::geteuid().as_raw();
    loop {
        let place = Arc::clone(&room).acquire_owned().await.expect("it is never closed");
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "accepting a connection failed");
                tokio::time::sleep(Duration::from_millis(100)).await;
                continue;
            }
        };
        // Checked again, as clients may have connected before the permissions were set.
        if stream.peer_cred().is_ok_and(|peer| peer.uid() == own || peer.uid() == 0) {
            let out = out.clone();
            tokio::spawn(async move {
                if let Err(error) = converse(stream, out).await {
                    tracing::debug!(%error, "a connection ended early");
                }
                drop(place);
            });
        }
    }
}

/// Reads a command and sends the answer. If the client disconnects before the run takes the command, it has no effect.
async fn converse(mut stream: UnixStream, out: mpsc::Sender<Request>) -> io::Result<()> {
    let (from, mut to) = stream.split();
    let mut from = BufReader::new(from.take(LINE));
    let mut line = String::new();
    if timeout(ASKING, from.read_line(&mut line)).await?? == 0 {
        return Ok(());
    }
    let said = match line.parse() {
        Err(error) => Reply::refused(NoCommand::to_string(&error)),
        Ok(command) => {
            let (answer, said) = oneshot::channel();
            let asked = async {
                let _ = out.send(Request { command, answer }).await;
                said.await.unwrap_or_else(|_| Reply::refused("the run has ended"))
            };
            let mut more = [0; 1];
            tokio::select! {
                said = asked => said,
                _ = from.read(&mut more) => return Ok(()),
            }
        }
    };
    let word = if said.done { "done" } else { "refused" };
    timeout(ASKING, to.write_all(format!("{word} {}", said.text).as_bytes())).await?
}

/// Process id of the run of a database, from the socket: works for a busy or stopped run, too.
pub async fn run_of(db: &Path) -> Option<u32> {
    let (_folder, address, _) = address(db).ok()?;
    let pid = UnixStream::connect(address).await.ok()?.peer_cred().ok()?.pid();
    pid.and_then(|pid| pid.try_into().ok())
}

/// Whether a process writes to a database. A run that starts at this moment retries its lock.
pub fn is_held(db: &Path) -> bool {
    File::open(db).is_ok_and(|file| files::is_held(&file))
}

/// Sends a command to the run of a database.
///
/// # Errors
/// If there is no run or it does not answer.
pub async fn ask(db: &Path, command: &Command) -> Result<Reply, ControlError> {
    ask_within(ANSWERING, db, command).await
}

async fn ask_within(limit: Duration, db: &Path, command: &Command) -> Result<Reply, ControlError> {
    let at = |source| ControlError::Io { db: db.to_owned(), source };
    let (_folder, address, _) =
        address(db).map_err(|source| ControlError::NoDatabase { db: db.to_owned(), source })?;
    let stream = UnixStream::connect(&address).await.map_err(|source| match source.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused => match is_held(db) {
            true => ControlError::NotListening { db: db.to_owned() },
            false => ControlError::NoRun { db: db.to_owned() },
        },
        _ => at(refused(&address, source)),
    })?;
    let pid = stream.peer_cred().ok().and_then(|peer| peer.pid());
    let answer = async {
        let (from, mut to) = stream.into_split();
        to.write_all(format!("{command}\n").as_bytes()).await?;
        let mut answer = String::new();
        from.take(ANSWER).read_to_string(&mut answer).await?;
        Ok::<_, io::Error>(answer)
    };
    let answer = timeout(limit, answer).await.map_err(|late| match pid {
        Some(pid) => ControlError::NoAnswer { db: db.to_owned(), pid },
        None => at(late.into()),
    })?;
    let answer = answer.map_err(at)?;
    match answer.split_once(' ') {
        Some(("done", text)) => Ok(Reply { done: true, text: text.to_owned() }),
        Some(("refused", text)) => Ok(Reply::refused(text)),
        _ => Err(at(io::Error::new(io::ErrorKind::UnexpectedEof, "it ended without a reply"))),
    }
}

/// Source of commands to a run.
pub struct Control {
    listener: Option<Listener>,
    /// Reads the spec again.
    pub(crate) reread: Arc<Reread>,
    /// Plans that were read during the run.
    pub(crate) plans: RefCell<Vec<Arc<Plan>>>,
}

/// Reads the spec again; the error is text for people.
pub type Reread = dyn Fn() -> Result<Plan, String> + Send + Sync;

impl Control {
    /// Takes commands from a listener, if any.
    pub fn new(listener: Option<Listener>, reread: Arc<Reread>) -> Self {
        Self { listener, reread, plans: RefCell::default() }
    }

    /// Takes no commands.
    pub fn none() -> Self {
        Self::new(None, Arc::new(|| Err("this run has no spec file".into())))
    }

    /// The last plan that was read, starting from `first`, with the trials of earlier plans that it lacks appended.
    pub fn last_plan(&self, first: Plan) -> Plan {
        self.plans.borrow().iter().fold(first, |earlier, later| {
            let own: HashSet<&str> = later.trials.iter().map(|trial| trial.hash.as_str()).collect();
            let gone = earlier.trials.into_iter().filter(|trial| !own.contains(trial.hash.as_str()));
            Plan { trials: later.trials.iter().cloned().chain(gone).collect(), ..Plan::clone(later) }
        })
    }

    pub(crate) async fn next(&self) -> Option<Request> {
        self.listener.as_ref()?.next().await
    }
}

impl fmt::Debug for Control {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Control").field("listener", &self.listener).finish_non_exhaustive()
    }
}

/// State of a run as text.
pub(crate) fn in_words(state: &SchedulerState, view: &View) -> String {
    let how = match (state.is_stopping(), state.is_paused()) {
        (true, _) => "stopping",
        (false, true) => "paused",
        (false, false) => "running",
    };
    let workers = counted(state.workers() as usize, "worker");
    let (busy, settled, waiting) = (state.busy(), view.settled(), state.waiting());
    format!(
        "{how}: {busy} of {workers} busy, {settled} of {} finished, {waiting} pending",
        counted(view.total, "trial")
    )
}

#[cfg(test)]
mod tests;
