//! A finished trial as stored: its two bodies and the weights of their decoders.

use metasense_schemas::spec::TrialSpec;

use super::{Reader, quoted};
use crate::store::{KEPT_DESIGNS, StoreError};

/// Designs and weights of a trial's two bodies, `[initial, optimised]`.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredTrial {
    /// Hash of the trial.
    pub hash: String,
    /// Spec with the sensors of each body: training may have moved them.
    pub specs: [TrialSpec; 2],
    /// α (mm).
    pub designs: [Vec<f64>; 2],
    /// Flat weights of the first network; empty if not stored.
    pub weights: [Vec<f32>; 2],
    /// Training loss of the first network after every iteration.
    pub losses: [Vec<f32>; 2],
    /// The time integrator and why it was chosen.
    pub solver: String,
    /// Half-widths (N) of the bands around the estimated forces, T × K: per instant and per sample; empty if not stored.
    pub bands: [[Vec<f64>; 2]; 2],
    /// Drawings (SVG) of both bodies by an external body's program; empty: none.
    pub drawings: Vec<String>,
}

impl StoredTrial {
    /// The settings that both bodies share, with the sensors of the initial one.
    pub fn spec(&self) -> &TrialSpec {
        &self.specs[0]
    }
}

impl Reader {
    /// Designs and weights of a trial; `None` if it is not done.
    ///
    /// # Errors
    /// If the trial does not exist or its data cannot be read.
    pub async fn stored(&mut self, hash: &str) -> Result<Option<StoredTrial>, StoreError> {
        let named = quoted(&self.hash_of(hash).await?);
        let columns = ["hash", "state", "spec", "sensor_units", "sensor_units_optimised", "solver"];
        let columns_of_view = columns.join(", ");
        let drawings = format!("(SELECT result->>'$.drawings' FROM trial WHERE hash = {named}) AS drawings");
        let sql = format!("SELECT {columns_of_view}, {drawings} FROM v_trial WHERE hash = {named}");
        let rows = self.rows(&sql, |row| {
            let drawings = serde_json::from_str(row.text("drawings")).unwrap_or_default();
            (columns.map(|column| row.text(column).to_owned()), drawings)
        });
        let Some(([hash, state, spec, units, units_optimised, solver], drawings)) = rows.await?.pop() else {
            return Err(StoreError::UnknownTrial(self.path().to_owned(), hash.to_owned()));
        };
        if state != "done" {
            return Ok(None);
        }
        let unreadable = |what, e: serde_json::Error| StoreError::unreadable(&hash, what, e);
        let spec: TrialSpec = serde_json::from_str(&spec).map_err(|e| unreadable("spec", e))?;
        let heard = |units: &str| -> Result<TrialSpec, StoreError> {
            let sensor_units = serde_json::from_str(units).map_err(|e| unreadable("sensor_units", e))?;
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
        Ok(Some(StoredTrial { hash, specs, designs, weights, losses, solver, bands, drawings }))
    }

    /// Kept designs of a trial: number of outer steps, and α (mm, 32-bit precision).
    ///
    /// # Errors
    /// If SQLite fails or an array cannot be read.
    pub async fn designs_of(&mut self, hash: &str) -> Result<Vec<(u32, Vec<f64>)>, StoreError> {
        let mut designs = Vec::new();
        for array in self.arrays_of(hash).await? {
            if let Some(step) = array.name.strip_prefix(KEPT_DESIGNS).and_then(|step| step.parse().ok()) {
                designs.push((step, array.values::<f32>()?.into_iter().map(f64::from).collect()));
            }
        }
        designs.sort_by_key(|design: &(u32, Vec<f64>)| design.0);
        Ok(designs)
    }
}
