//! Where the fall of the error over the number of sensors ends, of the trials that suggested that it is at K / channels, rounded up.

use metasense::analysis::decision::{Decision, Terms, decide};
use metasense::analysis::{Cluster, Height, Observation, elbow};

use super::results::{number, of, rows};
use super::table;

/// Channels of each sensor: two accelerations and a rotation.
const CHANNELS: u64 = 3;

/// Trained bodies: so many forces, who reads them, the file of their trials, and which of them.
type Bodies = (u64, &'static str, &'static str, &'static [(&'static str, &'static str)]);
const BODIES: [Bodies; 5] = [
    (4, "linear brain", "claims/four-forces-trials.csv", &[("brain.kind", "linear")]),
    (8, "linear brain", "claims/eight-forces-trials.csv", &[("brain.kind", "linear")]),
    (
        4,
        "linear brain, 3 % noise",
        "placed-two-core/trials.csv",
        &[("brain.kind", "linear"), ("sensors.search", ""), ("stimuli.kind", "bell")],
    ),
    (4, "the paper's network", "claims/four-forces-trials.csv", &[("brain.kind", "")]),
    (8, "the paper's network", "claims/eight-forces-trials.csv", &[("brain.kind", "")]),
];

fn curve((_, _, file, wanted): Bodies) -> Vec<Observation> {
    let all = rows(file);
    let observation = |row| {
        let whole = |name| number(row, name) as u64;
        let cluster = Cluster { placement: whole("placement"), seed: whole("seed") };
        Observation { at: number(row, "sensors"), cluster, error: number(row, "holdout_error_optimised") }
    };
    of(&all, wanted).map(observation).collect()
}

/// Places with their shares of the votes, `None` for no place.
type Votes = Vec<(Option<f64>, f64)>;

fn by_elbow(curve: &[Observation], height: Height) -> Votes {
    let found = elbow(curve, height).unwrap();
    let none = 1.0 - found.votes.iter().map(|v| v.1).sum::<f64>();
    found.votes.iter().map(|&(m, share)| (Some(m), share)).chain([(None, none)]).collect()
}

fn fall(curve: &[Observation], part: f64) -> Decision {
    decide(curve, Terms { fall: part, ..Terms::default() }).unwrap().fall
}

fn place(m: Option<f64>) -> String {
    m.map_or("none".into(), |m| m.to_string())
}

/// All votes, the most first.
fn words(mut votes: Votes) -> String {
    votes.retain(|vote| vote.1 > 0.004);
    votes.sort_by(|a, b| b.1.total_cmp(&a.1));
    let word = |(m, share): &(Option<f64>, f64)| {
        if *share > 0.996 { place(*m) } else { format!("{}: {:.0} %", place(*m), 100.0 * share) }
    };
    votes.iter().map(word).collect::<Vec<_>>().join(", ")
}

/// Where the fall ends, asked in three ways, with votes; and how that depends on the rivals of an elbow and on the part of the fall.
pub fn all() -> String {
    let line = |bodies: Bodies| {
        let (curve, (forces, who, ..)) = (curve(bodies), bodies);
        let [percent, logarithm] = Height::ALL.map(|height| words(by_elbow(&curve, height)));
        let by_fall =
            fall(&curve, 0.9).votes.unwrap().into_iter().map(|(m, share)| (Some(m), share)).collect();
        let any = Height::ALL.map(|height| place(elbow(&curve, height).unwrap().any_decay));
        let parts = [0.8, 0.95].map(|part| fall(&curve, part).at.to_string());
        let law = forces.div_ceil(CHANNELS).to_string();
        let told = [law, percent, logarithm, words(by_fall), any.join(", "), parts.join(", ")];
        [[forces.to_string(), who.to_owned()].as_slice(), &told].concat()
    };
    let head = [
        "forces K",
        "read by",
        "K / 3, rounded up",
        "elbow in %",
        "elbow in logarithms",
        "nine tenths of the fall",
        "elbows if decays may be fast",
        "80 %, 95 % of the fall",
    ];
    table(&head, BODIES.map(line))
}
