use super::*;
use crate::store::Store;

#[tokio::test]
async fn what_cannot_be_handed_in_stays_where_it_is_said_to_be() {
    let bench = tempfile::tempdir().unwrap();
    let (folder, db) = (bench.path().join("out"), bench.path().join("live.sqlite"));
    let home = Home::new("s", Shard::new(1, 2).unwrap(), &folder, Some(db.clone())).unwrap();
    Store::open(&db).await.unwrap().close().await.unwrap();
    std::fs::rename(&folder, bench.path().join("away")).unwrap();
    let error = home.hand_in_within(Duration::from_millis(10)).await.unwrap_err();
    assert!(error.to_string().contains(db.to_str().unwrap()) && db.exists(), "{error}");
    std::fs::rename(bench.path().join("away"), &folder).unwrap();
    home.hand_in_within(Duration::ZERO).await.unwrap();
    assert_eq!(attempts(&folder).into_values().map(|files| files.len()).sum::<usize>(), 1);
}

/// A damaged live database is moved to the results folder with its log, and the shard resumes from copies. A database of a
/// newer version, or another file, is refused and stays.
#[tokio::test]
async fn a_damaged_live_database_is_set_aside_and_no_other() {
    let bench = tempfile::tempdir().unwrap();
    let (folder, db) = (bench.path().join("out"), bench.path().join("live.sqlite"));
    let mut home = Home::new("s", Shard::new(1, 2).unwrap(), &folder, Some(db.clone())).unwrap();
    assert_eq!(home.merge_earlier_copies(|| ()).await.unwrap(), None);
    Store::open(&db).await.unwrap().close().await.unwrap();
    let whole = std::fs::read(&db).unwrap();
    let mut newer = whole.clone();
    newer[60..64].copy_from_slice(&99u32.to_be_bytes()); // user_version in the header
    for foreign in [newer, b"notes of mine".repeat(100)] {
        std::fs::write(&db, &foreign).unwrap();
        assert!(matches!(
            home.merge_earlier_copies(|| ()).await,
            Err(HomeError::Merge(MergeError::Result { .. }))
        ));
        assert!(std::fs::read(&db).unwrap() == foreign);
    }
    for handed_in in [false, true] {
        let damaged = &whole[..whole.len() / 2];
        std::fs::write(&db, damaged).unwrap();
        std::fs::write(files::sidecar(&db, "-wal"), "").unwrap();
        let aside = home.merge_earlier_copies(|| ()).await.unwrap().unwrap();
        assert!(
            aside.starts_with(folder.canonicalize().unwrap()) && std::fs::read(&aside).unwrap() == damaged
        );
        assert!(attempts(&folder).into_values().flatten().all(|file| file != aside));
        Store::open(&db).await.unwrap().close().await.unwrap();
        assert_eq!(attempts(&folder).len(), usize::from(handed_in));
        home.hand_in_while(|| true).await.unwrap();
    }
}

/// At the end of a run, a large copy in progress is cancelled.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_last_hand_in_does_not_wait_for_a_periodic_one() {
    use sqlx::ConnectOptions;
    let bench = tempfile::tempdir().unwrap();
    let (folder, db) = (bench.path().join("out"), bench.path().join("live.sqlite"));
    let home = Home::new("s", Shard::new(1, 2).unwrap(), &folder, Some(db.clone())).unwrap();
    Store::open(&db).await.unwrap().close().await.unwrap();
    let mut large = crate::store::options(&db).connect().await.unwrap();
    sqlx::raw_sql(
        "CREATE TABLE large (n INTEGER); WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c WHERE n < 1000000)
         INSERT INTO large SELECT n FROM c",
    )
    .execute(&mut large)
    .await
    .unwrap();
    let began = std::time::Instant::now();
    home.hand_in_while(|| true).await.unwrap();
    let whole = began.elapsed();
    let (stop, stopped) = tokio::sync::oneshot::channel();
    let copy = home.handed_in.with_extension("tmp");
    let ending = async {
        while !copy.exists() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        let began = std::time::Instant::now();
        drop(stop);
        began
    };
    let every = async {
        home.hand_in_every(Duration::from_millis(1), stopped, &Notify::new()).await;
        std::time::Instant::now()
    };
    let (began, ended) = tokio::join!(ending, every);
    assert!(ended - began < whole / 2, "{:?} of {whole:?}", ended - began);
    assert!(copy.exists(), "it was given up");
}
