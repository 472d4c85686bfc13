//! `tasks`: estimates quantities other than forces from the signals of finished bodies.

use metasense_lab::tasks::{SensingTask, tasks};
use metasense_schemas::record::TaskReading;
use serde_json::Value;

use super::named::Finished;
use super::{Error, Format, cores, print_rows};
use crate::analysis::kinds::trained_with;
use crate::analysis::tasks::{matrix, results, table, trained_for};
use crate::analysis::{BodyState, Cluster, Trial};
use crate::exit::Exit;
use crate::look::{Table, row, short_hash};
use crate::reader::StoredTrial;

/// Estimates quantities other than forces from finished bodies: where, how many, when
///
/// Each quantity (task) is estimated in several ways on the held-out set. `direct`: ridge regression on the signals of the
/// whole record, or of `brain.window` from the contact on. `network`: in a window, a small network per task. `decoded`: from
/// the forces that a linear decoder estimates. The table has means over the trials of a setting, and the error of a predictor
/// without signals (trivial). It also has the ratio initial / trained with its 95 % interval over seeds and placements, in
/// which each error is at least half the error of one sample. If bodies were trained for several tasks (brain.task), a
/// transfer matrix follows: this ratio per task and training. Other formats have one row per trial, body, task and readout,
/// with its window (s), a 95 % interval over samples and a score: balanced accuracy (%) of classes, R² of values. With
/// `evaluation.casts`, rows have the mean error over casts. Classes, except decoded ones, have log loss and calibration
/// error (%) of their probabilities. Tasks: forces (% of their squares); panel, the panel with the greatest force (%
/// wrong); count, the number of panels with more than a tenth of it (% wrong); position, the panels' mean position weighted
/// by impulse (mm); peak (N) and impulse (mN s) of each panel; onset, when a force first exceeds a tenth of the greatest
/// (ms); kind, the part of `stimuli.mix` (% wrong; not decoded). A task whose label is the same in all samples is omitted.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    trials: Finished,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let lacks_estimates = |trial: &Trial| BodyState::ALL.iter().any(|body| !has_estimates(trial, *body));
    let trials = args.trials.visit(lacks_estimates, estimate).await?;
    let names = SensingTask::ALL.map(|task| task.name().0);
    let is_constant = |name: &&str| trials[0].tasks.iter().all(|read| read.task != *name);
    let constant: Vec<&str> = names.into_iter().filter(is_constant).collect();
    if !constant.is_empty() {
        say!("omitted, because their labels are the same in all samples: {}", constant.join(", "));
    }
    let further = "casts log_loss calibration_error";
    let columns =
        format!("{HEAD} window task readout unit error low high least trivial samples score {further}");
    match args.trials.format {
        Format::Table => {
            let all = results(&trials.iter().collect::<Vec<_>>());
            let mut means = table(&all);
            for column in ["elbow", "ratio_by_placement"] {
                let at = means.column(column);
                if means.rows.iter().all(|row| row[at].is_null()) {
                    means.drop_columns(&[column]);
                }
            }
            print_rows(&means, Format::Table)?;
            if let Some(matrix) = matrix(&all) {
                print_line!("\nratio initial/trained by the task of the training:")?;
                print_rows(&matrix, Format::Table)?;
            }
        }
        format => print_rows(&Table::new(&columns, trials.iter().flat_map(rows)), format)?,
    }
    Ok(Exit::Done)
}

fn has_estimates(trial: &Trial, body: BodyState) -> bool {
    trial.tasks.iter().any(|read| read.body == body.name())
}

/// Adds the estimates that the trial has not stored.
fn estimate(stored: &StoredTrial, trial: &mut Trial) -> Result<(), Error> {
    for body in BodyState::ALL.into_iter().filter(|body| !has_estimates(trial, *body)).collect::<Vec<_>>() {
        let of = body as usize;
        let found = tasks(&stored.specs[of], of, &stored.designs[of], cores())
            .map_err(|e| Error::Usage(format!("trial {}: {e}", short_hash(&trial.hash))))?;
        trial.tasks.extend(found);
    }
    trial.tasks.sort_by_key(|read| read.body != BodyState::Initial.name());
    Ok(())
}

/// First columns of rows about a body.
pub(super) const HEAD: &str = "hash panels sensors placement seed trained_with trained_for body";

/// Values of the first columns.
pub(super) fn head(trial: &Trial, body: &str) -> Vec<Value> {
    let Cluster { placement, seed } = trial.cluster;
    let (with, trained_for) = (trained_with(&trial.setting), trained_for(trial));
    row![trial.hash, trial.panels, trial.sensors, placement, seed, with, trained_for, body]
}

fn rows(trial: &Trial) -> Vec<Vec<Value>> {
    let row = |read: &TaskReading| {
        let TaskReading { task, readout, unit, error, interval: [low, high], least, trivial, .. } = read;
        let estimate = row![task, readout, unit, error, low, high, least, trivial, read.samples, read.score];
        let further = row![read.casts, read.log_loss, read.calibration_error];
        let window = trial.setting.number("brain.window").filter(|_| read.readout != "decoded");
        [head(trial, &read.body), row![window], estimate, further].concat()
    };
    trial.tasks.iter().map(row).collect()
}
