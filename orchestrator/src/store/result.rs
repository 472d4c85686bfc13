//! The rows of a trial's result: bodies with their decoders, casts, bands and arrays.

use std::borrow::Cow;

use metasense_schemas::record::{BandRecord, BodyRecord, CastRecord, NetworkRecord, TrialResult};
use metasense_worker::milestones;

use super::digest::digest;
use super::{Store, StoredArray, npy_bytes, npy_values};
use crate::analysis::numbers::{most_above, network_mean};

impl Store {
    /// Records a result with its arrays, sets its trial to done and deletes its checkpoint.
    pub(super) async fn insert_result(
        &mut self,
        id: i64,
        result: &TrialResult,
        arrays: &[StoredArray<'_>],
    ) -> sqlx::Result<()> {
        let mut query = sqlx::query(
            "UPDATE trial SET state = 'done', reason = NULL, error_initial = ?, error_optimised = ?,
               train_error_initial = ?, train_error_optimised = ?, holdout_error_initial = ?,
               holdout_error_optimised = ?, holdout_median_initial = ?, holdout_median_optimised = ?,
               holdout_p90_initial = ?, holdout_p90_optimised = ?, holdout_above_initial = ?,
               holdout_above_optimised = ?, best_step = ?, seconds_evaluation = ?, simd = ?, solver = ?, result = ?,
               finished_at = strftime('%Y-%m-%dT%H:%M:%fZ')
             WHERE id = ?",
        );
        let errors: [fn(&NetworkRecord) -> Option<f64>; 5] = [
            |n| n.error_test,
            |n| n.error_train,
            |n| n.error_holdout,
            |n| n.spread?.median,
            |n| n.spread?.p90,
        ];
        for error in errors {
            query = query.bind(network_mean(&result.initial.networks, error));
            query = query.bind(network_mean(&result.optimised.networks, error));
        }
        for body in [&result.initial, &result.optimised] {
            query = query.bind(most_above(&body.networks));
        }
        let seconds = finite(Some(result.seconds_evaluation));
        bound!(query; result.best_step, seconds, &result.simd, &result.solver, without_bulk(result), id)
            .execute(&mut self.connection)
            .await?;
        let bodies = [("initial", &result.initial), ("optimised", &result.optimised)];
        for ((body, evaluation), (casts, bands)) in
            bodies.into_iter().zip(result.casts.iter().zip(&result.bands))
        {
            self.insert_evaluation(id, body, evaluation, arrays).await?;
            self.insert_casts(id, body, casts).await?;
            self.insert_bands(id, body, bands).await?;
        }
        for array in arrays {
            self.insert_artifact(id, array.name, array.shape, array.npy.to_vec()).await?;
        }
        run!(self, "DELETE FROM checkpoint WHERE trial_id = ?"; id)?;
        Ok(())
    }

    async fn insert_evaluation(
        &mut self,
        id: i64,
        body: &str,
        evaluation: &BodyRecord,
        arrays: &[StoredArray<'_>],
    ) -> sqlx::Result<()> {
        // networks with long training get the next numbers; their iterations distinguish them
        let (ordinary, long) = (&evaluation.networks, &evaluation.long);
        for (seed, network) in ordinary.iter().chain(long).enumerate() {
            let kind = if seed < ordinary.len() { "losses" } else { "long_losses" };
            let name = format!("{kind}_{body}_{seed}");
            let apart = arrays.iter().find(|array| array.name == name);
            let losses = match apart {
                Some(array) => Cow::Owned(npy_values::<f32>(array.npy).map_err(sqlx::Error::Io)?),
                None => Cow::Borrowed(&network.losses[..]),
            };
            let spread = network.spread.unwrap_or_default();
            run!(self, "INSERT OR REPLACE INTO network VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)";
                id, body, seed as i64, finite(network.error_train), finite(network.error_test),
                finite(network.error_holdout), losses.len() as i64, &network.outcome, finite(spread.median),
                finite(spread.p90), network.spread.map(|s| s.above))?;
            for iteration in milestones(losses.len()) {
                let error =
                    network.errors.iter().find(|(n, _)| *n as usize == iteration).map(|(_, error)| *error);
                let loss = losses[iteration - 1].into();
                run!(self, "INSERT OR REPLACE INTO curve VALUES (?, ?, ?, ?, ?, ?)";
                    id, body, seed as i64, iteration as i64, finite(Some(loss)), finite(error))?;
            }
            self.insert_values(id, &format!("weights_{body}_{seed}"), &network.weights).await?;
            if apart.is_none() {
                self.insert_values(id, &name, &losses).await?;
            }
        }
        for (n, reading) in evaluation.readings.iter().enumerate() {
            let spread = reading.spread.unwrap_or_default();
            run!(self, "INSERT OR REPLACE INTO reading VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)";
                id, body, reading.before, reading.after, i64::from(n == 0), reading.ridge, finite(reading.error_train),
                finite(reading.error_test), finite(reading.error_holdout), finite(spread.median), finite(spread.p90),
                reading.spread.map(|s| s.above))?;
        }
        self.insert_values(id, &format!("alpha_{body}"), &evaluation.design).await
    }

    async fn insert_bands(&mut self, id: i64, body: &str, bands: &[BandRecord]) -> sqlx::Result<()> {
        for band in bands {
            run!(self, "INSERT OR REPLACE INTO band VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)";
                id, body, band.cast.map_or(-1, i64::from), &band.reader, band.records, &band.method, &band.kind,
                band.level, band.samples, finite(band.coverage), finite(band.width), &band.outcome)?;
            self.insert_values(id, &format!("band_{}_{body}", band.kind), &band.half_width).await?;
        }
        Ok(())
    }

    async fn insert_casts(&mut self, id: i64, body: &str, casts: &[CastRecord]) -> sqlx::Result<()> {
        for reading in casts {
            let spread = reading.spread.unwrap_or_default();
            run!(self, "INSERT OR REPLACE INTO cast_reading VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)";
                id, body, reading.cast, &reading.reader, reading.records, finite(reading.error), &reading.outcome,
                finite(spread.median), finite(spread.p90), reading.spread.map(|s| s.above), finite(reading.ridge),
                finite(reading.share))?;
        }
        Ok(())
    }

    /// Records a list of numbers as an array, unless it is empty.
    pub(super) async fn insert_values<T: npyz::AutoSerialize + Copy>(
        &mut self,
        id: i64,
        name: &str,
        values: &[T],
    ) -> sqlx::Result<()> {
        let shape = [values.len()];
        match values {
            [] => Ok(()),
            values => self.insert_artifact(id, name, &shape, npy_bytes(&shape, values)).await,
        }
    }

    async fn insert_artifact(
        &mut self,
        id: i64,
        name: &str,
        shape: &[usize],
        npy: Vec<u8>,
    ) -> sqlx::Result<()> {
        let shape = serde_json::to_string(shape).expect("numbers are JSON");
        run!(self, "INSERT OR REPLACE INTO artifact (trial_id, name, shape, digest, bytes) VALUES (?, ?, ?, ?, ?)";
            id, name, shape, digest(&npy), npy)?;
        Ok(())
    }
}

/// Non-finite numbers are stored as NULL; the outcome column gives the reason.
pub(super) fn finite(value: Option<f64>) -> Option<f64> {
    value.filter(|v| v.is_finite())
}

/// The result as JSON, without the data that is stored elsewhere.
fn without_bulk(result: &TrialResult) -> String {
    let mut small = result.clone();
    small.casts = Default::default();
    small.bands = Default::default();
    for body in [&mut small.initial, &mut small.optimised] {
        body.design.clear();
        body.readings.clear();
        for network in body.networks.iter_mut().chain(&mut body.long) {
            network.losses.clear();
            network.errors.clear();
            network.weights.clear();
        }
    }
    serde_json::to_string(&small).expect("a result is JSON")
}
