//! Checks of the maths against reference cases made by an independent program: one row a quantity.
//!
//! A case is a folder with `case.json` and `.npy` arrays (f64, C order; `tests/cases/` holds some). What can't be read,
//! or is of a kind that is not known, is a failure.

mod body;
mod brain;
mod case;
mod checks;
mod extreme;

use case::{Case, CaseError};
pub use checks::{bells, reference};
use metasense_numerics::dynamics::{Accuracy, Method, Solver, Tolerance};
use serde::Serialize;
use std::path::Path;

/// What a spec gets that says nothing.
const DEFAULT: Solver = Solver::new(Method::Auto, Accuracy(1e-3));

/// One quantity compared.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The case, or the group of checks.
    pub case: String,
    /// What was compared.
    pub quantity: String,
    /// Relative distance, or whatever `quantity` says; absent where nothing came out.
    pub error: Option<f64>,
    /// The largest error that passes; absent where a figure is only shown.
    pub tolerance: Option<f64>,
    /// Within the tolerance.
    pub pass: bool,
    /// What else there is to say.
    pub note: String,
}

impl Row {
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

    /// A row of a quantity that could not be found.
    pub(crate) fn failed(quantity: impl Into<String>) -> Self {
        Self::new(quantity, f64::NAN, 0.0)
    }

    /// A figure that decides nothing, unless it is not a number.
    pub(crate) fn shown(quantity: impl Into<String>, error: f64) -> Self {
        Self { tolerance: None, pass: error.is_finite(), ..Self::new(quantity, error, f64::INFINITY) }
    }

    pub(crate) fn noted(self, note: impl Into<String>) -> Self {
        Self { note: note.into(), ..self }
    }
}

/// The cases below `folder`, in the order of their names; each as a row a quantity.
///
/// # Errors
/// If the folder can't be listed or holds no folder.
pub fn cases(folder: &Path, pool: &metasense_numerics::Pool) -> Result<Vec<Row>, CaseError> {
    let mut rows = Vec::new();
    for folder in case::folders(folder)? {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let compared = Case::open(&folder)
            .and_then(|case| compare(&case, pool))
            .unwrap_or_else(|e| vec![Row::failed("case").noted(e.to_string())]);
        rows.extend(of_case(&name, compared));
    }
    Ok(rows)
}

/// Energy balance, Taylor tests and equal bits of every integrator.
pub fn numerics(pool: &metasense_numerics::Pool) -> Vec<Row> {
    let solvers = [
        Solver::tsit5(Tolerance::both(1e-11)),
        Solver::new(Method::Leapfrog, Accuracy(1e-3)),
        Solver::new(Method::Nystrom4, Accuracy(1e-6)),
        Solver::new(Method::Nystrom6, Accuracy(1e-7)),
    ];
    of_case("numerics", checks::rows(&solvers, pool))
}

/// Stiff and extreme scenes at default settings.
pub fn extremes(pool: &metasense_numerics::Pool) -> Vec<Row> {
    of_case("extreme", extreme::rows(DEFAULT, pool))
}

fn of_case(name: &str, rows: Vec<Row>) -> Vec<Row> {
    rows.into_iter().map(|row| Row { case: name.to_string(), ..row }).collect()
}

fn compare(case: &Case, pool: &metasense_numerics::Pool) -> Result<Vec<Row>, CaseError> {
    match case.text("kind")? {
        "geometry" => body::geometry(case),
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

/// ‖a − b‖/‖b‖, or ‖a‖ where b is zero; infinite where lengths differ.
#[must_use]
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
mod tests {
    use super::*;

    fn pool() -> metasense_numerics::Pool {
        metasense_numerics::Pool::new(2).expect("threads")
    }

    fn hold(rows: &[Row], at_least: usize) {
        let failed: Vec<&Row> = rows.iter().filter(|row| !row.pass).collect();
        assert!(failed.is_empty() && rows.len() >= at_least, "{} rows: {failed:#?}", rows.len());
    }

    /// These and the next: every row that `metasense verify` prints.
    #[test]
    fn every_integrator_is_what_it_says() {
        hold(&numerics(&pool()), 30);
    }

    #[test]
    fn extreme_scenes_are_solved_at_default_settings() {
        hold(&extremes(&pool()), 17);
    }

    /// Every committed case, every quantity.
    #[test]
    fn the_committed_cases_hold() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/cases");
        let rows = cases(Path::new(folder), &pool()).expect("cases");
        let kinds: std::collections::BTreeSet<&str> =
            rows.iter().filter_map(|r| r.case.split('_').next()).collect();
        assert_eq!(kinds.len(), 8, "{kinds:?}");
        hold(&rows, kinds.len());
    }

    /// A folder without a case, broken JSON, an unknown kind, a missing array, an array cut short, a wrong number: each
    /// is a row that fails, and the rest goes on.
    #[test]
    fn what_cannot_be_read_or_does_not_agree_fails() {
        let folder = tempfile::tempdir().expect("folder");
        let metric = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/cases/metric_p"));
        let make = |name: &str, spoil: &dyn Fn(&Path)| {
            let to = folder.path().join(name);
            std::fs::create_dir(&to).expect("folder");
            for file in std::fs::read_dir(metric).expect("case").map(|f| f.expect("file").path()) {
                std::fs::copy(&file, to.join(file.file_name().expect("name"))).expect("copy");
            }
            spoil(&to);
        };
        let write = |to: &Path, bytes: &[u8]| std::fs::write(to, bytes).expect("write");
        make("a_good", &|_| ());
        make("b_no_json", &|to| std::fs::remove_file(to.join("case.json")).expect("remove"));
        make("c_broken", &|to| write(&to.join("case.json"), b"{"));
        make("d_unknown", &|to| write(&to.join("case.json"), br#"{"kind": "weather"}"#));
        make("e_missing", &|to| std::fs::remove_file(to.join("force.npy")).expect("remove"));
        make("f_short", &|to| {
            let bytes = std::fs::read(to.join("force.npy")).expect("read");
            write(&to.join("force.npy"), &bytes[..bytes.len() - 8]);
        });
        make("g_wrong", &|to| {
            std::fs::copy(to.join("force.npy"), to.join("predicted.npy")).expect("copy");
        });
        let rows = cases(folder.path(), &pool()).expect("cases");
        let verdict = |name: &str| rows.iter().filter(|r| r.case.starts_with(name)).all(|r| r.pass);
        assert!(verdict("a_"), "{rows:#?}");
        assert!(["b_", "c_", "d_", "e_", "f_", "g_"].iter().all(|name| !verdict(name)), "{rows:#?}");
        assert!(cases(&folder.path().join("nowhere"), &pool()).is_err());
    }
}
