use std::os::unix::fs::{PermissionsExt, symlink};

use super::*;

/// A file can be created, overwritten with its permissions kept, and written through a link or to a device; errors leave the
/// old one.
#[test]
fn a_file_is_the_old_one_or_the_new_one() {
    let bench = tempfile::tempdir().unwrap();
    let (file, link) = (bench.path().join("a.txt"), bench.path().join("link"));
    let read = |path: &Path| std::fs::read_to_string(path).unwrap();
    write(&file, b"one").unwrap();
    assert_eq!(read(&file), "one");
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o640)).unwrap();
    symlink("a.txt", &link).unwrap();
    write(&link, b"two").unwrap();
    assert_eq!((read(&file), file.metadata().unwrap().permissions().mode() & 0o777), ("two".into(), 0o640));
    assert!(link.symlink_metadata().unwrap().is_symlink());
    write(Path::new("/dev/null"), b"three").unwrap();
    assert!(write(&bench.path().join("no such folder/a.txt"), b"four").is_err());
    assert!(write(bench.path(), b"five").is_err());
    let names: Vec<_> = std::fs::read_dir(bench.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(names.len(), 2, "nothing is left beside: {names:?}");
}

/// An unfinished file leaves the old file and no temporary one; a database is never overwritten.
#[test]
fn an_unfinished_file_and_one_over_a_database_leave_what_was_there() {
    let bench = tempfile::tempdir().unwrap();
    let (file, db) = (bench.path().join("a.csv"), bench.path().join("a.sqlite"));
    std::fs::write(&file, "before").unwrap();
    std::fs::write(&db, "SQLite format 3\0 and so on").unwrap();
    let mut output = Output::create(&file).unwrap();
    output.write_all(b"half").unwrap();
    drop(output);
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "before");
    let why = write(&db, b"rows").unwrap_err().to_string();
    assert!(why.contains("it is a database"), "{why}");
    assert!(std::fs::read_to_string(&db).unwrap().ends_with("and so on"));
    assert_eq!(std::fs::read_dir(bench.path()).unwrap().count(), 2);
}

/// Temporary files that an ended process has left of the same file are removed, those of others are not.
#[test]
fn what_an_ended_process_has_left_is_removed() {
    let bench = tempfile::tempdir().unwrap();
    let ended = format!("{}-{}.tmp", mark_of(&host()), u32::MAX);
    for name in ["a.csv", "a.csv.gz", "b.csv"] {
        std::fs::write(bench.path().join(format!(".{name}.{ended}")), "half").unwrap();
    }
    write(&bench.path().join("a.csv"), b"whole").unwrap();
    let names =
        std::fs::read_dir(bench.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<_> = names.collect();
    names.sort();
    assert_eq!(names, [format!(".a.csv.gz.{ended}"), format!(".b.csv.{ended}"), "a.csv".into()]);
}

#[test]
fn open_files_of_this_process_are_streams() {
    for path in ["/dev/stdout", "/dev/fd/2", "/proc/self/fd/0", "/dev/null"] {
        assert!(is_stream(Path::new(path)), "{path}");
    }
    for path in ["/proc/self/status", "/dev", "Cargo.toml", "/dev/fd/-1", "none"] {
        assert!(!is_stream(Path::new(path)), "{path}");
    }
}
