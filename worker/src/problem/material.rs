//! Mass per area, stiffness and damping of a body from its spec.

use metasense_numerics::dynamics::LigamentStiffness;
use metasense_numerics::material::{LigamentMaterial, modulus_at_rest};
use metasense_schemas::spec::{self, Material, Rubber};

use super::body::lengths;
use crate::invalid::{Invalid, absent, invalid, not_negative, positive, require};

/// Nominal stress at 100 % strain (MPa) and density (Mg/mm³) of a rubber.
fn stress_and_density(rubber: Rubber) -> (f64, f64) {
    const PSI: f64 = 6.894_757e-3;
    match rubber {
        Rubber::DragonSkin10 => (22.0 * PSI, 1.07e-9),
    }
}

/// The body with mass per area and stiffnesses in place of its material.
///
/// # Errors
/// If it has neither, or both.
pub fn sheet(body: &spec::Body) -> Result<spec::Body, Invalid> {
    let missing = |key| invalid(key, "", "must be set, unless body.material is set");
    let Some(material) = body.material else {
        body.density.ok_or_else(|| missing("body.density"))?;
        body.stiffness.ok_or_else(|| missing("body.stiffness"))?;
        return Ok(body.clone());
    };
    let remedy = "cannot be set together with body.material, which determines it";
    absent("body.density", body.density, remedy)?;
    absent("body.stiffness", body.stiffness.map(|_| "{ … }"), remedy)?;
    let Material { rubber, modulus, density, thickness, ligament_width } = material;
    let (stress, heavy) = rubber.map(stress_and_density).unzip();
    let checked_value = |key: &str, own: Option<f64>, rubber: Option<f64>| {
        let missing = || invalid(key, "", "must be set, unless body.material.rubber is set");
        let value = own.or(rubber).ok_or_else(missing)?;
        positive(key, value).map(|()| value)
    };
    let modulus = checked_value("body.material.modulus", modulus, stress.map(modulus_at_rest))?;
    let density = checked_value("body.material.density", density, heavy)?;
    positive("body.material.thickness", thickness)?;
    positive("body.material.ligament_width", ligament_width)?;
    let [_, length] = lengths(body)?;
    let ligament = LigamentMaterial { modulus, thickness, width: ligament_width, length };
    let LigamentStiffness { stretch, shear, bend } = ligament.stiffness();
    Ok(spec::Body {
        density: Some(density * thickness),
        stiffness: Some(spec::Stiffness { stretch, shear, bend }),
        material: None,
        ..body.clone()
    })
}

/// Mass per area (Mg/mm²) and stiffnesses, checked together with damping and contact. Trials contain them beside the material.
///
/// # Errors
/// If a value is missing or out of range.
pub fn material(body: &spec::Body) -> Result<(f64, LigamentStiffness), Invalid> {
    let (density, stiffness) = match body.density.zip(body.stiffness) {
        Some(both) => both,
        None => {
            let sheet = sheet(body)?;
            sheet.density.zip(sheet.stiffness).expect("a sheet has both")
        }
    };
    let spec::Stiffness { stretch, shear, bend } = stiffness;
    positive("body.density", density)?;
    not_negative("body.damping_ratio", body.damping_ratio)?;
    if let Some(damping) = body.damping {
        let sound = damping.iter().all(|c| *c >= 0.0 && c.is_finite());
        require(sound, "body.damping", format!("{damping:?}"), "must be three numbers of at least 0")?;
        let usual = body.damping_ratio == spec::Body::DAMPING_RATIO;
        require(usual, "body.damping_ratio", body.damping_ratio, "cannot be set together with body.damping")?;
    }
    positive("body.stiffness.stretch", stretch)?;
    positive("body.stiffness.shear", shear)?;
    positive("body.stiffness.bend", bend)?;
    if let Some(contact) = &body.contact {
        positive("body.contact.stiffness", contact.stiffness)?;
        let (least, cutoff) = (contact.min_angle, contact.cutoff_angle);
        let in_order = -180.0 < least && least < cutoff && cutoff < 180.0;
        let remedy = "must be less than body.contact.cutoff_angle, both within ±180 degrees";
        require(in_order, "body.contact.min_angle", least, remedy)?;
    }
    Ok((density, LigamentStiffness { stretch, shear, bend }))
}
