//! Loads finished trials from a database for the analysis.

use std::collections::{BTreeSet, HashMap};

use serde_json::Value;

use super::answers::answers;
use super::search::{self, SearchState};
use super::{ReportData, States, StoredSweep};

use crate::analysis::numbers::mean;
use crate::analysis::paired::{TrainingMeasure, iteration_ratio};
use crate::analysis::setting::{SharedSettings, differing_paths};
use crate::analysis::trial::{CastDecoder, CurvePoint, LinearErrors, ReadingOnCasts, UnderErrors};
use crate::analysis::{BodyState, Cluster, DecisionTerms, Set, Trial};
use crate::look::{Answer, MOST_ROWS, PictureData, Table};
use crate::provenance;
use crate::reader::{Reader, Row};
use crate::store::StoreError;
use metasense_schemas::reason::CANCELLED;

/// Parts of the time of an outer step: columns of `v_step` and words.
pub(crate) const PARTS: [(&str, &str); 6] = [
    ("seconds_simulate", "simulate"),
    ("seconds_train", "train"),
    ("seconds_differentiate", "differentiate"),
    ("seconds_implicit", "implicit term"),
    ("seconds_project", "project"),
    ("seconds_store", "store"),
];

/// Thins a curve to about fifty points per decade, so that curves of many trials fit into memory.
fn thinned(curve: &[CurvePoint]) -> Vec<CurvePoint> {
    let mut next = 0.0;
    let mut kept: Vec<CurvePoint> = Vec::new();
    for (i, point) in curve.iter().enumerate() {
        if f64::from(point.0) >= next || i + 1 == curve.len() {
            kept.push(*point);
            while next <= f64::from(point.0) {
                next = (1.047 * next).max(next + 1.0);
            }
        }
    }
    kept.shrink_to_fit();
    kept
}

/// Reads all finished trials, ordered by setting. Omits trials that judge a search's designs on fresh seeds, because they train no
/// body. Rows are processed as they arrive; trials keep only the steps and points that the analysis needs.
pub async fn finished_trials(reader: &mut Reader) -> Result<Vec<Trial>, StoreError> {
    let (mut trials, mut places) = (Vec::new(), HashMap::new());
    let mut settings = SharedSettings::default();
    reader
        .each(
            "SELECT id, hash, spec, panels, sensors, placement, seed, units, design_parameters,
               error_initial AS test_error_initial, error_optimised AS test_error_optimised, holdout_error_initial,
               holdout_error_optimised, holdout_median_initial, holdout_median_optimised, seconds_evaluation,
               result->>'$.nonlinear[0][0]' AS nonlinear_acceleration_initial,
               result->>'$.nonlinear[0][1]' AS nonlinear_rotation_initial,
               result->>'$.nonlinear[1][0]' AS nonlinear_acceleration_optimised,
               result->>'$.nonlinear[1][1]' AS nonlinear_rotation_optimised
             FROM trial t WHERE state = 'done' AND NOT EXISTS (
               SELECT 1 FROM sweep_trial x JOIN sweep s ON s.id = x.sweep_id
               WHERE x.trial_id = t.id AND s.spec->'$.goal' IS NOT NULL
                 AND t.seed > (SELECT max(value) FROM json_each(s.spec, '$.sweep.seeds')))
             ORDER BY panels, design_parameters, sensors, placement, seed, hash",
            |row| {
                let hash = row.text("hash").to_owned();
                let spec: Value = serde_json::from_str(row.text("spec"))
                    .map_err(|e| StoreError::unreadable(&hash, "spec", e))?;
                places.insert(row.count("id"), trials.len());
                trials.push(Trial {
                    setting: settings.of(&spec),
                    panels: row.count("panels"),
                    sensors: row.count("sensors"),
                    cluster: Cluster { placement: row.count("placement"), seed: row.count("seed") },
                    units: row.count("units"),
                    design_parameters: row.count("design_parameters"),
                    errors: BodyState::ALL.map(|body| Set::ALL.map(|set| row.number(&set.column(body)))),
                    nonlinear: BodyState::ALL.map(|body| {
                        ["acceleration", "rotation"]
                            .map(|kind| row.number(&format!("nonlinear_{kind}_{}", body.name())))
                    }),
                    seconds: vec![("evaluate", row.number("seconds_evaluation").unwrap_or(0.0))],
                    hash,
                    ..Trial::default()
                });
                Ok::<_, StoreError>(())
            },
        )
        .await?;
    let mut loader = Loader { reader, trials: &mut trials, places: &places };
    loader.histories().await?;
    loader.seconds().await?;
    loader.losses("losses_", |t| &mut t.curves, true).await?;
    loader.losses("long_losses_", |t| &mut t.long_curves, false).await?;
    loader.error_curves().await?;
    loader.long_errors().await?;
    loader.readings().await?;
    loader.casts().await?;
    loader.under().await?;
    loader.tasks().await?;
    trials.shrink_to_fit();
    for trial in &mut trials {
        trial.remove_trained_results();
        trial.history.shrink_to_fit();
        trial.readings.shrink_to_fit();
    }
    Ok(trials)
}

/// Curves of a trial's initial body by network, kept until those of its trained body arrive.
#[derive(Default)]
struct PendingCurves {
    of: String,
    curves: HashMap<usize, Vec<CurvePoint>>,
}

impl PendingCurves {
    /// Stores a curve of the initial body; for the trained body, returns the ratio of iterations.
    fn ratio(&mut self, hash: &str, body: BodyState, network: usize, curve: Vec<CurvePoint>) -> Option<f64> {
        if self.of != hash {
            *self = Self { of: hash.to_owned(), curves: HashMap::new() };
        }
        match body {
            BodyState::Initial => {
                self.curves.insert(network, curve);
                None
            }
            BodyState::Optimised => iteration_ratio(self.curves.get(&network)?, &curve),
        }
    }
}

/// Adds data to loaded trials, by their ids in the database.
struct Loader<'a> {
    reader: &'a mut Reader,
    trials: &'a mut [Trial],
    places: &'a HashMap<u64, usize>,
}

impl Loader<'_> {
    async fn each(
        &mut self,
        sql: &str,
        mut add: impl FnMut(&mut Trial, &Row<'_>) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let (trials, places) = (&mut *self.trials, self.places);
        self.reader
            .each(sql, |row| match places.get(&row.count("trial_id")) {
                Some(&place) => add(&mut trials[place], row),
                None => Ok(()),
            })
            .await
    }

    /// The steps that improve the best error, and the last step, against the CPU time of training the body. Includes steps that
    /// another trial computed, as if each trial had trained its body itself.
    async fn histories(&mut self) -> Result<(), StoreError> {
        let [sum, in_order] =
            [PARTS.map(|(column, _)| column).join(" + "), "PARTITION BY trial_id ORDER BY step".to_owned()];
        let sql = format!(
            "SELECT trial_id, seconds, best FROM
               (SELECT *, lag(best) OVER o AS before, lead(step) OVER o AS after FROM
                 (SELECT trial_id, step, sum({sum}) OVER w AS seconds, min(error_test) OVER w AS best FROM step
                  WINDOW w AS ({in_order} ROWS UNBOUNDED PRECEDING))
                WINDOW o AS ({in_order}))
             WHERE best < before OR before IS NULL OR after IS NULL"
        );
        self.each(&sql, |trial, row| {
            if let (Some(seconds), Some(best)) = (row.number("seconds"), row.number("best")) {
                trial.history.push((seconds, best));
            }
            Ok(())
        })
        .await
    }

    /// The CPU time of each trial, in total and by part, without steps that another trial computed (attempt 0).
    async fn seconds(&mut self) -> Result<(), StoreError> {
        let sums = PARTS.map(|(column, _)| format!("sum({column}) AS {column}")).join(", ");
        let steps = format!("SELECT trial_id, {sums} FROM step WHERE attempt > 0 GROUP BY trial_id");
        self.each(&steps, |trial, row| {
            let parts = PARTS.iter().map(|(column, part)| (*part, row.number(column).unwrap_or(0.0)));
            trial.seconds.splice(0..0, parts);
            Ok(())
        })
        .await?;
        // trials whose steps all come from another trial get the parts as zeros
        if self.trials.iter().any(|trial| trial.seconds.len() > 1) {
            for trial in self.trials.iter_mut().filter(|trial| trial.has_steps() && trial.seconds.len() == 1)
            {
                trial.seconds.splice(0..0, PARTS.map(|(_, part)| (part, 0.0)));
            }
        }
        let all = "SELECT trial_id, sum(seconds) AS seconds FROM spent WHERE NOT redone GROUP BY trial_id";
        self.each(all, |trial, row| {
            trial.spent = row.number("seconds").unwrap_or(0.0);
            // the two clocks differ by some hundredths of a second
            let other = (trial.spent - trial.seconds.iter().map(|part| part.1).sum::<f64>()).max(0.0);
            trial.seconds.push(("other", other));
            Ok(())
        })
        .await
    }

    /// Training losses, thinned from the stored curves. If `compared`, adds the ratios of iterations between bodies.
    async fn losses(
        &mut self,
        prefix: &str,
        curves: fn(&mut Trial) -> &mut [Vec<Vec<CurvePoint>>; 2],
        compared: bool,
    ) -> Result<(), StoreError> {
        let sql = format!(
            "SELECT trial_id, name, bytes, digest FROM artifact
             WHERE name BETWEEN '{prefix}' AND '{prefix}~' ORDER BY trial_id, name"
        );
        let mut waiting = PendingCurves::default();
        self.each(&sql, |trial, row| {
            let name = row.text("name").trim_start_matches(prefix);
            let numbered = name.rsplit_once('_').and_then(|(b, n)| Some((body_named(b)?, n.parse().ok()?)));
            let Some((body, network)) = numbered else { return Ok(()) };
            let losses = row.array(&trial.hash).values::<f32>()?;
            let curve: Vec<CurvePoint> =
                losses.into_iter().zip(1..).map(|(loss, n)| (n, loss.into())).collect();
            *curve_of(&mut curves(trial)[body as usize], network) = thinned(&curve);
            if compared {
                let ratio = waiting.ratio(&trial.hash, body, network, curve);
                trial.iterations[TrainingMeasure::Loss as usize].extend(ratio);
            }
            Ok(())
        })
        .await
    }

    /// Held-out errors during ordinary training. One row per network, because one per point takes far longer.
    async fn error_curves(&mut self) -> Result<(), StoreError> {
        let sql = "SELECT trial_id, body, network, group_concat(iteration || ' ' || printf('%!.17g', error_holdout), ' ') AS points
             FROM curve WHERE error_holdout IS NOT NULL GROUP BY trial_id, body, network";
        let mut waiting = PendingCurves::default();
        self.each(sql, |trial, row| {
            let (Some(body), network) = (body_named(row.text("body")), row.count("network")) else {
                return Ok(());
            };
            let ordinary = trial.setting.count("evaluation.seeds").unwrap_or_default();
            if network >= ordinary {
                return Ok(());
            }
            let mut words = row.text("points").split(' ');
            let mut curve: Vec<CurvePoint> = Vec::new();
            while let (Some(n), Some(error)) = (words.next(), words.next()) {
                curve.extend(n.parse().ok().zip(error.parse().ok()));
            }
            curve.sort_unstable_by_key(|point| point.0);
            let network = network as usize;
            *curve_of(&mut trial.error_curves[body as usize], network) = thinned(&curve);
            let ratio = waiting.ratio(&trial.hash, body, network, curve);
            trial.iterations[TrainingMeasure::Error as usize].extend(ratio);
            Ok(())
        })
        .await
    }

    /// Mean errors of the networks of long training, which follow the ordinary ones.
    async fn long_errors(&mut self) -> Result<(), StoreError> {
        let sql = "SELECT n.trial_id, n.body, avg(n.error_test) AS test, avg(n.error_holdout) AS holdout, avg(n.median) AS median
             FROM network n JOIN trial t ON t.id = n.trial_id
             WHERE n.network >= t.spec->>'$.evaluation.seeds' AND t.spec->>'$.evaluation.long_iterations' > 0
             GROUP BY n.trial_id, n.body";
        self.each(sql, |trial, row| {
            if let Some(body) = body_named(row.text("body")) {
                trial.long_errors[body as usize] = ["test", "holdout", "median"].map(|key| row.number(key));
            }
            Ok(())
        })
        .await
    }

    async fn readings(&mut self) -> Result<(), StoreError> {
        let sql = "SELECT r.trial_id, r.body, r.whole, r.error_test, r.error_holdout, r.median,
               r.before * (t.spec->>'$.time.duration') / (t.spec->>'$.time.samples') AS before,
               r.after * (t.spec->>'$.time.duration') / (t.spec->>'$.time.samples') AS after
             FROM reading r JOIN trial t ON t.id = r.trial_id
             ORDER BY r.trial_id, r.whole DESC, r.before, r.after, r.body";
        self.each(sql, |trial, row| {
            let Some(body) = body_named(row.text("body")) else { return Ok(()) };
            let memory = ["before", "after"].map(|column| row.number(column).unwrap_or(0.0));
            if trial.readings.last().is_none_or(|last| last.memory != memory) {
                let whole = row.count("whole") == 1;
                trial.readings.push(LinearErrors { memory, is_longest: whole, ..LinearErrors::default() });
            }
            let last = trial.readings.len() - 1;
            trial.readings[last].errors[body as usize] =
                ["error_test", "error_holdout", "median"].map(|column| row.number(column));
            Ok(())
        })
        .await
    }

    /// Quantiles over casts, interpolated between the two nearest order statistics.
    async fn casts(&mut self) -> Result<(), StoreError> {
        let quantile = |of: &str, place: &str, q: f64| {
            format!("sum({of} * max(0, 1 - abs({q:?} * (count - 1) - {place})))")
        };
        let partition = "PARTITION BY trial_id, body, reader, records";
        let sql = format!(
            "SELECT trial_id, body, reader, records, count, sum(outcome <> 'ok') AS failed, {} AS middle, {} AS most,
               {} AS sample_median FROM
               (SELECT *, row_number() OVER ({partition} ORDER BY error) - 1 AS place, count(*) OVER ({partition}) AS count,
                  row_number() OVER ({partition} ORDER BY coalesce(median, error)) - 1 AS median_place
                FROM cast_reading WHERE error IS NOT NULL)
             GROUP BY trial_id, body, reader, records",
            quantile("error", "place", 0.5),
            quantile("error", "place", 0.9),
            quantile("coalesce(median, error)", "median_place", 0.5)
        );
        self.each(&sql, |trial, row| {
            let named = body_named(row.text("body"))
                .zip(CastDecoder::named(row.text("reader"), row.count("records") as u32));
            let errors = row.number("middle").zip(row.number("most")).map(<[f64; 2]>::from);
            if let (Some((body, decoder)), Some(errors)) = (named, errors) {
                let (casts, failed) = (row.count("count"), row.count("failed"));
                let median = row.number("sample_median");
                trial.casts.push(ReadingOnCasts { body, decoder, casts, failed, errors, median });
            }
            Ok(())
        })
        .await
    }

    async fn under(&mut self) -> Result<(), StoreError> {
        let sql = "SELECT t.id AS trial_id, u.value->>'$.body' AS body, u.value->>'$.stimuli' AS stimuli,
               u.value->>'$.reader' = 'own' AS own, u.value->>'$.error' AS error,
               u.value->>'$.spread.median' AS median
             FROM trial t, json_each(t.result, '$.under') u WHERE t.state = 'done' ORDER BY t.id, u.key";
        self.each(sql, |trial, row| {
            let read = body_named(row.text("body")).zip(row.number("error").filter(|error| *error > 0.0));
            let Some((body, error)) = read else { return Ok(()) };
            let (stimuli, own) = (row.text("stimuli").to_owned(), row.count("own") == 1);
            let median = row.number("median").filter(|error| *error > 0.0);
            trial.under.push(UnderErrors { body, stimuli, own, error, median });
            Ok(())
        })
        .await
    }

    async fn tasks(&mut self) -> Result<(), StoreError> {
        let sql = "SELECT id AS trial_id, result->'$.tasks' AS tasks FROM trial
             WHERE state = 'done' AND json_array_length(result, '$.tasks') > 0";
        self.each(sql, |trial, row| {
            trial.tasks = serde_json::from_str(row.text("tasks"))
                .map_err(|e| StoreError::unreadable(&trial.hash, "result", e))?;
            Ok(())
        })
        .await
    }
}

fn body_named(name: &str) -> Option<BodyState> {
    BodyState::ALL.into_iter().find(|b| b.name() == name)
}

fn curve_of(curves: &mut Vec<Vec<CurvePoint>>, network: usize) -> &mut Vec<CurvePoint> {
    if curves.len() <= network {
        curves.resize(network + 1, Vec::new());
    }
    &mut curves[network]
}

/// Reads all data of a report. `trial` is the trial to replay, by its hash or the beginning of it.
pub async fn story(
    reader: &mut Reader,
    trial: Option<&str>,
    terms: DecisionTerms,
) -> Result<ReportData, StoreError> {
    let trials = finished_trials(reader).await?;
    let sweeps = sweeps(reader).await?;
    let states = states(reader, &differing_paths(trials.iter().map(|trial| &trial.setting))).await?;
    let searches = SearchState::all(reader, &sweeps).await;
    let design = searches.iter().flatten().find_map(|search| Some(&search.chosen()?.0.hash));
    let replayed = trial.or(design.map(String::as_str));
    let stored = match replayed.or_else(|| Some(&typical(&trials)?.hash)) {
        Some(hash) => reader.stored(hash).await?,
        None => None,
    };
    let made = reader.code_versions().await?;
    let caveats = provenance::caveats(reader, &made).await?;
    Ok(ReportData { sweeps, states, trials, code_versions: made, caveats, stored, terms, searches })
}

/// The verdicts of a report in words, without the report.
pub async fn verdicts(
    reader: &mut Reader,
    trials: &[Trial],
    terms: DecisionTerms,
) -> Result<Vec<Answer>, StoreError> {
    let sweeps = sweeps(reader).await?;
    let mut said = search::answers(&SearchState::all(reader, &sweeps).await);
    said.extend(answers(trials, terms));
    Ok(said)
}

async fn sweeps(reader: &mut Reader) -> Result<Vec<StoredSweep>, StoreError> {
    let columns = ["name", "text", "version", "created_at"];
    let sql = "SELECT name, text, version, created_at, spec->'$.goal' IS NOT NULL AS searched
         FROM sweep ORDER BY created_at, name";
    let sweeps = reader.rows(sql, |row| {
        let [name, text, version, created_at] = columns.map(|column| row.text(column).to_owned());
        StoredSweep { name, text, version, created_at, searched: row.count("searched") == 1 }
    });
    sweeps.await
}

/// Columns of trials on the page, after hash, state, reason and settings that vary.
const SHOWN: &str = "panels, sensors, placement, seed, units, design_parameters, brain, trained_with,
  spec->>'$.optimise.objective' AS objective, protocol,
  error_initial AS test_error_initial, error_optimised AS test_error_optimised, holdout_error_initial, holdout_error_optimised,
  holdout_median_initial, holdout_median_optimised, holdout_above_initial, holdout_above_optimised,
  steps, attempts, seconds, simd";
/// Further columns in the file of trials, so that a row is understood without other files.
const BESIDES: &str = "linear_holdout_error_initial, linear_holdout_error_optimised, holdout_p90_initial, holdout_p90_optimised,
  holdout_rms_initial, holdout_rms_optimised";

/// Maximum number of settings that vary on the page; the file contains all.
const MOST_PATHS: usize = 6;

/// All trials with one column per path in `paths`.
async fn states(reader: &mut Reader, paths: &BTreeSet<&str>) -> Result<States, StoreError> {
    let column = |path: &&str| format!("spec->>'$.{path}' AS \"{path}\", ");
    let [first, rest]: [String; 2] = [
        paths.iter().take(MOST_PATHS).map(column).collect(),
        paths.iter().skip(MOST_PATHS).map(column).collect(),
    ];
    let sql = format!(
        "SELECT hash, state, reason, {first}{SHOWN}, {rest}{BESIDES} FROM v_trial
         ORDER BY state = 'failed' DESC, panels, units, sensors, placement, seed"
    );
    let (all, shown) =
        (reader.columns(&sql).await?, 3 + paths.len().min(MOST_PATHS) + SHOWN.split(',').count());
    let mut data = PictureData::new(&all);
    let first = Table { columns: all[..shown].to_vec(), rows: Vec::new() };
    let [state, reason] = ["state", "reason"].map(|name| first.column(name));
    let mut states = States { first, ..States::default() };
    reader
        .rows(&sql, |row| {
            let mut values = row.values();
            data.row(&values);
            states.all += 1;
            states.done += usize::from(values[state] == "done");
            let given_up = values[reason].as_str() == Some(CANCELLED);
            states.failed += usize::from(values[state] == "failed" && !given_up);
            if states.first.rows.len() < MOST_ROWS {
                values.truncate(shown);
                states.first.rows.push(values);
            }
        })
        .await?;
    states.first.leave_out_spread();
    Ok(States { csv: data.text(), ..states })
}

/// The trial whose ratio of held-out errors is nearest to the mean; if no initial body was evaluated, whose held-out error is.
/// Never a trial that starts from a random body.
fn typical(trials: &[Trial]) -> Option<&Trial> {
    let log_ratio =
        |first: f64, t: &Trial| Some(first.ln() - t.error(BodyState::Optimised, Set::Holdout)?.ln());
    let all = |measure: &dyn Fn(&Trial) -> Option<f64>| -> Vec<(f64, &Trial)> {
        trials.iter().filter(|t| !t.starts_random()).filter_map(|t| Some((measure(t)?, t))).collect()
    };
    let mut measured = all(&|t| log_ratio(t.error(BodyState::Initial, Set::Holdout)?, t));
    if measured.is_empty() {
        measured = all(&|t| log_ratio(1.0, t));
    }
    let mean = mean(&measured.iter().map(|m| m.0).collect::<Vec<_>>())?;
    measured.iter().min_by(|a, b| (a.0 - mean).abs().total_cmp(&(b.0 - mean).abs())).map(|m| m.1)
}
