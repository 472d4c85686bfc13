//! Files of twins, and the casts that they describe.

use std::path::Path;

use metasense_numerics::dynamics::{Parameters, PartFactors};
pub use metasense_numerics::identify::Twin;
use metasense_numerics::variation::{Cast, Chips};
use metasense_schemas::spec::TrialSpec;
use metasense_source::Source;
use metasense_worker::invalid::{Invalid, invalid, positive, require};

use crate::measured::MeasuredError;
use crate::simulate::body;

pub mod stored;

use stored::Factors;

/// Converts a twin to its stored form.
pub fn store(trial: &TrialSpec, design: &[f64], twin: &Twin) -> stored::TwinFile {
    let Cast { material, parts, ligament_length, shifts, chips, .. } = &twin.cast;
    let [stretch, shear, bend, damping, density, contact] = material.array();
    stored::TwinFile {
        body: trial.body_digest(design),
        misfit: twin.misfit,
        noise: twin.noise.clone(),
        ligament_length: *ligament_length,
        gain: chips.gain.clone(),
        turn: chips.turn.iter().map(|turn| turn.to_degrees()).collect(),
        shifts: shifts.clone(),
        ligaments: parts.ligaments.clone(),
        units: parts.units.clone(),
        material: Factors { stretch, shear, bend, damping, density, contact },
    }
}

/// Reads a twin from a file.
///
/// # Errors
/// Names file, key and value of what is invalid or belongs to another body.
pub fn read(file: &Path, trial: &TrialSpec, design: &[f64]) -> Result<Twin, MeasuredError> {
    let text = std::fs::read_to_string(file)
        .map_err(|source| MeasuredError::Unreadable { path: file.to_owned(), source })?;
    parse(&Source::new(file, text)?, trial, design)
}

/// Parses a twin.
///
/// # Errors
/// As [`read`].
pub fn parse(source: &Source, trial: &TrialSpec, design: &[f64]) -> Result<Twin, MeasuredError> {
    let stored: stored::TwinFile = source.parse()?;
    checked(stored, trial, design).map_err(|Invalid { key, value, remedy }| {
        MeasuredError::Spec(source.error_with(&key, Some(&value), &remedy))
    })
}

fn checked(twin: stored::TwinFile, trial: &TrialSpec, design: &[f64]) -> Result<Twin, Invalid> {
    let stored::TwinFile {
        body: digest,
        misfit,
        noise,
        ligament_length,
        gain,
        turn,
        shifts,
        ligaments,
        units,
        material,
    } = twin;
    let remedy =
        "belongs to another body: its spec, its sensors' units or its design differ from those of the fit";
    require(digest == trial.body_digest(design), "body", &digest, remedy)?;
    let (layout, _) = body(trial).map_err(|e| invalid("body", &digest, e.to_string()))?;
    let (sensors, read) = (trial.point.sensors, trial.signals());
    let remedy = format!("must have {read} entries, one per signal");
    require(noise.len() == read, "noise", format!("{} entries", noise.len()), &remedy)?;
    for (key, given, own) in [
        ("gain", gain.len(), 3 * sensors),
        ("turn", turn.len(), sensors),
        ("shifts", shifts.len(), layout.design_len()),
        ("ligaments", ligaments.len(), layout.ligaments.len()),
        ("units", units.len(), layout.units()),
    ] {
        let remedy = format!("must have {own} entries, or be left out");
        require(given == 0 || given == own, key, format!("{given} entries"), &remedy)?;
    }
    let Factors { stretch, shear, bend, damping, density, contact } = material;
    let factors = [stretch, shear, bend, damping, density, contact];
    let names = ["stretch", "shear", "bend", "damping", "density", "contact"];
    for (name, factor) in names.into_iter().zip(factors) {
        positive(&format!("material.{name}"), factor)?;
    }
    positive("ligament_length", ligament_length)?;
    for (key, all) in
        [("noise", &noise[..]), ("gain", &gain), ("ligaments", ligaments.as_flattened()), ("units", &units)]
    {
        all.iter().try_for_each(|factor| positive(key, *factor))?;
    }
    for (key, all) in [("turn", &turn), ("shifts", &shifts)] {
        all.iter().try_for_each(|x| require(x.is_finite(), key, x, "must be a number"))?;
    }
    let turn = turn.into_iter().map(f64::to_radians).collect();
    let (material, relaxation) = (Parameters::from_array(factors), None);
    let parts = PartFactors { ligaments, units };
    let cast = Cast { material, parts, ligament_length, relaxation, shifts, chips: Chips { gain, turn } };
    Ok(Twin { cast, misfit, noise })
}

#[cfg(test)]
mod tests;
