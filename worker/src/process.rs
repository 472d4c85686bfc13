//! The worker process: receives jobs, runs them and sends their results.
//!
//! It ends with its orchestrator: the kernel kills it when that process dies, and the end of standard input ends it at once,
//! without cleanup, since the orchestrator removes the whole iceoryx2 domain. It ignores Ctrl-C and SIGTERM; the orchestrator
//! handles them and requests a stop.

use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use metasense_numerics::Heartbeat;
use metasense_schemas::reason::Reason;
use metasense_schemas::record::{Checkpoint, StepRecord, TrialResult};
use metasense_schemas::spec::TrialSpec;
use metasense_schemas::wire::{
    self, BackpressureStrategy, BeatSender, DomainEnd, Lease, LinkError, MessageReceiver, MessageSender,
    Services, Sleeper, ToOrchestrator, ToWorker, Waker, WorkerStart,
};
use rustix::process;

use crate::arrays::Arrays;
use crate::limits::{Needs, check, check_file_size, explained, tells_of_shortage};
use crate::run::{self, LoopControl, NoResult, ObserveTrial};
use crate::simd;

/// Exit code: the orchestrator has another build.
pub const OTHER_BUILD: i32 = 64;
/// Exit code: the orchestrator cannot be reached.
pub const NO_LINK: i32 = 65;
/// Exit code: the orchestrator ended before the worker started.
pub const ORPHAN: i32 = 66;
/// Exit code: shared memory is full.
pub const NO_ROOM: i32 = 67;
/// Exit code: a system limit is too low for any worker.
pub const SHORT: i32 = 68;

/// Least interval between two heartbeats.
const BEAT: Duration = Duration::from_millis(50);
/// Interval between checks of the computation's progress, during long calls.
const PULSE: Duration = Duration::from_millis(500);

/// Identifies this build: version and identity of the running executable.
pub fn build() -> String {
    let exe = std::fs::metadata("/proc/self/exe");
    let (inode, size, modified) =
        exe.map_or((0, 0, 0), |m| (m.ino(), m.size(), m.mtime_nsec() ^ (m.mtime() << 30)));
    format!("{}-{inode:x}-{size:x}-{modified:x}", env!("CARGO_PKG_VERSION"))
}

/// Prints to standard error; ignores failures.
fn complain(what: std::fmt::Arguments) {
    let _ = std::io::Write::write_fmt(&mut std::io::stderr(), format_args!("{what}\n"));
}

/// Makes glibc keep large freed blocks. A linear decoder of six sensors allocates 100 MB per step, whose pages the kernel would
/// clear again. This saves a sixth of such a trial's time on one thread and a third on two, for a third more memory.
pub fn keep_memory() {
    // SAFETY: sets parameters of the allocator only.
    #[cfg(target_env = "gnu")]
    unsafe {
        libc::mallopt(libc::M_MMAP_MAX, 0);
        libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
    }
}

/// Runs a job from a checkpoint, or from the start, on this many threads; the heartbeat counts its progress.
pub type Perform =
    fn(&str, Option<Checkpoint>, usize, Heartbeat, &mut dyn ObserveTrial) -> Result<TrialResult, NoResult>;

/// `Perform` for trials: the job is a `TrialSpec` as JSON.
///
/// # Errors
/// As `run_trial`.
pub fn perform_trial(
    job: &str,
    checkpoint: Option<Checkpoint>,
    threads: usize,
    heartbeat: Heartbeat,
    observer: &mut dyn ObserveTrial,
) -> Result<TrialResult, NoResult> {
    let trial: TrialSpec =
        serde_json::from_str(job).map_err(|error| NoResult::Rejected(error.to_string()))?;
    run::run_trial(&trial, checkpoint, &run::pool_counting(threads, heartbeat)?, observer)
}

/// Runs the hidden subcommand; `start` is a `wire::Start` as JSON. Returns the exit code.
pub fn run(start: &str, perform: Perform) -> i32 {
    let start: WorkerStart = match serde_json::from_str(start) {
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
/// If the system cannot start a thread.
fn bind_to_parent(start: &WorkerStart) -> std::io::Result<()> {
    // Failures of these calls are ignored: the trial can still run.
    let _ = process::set_parent_process_death_signal(Some(process::Signal::KILL));
    for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP, libc::SIGXFSZ] {
        // SAFETY: SIG_IGN installs no handler, and no other thread of this process exists yet.
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
        // SAFETY: ends the process without destructors, as intended during a computation.
        unsafe { libc::_exit(0) }
    };
    std::thread::Builder::new().stack_size(64 << 10).spawn(until_closed).map(drop)
}

/// The worker's ports. Ports are dropped before the node.
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
    fn connect(start: &WorkerStart, perform: Perform) -> Result<Self, LinkError> {
        let services = Services::new(&start.root, &start.prefix, DomainEnd::Worker)?;
        let worker = Self {
            perform,
            down: Services::receiver(&services.down)?,
            sleeper: Services::sleeper(&services.wake_worker)?,
            up: Services::sender(&services.up, BackpressureStrategy::DiscardData)?,
            arrays: Services::sender(&services.arrays, BackpressureStrategy::RetryUntilDelivered)?,
            beats: Services::beat_sender(&services.progress)?,
            waker: Services::waker(&services.wake_orchestrator)?,
            services,
        };
        worker.send(&ToOrchestrator::Hello { build: build(), pid: std::process::id() })?;
        Ok(worker)
    }

    /// Sends a message and wakes the orchestrator. Waits while its buffer is full; if it never reads again, this process ends
    /// too.
    fn send(&self, message: &ToOrchestrator) -> Result<(), LinkError> {
        let bytes = wire::encode(message);
        check_shared_memory(bytes.len())?;
        patiently(|| Ok(wire::send(&self.up, &bytes)?.then_some(())))?;
        // If the wake-up fails, the orchestrator still polls.
        let _ = self.waker.notify();
        Ok(())
    }

    /// Receives jobs until the process ends.
    fn serve(&mut self) -> Result<(), LinkError> {
        let _keep_open = &self.services;
        name_process(IDLE);
        let mut unwanted = None;
        loop {
            match wire::receive::<ToWorker>(&self.down)? {
                Some(ToWorker::Job { lease, .. }) if unwanted == Some(lease) => {
                    self.send(&ToOrchestrator::Stopped(lease))?;
                }
                // An earlier attempt reached the pause step before the orchestrator knew.
                Some(ToWorker::Job { lease, checkpoint: Some(done), pause: Some(step), .. })
                    if done.step >= step =>
                {
                    self.send(&ToOrchestrator::Stopped(lease))?;
                }
                Some(ToWorker::Job { lease, work, checkpoint, threads, pause, hash }) => {
                    name_process(&hash);
                    self.perform(lease, &work, checkpoint.map(|boxed| *boxed), threads as usize, pause)?;
                    name_process(IDLE);
                }
                Some(ToWorker::Stop(lease)) => unwanted = Some(lease),
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
        let mut reporter = Reporter {
            worker: self,
            lease,
            pause,
            beats: &beats,
            last_beat: None,
            stop: false,
            link_error: None,
        };
        let perform = || (self.perform)(work, checkpoint, threads, heartbeat, &mut reporter);
        let done = AtomicBool::new(false);
        let ended = std::thread::scope(|scope| {
            let beats = std::thread::Builder::new()
                .stack_size(64 << 10)
                .spawn_scoped(scope, || beats.while_work_is_done(&done));
            let ended = std::panic::catch_unwind(AssertUnwindSafe(perform));
            done.store(true, Ordering::Release);
            // Without this thread there are fewer heartbeats.
            if let Ok(beats) = beats {
                beats.thread().unpark();
            }
            ended
        });
        if let Some(error) = reporter.link_error {
            return Err(error);
        }
        let failed = |reason, detail: String| ToOrchestrator::Failed(lease, reason, detail);
        let message = match ended {
            Ok(Ok(result)) => self.finished(lease, result)?,
            Ok(Err(NoResult::Stopped)) => ToOrchestrator::Stopped(lease),
            Ok(Err(NoResult::Shortage(detail))) => failed(Reason::Shortage, detail),
            Ok(Err(NoResult::Rejected(detail))) if tells_of_shortage(&detail) => {
                failed(Reason::Shortage, explained(&detail, &Needs::default()))
            }
            Ok(Err(NoResult::Rejected(detail))) => failed(Reason::Rejected, detail),
            Ok(Err(NoResult::Body { fault, detail })) => failed(Reason::Body(fault), detail),
            Ok(Err(NoResult::Numerical { cause, detail })) => failed(Reason::Numerical(cause), detail),
            Err(panic) => {
                let text = panic.downcast_ref::<&str>().map(ToString::to_string);
                let text = text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
                let reason = if tells_of_shortage(&text) { Reason::Shortage } else { Reason::Panicked };
                failed(reason, text)
            }
        };
        self.send(&message)
    }

    /// Writes the arrays of a result into shared memory.
    fn finished(&self, lease: Lease, mut result: TrialResult) -> Result<ToOrchestrator, LinkError> {
        let arrays = Arrays::of(&mut result, wire::INLINE_LIMIT);
        if !arrays.is_empty() {
            self.send_arrays(&arrays)?;
        }
        Ok(ToOrchestrator::Finished(lease, Box::new(result), arrays.heads()))
    }

    /// Loans a chunk, writes the arrays into it and sends it. Waits while the orchestrator holds all its chunks.
    fn send_arrays(&self, arrays: &Arrays) -> Result<(), LinkError> {
        check_shared_memory(arrays.len())?;
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

/// Repeats `ask` with growing pauses until it returns a value.
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

/// Process name of a worker without a trial.
pub const IDLE: &str = "idle";

/// Sets the name of this process, for `top` and `metasense watch`; the kernel keeps 15 bytes.
fn name_process(name: &str) {
    if let Ok(name) = std::ffi::CString::new(name) {
        let _ = rustix::thread::set_name(&name);
    }
}

/// `LinkError::step` if shared memory is full.
pub const MAKING_ROOM: &str = "making room";
/// `LinkError::step` if the limit on file sizes is too low.
pub const FILE_SIZE: &str = "enlarging a file";

/// Checks that `bytes` fit into shared memory. Writing to full shared memory would kill this process.
///
/// # Errors
/// If they do not fit, with a margin.
pub fn check_shared_memory(bytes: usize) -> Result<(), LinkError> {
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

/// Heartbeat of an attempt.
struct Beats<'a> {
    sender: &'a BeatSender,
    lease: Lease,
    /// Progress counter of the computation.
    heartbeat: Heartbeat,
}

impl Beats<'_> {
    fn send(&self) {
        // A lost beat does no harm.
        let _ = self.sender.send_copy(self.lease);
    }

    /// Sends beats while the computation progresses, until `done`.
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

/// Connects a trial to the orchestrator.
struct Reporter<'a> {
    worker: &'a Worker,
    lease: Lease,
    /// Outer step after which the trial pauses.
    pause: Option<u32>,
    beats: &'a Beats<'a>,
    last_beat: Option<Instant>,
    stop: bool,
    link_error: Option<LinkError>,
}

impl Reporter<'_> {
    /// Sends a message, then checks for a stop request.
    fn tell(&mut self, message: &ToOrchestrator) {
        match self.worker.send(message) {
            Ok(()) => self.listen(),
            Err(error) => self.link_error = Some(error),
        }
    }

    fn listen(&mut self) {
        match wire::receive::<ToWorker>(&self.worker.down) {
            Ok(Some(ToWorker::Stop(lease))) => self.stop |= lease == self.lease,
            Ok(_) => {}
            Err(error) => self.link_error = Some(error),
        }
    }

    fn current_control(&self) -> LoopControl {
        if self.stop || self.link_error.is_some() { LoopControl::Stop } else { LoopControl::Continue }
    }
}

impl ObserveTrial for Reporter<'_> {
    fn progress(&mut self) -> LoopControl {
        if self.last_beat.is_none_or(|at| at.elapsed() >= BEAT) {
            self.last_beat = Some(Instant::now());
            self.beats.send();
            self.listen();
        }
        self.current_control()
    }

    fn step(&mut self, record: StepRecord, checkpoint: Checkpoint) -> LoopControl {
        let (record, checkpoint) = (Box::new(record), Box::new(checkpoint));
        self.stop |= self.pause.is_some_and(|step| checkpoint.step >= step);
        self.tell(&ToOrchestrator::Step(self.lease, record, checkpoint));
        self.current_control()
    }

    fn save(&mut self, checkpoint: Checkpoint) {
        self.tell(&ToOrchestrator::Saved(self.lease, Box::new(checkpoint)));
    }
}
