//! The work-precision diagram: rows of JSON lines as log-log panels, a column a scene, signals above dα.

use std::fmt::Write as _;
use std::path::Path;

use serde_json::Value;

use super::super::Error;
use crate::report::plot::{Axis, Plot, Scale};

/// A panel's size (px), and the room for the legend above all.
const PANEL: [f64; 2] = [310.0, 270.0];
const LEGEND: f64 = 34.0;

/// Scenes and what a panel calls them.
pub(super) const SCENES: [(&str, &str); 4] = [
    ("reference", "reference scene, 6 × 6"),
    ("contact", "contact, 8 × 4"),
    ("stretch100", "k_stretch × 100"),
    ("stretch10000", "k_stretch × 10 000"),
];
/// Integrators.
pub(super) const METHODS: [&str; 5] = ["tsit5", "leapfrog", "nystrom4", "nystrom6", "nystrom4_f32"];

/// One measured run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mark {
    pub scene: String,
    pub method: String,
    pub setting: String,
    pub auto: bool,
    /// Milliseconds a sample and error: signals forward, then dα with its sweep.
    pub points: [Option<(f64, f64)>; 2],
}

fn mark(row: &Value) -> Option<Mark> {
    let text = |key: &str| row[key].as_str().map(str::to_owned);
    // A run with the truth's own steps has no error that a logarithm could show.
    let point = |cost: &str, error: &str| {
        let error = row[error].as_f64().filter(|e| *e > 0.0)?;
        Some((row[cost].as_f64()?, error))
    };
    Some(Mark {
        scene: text("scene")?,
        method: text("method")?,
        setting: text("setting")?,
        auto: row["auto"].as_bool()?,
        points: [point("forward_ms", "signals_error"), point("gradient_ms", "gradient_error")],
    })
}

/// The newest row of each setting with so many instants.
fn newest(lines: &str, instants: u16) -> Vec<Mark> {
    let mut marks: Vec<Mark> = Vec::new();
    for line in lines.lines() {
        let Ok(row) = serde_json::from_str::<Value>(line) else { continue };
        if row["bench"] != "dynamics" || row["instants"] != instants {
            continue;
        }
        let Some(new) = mark(&row) else { continue };
        let same =
            |old: &Mark| (&old.scene, &old.method, &old.setting) == (&new.scene, &new.method, &new.setting);
        marks.retain(|old| !same(old));
        marks.push(new);
    }
    marks
}

/// Draws what `rows` holds into `picture` and returns it.
///
/// # Errors
/// Where reading or writing fails.
pub(super) fn write(rows: &Path, picture: &Path, instants: u16) -> Result<Vec<Mark>, Error> {
    let failed = |doing, path: &Path| {
        let path = path.to_owned();
        move |source| Error::Io { doing, path, source }
    };
    let lines = std::fs::read_to_string(rows).map_err(failed("reading", rows))?;
    if let Some(folder) = picture.parent() {
        std::fs::create_dir_all(folder).map_err(failed("making", folder))?;
    }
    let marks = newest(&lines, instants);
    std::fs::write(picture, draw(&marks)).map_err(failed("writing", picture))?;
    Ok(marks)
}

fn draw(marks: &[Mark]) -> String {
    let scenes: Vec<_> = SCENES.iter().filter(|(name, _)| marks.iter().any(|m| m.scene == *name)).collect();
    let [width, height] = [PANEL[0] * scenes.len().max(2) as f64, LEGEND + 2.0 * PANEL[1]];
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\">{STYLE}<rect class=\"page\" width=\"{width}\" height=\"{height}\"/>"
    );
    let mut x = 46.0;
    for (n, name) in METHODS.iter().enumerate() {
        let _ = write!(
            svg,
            "<path class=\"line c{n}\" d=\"M{x} 18h22\"/><circle class=\"dot c{n}\" cx=\"{}\" cy=\"18\" r=\"3.2\"/>\
             <text x=\"{}\" y=\"22\">{name}</text>",
            x + 11.0,
            x + 28.0
        );
        x += 118.0;
    }
    let _ = write!(
        svg,
        "<circle class=\"auto\" cx=\"{x}\" cy=\"18\" r=\"5.5\"/><text x=\"{}\" y=\"22\">auto</text>",
        x + 11.0
    );
    for (column, (scene, title)) in scenes.iter().enumerate() {
        let of: Vec<&Mark> = marks.iter().filter(|m| m.scene == *scene).collect();
        for row in 0..2 {
            let what = ["relative error of the signals", "relative error of dα"][row];
            let cost = ["forward (CPU ms a sample)", "forward and gradient (CPU ms a sample)"][row];
            let panel = panel(title, [cost, what], &of, row);
            let at = (PANEL[0] * column as f64, LEGEND + PANEL[1] * row as f64);
            let place =
                format!("<svg x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" ", at.0, at.1, PANEL[0], PANEL[1]);
            svg.push_str(&panel.replacen("<svg ", &place, 1));
        }
    }
    svg.push_str("</svg>\n");
    svg
}

fn panel(title: &str, [cost, what]: [&str; 2], marks: &[&Mark], row: usize) -> String {
    let points = || marks.iter().filter_map(|m| m.points[row]);
    // Errors above 1 are none
    let errors = || points().map(|p| p.1.min(1.0)).chain([1e-4, 1.0]);
    let decades = |low: f64| (low.log10().ceil() as i32..=0).map(|p| 10f64.powi(p)).collect::<Vec<f64>>();
    let least = errors().fold(1.0, f64::min);
    let x = Axis::new(cost, Scale::Log, points().map(|p| p.0));
    let y = Axis::new(what, Scale::Log, errors()).with_ticks(decades(least));
    let mut plot = Plot::new(title, x, y).sized(PANEL[0], PANEL[1]);
    let text = |m: &Mark, p: (f64, f64)| format!("{} {}: {:.3} ms, {:.1e}", m.method, m.setting, p.0, p.1);
    for (n, name) in METHODS.iter().enumerate() {
        let mut line: Vec<(&Mark, (f64, f64))> = marks
            .iter()
            .filter(|m| m.method == *name && !m.auto)
            .filter_map(|m| Some((*m, m.points[row]?)))
            .map(|(m, p)| (m, (p.0, p.1.min(1.0))))
            .collect();
        line.sort_by(|a, b| a.1.0.total_cmp(&b.1.0));
        let class = format!("c{n}");
        plot.line(&class, line.iter().map(|l| l.1));
        plot.dots(&class, line.iter().map(|(m, p)| (*p, text(m, *p))));
    }
    let auto = marks.iter().filter(|m| m.auto).filter_map(|m| Some((*m, m.points[row]?)));
    plot.rings("auto", auto.map(|(m, p)| (p, text(m, p))));
    plot.svg()
}

const STYLE: &str = "<style>text{font:11px sans-serif;fill:#333}.tick{font-size:9.5px}.title{font-weight:bold}.page{fill:#fff}\
    .grid{stroke:#e4e4e4;fill:none}.axis{stroke:#333;fill:none}.line{fill:none;stroke-width:1.8}\
    .line.c0{stroke:#777}.line.c1{stroke:#a80}.line.c2{stroke:#48a}.line.c3{stroke:#c44}.line.c4{stroke:#3a6}\
    .dot.c0{fill:#777}.dot.c1{fill:#a80}.dot.c2{fill:#48a}.dot.c3{fill:#c44}.dot.c4{fill:#3a6}\
    .auto{fill:none;stroke:#111;stroke-width:1.6}</style>";

#[cfg(test)]
mod tests {
    use super::*;

    fn row(method: &str, setting: &str, milliseconds: f64) -> String {
        format!(
            "{{\"bench\":\"dynamics\",\"instants\":200,\"scene\":\"contact\",\"method\":\"{method}\",\
             \"setting\":\"{setting}\",\"auto\":false,\"forward_ms\":{milliseconds},\"gradient_ms\":3,\
             \"signals_error\":1e-3,\"gradient_error\":null}}"
        )
    }

    /// A run that is measured again replaces what it measured before; other lines of the file are left out.
    #[test]
    fn the_newest_row_of_each_setting_is_drawn() {
        let lines =
            [row("tsit5", "1e-6", 8.0), "{\"bench\":\"brain\"}".into(), row("leapfrog", "9 steps", 2.0)]
                .into_iter()
                .chain([row("tsit5", "1e-6", 4.0)])
                .collect::<Vec<_>>()
                .join("\n");
        let marks = newest(&lines, 200);
        assert_eq!(marks.len(), 2, "{marks:?}");
        assert_eq!(marks[1].points, [Some((4.0, 1e-3)), None], "{marks:?}");
        assert!(newest(&lines, 20).is_empty());
        let svg = draw(&marks);
        assert!(svg.contains("contact, 8 × 4") && !svg.contains("reference scene"), "{svg}");
    }
}
