//! Ligaments and material with which a cast body has the simulated stiffnesses: MODEL.md, Material.

use metasense_lab::prepare::prepared;
use metasense_lab::replay::{Drawing, drawing};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::problem::{LigamentMaterial, material, shore_a};
use metasense_worker::run::NoResult;

use super::outline::{Mould, NoOutline, Outline};
use crate::look::{digits, number};

/// Ligaments and material of a cast body. Lengths in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CastMaterial {
    /// The ligament of mean length that has the model's stiffnesses in stretch and bending.
    pub ligament: LigamentMaterial,
    /// The model's stiffness in shear (N/mm).
    shear: f64,
    /// The model's mass per area (Mg/mm²).
    density: f64,
    /// Lengths of the shortest and the longest ligament.
    lengths: [f64; 2],
    /// The shortest edge of a unit at the end of a ligament.
    edge: f64,
    /// The ligament length for which `body.material` gives stiffnesses.
    nominal: Option<f64>,
}

/// Relative difference of a stiffness above which there is a warning.
const TOLERANCE: f64 = 0.05;
/// Rules of thumb for soft silicone: ligaments thinner than this (mm), or than this fraction of the height, tear when they leave
/// the mould.
const THINNEST: f64 = 1.0;
const SLENDEREST: f64 = 0.1;

impl CastMaterial {
    /// For a body of this height.
    ///
    /// # Errors
    /// If the spec has no valid material.
    pub fn new(spec: &TrialSpec, drawing: &Drawing, height: f64) -> Result<Self, NoResult> {
        let (density, stiffness) = material(&spec.body).map_err(|e| NoResult::Rejected(e.to_string()))?;
        let distance = |[a, b]: [[f64; 2]; 2]| (b[0] - a[0]).hypot(b[1] - a[1]);
        let lengths = || drawing.ligaments.iter().copied().map(distance);
        let mean = lengths().sum::<f64>() / drawing.ligaments.len() as f64;
        let ligament = LigamentMaterial::of(&stiffness, mean, height);
        let edges = drawing.joints.iter().flatten().flat_map(|&(unit, p)| {
            let corners = &drawing.units[unit];
            let n = corners.len();
            [(p, (p + 1) % n), ((p + n - 1) % n, p)].map(|(a, b)| distance([corners[a], corners[b]]))
        });
        let lengths = [lengths().fold(f64::INFINITY, f64::min), lengths().fold(0.0, f64::max)];
        let edge = edges.fold(f64::INFINITY, f64::min);
        let nominal = spec.body.material.map(|_| spec.body.lengths()[1]);
        Ok(Self { ligament, shear: stiffness.shear, density, lengths, edge, nominal })
    }

    fn outline(&self, drawing: &Drawing) -> Result<Outline, NoOutline> {
        let (width, pocket) = (self.ligament.width, None);
        Outline::new(drawing, &Mould { width, height: 1.0, wall: 1.0, clearance: 0.0, pocket })
    }

    /// Requirements for a cast to move as simulated, one sentence each.
    pub fn needs(&self, drawing: &Drawing) -> Vec<String> {
        let Self { ligament: LigamentMaterial { modulus, thickness, width, length }, density, .. } = *self;
        let hardness = match shore_a(modulus) {
            s if s < 0.0 => "softer than Shore A 0".to_owned(),
            s => format!("about Shore A {s:.0}"),
        };
        let (grams, per_ml) = (1e6 * density * drawing.area(), 1e9 * density / thickness);
        let size = [0, 1].map(|d| {
            let all = || drawing.units.iter().flatten().map(|corner| corner[d]);
            number(all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min))
        });
        let mut said = vec![
            format!("The body measures {} × {} × {} mm.", size[0], size[1], number(thickness)),
            format!(
                "Ligaments are {} mm wide and {} mm long: the beams that have the stretch and bending stiffness of the model, with \
                 E·t = {} N/mm (MODEL.md, Material).",
                digits(width, 4),
                digits(length, 4),
                digits(modulus * thickness, 4)
            ),
            format!(
                "At this height, the material needs E = {} MPa at small strain ({hardness}; Gent 1958, doi:10.5254/1.3542351, for \
                 Shore A 20 to 80) and {} g/ml.",
                digits(modulus, 4),
                digits(per_ml, 4)
            ),
        ];
        if let Ok(outline) = self.outline(drawing) {
            let added = outline.area() - drawing.area();
            said.push(format!(
                "The units weigh {} g. The ligaments add {} g ({} %), which the model does not count: cast a material of {} g/ml, or \
                 train with a density greater by the factor {}.",
                number(grams),
                number(1e6 * density * added),
                number(100.0 * added / drawing.area()),
                number(per_ml * drawing.area() / (drawing.area() + added)),
                number((drawing.area() + added) / drawing.area())
            ));
        }
        said
    }

    /// Reasons why a cast cannot move as simulated, or is hard to cast.
    pub fn warnings(&self, drawing: &Drawing) -> Vec<String> {
        let Self { ligament, shear, lengths: [short, long], nominal, .. } = *self;
        let LigamentMaterial { thickness, width, length, .. } = ligament;
        let beam = ligament.stiffness().shear;
        let mut said = Vec::new();
        if (beam / shear - 1.0).abs() > TOLERANCE {
            said.push(format!(
                "a straight ligament of this width has a shear stiffness of {} N/mm, the model {}; the cast moves as simulated only after \
                 training with body.stiffness.shear = {}",
                number(beam),
                number(shear),
                number(beam)
            ));
        }
        if long / short - 1.0 > TOLERANCE {
            said.push(format!(
                "ligaments are {} to {} mm long, and the model gives all the same stiffness; in one material the shortest are stiffer by a \
                 factor of {}",
                number(short),
                number(long),
                number(long / short)
            ));
        }
        if let Some(nominal) = nominal.filter(|nominal| (length / nominal - 1.0).abs() > TOLERANCE) {
            said.push(format!(
                "body.material counts ligaments as {} mm long, which are {} mm long here; the stiffnesses of the model need E times {}",
                number(nominal),
                number(length),
                number(length / nominal)
            ));
        }
        if width < THINNEST || width < SLENDEREST * thickness {
            said.push(format!(
                "ligaments {} mm wide and {} mm high are thinner than {THINNEST} mm or {SLENDEREST} of the height: they may tear when \
                 taken out of the mould",
                number(width),
                number(thickness)
            ));
        }
        if width > length {
            said.push(format!(
                "ligaments {} mm wide are wider than long ({} mm): corners of units yield, and the cast is softer than these formulas",
                number(width),
                number(length)
            ));
        }
        match self.merged(drawing) {
            0 => {}
            n => said.push(format!(
                "{n} of {} ligaments merge with a unit or another ligament along half their length or more, and are stiffer than simulated; \
                 feasible.min_ligament_angle and feasible.ligament_clearance keep them apart in training",
                drawing.ligaments.len()
            )),
        }
        said.extend(self.too_wide());
        said
    }

    /// Number of ligaments with a side whose midpoint lies within a unit or another ligament.
    fn merged(&self, drawing: &Drawing) -> usize {
        let half = 0.5 * self.ligament.width;
        let ligaments = || drawing.ligaments.iter().enumerate();
        let merges = |&(l, &[[ax, ay], [bx, by]]): &(usize, &[[f64; 2]; 2])| {
            let scale = half / (bx - ax).hypot(by - ay);
            [-scale, scale].iter().any(|s| {
                let side = [0.5 * (ax + bx) - s * (by - ay), 0.5 * (ay + by) + s * (bx - ax)];
                drawing.units.iter().any(|unit| contains(unit, side))
                    || ligaments().any(|(other, ends)| other != l && distance(side, *ends) < half)
            })
        };
        ligaments().filter(merges).count()
    }

    /// A message if ligaments are wider than an edge beside them.
    fn too_wide(&self) -> Option<String> {
        let [width, edge] = [self.ligament.width, self.edge].map(number);
        let said = format!("ligaments {width} mm wide are wider than the edge beside them ({edge} mm)");
        (self.ligament.width > self.edge).then_some(said)
    }
}

/// Whether a polygon contains a point.
fn contains(polygon: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let crosses = |&i: &usize| {
        let ([ax, ay], [bx, by]) = (polygon[i], polygon[(i + 1) % polygon.len()]);
        (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax)
    };
    (0..polygon.len()).filter(crosses).count() % 2 == 1
}

/// Distance of a point from the segment between two others (mm).
fn distance([x, y]: [f64; 2], [[ax, ay], [bx, by]]: [[f64; 2]; 2]) -> f64 {
    let (dx, dy) = (bx - ax, by - ay);
    let along = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy);
    let along = along.clamp(0.0, 1.0);
    (x - ax - along * dx).hypot(y - ay - along * dy)
}

/// Why no cast body can have the stiffnesses of a trial's initial body.
pub fn impossible(spec: &TrialSpec) -> Option<String> {
    let body = drawing(spec, &prepared(spec).ok()?.initial).ok()?;
    let cast = CastMaterial::new(spec, &body, 1.0).ok()?;
    let why = cast.too_wide().or_else(|| match cast.outline(&body) {
        Err(NoOutline::TooWide { left, voids, .. }) => Some(format!(
            "ligaments {} mm wide leave {left} of the body's {voids} voids",
            number(cast.ligament.width)
        )),
        _ => None,
    })?;
    let key = match spec.body.material {
        Some(_) => "reduce body.material.ligament_width",
        None => "width √(12 bend/stretch); reduce body.stiffness.bend or increase stretch",
    };
    Some(format!("no cast body has the stiffnesses of the model: {why}; {key}"))
}
