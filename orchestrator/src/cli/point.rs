//! A trial's point of the sweep as cells and as text.

use std::collections::BTreeSet;

use serde_json::Value;

use crate::cell::{brief, of_value, plain};

/// Values of a trial's spec at the given keys: lists and tables as `text` writes them, missing keys as null.
pub fn values_at(spec: &Value, keys: &BTreeSet<&str>, text: fn(&Value) -> String) -> Vec<Value> {
    let value = |key: &&str| spec.pointer(&format!("/{}", key.replace('.', "/")));
    keys.iter().map(|key| value(key).map_or(Value::Null, |value| of_value(value, text))).collect()
}

/// Text with a trial's K, M, placement, seed, and its values of `keys`.
pub fn point_in_words(spec: &Value, keys: &BTreeSet<&str>) -> String {
    let point = |name: &str| plain(&spec["point"][name]);
    let [k, m, placement, seed] = ["panels", "sensors", "placement", "seed"].map(point);
    let mut words = format!("K={k} M={m} placement {placement} seed {seed}");
    for (key, value) in keys.iter().zip(values_at(spec, keys, brief)).filter(|(_, value)| !value.is_null()) {
        words += &format!(" {key}={}", plain(&value));
    }
    words
}
