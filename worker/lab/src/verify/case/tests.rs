use super::without_nan;

#[test]
fn numbers_that_are_none_become_null_and_texts_stay() {
    let text = r#"{"a": NaN, "NaN": [-Infinity, Infinity, 1.5], "b": "say \"NaN\", NaN", "c": NaN}"#;
    let read: serde_json::Value = serde_json::from_str(&without_nan(text)).unwrap();
    let expected =
        serde_json::json!({"a": null, "NaN": [null, null, 1.5], "b": "say \"NaN\", NaN", "c": null});
    assert_eq!(read, expected);
}
