//! A writer that does not block: output that the reader has not taken yet is held in memory, and beyond `MEMORY` in an unnamed
//! temporary file. A slow reader must not keep a database snapshot open, because the write-ahead log grows meanwhile.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::JoinHandle;

/// Largest number of bytes held in memory.
const MEMORY: usize = 4 << 20;
/// Bytes read back from the file at a time.
const PART: u64 = 1 << 16;

/// See the module. [`Spool::finish`] waits until the reader has everything.
#[derive(Debug)]
pub struct Spool {
    shared: Arc<Shared>,
    passing: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Waiting {
    /// Order: first `memory`, then the file from offset `taken` on.
    memory: VecDeque<Vec<u8>>,
    bytes: usize,
    file: Option<File>,
    taken: u64,
    written: u64,
    ended: bool,
    error: Option<io::Error>,
}

impl Shared {
    fn locked(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().expect("nobody panics with it")
    }
}

/// An error of the temporary file.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
struct FileError(io::Error);

fn of_file(error: io::Error) -> io::Error {
    io::Error::new(error.kind(), FileError(error))
}

/// Whether the temporary file has failed, not the output.
pub fn is_of_file(error: &io::Error) -> bool {
    error.get_ref().is_some_and(|error| error.is::<FileError>())
}

impl Spool {
    /// Starts a thread that writes to `out`.
    pub fn new(out: impl Write + Send + 'static) -> Self {
        let shared = Arc::new(Shared::default());
        let passing = Arc::clone(&shared);
        let passing = std::thread::spawn(move || {
            if let Err(error) = pass_on(&passing, out) {
                passing.locked().error = Some(error);
            }
        });
        Self { shared, passing: Some(passing) }
    }

    /// Waits until `out` has everything.
    ///
    /// # Errors
    /// If writing to `out` fails.
    pub fn finish(mut self) -> io::Result<()> {
        self.end();
        self.shared.locked().error.take().map_or(Ok(()), Err)
    }

    fn end(&mut self) {
        self.shared.locked().ended = true;
        self.shared.changed.notify_one();
        if let Some(passing) = self.passing.take() {
            passing.join().expect("it does not panic");
        }
    }
}

impl Drop for Spool {
    fn drop(&mut self) {
        self.end();
    }
}

impl Write for Spool {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut waiting = self.shared.locked();
        if let Some(error) = waiting.error.take() {
            return Err(error);
        }
        // While the file contains unread bytes, new ones must follow them there.
        if waiting.bytes + bytes.len() <= MEMORY && waiting.taken == waiting.written {
            waiting.bytes += bytes.len();
            waiting.memory.push_back(bytes.to_vec());
        } else {
            if waiting.file.is_none() {
                waiting.file = Some(tempfile::tempfile().map_err(of_file)?);
            }
            let at = waiting.written;
            waiting.file.as_ref().expect("it was just made").write_all_at(bytes, at).map_err(of_file)?;
            waiting.written += bytes.len() as u64;
        }
        drop(waiting);
        self.shared.changed.notify_one();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writes to `out` until the spool has ended and is empty.
fn pass_on(shared: &Shared, mut out: impl Write) -> io::Result<()> {
    loop {
        let mut waiting = shared.locked();
        let part = loop {
            if let Some(part) = waiting.memory.pop_front() {
                waiting.bytes -= part.len();
                break part;
            }
            if waiting.taken < waiting.written {
                let at = waiting.taken;
                let mut part = vec![0; (waiting.written - at).min(PART) as usize];
                let file = waiting.file.as_ref().expect("something was written to it");
                file.read_exact_at(&mut part, at).map_err(of_file)?;
                waiting.taken += part.len() as u64;
                if waiting.taken == waiting.written {
                    // Everything was read: free the disk space.
                    (waiting.file, waiting.taken, waiting.written) = (None, 0, 0);
                }
                break part;
            }
            if waiting.ended {
                drop(waiting);
                return out.flush();
            }
            waiting = shared.changed.wait(waiting).expect("nobody panics with it");
        };
        drop(waiting);
        out.write_all(&part)?;
    }
}

#[cfg(test)]
mod tests;
