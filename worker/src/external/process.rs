//! The process of an external body: start, calls, end.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use metasense_numerics::Heartbeat;
use metasense_numerics::trial::BodyFailure;
use metasense_schemas::reason::BodyFault;
use metasense_schemas::spec::Description;
use rustix::fs::{MemfdFlags, memfd_create};
use serde_json::{Value, json};

/// Last lines of standard error in a message.
const LINES: usize = 20;
/// Interval between heartbeats during a call.
const PULSE: Duration = Duration::from_millis(500);
/// Time for a process to end after it has closed its output.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// A named array that a call reads.
pub(super) struct Array<'a> {
    name: &'static str,
    shape: Vec<usize>,
    values: &'a [f64],
}

impl<'a> Array<'a> {
    pub(super) fn new(name: &'static str, shape: &[usize], values: &'a [f64]) -> Self {
        Self { name, shape: shape.to_vec(), values }
    }
}

/// A running process.
pub(super) struct Process {
    command: Vec<String>,
    child: Child,
    input: ChildStdin,
    lines: Receiver<String>,
    errors: Arc<Mutex<VecDeque<String>>>,
    /// Shared memory; the process inherits its descriptor.
    memory: File,
    bytes: u64,
    /// The process's description, with the digest.
    pub(super) description: Description,
}

impl Process {
    /// Returns `kept` if it runs this command; otherwise replaces it by a new process.
    pub(super) fn of<'a>(
        kept: &'a mut Option<Self>,
        command: &[String],
        limit: Duration,
    ) -> Result<&'a mut Self, BodyFailure> {
        let usable =
            |process: &mut Self| process.command == command && matches!(process.child.try_wait(), Ok(None));
        if !kept.as_mut().is_some_and(usable) {
            *kept = None; // ends the old process first
            *kept = Some(Self::start(command, limit)?);
        }
        Ok(kept.as_mut().expect("it has just been put there"))
    }

    fn start(command: &[String], limit: Duration) -> Result<Self, BodyFailure> {
        let wrong = |what: String| BodyFailure {
            name: BodyFault::Died.name(),
            detail: format!("{}: {what}", command.join(" ")),
        };
        let Some((program, arguments)) = command.split_first() else {
            return Err(wrong("names no program".to_owned()));
        };
        // without CLOEXEC: the process opens the memory by its descriptor's number
        let memory = memfd_create("metasense-body", MemfdFlags::empty());
        let memory = File::from(memory.map_err(|e| wrong(format!("no shared memory: {e}")))?);
        let piped = || Stdio::piped();
        let mut started = Command::new(program);
        started.args(arguments).stdin(piped()).stdout(piped()).stderr(piped());
        let mut child = started.spawn().map_err(|e| wrong(format!("cannot be started: {e}")))?;
        let (input, output) = (child.stdin.take().expect("piped"), child.stdout.take().expect("piped"));
        let (sender, lines) = channel();
        let (errors, said) = (Arc::new(Mutex::new(VecDeque::new())), child.stderr.take().expect("piped"));
        let kept = Arc::clone(&errors);
        std::thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        std::thread::spawn(move || {
            for line in BufReader::new(said).split(b'\n').map_while(Result::ok) {
                let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                kept.push_back(String::from_utf8_lossy(&line).into_owned());
                let surplus = kept.len().saturating_sub(LINES);
                kept.drain(..surplus);
            }
        });
        let (command, description) = (command.to_vec(), Description::default());
        let mut process = Self { command, child, input, lines, errors, memory, bytes: 0, description };
        let answer = process.exchange(&json!({ "call": "describe" }), limit, &Heartbeat::default())?;
        let description: Description = serde_json::from_value(answer)
            .map_err(|e| process.fault(BodyFault::Invalid, &format!("its answer to `describe`: {e}")))?;
        process.description = Description { digest: process.digest(&description)?, ..description };
        Ok(process)
    }

    /// Digest of the description and of the command's text files.
    fn digest(&self, description: &Description) -> Result<String, BodyFailure> {
        let mut digest = blake3::Hasher::new();
        digest.update(serde_json::to_string(description).expect("it is JSON").as_bytes());
        for file in self.command.iter().map(Path::new).filter(|file| file.is_file()) {
            let bytes = std::fs::read(file)
                .map_err(|e| self.fault(BodyFault::Died, &format!("reading {}: {e}", file.display())))?;
            // skips binaries: the interpreter's file differs between machines
            if std::str::from_utf8(&bytes).is_ok() {
                digest.update(blake3::hash(&bytes).as_bytes());
            }
        }
        Ok(digest.finalize().to_hex()[..32].to_owned())
    }

    /// Returns the answer and the output array `name`; none if `name` is empty.
    pub(super) fn call(
        &mut self,
        request: &Value,
        arrays: &[Array],
        (name, shape): (&str, &[usize]),
        limit: Duration,
        heartbeat: &Heartbeat,
    ) -> Result<(Value, Vec<f64>), BodyFailure> {
        let (mut request, mut end) = (request.clone(), 0);
        let mut place = |name: &str, shape: &[usize]| {
            request[name] = json!([&[end][..], shape].concat());
            let next = end + shape.iter().product::<usize>();
            std::mem::replace(&mut end, next)
        };
        let places: Vec<usize> = arrays.iter().map(|array| place(array.name, &array.shape)).collect();
        let output = if name.is_empty() { 0 } else { place(name, shape) };
        self.provide(8 * end as u64)
            .map_err(|e| self.fault(BodyFault::Died, &format!("shared memory: {e}")))?;
        for (array, place) in arrays.iter().zip(places) {
            let written = self.memory.write_all_at(bytemuck::cast_slice(array.values), 8 * place as u64);
            written.map_err(|e| self.fault(BodyFault::Died, &format!("shared memory: {e}")))?;
        }
        request["memory"] = json!(format!("/proc/self/fd/{}", self.memory.as_raw_fd()));
        request["bytes"] = json!(self.bytes);
        let answer = self.exchange(&request, limit, heartbeat)?;
        if name.is_empty() {
            return Ok((answer, Vec::new()));
        }
        if answer["shape"] != json!(shape) {
            let call = request["call"].as_str().unwrap_or_default();
            let what =
                format!("its answer to `{call}` has \"shape\" {}: {name} must be {shape:?}", answer["shape"]);
            return Err(self.fault(BodyFault::Invalid, &what));
        }
        let mut values = vec![0.0; shape.iter().product()];
        let read = self.memory.read_exact_at(bytemuck::cast_slice_mut(&mut values), 8 * output as u64);
        read.map_err(|e| self.fault(BodyFault::Died, &format!("shared memory: {e}")))?;
        Ok((answer, values))
    }

    /// Grows the memory to at least `bytes`.
    fn provide(&mut self, bytes: u64) -> std::io::Result<()> {
        if bytes > self.bytes {
            let bytes = bytes.next_power_of_two();
            self.memory.set_len(bytes)?;
            self.bytes = bytes;
        }
        Ok(())
    }

    /// Sends a request and waits for the answer.
    fn exchange(
        &mut self,
        request: &Value,
        limit: Duration,
        heartbeat: &Heartbeat,
    ) -> Result<Value, BodyFailure> {
        let sent = writeln!(self.input, "{request}").and_then(|()| self.input.flush());
        if sent.is_err() {
            return Err(self.died());
        }
        let end = Instant::now() + limit;
        let line = loop {
            let left = end.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left.min(PULSE)) {
                Ok(line) => break line,
                Err(RecvTimeoutError::Timeout) if left > Duration::ZERO => heartbeat.beat(),
                Err(RecvTimeoutError::Timeout) => {
                    let call = request["call"].as_str().unwrap_or_default();
                    let what =
                        format!("`{call}` took longer than body.time_limit = {} s", limit.as_secs_f64());
                    let _ = self.child.kill();
                    return Err(self.fault(BodyFault::TimeLimit, &what));
                }
                Err(RecvTimeoutError::Disconnected) => return Err(self.died()),
            }
        };
        let answer: Value = serde_json::from_str(&line).map_err(|_| {
            let what = format!("printed \"{line}\"; standard output is for answers in JSON alone");
            self.fault(BodyFault::Invalid, &what)
        })?;
        match answer.get("error") {
            Some(error) => {
                Err(self.fault(BodyFault::Invalid, error.as_str().unwrap_or("an error without text")))
            }
            None => Ok(answer),
        }
    }

    fn died(&mut self) -> BodyFailure {
        let end = Instant::now() + LAST_WORDS;
        let status = loop {
            match self.child.try_wait() {
                Ok(Some(status)) => {
                    std::thread::sleep(Duration::from_millis(50)); // the threads read its last lines
                    break status.to_string();
                }
                _ if Instant::now() > end => break "it closed its standard output".to_owned(),
                _ => std::thread::sleep(Duration::from_millis(5)),
            }
        };
        self.fault(BodyFault::Died, &format!("the process ended: {status}"))
    }

    /// A fault with the last lines of standard error.
    fn fault(&self, fault: BodyFault, what: &str) -> BodyFailure {
        let lines = self.errors.lock().unwrap_or_else(PoisonError::into_inner);
        let mut detail = format!("{}: {what}", self.command.join(" "));
        lines.iter().for_each(|line| detail += &format!("\n  {line}"));
        BodyFailure { name: fault.name(), detail }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
