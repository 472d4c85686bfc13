//! Output at the end of `run`: failed trials and all results.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use metasense_schemas::reason::CANCELLED;
use metasense_schemas::spec::TrialSpec;
use serde_json::{Value, json};

use super::point::values_at;
use super::{Error, Format, print_rows};
use crate::analysis::kinds::brains_of;
use crate::cell::brief;
use crate::files;
use crate::look::Table;
use crate::plan::{Plan, counted};
use crate::provenance;
use crate::reader::{Reader, quoted};

/// Maximum number of rows printed for people.
const MOST_ROWS: usize = 400;

/// Files of a run.
#[derive(Clone, Copy)]
pub(super) struct Results<'a> {
    /// The database to read.
    pub db: &'a Path,
    /// The database that messages name.
    pub named: &'a Path,
    /// The log, which contains the failures.
    pub log: &'a Path,
}

/// Prints the failed trials, then one row per trial; returns the number of failed trials.
pub(super) async fn print_results(from: Results<'_>, plan: &Plan, format: Format) -> Result<usize, Error> {
    // -1: no limit
    let limit = if format == Format::Table { MOST_ROWS as i64 } else { -1 };
    let (settled, mut table, unresolved) = Reader::with_reader(from.db, async |reader| {
        let settled = reader.query::<Table>(&of_plan("t.hash, t.state, t.reason", plan)).await?;
        let hashes_of_plan = of_plan("t.hash", plan);
        let sql = format!(
            "SELECT panels AS K, sensors AS M, placement, seed, units, brain, trained_with, placed,
               error_initial AS test_error_initial, error_optimised AS test_error_optimised, holdout_error_initial,
               holdout_error_optimised, holdout_median_initial, holdout_median_optimised, holdout_above_initial,
               holdout_above_optimised, seconds, state, reason, hash
             FROM v_trial WHERE hash IN ({hashes_of_plan})
             ORDER BY panels, sensors, units, placement, seed, brain, trained_with, placed, hash LIMIT {limit}"
        );
        Ok::<_, Error>((settled, reader.query::<Table>(&sql).await?, reader.unresolved().await?))
    })
    .await?;
    name_brains(&mut table, plan);
    if format == Format::Table {
        add_axes(&mut table, plan);
    }
    if format == Format::Table && !table.rows.is_empty() {
        drop_default_columns(&mut table);
    }
    let failed = say_failures(from, &settled);
    print_rows(&table, format)?;
    let own: HashSet<&str> = plan.trials.iter().map(|trial| trial.hash.as_str()).collect();
    let unresolved: Vec<String> = unresolved.into_iter().filter(|hash| own.contains(&**hash)).collect();
    provenance::unresolved_trials(&unresolved).iter().for_each(|caveat| say!("warning: {caveat}"));
    if let more @ 1.. = settled.rows.len() - table.rows.len() {
        say!("… and {more} more: metasense query {} \"SELECT * FROM v_trial\"", files::quoted(from.named));
    }
    Ok(failed)
}

/// SQL for the plan's trials. The sweep in the database may have more, if files that the spec names have changed.
fn of_plan(columns: &str, plan: &Plan) -> String {
    let hashes: Vec<&str> = plan.trials.iter().map(|trial| trial.hash.as_str()).collect();
    let hashes = quoted(&serde_json::to_string(&hashes).expect("texts are JSON"));
    format!("SELECT {columns} FROM json_each({hashes}) j JOIN trial t ON t.hash = j.value ORDER BY j.key")
}

/// Replaces the names of decoders by those that figures use.
fn name_brains(table: &mut Table, plan: &Plan) {
    let specs: HashMap<&str, &TrialSpec> = plan.trials.iter().map(|t| (t.hash.as_str(), &t.spec)).collect();
    let mut known: HashMap<String, [String; 2]> = HashMap::new();
    let [read, trained, hash] = ["brain", "trained_with", "hash"].map(|name| table.column(name));
    for row in &mut table.rows {
        let Some(spec) = row[hash].as_str().and_then(|hash| specs.get(hash)) else { continue };
        let of = json!({ "brain": spec.brain, "optimise": spec.optimise, "variation": spec.variation,
            "stimuli": { "kind": spec.stimuli.kind } });
        let names = known.entry(of.to_string()).or_insert_with(|| brains_of(&of));
        [row[read], row[trained]] = names.clone().map(Value::from);
    }
}

/// Inserts the keys that the sweep varies as columns after `units`; decoders have columns already.
fn add_axes(table: &mut Table, plan: &Plan) {
    let mut axes = plan.spec.sweep.keys();
    axes.remove("brain.kind");
    let specs: HashMap<&str, &TrialSpec> = plan.trials.iter().map(|t| (t.hash.as_str(), &t.spec)).collect();
    let [hash, behind] = ["hash", "units"].map(|name| table.column(name));
    for row in &mut table.rows {
        let spec = row[hash].as_str().and_then(|hash| specs.get(hash));
        let spec = spec.map_or(Value::Null, |spec| json!(spec));
        row.splice(behind + 1..behind + 1, values_at(&spec, &axes, brief));
    }
    table.columns.splice(behind + 1..behind + 1, axes.into_iter().map(str::to_owned));
}

/// Drops columns that have the usual value in every row: done, random placement, the paper's decoder, no sample above 100 %.
fn drop_default_columns(table: &mut Table) {
    table.leave_out_spread();
    let usual: [(&[&str], &str, &[&str]); 3] = [
        (&["state"], "done", &["state", "reason", "hash"]),
        (&["placed"], "random", &["placed"]),
        (&["brain", "trained_with"], "cnn", &["brain", "trained_with"]),
    ];
    for (columns, value, left_out) in usual {
        let at: Vec<usize> = columns.iter().map(|name| table.column(name)).collect();
        if table.rows.iter().all(|row| at.iter().all(|&at| row[at] == value)) {
            table.drop_columns(left_out);
        }
    }
}

/// Prints the failed trials with a remedy, and the number of cancelled trials. Returns the number of failed trials.
fn say_failures(Results { named, log, .. }: Results<'_>, settled: &Table) -> usize {
    let [hash, state, reason] = ["hash", "state", "reason"].map(|name| settled.column(name));
    let cell_text = |row: &'_ [Value], at: usize| row[at].as_str().unwrap_or_default().to_owned();
    let failed = settled.rows.iter().filter(|row| row[state] == "failed");
    let failed = failed.map(|row| (cell_text(row, hash), cell_text(row, reason)));
    let (cancelled, failed): (Vec<_>, Vec<_>) = failed.partition(|(_, why)| why == CANCELLED);
    if !cancelled.is_empty() {
        say!("{} cancelled on request; --retry-failed resumes them", counted(cancelled.len(), "trial"));
    }
    for (hash, reason) in failed.iter().take(MOST_ROWS) {
        say!("failed: trial {hash} ({reason})");
    }
    if failed.len() > MOST_ROWS {
        say!("… and {} more failed: metasense status {}", failed.len() - MOST_ROWS, files::quoted(named));
    }
    if !failed.is_empty() {
        say!("{} contains reasons and remedies; --retry-failed resumes these trials", log.display());
    }
    failed.len()
}
