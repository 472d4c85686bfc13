//! A Slurm cluster for tests: munge, a controller and two nodes on this machine, in a folder that is removed after the test.

use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The cluster; dropping it ends its jobs and daemons.
pub struct Slurm {
    folder: PathBuf,
    daemons: Vec<Child>,
}

/// Why there can be no cluster on this machine.
pub fn missing() -> Option<String> {
    let there = |name: &&str| {
        ["/usr/sbin", "/usr/bin", "/usr/local/sbin", "/usr/local/bin"]
            .iter()
            .any(|f| Path::new(f).join(name).exists())
    };
    if !rustix::process::geteuid().is_root() {
        return Some("its daemons need root".into());
    }
    let programs = ["munged", "slurmctld", "slurmd", "sbatch", "squeue", "scontrol"];
    let program = programs.into_iter().find(|name| !there(name))?;
    Some(format!("there is no {program}; Debian has it in slurm-wlm and munge"))
}

impl Slurm {
    /// Starts the cluster below `folder`, whose path must be short because it contains a socket.
    pub fn start(folder: &Path) -> Self {
        let at = |name: &str| folder.join(name).display().to_string();
        for name in ["state", "spool", "tmp"] {
            std::fs::create_dir_all(folder.join(name)).unwrap();
        }
        std::fs::write(at("munge.key"), [7; 128]).unwrap();
        std::fs::set_permissions(at("munge.key"), PermissionsExt::from_mode(0o600)).unwrap();
        let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap().trim().to_owned();
        let ports: Vec<u16> = (0..3)
            .map(|_| TcpListener::bind("127.0.0.1:0").unwrap())
            .collect::<Vec<_>>()
            .iter()
            .map(|socket| socket.local_addr().unwrap().port())
            .collect();
        let node = |i: usize| {
            format!(
                "NodeName=n{i} NodeHostname={host} NodeAddr=127.0.0.1 Port={} CPUs=1 RealMemory=2000",
                ports[i]
            )
        };
        let config = format!(
            "ClusterName=test\nSlurmctldHost={host}(127.0.0.1)\nSlurmctldPort={}\nSlurmUser=root\nSlurmdUser=root\n\
             AuthType=auth/munge\nAuthInfo=socket={}\nCredType=cred/munge\nStateSaveLocation={}\nSlurmdSpoolDir={}/%n\n\
             SlurmctldPidFile={}\nSlurmdPidFile={}/slurmd-%n.pid\nProctrackType=proctrack/linuxproc\n\
             TaskPlugin=task/none\nSelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\nReturnToService=2\n\
             MaxArraySize=3\nAccountingStorageType=accounting_storage/none\nJobAcctGatherType=jobacct_gather/none\nMpiDefault=none\n\
             SchedulerParameters=batch_sched_delay=0,sched_interval=1,bf_interval=1\n{}\n{}\n\
             PartitionName=main Nodes=n1,n2 Default=YES State=UP\n",
            ports[0],
            at("munge.socket"),
            at("state"),
            at("spool"),
            at("slurmctld.pid"),
            at("spool"),
            node(1),
            node(2),
        );
        std::fs::write(at("slurm.conf"), config).unwrap();
        let mut slurm = Self { folder: folder.to_owned(), daemons: Vec::new() };
        let munge = [("key-file", "munge.key"), ("socket", "munge.socket"), ("pid-file", "munged.pid")];
        let further = [("log-file", "munged.log"), ("seed-file", "munged.seed")];
        let mut options: Vec<String> =
            munge.iter().chain(&further).map(|(name, file)| format!("--{name}={}", at(file))).collect();
        options.extend(["--foreground".to_owned(), "--force".to_owned(), "--num-threads=1".to_owned()]);
        slurm.daemon("munged", &options);
        slurm.until("munged makes its socket", 10, || folder.join("munge.socket").exists());
        slurm.daemon("slurmctld", &["-D".into(), "-i".into()]);
        for name in ["n1", "n2"] {
            slurm.daemon("slurmd", &["-D".into(), "-N".into(), name.into()]);
        }
        slurm.until("both nodes are idle", 30, || {
            slurm.tool("sinfo", "-h -N -o %T").matches("idle").count() == 2
        });
        slurm
    }

    fn daemon(&mut self, name: &str, options: &[String]) {
        let log =
            std::fs::File::create(self.folder.join(format!("{name}-{}.log", self.daemons.len()))).unwrap();
        let mut command = self.command(name);
        command.args(options).stdin(Stdio::null()).stdout(log.try_clone().unwrap()).stderr(log);
        self.daemons.push(command.spawn().unwrap_or_else(|e| panic!("{name}: {e}")));
    }

    /// A program in the environment of this cluster; the nodes' own disk is the folder `tmp`.
    pub fn command(&self, program: impl AsRef<std::ffi::OsStr>) -> Command {
        let mut command = Command::new(program);
        let path = std::env::var("PATH").unwrap_or_default();
        command
            .env("SLURM_CONF", self.folder.join("slurm.conf"))
            .env("TMPDIR", self.folder.join("tmp"))
            .env("PATH", format!("{path}:/usr/sbin"));
        command
    }

    /// Output of one of Slurm's tools.
    pub fn tool(&self, name: &str, arguments: &str) -> String {
        let output = self.command(name).args(arguments.split_whitespace()).output().unwrap();
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    /// Waits for a condition; after the time limit, panics with the queue and the daemons' logs.
    pub fn until(&self, what: &str, seconds: u64, mut ask: impl FnMut() -> bool) {
        let began = Instant::now();
        while !ask() {
            if began.elapsed() > Duration::from_secs(seconds) {
                let logs = std::fs::read_dir(&self.folder).unwrap().flatten().map(|entry| entry.path());
                let logs = logs.filter(|path| path.extension().is_some_and(|e| e == "log"));
                let last = |path: PathBuf| {
                    let text = std::fs::read_to_string(&path).unwrap_or_default();
                    let lines: Vec<&str> = text.lines().rev().take(15).collect();
                    format!("{}:\n{}", path.display(), lines.into_iter().rev().collect::<Vec<_>>().join("\n"))
                };
                let logs: Vec<String> = logs.map(last).collect();
                panic!("not within {seconds} s: {what}\n{}\n{}", self.tool("squeue", ""), logs.join("\n"));
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Waits until no job is left: an empty answer, not a controller that does not answer.
    pub fn until_empty(&self, seconds: u64) {
        self.until("the queue is empty", seconds, || {
            let answer = self.command("squeue").arg("-h").output().unwrap();
            answer.status.success() && answer.stdout.trim_ascii().is_empty()
        });
    }
}

impl Drop for Slurm {
    fn drop(&mut self) {
        self.tool("scancel", "--signal=KILL --full --user=root");
        self.tool("scancel", "--user=root");
        for daemon in self.daemons.iter_mut().rev() {
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
    }
}
