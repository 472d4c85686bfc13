//! Shards on machines without a scheduler, over a real `sshd` on loopback: an unreachable host, a clean stop of all shards, and
//! resuming.
//!
//! Skipped without `sshd` and `ssh` (Debian: openssh-server).

use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::common::processes::{eventually, kill};
use crate::common::skip;
use crate::common::{Bench, TINY, results};

/// The daemon; dropping it ends it.
struct Sshd(Child);

impl Drop for Sshd {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Sshd {
    /// Starts the daemon and writes `ssh.conf`, in which hosts `a` and `b` are this machine and `gone` does not exist.
    fn start(bench: &Bench) -> Option<Self> {
        let program =
            ["/usr/sbin/sshd", "/usr/local/sbin/sshd"].into_iter().find(|path| Path::new(path).exists());
        let client = Command::new("ssh").arg("-V").stderr(Stdio::null()).status();
        let (Some(program), Ok(_)) = (program, client) else {
            skip::skipped("shards by ssh", "there is no sshd or no ssh; Debian has them in openssh-server");
            return None;
        };
        let _ = std::fs::create_dir("/run/sshd"); // root's sshd needs it
        for key in ["host", "user"] {
            let key = bench.path(key).display().to_string();
            let made =
                Command::new("ssh-keygen").args(["-q", "-t", "ed25519", "-N", "", "-f", &key]).status();
            assert!(made.unwrap().success());
        }
        std::fs::copy(bench.path("user.pub"), bench.path("authorized")).unwrap();
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let at = |name: &str| bench.path(name).display().to_string();
        let config = format!(
            "Port {port}\nListenAddress 127.0.0.1\nHostKey {}\nAuthorizedKeysFile {}\nPidFile none\nUsePAM no\n\
             StrictModes no\nPermitRootLogin yes\n",
            at("host"),
            at("authorized")
        );
        let config = bench.file("sshd.conf", &config);
        let common =
            format!("IdentityFile {}\nStrictHostKeyChecking no\nUserKnownHostsFile /dev/null\n", at("user"));
        let here = format!("HostName 127.0.0.1\nPort {port}\n");
        bench.file(
            "ssh.conf",
            &format!("Host a b\n{here}Host gone\nHostName 127.0.0.1\nPort 1\nHost *\n{common}"),
        );
        let log = std::fs::File::create(bench.path("sshd.log")).unwrap();
        let mut command = Command::new(program);
        command.args(["-D", "-e", "-f"]).arg(config).stdin(Stdio::null()).stderr(log).stdout(Stdio::null());
        let sshd = Self(command.spawn().unwrap());
        let answers = || {
            let mut ssh = Command::new("ssh");
            ssh.args(["-F", &at("ssh.conf"), "-o", "BatchMode=yes", "a", "true"]).stderr(Stdio::null());
            ssh.status().unwrap().success().then_some(())
        };
        let said = || std::fs::read_to_string(bench.path("sshd.log")).unwrap_or_default();
        eventually(Duration::from_secs(20), answers)
            .unwrap_or_else(|| panic!("sshd does not answer: {}", said()));
        Some(sshd)
    }
}

#[test]
fn shards_by_ssh_are_the_sweep() {
    let bench = Bench::new();
    let Some(_sshd) = Sshd::start(&bench) else { return };
    let text = TINY.replace("iterations = 4\n", "iterations = 150\n") + "seeds = [1, 2]\n";
    bench.file("tiny.toml", &text);
    bench.output(&["run", "tiny.toml", "--db", "whole.sqlite"]);
    bench.file("hosts", "gone\na\nb 1 # as many as it has room for\n");
    std::fs::create_dir(bench.path("tmp")).unwrap();
    let scratch = format!("env TMPDIR={}", bench.path("tmp").display());
    let submit = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_metasense"));
        command.args([
            "cluster",
            "submit",
            "ssh",
            "tiny.toml",
            "--hosts",
            "hosts",
            "--shards",
            "2",
            "--cpus",
            "1",
        ]);
        command.args(["--prefix", &scratch, "--", "-F"]).arg(bench.path("ssh.conf"));
        command.current_dir(bench.path("")).stderr(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap()
    };
    let said = |child: Child| {
        let output = child.wait_with_output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let log = |i: u32| bench.path(&format!("results/tiny.shards/shard-{i}-of-2.log"));
    let begun = |i| std::fs::read_to_string(log(i)).unwrap_or_default().contains("worker started");

    // Both shards run, one of them after `gone` failed; Ctrl-C reaches them on their hosts.
    let first = submit();
    eventually(Duration::from_secs(60), || (begun(1) && begun(2)).then_some(())).expect("both shards begin");
    kill(first.id(), libc::SIGTERM);
    let (code, message) = said(first);
    assert_eq!(code, Some(4), "{message}");
    assert!(message.contains("on gone: the machine is unfit, is unreachable"), "{message}");
    assert!(message.contains("left: shards 1-2") && message.contains("stopped on request"), "{message}");
    let outcomes = "SELECT DISTINCT outcome FROM v_run";
    let outcomes = bench.output(&["query", "results/tiny.sqlite", outcomes, "--format", "csv"]);
    assert_eq!(outcomes, "outcome\ninterrupted\n");

    let (code, message) = said(submit());
    assert_eq!(code, Some(0), "{message}");
    assert_eq!(results(&bench, "results/tiny.sqlite"), results(&bench, "whole.sqlite"));
    assert_eq!(bench.path("tmp").read_dir().unwrap().count(), 0, "nothing is left on the machines");

    // No host is reachable: nothing is lost, and the exit code shows it.
    bench.file("hosts", "gone\n");
    bench.file("tiny.toml", &(text + "\n").replace("seeds = [1, 2]", "seeds = [1, 2, 3]"));
    let (code, message) = said(submit());
    assert_eq!(code, Some(5), "{message}");
}
