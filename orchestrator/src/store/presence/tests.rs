use super::*;
use crate::reader::Reader;
use crate::store::Store;
use std::fs;

const SPEC: &str = "name = \"s\"\n[body]\ncolumns = 4\nrows = 4\nspacing = 15.0\nligament_length = 2.25\n\
    density = 1e-8\nstiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }\n[stimuli]\nkind = \"bell\"\n\
    samples = 8\ntest = 2\n[sweep]\npanels = [2]\nsensors = [1, 2]\n";

/// The number of trials in a file; `None` if it cannot be read.
async fn trials(db: &Path) -> Option<u64> {
    let mut reader = Reader::open(db).await.ok()?;
    let found: crate::reader::QueryResult = reader.query("SELECT count(*) FROM v_trial").await.ok()?;
    reader.close().await;
    found.1[0][0].as_u64()
}

/// Each change to the files of an open database is detected, and the error names a file with all recorded data.
#[tokio::test]
async fn changes_to_the_files_are_detected_and_the_data_is_saved() {
    type Deed = fn(&Path, &Path);
    let deeds: [(&str, FileLoss, Deed); 8] = [
        ("deleted", FileLoss::Deleted, |_, db| fs::remove_file(db).unwrap()),
        ("deleted with its log", FileLoss::Deleted, |_, db| {
            ["-wal", "-shm", ""].into_iter().for_each(|end| fs::remove_file(sidecar(db, end)).unwrap());
        }),
        ("renamed", FileLoss::Moved, |_, db| fs::rename(db, db.with_file_name("other.sqlite")).unwrap()),
        ("its folder moved", FileLoss::Moved, |folder, _| {
            fs::rename(folder.join("a"), folder.join("b")).unwrap()
        }),
        ("its folder removed", FileLoss::Deleted, |folder, _| fs::remove_dir_all(folder.join("a")).unwrap()),
        ("replaced", FileLoss::Replaced, |folder, db| {
            fs::write(folder.join("new"), "another").unwrap();
            fs::rename(folder.join("new"), db).unwrap();
        }),
        ("its log deleted", FileLoss::Log, |_, db| fs::remove_file(sidecar(db, "-wal")).unwrap()),
        ("replaced with its log", FileLoss::Replaced, |folder, db| {
            for (end, text) in [("-wal", "log"), ("", "another")] {
                fs::write(folder.join("new"), text).unwrap();
                fs::rename(folder.join("new"), sidecar(db, end)).unwrap();
            }
        }),
    ];
    let plan = crate::plan::Plan::new("s.toml", SPEC.into()).unwrap();
    for (name, expected, deed) in deeds {
        let folder = tempfile::tempdir().unwrap();
        let db = folder.path().join("a/db.sqlite");
        let mut store = Store::open(&db).await.unwrap();
        store.begin_sweep(&plan.spec, SPEC, &plan.trials).await.unwrap();
        let presence = store.presence();
        assert_eq!(presence.check(), None, "{name}");
        deed(folder.path(), &db);
        assert_eq!(presence.check(), Some(expected), "{name}");
        drop(presence);
        let Err(StoreError::Lost { lost, saved, .. }) = store.close().await else { panic!("{name}") };
        assert_eq!(lost, expected, "{name}");
        let saved = saved.unwrap_or_else(|why| panic!("{name}: {why}"));
        assert_eq!(trials(&saved).await, Some(2), "{name}: {}", saved.display());
        if saved.parent() == Some(Path::new(".")) {
            fs::remove_file(saved).unwrap();
        }
        if expected == FileLoss::Replaced {
            assert_eq!(fs::read(&db).unwrap(), b"another", "{name}");
            let log = fs::read(sidecar(&db, "-wal")).ok();
            assert_eq!(log, (name == "replaced with its log").then(|| b"log".to_vec()), "{name}");
        }
    }
}

/// A truncated file is detected; a file that another program has compacted is not mistaken for one.
#[tokio::test]
async fn truncation_is_distinguished_from_compaction() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("db.sqlite");
    let mut store = Store::open(&db).await.unwrap();
    let plan = crate::plan::Plan::new("s.toml", SPEC.into()).unwrap();
    store.begin_sweep(&plan.spec, SPEC, &plan.trials).await.unwrap();
    let mut other = crate::store::options(&db);
    other = other.pragma("wal_autocheckpoint", "1");
    let mut other = sqlx::ConnectOptions::connect(&other).await.unwrap();
    for sql in
        ["CREATE TABLE t AS SELECT zeroblob(1000000) AS x", "DROP TABLE t", "VACUUM", "PRAGMA wal_checkpoint"]
    {
        sqlx::raw_sql(sql).execute(&mut other).await.unwrap();
        assert_eq!(store.presence().check(), None, "{sql}");
    }
    other.close().await.unwrap();
    let presence = store.presence();
    for size in [5000, 0] {
        fs::OpenOptions::new().write(true).open(&db).unwrap().set_len(size).unwrap();
        assert_eq!(presence.check(), Some(FileLoss::Truncated), "{size} bytes");
    }
    drop(presence);
    let closed = store.close().await;
    let Err(StoreError::Lost { lost: FileLoss::Truncated, saved: Err(why), .. }) = closed else {
        panic!("{closed:?}")
    };
    assert!(why.contains("restore"), "{why}");
    // what the log still has is saved
    let db = folder.path().join("young.sqlite");
    let mut store = Store::open(&db).await.unwrap();
    store.begin_sweep(&plan.spec, SPEC, &plan.trials).await.unwrap();
    assert_eq!(store.presence().check(), None);
    fs::OpenOptions::new().write(true).open(&db).unwrap().set_len(0).unwrap();
    let Err(StoreError::Lost { lost: FileLoss::Truncated, saved: Ok(saved), .. }) = store.close().await
    else {
        panic!("nothing is saved");
    };
    assert_eq!(trials(&saved).await, Some(2));
}
