//! A trial by its hash, or by the beginning of it: the one rule, for specs, databases and runs.

/// Why a text names no trial.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NotOne {
    /// No hash begins so.
    #[error("trial {text}: no trial begins so; {near}")]
    None {
        /// What was asked for.
        text: String,
        /// The hash most like it, or else those there are.
        near: String,
    },
    /// More than one hash begins so.
    #[error("trial {text}: several trials begin so: {those}")]
    Several {
        /// What was asked for.
        text: String,
        /// The first of them, and how many more there are.
        those: String,
    },
}

/// Candidates that a message lists.
const SHOWN: usize = 5;
/// Digits of a hash in a message.
const DIGITS: usize = 12;

/// Position of the one hash that begins with a text.
///
/// # Errors
/// Where none does, with the nearest; or several, with the first of them.
pub fn position_of<'a>(text: &str, hashes: impl Iterator<Item = &'a str> + Clone) -> Result<usize, NotOne> {
    let mut found = hashes.clone().enumerate().filter(|(_, hash)| hash.starts_with(text));
    match (found.next(), found.next()) {
        (Some((at, _)), None) => Ok(at),
        (None, _) => {
            let near = match nearest(text, hashes.clone()) {
                Some(hash) => format!("the nearest is {hash}"),
                None => format!("there are: {}", listed(hashes)),
            };
            Err(NotOne::None { text: text.to_owned(), near })
        }
        (Some(first), Some(second)) => {
            let those = listed([first, second].into_iter().chain(found).map(|(_, hash)| hash));
            Err(NotOne::Several { text: text.to_owned(), those })
        }
    }
}

/// The first hashes, and how many more there are.
fn listed<'a>(hashes: impl Iterator<Item = &'a str> + Clone) -> String {
    let shown: Vec<String> = hashes.clone().take(SHOWN).map(short).collect();
    match hashes.skip(SHOWN).count() {
        0 if shown.is_empty() => "none".to_owned(),
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// As much of a hash as a message shows.
fn short(hash: &str) -> String {
    hash.chars().take(DIGITS).collect()
}

/// The hash whose beginning is most like a text: a digit may be wrong, and one in four more.
fn nearest<'a>(text: &str, hashes: impl Iterator<Item = &'a str>) -> Option<String> {
    let digits = text.chars().count();
    let distance = |hash: &str| {
        let beginning: String = hash.chars().take(digits).collect();
        strsim::damerau_levenshtein(&beginning, text)
    };
    let (distance, hash) = hashes.map(|hash| (distance(hash), hash)).min()?;
    (distance <= digits / 3).then(|| short(hash))
}

#[cfg(test)]
mod tests;
