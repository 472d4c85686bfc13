//! Runs shards on machines without a scheduler: one at a time per place, on this machine or by `ssh`, until all have run.
//!
//! An unreachable or unfit host gets no more shards; its shards go to other hosts. A stop is passed on to every shard: by
//! SIGTERM here, by Ctrl-C through the terminal that `ssh` opens on other hosts.

use std::collections::{HashMap, VecDeque};
use std::fs::OpenOptions;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use rustix::process::{Pid, Signal, kill_process, set_parent_process_death_signal};
use tokio::io::AsyncWriteExt;
use tokio::process::{Child, ChildStdin, Command};
use tokio::sync::watch;
use tokio::task::JoinSet;

use super::Shard;
use super::submit::line;
use crate::exit::Exit;
use crate::files::{self, host, quoted};
use crate::signals::Signals;

/// Most starts of a shard that dies or whose host becomes unreachable.
const MOST_TRIES: u32 = 3;
/// Exit code of a failed `ssh`, and of our script if the folder does not exist.
const UNREACHABLE: i32 = 255;
/// `ssh` disconnects after four such intervals without an answer (s).
const ALIVE_EVERY: u32 = 15;

/// A place for one shard at a time: a host; `None`: this machine.
pub type HostSlot = Option<String>;

/// How shards are started.
#[derive(Debug, Clone)]
pub struct LaunchConfig {
    /// Folder of the shards, with the script.
    pub folder: PathBuf,
    /// Number of shards of the sweep.
    pub shards: u32,
    /// Options for `ssh`.
    pub options: Vec<String>,
    /// Longest wait of a stopped shard for steps in progress (s).
    pub grace: f64,
}

/// Result of running shards.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct ShardsOutcome {
    /// Shards that are not finished.
    pub unfinished: Vec<u32>,
    /// Whether a stop was requested.
    pub asked: bool,
    /// Whether trials have failed.
    pub failed: bool,
    /// Whether no usable place is left.
    pub deserted: bool,
}

/// Parses a list of hosts, one per line with an optional number of simultaneous shards; `#` starts a comment.
///
/// # Errors
/// For the first invalid line.
pub fn places(text: &str) -> Result<Vec<HostSlot>, String> {
    let mut places = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let words: Vec<&str> = line.split('#').next().unwrap_or_default().split_whitespace().collect();
        let (host, count) = match words[..] {
            [] => continue,
            [host] => (host, Some(1)),
            [host, count] => (host, count.parse().ok().filter(|count| (1..=1024).contains(count))),
            _ => (words[0], None),
        };
        match count {
            Some(count) if !host.starts_with('-') => places.extend(vec![Some(host.to_owned()); count]),
            _ => {
                return Err(format!(
                    "{}: {line:?}: must be HOST, or HOST and its number of simultaneous shards",
                    number + 1
                ));
            }
        }
    }
    Ok(places)
}

/// Runs shards in these places; `say` receives messages for people.
pub async fn run(
    places: &[HostSlot],
    which: &[u32],
    how: &LaunchConfig,
    signals: &mut Signals,
    mut say: impl FnMut(String),
) -> ShardsOutcome {
    let mut free_slots: Vec<HostSlot> = places.iter().rev().cloned().collect();
    let mut waiting: VecDeque<u32> = which.iter().copied().collect();
    let (mut tries, mut lost) = (HashMap::<u32, u32>::new(), Vec::<HostSlot>::new());
    let (mut ended, mut running) = (ShardsOutcome::default(), JoinSet::new());
    let (ask, stop_receiver) = watch::channel(());
    loop {
        while !waiting.is_empty()
            && let Some(place) = free_slots.pop()
        {
            let shard = waiting.pop_front().expect("it is not empty");
            say(format!("shard {shard} starts on {}", name(&place)));
            *tries.entry(shard).or_default() += 1;
            running.spawn(run_shard(place, shard, how.clone(), stop_receiver.clone()));
        }
        match signals.or_signal(running.join_next()).await {
            None => {
                say(match ended.asked {
                    false => format!(
                        "stopping: steps that end within {} s are recorded, and databases are copied to the folder (press Ctrl-C again to stop at once)",
                        how.grace
                    ),
                    true => "stopping at once".into(),
                });
                ended.asked = true;
                ended.unfinished.extend(waiting.drain(..));
                let _ = ask.send(());
            }
            Some(None) => break,
            Some(Some(Err(bug))) => std::panic::resume_unwind(bug.into_panic()),
            Some(Some(Ok((place, shard, code, last_words)))) => {
                let verdict = Verdict::of(code, place.is_some());
                let dead = matches!(verdict, Verdict::Unfit | Verdict::Died);
                let last_words = if dead || verdict == Verdict::Refused { last_words } else { String::new() };
                say(format!("shard {shard} on {}: {}{last_words}", name(&place), verdict.words()));
                let again = !ended.asked && dead && tries[&shard] < MOST_TRIES;
                match verdict {
                    Verdict::Done => {}
                    Verdict::Failed => ended.failed = true,
                    _ if again => waiting.push_back(shard),
                    _ => ended.unfinished.push(shard),
                }
                if verdict == Verdict::Unfit {
                    lost.push(place.clone());
                    free_slots.retain(|free_slots| !lost.contains(free_slots));
                }
                if !lost.contains(&place) {
                    free_slots.push(place);
                }
            }
        }
    }
    ended.deserted = free_slots.is_empty();
    ended.unfinished.extend(waiting);
    ended.unfinished.sort_unstable();
    ended
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Done,
    Failed,
    Stopped,
    Refused,
    Unfit,
    Died,
}

impl Verdict {
    fn of(code: Option<i32>, is_remote: bool) -> Self {
        match code {
            Some(code) if code == Exit::Done as i32 => Self::Done,
            Some(code) if code == Exit::Failed as i32 => Self::Failed,
            Some(code) if code == Exit::Interrupted as i32 => Self::Stopped,
            Some(code) if [Exit::BadInput as i32, Exit::Io as i32].contains(&code) => Self::Refused,
            Some(code) if code == Exit::Unfit as i32 || is_remote && code == UNREACHABLE => Self::Unfit,
            _ => Self::Died,
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Done => "all trials are done",
            Self::Failed => "trials have failed",
            Self::Stopped => "stopped on request",
            Self::Refused => "it refused to run",
            Self::Unfit => {
                "the machine is unfit, is unreachable or cannot read the folder; it gets no more shards"
            }
            Self::Died => "it ended unexpectedly",
        }
    }
}

fn name(place: &HostSlot) -> String {
    place.clone().unwrap_or_else(host)
}

/// Runs a shard to its end. Returns its place and number, its exit code and its last message.
async fn run_shard(
    place: HostSlot,
    shard: u32,
    how: LaunchConfig,
    mut stop_requested: watch::Receiver<()>,
) -> (HostSlot, u32, Option<i32>, String) {
    let output =
        Shard::new(shard, how.shards).map_or(String::new(), |shard| format!("{}.out", shard.file_stem()));
    let outputs = [how.folder.join(output), log_file(&how.folder, &place)];
    let before = outputs.each_ref().map(|file| file.metadata().map_or(0, |file| file.len()));
    let status = match begin(&place, shard, &how) {
        Ok(mut child) => {
            // Taken out, because `wait` would close it; closing it does not stop the remote shard.
            let mut terminal = child.stdin.take();
            loop {
                tokio::select! {
                    status = child.wait() => break status.ok(),
                    Ok(()) = stop_requested.changed() => end(&child, terminal.as_mut()).await,
                }
            }
        }
        Err(error) => {
            let words = format!(": {error}");
            return (place, shard, Some(Exit::Io as i32), words);
        }
    };
    let said = outputs.iter().zip(before).find_map(|(file, before)| {
        let line = last_message(file, before).ok()??;
        Some(format!(": {line} ({})", file.display()))
    });
    let said = said.unwrap_or_else(|| format!("; {} is empty", outputs[0].display()));
    let how = status.map_or(String::new(), |status| format!(" ({status})"));
    (place, shard, status.and_then(|status| status.code()), how + &said)
}

/// Bytes at the end of an output in which the last message is searched.
const LAST: u64 = 2000;

/// The last error with its causes in a file after offset `before`, else the last non-empty line, if any.
fn last_message(file: &Path, before: u64) -> io::Result<Option<String>> {
    let mut file = std::fs::File::open(file)?;
    let from = before.max(file.metadata()?.len().saturating_sub(LAST));
    file.seek(SeekFrom::Start(from))?;
    let mut bytes = Vec::new();
    file.take(LAST).read_to_end(&mut bytes)?;
    let text = String::from_utf8_lossy(&bytes).replace(|c: char| c.is_control() && c != '\n', " ");
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let Some(error) = lines.iter().rposition(|line| line.starts_with("error:")) else {
        return Ok(lines.last().map(ToString::to_string));
    };
    let causes = lines[error + 1..].iter().take_while(|line| line.starts_with("because:"));
    Ok(Some(lines[error..=error + causes.count()].join(" ")))
}

fn begin(place: &HostSlot, shard: u32, how: &LaunchConfig) -> io::Result<Child> {
    let script = how.folder.join("shard.sh");
    let mut command = match place {
        None => {
            let mut command = Command::new("sh");
            command.arg(&script).arg(shard.to_string()).stdin(Stdio::null());
            // Also if this process is killed, its shards end in order. `exec` keeps the setting; unlike `--parent`, it
            // allows a prefix that starts the program as a child.
            // SAFETY: the closure makes one system call.
            unsafe {
                command.pre_exec(|| set_parent_process_death_signal(Some(Signal::TERM)).map_err(Into::into))
            };
            command
        }
        Some(host) => {
            let file = quoted(&script);
            let there = format!("[ -r {file} ] || exit {UNREACHABLE}; exec sh {file} {shard}");
            let mut command = Command::new("ssh");
            let alive = format!("ServerAliveInterval={ALIVE_EVERY}");
            command.args(["-tt", "-o", "BatchMode=yes", "-o", &alive, "-o", "ServerAliveCountMax=4"]);
            command.args(&how.options).args(["--", host, &format!("sh -c {}", line(&[there]))]);
            command.stdin(Stdio::piped());
            command
        }
    };
    let log = OpenOptions::new().create(true).append(true).open(log_file(&how.folder, place))?;
    // Its own process group: Ctrl-C reaches only this process, which passes it on once.
    command.process_group(0).stdout(log.try_clone()?).stderr(log).spawn()
}

/// Log of `ssh`, and of scripts that fail before they write to the shard's output.
fn log_file(folder: &Path, place: &HostSlot) -> PathBuf {
    folder.join(format!("{}.out", files::mark_of(&name(place))))
}

/// Stops a shard: by Ctrl-C through its terminal on another host, or by a signal here.
async fn end(child: &Child, terminal: Option<&mut ChildStdin>) {
    if let Some(terminal) = terminal {
        let _ = terminal.write_all(b"\x03").await;
        let _ = terminal.flush().await;
    } else if let Some(pid) = child.id().and_then(|pid| Pid::from_raw(pid.cast_signed())) {
        let _ = kill_process(pid, Signal::TERM);
    }
}

#[cfg(test)]
mod tests;
