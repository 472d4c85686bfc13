//! A body as DXF (R12, ASCII, mm): closed polylines on the layers `units`, `ligaments`, `panels`, `sensors`.
//!
//! A ligament is a rectangle of its width. A panel is the outline of its unit. A sensor is a circle of 24 corners about its unit's
//! centroid. `holes` has screw holes as circles, `notes` the numbers of units and a scale bar.

use std::fmt::Write as _;

use metasense_lab::replay::Drawing;

use super::outline::{HOLE, screwed};

/// Layers with their colour numbers.
const LAYERS: [(&str, u8); 6] =
    [("units", 7), ("ligaments", 8), ("panels", 4), ("sensors", 1), ("holes", 2), ("notes", 3)];

/// The drawing; `width` of ligaments and `radius` of sensors in mm.
pub fn dxf(drawing: &Drawing, width: f64, radius: f64) -> String {
    let mut text =
        String::from("0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n");
    let _ = write!(text, "0\nSECTION\n2\nTABLES\n0\nTABLE\n2\nLAYER\n70\n{}\n", LAYERS.len());
    for (layer, colour) in LAYERS {
        let _ = write!(text, "0\nLAYER\n2\n{layer}\n70\n0\n62\n{colour}\n6\nCONTINUOUS\n");
    }
    text.push_str("0\nENDTAB\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n");
    for unit in &drawing.units {
        polyline(&mut text, "units", unit);
    }
    for &[a, b] in &drawing.ligaments {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let half = 0.5 * width / dx.hypot(dy);
        let (nx, ny) = (-half * dy, half * dx);
        let corners =
            [[a[0] - nx, a[1] - ny], [b[0] - nx, b[1] - ny], [b[0] + nx, b[1] + ny], [a[0] + nx, a[1] + ny]];
        polyline(&mut text, "ligaments", &corners);
    }
    for (panel, _) in &drawing.panels {
        polyline(&mut text, "panels", &drawing.units[panel.unit]);
    }
    for unit in &drawing.sensors {
        let [x, y] = drawing.centroids[*unit];
        let turns = (0..24).map(|i| (f64::from(i) * std::f64::consts::TAU / 24.0).sin_cos());
        let circle: Vec<[f64; 2]> = turns.map(|(sin, cos)| [x + radius * cos, y + radius * sin]).collect();
        polyline(&mut text, "sensors", &circle);
    }
    for unit in screwed(drawing) {
        let [x, y] = drawing.centroids[unit];
        let _ = write!(text, "0\nCIRCLE\n8\nholes\n10\n{x:.9}\n20\n{y:.9}\n30\n0.0\n40\n{}\n", 0.5 * HOLE);
    }
    let tall = 0.1 * drawing.spacing;
    for (unit, at) in drawing.centroids.iter().enumerate() {
        note(&mut text, *at, tall, &unit.to_string());
    }
    let corners = || drawing.units.iter().flatten();
    let [left, below] = [0, 1].map(|d| corners().map(|q| q[d]).fold(f64::INFINITY, f64::min));
    let bar = 10f64.powf(drawing.spacing.log10().floor());
    let y = below - 4.0 * tall;
    polyline(&mut text, "notes", &[[left, y], [left + bar, y], [left + bar, y - tall], [left, y - tall]]);
    note(&mut text, [left, y + tall], tall, &format!("{bar} mm"));
    text.push_str("0\nENDSEC\n0\nEOF\n");
    text
}

fn note(text: &mut String, [x, y]: [f64; 2], tall: f64, what: &str) {
    let _ = write!(text, "0\nTEXT\n8\nnotes\n10\n{x:.9}\n20\n{y:.9}\n30\n0.0\n40\n{tall:.3}\n1\n{what}\n");
}

fn polyline(text: &mut String, layer: &str, corners: &[[f64; 2]]) {
    let _ = write!(text, "0\nPOLYLINE\n8\n{layer}\n66\n1\n70\n1\n10\n0.0\n20\n0.0\n30\n0.0\n");
    for [x, y] in corners {
        let _ = write!(text, "0\nVERTEX\n8\n{layer}\n10\n{x:.9}\n20\n{y:.9}\n30\n0.0\n");
    }
    let _ = write!(text, "0\nSEQEND\n8\n{layer}\n");
}
