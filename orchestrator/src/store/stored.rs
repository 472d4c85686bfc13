//! A finished trial as it is stored: its two bodies, with the weights that read them.

use metasense_schemas::spec::TrialSpec;

use super::{Reader, StoreError, quoted};

/// What is stored of a trial's two bodies: α (mm) and the weights of the first network, `[initial, optimised]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Stored {
    /// Names the trial.
    pub hash: String,
    /// What it is, by its sensors on either body: on the optimised one they may have moved.
    pub specs: [TrialSpec; 2],
    /// α.
    pub designs: [Vec<f64>; 2],
    /// Flat weights; empty where none were kept.
    pub weights: [Vec<f32>; 2],
    /// Training loss of the first network after every iteration.
    pub losses: [Vec<f32>; 2],
    /// The integrator, and why.
    pub solver: String,
    /// Half-widths (T, K) (N) of the bands about what the body's brain says, at each instant and over a sample; empty without.
    pub bands: [[Vec<f64>; 2]; 2],
}

impl Stored {
    /// What both bodies share.
    #[must_use]
    pub fn spec(&self) -> &TrialSpec {
        &self.specs[0]
    }
}

impl Reader {
    /// Designs and weights of a trial; `None` where it is not done.
    ///
    /// # Errors
    /// Where there is no such trial, or what is stored of it cannot be read.
    pub async fn stored(&mut self, hash: &str) -> Result<Option<Stored>, StoreError> {
        let named = quoted(&self.hash_of(hash).await?);
        let columns = ["hash", "state", "spec", "sensor_units", "sensor_units_optimised", "solver"];
        let sql = format!("SELECT {} FROM v_trial WHERE hash = {named}", columns.join(", "));
        let mut found = None;
        self.each(&sql, |row| {
            found = Some(columns.map(|column| row.text(column).to_owned()));
            Ok::<_, StoreError>(())
        })
        .await?;
        let Some([hash, state, spec, units, units_optimised, solver]) = found else {
            return Err(StoreError::UnknownTrial { path: self.path().to_owned(), hash: hash.to_owned() });
        };
        if state != "done" {
            return Ok(None);
        }
        let unreadable = |what| {
            let hash = hash.clone();
            move |e: serde_json::Error| StoreError::Unreadable { hash, what, message: e.to_string() }
        };
        let spec: TrialSpec = serde_json::from_str(&spec).map_err(unreadable("spec"))?;
        let heard = |units: &str| -> Result<TrialSpec, StoreError> {
            let sensor_units = serde_json::from_str(units).map_err(unreadable("sensor_units"))?;
            Ok(TrialSpec { sensor_units, ..spec.clone() })
        };
        let specs = [heard(&units)?, heard(&units_optimised)?];
        let (mut designs, mut weights, mut losses) =
            <([Vec<f64>; 2], [Vec<f32>; 2], [Vec<f32>; 2])>::default();
        let mut bands = <[[Vec<f64>; 2]; 2]>::default();
        for array in self.arrays_of(&hash).await? {
            for (b, body) in ["initial", "optimised"].into_iter().enumerate() {
                match array.name.split_once('_') {
                    Some(("alpha", of)) if of == body => designs[b] = array.values()?,
                    Some(("weights", of)) if of == format!("{body}_0") => weights[b] = array.values()?,
                    Some(("losses", of)) if of == format!("{body}_0") => losses[b] = array.values()?,
                    Some(("band", of)) if of == format!("instant_{body}") => bands[b][0] = array.values()?,
                    Some(("band", of)) if of == format!("sample_{body}") => bands[b][1] = array.values()?,
                    _ => {}
                }
            }
        }
        Ok(Some(Stored { hash, specs, designs, weights, losses, solver, bands }))
    }
}
