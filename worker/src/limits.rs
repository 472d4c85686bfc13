//! System limits of this process and user: threads, file descriptors, memory, file sizes, shared memory, disks.
//!
//! A limit that is too low is reported with its value, the use, the need and a remedy, before the first worker starts or when a
//! worker meets the limit. Needs are those of every trial; `demands::memory` checks those of single trials.

use std::fs;
use std::path::{Path, PathBuf};

use metasense_schemas::wire::SHARED_MEMORY;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use crate::process::free_space;

/// File descriptors per worker in the orchestrator, and in a worker; both with a margin.
const DESCRIPTORS: [u64; 2] = [48, 72];
/// Threads of a worker besides computing ones; threads of the orchestrator per worker.
const THREADS: [u64; 2] = [3, 1];
/// Stack of a thread (bytes), the standard library's default.
const STACK: u64 = 2 << 20;
/// Least memory of a worker (bytes).
const MEMORY: u64 = 64 << 20;
/// Address space and data that a worker needs beyond those of this process, without stacks (bytes).
const SPACE: [u64; 2] = [64 << 20, 32 << 20];
/// Address space and data that any command needs (bytes).
const START: [u64; 2] = [32 << 20, 16 << 20];
/// File descriptors that any command needs.
const START_DESCRIPTORS: u64 = 8;
/// Least free shared memory per worker (bytes): chunks for messages and some arrays.
const SPACE_PER_WORKER: u64 = 16 << 20;
/// Files per worker in shared memory.
const SHARED_FILES: u64 = 80;
/// Least limit on file sizes, and least free space on the disk of each file (bytes).
const FILE: u64 = 8 << 20;
/// Files beside a database: WAL, journal and temporary files.
const FILES: u64 = 8;
/// Least stack of the main thread, and the value to which it is raised if possible (bytes).
const MAIN_STACK: [u64; 2] = [2 << 20, 8 << 20];

/// A limit that is too low, its use and the additional need.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}; {remedy}", self.fact())]
pub struct Shortage {
    what: String,
    most: u64,
    used: u64,
    needed: u64,
    /// Whether these are sizes (bytes), not counts.
    bytes: bool,
    remedy: &'static str,
}

impl Shortage {
    /// `None` if the limit allows the need.
    fn if_short(self) -> Option<Self> {
        (self.needed > 0 && self.used.saturating_add(self.needed) > self.most).then_some(self)
    }

    /// Message without the remedy.
    fn fact(&self) -> String {
        let amount = |n: u64| match self.bytes {
            false => n.to_string(),
            true if n < 1 << 20 => format!("{} KiB", n.div_ceil(1 << 10)),
            true => format!("{} MiB", n >> 20),
        };
        let [most, used, needed] = [self.most, self.used, self.needed].map(amount);
        format!("{}: {most}, {used} in use, {needed} needed", self.what)
    }
}

/// Resources that are needed in addition to those in use.
#[derive(Debug, Clone, Copy, Default)]
pub struct Needs<'a> {
    /// Number of worker processes; 0: needs of this process.
    pub workers: u32,
    /// Computing threads per worker; without workers: of this process.
    pub threads: u32,
    /// Files that will be written; they need not exist.
    pub files: &'a [&'a Path],
}

/// Checks the needs against all limits.
///
/// # Errors
/// The first limit that is too low.
pub fn check(needs: &Needs) -> Result<(), Shortage> {
    let (workers, threads) = (u64::from(needs.workers), u64::from(needs.threads));
    let most_threads = threads.max(workers) + THREADS[0];
    let started = match workers {
        0 => threads,
        _ => workers * (threads + THREADS.iter().sum::<u64>()),
    };
    let (shared, in_worker) = (Path::new(SHARED_MEMORY), DESCRIPTORS[1] * workers.min(1));
    let mut short = vec![
        user_threads(started),
        cgroup_tasks(started),
        machine_threads(started),
        descriptors(if workers == 0 { 4 } else { workers * DESCRIPTORS[0] + 8 }),
        resource(Resource::Nofile, "descriptors of a worker (`ulimit -n`)", 0, in_worker, false),
        memory(workers * MEMORY),
        cgroup_memory(workers * MEMORY),
        space(shared, workers * SPACE_PER_WORKER, SHARED_SPACE),
        inodes(shared, workers * SHARED_FILES, SHARED_SPACE),
    ];
    short.extend(memory_of_process(SPACE.map(|spare| workers.min(1) * (spare + most_threads * STACK))));
    for file in needs.files {
        let size = fs::metadata(file).map_or(0, |file| file.len());
        let what = format!("size of a file (`ulimit -f`), here of {}", file.display());
        short.push(resource(Resource::Fsize, &what, size, FILE, true));
        let folder = existing(file);
        short.extend([space(&folder, FILE, ON_DISK), inodes(&folder, FILES, ON_DISK)]);
    }
    short.into_iter().flatten().next().map_or(Ok(()), Err)
}

/// Checks the limit on file sizes.
///
/// # Errors
/// The limit, if it is below `bytes`.
pub fn check_file_size(bytes: u64) -> Result<(), Shortage> {
    resource(Resource::Fsize, "size of a file (`ulimit -f`)", 0, bytes, true).map_or(Ok(()), Err)
}

const RAISE: &str = "raise it, or use fewer workers or threads";
const RAISE_ALONE: &str = "raise it";
const SHARED_SPACE: &str = "make room, enlarge it (`mount -o remount,size=1G /dev/shm`, `docker run --shm-size 1g`), or take \
                            fewer workers";
const ON_DISK: &str = "free space, or choose another folder";

fn resource(limit: Resource, what: &str, used: u64, needed: u64, bytes: bool) -> Option<Shortage> {
    let allowed = getrlimit(limit).current?;
    let remedy = if matches!(limit, Resource::Fsize | Resource::Stack) { RAISE_ALONE } else { RAISE };
    Shortage { what: what.into(), most: allowed, used, needed, bytes, remedy }.if_short()
}

/// Limits on address space and data of this process, or of a process of equal size.
fn memory_of_process(needed: [u64; 2]) -> [Option<Shortage>; 2] {
    let own = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let [space, data] = ["VmSize:", "VmData:"].map(|name| field(&own, name).unwrap_or(0) << 10);
    [
        resource(Resource::As, "address space of a process (`ulimit -v`)", space, needed[0], true),
        resource(Resource::Data, "data of a process (`ulimit -d`)", data, needed[1], true),
    ]
}

/// Limit on descriptors of this process; `raise_limits` has raised the soft limit.
fn descriptors(needed: u64) -> Option<Shortage> {
    let used = fs::read_dir("/proc/self/fd").map_or(0, Iterator::count) as u64;
    resource(Resource::Nofile, "descriptors of a process (`ulimit -n`)", used, needed, false)
}

/// Limit on the threads of a user. The kernel exempts root and capable processes. Counts the visible processes.
fn user_threads(needed: u64) -> Option<Shortage> {
    if needed == 0 {
        return None;
    }
    const MAY_EXCEED: u64 = 1 << 21 | 1 << 24; // CAP_SYS_ADMIN, CAP_SYS_RESOURCE
    let user = rustix::process::getuid();
    let capable = fs::read_to_string("/proc/self/status").ok()?;
    let capable = capable.lines().find_map(|line| line.strip_prefix("CapEff:"))?;
    if user.is_root() || u64::from_str_radix(capable.trim(), 16).ok()? & MAY_EXCEED != 0 {
        return None;
    }
    // If all threads of the machine fit, so do those of the user; this avoids a scan of /proc.
    let most = getrlimit(Resource::Nproc).current?;
    if all_threads().is_some_and(|all| all.saturating_add(needed) <= most) {
        return None;
    }
    let entries = fs::read_dir("/proc").ok()?.flatten();
    let theirs = entries.filter_map(|entry| {
        entry.file_name().to_str()?.parse::<u32>().ok()?;
        let text = fs::read_to_string(entry.path().join("status")).ok()?;
        (field(&text, "Uid:")? == u64::from(user.as_raw())).then(|| field(&text, "Threads:"))?
    });
    let what = "processes and threads of this user (`ulimit -u`)";
    resource(Resource::Nproc, what, theirs.sum(), needed, false)
}

/// Threads of all users; the fourth field of /proc/loadavg is running/total.
fn all_threads() -> Option<u64> {
    let load = fs::read_to_string("/proc/loadavg").ok()?;
    load.split_whitespace().nth(3)?.split_once('/')?.1.parse().ok()
}

fn machine_threads(needed: u64) -> Option<Shortage> {
    let used = all_threads()?;
    let limit = |name: &str| number(&Path::new("/proc/sys/kernel").join(name));
    let most = limit("threads-max")?.min(limit("pid_max")?);
    let what = "threads of this machine (kernel.threads-max, kernel.pid_max)".into();
    Shortage { what, most, used, needed, bytes: false, remedy: "use fewer workers or threads" }.if_short()
}

fn cgroup_tasks(needed: u64) -> Option<Shortage> {
    let of = |group: &Path| Some((number(&group.join("pids.max"))?, number(&group.join("pids.current"))?));
    let (most, used) = tightest("pids", of)?;
    let what =
        "processes and threads of this container or job (cgroup's pids.max, `docker run --pids-limit`)"
            .into();
    Shortage { what, most, used, needed, bytes: false, remedy: RAISE }.if_short()
}

/// Limit on the memory of the control group. The page cache counts as free.
fn cgroup_memory(needed: u64) -> Option<Shortage> {
    let of = |group: &Path| {
        let most = memory_limit(group)?;
        let used = either(group, ["memory.current", "memory.usage_in_bytes"])?;
        let text = fs::read_to_string(group.join("memory.stat")).unwrap_or_default();
        let sum = |names: [&str; 2]| names.iter().filter_map(|name| field(&text, name)).sum::<u64>();
        let page_cache = sum(["file ", "total_cache "]).saturating_sub(sum(["shmem ", "total_shmem "]));
        Some((most, used.saturating_sub(page_cache)))
    };
    let (most, used) = tightest("memory", of)?;
    let what = "memory of this container or job (its cgroup's limit)".into();
    Shortage { what, most, used, needed, bytes: true, remedy: RAISE }.if_short()
}

fn memory(needed: u64) -> Option<Shortage> {
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    let (total, free) = (field(&text, "MemTotal:")? << 10, field(&text, "MemAvailable:")? << 10);
    let (what, used) = ("memory of this machine".into(), total.saturating_sub(free));
    let remedy = "free memory, or use fewer workers";
    Shortage { what, most: total, used, needed, bytes: true, remedy }.if_short()
}

fn space(folder: &Path, needed: u64, remedy: &'static str) -> Option<Shortage> {
    let what = format!("free space in {}", folder.display());
    Shortage { what, most: free_space(folder)?, used: 0, needed, bytes: true, remedy }.if_short()
}

/// `None` for file systems without a limit on inodes.
fn inodes(folder: &Path, needed: u64, remedy: &'static str) -> Option<Shortage> {
    let disk = rustix::fs::statvfs(folder).ok().filter(|disk| disk.f_files > 0)?;
    let what = format!("free inodes (`df -i`) in {}", folder.display());
    Shortage { what, most: disk.f_favail, used: 0, needed, bytes: false, remedy }.if_short()
}

/// The closest existing parent folder of a file.
fn existing(file: &Path) -> PathBuf {
    let file = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    file.ancestors().find(|folder| folder.is_dir()).unwrap_or(Path::new("/")).to_owned()
}

/// The groups of this controller in a text such as /proc/self/cgroup, and their parents.
pub(crate) fn groups(text: &str, root: &Path, controller: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for line in text.lines() {
        let mut parts = line.splitn(3, ':').skip(1);
        let (Some(names), Some(path)) = (parts.next(), parts.next()) else { continue };
        let root = match names {
            "" => root.to_owned(),
            names if names.split(',').any(|name| name == controller) => root.join(controller),
            _ => continue,
        };
        // In a container the path may be the host's. Then only the mounted root exists.
        let own = root.join(path.trim_start_matches('/'));
        found.extend(own.ancestors().take_while(|group| group.starts_with(&root)).map(Path::to_owned));
    }
    found
}

/// The control groups of this process.
pub(crate) fn own_groups(controller: &str) -> Vec<PathBuf> {
    let text = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    groups(&text, Path::new("/sys/fs/cgroup"), controller)
}

/// Limit and use of the control group, among those of this process, with the least remaining.
fn tightest(controller: &str, of: impl Fn(&Path) -> Option<(u64, u64)>) -> Option<(u64, u64)> {
    let found = own_groups(controller);
    found.iter().filter_map(|group| of(group)).min_by_key(|(most, used)| most.saturating_sub(*used))
}

/// Memory limit of a control group (bytes); `None` without a limit.
pub(crate) fn memory_limit(group: &Path) -> Option<u64> {
    either(group, ["memory.max", "memory.limit_in_bytes"])
}

/// The number in the first file that contains one; names differ between cgroup versions.
fn either(group: &Path, names: [&str; 2]) -> Option<u64> {
    names.iter().find_map(|name| number(&group.join(name)))
}

/// The number in a file; `None` for `max`.
fn number(file: &Path) -> Option<u64> {
    fs::read_to_string(file).ok()?.trim().parse().ok()
}

/// The number after a name at the start of a line.
pub(crate) fn field(text: &str, name: &str) -> Option<u64> {
    text.lines().find_map(|line| line.strip_prefix(name))?.split_whitespace().next()?.parse().ok()
}

/// Number of processes of this container or job that the system killed for lack of memory.
pub fn killed_for_memory() -> u64 {
    let of = |group: &Path| {
        let events = ["memory.events", "memory.oom_control"];
        let text = events.iter().find_map(|name| fs::read_to_string(group.join(name)).ok())?;
        Some((u64::MAX, field(&text, "oom_kill ")?))
    };
    tightest("memory", of).map_or(0, |(_, kills)| kills)
}

/// Error codes of shortages: EAGAIN, ENOMEM, ENFILE, EMFILE, EFBIG, ENOSPC, EDQUOT.
const SHORTAGE_CODES: [i32; 7] =
    [libc::EAGAIN, libc::ENOMEM, libc::ENFILE, libc::EMFILE, libc::EFBIG, libc::ENOSPC, libc::EDQUOT];

/// Whether an error message contains the code of a shortage.
pub fn tells_of_shortage(text: &str) -> bool {
    SHORTAGE_CODES.iter().any(|code| {
        [format!("os error {code})"), format!("Os {{ code: {code},")].iter().any(|words| text.contains(words))
    })
}

/// Appends the exceeded limit to a message, if one is still exceeded.
pub fn explained(text: &str, needs: &Needs) -> String {
    check(needs).map_or_else(|short| format!("{text}; {}", short.fact()), |()| text.to_owned())
}

/// Raises the soft limit on descriptors to the hard limit; the usual soft limit is too low for twenty workers. Ignores SIGXFSZ,
/// so that writing beyond the size limit is an error and does not end the process.
pub fn raise_limits() {
    let maximum = getrlimit(Resource::Nofile).maximum;
    let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum });
    // SAFETY: SIG_IGN installs no handler.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
}

/// Checks that a program can run. Raises the stack of its main thread, and of workers, if possible. Call it at program start.
///
/// # Errors
/// The limit that is too low and cannot be raised.
pub fn check_start() -> Result<(), Shortage> {
    let [least, usual] = MAIN_STACK;
    let Rlimit { current, maximum } = getrlimit(Resource::Stack);
    if current.is_some_and(|current| current < usual) {
        let raised = Some(maximum.map_or(usual, |maximum| maximum.min(usual)));
        let _ = setrlimit(Resource::Stack, Rlimit { current: raised, maximum });
    }
    let stack = resource(Resource::Stack, "stack (`ulimit -s`)", 0, least, true);
    let [space, data] = memory_of_process(START);
    let short = [stack, space, data, descriptors(START_DESCRIPTORS)].into_iter().flatten().next();
    short.map_or(Ok(()), Err)?;
    match std::thread::Builder::new().stack_size(64 << 10).spawn(|| ()) {
        Ok(thread) => drop(thread.join()),
        Err(_) => check(&Needs { threads: 2, ..Needs::default() })?,
    }
    Ok(())
}

#[cfg(test)]
mod tests;
