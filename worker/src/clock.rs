//! The clock of all that is recorded and compared: CPU time, which other work on the machine does not change.

/// CPU time of this process so far, all threads (s).
#[must_use]
pub fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
