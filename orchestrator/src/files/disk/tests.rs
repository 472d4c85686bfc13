use super::*;

#[test]
fn network_file_systems_are_known_by_name_and_local_ones_pass() {
    for (magic, mounted_as, expected) in [
        (0x6969, "nfs4", Some("NFS")),
        (0xff53_4d42, "cifs", Some("CIFS")),
        (0x0bd0_0bd0, "lustre", Some("Lustre")),
        (0x4750_4653, "gpfs", Some("GPFS")),
        (0x1983_0326, "beegfs", Some("BeeGFS")),
        (0x00c3_6400, "ceph", Some("Ceph")),
        (0x7461_636f, "ocfs2", Some("OCFS2")),
        (0x0116_1970, "gfs2", Some("GFS2")),
        (0x786f_4256, "vboxsf", Some("vboxsf")),
        (FUSE, "fuse.daos", Some("fuse.daos")),
        (FUSE, "fuse.eosxd", Some("fuse.eosxd")),
        (FUSE, "fuse.sshfs", Some("fuse.sshfs")),
        (FUSE, "fuse.ceph-fuse", Some("fuse.ceph-fuse")),
        (FUSE, "fuse.fuse-overlayfs", None),
        (FUSE, "fuseblk", None),
        (0xef53, "ext4", None),
        (0x5846_5342, "xfs", None),
        (0x9123_683e, "btrfs", None),
        (0x0102_1994, "tmpfs", None),
        (0x794c_7630, "overlay", None),
        (0x2fc1_2fc1, "zfs", None),
    ] {
        assert_eq!(network(magic, mounted_as).as_deref(), expected, "{magic:#x} {mounted_as}");
    }
}

#[test]
fn the_mount_table_names_the_program_behind_fuse() {
    let table = "36 35 98:0 / / rw,noatime shared:1 - ext4 /dev/root rw\n\
                 48 36 0:52 / /home/a rw,nosuid shared:2 - fuse.sshfs host:/home rw,user_id=0\n";
    assert_eq!(mounted_as(rustix::fs::makedev(0, 52), table), "fuse.sshfs");
    assert_eq!(mounted_as(rustix::fs::makedev(0, 53), table), "");
}

#[test]
fn folders_of_tests_are_local() {
    assert_eq!(network_of(&std::env::temp_dir()), None);
}
