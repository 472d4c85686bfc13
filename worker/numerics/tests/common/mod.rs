//! Reads the reference cases under `tests/cases` at the top of the repository.
#![allow(dead_code, reason = "each test file uses its part")]

use metasense_numerics::body::Layout;
use metasense_numerics::dynamics::{Contact, Forces, Frame, Panel, Scene, Stiffness};
use serde_json::Value;
use std::path::PathBuf;

pub struct Case {
    folder: PathBuf,
    pub about: Value,
}

impl Case {
    pub fn open(name: &str) -> Self {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/cases").join(name);
        let text = std::fs::read_to_string(folder.join("case.json")).expect("case.json");
        Self { folder, about: serde_json::from_str(&text).expect("JSON") }
    }

    /// Array `name` as flat numbers.
    pub fn array(&self, name: &str) -> Vec<f64> {
        let bytes = std::fs::read(self.folder.join(format!("{name}.npy"))).expect("array");
        npyz::NpyFile::new(&bytes[..]).expect("npy").into_vec().expect("f64")
    }

    /// Array `name` (…, n, 3), cut into states.
    pub fn states(&self, name: &str, units: usize) -> Vec<Vec<[f64; 3]>> {
        let flat = self.array(name);
        flat.as_chunks::<3>().0.chunks(units).map(<[_]>::to_vec).collect()
    }

    fn number(&self, key: &str) -> f64 {
        self.about["scene"][key].as_f64().unwrap_or_else(|| panic!("number {key}"))
    }

    fn units(&self, key: &str) -> Vec<usize> {
        let list = self.about["scene"][key].as_array().unwrap_or_else(|| panic!("list {key}"));
        list.iter().map(|u| u.as_u64().expect("index") as usize).collect()
    }

    pub fn scene(&self) -> Scene {
        let scene = &self.about["scene"];
        let direction: Vec<f64> = scene["force_direction"]
            .as_array()
            .expect("direction")
            .iter()
            .filter_map(Value::as_f64)
            .collect();
        let layout = Layout::planar(
            self.number("columns") as usize,
            self.number("rows") as usize,
            self.number("spacing"),
            self.number("ligament_length"),
        );
        let contact = Contact {
            stiffness: self.number("k_contact"),
            min_angle: self.number("psi_min"),
            cutoff_angle: self.number("psi_cut"),
        };
        Scene {
            layout,
            density: self.number("density"),
            stiffness: Stiffness {
                stretch: self.number("k_stretch"),
                shear: self.number("k_shear"),
                bend: self.number("k_rot"),
            },
            damping_ratio: self.number("zeta"),
            contact: (scene["contact"] == true).then_some(contact),
            linearised: scene["linearised"] == true,
            clamped: self.units("clamped"),
            panels: self
                .units("panels")
                .into_iter()
                .map(|unit| Panel { unit, direction: [direction[0], direction[1]] })
                .collect(),
            sensors: self.units("sensors"),
            frame: if scene["frame"] == "body" { Frame::Body } else { Frame::World },
            duration: self.number("duration"),
            instants: self.number("T") as usize,
        }
    }

    pub fn forces(&self) -> Forces {
        let scene = self.scene();
        let values = self.array("forces");
        let (panels, instants) = (scene.panels.len(), scene.instants);
        Forces { samples: values.len() / (panels * (instants + 1)), panels, instants, values }
    }
}

pub fn norm(a: &[f64]) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// ‖a − b‖/‖b‖.
pub fn relative(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "lengths");
    let difference: Vec<f64> = a.iter().zip(b).map(|(a, b)| a - b).collect();
    let scale = norm(b);
    norm(&difference) / if scale > 0.0 { scale } else { 1.0 }
}

pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads")
}
