//! Which code computed a trial, and on which machine.

#[cfg(test)]
mod source;

use metasense_schemas::record::Provenance;
use metasense_worker::run::keeps_error;
use metasense_worker::simd;

use crate::files::host;
use crate::look::short_hash;
use crate::reader::{CodeVersion, Reader};
use crate::store::StoreError;

/// Provenance of this program on this machine with `threads` threads per worker.
pub fn this_machine(threads: u32) -> Provenance {
    Provenance {
        code: code().into(),
        revision: revision().map(str::to_owned),
        rustc: env!("METASENSE_RUSTC").into(),
        host: host(),
        cpu: cpu(),
        simd: simd::name().into(),
        threads,
    }
}

/// Digest of the sources of this program that affect the results of trials.
pub fn code() -> &'static str {
    env!("METASENSE_CODE")
}

/// Digest of the sources of this program that affect the results of any command.
pub fn code_with_lab() -> &'static str {
    env!("METASENSE_CODE_WITH_LAB")
}

/// Git commit of this program; `None` if it was built without git.
pub fn revision() -> Option<&'static str> {
    option_env!("METASENSE_REVISION")
}

/// Model of this machine's first processor.
fn cpu() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

/// Job id of this run on the cluster, if any.
pub(crate) fn job() -> Option<String> {
    let variable = |name| std::env::var(name).ok();
    let slurm = || {
        let task = variable("SLURM_ARRAY_TASK_ID").map_or(String::new(), |task| format!("_{task}"));
        variable("SLURM_ARRAY_JOB_ID").or(variable("SLURM_JOB_ID")).map(|job| format!("slurm {job}{task}"))
    };
    let hyperqueue = || Some(format!("hq {}.{}", variable("HQ_JOB_ID")?, variable("HQ_TASK_ID")?));
    slurm().or_else(hyperqueue)
}

/// A warning if different code computed the results; `None` if the code is the same.
pub fn mixed(made: &[CodeVersion]) -> Option<String> {
    let named = |made: &CodeVersion| {
        let revisions = if made.revisions.is_empty() {
            String::new()
        } else {
            format!(" ({})", made.revisions.join(", "))
        };
        format!(
            "{} by {}{revisions}",
            crate::plan::counted(made.trials, "trial"),
            made.code.replace(' ', " then ")
        )
    };
    (made.len() > 1).then(|| {
        let list = made.iter().map(named).collect::<Vec<_>>().join(", ");
        format!("the results come from different code versions: {list}; `metasense run SPEC --redo-other-code` repeats trials \
            that were not computed by this program ({})", code())
    })
}

/// Warning about intervals of a sweep that may stop early.
const EARLY: &str = "a sweep of this database has [until] or a [goal]: it may have stopped because its numbers looked clear. Intervals and \
    votes here assume a fixed number of trials, so their true coverage is lower than stated; the answers of `run` and \
    `design` account for this";

/// Warns if no time step keeps the requested error on the initial or the best body, according to the trial's `solver` column;
/// `None` if both are resolved.
pub fn unresolved(solver: &str) -> Option<String> {
    let bodies = match keeps_error(solver) {
        [true, true] => return None,
        [false, false] => "both bodies",
        [false, true] => "the initial body",
        [true, false] => "the trained body",
    };
    Some(format!("no time step reaches solver.tolerance on {bodies}: {UNRESOLVED}"))
}

const UNRESOLVED: &str = "errors and predictions depend on the steps. v_trial.solver contains the remaining error. If it is large, \
    the motion is chaotic: softer contact, weaker forces or more damping help. If it is tiny, it is rounding: increase \
    solver.tolerance";

/// The same warning for several trials.
pub fn unresolved_trials(hashes: &[String]) -> Option<String> {
    let shown: Vec<&str> = hashes.iter().take(SHOWN).map(|hash| short_hash(hash)).collect();
    let more = if hashes.len() > SHOWN { ", …" } else { "" };
    let trials = crate::plan::counted(hashes.len(), "trial");
    let text = || {
        format!(
            "no time step reaches solver.tolerance in {trials} ({}{more}): {UNRESOLVED}",
            shown.join(", ")
        )
    };
    (!hashes.is_empty()).then(text)
}

/// Number of hashes in a message.
const SHOWN: usize = 5;

/// Warnings about the numbers of a database: results of different code, possible early stopping, unresolved motion.
///
/// # Errors
/// If SQLite fails.
pub async fn caveats(reader: &mut Reader, made: &[CodeVersion]) -> Result<Vec<String>, StoreError> {
    let early = reader.may_stop_early().await?;
    let unresolved = unresolved_trials(&reader.unresolved().await?);
    Ok(mixed(made).into_iter().chain(early.then(|| EARLY.to_owned())).chain(unresolved).collect())
}

#[cfg(test)]
mod tests;
