use super::*;
use crate::store::Store;

/// What is attached as it is does not change: no run can begin on it before the merge has let go of it.
#[tokio::test]
async fn an_input_is_locked_for_as_long_as_it_is_attached() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("a.sqlite");
    Store::open(&db).await.unwrap().close().await.unwrap();
    let input = Input::open(&db, folder.path(), 0).await.unwrap();
    assert!(matches!(Store::open(&db).await, Err(StoreError::InUse { .. })), "{input:?}");
    let other = Input::open(&db, folder.path(), 1).await.unwrap();
    assert_eq!(other.uri, input.uri, "merges may share it");
    drop((input, other));
    Store::open(&db).await.unwrap().close().await.unwrap();
}
