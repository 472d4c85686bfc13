//! The cheapest design that meets a requirement, and what to run next to find it: pure, fed with stored results alone.
//!
//! A candidate is a trial of the plan: one body with its sensors and brain. It climbs a ladder: not begun, two rungs of outer
//! steps, its result, fresh seeds. Candidates of equal cost are a class. Work goes to the cheapest class that a candidate may
//! still meet the requirement in, there to the candidates of the best prospects ([`Prediction`]). The first design that stands on
//! fresh seeds, with no candidate left in a cheaper class that is worth work, is the answer.

use metasense_schemas::spec::Goal;
use metasense_worker::chance_above;
pub use metasense_worker::predict::LEVELS;
use metasense_worker::predict::{Prediction, Seen};

/// Settings that are looked at before anything is predicted.
const BEGIN: usize = 8;
/// Candidates with smaller prospects than this are not worked on. By it a search trades what it takes for how surely the design
/// is the cheapest one; that it meets the requirement hangs on fresh seeds alone. Chosen on made-up spaces (tests).
const WORTH: f64 = 0.15;
/// The same as long as no design stands, after so many results and one more for each coordinate.
const WORTH_LAST: f64 = 0.03;
const LEAST_RESULTS: usize = 4;
/// Least standard deviation of ln error from seed to seed: four seeds that agree by chance are not sure for ever.
const DEVIATION_MIN: f64 = 0.02;

/// A trial of the plan as the search sees it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Candidate {
    /// What it costs: compared one after the other.
    pub cost: [f64; 3],
    /// Its setting, as coordinates of about 0 … 1.
    pub place: Vec<f64>,
    /// Errors (%) at the levels that it has reached; `None`: none was told there.
    pub reached: Vec<Option<f64>>,
    /// It has failed for good.
    pub failed: bool,
    /// Errors (%) of its trained body on fresh seeds.
    pub fresh: Vec<f64>,
}

/// What is to be done for a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Work {
    /// Run it to this level: a rung, or its result.
    Level(usize),
    /// Judge its body on so many fresh seeds, those that are known among them.
    Fresh(usize),
}

/// How a class stands.
#[derive(Debug, Clone, PartialEq)]
pub struct Standing {
    /// What its candidates cost.
    pub cost: [f64; 3],
    /// The candidate with the best prospects.
    pub best: usize,
    /// How far it has come.
    pub stage: Stage,
    /// The error (%) that is expected of it, and the one that it keeps to with the confidence asked for.
    pub error: [f64; 2],
    /// Probability that it meets the requirement.
    pub meets: f64,
    /// Probability that any of the class does.
    pub any: f64,
    /// Candidates of the class, and how many of them were begun.
    pub candidates: [usize; 2],
}

/// How far a candidate has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Not begun: its error is a prediction by others.
    Predicted,
    /// Part of its outer steps: the same by them, too.
    Looked,
    /// It has its result.
    Trained,
    /// Its body was judged on so many fresh seeds.
    Judged(usize),
}

/// What comes next.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// To be run before the next decision; nothing once the search is over.
    pub work: Vec<(usize, Work)>,
    /// The design, if one stands.
    pub chosen: Option<usize>,
    /// All classes, the cheapest first.
    pub standings: Vec<Standing>,
    /// How far a first look tells a result: a correlation; `None` as long as nothing was seen.
    pub kinship: Option<f64>,
}

/// Probability that the error on a further seed is at most `limit`, by those on fresh ones: Student's t of ln e.
fn chance_below(limit: f64, fresh: &[f64]) -> f64 {
    let (mean, deviation, n) = of_seeds(fresh);
    chance_above(fresh.len() - 1, (mean - limit.ln()) / (deviation * (1.0 + 1.0 / n).sqrt()))
}

/// Mean and standard deviation of ln e, and their number.
fn of_seeds(fresh: &[f64]) -> (f64, f64, f64) {
    let n = fresh.len() as f64;
    let mean = fresh.iter().map(|e| e.ln()).sum::<f64>() / n;
    let variance = fresh.iter().map(|e| (e.ln() - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, variance.sqrt().max(DEVIATION_MIN), n)
}

/// A candidate on fresh seeds: not judged yet, or with what probability it meets the requirement, and whether that is final.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Judgement {
    None,
    More(f64),
    Final(f64),
}

fn judged(goal: &Goal, candidate: &Candidate) -> Judgement {
    let fresh = &candidate.fresh;
    if fresh.len() < goal.fresh {
        return Judgement::None;
    }
    let chance = chance_below(goal.error, fresh);
    let decides = !(1.0 - goal.confidence..goal.confidence).contains(&chance);
    if decides || fresh.len() >= 2 * goal.fresh { Judgement::Final(chance) } else { Judgement::More(chance) }
}

/// Where the search stands by what is stored, and what is to be run next. It is followed from its beginning, and sees what it has
/// asked for alone: kills, and whatever else is stored, change no decision.
pub fn follow(goal: &Goal, stored: &[Candidate]) -> Decision {
    let unknown = |c: &Candidate| Candidate { reached: vec![], fresh: vec![], failed: false, ..c.clone() };
    let mut shown: Vec<Candidate> = stored.iter().map(unknown).collect();
    loop {
        let mut decision = decide(goal, &shown);
        let asked = decision.work.clone();
        decision.work.retain(|&(i, work)| !is_known(&stored[i], work));
        if asked.is_empty() || !decision.work.is_empty() {
            return decision;
        }
        asked.into_iter().for_each(|(i, work)| show(&mut shown[i], &stored[i], work));
    }
}

/// Whether what is stored of a candidate has this.
fn is_known(stored: &Candidate, work: Work) -> bool {
    match work {
        Work::Level(level) => stored.failed || stored.reached.len() > level,
        Work::Fresh(seeds) => stored.fresh.len() >= seeds,
    }
}

fn show(shown: &mut Candidate, stored: &Candidate, work: Work) {
    match work {
        Work::Level(level) if stored.reached.len() > level => {
            shown.reached = stored.reached[..=level].to_vec();
        }
        Work::Level(_) => shown.failed = true,
        Work::Fresh(seeds) => shown.fresh = stored.fresh[..seeds].to_vec(),
    }
}

/// Where the search stands, and what is to be run next.
fn decide(goal: &Goal, candidates: &[Candidate]) -> Decision {
    let classes = classes(candidates);
    let seen = seen(candidates);
    let places: Vec<Vec<f64>> = candidates.iter().map(|c| c.place.clone()).collect();
    let prediction = Prediction::new(&places, &seen);
    let judgements: Vec<Judgement> = candidates.iter().map(|c| judged(goal, c)).collect();
    let limit = goal.error.ln();
    // its own result is the first judge
    let falls_short = |i: usize| {
        candidates[i].reached.get(LEVELS - 1).is_some_and(|told| told.is_none_or(|e| e > goal.error))
    };
    let is_open =
        |i: usize| !candidates[i].failed && !falls_short(i) && !matches!(judgements[i], Judgement::Final(_));
    let meets = |i: usize| match judgements[i] {
        _ if candidates[i].failed || falls_short(i) => 0.0,
        Judgement::Final(chance) | Judgement::More(chance) => chance,
        Judgement::None => prediction.chance(|draw| draw[i] <= limit),
    };
    let prospects: Vec<f64> = (0..candidates.len()).map(meets).collect();
    let stands = |i: &usize| matches!(judgements[*i], Judgement::Final(chance) if chance >= goal.confidence);

    let chosen = classes.iter().find_map(|class| class.iter().copied().find(stands));
    let any = |class: &[usize]| {
        let open: Vec<usize> = class.iter().copied().filter(|&i| is_open(i)).collect();
        let looked = |i: &usize| judgements[*i] == Judgement::None;
        let (unjudged, judged): (Vec<usize>, Vec<usize>) = open.into_iter().partition(looked);
        let by_draws = prediction.chance(|draw| unjudged.iter().any(|&i| draw[i] <= limit));
        judged.iter().fold(by_draws, |any, &i| 1.0 - (1.0 - any) * (1.0 - prospects[i]))
    };
    let hopes: Vec<f64> = classes.iter().map(|class| any(class)).collect();

    // of equal prospects the one whose next level is nearer
    let better = |&a: &usize, &b: &usize| {
        let (begun, mean) = (|i: usize| candidates[i].reached.len(), &prediction.mean);
        let nearer = begun(b).cmp(&begun(a)).then(mean[a].total_cmp(&mean[b]));
        prospects[b].total_cmp(&prospects[a]).then(nearer).then(a.cmp(&b))
    };
    let mut work = begin(&classes, candidates);
    if work.is_empty() {
        // class by class up to the one that a design stands in, as many as leave little to hope for besides
        let mut besides = 1.0;
        for class in classes.iter().take_while(|class| chosen.is_none_or(|c| !class.contains(&c))) {
            let worth = |i: &usize| is_open(*i) && prospects[*i] >= WORTH;
            let mut some: Vec<usize> = class.iter().copied().filter(worth).collect();
            some.sort_by(better);
            for i in some {
                if work.len() < goal.at_a_time && besides > 0.05 {
                    besides *= 1.0 - prospects[i];
                    work.push((i, next(goal, &candidates[i], judgements[i])));
                }
            }
        }
    }
    if work.is_empty() && chosen.is_none() {
        // that there is no design is said less lightly than that there is no cheaper one, and not by a guess of a few results
        let results = candidates.iter().filter(|c| c.reached.len() == LEVELS).count();
        let guess = results < LEAST_RESULTS + candidates[0].place.len();
        let worth = |i: &usize| is_open(*i) && (guess || prospects[*i] >= WORTH_LAST);
        let mut some: Vec<usize> = (0..candidates.len()).filter(worth).collect();
        some.sort_by(better);
        let result = |i: usize| match candidates[i].reached.len() {
            LEVELS.. => next(goal, &candidates[i], judgements[i]),
            _ => Work::Level(LEVELS - 1),
        };
        work = some.into_iter().take(goal.at_a_time).map(|i| (i, result(i))).collect();
    }
    let standing = |(class, any): (&Vec<usize>, &f64)| {
        let worth = |i: usize| (stands(&i), prospects[i], -prediction.mean[i]);
        let best = class.iter().copied().max_by(|&a, &b| {
            let (a, b) = (worth(a), worth(b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2))
        });
        let best = best.expect("a class has candidates");
        let candidate = &candidates[best];
        let (middle, keeps) = match candidate.fresh.len() {
            0 | 1 => {
                let mut below = |e: f64| prediction.chance(|draw| draw[best] <= e);
                (prediction.mean[best], quantile(goal.confidence, prediction.mean[best], &mut below))
            }
            _ => {
                let mean = of_seeds(&candidate.fresh).0;
                (mean, quantile(goal.confidence, mean, &mut |e: f64| chance_below(e.exp(), &candidate.fresh)))
            }
        };
        Standing {
            cost: candidate.cost,
            best,
            stage: stage(candidate),
            error: [middle.exp(), keeps.exp()],
            meets: prospects[best],
            any: if class.iter().any(stands) { any.max(goal.confidence) } else { *any },
            candidates: [class.len(), class.iter().filter(|&&i| !candidates[i].reached.is_empty()).count()],
        }
    };
    let standings = classes.iter().zip(&hopes).map(standing).collect();
    let kinship = (!seen.is_empty()).then_some(prediction.kinship);
    Decision { work, chosen, standings, kinship }
}

/// The ln error that is kept to with this probability, from a middle one on.
fn quantile(probability: f64, middle: f64, below: &mut dyn FnMut(f64) -> f64) -> f64 {
    let (mut low, mut high) = (middle - 3.0, middle + 6.0);
    for _ in 0..40 {
        let half = 0.5 * (low + high);
        if below(half) < probability { low = half } else { high = half }
    }
    high
}

fn stage(candidate: &Candidate) -> Stage {
    match (candidate.fresh.len(), candidate.reached.len()) {
        (0, 0) => Stage::Predicted,
        (0, LEVELS..) => Stage::Trained,
        (0, _) => Stage::Looked,
        (seeds, _) => Stage::Judged(seeds),
    }
}

/// The next rung of a candidate's ladder.
fn next(goal: &Goal, candidate: &Candidate, judgement: Judgement) -> Work {
    match (candidate.reached.len(), judgement) {
        (level, _) if level < LEVELS => Work::Level(level),
        (_, Judgement::None) => Work::Fresh(goal.fresh),
        _ => Work::Fresh(2 * goal.fresh),
    }
}

/// Candidates by cost, the cheapest first; of a class in the order of the plan.
fn classes(candidates: &[Candidate]) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    let before = |a: &[f64; 3], b: &[f64; 3]| {
        a.iter().zip(b).map(|(a, b)| a.total_cmp(b)).find(|o| o.is_ne()).unwrap_or(std::cmp::Ordering::Equal)
    };
    order.sort_by(|&a, &b| before(&candidates[a].cost, &candidates[b].cost).then(a.cmp(&b)));
    let same = |a: &usize, b: &usize| candidates[*a].cost == candidates[*b].cost;
    order.chunk_by(same).map(<[usize]>::to_vec).collect()
}

/// A first look at settings spread over all costs, one trial each; every third one goes on to its result, as only results tell
/// what looks are worth.
fn begin(classes: &[Vec<usize>], candidates: &[Candidate]) -> Vec<(usize, Work)> {
    let mut settings: Vec<usize> = Vec::new(); // the first candidate of each, by cost
    for &i in classes.iter().flatten() {
        if !settings.iter().any(|&known| candidates[known].place == candidates[i].place) {
            settings.push(i);
        }
    }
    let count = settings.len().min(BEGIN);
    let spread = (0..count).map(|n| {
        let level = if n % 3 == 0 { LEVELS - 1 } else { 0 };
        (settings[n * (settings.len() - 1) / (count - 1).max(1)], level)
    });
    let lacks = |&(i, level): &(usize, usize)| candidates[i].reached.len() <= level && !candidates[i].failed;
    spread.filter(lacks).map(|(i, level)| (i, Work::Level(level))).collect()
}

/// All errors that candidates have told.
fn seen(candidates: &[Candidate]) -> Vec<Seen> {
    let of = |(i, candidate): (usize, &Candidate)| {
        let told = candidate.reached.iter().enumerate();
        let told: Vec<Seen> =
            told.filter_map(|(level, e)| Some((i, level, e.filter(|e| *e > 0.0)?.ln()))).collect();
        told
    };
    candidates.iter().enumerate().flat_map(of).collect()
}

#[cfg(test)]
mod tests;
