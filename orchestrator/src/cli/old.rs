//! Spellings of the version before: understood for one more, with a hint on standard error.
//!
//! To end that, delete this file and what then does not compile.

use std::ffi::{OsStr, OsString};

use super::Error;

/// Commands that are others now.
const COMMANDS: [(&str, &str); 1] = [("why", "status")];

/// Options of a command that have another name now.
const OPTIONS: [(&str, &str, &str); 6] = [
    ("simulate", "--out", "--out-dir"),
    ("identify", "--out", "--out-dir"),
    ("evaluate", "--out", "--out-dir"),
    ("claims", "--out", "--out-dir"),
    ("report", "--figures", "--out-dir"),
    ("submit", "--folder", "--out-dir"),
];

/// Options of a command whose value stands behind the database now.
const POSITIONAL: [(&str, &str, &str); 1] = [("report", "--trial", "DB HASH")];

fn hint(old: &str, new: &str) {
    say!("note: `{old}` is now `{new}`; the old spelling goes with the next version");
}

/// A command line in today's spelling.
///
/// # Errors
/// Of a command that is a program of its own now.
pub(super) fn rewritten(args: impl Iterator<Item = OsString>) -> Result<Vec<OsString>, Error> {
    let mut args: Vec<OsString> = args.collect();
    let Some(command) = args.get(1).and_then(|name| name.to_str()).map(str::to_owned) else {
        return Ok(args);
    };
    if command == "bench" {
        let rest: Vec<_> = args[2..].iter().map(|arg| arg.to_string_lossy()).collect();
        return Err(Error::Usage(format!(
            "`bench` is a program of its own now, for development: `cargo run --release -p metasense-bench -- {}`",
            rest.join(" ")
        )));
    }
    if let Some((old, new)) = COMMANDS.iter().find(|(old, _)| *old == command) {
        hint(old, new);
        args[1] = new.into();
    }
    let end = args.iter().position(|arg| arg == "--").unwrap_or(args.len());
    let verbatim = args.split_off(end);
    let mut behind = Vec::new();
    let mut rest = std::mem::take(&mut args).into_iter();
    while let Some(arg) = rest.next() {
        let (name, value) = match arg.to_str().and_then(|text| text.split_once('=')) {
            Some((name, value)) if name.starts_with("--") => (OsStr::new(name), Some(OsString::from(value))),
            _ => (arg.as_os_str(), None),
        };
        let of = |(of, old, _): &&(&str, &str, &str)| *of == command && *old == name;
        if let Some((_, old, new)) = OPTIONS.iter().find(of) {
            hint(&format!("{command} {old}"), &format!("{command} {new}"));
            args.push(new.into());
            args.extend(value);
        } else if let Some((_, old, new)) = POSITIONAL.iter().find(of) {
            hint(&format!("{command} DB {old} HASH"), &format!("{command} {new}"));
            behind.extend(value.or_else(|| rest.next()));
        } else {
            args.push(arg);
        }
    }
    Ok([args, behind, verbatim].concat())
}

/// `DB --hash HASH`.
pub(super) fn trial_of_database(hash: Option<&str>) -> Option<&str> {
    hint("DB --hash HASH", "DB HASH");
    hash
}

/// `SPEC HASH`.
pub(super) fn trial_of_spec(hash: Option<&str>) -> Option<&str> {
    hash.inspect(|_| hint("SPEC HASH", "SPEC --hash HASH"))
}

#[cfg(test)]
mod tests;
