//! Reading a reference case: `case.json` and its arrays, every fault an error that names the file.

use metasense_numerics::body::Layout;
use metasense_numerics::dynamics::{Contact, Forces, Frame, Panel, Scene, Stiffness};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Why a case can't be compared.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// A file or folder can't be read.
    #[error("{file}: {source}", file = file.display())]
    Read {
        /// Which.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The folder holds no case.
    #[error("{folder}: no case in it; a case is a folder with a case.json", folder = folder.display())]
    Empty {
        /// Which.
        folder: PathBuf,
    },
    /// `case.json` is not JSON.
    #[error("{file}: {source}", file = file.display())]
    Json {
        /// Which.
        file: PathBuf,
        /// Why.
        source: serde_json::Error,
    },
    /// A key is missing or of the wrong type.
    #[error("{file}: `{key}` is missing or no {expected}", file = file.display())]
    Key {
        /// Where.
        file: PathBuf,
        /// Which.
        key: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A kind of case that nothing here compares.
    #[error("{file}: `kind` is \"{kind}\", which is not known", file = file.display())]
    Kind {
        /// Where.
        file: PathBuf,
        /// Which.
        kind: String,
    },
    /// An array's numbers stand in another order than everything else's.
    #[error("{file}: Fortran order; save it in C order (numpy.ascontiguousarray)", file = file.display())]
    Order {
        /// Which.
        file: PathBuf,
    },
    /// An array's length does not fit the case.
    #[error("{file}: {found} numbers, expected {expected}", file = file.display())]
    Length {
        /// Which array.
        file: PathBuf,
        /// Its numbers.
        found: usize,
        /// What the case says.
        expected: usize,
    },
}

/// The folders below `folder`, by name.
pub fn folders(folder: &Path) -> Result<Vec<PathBuf>, CaseError> {
    let read = |source| CaseError::Read { file: folder.to_path_buf(), source };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(read)? {
        let path = entry.map_err(read)?.path();
        if path.is_dir() {
            found.push(path);
        }
    }
    if found.is_empty() {
        return Err(CaseError::Empty { folder: folder.to_path_buf() });
    }
    found.sort();
    Ok(found)
}

/// JSON of what Python writes: `NaN` and `Infinity` outside of texts become `null`, which is no number.
fn without_nan(text: &str) -> String {
    let parts = text.split('"').scan(false, |within, part| {
        let (plain, escaped) = (!*within, part.ends_with('\\'));
        // A quote after a backslash ends no text.
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
        let text = std::fs::read_to_string(&file)
            .map_err(|source| CaseError::Read { file: file.clone(), source })?;
        let about =
            serde_json::from_str(&without_nan(&text)).map_err(|source| CaseError::Json { file, source })?;
        Ok(Self { folder: folder.to_path_buf(), about })
    }

    pub fn file(&self) -> PathBuf {
        self.folder.join("case.json")
    }

    /// The value at `path`, keys and list positions parted by dots.
    fn value<'a, T>(
        &'a self,
        path: &str,
        expected: &'static str,
        read: impl Fn(&'a Value) -> Option<T>,
    ) -> Result<T, CaseError> {
        let step = |value: &'a Value, key: &str| {
            if value.is_array() { value.get(key.parse::<usize>().ok()?) } else { value.get(key) }
        };
        path.split('.').try_fold(&self.about, step).and_then(read).ok_or_else(|| CaseError::Key {
            file: self.file(),
            key: path.to_string(),
            expected,
        })
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

    fn flag(&self, path: &str) -> Result<bool, CaseError> {
        self.value(path, "true or false", Value::as_bool)
    }

    pub fn list(&self, path: &str) -> Result<&[Value], CaseError> {
        self.value(path, "list", |v| v.as_array().map(Vec::as_slice))
    }

    fn units(&self, path: &str, count: usize) -> Result<Vec<usize>, CaseError> {
        let unit = |i| self.size(&format!("{path}.{i}"));
        let units = (0..self.list(path)?.len()).map(unit).collect::<Result<Vec<_>, _>>()?;
        match units.iter().all(|&u| u < count) {
            true => Ok(units),
            false => Err(CaseError::Key {
                file: self.file(),
                key: path.into(),
                expected: "list of units of the body",
            }),
        }
    }

    /// Array `name` as flat numbers.
    pub fn array(&self, name: &str) -> Result<Vec<f64>, CaseError> {
        let file = self.folder.join(format!("{name}.npy"));
        let read = |source| CaseError::Read { file: file.clone(), source };
        let bytes = std::fs::read(&file).map_err(read)?;
        let array = npyz::NpyFile::new(&bytes[..]).map_err(read)?;
        if array.order() == npyz::Order::Fortran && array.shape().iter().filter(|n| **n > 1).count() > 1 {
            return Err(CaseError::Order { file });
        }
        array.into_vec().map_err(read)
    }

    /// Array `name`, which must hold `expected` numbers.
    pub fn array_of(&self, name: &str, expected: usize) -> Result<Vec<f64>, CaseError> {
        let values = self.array(name)?;
        match values.len() {
            found if found == expected => Ok(values),
            found => {
                Err(CaseError::Length { file: self.folder.join(format!("{name}.npy")), found, expected })
            }
        }
    }

    /// Array `name` (…, units, 3), cut into states.
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
        let layout =
            Layout::planar(size("columns")?, size("rows")?, number("spacing")?, number("ligament_length")?);
        let units = |key: &str| self.units(&format!("scene.{key}"), layout.units());
        let direction = [number("force_direction.0")?, number("force_direction.1")?];
        let contact = match self.flag("scene.contact")? {
            true => Some(Contact {
                stiffness: number("k_contact")?,
                min_angle: number("psi_min")?,
                cutoff_angle: number("psi_cut")?,
            }),
            false => None,
        };
        Ok(Scene {
            density: number("density")?,
            stiffness: Stiffness {
                stretch: number("k_stretch")?,
                shear: number("k_shear")?,
                bend: number("k_rot")?,
            },
            damping_ratio: number("zeta")?,
            contact,
            linearised: self.flag("scene.linearised")?,
            clamped: units("clamped")?,
            panels: units("panels")?.into_iter().map(|unit| Panel { unit, direction }).collect(),
            sensors: units("sensors")?,
            frame: if self.text("scene.frame")? == "body" { Frame::Body } else { Frame::World },
            duration: number("duration")?,
            instants: size("T")?,
            layout,
        })
    }

    pub fn design(&self, scene: &Scene) -> Result<Vec<f64>, CaseError> {
        self.array_of("alpha", scene.layout.design_len())
    }

    pub fn forces(&self, scene: &Scene) -> Result<Forces, CaseError> {
        let (samples, panels, instants) = (self.size("N")?, scene.panels.len(), scene.instants);
        let values = self.array_of("forces", samples * panels * (instants + 1))?;
        Ok(Forces { samples, panels, instants, values })
    }
}

#[cfg(test)]
mod tests {
    use super::without_nan;

    #[test]
    fn numbers_that_are_none_become_null_and_texts_stay() {
        let text = r#"{"a": NaN, "NaN": [-Infinity, Infinity, 1.5], "b": "say \"NaN\", NaN", "c": NaN}"#;
        let read: serde_json::Value = serde_json::from_str(&without_nan(text)).unwrap();
        let expected =
            serde_json::json!({"a": null, "NaN": [null, null, 1.5], "b": "say \"NaN\", NaN", "c": null});
        assert_eq!(read, expected);
    }
}
