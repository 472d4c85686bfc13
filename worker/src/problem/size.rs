//! Scales a body to a given size: the same sheet, divided into more or fewer units.
//!
//! ```text
//! s = diameter / (columns · spacing)      lengths × s      k_θ, k_c × s²      Adam's rate on α × s
//! ```
//! A ligament of width w and length l in a sheet of thickness t has k_l ~ E t w/l and k_s ~ E t (w/l)³, which scaling keeps,
//! and k_θ ~ E t w³/l. The disc thus keeps its mass and its resistance to deformation; only its units become smaller. The
//! formulas of a material ([`sheet`]) use the lengths as written.

use metasense_schemas::spec::{Body, LayoutKind, SweepSpec};

use super::sheet;
use crate::invalid::{Invalid, absent, positive};

/// The spec with the lengths for `body.diameter` or `body.width` and the properties of `body.material`; and the scale s.
///
/// # Errors
/// If a size is invalid or belongs to the other layout; if the material is missing or given twice.
pub fn scale_to_size(spec: &SweepSpec) -> Result<(SweepSpec, f64), Invalid> {
    // keep the material, which says what to cast
    let body = Body { material: spec.body.material, ..sheet(&spec.body)? };
    let mut spec = SweepSpec { body, ..spec.clone() };
    let body = &mut spec.body;
    let (diameter, width) = (body.diameter.take(), body.width.take());
    let (key, size) = match body.layout {
        LayoutKind::Circular => {
            absent("body.width", width, "only for planar bodies; use body.diameter for a circular body")?;
            ("body.diameter", diameter)
        }
        LayoutKind::Planar => {
            absent("body.diameter", diameter, "only for circular bodies; use body.width for a planar body")?;
            ("body.width", width)
        }
    };
    let Some(size) = size else { return Ok((spec, 1.0)) };
    positive(key, size)?;
    let scale = size / (body.columns() as f64 * body.lengths()[0]);
    for length in [&mut body.spacing, &mut body.ligament_length].into_iter().flatten() {
        *length *= scale;
    }
    if let Some(material) = &mut body.material {
        material.ligament_width *= scale;
    }
    if let Some(stiffness) = &mut body.stiffness {
        stiffness.bend *= scale * scale;
    }
    if let Some(contact) = &mut body.contact {
        contact.stiffness *= scale * scale;
    }
    let limits = &mut spec.feasible;
    for length in [&mut limits.min_edge, &mut limits.clearance, &mut limits.ligament_clearance] {
        *length *= scale;
    }
    Ok((spec, scale))
}
