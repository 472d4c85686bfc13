//! The number of sensors at which the fall of the error ends, compared with K / channels, rounded up.

use metasense::analysis::decision::{Decision, DecisionTerms, decisions};
use metasense::analysis::{Cluster, ErrorScale, Observation, elbow};
use metasense::look::file;
use metasense::look::grid::{Cell, grid};

use super::rows::{Row, geometric, number, of, rows};
use super::table;

/// Errors of a body against M.
pub(super) fn curve<'a>(rows: impl Iterator<Item = &'a Row>, body: &str) -> Vec<Observation> {
    let error = format!("holdout_error_{body}");
    let observation = |row| {
        let whole = |name| number(row, name) as u64;
        let cluster = Cluster { placement: whole("placement"), seed: whole("seed") };
        Observation { at: number(row, "sensors"), cluster, error: number(row, &error) }
    };
    rows.map(observation).collect()
}

/// Values of M with their shares of the votes; `None`: no such M.
pub(super) type Votes = Vec<(Option<f64>, f64)>;

fn by_elbow(curve: &[Observation], height: ErrorScale) -> Votes {
    let found = elbow(curve, height).unwrap();
    let none = 1.0 - found.votes.iter().map(|v| v.1).sum::<f64>();
    found.votes.iter().map(|&(m, share)| (Some(m), share)).chain([(None, none)]).collect()
}

fn fall(curve: &[Observation], part: f64) -> Decision {
    decisions(curve, DecisionTerms { fall: part, ..DecisionTerms::default() }).unwrap().fall
}

/// Votes for the M at which 90 % of the fall are reached.
pub(super) fn by_fall(curve: &[Observation]) -> Votes {
    fall(curve, 0.9).votes.unwrap().into_iter().map(|(m, share)| (Some(m), share)).collect()
}

/// Mean error at each number of sensors.
pub(super) fn errors(curve: &[Observation]) -> String {
    let places: std::collections::BTreeSet<u64> = curve.iter().map(|o| o.at as u64).collect();
    let mean = |m: &u64| geometric(curve.iter().filter(|o| o.at == *m as f64).map(|o| o.error));
    places.iter().map(mean).collect::<Vec<_>>().join(", ") + " %"
}

fn place(m: Option<f64>) -> String {
    m.map_or("none".into(), |m| m.to_string())
}

/// All votes, the largest share first.
pub(super) fn words(votes: &Votes) -> String {
    let mut votes: Vec<_> = votes.iter().filter(|vote| vote.1 > 0.004).collect();
    votes.sort_by(|a, b| b.1.total_cmp(&a.1));
    let word = |(m, share): &&(Option<f64>, f64)| {
        if *share > 0.996 { place(*m) } else { format!("{}: {:.0} %", place(*m), 100.0 * share) }
    };
    votes.iter().map(word).collect::<Vec<_>>().join(", ")
}

/// Votes by the elbow in per cent and in logarithms, and by 90 % of the fall.
pub(super) fn readings(curve: &[Observation]) -> [Votes; 3] {
    let [percent, logarithm] = ErrorScale::ALL.map(|height| by_elbow(curve, height));
    [percent, logarithm, by_fall(curve)]
}

/// Elbows if fast decays are permitted, and M at 80 % and 95 % of the fall.
fn beside(curve: &[Observation]) -> [String; 2] {
    let any = ErrorScale::ALL.map(|height| place(elbow(curve, height).unwrap().any_decay));
    let parts = [0.8, 0.95].map(|part| fall(curve, part).at.to_string());
    [any.join(", "), parts.join(", ")]
}

const READINGS: [&str; 5] = [
    "elbow in %",
    "elbow in logarithms",
    "nine tenths of the fall",
    "elbows if decays may be fast",
    "80 %, 95 % of the fall",
];

/// The verdict on votes by the rule at the head of `elbow-law.toml`.
pub(super) fn verdict(votes: &Votes, law: f64, elbow: bool) -> &'static str {
    let of = |wanted: &dyn Fn(Option<f64>) -> bool| {
        votes.iter().filter(|vote| wanted(vote.0)).map(|vote| vote.1).sum::<f64>()
    };
    let share = of(&|m| m == Some(law));
    match elbow && law == 1.0 {
        // no elbow can be at M = 1
        true if of(&|m| m.is_some_and(|m| m >= 2.0)) >= 0.95 => "refuted",
        true => "no answer",
        false if share >= 0.95 => "confirmed",
        false if share <= 0.05 => "refuted",
        false => "open",
    }
}

/// Numbers of forces in the sweep.
const FORCES: std::ops::RangeInclusive<u64> = 2..=9;

/// Trained bodies of the sweep.
fn of_sweep(forces: u64, channels: u64) -> Vec<Observation> {
    let wanted = [forces, channels].map(|x| x.to_string());
    let wanted = [("panels", &*wanted[0]), ("channels", &*wanted[1])];
    curve(of(&rows("elbow-law/trials.csv"), &wanted), "optimised")
}

/// M at 90 % of the fall.
pub fn fallen(forces: u64, channels: u64) -> f64 {
    fall(&of_sweep(forces, channels), 0.9).at
}

/// The sweep: K forces, three or two channels, four seeds.
pub fn asked() -> String {
    let line = |(forces, channels): (u64, u64)| {
        let curve = of_sweep(forces, channels);
        let law = forces.div_ceil(channels);
        let [percent, logarithm, fall] = readings(&curve);
        let told = [(percent, true), (logarithm, true), (fall, false)]
            .map(|(votes, elbow)| format!("{} ({})", words(&votes), verdict(&votes, law as f64, elbow)));
        let begun = vec![forces.to_string(), channels.to_string(), errors(&curve), law.to_string()];
        [begun, told.to_vec(), beside(&curve).to_vec()].concat()
    };
    let points = FORCES.flat_map(|forces| [3, 2].map(|channels| (forces, channels)));
    let head = ["forces K", "channels", "error with M = 1, 2, …", "K / channels, rounded up"];
    table(&[&head[..], &READINGS].concat(), points.map(line))
}

/// K and M of the paper's elbows (Fig. 4B, C).
const PAPERS: [(u64, u64); 2] = [(4, 2), (8, 4)];

/// Errors by K and M, shaded by the votes for the end of the fall. The law's M is in brackets, the paper's elbows are marked.
pub fn map() -> String {
    let forces: Vec<String> = FORCES.map(|k| k.to_string()).collect();
    let sensors: Vec<String> = (1..=7).map(|m| m.to_string()).collect();
    let of_channels = |channels: u64| {
        let row = |forces: u64| -> Vec<Cell> {
            let curve = of_sweep(forces, channels);
            let votes = by_fall(&curve);
            let cell = |m: u64| {
                let here = curve.iter().filter(|o| o.at == m as f64).map(|o| o.error).collect::<Vec<_>>();
                if here.is_empty() {
                    return Cell::default();
                }
                let error = geometric(here.into_iter());
                let is_law = m == forces.div_ceil(channels);
                let part = votes.iter().filter(|vote| vote.0 == Some(m as f64)).map(|vote| vote.1).sum();
                let papers = if channels == 3 && PAPERS.contains(&(forces, m)) { "°" } else { "" };
                let text = if is_law { format!("[{error}]{papers}") } else { error + papers };
                Cell { text, part, title: format!("{:.0} % of votes", 100.0 * part), to: None }
            };
            (1..=7).map(cell).collect()
        };
        let papers = if channels == 3 { ", ° paper" } else { "" };
        let title = format!("{channels} channels: error (%), shaded by votes; [law]{papers}");
        grid(&title, ("sensors M", &sensors), ("forces K", &forces), &FORCES.map(row).collect::<Vec<_>>())
    };
    file(&[3, 2].map(of_channels), 2, 920.0, &Vec::new()) + "\n"
}
