//! By what code, and where, a trial is computed.

#[cfg(test)]
mod source;

use metasense_schemas::record::Provenance;
use metasense_worker::simd;

use crate::files::host;
use crate::store::Made;

/// Of this program on this machine, with so many threads a worker.
#[must_use]
pub fn here(threads: u32) -> Provenance {
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

/// Digest of the sources of this program that compute.
#[must_use]
pub fn code() -> &'static str {
    env!("METASENSE_CODE")
}

/// The commit of this program, where it was built with git.
#[must_use]
pub fn revision() -> Option<&'static str> {
    option_env!("METASENSE_REVISION")
}

/// Model of this machine's first processor.
fn cpu() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

/// What is to be said where different code has been at work; `None` where it was one.
#[must_use]
pub fn mixed(made: &[Made]) -> Option<String> {
    let named = |made: &Made| {
        let revisions = if made.revisions.is_empty() {
            String::new()
        } else {
            format!(" ({})", made.revisions.join(", "))
        };
        format!(
            "{} by {}{revisions}",
            crate::plan::counted(made.trials, "trial"),
            made.code.replace(' ', " and then ")
        )
    };
    (made.len() > 1).then(|| {
        let list = made.iter().map(named).collect::<Vec<_>>().join(", ");
        format!("results of different code are mixed: {list}; `metasense run SPEC --redo-other-code` makes again what \
            is not by {}, this program", code())
    })
}

/// What is to be said of the intervals where a sweep may end as soon as it knows enough.
const EARLY: &str = "a sweep of this database has [until] or a [goal]: it may have stopped because its numbers looked clear. Intervals and \
    votes here are those of a number of trials that was fixed before, and hold the truth less often than they say; what `run` or \
    `design` answered keeps its confidence";

/// What is to be said beside numbers: that different code made them, and that the sweep may have ended early.
#[must_use]
pub fn caveats(made: &[Made], early: bool) -> Vec<String> {
    mixed(made).into_iter().chain(early.then(|| EARLY.to_owned())).collect()
}

#[cfg(test)]
mod tests;
