use super::*;
use crate::store::Store;

const LIMITS: AnswerLimits = AnswerLimits { rows: 10, bytes: 1000, time: Duration::from_millis(300) };

/// Statements that access other files or change anything are refused, also after another statement.
#[tokio::test]
async fn nothing_but_rows_can_be_had() {
    let bench = tempfile::tempdir().unwrap();
    let [db, other] = ["db.sqlite", "other.sqlite"].map(|name| bench.path().join(name));
    Store::open(&db).await.unwrap().close().await.unwrap();
    let mut reader = Reader::confined(&db).await.unwrap();
    let file = other.display();
    for sql in [
        format!("ATTACH '{file}' AS other"),
        format!("VACUUM INTO '{file}'"),
        format!("SELECT 1; VACUUM INTO '{file}'"),
        "PRAGMA query_only = OFF".into(),
        "PRAGMA database_list".into(),
        "PRAGMA integrity_check".into(),
        "SELECT * FROM pragma_quick_check".into(),
        "SELECT * FROM pragma_database_list".into(),
        "SELECT load_extension('libc.so.6')".into(),
        "DELETE FROM trial".into(),
        "CREATE TEMP TABLE t (x)".into(),
        "BEGIN".into(),
        "SELECT '\0'".into(),
    ] {
        let answer = reader.limited::<QueryResult>(&sql, LIMITS).await;
        assert!(answer.is_err(), "{sql}: {answer:?}");
    }
    assert!(!other.exists());
    let (table, cut) =
        reader.limited::<QueryResult>("SELECT count(*) AS n FROM v_trial", LIMITS).await.unwrap();
    assert_eq!((table.1[0][0].as_i64(), cut), (Some(0), None));
}

/// Answers respect the limits of rows, bytes, time and length of values.
#[tokio::test]
async fn answers_end_at_their_limits() {
    let bench = tempfile::tempdir().unwrap();
    let db = bench.path().join("db.sqlite");
    Store::open(&db).await.unwrap().close().await.unwrap();
    let mut reader = Reader::confined(&db).await.unwrap();
    let count = |to: u64, what: &str| {
        format!(
            "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c WHERE n < {to}) SELECT {what} FROM c"
        )
    };
    for (sql, rows, why) in [
        (count(10, "n"), 10, None),
        (count(11, "n"), 10, Some("more than 10 rows")),
        (count(9, "printf('%400c', 'x')"), 2, Some("more than 1000 bytes")),
    ] {
        let (table, cut) = reader.limited::<QueryResult>(&sql, LIMITS).await.unwrap();
        assert_eq!(table.1.len(), rows, "{sql}");
        assert!(why.is_none_or(|why| cut.as_ref().is_some_and(|cut| cut.contains(why))), "{sql}: {cut:?}");
    }
    // on values of the maximum length
    let long = "hex(zeroblob(130000))";
    for (sql, why) in [
        (count(1 << 40, "count(*)"), "more than 0.3 s"),
        (count(1 << 40, &format!("sum(instr({long}, hex(zeroblob(65000)) || '1'))")), "more than 0.3 s"),
        (count(1 << 40, &format!("sum({long} LIKE '%0%0%0%0%0%1')")), "more than 0.3 s"),
        ("SELECT zeroblob(9000000)".into(), "too big"),
        (format!("SELECT instr(hex(zeroblob(1500000)), hex(zeroblob(150000)) || '1'), {long}"), "too big"),
        (format!("SELECT replace({long}, '0', 'aaaa')"), "too big"),
        (format!("SELECT trim({long}, '0' || {long})"), "not available here"),
        (format!("SELECT json_patch({long}, {long})"), "not available here"),
    ] {
        let begun = Instant::now();
        let said = reader.limited::<QueryResult>(&sql, LIMITS).await.unwrap_err().to_string();
        assert!(said.contains(why) && begun.elapsed() < Duration::from_secs(20), "{sql}: {said}");
    }
}
