//! Tests of `table`.

use super::*;
use serde_json::json;

#[test]
fn names_are_cut_between_characters() {
    assert_eq!(
        ["", "abc", "abcdefgh", "abcdefghi", "abcdefg\u{e9}1"].map(short_hash),
        ["", "abc", "abcdefgh", "abcdefgh", "abcdefg\u{e9}"]
    );
}

#[test]
fn a_verdict_is_the_only_one_where_no_row_says_more() {
    let row = |set: &str, verdict: &str, m: Value| vec![json!(set), json!(verdict), m, Value::Null];
    let table = |rows: Vec<Vec<Value>>| Table::new("set verdict kneedle chord", rows);
    let few = [row("test", "too few", Value::Null), row("holdout", "too few", Value::Null)];
    assert_eq!(table(few.to_vec()).sole_verdict(), Some("too few"));
    let found = [few[0].clone(), row("holdout", "at M = 3", json!(3))];
    assert_eq!(table(found.to_vec()).sole_verdict(), None);
    assert_eq!(table(found.to_vec()).without_empty_columns().columns, ["set", "verdict", "kneedle"]);
    assert_eq!(table(Vec::new()).sole_verdict(), None);
}
