//! Phrases of captions and answers.

use crate::analysis::paired::Ratio;
use crate::look::number;

/// The interval of a ratio in words.
pub(super) fn interval(ratio: &Ratio) -> String {
    match ratio.interval {
        Some(i) => format!("95 % interval {} to {} over {}", number(i.low), number(i.high), ratio.over),
        // few units say so themselves
        None => format!("no interval, {}", ratio.over.trim_start_matches("no interval, ")),
    }
}

/// A caption's sentence about settings that are not drawn.
pub(super) fn left_out(all: usize, most: usize) -> String {
    match all.saturating_sub(most) {
        0 => String::new(),
        1 => " A further setting is in the data.".to_owned(),
        more => format!(" {more} further settings are in the data."),
    }
}
