//! `tasks`: estimates quantities other than forces from the signals of finished bodies.

use std::path::PathBuf;

use metasense_lab::tasks::{TaskEstimate, tasks};
use metasense_schemas::spec::{Point, Task};
use metasense_worker::problem::as_written;
use serde_json::{Value, json};

use super::named::Database;
use super::{Error, Format, cores, print_rows};
use crate::analysis::Cluster;
use crate::analysis::kinds::brains_of;
use crate::analysis::tasks::{TaskResult, matrix, table};
use crate::exit::Exit;
use crate::look::{Table, row, short_hash};
use crate::reader::{Reader, StoredTrial};

/// Estimates quantities other than forces from finished bodies: where, how many, when
///
/// Each quantity (task) is estimated in two ways on the held-out set. `direct`: ridge regression on the signals of the whole
/// record. `decoded`: from the forces that a linear decoder estimates. The table has means over the trials of a setting, the error
/// of a predictor without signals (trivial), and the ratio initial / trained with its 95 % interval over seeds and placements;
/// in it an error counts at least as half of one sample's. If bodies were trained for several tasks (brain.task), a transfer matrix
/// follows: this ratio per task and training. Other formats have one row per trial, body, task and readout, with a 95 % interval
/// over samples and a score: balanced accuracy (%) of classes, R² of values. Tasks: forces (% of their squares); panel, the panel
/// with the greatest force (% wrong); count, the number of panels with more than a tenth of it (% wrong); position, the panels'
/// mean position weighted by impulse (mm); peak (N) and impulse (mN s) of each panel; onset, when a force first exceeds a tenth of
/// the greatest (ms). A task whose label is the same in all samples is omitted.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database
    #[arg(value_name = "DB")]
    db: PathBuf,
    /// One trial, by its hash or the beginning of it [default: all finished trials]
    hash: Option<String>,
    /// Format: a table of means, or rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let sql = "SELECT hash FROM v_trial WHERE state = 'done' ORDER BY panels, sensors, placement, seed, hash";
    let (mut trials, mut rows, mut all) = (0, Vec::new(), Vec::new());
    Reader::with_reader(Database::at(&args.db).await?, async |reader| -> Result<_, Error> {
        let hashes: Vec<String> = match &args.hash {
            Some(hash) => vec![reader.hash_of(hash).await?],
            None => {
                let found = reader.query::<Table>(sql).await?.rows;
                found.iter().filter_map(|row| row[0].as_str().map(str::to_owned)).collect()
            }
        };
        for hash in hashes {
            if let Some(stored) = reader.stored(&hash).await? {
                trials += 1;
                of_trial(&stored, &mut rows, &mut all)?;
            }
        }
        Ok(())
    })
    .await?;
    if trials == 0 {
        let db = args.db.display();
        return Err(Error::Usage(format!("{db} contains no finished trial; see `metasense status {db}`")));
    }
    let columns = "hash panels sensors placement seed trained_with trained_for body task readout unit error low high least trivial samples score";
    match args.format {
        Format::Table => {
            print_rows(&table(&all), Format::Table)?;
            if let Some(matrix) = matrix(&all) {
                print_line!("\nratio initial/trained by the task of the training:")?;
                print_rows(&matrix, Format::Table)?;
            }
        }
        format => print_rows(&Table::new(columns, rows), format)?,
    }
    Ok(Exit::Done)
}

/// Appends the readings of both bodies as rows and as pairs.
fn of_trial(trial: &StoredTrial, rows: &mut Vec<Vec<Value>>, all: &mut Vec<TaskResult>) -> Result<(), Error> {
    let point = &trial.specs[1].point;
    let mut spec = trial.specs[1].clone();
    let trained_for = as_written(&std::mem::replace(&mut spec.brain.task, Task::Forces)).replace('"', "");
    let [_, with] = brains_of(&json!(spec));
    let cluster = Cluster { placement: point.placement as u64, seed: point.seed };
    let mut bodies = Vec::new();
    for (body, name) in ["initial", "optimised"].into_iter().enumerate() {
        let (found, constant) = tasks(&trial.specs[body], &trial.designs[body], cores())
            .map_err(|e| Error::Usage(format!("trial {}: {e}", short_hash(&trial.hash))))?;
        if body == 0 && rows.is_empty() && !constant.is_empty() {
            let names: Vec<&str> = constant.iter().map(|task| task.name().0).collect();
            say!("omitted, because their labels are the same in all samples: {}", names.join(", "));
        }
        for reading in &found {
            let [low, high] = reading.interval;
            let Point { panels, sensors, placement, seed } = point;
            let head = row![trial.hash, panels, sensors, placement, seed, with, trained_for, name];
            let TaskEstimate { task: (task, unit), readout, error, least, trivial, samples, score, .. } =
                reading;
            rows.push(
                [head, row![task, readout, unit, error, low, high, least, trivial, samples, score]].concat(),
            );
        }
        bodies.push(found);
    }
    all.extend(bodies[0].iter().zip(&bodies[1]).map(|(initial, trained)| TaskResult {
        setting: format!("K = {}, M = {}, {with}", point.panels, point.sensors),
        cluster,
        trained_for: trained_for.clone(),
        task: initial.task,
        readout: initial.readout,
        errors: [initial.error, trained.error],
        trivial: initial.trivial,
        error_min: initial.least,
    }));
    Ok(())
}
