//! Cells of a result: JSON values, plus a representation of ±∞, which JSON numbers lack.

use serde_json::{Value, json};

/// Key of the object that represents ±∞. Its value is true for +∞.
const INFINITE: &str = "infinite";

/// The cell for a number. NaN becomes null, as in SQLite.
pub fn real(x: f64) -> Value {
    if x.is_infinite() { json!({ INFINITE: x > 0.0 }) } else { x.into() }
}

/// The number in a cell, including ±∞.
pub fn number(cell: &Value) -> Option<f64> {
    cell.as_f64().or_else(|| infinite(cell))
}

/// ±∞ in a cell.
pub fn infinite(cell: &Value) -> Option<f64> {
    let positive = cell.as_object()?.get(INFINITE)?.as_bool()?;
    Some(if positive { f64::INFINITY } else { f64::NEG_INFINITY })
}

/// The cell as text that reads back as the same value: `inf` and `-inf`, and nothing for NULL.
pub fn plain(cell: &Value) -> String {
    match (cell, infinite(cell)) {
        (Value::Null, _) => String::new(),
        (Value::String(text), _) => text.clone(),
        (_, Some(x)) => x.to_string(),
        (other, _) => other.to_string(),
    }
}

/// A value of a spec in few characters: of a long list its length, of a body from a file its number of units, of other long lists
/// and tables the beginning, each with a short hash; of a digest the first digits.
pub fn brief(value: &Value) -> String {
    const MOST: usize = 12;
    const WIDEST: usize = 48;
    let text = plain(value);
    let named = |what: String| format!("{what} ({})", &blake3::hash(text.as_bytes()).to_hex()[..6]);
    let units = value.get("units").and_then(Value::as_array);
    match (value, units, text.char_indices().nth(WIDEST)) {
        (_, Some(units), _) => named(format!("{} units", units.len())),
        (Value::Array(numbers), ..) if numbers.len() > MOST => named(format!("{} numbers", numbers.len())),
        (Value::Array(_) | Value::Object(_), _, Some((end, _))) => named(format!("{}…", &text[..end])),
        (Value::String(digest), ..)
            if digest.len() == 64 && digest.bytes().all(|b| b.is_ascii_hexdigit()) =>
        {
            digest[..6].to_owned()
        }
        _ => text,
    }
}

/// The cell for a value of a spec: lists and tables as `text` writes them.
pub fn of_value(value: &Value, text: fn(&Value) -> String) -> Value {
    match value {
        Value::Array(_) | Value::Object(_) => text(value).into(),
        scalar => scalar.clone(),
    }
}

/// The cell as JSON that reads back as the same value: ±∞ as `9e999` and `-9e999`, as SQLite writes them.
pub fn json(cell: &Value) -> String {
    match infinite(cell) {
        Some(x) if x > 0.0 => "9e999".into(),
        Some(_) => "-9e999".into(),
        None => cell.to_string(),
    }
}
