//! `operator`: information in the signals of initial and trained bodies, and how it correlates with the gain.

use std::path::PathBuf;

use metasense_lab::operator::{OperatorFigures, operator_figures};
use serde_json::json;

use super::named::Finished;
use super::{Error, Format, print_rows, write};
use crate::analysis::kinds::brains_of;
use crate::analysis::numbers::distinct;
use crate::analysis::operator::{BodyPair, MEASURES, table};
use crate::analysis::{BodyState, Cluster, Set, Trial};
use crate::exit::Exit;
use crate::look::{Axis, Legend, Plot, Scale, Table, file, number, row, short_hash};
use crate::reader::StoredTrial;

/// Computes the information about the forces in the signals, independent of the decoder
///
/// Valid for small motions about rest. Computed from the linear operator that maps the spectrum of the forces to the
/// signals, relative to the sensors' noise (1 % of each channel's RMS on the initial body if the spec has none). The
/// measures are: the error of Wiener's filter, the best linear decoder; the number of distinguishable forces (the
/// exponential of the entropy of squared singular values, from 1 to K); the condition number, the first singular value divided
/// by the last; bits per second; the mean duration of the response to an impulse; the number of participating modes, by the
/// energies E of their own signals ((ΣE)²/ΣE²). Each is a geometric mean over the trials of a setting. Also printed: the
/// rank correlation of its change with the gain, with a 95 % interval (Fisher's z with the standard deviation √(1.06/(n −
/// 3)); n is the number of seeds or of placements, whichever is smaller). Other formats have one row per trial and body.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    trials: Finished,
    /// Draws the gain of Wiener's filter and the measured gain
    #[arg(long, value_name = "FILE.svg", help_heading = "Output")]
    out: Option<PathBuf>,
}

/// A finished trial: its name and decoders, and the measures of its bodies.
struct TrialMeasures {
    hash: String,
    panels: u64,
    sensors: u64,
    brains: [String; 2],
    change: BodyPair,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let mut seen: Vec<TrialMeasures> = Vec::new();
    let compared = |trial: &Trial| errors(trial).is_some();
    args.trials
        .visit(compared, |stored, trial| {
            seen.extend(errors(trial).map(|errors| measures(stored, trial, errors)).transpose()?);
            Ok(())
        })
        .await?;
    if seen.is_empty() {
        return usage!("no finished trial has held-out errors of both bodies");
    }
    seen.sort_by_cached_key(|of| (of.panels, of.sensors, of.change.cluster, of.hash.clone()));
    let table = match args.trials.format {
        Format::Table => table(&seen.iter().map(|seen| seen.change.clone()).collect::<Vec<_>>()),
        _ => rows(&seen),
    };
    print_rows(&table, args.trials.format)?;
    if let Some(out) = &args.out {
        write(out, drawn(&seen))?;
        say!("written {}", out.display());
    }
    Ok(Exit::Done)
}

/// Held-out errors (%) of both bodies, which are the same without outer steps; `None` if one is missing.
fn errors(trial: &Trial) -> Option<[f64; 2]> {
    let trained = if trial.has_steps() { BodyState::Optimised } else { BodyState::Initial };
    Some([trial.error(BodyState::Initial, Set::Holdout)?, trial.error(trained, Set::Holdout)?])
}

fn measures(stored: &StoredTrial, trial: &Trial, errors: [f64; 2]) -> Result<TrialMeasures, Error> {
    let mut measured = [[0.0; MEASURES.len()]; 2];
    for (b, to) in measured.iter_mut().enumerate() {
        let found = operator_figures(&stored.specs[b], &stored.designs[b])
            .map_err(|e| Error::Usage(format!("trial {}: {e}", short_hash(&trial.hash))))?;
        let OperatorFigures { error, rank, condition, bits, memory, modes } = found;
        *to = [error, rank, condition, bits, memory, modes];
    }
    let brains = brains_of(&json!(stored.specs[1]));
    let [brain, trained] = &brains;
    let by = if brain == trained { brain.clone() } else { format!("{trained}, decoder {brain}") };
    let setting = format!("K = {}, M = {}, {by}", trial.panels, trial.sensors);
    let change = BodyPair { setting, cluster: trial.cluster, errors, measured };
    let &Trial { panels, sensors, .. } = trial;
    Ok(TrialMeasures { hash: trial.hash.clone(), panels, sensors, brains, change })
}

fn rows(seen: &[TrialMeasures]) -> Table {
    let columns = "hash panels sensors placement seed brain trained_with body error wiener_error distinguishable_forces condition bits memory modes";
    let of = |of: &TrialMeasures, b: usize| {
        let TrialMeasures { hash, panels, sensors, brains: [brain, trained], change } = of;
        let (Cluster { placement, seed }, body) = (change.cluster, BodyState::ALL[b].name());
        row![hash, panels, sensors, placement, seed, brain, trained, body, change.errors[b]; change.measured[b]]
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
