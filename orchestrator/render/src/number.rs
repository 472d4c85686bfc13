//! Formats numbers for reading.

/// Three significant digits without trailing zeros; `–` if not finite.
pub fn number(value: f64) -> String {
    match value {
        0.0 => "0".into(),
        x if !x.is_finite() => "–".into(),
        x if !(-3..6).contains(&magnitude(x)) => format!("{x:.1e}").replace(".0e", "e"),
        x => {
            let text = digits(x, 3);
            let bare = text.trim_end_matches('0').trim_end_matches('.');
            if text.contains('.') { bare.to_owned() } else { text }
        }
    }
}

/// `count` significant digits, with trailing zeros.
pub fn digits(value: f64, count: usize) -> String {
    match value {
        0.0 => "0".into(),
        x if (1e-3..1e6).contains(&x.abs()) => {
            format!("{x:.*}", (count as i32 - 1 - magnitude(x)).max(0) as usize)
        }
        x => format!("{x:.*e}", count - 1),
    }
}

/// A duration in its two largest units.
pub fn duration(seconds: f64) -> String {
    let s = seconds.round() as u64;
    match s {
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {} s", s / 60, s % 60),
        3600..86_400 => format!("{} h {} min", s / 3600, s / 60 % 60),
        _ => format!("{} d {} h", s / 86_400, s / 3600 % 24),
    }
}

/// The power of ten of the first digit.
fn magnitude(value: f64) -> i32 {
    value.abs().log10().floor() as i32
}

#[cfg(test)]
mod tests;
