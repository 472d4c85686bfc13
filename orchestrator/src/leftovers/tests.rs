use super::*;

/// Marks of an ended process on this host count as abandoned; fresh ones of a host whose name ends like this one do not.
#[test]
fn marks_of_other_machines_are_not_ours() {
    let own = own_mark();
    let (host, _) = own.rsplit_once('-').unwrap();
    let folder = tempfile::tempdir().unwrap();
    let none = 4_194_304; // above any process id
    for (begins, ends, ours) in [
        (".a.sqlite.", ".tmp", true),
        (".a.sqlite.merge-", "", true),
        ("metasense-run-Xy.", "", true),
        ("shard-1-of-2.1764259000123-", ".sqlite", true),
        (".a.sqlite.gpu-", ".tmp", false),
        (".a.sqlite.merge-rack1-", "", false),
        ("shard-1-of-2.1764259000123-gpu-", ".sqlite", false),
        (".a.sqlite.7-", ".tmp", false),
    ] {
        let path = folder.path().join(format!("{begins}{host}-{none}{ends}"));
        std::fs::write(&path, "").unwrap();
        assert_eq!(is_abandoned(&path), ours, "{}", path.display());
    }
    let at_work = folder.path().join(format!(".a.sqlite.{own}.tmp"));
    std::fs::write(&at_work, "").unwrap();
    assert!(!is_abandoned(&at_work));
}
