//! The clock of all recorded times: CPU time, which other processes on the machine do not change.

/// CPU time of this process, all threads (s).
pub fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
