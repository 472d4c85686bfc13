//! Processes to watch and kill, and queries of their databases.

use std::path::Path;
use std::time::{Duration, Instant};

use metasense::reader::Reader;
use rustix::process::{Pid, Signal, kill_process};

pub fn kill(pid: u32, signal: i32) {
    let (pid, signal) = (Pid::from_raw(pid as i32).unwrap(), Signal::from_named_raw(signal).unwrap());
    let _ = kill_process(pid, signal);
}

/// Living child processes of a process.
pub fn children(parent: u32) -> Vec<u32> {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let pids = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    pids.filter(|pid| parent_and_state(*pid).is_some_and(|(p, state)| p == parent && state != 'Z')).collect()
}

pub fn is_alive(pid: u32) -> bool {
    parent_and_state(pid).is_some_and(|(_, state)| state != 'Z')
}

fn parent_and_state(pid: u32) -> Option<(u32, char)> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let mut fields = stat.rsplit_once(") ")?.1.split(' ');
    let state = fields.next()?.chars().next()?;
    Some((fields.next()?.parse().ok()?, state))
}

/// Repeats `ask` until it returns a value or the time is over.
pub fn eventually<T>(within: Duration, mut ask: impl FnMut() -> Option<T>) -> Option<T> {
    let began = Instant::now();
    loop {
        match ask() {
            Some(answer) => return Some(answer),
            None if began.elapsed() > within => return None,
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    }
}

/// Rows of a query, each as JSON text.
pub fn rows(db: &Path, sql: &str) -> Vec<String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut reader = Reader::open(db).await.unwrap();
        let table = reader.query::<metasense::look::Table>(sql).await.unwrap();
        table.rows.iter().map(|row| serde_json::to_string(row).unwrap()).collect()
    })
}
