//! A body as SVG: units, ligaments, constraints at their limit, panels with the direction of the blow, sensors.

use std::fmt::Write as _;

use metasense_worker::replay::Drawing;

use crate::draw::mark;

/// Where a drawing lies on the page: x to the right, y downward, in mm.
#[derive(Debug, Clone, Copy)]
pub struct Frame {
    /// Left, top, width, height of the view box (mm).
    pub view: [f64; 4],
}

impl Frame {
    /// A frame around all of these bodies, so that they are drawn alike.
    #[must_use]
    pub fn around(drawings: &[&Drawing]) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for corner in drawings.iter().flat_map(|d| d.units.iter().flatten()) {
            for i in 0..2 {
                low[i] = low[i].min(corner[i]);
                high[i] = high[i].max(corner[i]);
            }
        }
        let air = 0.75 * drawings.first().map_or(1.0, |d| d.spacing);
        Self {
            view: [low[0] - air, -high[1] - air, high[0] - low[0] + 2.0 * air, high[1] - low[1] + 2.0 * air],
        }
    }

    /// The opening tag of an SVG element that shows it.
    #[must_use]
    pub fn open(&self, label: &str) -> String {
        let [x, y, width, height] = self.view;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"body\" viewBox=\"{x:.2} {y:.2} {width:.2} {height:.2}\" role=\"img\" aria-label=\"{}\">",
            super::plot::escape(label)
        )
    }
}

/// Corners as the value of a polygon's `points`.
#[must_use]
pub fn points(corners: &[[f64; 2]]) -> String {
    corners.iter().map(|[x, y]| format!("{x:.3},{:.3}", -y)).collect::<Vec<_>>().join(" ")
}

/// The whole drawing. `fill` gives each unit's extra attributes (a style, an id).
#[must_use]
pub fn svg(drawing: &Drawing, frame: &Frame, label: &str, fill: impl Fn(usize) -> String) -> String {
    let mut svg = frame.open(label);
    for [[ax, ay], [bx, by]] in &drawing.ligaments {
        let _ = write!(svg, "<path class=\"ligament\" d=\"M{ax:.3} {:.3}L{bx:.3} {:.3}\"/>", -ay, -by);
    }
    for (i, unit) in drawing.units.iter().enumerate() {
        let class = if drawing.clamped.contains(&i) { "unit clamped" } else { "unit" };
        let _ = write!(svg, "<polygon class=\"{class}\" points=\"{}\"{}/>", points(unit), fill(i));
    }
    let turned: Vec<[[f64; 2]; 4]> = drawing.units.iter().map(|u| u.map(|[x, y]| [x, -y])).collect();
    for active in &drawing.active {
        mark(active.kind, active.units, Some(active.node), ["active", "active-node"], &turned, &mut svg);
    }
    svg.push_str(&marks(drawing));
    svg.push_str("</svg>");
    svg
}

/// Arrows at the panels and dots at the sensors.
#[must_use]
pub fn marks(drawing: &Drawing) -> String {
    let mut svg = String::new();
    let pitch = drawing.spacing;
    for (k, &(unit, [dx, dy])) in drawing.panels.iter().enumerate() {
        let [x, y] = drawing.centroids[unit];
        // The arrow ends at the unit's middle and begins outside.
        let (x, y, dx, dy) = (x, -y, dx, -dy);
        let (tail, neck) =
            ([x - 0.95 * pitch * dx, y - 0.95 * pitch * dy], [x - 0.3 * pitch * dx, y - 0.3 * pitch * dy]);
        let (wx, wy) = (-0.14 * pitch * dy, 0.14 * pitch * dx);
        let _ = write!(
            svg,
            "<g class=\"panel\"><title>panel {k}: unit {unit}</title><path d=\"M{:.2} {:.2}L{:.2} {:.2}\"/><polygon points=\"{:.2},{:.2} {:.2},{:.2} {x:.2},{y:.2}\"/></g>",
            tail[0],
            tail[1],
            neck[0],
            neck[1],
            neck[0] + wx,
            neck[1] + wy,
            neck[0] - wx,
            neck[1] - wy
        );
    }
    for (m, &unit) in drawing.sensors.iter().enumerate() {
        let [x, y] = drawing.centroids[unit];
        let _ = write!(
            svg,
            "<circle class=\"sensor\" cx=\"{x:.2}\" cy=\"{:.2}\" r=\"{:.2}\"><title>sensor {m}: unit {unit}</title></circle>",
            -y,
            0.17 * pitch
        );
    }
    svg
}

#[cfg(test)]
mod tests {
    use metasense_worker::design::{Active, Kind};

    use super::*;
    use crate::export::outline::tests::squares;

    /// A gap as a line between its units, an angle as a dot at its corner; y downward.
    #[test]
    fn what_holds_a_body_is_drawn_where_it_is() {
        let mut drawing = squares();
        let [x, y] = drawing.units[4][2];
        let held = |kind, units| Active { kind, units, node: 2, slack: 0.0 };
        drawing.active = vec![held(Kind::Clearance, [4, 5]), held(Kind::BlockAngleLow, [4, 4])];
        let svg = svg(&drawing, &Frame::around(&[&drawing]), "", |_| String::new());
        assert_eq!(svg.matches("class=\"active\"").count(), 1, "{svg}");
        let dot = format!("class=\"active-node\" cx=\"{x:.3}\" cy=\"{:.3}\"", -y);
        assert!(svg.contains(&dot), "{dot} is not in {svg}");
    }
}
