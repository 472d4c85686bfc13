//! What a spec could once ask for, and what to write instead. Databases that hold such trials are read; none is run.

use super::{Optimise, Protocol, Search, TrialSpec};

/// A key that no spec has any more, and what to do without it.
#[must_use]
pub fn gone_key(key: &str) -> Option<&'static str> {
    (key == "optimise.placement").then_some(
        "is gone, as it has not paid: leave it out; sensors stay where sensors.search puts them on the initial body",
    )
}

/// Key, value and remedy of the first thing that `trial` asks for and that is gone.
#[must_use]
pub fn gone(trial: &TrialSpec) -> Option<(&'static str, String, &'static str)> {
    let Optimise { placement, protocol, .. } = &trial.optimise;
    if let Some(value) = placement {
        let key = "optimise.placement";
        return Some((key, value.clone(), gone_key(key)?));
    }
    if *protocol == Protocol::Warm {
        let remedy =
            "is gone, as it has not paid: write \"envelope\", or \"joint\", which gains most in its time";
        return Some(("optimise.protocol", "warm".into(), remedy));
    }
    let value = match trial.sensors.search {
        Some(Search::DOptimal) => "d_optimal",
        Some(Search::Pivots) => "pivots",
        _ => return None,
    };
    Some(("sensors.search", value.into(), "is gone, as it has not paid: write \"greedy\""))
}
