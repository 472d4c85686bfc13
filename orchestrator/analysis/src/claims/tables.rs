//! Tables of the claims: a rating per claim, and the evidence.

use super::{CLAIMS, Evidence, by_medians, corrected, summary};
use crate::Trial;
use crate::tables::ends;
use metasense_render::{Table, row};

/// Returns the evidence for every claim in the trials of a database, in the order of the paper.
pub fn tried(trials: &[Trial]) -> Vec<Vec<Evidence>> {
    corrected(CLAIMS.iter().map(|claim| claim.evidence(trials)).collect())
}

/// Returns the evidence for every claim about smooth pulses on a planar body in trials of another scene, such as that of the
/// authors.
pub fn tried_elsewhere(trials: &[Trial]) -> Vec<Vec<Evidence>> {
    corrected(CLAIMS.iter().map(|claim| claim.evidence_elsewhere(trials)).collect())
}

/// Returns one row per claim: rating, rating by medians if different, and specs.
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

/// Returns one row per claim, decoder and set: ratio with interval, votes and units.
pub fn evidence_table(found: &[Vec<Evidence>]) -> Table {
    let mut rows = Vec::new();
    for (i, (claim, evidence)) in CLAIMS.iter().zip(found).enumerate() {
        for e in evidence {
            let [low, high] = ends(e.interval);
            let note = (!e.note.is_empty()).then_some(&e.note);
            let ratio = row![e.rating.name(), claim.stated, e.found, low, high, e.chance, e.tells];
            rows.push([row![i + 1, e.who, e.set], ratio, row![note, e.trials, e.over]].concat());
        }
    }
    Table::new("claim with set rating stated found low high chance tells note trials over", rows)
}
