//! The claims as tables: a rating per claim, and the evidence.

use super::{CLAIMS, Evidence, by_medians, corrected, summary};
use crate::Trial;
use crate::tables::ends;
use metasense_render::{Table, row};

/// What a database's trials say of every claim, in the paper's order.
pub fn tried(trials: &[Trial]) -> Vec<Vec<Evidence>> {
    corrected(CLAIMS.iter().map(|claim| claim.evidence(trials)).collect())
}

/// What trials of another scene, such as the one of the paper's authors, say of each claim about smooth pulses on a planar body.
pub fn tried_elsewhere(trials: &[Trial]) -> Vec<Vec<Evidence>> {
    corrected(CLAIMS.iter().map(|claim| claim.evidence_elsewhere(trials)).collect())
}

/// One row per claim: what it comes to, by medians over samples where that is something else, and the specs that show it.
pub fn claims_table(found: &[Vec<Evidence>]) -> Table {
    let rows = CLAIMS.iter().zip(found).enumerate().map(|(i, (claim, evidence))| {
        let specs: Vec<String> = claim.specs.iter().map(|spec| format!("schemas/{spec}.toml")).collect();
        row![i + 1, claim.says, claim.source, summary(evidence).0, by_medians(evidence), specs.join(", ")]
    });
    let mut table = Table::new("claim says source rating by_medians specs", rows);
    let at = table.column("by_medians");
    if table.rows.iter().all(|row| row[at].is_null()) {
        table.drop_columns(&["by_medians"]);
    }
    table
}

/// One row per claim, brain and set: the ratio with its interval, votes, and over what they are.
pub fn evidence_table(found: &[Vec<Evidence>]) -> Table {
    let mut rows = Vec::new();
    for (i, (claim, evidence)) in CLAIMS.iter().zip(found).enumerate() {
        for e in evidence {
            let [low, high] = ends(e.interval);
            let note = (!e.note.is_empty()).then_some(&e.note);
            let ratio = row![
                e.rating.name(),
                claim.stated,
                e.found,
                low,
                high,
                e.chance,
                e.tells,
                note,
                e.trials,
                e.over
            ];
            rows.push([row![i + 1, e.who, e.set], ratio].concat());
        }
    }
    Table::new("claim with set rating stated found low high chance tells note trials over", rows)
}
