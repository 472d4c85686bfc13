//! Conclusions from the diagram: the cheapest method at an error of 1e-3, the choice of `auto`, and Tsit5 at equal error.

use super::picture::{METHODS, MeasuredRun, SCENES};

/// Requested error.
const ASKED: f64 = 1e-3;

/// One line per measured scene and quantity.
pub(super) fn lines(marks: &[MeasuredRun]) -> Vec<String> {
    let mut lines = Vec::new();
    for (scene, title) in SCENES {
        let of: Vec<&MeasuredRun> = marks.iter().filter(|m| m.scene == scene).collect();
        for (row, what) in ["signals", "dα"].into_iter().enumerate() {
            lines.extend(judge(&of, row).map(|said| format!("{title}, {what}: {said}")));
        }
    }
    lines
}

fn judge(marks: &[&MeasuredRun], row: usize) -> Option<String> {
    let curve = |name: &str| curve(marks, name, row);
    let smallest_error = |points: &[(f64, f64)]| points.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let tsit5 = curve("tsit5");
    // The smallest error that Tsit5 and another method both reach, at least 1e-3
    let others = METHODS.iter().filter(|name| **name != "tsit5");
    let reached = others.clone().map(|name| smallest_error(&curve(name))).fold(f64::INFINITY, f64::min);
    let error = ASKED.max(reached).max(smallest_error(&tsit5));
    if !error.is_finite() {
        return None;
    }
    let costs = others.filter_map(|name| Some((*name, cost(&curve(name), error)?)));
    let (name, cheapest) = costs.min_by(|a, b| a.1.total_cmp(&b.1))?;
    let reference = cost(&tsit5, error)?;
    let auto = marks.iter().find(|m| m.auto && m.setting.starts_with("auto 1e-3"));
    let auto = auto.and_then(|m| m.points[row]).map(|(cost, error)| {
        format!("; auto {cost:.3} ms at {error:.1e}, {:.2} of the cheapest", cost / cheapest)
    });
    let at =
        if error > ASKED { " (the smallest error that Tsit5 and another method both reach)" } else { "" };
    Some(format!(
        "at {error:.1e}{at} {name} {cheapest:.3} ms, tsit5 {reference:.3} ms, {:.2} times as long{}",
        reference / cheapest,
        auto.unwrap_or_default()
    ))
}

/// Milliseconds and errors of a method, cheapest first.
fn curve(marks: &[&MeasuredRun], method: &str, row: usize) -> Vec<(f64, f64)> {
    let of = marks.iter().filter(|m| m.method == method && !m.auto);
    let mut points: Vec<(f64, f64)> = of.filter_map(|m| m.points[row]).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    points
}

/// Cost at an error, by linear interpolation of logarithms; the cost of the first point if its error is smaller.
fn cost(curve: &[(f64, f64)], error: f64) -> Option<f64> {
    let first = curve.iter().position(|p| p.1 <= error)?;
    let (cost, there) = curve[first];
    let Some((before, off)) = first.checked_sub(1).map(|i| curve[i]) else { return Some(cost) };
    let part = (off / error).ln() / (off / there).ln();
    Some(before * (cost / before).powf(part))
}

#[cfg(test)]
mod tests;
