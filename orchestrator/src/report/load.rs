//! Finished trials out of a database, as the analysis takes them.

use std::collections::HashMap;

use metasense_schemas::spec::TrialSpec;
use serde_json::Value;

use super::samples::Stored;
use super::{Story, Sweep};
use crate::analysis::brains::Reading;
use crate::analysis::data::{CurvePoint, flatten};
use crate::analysis::{Body, Cluster, Set, Terms, Trial};
use crate::store::{Reader, StoreError, Table};

/// Parts of an outer step's time, as the columns of `v_step` and in words.
const PARTS: [(&str, &str); 6] = [
    ("seconds_simulate", "simulate"),
    ("seconds_train", "train"),
    ("seconds_differentiate", "differentiate"),
    ("seconds_implicit", "implicit term"),
    ("seconds_project", "project"),
    ("seconds_store", "store"),
];

/// Values of a table by column name.
pub(super) struct Rows {
    columns: HashMap<String, usize>,
    rows: Vec<Vec<Value>>,
}

impl From<Table> for Rows {
    fn from(table: Table) -> Self {
        let columns = table.columns.into_iter().enumerate().map(|(i, c)| (c, i)).collect();
        Self { columns, rows: table.rows }
    }
}

impl Rows {
    pub(super) fn iter(&self) -> impl Iterator<Item = Row<'_>> {
        self.rows.iter().map(|row| Row { columns: &self.columns, row })
    }
}

pub(super) struct Row<'a> {
    columns: &'a HashMap<String, usize>,
    row: &'a [Value],
}

impl Row<'_> {
    pub(super) fn value(&self, column: &str) -> &Value {
        &self.row[self.columns[column]]
    }
    pub(super) fn text(&self, column: &str) -> &str {
        self.value(column).as_str().unwrap_or_default()
    }
    pub(super) fn number(&self, column: &str) -> Option<f64> {
        self.value(column).as_f64()
    }
    pub(super) fn count(&self, column: &str) -> u64 {
        self.value(column).as_u64().unwrap_or_default()
    }
}

/// Reads every trial that is done, in the order in which the trials were planned.
///
/// # Errors
/// Where the database cannot be read, or holds what this program cannot.
pub async fn finished_trials(reader: &mut Reader) -> Result<Vec<Trial>, StoreError> {
    let rows: Rows = reader
        .query(
            "SELECT hash, spec, panels, sensors, placement, seed, units, design_parameters, error_initial,
               error_optimised, holdout_error_initial, holdout_error_optimised, seconds_evaluation,
               nonlinear_acceleration_initial, nonlinear_rotation_initial, nonlinear_acceleration_optimised,
               nonlinear_rotation_optimised
             FROM v_trial WHERE state = 'done' ORDER BY panels, design_parameters, sensors, placement, seed, hash",
        )
        .await?
        .into();
    let mut trials = Vec::new();
    for row in rows.iter() {
        let hash = row.text("hash").to_owned();
        let spec: Value = serde_json::from_str(row.text("spec")).map_err(|e| StoreError::Unreadable {
            hash: hash.clone(),
            what: "spec",
            message: e.to_string(),
        })?;
        trials.push(Trial {
            setting: flatten(&spec),
            panels: row.count("panels"),
            sensors: row.count("sensors"),
            cluster: Cluster { placement: row.count("placement"), seed: row.count("seed") },
            units: row.count("units"),
            design_parameters: row.count("design_parameters"),
            errors: [
                [row.number("error_initial"), row.number("holdout_error_initial")],
                [row.number("error_optimised"), row.number("holdout_error_optimised")],
            ],
            nonlinear: Body::ALL.map(|body| {
                ["acceleration", "rotation"]
                    .map(|kind| row.number(&format!("nonlinear_{kind}_{}", body.name())))
            }),
            seconds: vec![("evaluate", row.number("seconds_evaluation").unwrap_or(0.0))],
            hash,
            ..Trial::default()
        });
    }
    let places: HashMap<String, usize> =
        trials.iter().enumerate().map(|(i, t)| (t.hash.clone(), i)).collect();
    add_histories(reader, &mut trials, &places).await?;
    add_curves(reader, &mut trials, &places, "losses_", |t| &mut t.curves).await?;
    add_curves(reader, &mut trials, &places, "long_losses_", |t| &mut t.long_curves).await?;
    add_error_curves(reader, &mut trials, &places).await?;
    add_long_errors(reader, &mut trials, &places).await?;
    add_readings(reader, &mut trials, &places).await?;
    Ok(trials)
}

async fn add_readings(
    reader: &mut Reader,
    trials: &mut [Trial],
    places: &HashMap<String, usize>,
) -> Result<(), StoreError> {
    let rows: Rows = reader
        .query(
            "SELECT hash, body, before, after, whole, error_test, error_holdout FROM v_reading
             ORDER BY hash, whole DESC, before, after, body",
        )
        .await?
        .into();
    for row in rows.iter() {
        let (Some(&i), Some(body)) = (places.get(row.text("hash")), body_named(row.text("body"))) else {
            continue;
        };
        let memory = ["before", "after"].map(|column| row.number(column).unwrap_or(0.0));
        let readings = &mut trials[i].readings;
        if readings.last().is_none_or(|last| last.memory != memory) {
            let whole = row.count("whole") == 1;
            readings.push(Reading { memory, whole, ..Reading::default() });
        }
        let last = readings.len() - 1;
        readings[last].errors[body as usize] = [row.number("error_test"), row.number("error_holdout")];
    }
    Ok(())
}

async fn add_histories(
    reader: &mut Reader,
    trials: &mut [Trial],
    places: &HashMap<String, usize>,
) -> Result<(), StoreError> {
    let rows: Rows = reader
        .query("SELECT hash, seconds, best_error_test FROM v_error_time ORDER BY hash, step")
        .await?
        .into();
    for row in rows.iter() {
        if let (Some(&i), Some(seconds), Some(error)) =
            (places.get(row.text("hash")), row.number("seconds"), row.number("best_error_test"))
        {
            trials[i].history.push((seconds, error));
        }
    }
    let sums = PARTS.map(|(column, _)| format!("sum({column}) AS {column}")).join(", ");
    let rows: Rows = reader.query(&format!("SELECT hash, {sums} FROM v_step GROUP BY hash")).await?.into();
    for row in rows.iter() {
        if let Some(&i) = places.get(row.text("hash")) {
            let evaluate = trials[i].seconds.pop();
            trials[i].seconds =
                PARTS.iter().map(|(column, part)| (*part, row.number(column).unwrap_or(0.0))).collect();
            trials[i].seconds.extend(evaluate);
        }
    }
    Ok(())
}

/// Whole curves where they are kept.
async fn add_curves(
    reader: &mut Reader,
    trials: &mut [Trial],
    places: &HashMap<String, usize>,
    prefix: &str,
    curves: fn(&mut Trial) -> &mut [Vec<Vec<CurvePoint>>; 2],
) -> Result<(), StoreError> {
    for artifact in reader.artifacts(&format!("{prefix}%")).await? {
        let Some(&i) = places.get(&artifact.hash) else { continue };
        let name = artifact.name.trim_start_matches(prefix);
        let Some((body, network)) =
            name.rsplit_once('_').and_then(|(b, n)| Some((b, n.parse::<usize>().ok()?)))
        else {
            continue;
        };
        let Some(body) = body_named(body) else { continue };
        let curve: Vec<CurvePoint> =
            artifact.values::<f32>()?.into_iter().zip(1..).map(|(loss, n)| (n, loss.into())).collect();
        *of_network(&mut curves(&mut trials[i])[body as usize], network) = curve;
    }
    Ok(())
}

fn body_named(name: &str) -> Option<Body> {
    Body::ALL.into_iter().find(|b| b.name() == name)
}

fn of_network(curves: &mut Vec<Vec<CurvePoint>>, network: usize) -> &mut Vec<CurvePoint> {
    if curves.len() <= network {
        curves.resize(network + 1, Vec::new());
    }
    &mut curves[network]
}

/// Errors on the way of ordinary training.
async fn add_error_curves(
    reader: &mut Reader,
    trials: &mut [Trial],
    places: &HashMap<String, usize>,
) -> Result<(), StoreError> {
    let rows: Rows = reader
        .query(
            "SELECT c.hash, c.body, c.network, c.iteration, c.error_holdout
             FROM v_curve c JOIN v_trial t USING (hash)
             WHERE c.error_holdout IS NOT NULL AND c.network < t.spec->>'$.evaluation.seeds'
             ORDER BY c.hash, c.body, c.network, c.iteration",
        )
        .await?
        .into();
    for row in rows.iter() {
        let numbers = ["network", "iteration", "error_holdout"].map(|column| row.number(column));
        if let (Some(&i), Some(body), [Some(network), Some(iteration), Some(error)]) =
            (places.get(row.text("hash")), body_named(row.text("body")), numbers)
        {
            let curves = &mut trials[i].error_curves[body as usize];
            of_network(curves, network as usize).push((iteration as u32, error));
        }
    }
    Ok(())
}

/// Means over the networks that were trained long: those after the evaluation's ordinary ones.
async fn add_long_errors(
    reader: &mut Reader,
    trials: &mut [Trial],
    places: &HashMap<String, usize>,
) -> Result<(), StoreError> {
    let rows: Rows = reader
        .query(
            "SELECT n.hash, n.body, avg(n.error_test) AS test, avg(n.error_holdout) AS holdout
             FROM v_network n JOIN v_trial t USING (hash)
             WHERE n.network >= t.spec->>'$.evaluation.seeds' AND t.spec->>'$.evaluation.long_iterations' > 0
             GROUP BY n.hash, n.body",
        )
        .await?
        .into();
    for row in rows.iter() {
        let body = body_named(row.text("body"));
        if let (Some(&i), Some(body)) = (places.get(row.text("hash")), body) {
            trials[i].long_errors[body as usize] = [row.number("test"), row.number("holdout")];
        }
    }
    Ok(())
}

/// Reads all that a report tells; `trial` names the one to be replayed (the beginning of its hash is enough).
///
/// # Errors
/// Where the database cannot be read, or does not hold the trial whole.
pub async fn story(reader: &mut Reader, trial: Option<&str>, terms: Terms) -> Result<Story, StoreError> {
    let trials = finished_trials(reader).await?;
    let sweeps: Rows = reader
        .query("SELECT name, text, version, created_at FROM sweep ORDER BY created_at, name")
        .await?
        .into();
    let settled = reader
        .query(
            "SELECT hash, state, reason, panels, sensors, placement, seed, units, design_parameters, protocol,
               error_initial AS test_error_initial, error_optimised AS test_error_optimised, holdout_error_initial,
               holdout_error_optimised, steps, attempts, seconds, simd FROM v_trial ORDER BY state = 'failed' DESC, panels, units, sensors, placement, seed",
        )
        .await?;
    let chosen = match trial {
        Some(hash) => Some(hash.to_owned()),
        None => typical(&trials).map(|t| t.hash.clone()),
    };
    let stored = match chosen {
        Some(hash) => stored(reader, &hash).await?,
        None => None,
    };
    let text = |row: &Row, column| row.text(column).to_owned();
    Ok(Story {
        sweeps: sweeps
            .iter()
            .map(|r| Sweep {
                name: text(&r, "name"),
                text: text(&r, "text"),
                version: text(&r, "version"),
                created_at: text(&r, "created_at"),
            })
            .collect(),
        settled,
        trials,
        made: reader.made().await?,
        stored,
        terms,
    })
}

/// The trial whose ratio of holdout errors is nearest to the mean of all; none that began as a random body.
fn typical(trials: &[Trial]) -> Option<&Trial> {
    let trials = || trials.iter().filter(|t| !t.starts_random());
    let ratio = |t: &Trial| {
        Some((t.error(Body::Initial, Set::Holdout)? / t.error(Body::Optimised, Set::Holdout)?).ln())
    };
    let ratios: Vec<(f64, &Trial)> = trials().filter_map(|t| Some((ratio(t)?, t))).collect();
    let mean = ratios.iter().map(|r| r.0).sum::<f64>() / ratios.len() as f64;
    ratios.iter().min_by(|a, b| (a.0 - mean).abs().total_cmp(&(b.0 - mean).abs())).map(|r| r.1)
}

/// Designs and weights of a trial; `None` where it is not done.
///
/// # Errors
/// Where there is no such trial, or what is stored of it cannot be read.
pub async fn stored(reader: &mut Reader, hash: &str) -> Result<Option<Stored>, StoreError> {
    let quoted = reader.hash_of(hash).await?.replace('\'', "''");
    let sql = format!(
        "SELECT hash, spec, state, sensor_units, sensor_units_optimised FROM v_trial WHERE hash = '{quoted}'"
    );
    let rows: Rows = reader.query(&sql).await?.into();
    let Some(row) = rows.iter().next() else {
        return Err(StoreError::UnknownTrial { path: reader.path().to_owned(), hash: hash.to_owned() });
    };
    if row.text("state") != "done" {
        return Ok(None);
    }
    let hash = row.text("hash").to_owned();
    let unreadable = |what| {
        let hash = hash.clone();
        move |e: serde_json::Error| StoreError::Unreadable { hash, what, message: e.to_string() }
    };
    let spec: TrialSpec = serde_json::from_str(row.text("spec")).map_err(unreadable("spec"))?;
    let heard = |column: &'static str| -> Result<TrialSpec, StoreError> {
        let sensor_units = serde_json::from_str(row.text(column)).map_err(unreadable(column))?;
        Ok(TrialSpec { sensor_units, ..spec.clone() })
    };
    let specs = [heard("sensor_units")?, heard("sensor_units_optimised")?];
    let mut stored = Stored {
        hash,
        specs,
        designs: Default::default(),
        weights: Default::default(),
        losses: Default::default(),
    };
    for body in Body::ALL {
        for artifact in reader.arrays_of(&stored.hash).await? {
            if artifact.name == format!("alpha_{}", body.name()) {
                stored.designs[body as usize] = artifact.values()?;
            } else if artifact.name == format!("weights_{}_0", body.name()) {
                stored.weights[body as usize] = artifact.values()?;
            } else if artifact.name == format!("losses_{}_0", body.name()) {
                stored.losses[body as usize] = artifact.values()?;
            }
        }
    }
    Ok(Some(stored))
}
