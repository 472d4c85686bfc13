use super::*;

/// Accepts the needs of one worker, and names the limit that excessive needs exceed.
#[test]
fn what_no_machine_has_is_refused_by_name() {
    raise_limits();
    let here = std::env::temp_dir().join("none/db.sqlite");
    let files = [&*here];
    assert_eq!(check(&Needs { workers: 1, threads: 1, files: &files }), Ok(()));
    let short = check(&Needs { workers: u32::MAX, threads: 1, files: &files }).unwrap_err();
    let counts = !short.bytes && short.needed > u64::from(u32::MAX);
    assert!(counts && short.to_string().contains("workers"), "{short}");
}

/// Recognises system errors of shortages in their usual forms, and no others.
#[test]
fn words_of_a_shortage_are_told_from_others() {
    for code in SHORTAGE_CODES {
        let error = std::io::Error::from_raw_os_error(code);
        assert!(tells_of_shortage(&format!("a file cannot be read: {error}")), "{error}");
        assert!(tells_of_shortage(&format!("failed to spawn thread: {error:?}")), "{error:?}");
    }
    for code in [libc::ENOENT, libc::EACCES, libc::EIO] {
        assert!(!tells_of_shortage(&std::io::Error::from_raw_os_error(code).to_string()));
    }
    assert!(!tells_of_shortage("11"));
}

/// Sizes have readable units.
#[test]
fn a_shortage_says_what_is_there_and_what_is_needed() {
    let (what, remedy) = ("x".into(), "y");
    let limit = Shortage { what, most: 100 << 20, used: 1 << 10, needed: 1 << 30, bytes: true, remedy };
    assert_eq!(limit.to_string(), "x: 100 MiB, 1 KiB in use, 1024 MiB needed; y");
    assert_eq!(Shortage { most: 2 << 30, ..limit }.if_short(), None);
}
