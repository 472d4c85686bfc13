//! Trials and figure of the paper's claims.

use serde_json::Value;

use crate::analysis::claims::{CLAIMS, Evidence, Rating, evidence_table};
use crate::analysis::numbers::geometric_mean;
use crate::analysis::paired::TrainingMeasure;
use crate::analysis::setting::differing_paths;
use crate::analysis::{BodyState, Cluster, Set, Trial};
use crate::look::{Axis, Figure, Plot, Scale, Table, legend, number, row};

/// One row per trial: the settings in which trials differ, and all numbers that the claims use.
pub fn trials_table(trials: &[Trial]) -> Table {
    let paths: Vec<&str> = differing_paths(trials.iter().map(|trial| &trial.setting)).into_iter().collect();
    let sets: Vec<Set> = Set::with_errors(&trials.iter().collect::<Vec<_>>()).collect();
    let each = || BodyState::ALL.into_iter().flat_map(|body| sets.iter().map(move |set| (body, *set)));
    let rows = trials.iter().map(|t| {
        let Cluster { placement, seed } = t.cluster;
        let mut cells = row![t.hash, t.panels, t.sensors, placement, seed, t.units, t.design_parameters];
        cells.extend(paths.iter().map(|path| t.setting.get(path).cloned().unwrap_or_default()));
        let networks = t.iterations.iter().map(|of| (!of.is_empty()).then(|| geometric_mean(of)));
        let errors = each().map(|(body, set)| t.error(body, set));
        let long = each().map(|(body, set)| t.long_error(body, set));
        cells.extend(errors.chain(long).chain(networks).map(Value::from));
        cells
    });
    let first = "hash panels sensors placement seed units design_parameters";
    let mut columns = vec![first.to_owned()];
    columns.extend(paths.iter().map(|path| (*path).to_owned()));
    for long in ["", "long_"] {
        columns.extend(each().map(|(body, set)| format!("{long}{}", set.column(body))));
    }
    columns.extend(["iterations_to_loss", "iterations_to_error"].map(str::to_owned));
    Table::new(&columns.join(" "), rows)
}

/// Class of the marks of a rating.
fn class(rating: Rating) -> &'static str {
    match rating {
        Rating::Holds | Rating::Compatible => "fifth",
        Rating::InPart => "fourth",
        Rating::Fails => "optimised",
        Rating::Alike | Rating::Open => "truth",
    }
}

/// Height of a row (px).
const ROW: f64 = 16.0;

/// Held-out ratios with intervals, one row each, beside the paper's numbers; `None` without ratios.
pub fn figure(found: &[Vec<Evidence>]) -> Option<Figure> {
    let others = [Set::Test.name(), Set::Median.name(), TrainingMeasure::Loss.name()];
    let of_holdout = |e: &&Evidence| e.found.is_some() && !others.contains(&e.set);
    let each = found.iter().enumerate().flat_map(|(i, of)| of.iter().map(move |e| (i, e)));
    let rows: Vec<(usize, &Evidence)> = each.filter(|(_, e)| of_holdout(e)).collect();
    let reach = |e: &Evidence| e.interval.map_or([e.found; 2], |i| [Some(i.low), Some(i.high)]);
    let values =
        rows.iter().flat_map(|(i, e)| reach(e).into_iter().flatten().chain([CLAIMS[*i].stated, 1.0]));
    let x = Axis::new("ratio (above 1: as claimed)", Scale::Log, values);
    let at = |row: usize| -(row as f64);
    let first = |row: usize| row == 0 || rows[row - 1].0 != rows[row].0;
    let names =
        (0..rows.len()).filter(|row| first(*row)).map(|row| (at(row), format!("no. {}", rows[row].0 + 1)));
    let y = Axis::new("claim", Scale::Linear, [at(rows.len()), 1.0]).with_names(names.collect());
    let notes: Vec<String> =
        rows.iter().map(|(_, e)| format!("{} {}", number(e.found.unwrap_or(1.0)), e.who)).collect();
    let height = 70.0 + ROW * rows.len() as f64;
    let mut plot = Plot::new("Initial / trained, and other ratios", x, y)
        .sized(560.0, height)
        .with_room(notes.iter().map(|n| &**n));
    plot.vertical("", 1.0, "", 0);
    for (row, ((i, e), note)) in rows.iter().zip(&notes).enumerate() {
        let (Some(ratio), [Some(low), Some(high)]) = (e.found, reach(e)) else { continue };
        plot.line(class(e.rating), [(low, at(row)), (high, at(row))]);
        plot.dots(class(e.rating), [((ratio, at(row)), format!("{}: {note}", CLAIMS[*i].says))]);
        if CLAIMS[*i].stated > 1.0 {
            plot.rings([((CLAIMS[*i].stated, at(row)), format!("the paper: {}", CLAIMS[*i].stated))]);
        }
        plot.note((high.max(CLAIMS[*i].stated), at(row)), note);
    }
    let keys = [
        (class(Rating::Holds), "holds, or compatible"),
        (class(Rating::InPart), "in part"),
        (class(Rating::Fails), "fails"),
        (class(Rating::Open), "open, or no difference"),
        ("ring", "the paper's number"),
    ];
    (!rows.is_empty()).then(|| {
        Figure::new(
            "claims",
            "Comparison with the paper's numbers",
            "Ratios on unseen samples (holdout), with 95 % intervals over seeds and placements. Claims have the numbers of the \
             table.",
            legend(&keys),
            vec![plot.picture()],
            evidence_table(found),
        )
    })
}
