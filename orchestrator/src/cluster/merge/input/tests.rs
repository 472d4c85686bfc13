use super::*;
use crate::store::Store;

/// No run can start on an attached input; a run between two accesses is detected.
#[tokio::test]
async fn an_input_is_locked_while_it_is_attached_and_known_to_have_changed() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("a.sqlite");
    Store::open(&db).await.unwrap().close().await.unwrap();
    let open = async |copy: &str| Input::open(&db, &folder.path().join(copy), false).await.unwrap();
    let (input, other) = (open("1").await, open("2").await);
    let held = (input.hold().unwrap(), other.hold().unwrap());
    assert!(matches!(Store::open(&db).await, Err(StoreError::InUse(..))), "{input:?}");
    assert_eq!(other.uri(), input.uri(), "merges may share it");
    drop(held);
    let store = Store::open(&db).await.unwrap();
    assert!(matches!(input.hold(), Err(InputError::Changed)));
    assert_ne!(open("3").await.uri(), input.uri(), "a copy of what a run writes to");
    store.close().await.unwrap();
    let mut bytes = std::fs::read(&db).unwrap();
    bytes.push(0);
    std::fs::write(&db, bytes).unwrap();
    assert!(matches!(input.hold(), Err(InputError::Changed)));
}
