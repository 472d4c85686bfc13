//! The worker process: takes a job, runs it and sends its result. It never decides anything.
//!
//! It lives as long as its orchestrator: the kernel kills it when that dies, and the end of its standard input ends
//! it at once, in the middle of whatever it does. Nothing needs to be put in order then, since the orchestrator removes
//! the whole iceoryx2 domain. Ctrl-C and SIGTERM are the orchestrator's business, which asks for a stop.

use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use metasense_numerics::Heartbeat;
use metasense_schemas::record::{Checkpoint, StepRecord, TrialResult};
use metasense_schemas::spec::TrialSpec;
use metasense_schemas::wire::{
    self, BeatSender, End, Lease, LinkError, MessageReceiver, MessageSender, Progress, Services, Sleeper,
    Start, ToOrchestrator, ToWorker, Trouble, Waker,
};
use rustix::process;

use crate::arrays::Arrays;
use crate::limits::{Needs, check, check_file_size, explained, tells_of_shortage};
use crate::run::{self, Control, Failure, Observe};
use crate::simd;

/// Exit code of a worker whose orchestrator is another build.
pub const OTHER_BUILD: i32 = 64;
/// Exit code of a worker that cannot reach its orchestrator.
pub const NO_LINK: i32 = 65;
/// Exit code of a worker whose orchestrator was gone before it came up.
pub const ORPHAN: i32 = 66;
/// Exit code of a worker that finds no room in shared memory.
pub const NO_ROOM: i32 = 67;
/// Exit code of a worker that the machine does not allow what every worker needs.
pub const SHORT: i32 = 68;

/// Shortest time between two beats.
const BEAT: Duration = Duration::from_millis(50);
/// Time between two looks at what the maths has done, where it does not return for long.
const PULSE: Duration = Duration::from_millis(500);

/// Names this build: version, and the identity of the executable that runs.
pub fn build() -> String {
    let exe = std::fs::metadata("/proc/self/exe");
    let (inode, size, modified) =
        exe.map_or((0, 0, 0), |m| (m.ino(), m.size(), m.mtime_nsec() ^ (m.mtime() << 30)));
    format!("{}-{inode:x}-{size:x}-{modified:x}", env!("CARGO_PKG_VERSION"))
}

/// On standard error, if anybody reads that.
fn complain(what: std::fmt::Arguments) {
    let _ = std::io::Write::write_fmt(&mut std::io::stderr(), format_args!("{what}\n"));
}

/// Has glibc keep large pieces of memory that are freed: a linear brain of six sensors takes 100 MB a step anew, which the system
/// would clear page by page. A sixth of such a trial's time on one thread, a third on two, for a third more memory.
pub fn keep_memory() {
    // SAFETY: sets limits of the allocator.
    #[cfg(target_env = "gnu")]
    unsafe {
        libc::mallopt(libc::M_MMAP_MAX, 0);
        libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
    }
}

/// Does the work of a job, from a checkpoint or from the start, on so many threads; counts what it has done.
pub type Perform =
    fn(&str, Option<Checkpoint>, usize, Heartbeat, &mut dyn Observe) -> Result<TrialResult, Failure>;

/// `Perform` for trials: the job is a `TrialSpec` as JSON.
///
/// # Errors
/// As `run_trial`.
pub fn perform_trial(
    job: &str,
    checkpoint: Option<Checkpoint>,
    threads: usize,
    heartbeat: Heartbeat,
    observer: &mut dyn Observe,
) -> Result<TrialResult, Failure> {
    let trial: TrialSpec = serde_json::from_str(job).map_err(|error| Failure::Rejected(error.to_string()))?;
    run::run_trial(&trial, checkpoint, &run::pool_counting(threads, heartbeat)?, observer)
}

/// The hidden subcommand: `start` is a `wire::Start` as JSON. Returns the exit code.
pub fn run(start: &str, perform: Perform) -> i32 {
    let start: Start = match serde_json::from_str(start) {
        Ok(start) => start,
        Err(error) => {
            complain(format_args!("worker: this subcommand is for the orchestrator alone: {error}"));
            return OTHER_BUILD;
        }
    };
    if start.build != build() {
        complain(format_args!("worker: the orchestrator is build {}, this is {}", start.build, build()));
        return OTHER_BUILD;
    }
    if let Err(error) = simd::choose(&start.simd) {
        complain(format_args!("worker: {error}"));
        return OTHER_BUILD;
    }
    if let Err(error) = bind_to_parent(&start) {
        complain(format_args!("worker: {}", explained(&error.to_string(), &Needs::default())));
        return SHORT;
    }
    if std::os::unix::process::parent_id() != start.parent {
        return ORPHAN;
    }
    match Worker::connect(&start, perform).and_then(|mut worker| worker.serve()) {
        Ok(()) => 0,
        Err(error) => {
            let short = check(&Needs::default());
            complain(format_args!("worker: {}", explained(&error.to_string(), &Needs::default())));
            match error.step {
                MAKING_ROOM => NO_ROOM,
                _ if error.step == FILE_SIZE || short.is_err() => SHORT,
                _ => NO_LINK,
            }
        }
    }
}

/// Ties the process to its orchestrator and sets its limits.
///
/// # Errors
/// If the system starts no thread.
fn bind_to_parent(start: &Start) -> std::io::Result<()> {
    // What the kernel refuses is not worth a trial.
    let _ = process::set_parent_process_death_signal(Some(process::Signal::KILL));
    for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP, libc::SIGXFSZ] {
        // SAFETY: no handler runs, and no other thread of this process exists yet.
        unsafe { libc::signal(signal, libc::SIG_IGN) };
    }
    if start.niceness != 0 {
        let _ = process::setpriority_process(None, start.niceness);
    }
    if let Some(mib) = start.memory_mib {
        let bytes = Some(mib.saturating_mul(1 << 20));
        let limit = process::Rlimit { current: bytes, maximum: bytes };
        let _ = process::setrlimit(process::Resource::Data, limit);
    }
    let until_closed = || {
        let mut sink = [0; 64];
        while std::io::stdin().read(&mut sink).is_ok_and(|n| n > 0) {}
        // SAFETY: ends the process without running destructors, which is the point: computations are in progress.
        unsafe { libc::_exit(0) }
    };
    std::thread::Builder::new().stack_size(64 << 10).spawn(until_closed).map(drop)
}

/// The worker's end of its domain. Ports are dropped before the node.
struct Worker {
    perform: Perform,
    up: MessageSender,
    arrays: MessageSender,
    beats: BeatSender,
    waker: Waker,
    down: MessageReceiver,
    sleeper: Sleeper,
    services: Services,
}

impl Worker {
    fn connect(start: &Start, perform: Perform) -> Result<Self, LinkError> {
        iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Fatal);
        let config =
            wire::config(&start.root, &start.prefix).map_err(LinkError::of("reading the domain's name"))?;
        let node = wire::node(&config)?;
        let services = Services::new(&node, End::Worker)?;
        let worker = Self {
            perform,
            down: Services::receiver(&services.down)?,
            sleeper: Services::sleeper(&services.wake_worker)?,
            up: Services::sender(&services.up)?,
            arrays: Services::array_sender(&services.arrays)?,
            beats: Services::beat_sender(&services.progress)?,
            waker: Services::waker(&services.wake_orchestrator)?,
            services,
        };
        worker.send(&ToOrchestrator::Hello { build: build(), pid: std::process::id() })?;
        Ok(worker)
    }

    /// Sends and wakes the orchestrator. Waits while its buffer is full: if it never reads again, this process ends too.
    fn send(&self, message: &ToOrchestrator) -> Result<(), LinkError> {
        let bytes = wire::encode(message);
        make_room(bytes.len())?;
        patiently(|| Ok(wire::send(&self.up, &bytes)?.then_some(())))?;
        // A wake-up that fails is made good by the orchestrator's own polling.
        let _ = self.waker.notify();
        Ok(())
    }

    /// Takes jobs for as long as the process lives.
    fn serve(&mut self) -> Result<(), LinkError> {
        let _keep_open = &self.services;
        name_process(IDLE);
        let mut unwanted = None;
        loop {
            match wire::receive::<ToWorker>(&self.down)? {
                Some(ToWorker::Job { lease, .. }) if unwanted == Some(lease) => {
                    self.send(&ToOrchestrator::Stopped { lease })?;
                }
                // what another attempt has done before its end was heard
                Some(ToWorker::Job { lease, checkpoint: Some(done), pause: Some(step), .. })
                    if done.step >= step =>
                {
                    self.send(&ToOrchestrator::Stopped { lease })?;
                }
                Some(ToWorker::Job { lease, work, checkpoint, threads, pause, hash }) => {
                    name_process(&hash);
                    self.perform(lease, &work, checkpoint.map(|boxed| *boxed), threads as usize, pause)?;
                    name_process(IDLE);
                }
                Some(ToWorker::Stop { lease }) => unwanted = Some(lease),
                None => wire::sleep(&self.sleeper, "waiting for a job")?,
            }
        }
    }

    fn perform(
        &self,
        lease: Lease,
        work: &str,
        checkpoint: Option<Checkpoint>,
        threads: usize,
        pause: Option<u32>,
    ) -> Result<(), LinkError> {
        let heartbeat = Heartbeat::default();
        let beats = Beats { sender: &self.beats, lease, heartbeat: heartbeat.clone() };
        let mut reporter =
            Reporter { worker: self, lease, pause, beats: &beats, beaten: None, stop: false, broken: None };
        let perform = || (self.perform)(work, checkpoint, threads, heartbeat, &mut reporter);
        let done = AtomicBool::new(false);
        let ended = std::thread::scope(|scope| {
            let beats = std::thread::Builder::new()
                .stack_size(64 << 10)
                .spawn_scoped(scope, || beats.while_work_is_done(&done));
            let ended = std::panic::catch_unwind(AssertUnwindSafe(perform));
            done.store(true, Ordering::Release);
            // Without the thread there are fewer beats.
            if let Ok(beats) = beats {
                beats.thread().unpark();
            }
            ended
        });
        if let Some(error) = reporter.broken {
            return Err(error);
        }
        let failed = |trouble, detail: String| ToOrchestrator::Failed { lease, trouble, detail };
        let message = match ended {
            Ok(Ok(result)) => self.finished(lease, result)?,
            Ok(Err(Failure::Stopped)) => ToOrchestrator::Stopped { lease },
            Ok(Err(Failure::Shortage(detail))) => failed(Trouble::Shortage, detail),
            Ok(Err(Failure::Rejected(detail))) if tells_of_shortage(&detail) => {
                failed(Trouble::Shortage, explained(&detail, &Needs::default()))
            }
            Ok(Err(Failure::Rejected(detail))) => failed(Trouble::Rejected, detail),
            Ok(Err(Failure::Numerical { cause, detail })) => failed(Trouble::Numerical(cause), detail),
            Err(panic) => {
                let text = panic.downcast_ref::<&str>().map(ToString::to_string);
                let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
                let trouble = if tells_of_shortage(&text) { Trouble::Shortage } else { Trouble::Panicked };
                failed(trouble, text)
            }
        };
        self.send(&message)
    }

    /// Puts the arrays of a result into shared memory, where they are written once.
    fn finished(&self, lease: Lease, mut result: TrialResult) -> Result<ToOrchestrator, LinkError> {
        let arrays = Arrays::of(&mut result, wire::APART);
        if !arrays.is_empty() {
            self.send_arrays(&arrays)?;
        }
        Ok(ToOrchestrator::Finished { lease, result: Box::new(result), arrays: arrays.heads() })
    }

    /// Loans a chunk, writes the arrays into it, and sends it; waits while the orchestrator holds all it may hold.
    fn send_arrays(&self, arrays: &Arrays) -> Result<(), LinkError> {
        make_room(arrays.len())?;
        let mut chunk = patiently(|| match self.arrays.loan_slice_uninit(arrays.len()) {
            Ok(chunk) => Ok(Some(chunk)),
            Err(iceoryx2::port::LoanError::OutOfMemory) => Ok(None),
            Err(error) => Err(LinkError::of("loaning an array")(error)),
        })?;
        arrays.write(chunk.payload_mut());
        // SAFETY: every byte has been written.
        let chunk = unsafe { chunk.assume_init() };
        chunk.send().map_err(LinkError::of("sending an array"))?;
        Ok(())
    }
}

/// Asks again, after longer and longer pauses, until there is something.
fn patiently<T>(mut ask: impl FnMut() -> Result<Option<T>, LinkError>) -> Result<T, LinkError> {
    let mut pause = Duration::from_micros(50);
    loop {
        if let Some(found) = ask()? {
            return Ok(found);
        }
        std::thread::sleep(pause);
        pause = (2 * pause).min(Duration::from_millis(10));
    }
}

/// Name of a process that has no trial.
pub const IDLE: &str = "idle";

/// Names this process as `top` shows it, and as `metasense watch` reads it: the kernel keeps fifteen bytes.
fn name_process(name: &str) {
    if let Ok(name) = std::ffi::CString::new(name) {
        let _ = rustix::thread::set_name(&name);
    }
}

/// What a `LinkError` says it tried where shared memory is full.
pub const MAKING_ROOM: &str = "making room";
/// And where files there may not be as large.
pub const FILE_SIZE: &str = "enlarging a file";

/// Whether so many bytes fit into shared memory: writing to a full one would be the end of this process.
///
/// # Errors
/// If they do not, or hardly.
pub fn make_room(bytes: usize) -> Result<(), LinkError> {
    check_file_size(wire::segment(bytes))
        .map_err(|short| LinkError { step: FILE_SIZE, cause: short.to_string() })?;
    const SPARE: u64 = 256 << 10;
    let needed = bytes as u64 + SPARE;
    match free_space(std::path::Path::new(wire::SHARED_MEMORY)) {
        Some(free) if free < needed => {
            let cause =
                format!("{} KiB free in {}, {} KiB needed", free >> 10, wire::SHARED_MEMORY, needed >> 10);
            Err(LinkError { step: MAKING_ROOM, cause })
        }
        _ => Ok(()),
    }
}

/// Free bytes of a file system, for this user.
pub fn free_space(path: &std::path::Path) -> Option<u64> {
    rustix::fs::statvfs(path).ok().map(|stat| stat.f_bavail * stat.f_frsize)
}

/// The heartbeat of an attempt.
struct Beats<'a> {
    sender: &'a BeatSender,
    lease: Lease,
    /// Of the maths.
    heartbeat: Heartbeat,
}

impl Beats<'_> {
    fn send(&self) {
        let Lease { trial, attempt } = self.lease;
        // A beat may be lost.
        let _ = self.sender.send_copy(Progress { trial, attempt });
    }

    /// Beats as long as the maths comes further, until `done`.
    fn while_work_is_done(&self, done: &AtomicBool) {
        let mut seen = self.heartbeat.count();
        while !done.load(Ordering::Acquire) {
            std::thread::park_timeout(PULSE);
            let before = std::mem::replace(&mut seen, self.heartbeat.count());
            if seen != before {
                self.send();
            }
        }
    }
}

/// What a trial sees of the outside.
struct Reporter<'a> {
    worker: &'a Worker,
    lease: Lease,
    /// The outer step after which no more is wanted.
    pause: Option<u32>,
    beats: &'a Beats<'a>,
    beaten: Option<Instant>,
    stop: bool,
    broken: Option<LinkError>,
}

impl Reporter<'_> {
    /// Sends, and hears whether a stop is wanted.
    fn tell(&mut self, message: &ToOrchestrator) {
        match self.worker.send(message) {
            Ok(()) => self.listen(),
            Err(error) => self.broken = Some(error),
        }
    }

    fn listen(&mut self) {
        match wire::receive::<ToWorker>(&self.worker.down) {
            Ok(Some(ToWorker::Stop { lease })) => self.stop |= lease == self.lease,
            Ok(_) => {}
            Err(error) => self.broken = Some(error),
        }
    }

    fn wanted(&self) -> Control {
        if self.stop || self.broken.is_some() { Control::Stop } else { Control::Continue }
    }
}

impl Observe for Reporter<'_> {
    fn progress(&mut self) -> Control {
        if self.beaten.is_none_or(|at| at.elapsed() >= BEAT) {
            self.beaten = Some(Instant::now());
            self.beats.send();
            self.listen();
        }
        self.wanted()
    }

    fn step(&mut self, record: StepRecord, checkpoint: Checkpoint) -> Control {
        let (record, checkpoint) = (Box::new(record), Box::new(checkpoint));
        self.stop |= self.pause.is_some_and(|step| checkpoint.step >= step);
        self.tell(&ToOrchestrator::Step { lease: self.lease, record, checkpoint });
        self.wanted()
    }

    fn save(&mut self, checkpoint: Checkpoint) {
        self.tell(&ToOrchestrator::Saved { lease: self.lease, checkpoint: Box::new(checkpoint) });
    }
}
