//! The pages of a run: `serve --control` on its database in a separate process with its own niceness, so that viewers neither slow
//! nor block the run.

use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, Command};

use super::Error;

/// Maximum time to wait for the address of the pages.
const BEGINNING: Duration = Duration::from_secs(20);
/// Maximum time to wait for the end of the process.
const ENDING: Duration = Duration::from_secs(6);

/// The process that serves the pages; dropping this value kills it.
#[derive(Debug)]
pub(super) struct Pages(Child);

impl Pages {
    /// Serves the pages of a database and prints their address.
    ///
    /// # Errors
    /// If the port cannot be used.
    pub async fn start(db: &Path, port: u16) -> Result<Self, Error> {
        let failed = Error::io("serving the pages of", db);
        let own = std::process::id();
        let mut child = Command::new("/proc/self/exe")
            .args(["serve", "--control", "--listen", &port.to_string(), "--parent", &own.to_string()])
            .arg("--")
            .arg(db)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .map_err(&failed)?;
        let mut address = String::new();
        let out = child.stdout.take().expect("it is piped");
        let mut out = BufReader::new(out);
        let said = tokio::time::timeout(BEGINNING, out.read_line(&mut address)).await;
        said.unwrap_or_else(|_| Err(std::io::ErrorKind::TimedOut.into())).map_err(&failed)?;
        if address.is_empty() {
            // the process has printed the reason
            return usage!(
                "port {port} cannot be used: pass another with --serve=PORT, or --serve=0 for any free port"
            );
        }
        say!("pages, during the run (everyone who has the address can control the run): {}", address.trim());
        Ok(Self(child))
    }

    /// Ends the process with SIGTERM, so that it leaves no file beside the database.
    pub async fn end(mut self) {
        if let Some(pid) = self.0.id().and_then(|pid| Pid::from_raw(pid as i32)) {
            let _ = kill_process(pid, Signal::TERM);
        }
        let _ = tokio::time::timeout(ENDING, self.0.wait()).await;
    }
}
