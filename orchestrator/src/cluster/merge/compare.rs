//! What the copies that were not kept hold: nothing new, equal bits, something that disagrees, or work that is left out.

use std::collections::{BTreeMap, HashSet};
use std::path::PathBuf;

use sqlx::AssertSqlSafe;
use sqlx::sqlite::SqliteConnection;

use super::Summary;
use super::input::Input;
use crate::cluster::Shard;

/// What is to be said of a copy that was not kept.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Finding {
    /// What kind.
    pub kind: Kind,
    /// The trial.
    pub hash: String,
    /// Whose copy was kept.
    pub kept: PathBuf,
    /// Whose was not.
    pub other: PathBuf,
    /// What differs, or what is left out.
    pub what: String,
}

/// Kinds of findings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// One instruction set, one trial, other bits.
    Bits,
    /// Done in one, given up in the other.
    Outcome,
    /// Attempts that are not in the result, as the other copy has come farther.
    LeftOut,
}

impl Kind {
    /// As tables have it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Bits => "bits differ",
            Self::Outcome => "outcomes differ",
            Self::LeftOut => "left out",
        }
    }
}

/// Columns of a result that are equal to the bit between runs of one instruction set.
const COMPARED: [&str; 9] = [
    "spec",
    "error_initial",
    "error_optimised",
    "train_error_initial",
    "train_error_optimised",
    "holdout_error_initial",
    "holdout_error_optimised",
    "best_step",
    "solver",
];

/// Hash, whose copy is kept, state and reason here and there, one instruction set, all of it in the kept one, attempts,
/// steps, columns that differ, number here and there.
type Copied = (String, i64, String, String, String, String, bool, bool, i64, i64, String, i64, i64);

/// Inputs with copies of tried trials that were not kept.
pub(super) async fn losers(out: &mut SqliteConnection) -> sqlx::Result<HashSet<usize>> {
    let rows: Vec<i64> = sqlx::query_scalar(
        "SELECT DISTINCT c.input FROM temp.candidate c JOIN temp.kept k ON k.hash = c.hash
         WHERE c.attempts > 0 AND (c.input <> k.input OR c.old <> k.old)",
    )
    .fetch_all(out)
    .await?;
    Ok(rows.into_iter().map(|i| i as usize).collect())
}

/// Looks at those of one input, attached as `src`.
pub(super) async fn compare(
    out: &mut SqliteConnection,
    input: usize,
    inputs: &[Input],
    summary: &mut Summary,
) -> sqlx::Result<()> {
    let differs =
        COMPARED.map(|c| format!("CASE WHEN o.{c} IS NOT m.{c} THEN '{c} ' ELSE '' END")).join(" || ");
    let sql = format!(
        "SELECT c.hash, k.input, o.state, m.state, coalesce(o.reason, ''), coalesce(m.reason, ''), o.simd IS m.simd,
           NOT EXISTS (SELECT 1 FROM src.attempt a WHERE a.trial_id = c.old AND NOT EXISTS
             (SELECT 1 FROM main.attempt b
              WHERE b.trial_id = k.new AND b.number = a.number AND b.started_at = a.started_at)),
           c.attempts, (SELECT count(*) FROM src.step p WHERE p.trial_id = c.old), {differs}, c.old, k.new
         FROM temp.candidate c JOIN temp.kept k ON k.hash = c.hash
         JOIN src.trial o ON o.id = c.old JOIN main.trial m ON m.id = k.new
         WHERE c.input = ? AND c.attempts > 0 AND (c.input <> k.input OR c.old <> k.old)"
    );
    // Names of our own schema only.
    let rows: Vec<Copied> =
        sqlx::query_as(AssertSqlSafe(sql)).bind(input as i64).fetch_all(&mut *out).await?;
    for row in rows {
        let (hash, kept, state, kept_state, reason, kept_reason, one_simd, contained, ..) = row;
        let (.., attempts, steps, mut differing, old, new) = row;
        let mut finding = |kind, what| {
            let kept = inputs[kept as usize].named.clone();
            let other = inputs[input].named.clone();
            summary.findings.push(Finding { kind, hash: hash.clone(), kept, other, what });
        };
        match (state.as_str(), kept_state.as_str()) {
            // The same run, kept in a later state.
            _ if contained => summary.covered += 1,
            ("done", "done") if !one_simd => summary.not_compared += 1,
            ("done", "done") => {
                differing += &arrays(out, old, new).await?;
                match differing.trim_end() {
                    "" => summary.covered += 1,
                    names => finding(Kind::Bits, names.to_owned()),
                }
            }
            ("failed", "done") => finding(Kind::Outcome, format!("failed there ({reason}), done here")),
            ("done", _) => finding(Kind::Outcome, format!("done there, {kept_state} ({kept_reason}) here")),
            _ => {
                let because = if reason.is_empty() { String::new() } else { format!(" ({reason})") };
                finding(Kind::LeftOut, format!("{state}{because}: {attempts} attempts with {steps} steps"));
            }
        }
    }
    Ok(())
}

/// Names of the arrays that two copies of a trial have and that are not equal. Other versions keep others.
async fn arrays(out: &mut SqliteConnection, other: i64, kept: i64) -> sqlx::Result<String> {
    let names: Vec<String> = sqlx::query_scalar(
        "SELECT o.name FROM src.artifact o JOIN main.artifact m ON m.trial_id = ?2 AND m.name = o.name
         WHERE o.trial_id = ?1 AND o.bytes <> m.bytes ORDER BY 1",
    )
    .bind(other)
    .bind(kept)
    .fetch_all(out)
    .await?;
    Ok(names.join(" "))
}

/// Shards of which no database has a run; none once a run of the whole sweep has completed it.
pub(super) async fn missing_shards(out: &mut SqliteConnection) -> sqlx::Result<Vec<(String, u32, Vec<u32>)>> {
    let rows: Vec<(String, i64, u32, u32)> = sqlx::query_as(
            "SELECT s.name, -s.id, r.shards, r.shard FROM main.run r JOIN main.sweep s ON s.id = r.sweep_id
             WHERE r.shards BETWEEN 1 AND ? AND r.shard BETWEEN 1 AND r.shards AND NOT EXISTS (SELECT 1 FROM main.run w
               WHERE w.sweep_id = r.sweep_id AND w.shards = 1 AND w.outcome = 'complete')
             GROUP BY s.id, r.shards, r.shard",
        )
        .bind(Shard::MOST)
        .fetch_all(out)
        .await?;
    let mut seen: BTreeMap<(i64, u32), (String, HashSet<u32>)> = BTreeMap::new();
    for (name, sweep, shards, shard) in rows {
        seen.entry((sweep, shards)).or_insert_with(|| (name, HashSet::new())).1.insert(shard);
    }
    let missing = |((_, count), (name, there)): ((i64, u32), (String, HashSet<u32>))| {
        let missing: Vec<u32> = (1..=count).filter(|i| !there.contains(i)).collect();
        (!missing.is_empty()).then_some((name, count, missing))
    };
    Ok(seen.into_iter().filter_map(missing).collect())
}
