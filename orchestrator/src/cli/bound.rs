//! `bound`: errors of the best linear decoder around each motion, a lower bound for all decoders, and errors of trained decoders.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use metasense_lab::bound::{Bound, bound};
use metasense_schemas::spec::TrialSpec;
use serde_json::{Value, json};

use super::named::{Database, Design, Designed};
use super::{Error, Format, cores, print_rows};
use crate::analysis::kinds::brains_of;
use crate::exit::Exit;
use crate::look::{Table, short_hash};
use crate::reader::Reader;

/// Computes the error of the best linear decoder, and a lower bound for all decoders
///
/// The first value is not a bound for all decoders. The motion is linearised around each of the first held-out samples. The
/// body is known; the forces are normal with the mean and covariance of the training samples; the error is that of the
/// posterior given the signals. Row "mean": the mean covariance of the samples, with the weights that the training set
/// gives the mean error (it differs from the mean of the printed rows). Row "mean information": the error for the mean
/// information, which is smaller. For pulses (bell), "any decoder" is a lower bound on the mean error of all decoders,
/// whatever they use about body, noise and pulses, with its standard error. It comes from walks on the true posterior,
/// eight per sample, with nonlinear motion and uniform parameters. A better decoder may remove error above the bound. Only
/// another body, another placement of sensors or less noise lower the bound itself.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    one: Designed,
    /// Number of held-out samples
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u16).range(1..=10_000))]
    samples: u16,
    /// White noise of each reading, as a fraction of each channel's RMS on the initial body [default: the spec's
    /// sensors.noise]
    #[arg(long, value_name = "σ", value_parser = above_zero)]
    noise: Option<f64>,
    /// With SPEC: a database that contains the trial, finished, or trials that differ from it only in their decoders. With
    /// it, as with DB HASH, prints these errors of the initial and trained bodies, and the held-out errors of all decoders
    /// for these bodies
    #[arg(long, value_name = "FILE", conflicts_with = "design")]
    db: Option<PathBuf>,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

fn above_zero(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if value > 0.0 && value.is_finite() { Ok(value) } else { Err("must be above 0".into()) }
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let (hash, trial, design) = args.one.read().await?;
    let of = |trial: &TrialSpec, design: &[f64]| {
        bound(trial, design, args.samples.into(), args.noise, cores()).map_err(|e| args.one.trial.failed(e))
    };
    let given = matches!(args.one.design, Design::File(_));
    let own = args.one.trial.is_database() && !given;
    let rows = match args.db.as_ref().or(own.then_some(&args.one.trial.source)) {
        None => {
            let body = if given { "given" } else { "initial" };
            bounds([json!(body), Value::Null], &of(&trial, &design)?)
        }
        Some(db) => bounds_and_errors(db, &hash, &trial, of).await?,
    };
    print_rows(&Table::new("body trained_with read_by sample error standard_error", rows), args.format)?;
    Ok(Exit::Done)
}

/// Name of the best linear decoder in column `read_by`.
const LINEAR: &str = "best linear decoder around the motion";

/// One row per sample, then both means, the lower bound for all decoders, and the error without signals.
fn bounds(body: [Value; 2], found: &Bound) -> Vec<Vec<Value>> {
    let row = |by: &str, sample: Value, error: Value, off: Option<f64>| {
        body.iter().cloned().chain([json!(by), sample, error, json!(off)]).collect::<Vec<_>>()
    };
    let samples = found.samples.iter().enumerate();
    let mut rows: Vec<_> = samples.map(|(i, error)| row(LINEAR, json!(i), json!(error), None)).collect();
    rows.push(row(LINEAR, json!("mean"), json!(found.mean), None));
    rows.push(row(LINEAR, json!("mean information"), json!(found.mean_information), None));
    rows.extend(found.least.map(|[least, off]| row("any decoder", json!("mean"), json!(least), Some(off))));
    rows.push(row("no signal", json!("mean"), json!(found.prior_only), None));
    rows
}

/// Bounds for the bodies of all trials that differ from `trial` only in their decoders, and the errors of these decoders.
async fn bounds_and_errors(
    db: &Path,
    hash: &str,
    trial: &TrialSpec,
    of: impl Fn(&TrialSpec, &[f64]) -> Result<Bound, Error>,
) -> Result<Vec<Vec<Value>>, Error> {
    let scene = scene(&json!(trial));
    let trials = Reader::with_reader(Database::at(db).await?, async |reader| -> Result<_, Error> {
        let sql = "SELECT hash, spec, holdout_error_initial, linear_holdout_error_initial,
                     holdout_error_optimised, linear_holdout_error_optimised
                   FROM v_trial WHERE state = 'done' ORDER BY trained_with, brain, hash";
        let mut found = Vec::new();
        for row in reader.query::<Table>(sql).await?.rows {
            let text = |i: usize| row[i].as_str().unwrap_or_default().to_owned();
            let own: Value = serde_json::from_str(&text(1)).unwrap_or_default();
            if self::scene(&own) == scene
                && let Some(stored) = reader.stored(&text(0)).await?
            {
                found.push((stored, brains_of(&own), row[2..].to_vec()));
            }
        }
        Ok(found)
    })
    .await?;
    if trials.is_empty() {
        let (word, db, hash) = (crate::files::quoted(db), db.display(), short_hash(hash));
        return usage!(
            "{db} contains no finished trial with the scene of {hash}; see `metasense status {word}`"
        );
    }
    // keyed by the bits of the design: the bound of equal bodies is computed once
    let mut bodies: BTreeMap<(usize, Vec<u64>), Vec<Vec<Value>>> = BTreeMap::new();
    for (stored, [brain, trained_with], errors) in &trials {
        for (b, name) in ["initial", "optimised"].into_iter().enumerate() {
            let design = &stored.designs[b];
            let with = if b == 0 { Value::Null } else { json!(trained_with) };
            let head = [json!(name), with];
            let key = (b, design.iter().map(|x| x.to_bits()).collect());
            if !bodies.contains_key(&key) {
                bodies.insert(key.clone(), bounds(head.clone(), &of(&stored.specs[b], design)?));
            }
            let rows = bodies.get_mut(&key).expect("just put there");
            for (by, error) in [&brain[..], "linear, whole sample"].into_iter().zip(&errors[2 * b..]) {
                let row = [&head[..], &[json!(by), json!("mean"), error.clone(), Value::Null]].concat();
                if !error.is_null() && !rows.contains(&row) {
                    rows.push(row);
                }
            }
        }
    }
    Ok(bodies.into_values().flatten().collect())
}

/// A trial's spec without the keys of decoder, training, evaluation and limits.
fn scene(spec: &Value) -> Value {
    let mut scene = spec.clone();
    // older databases store only the values that follow from the material
    if let Some(body) = scene.pointer_mut("/body").and_then(Value::as_object_mut) {
        body.remove("material");
    }
    if let Some(keys) = scene.as_object_mut() {
        keys.retain(|key, _| !["brain", "optimise", "evaluation", "feasible"].contains(&key.as_str()));
    }
    scene
}
