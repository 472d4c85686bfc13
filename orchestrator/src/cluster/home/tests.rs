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
