//! Compares discarded copies with kept ones: nothing new, equal bits, differences, or discarded work.

use std::collections::{BTreeMap, HashSet};
use std::path::PathBuf;

use sqlx::sqlite::{SqliteConnection, SqliteRow};
use sqlx::{AssertSqlSafe, Row};

use super::input::Input;
use super::{Summary, copy};
use crate::cluster::Shard;

/// A finding about a discarded copy.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct MergeFinding {
    /// Its kind.
    pub kind: FindingKind,
    /// The trial.
    pub hash: String,
    /// File of the kept copy.
    pub kept: PathBuf,
    /// File of the discarded copy.
    pub other: PathBuf,
    /// What differs or is discarded.
    pub what: String,
}

/// Kinds of findings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum FindingKind {
    /// Checkpoints or arrays whose checksums do not match.
    Damaged,
    /// Results differ despite equal instruction sets.
    Bits,
    /// Done in one copy, failed in the other.
    Outcome,
    /// Attempts that the result lacks, because the kept copy is more advanced.
    LeftOut,
}

impl FindingKind {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Damaged => "damaged",
            Self::Bits => "bits differ",
            Self::Outcome => "outcomes differ",
            Self::LeftOut => "discarded",
        }
    }
}

/// Columns of a result that must be bit-identical between runs with the same instruction set.
const COMPARED: [&str; 8] = [
    "error_initial",
    "error_optimised",
    "train_error_initial",
    "train_error_optimised",
    "holdout_error_initial",
    "holdout_error_optimised",
    "best_step",
    "solver",
];

/// Further columns that must be equal in two copies of the same run.
const OF_ONE_RUN: [&str; 3] = ["result", "seconds_evaluation", "finished_at"];

/// Columns that are empty in earlier versions.
const LATER: [&str; 4] = ["median", "p90", "ridge", "kappa"];

/// Whether two specs differ in anything but the paths of recorded forces.
const SPECS_DIFFER: &str = "CASE WHEN json_valid(o.spec) AND json_valid(m.spec)
    THEN json_remove(o.spec, '$.stimuli.recorded.files') <> json_remove(m.spec, '$.stimuli.recorded.files') ELSE o.spec <> m.spec END";

/// A discarded copy, compared with the kept one. Pairs are of the discarded and of the kept copy.
struct DiscardedCopy {
    hash: String,
    /// Input of the kept copy.
    kept: i64,
    states: [String; 2],
    reasons: [String; 2],
    one_simd: bool,
    /// Whether the kept copy has all its attempts: both are of the same run.
    contained: bool,
    /// Whether other code has computed the kept copy again since.
    redone: bool,
    attempts: i64,
    steps: i64,
    /// Ids of the trial.
    ids: [i64; 2],
}

impl DiscardedCopy {
    fn of(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self {
            hash: row.try_get("hash")?,
            kept: row.try_get("kept")?,
            states: [row.try_get("state")?, row.try_get("kept_state")?],
            reasons: [row.try_get("reason")?, row.try_get("kept_reason")?],
            one_simd: row.try_get("one_simd")?,
            contained: row.try_get("contained")?,
            redone: row.try_get("redone")?,
            attempts: row.try_get("attempts")?,
            steps: row.try_get("steps")?,
            ids: [row.try_get("old")?, row.try_get("new")?],
        })
    }
}

/// Lists the damaged checkpoints and arrays of all inputs.
pub(super) async fn damaged(
    out: &mut SqliteConnection,
    inputs: &[Input],
    summary: &mut Summary,
) -> sqlx::Result<()> {
    let sql = "SELECT c.hash, c.input, k.input, group_concat(d.what, ' ' ORDER BY d.what) FROM temp.damage d
         JOIN temp.candidate c ON c.input = d.input AND c.old = d.old JOIN temp.kept k ON k.hash = c.hash GROUP BY d.input, d.old";
    let rows: Vec<(String, i64, i64, String)> = sqlx::query_as(sql).fetch_all(out).await?;
    for (hash, input, kept, what) in rows {
        let [other, kept] = [input, kept].map(|i| inputs[i as usize].named.clone());
        summary.findings.push(MergeFinding { kind: FindingKind::Damaged, hash, kept, other, what });
    }
    Ok(())
}

/// Inputs with discarded copies of attempted trials.
pub(super) async fn losers(out: &mut SqliteConnection) -> sqlx::Result<HashSet<usize>> {
    let sql = "SELECT DISTINCT c.input FROM temp.candidate c JOIN temp.kept k ON k.hash = c.hash
         WHERE c.attempts > 0 AND (c.input <> k.input OR c.old <> k.old)";
    let rows: Vec<i64> = sqlx::query_scalar(sql).fetch_all(out).await?;
    Ok(rows.into_iter().map(|i| i as usize).collect())
}

/// Compares the discarded copies of one input, attached as `src`.
pub(super) async fn compare(
    out: &mut SqliteConnection,
    input: usize,
    inputs: &[Input],
    summary: &mut Summary,
) -> sqlx::Result<()> {
    let sql = "SELECT c.hash, k.input AS kept, o.state, m.state AS kept_state, coalesce(o.reason, '') AS reason,
           coalesce(m.reason, '') AS kept_reason, o.simd IS m.simd AS one_simd,
           NOT EXISTS (SELECT 1 FROM src.attempt a WHERE a.trial_id = c.old AND NOT EXISTS
             (SELECT 1 FROM main.attempt b
              WHERE b.trial_id = k.new AND b.number = a.number AND b.started_at = a.started_at)) AS contained,
           (SELECT coalesce(sum(redone), 0) FROM main.attempt b WHERE b.trial_id = k.new) > c.redone AS redone,
           c.attempts, (SELECT count(*) FROM src.step p WHERE p.trial_id = c.old) AS steps, c.old, k.new
         FROM temp.candidate c JOIN temp.kept k ON k.hash = c.hash
         JOIN src.trial o ON o.id = c.old JOIN main.trial m ON m.id = k.new
         WHERE c.input = ? AND c.attempts > 0 AND (c.input <> k.input OR c.old <> k.old)";
    let rows = sqlx::query(sql).bind(input as i64).fetch_all(&mut *out).await?;
    let tables = if rows.is_empty() { Vec::new() } else { compared(out).await? };
    for copied in rows.iter().map(DiscardedCopy::of) {
        let copied = copied?;
        let DiscardedCopy { hash, kept, attempts, steps, .. } = &copied;
        let ([state, kept_state], [reason, kept_reason]) = (&copied.states, &copied.reasons);
        let mut finding = |kind, what| {
            let (kept, other) = (inputs[*kept as usize].named.clone(), inputs[input].named.clone());
            summary.findings.push(MergeFinding { kind, hash: hash.clone(), kept, other, what });
        };
        match (state.as_str(), kept_state.as_str()) {
            _ if copied.contained && copied.redone => summary.covered += 1,
            ("done", "done") if !copied.one_simd && !copied.contained => summary.not_compared += 1,
            // Copies of the same run, or two results that must be bit-identical.
            (_, kept_state) if copied.contained || state == "done" && kept_state == "done" => {
                match differing(out, &tables, &copied).await?.as_str() {
                    "" => summary.covered += 1,
                    names => finding(FindingKind::Bits, names.to_owned()),
                }
            }
            ("failed", "done") => finding(
                FindingKind::Outcome,
                format!("failed in the discarded copy ({reason}), done in the kept copy"),
            ),
            ("done", _) => finding(
                FindingKind::Outcome,
                format!("done in the discarded copy, {kept_state} ({kept_reason}) in the kept copy"),
            ),
            _ => {
                let because = if reason.is_empty() { String::new() } else { format!(" ({reason})") };
                finding(
                    FindingKind::LeftOut,
                    format!("{state}{because}: {attempts} attempts with {steps} steps"),
                );
            }
        }
    }
    Ok(())
}

/// Names of the result columns, arrays and tables that differ between two copies of a trial. Ignores rows that only one copy
/// has, because versions store different arrays.
async fn differing(
    out: &mut SqliteConnection,
    tables: &[TableComparison],
    copied: &DiscardedCopy,
) -> sqlx::Result<String> {
    let mut differ = vec![format!("CASE WHEN {SPECS_DIFFER} THEN 'spec ' ELSE '' END")];
    if copied.states[0] == copied.states[1] {
        let own = if copied.contained { &OF_ONE_RUN[..] } else { &[] };
        let columns = COMPARED.iter().chain(own);
        differ.extend(columns.map(|c| format!("CASE WHEN o.{c} IS NOT m.{c} THEN '{c} ' ELSE '' END")));
    }
    let differ = differ.join(" || ");
    let mut statements =
        vec![format!("SELECT {differ} FROM src.trial o, main.trial m WHERE o.id = ?1 AND m.id = ?2")];
    for TableComparison { table, keys, numbers } in tables {
        // a step that was repeated belongs to another attempt
        let attempt = if table == "step" && copied.contained { "AND o.attempt = m.attempt" } else { "" };
        let named = if table == "artifact" { "o.name" } else { &format!("'{table}'") };
        statements.push(format!(
            "SELECT coalesce(group_concat(name, ' '), '') FROM (SELECT DISTINCT {named} AS name
             FROM src.{table} o JOIN main.{table} m ON {keys} {attempt}
             WHERE o.trial_id = ?1 AND m.trial_id = ?2 AND ({numbers}) ORDER BY 1)"
        ));
    }
    let mut names = String::new();
    for sql in statements {
        // Safe: contains only names of our own schema.
        let query =
            sqlx::query_scalar::<_, String>(AssertSqlSafe(sql)).bind(copied.ids[0]).bind(copied.ids[1]);
        names += &query.fetch_one(&mut *out).await?;
        names += " ";
    }
    Ok(names.split_whitespace().collect::<Vec<_>>().join(" "))
}

/// A table to compare, with SQL conditions: whether rows of two copies correspond, and whether their numbers or bytes differ.
struct TableComparison {
    table: String,
    keys: String,
    numbers: String,
}

/// The tables whose rows are compared.
async fn compared(out: &mut SqliteConnection) -> sqlx::Result<Vec<TableComparison>> {
    let mut compared = Vec::new();
    for (table, _) in copy::tables_of_trials(out).await? {
        if let Some((keys, numbers)) = numbers_of(out, &table).await? {
            compared.push(TableComparison { table, keys, numbers });
        }
    }
    Ok(compared)
}

/// The conditions of a table; excludes times. `None` for tables without columns to compare.
async fn numbers_of(out: &mut SqliteConnection, table: &str) -> sqlx::Result<Option<(String, String)>> {
    if ["trial", "attempt", "checkpoint", "log", "elsewhere"].contains(&table) {
        return Ok(None);
    }
    let sql = "SELECT name, pk, type FROM pragma_table_info(?, 'main') WHERE name <> 'trial_id'";
    let columns: Vec<(String, i64, String)> = sqlx::query_as(sql).bind(table).fetch_all(out).await?;
    let keys = columns.iter().filter(|column| column.1 > 0);
    let compared = columns.iter().filter(|(name, key, kind)| {
        *key == 0 && (kind == "REAL" && !name.starts_with("seconds") || kind == "BLOB" && name == "bytes")
    });
    let join = |names: Vec<String>, with: &str| names.join(with);
    let keys = join(keys.map(|(name, ..)| format!("o.\"{name}\" = m.\"{name}\"")).collect(), " AND ");
    let differs = |name: &str| if LATER.contains(&name) { "<>" } else { "IS NOT" };
    let differs = |name: &String| format!("o.\"{name}\" {} m.\"{name}\"", differs(name));
    let compared = join(compared.map(|(name, ..)| differs(name)).collect(), " OR ");
    Ok(Some((keys, compared)).filter(|(_, compared)| !compared.is_empty()))
}

/// Shards without a run in any database; empty after a complete run of the whole sweep.
pub(super) async fn missing_shards(out: &mut SqliteConnection) -> sqlx::Result<Vec<(String, u32, Vec<u32>)>> {
    let sql = "SELECT s.name, -s.id, r.shards, r.shard FROM main.run r JOIN main.sweep s ON s.id = r.sweep_id
             WHERE r.shards BETWEEN 1 AND ? AND r.shard BETWEEN 1 AND r.shards AND NOT EXISTS (SELECT 1 FROM main.run w
               WHERE w.sweep_id = r.sweep_id AND w.shards = 1 AND w.outcome = 'complete')
             GROUP BY s.id, r.shards, r.shard";
    let rows: Vec<(String, i64, u32, u32)> = sqlx::query_as(sql).bind(Shard::MOST).fetch_all(out).await?;
    let mut shards_of_sweep: BTreeMap<(i64, u32), (String, HashSet<u32>)> = BTreeMap::new();
    for (name, sweep, shards, shard) in rows {
        shards_of_sweep.entry((sweep, shards)).or_insert_with(|| (name, HashSet::new())).1.insert(shard);
    }
    let missing = |((_, count), (name, there)): ((i64, u32), (String, HashSet<u32>))| {
        let missing: Vec<u32> = (1..=count).filter(|i| !there.contains(i)).collect();
        (!missing.is_empty()).then_some((name, count, missing))
    };
    Ok(shards_of_sweep.into_iter().filter_map(missing).collect())
}
