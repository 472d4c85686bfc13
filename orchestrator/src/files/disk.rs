//! Detects network file systems. They lack the shared memory and reliable locks that SQLite's write-ahead log needs: a database
//! in use there is eventually corrupted.

use std::os::unix::fs::MetadataExt;
use std::path::Path;

use rustix::fs::{major, minor, statfs};

/// `f_type` of FUSE; only the mount table gives the program behind it.
const FUSE: u64 = 0x6573_5546;

/// Network file systems by `f_type` (statfs(2); headers of file systems outside the kernel).
const BY_MAGIC: &[(u64, &str)] = &[
    (0x6969, "NFS"),
    (0x517b, "SMB"),
    (0xff53_4d42, "CIFS"),
    (0xfe53_4d42, "SMB2"),
    (0x0bd0_0bd0, "Lustre"),
    (0x4750_4653, "GPFS"),
    (0x1983_0326, "BeeGFS"),
    (0x00c3_6400, "Ceph"),
    (0x5346_414f, "AFS"),
    (0x6b41_4653, "AFS"),
    (0x7375_7245, "Coda"),
    (0x2003_0528, "OrangeFS"),
    (0x0102_1997, "9p"),
    (0xaad7_aaea, "PanFS"),
    (0x1803_1977, "WekaFS"),
    (0x7461_636f, "OCFS2"),
    (0x0116_1970, "GFS2"),
    (0x786f_4256, "vboxsf"),
];

/// FUSE programs that access files over a network, by subtype in the mount table, separated by spaces.
const BY_SUBTYPE: &str = "afp beegfs blobfuse ceph curlftpfs cvmfs daos davfs dfuse eos gcsfuse geesefs glusterfs goofys hdfs \
     juicefs lizardfs mfs moosefs mountpoint-s3 quobyte rclone s3fs seaweedfs smbnetfs sshfs vast virtiofs";

/// Name of a network file system, given `f_type` and, for FUSE, the type in the mount table (`fuse.sshfs`); `None` for a local
/// one.
pub fn network(magic: u64, mounted_as: &str) -> Option<String> {
    if magic == FUSE {
        let program = mounted_as.strip_prefix("fuse.").unwrap_or(mounted_as);
        return BY_SUBTYPE.split(' ').any(|name| program.starts_with(name)).then(|| mounted_as.to_owned());
    }
    BY_MAGIC.iter().find(|(known, _)| *known == magic).map(|(_, name)| (*name).to_owned())
}

/// Name of the network file system that contains a folder. Counts as local if the system gives no answer.
pub fn network_of(folder: &Path) -> Option<String> {
    let magic = statfs(folder).ok()?.f_type as u64 & 0xffff_ffff;
    let device = if magic == FUSE { folder.metadata().ok()?.dev() } else { 0 };
    network(magic, &mounted_as(device, &std::fs::read_to_string("/proc/self/mountinfo").unwrap_or_default()))
}

/// Type of the file system with this device number, from the mount table (proc_pid_mountinfo(5)).
fn mounted_as(device: u64, table: &str) -> String {
    let number = format!("{}:{}", major(device), minor(device));
    let line = table.lines().find(|line| line.split(' ').nth(2) == Some(&number));
    line.and_then(|line| line.split_once(" - ")?.1.split(' ').next()).unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests;
