//! Finds a trial by its hash or a prefix of it, in specs, databases and runs.

/// Why a text does not identify one trial.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum HashError {
    /// No hash begins with the text.
    #[error("trial {text}: no hash begins with this text; {near}")]
    None {
        /// The text.
        text: String,
        /// The nearest hash, or a list of all hashes.
        near: String,
    },
    /// More than one hash begins with the text.
    #[error("trial {text}: several hashes begin with this text: {those}; add digits")]
    Several {
        /// The text.
        text: String,
        /// The first of these hashes, and the number of others.
        those: String,
    },
}

/// Number of hashes that a message lists.
const SHOWN: usize = 5;
/// Digits of a hash in a message.
const DIGITS: usize = 12;

/// Returns the position of the only hash that begins with a text.
///
/// # Errors
/// If no hash or more than one does.
pub fn position_of<'a>(
    text: &str,
    hashes: impl Iterator<Item = &'a str> + Clone,
) -> Result<usize, HashError> {
    let mut matches = hashes.clone().enumerate().filter(|(_, hash)| hash.starts_with(text));
    match (matches.next(), matches.next()) {
        (Some((at, _)), None) => Ok(at),
        (None, _) => {
            let near = match nearest(text, hashes.clone()) {
                Some(hash) => format!("the nearest is {hash}"),
                None => format!("known trials: {}", listed(hashes)),
            };
            Err(HashError::None { text: text.to_owned(), near })
        }
        (Some(first), Some(second)) => {
            let those = listed([first, second].into_iter().chain(matches).map(|(_, hash)| hash));
            Err(HashError::Several { text: text.to_owned(), those })
        }
    }
}

/// Lists the first hashes and the number of others.
fn listed<'a>(hashes: impl Iterator<Item = &'a str> + Clone) -> String {
    let shown: Vec<String> = hashes.clone().take(SHOWN).map(short).collect();
    match hashes.skip(SHOWN).count() {
        0 if shown.is_empty() => "none".to_owned(),
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// Shortens a hash for a message.
fn short(hash: &str) -> String {
    hash.chars().take(DIGITS).collect()
}

/// Returns the hash whose prefix is nearest to a text, if at most a third of the digits differ.
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
