use super::*;
use crate::store::Store;
use metasense_schemas::database::VIEWS;

/// With these types, a Parquet file of an empty answer has the same schema as one with rows.
#[tokio::test]
async fn every_column_of_a_view_has_a_type() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("db.sqlite");
    Store::open(&db).await.unwrap().close().await.unwrap();
    let mut reader = Reader::open(&db).await.unwrap();
    for (view, _) in VIEWS.iter() {
        let sql = format!("SELECT * FROM {view} WHERE 0");
        let (columns, types) = (reader.columns(&sql).await.unwrap(), reader.types(&sql).await);
        assert_eq!(columns.len(), types.len(), "{view}");
        for (column, sql) in columns.iter().zip(&types) {
            assert!(
                ["TEXT", "INTEGER", "INT", "REAL", "BLOB"].contains(&sql.as_str()),
                "{view}.{column}: {sql:?}"
            );
        }
    }
    let sql = "SELECT reason, CAST(NULL AS REAL), NULL, seconds FROM v_trial -- that is all";
    assert_eq!(reader.types(sql).await, ["TEXT", "REAL", "", "REAL"]);
    for sql in ["SELECT 1; DROP VIEW v_trial", "SELECT 1; VACUUM INTO 'x.db'", "EXPLAIN SELECT 1", "no SQL"] {
        reader.types(sql).await;
    }
    assert_eq!(reader.columns("SELECT * FROM temp.sqlite_schema").await.unwrap().len(), 5);
    reader.query::<QueryResult>("SELECT * FROM v_trial").await.unwrap();
    reader.close().await;
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left beside");
}
