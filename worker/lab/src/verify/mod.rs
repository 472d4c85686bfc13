//! Checks of the numerics against reference cases of an independent program, one row per quantity.
//!
//! A case is a folder with `case.json` and `.npy` arrays (f64, C order); `tests/cases/` contains examples. Unreadable cases and
//! unknown kinds fail.

use std::path::Path;

use metasense_numerics::dynamics::{Accuracy, Integrator, IntegratorSettings};
use serde::Serialize;

pub mod authors;
mod body;
mod brain;
mod case;
mod external;

use case::{Case, CaseError};
pub use external::external;

/// The default solver of a spec.
const DEFAULT: IntegratorSettings = IntegratorSettings::new(Integrator::Auto, Accuracy(1e-3));

/// One compared quantity.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparedQuantity {
    /// Name of the case, or group of checks.
    pub case: String,
    /// Compared quantity.
    pub quantity: String,
    /// Relative difference, or what `quantity` states; `None` if not finite.
    pub error: Option<f64>,
    /// Largest accepted error; `None` for a figure that is only shown.
    pub tolerance: Option<f64>,
    /// Whether the error is within the tolerance.
    pub pass: bool,
    /// Further information.
    pub note: String,
}

impl ComparedQuantity {
    /// A row that passes if `error` is at most `tolerance`; NaN fails.
    pub(crate) fn new(quantity: impl Into<String>, error: f64, tolerance: f64) -> Self {
        Self {
            case: String::new(),
            quantity: quantity.into(),
            error: error.is_finite().then_some(error),
            tolerance: Some(tolerance),
            pass: error <= tolerance,
            note: String::new(),
        }
    }

    /// A failed row for a quantity that could not be computed.
    pub(crate) fn failed(quantity: impl Into<String>) -> Self {
        Self::new(quantity, f64::NAN, 0.0)
    }

    /// A figure that is only shown; fails if it is not finite.
    pub(crate) fn shown(quantity: impl Into<String>, error: f64) -> Self {
        Self { tolerance: None, pass: error.is_finite(), ..Self::new(quantity, error, f64::INFINITY) }
    }

    pub(crate) fn noted(self, note: impl Into<String>) -> Self {
        Self { note: note.into(), ..self }
    }
}

/// Compares all cases in `folder`, in the order of their names, one row per quantity.
///
/// # Errors
/// If the folder cannot be listed or contains no folder.
pub fn cases(folder: &Path, pool: &metasense_numerics::Pool) -> Result<Vec<ComparedQuantity>, CaseError> {
    let mut rows = Vec::new();
    for folder in case::folders(folder)? {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let compared = Case::open(&folder)
            .and_then(|case| compare(&case, pool))
            .unwrap_or_else(|e| vec![ComparedQuantity::failed("case").noted(e.to_string())]);
        rows.extend(of_case(&name, compared));
    }
    Ok(rows)
}

fn of_case(name: &str, rows: Vec<ComparedQuantity>) -> Vec<ComparedQuantity> {
    rows.into_iter().map(|row| ComparedQuantity { case: name.to_string(), ..row }).collect()
}

fn compare(case: &Case, pool: &metasense_numerics::Pool) -> Result<Vec<ComparedQuantity>, CaseError> {
    match case.text("kind")? {
        "geometry" => body::geometry(case),
        "authors_trajectory" => authors::trajectory(case, pool),
        "energy" => body::energies(case),
        "trajectory" => body::trajectory(case, pool),
        "adjoint" => body::adjoint(case, pool),
        "stimuli" => body::stimuli(case),
        "cnn" => brain::network(case, pool),
        "implicit" => brain::implicit(case, pool),
        "metric" => brain::metric(case),
        kind => Err(case.wrong(format!("`kind` is \"{kind}\", which is not known"))),
    }
}

/// ‖a − b‖/‖b‖, or ‖a‖ if b is zero; infinite if lengths differ.
pub fn relative(a: &[f64], b: &[f64]) -> f64 {
    if a.len() != b.len() {
        return f64::INFINITY;
    }
    let scale = norm(b);
    let apart: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    norm(&apart) / if scale > 0.0 { scale } else { 1.0 }
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests;
