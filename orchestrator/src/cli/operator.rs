//! `operator`: information in the signals of initial and trained bodies, and how it correlates with the gain.

use std::path::PathBuf;

use metasense_lab::operator::{OperatorFigures, operator_figures};
use serde_json::json;

use super::named::Database;
use super::{Error, Format, print_rows, write};
use crate::analysis::Cluster;
use crate::analysis::kinds::brains_of;
use crate::analysis::numbers::distinct;
use crate::analysis::operator::{BodyPair, MEASURES, table};
use crate::exit::Exit;
use crate::look::{Axis, Legend, Plot, Scale, Table, file, number, row, short_hash};
use crate::reader::Reader;

/// Computes the information about the forces in the signals, independent of the decoder
///
/// Valid for small motions about rest. Computed from the linear operator that maps the spectrum of the forces to the
/// signals, relative to the sensors' noise (1 % of each channel's RMS on the initial body if the spec has none). The
/// measures are: the error of Wiener's filter, the best linear decoder; the number of distinguishable forces (the
/// exponential of the entropy of squared singular values, from 1 to K); the condition number, the first singular value divided
/// by the last; bits per second; the mean duration of the response to an impulse; the number of participating modes, by the
/// energies E of their own signals ((ΣE)²/ΣE²). Each is a geometric mean over the trials of a setting. Also printed: the
/// rank correlation of its change with the gain, with a 95 % interval (Fisher's z with the standard deviation √(1.06/(n −
/// 3)); n is the number of seeds or of placements, whichever is smaller).
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The database
    #[arg(value_name = "DB")]
    db: PathBuf,
    /// Prints one row per trial and body instead of the table of measures
    #[arg(long, help_heading = "Output")]
    rows: bool,
    /// Draws the gain of Wiener's filter and the measured gain
    #[arg(long, value_name = "FILE.svg", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Format of the table
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

/// A finished trial: its name and decoders, and the measures of its bodies.
struct TrialMeasures {
    head: Vec<serde_json::Value>,
    change: BodyPair,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let seen = Reader::with_reader(Database::at(&args.db).await?, async |reader| -> Result<_, Error> {
        let sql =
            "SELECT hash, panels, sensors, placement, seed, holdout_error_initial, holdout_error_optimised
                     FROM v_trial
                    WHERE state = 'done' AND holdout_error_initial > 0 AND holdout_error_optimised > 0
                    ORDER BY panels, sensors, placement, seed, hash";
        let mut seen = Vec::new();
        for row in reader.query::<Table>(sql).await?.rows {
            let hash = row[0].as_str().unwrap_or_default();
            let Some(stored) = reader.stored(hash).await? else { continue };
            let mut measured = [[0.0; MEASURES.len()]; 2];
            for (b, to) in measured.iter_mut().enumerate() {
                let found = operator_figures(&stored.specs[b], &stored.designs[b])
                    .map_err(|e| Error::Usage(format!("trial {}: {e}", short_hash(hash))))?;
                let OperatorFigures { error, rank, condition, bits, memory, modes } = found;
                *to = [error, rank, condition, bits, memory, modes];
            }
            let whole = |i: usize| row[i].as_u64().unwrap_or_default();
            let cluster = Cluster { placement: whole(3), seed: whole(4) };
            let errors = [5, 6].map(|i| row[i].as_f64().unwrap_or_default());
            let [brain, trained] = brains_of(&json!(stored.specs[1]));
            let by = if brain == trained { brain.clone() } else { format!("{trained}, decoder {brain}") };
            let setting = format!("K = {}, M = {}, {by}", row[1], row[2]);
            let change = BodyPair { setting, cluster, errors, measured };
            let head = [&row[..5], &row![brain, trained][..]].concat();
            seen.push(TrialMeasures { head, change });
        }
        Ok(seen)
    })
    .await?;
    if seen.is_empty() {
        let db = args.db.display();
        return usage!("{db} contains no finished trial; see `metasense status {db}`");
    }
    if args.rows {
        print_rows(&rows(&seen), args.format)?;
    } else {
        print_rows(&table(&seen.iter().map(|seen| seen.change.clone()).collect::<Vec<_>>()), args.format)?;
    }
    if let Some(out) = &args.out {
        write(out, drawn(&seen))?;
        say!("written {}", out.display());
    }
    Ok(Exit::Done)
}

fn rows(seen: &[TrialMeasures]) -> Table {
    let columns = "hash panels sensors placement seed brain trained_with body error wiener_error distinguishable_forces condition bits memory modes";
    let of = |TrialMeasures { head, change }: &TrialMeasures, b: usize| {
        let body = ["initial", "optimised"][b];
        [head.clone(), row![body, change.errors[b]; change.measured[b]]].concat()
    };
    Table::new(columns, seen.iter().flat_map(|trial| [of(trial, 0), of(trial, 1)]))
}

/// Classes of legend entries and, after the blank, of dots, per setting in turn.
const CLASSES: [&str; 5] = ["dot optimised", "dot front", "dot fourth", "dot fifth", "dot initial"];

/// Plots gains of the trials' decoders over gains of Wiener's filter.
fn drawn(seen: &[TrialMeasures]) -> String {
    let gains = |TrialMeasures { change, .. }: &TrialMeasures| {
        (change.measured[0][0] / change.measured[1][0], change.errors[0] / change.errors[1])
    };
    let points: Vec<(f64, f64)> = seen.iter().map(gains).collect();
    let x = Axis::new("gain of Wiener's filter, small motions", Scale::Log, points.iter().map(|p| p.0));
    let y = Axis::new("gain of the trial's decoder, held-out set", Scale::Log, points.iter().map(|p| p.1));
    let mut plot = Plot::new("Gain from training: Wiener's filter and the trial's decoder", x, y);
    let (low, high) =
        points.iter().fold((f64::INFINITY, 0.0f64), |(l, h), p| (l.min(p.0.max(p.1)), h.max(p.0.min(p.1))));
    plot.line("equal", [(low, low), (high, high)]);
    let text = |change: &BodyPair, (x, y): &(f64, f64)| {
        let Cluster { placement, seed } = change.cluster;
        let (setting, x, y) = (&change.setting, number(*x), number(*y));
        format!("{setting}, placement {placement}, seed {seed}: {x} and {y} times")
    };
    let settings = distinct(seen.iter().map(|trial| &trial.change.setting));
    let mut key = Legend::default();
    for (setting, class) in settings.into_iter().zip(CLASSES.into_iter().cycle()) {
        let own = seen.iter().zip(&points).filter(|(trial, _)| trial.change.setting == *setting);
        plot.dots(&class["dot ".len()..], own.map(|(trial, point)| (*point, text(&trial.change, point))));
        key.push((class, setting.clone()));
    }
    file(&[plot.picture()], 1, 480.0, &key)
}
