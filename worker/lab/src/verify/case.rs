//! Reads a reference case: `case.json` and its arrays. Every error names the file.

use std::path::{Path, PathBuf};

use metasense_numerics::body::Layout;
use metasense_numerics::dynamics::{
    AccelerationFrame, EdgeContact, Forces, LigamentStiffness, Panel, PrescribedMotion, Scene,
};
use metasense_worker::{files, polygons};
use serde_json::Value;

use super::{ComparedQuantity, relative};

/// Why a case cannot be compared.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {what}", file = file.display())]
pub struct CaseError {
    /// The file or folder.
    pub file: PathBuf,
    /// The fault.
    pub what: String,
}

fn wrong(file: &Path, what: impl ToString) -> CaseError {
    CaseError { file: file.to_owned(), what: what.to_string() }
}

/// The folders in `folder`, by name.
pub fn folders(folder: &Path) -> Result<Vec<PathBuf>, CaseError> {
    let read = |e| wrong(folder, e);
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(read)? {
        let path = entry.map_err(read)?.path();
        if path.is_dir() {
            found.push(path);
        }
    }
    if found.is_empty() {
        return Err(wrong(folder, "no case in it; a case is a folder with a case.json"));
    }
    found.sort();
    Ok(found)
}

/// Converts JSON as Python writes it: `NaN` and `Infinity` outside strings become `null`, which is then rejected as a number.
fn without_nan(text: &str) -> String {
    let parts = text.split('"').scan(false, |within, part| {
        let (plain, escaped) = (!*within, part.ends_with('\\'));
        // An escaped quote does not end a string.
        *within = if *within && escaped { true } else { !*within };
        let unnamed = || part.replace("-Infinity", "null").replace("Infinity", "null").replace("NaN", "null");
        Some(if plain { unnamed() } else { part.to_owned() })
    });
    parts.collect::<Vec<_>>().join("\"")
}

/// An opened case.
pub struct Case {
    folder: PathBuf,
    about: Value,
}

impl Case {
    pub fn open(folder: &Path) -> Result<Self, CaseError> {
        let file = folder.join("case.json");
        let text = std::fs::read_to_string(&file).map_err(|e| wrong(&file, e))?;
        let about = serde_json::from_str(&without_nan(&text)).map_err(|e| wrong(&file, e))?;
        Ok(Self { folder: folder.to_path_buf(), about })
    }

    /// An error of `case.json`.
    pub fn wrong(&self, what: impl ToString) -> CaseError {
        wrong(&self.folder.join("case.json"), what)
    }

    /// The value at `path`, whose keys and list indices are separated by dots.
    fn value<'a, T>(
        &'a self,
        path: &str,
        expected: &'static str,
        read: impl Fn(&'a Value) -> Option<T>,
    ) -> Result<T, CaseError> {
        let step = |value: &'a Value, key: &str| {
            if value.is_array() { value.get(key.parse::<usize>().ok()?) } else { value.get(key) }
        };
        let found = path.split('.').try_fold(&self.about, step).and_then(read);
        found.ok_or_else(|| self.wrong(format!("`{path}` is missing or not a {expected}")))
    }

    pub fn text(&self, path: &str) -> Result<&str, CaseError> {
        self.value(path, "text", Value::as_str)
    }

    pub fn number(&self, path: &str) -> Result<f64, CaseError> {
        self.value(path, "number", Value::as_f64)
    }

    pub fn size(&self, path: &str) -> Result<usize, CaseError> {
        self.value(path, "whole number", |v| v.as_u64().map(|n| n as usize))
    }

    pub fn flag(&self, path: &str) -> Result<bool, CaseError> {
        self.value(path, "true or false", Value::as_bool)
    }

    pub fn list(&self, path: &str) -> Result<&[Value], CaseError> {
        self.value(path, "list", |v| v.as_array().map(Vec::as_slice))
    }

    pub fn units(&self, path: &str, count: usize) -> Result<Vec<usize>, CaseError> {
        let unit = |i| self.size(&format!("{path}.{i}"));
        let units = (0..self.list(path)?.len()).map(unit).collect::<Result<Vec<_>, _>>()?;
        match units.iter().all(|&u| u < count) {
            true => Ok(units),
            false => Err(self.wrong(format!("`{path}` is not a list of units of the body"))),
        }
    }

    fn array_file(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.npy"))
    }

    /// Array `name`, flat.
    pub fn array(&self, name: &str) -> Result<Vec<f64>, CaseError> {
        let file = self.array_file(name);
        let bytes = std::fs::read(&file).map_err(|e| wrong(&file, e))?;
        Ok(files::array(&bytes).map_err(|e| wrong(&file, e))?.values)
    }

    /// Array `name`, which must contain `expected` numbers.
    pub fn array_of(&self, name: &str, expected: usize) -> Result<Vec<f64>, CaseError> {
        let values = self.array(name)?;
        match values.len() {
            found if found == expected => Ok(values),
            found => Err(wrong(&self.array_file(name), format!("{found} numbers, expected {expected}"))),
        }
    }

    /// A row that compares `ours` with array `name`.
    pub fn row(
        &self,
        quantity: &str,
        ours: &[f64],
        name: &str,
        tolerance: f64,
    ) -> Result<ComparedQuantity, CaseError> {
        Ok(ComparedQuantity::new(quantity, relative(ours, &self.array(name)?), tolerance))
    }

    /// Array `name` (…, units, 3), divided into states.
    pub fn states(&self, name: &str, units: usize) -> Result<Vec<Vec<[f64; 3]>>, CaseError> {
        let flat = self.array(name)?;
        if flat.len() % (3 * units) != 0 {
            let expected = 3 * units * flat.len().div_ceil(3 * units);
            return self.array_of(name, expected).map(|_| Vec::new());
        }
        Ok(flat.as_chunks::<3>().0.chunks(units).map(<[_]>::to_vec).collect())
    }

    pub fn scene(&self) -> Result<Scene, CaseError> {
        let number = |key: &str| self.number(&format!("scene.{key}"));
        let size = |key: &str| self.size(&format!("scene.{key}"));
        let layout = match self.about.pointer("/scene/polygons") {
            Some(given) => {
                let given = serde_json::from_value(given.clone()).map_err(|e| self.wrong(e))?;
                polygons::layout(&given).map_err(|e| self.wrong(e))?
            }
            None => Layout::planar(
                size("columns")?,
                size("rows")?,
                number("spacing")?,
                number("ligament_length")?,
            ),
        };
        let units = |key: &str| self.units(&format!("scene.{key}"), layout.units());
        let pressed = match self.about.pointer("/scene/pressed") {
            Some(ways) => serde_json::from_value(ways.clone()).map_err(|e| self.wrong(e))?,
            None => Vec::new(),
        };
        let guided = match self.about.pointer("/scene/guided") {
            Some(guided) => serde_json::from_value(guided.clone()).map_err(|e| self.wrong(e))?,
            None => Vec::new(),
        };
        let direction = [number("force_direction.0")?, number("force_direction.1")?];
        let mut panels: Vec<Panel> =
            units("panels")?.into_iter().map(|unit| Panel::central(unit, direction)).collect();
        if self.about.pointer("/scene/driven").is_some() {
            for k in self.units("scene.driven", panels.len())? {
                panels[k].moves = Some(PrescribedMotion::Unit(number("driven_mass")?));
            }
        }
        let contact = match self.flag("scene.contact")? {
            true => Some(EdgeContact {
                stiffness: number("k_contact")?,
                min_angle: number("psi_min")?,
                cutoff_angle: number("psi_cut")?,
            }),
            false => None,
        };
        Ok(Scene {
            density: number("density")?,
            stiffness: LigamentStiffness {
                stretch: number("k_stretch")?,
                shear: number("k_shear")?,
                bend: number("k_rot")?,
            },
            damping_ratio: number("zeta")?,
            contact,
            linearised: self.flag("scene.linearised")?,
            clamped: units("clamped")?,
            guided,
            imposed: pressed,
            panels,
            sensors: units("sensors")?,
            frame: if self.text("scene.frame")? == "body" {
                AccelerationFrame::Body
            } else {
                AccelerationFrame::World
            },
            duration: number("duration")?,
            instants: size("T")?,
            layout,
            ..Scene::default()
        })
    }

    pub fn design(&self, scene: &Scene) -> Result<Vec<f64>, CaseError> {
        self.array_of("alpha", scene.layout.design_len())
    }

    pub fn forces(&self, scene: &Scene) -> Result<Forces, CaseError> {
        let (samples, panels, instants) = (self.size("N")?, scene.panels.len(), scene.instants);
        let values = self.array_of("forces", samples * panels * (instants + 1))?;
        Ok(Forces { samples, panels, instants, values, strikes: Vec::new() })
    }
}

#[cfg(test)]
mod tests;
