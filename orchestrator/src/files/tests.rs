use std::os::unix::fs::{PermissionsExt, symlink};

use super::*;

/// New, written over with its permissions kept, through a link, to a device; where it cannot be, what was there stays.
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
