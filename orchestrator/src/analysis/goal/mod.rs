//! The cheapest design that meets a requirement, and what to run next to find it: pure, fed with stored results alone.
//!
//! A candidate is a trial of the plan: one body with its sensors and brain. It climbs a ladder: not begun, two rungs of outer
//! steps, its result, fresh seeds. Candidates of equal cost are a class. Work goes to the cheapest class that a candidate may
//! still meet the requirement in, there to the candidates of the best prospects ([`Prediction`]). The first design that stands on
//! fresh seeds, with no candidate left in a cheaper class that is worth work, is the answer.

use std::cmp::Ordering;

use metasense_schemas::spec::Goal;
pub use metasense_worker::predict::{LEVELS, Setting};
use metasense_worker::predict::{Prediction, Seen};
use metasense_worker::{FAILED, chance_above, student_above};

use super::numbers::{deviation, mean};

/// Settings that are looked at before anything is predicted.
const BEGIN: usize = 8;
/// Candidates with smaller prospects than this are not worked on. By it a search trades what it takes for how surely the design
/// is the cheapest one; that it meets the requirement hangs on fresh seeds alone. Chosen on made-up spaces (tests).
const WORTH: f64 = 0.12;
/// The same as long as no design stands, after so many results and one more for each coordinate.
const WORTH_LAST: f64 = 0.03;
const LEAST_RESULTS: usize = 4;
/// Candidates are worked on at a time until the chance that none of them meets the requirement is as small as this.
const LEFT: f64 = 0.05;
/// Least standard deviation of ln error from seed to seed: four seeds that agree by chance are not sure for ever.
const DEVIATION_MIN: f64 = 0.02;
/// What is thought of seeds before any body was judged: that deviation, as surely as by so many degrees of freedom. Of 0.05 and 0.1
/// on made-up spaces (tests, below the first) neither was better.
const DEVIATION: f64 = 0.1;
const FREEDOM: usize = 3;

/// A trial of the plan as the search sees it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Candidate {
    /// What it costs: compared one after the other.
    pub cost: [f64; 3],
    /// What is known of it before it is seen.
    pub setting: Setting,
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
pub struct Class {
    /// The candidate with the best prospects.
    pub best: usize,
    /// How far it has come.
    pub stage: Stage,
    /// The error (%) that is expected of it, and the one that it keeps to with the confidence asked for.
    pub error: [f64; 2],
    /// Probability that it meets the requirement on a further seed.
    pub meets: f64,
    /// Probability that any of the class would stand on fresh seeds.
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
    /// Probability that any of the cheapest class that is worked on would stand; 0 without work.
    pub open: f64,
    /// How far a first look tells a result: a correlation; `None` as long as nothing was seen.
    pub kinship: Option<f64>,
}

/// Fresh seeds that a body is judged on at most.
#[must_use]
pub fn most_fresh(goal: &Goal) -> usize {
    2 * goal.fresh
}

/// Probability that the error on a further seed is at most `limit`, by those on fresh ones: Student's t of ln e.
fn chance_below(limit: f64, fresh: &[f64]) -> f64 {
    let ((mean, deviation), n) = (of_seeds(fresh), fresh.len() as f64);
    chance_above(fresh.len() - 1, (mean - limit.ln()) / (deviation * (1.0 + 1.0 / n).sqrt()))
}

/// Mean and standard deviation of ln e.
fn of_seeds(fresh: &[f64]) -> (f64, f64) {
    let logs: Vec<f64> = fresh.iter().map(|e| e.ln()).collect();
    (mean(&logs).expect("it was judged"), deviation(&logs).unwrap_or(0.0).max(DEVIATION_MIN))
}

/// What a body's own result tells of fresh seeds, learnt from those that were judged.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Seeds {
    /// Mean ln error on fresh seeds, less that of the result: a body may owe part of it to its own seed.
    shift: f64,
    /// Standard deviation of that, and of ln error from seed to seed.
    about: f64,
    between: f64,
    /// Degrees of freedom of both.
    freedom: usize,
    freedom_between: usize,
    /// Fresh seeds that are asked for at most, and the greatest mean ln error over them with which a body stands.
    most: usize,
    limit: f64,
}

impl Seeds {
    fn of(goal: &Goal, candidates: &[Candidate]) -> Self {
        let (mut shifts, mut logs_between, mut freedom) = (Vec::new(), 0.0, 0);
        for candidate in candidates {
            // a failure is that of one body, and tells nothing of others
            let logs: Vec<f64> = candidate.fresh.iter().filter(|e| **e < FAILED).map(|e| e.ln()).collect();
            let Some(middle) = mean(&logs) else { continue };
            if let Some(deviation) = deviation(&logs) {
                // by the logarithm, less its bias (that of ln χ): bodies whose seeds are far apart are held against few others
                let of = (logs.len() - 1) as f64;
                logs_between += of * deviation.max(DEVIATION_MIN).ln() + 0.5 + 1.0 / (6.0 * of);
                freedom += logs.len() - 1;
            }
            shifts.extend(candidate.reached.last().copied().flatten().map(|own| middle - own.ln()));
        }
        let shift = shifts.iter().sum::<f64>() / (shifts.len() + 1) as f64;
        let before = FREEDOM as f64;
        let squares: f64 = shifts.iter().map(|s| (s - shift).powi(2)).sum();
        let about = ((before * DEVIATION.powi(2) + squares) / (FREEDOM + shifts.len()) as f64).sqrt();
        let between = ((before * DEVIATION.ln() + logs_between) / (FREEDOM + freedom) as f64).exp();
        let most = most_fresh(goal);
        let sure = if goal.confidence > 0.5 { student_above(most - 1, 1.0 - goal.confidence) } else { 0.0 };
        let limit = goal.error.ln() - sure * between * (1.0 + 1.0 / most as f64).sqrt();
        let [freedom, freedom_between] = [shifts.len(), freedom].map(|seen| FREEDOM + seen);
        Self { shift, about, between, freedom, freedom_between, most, limit }
    }

    /// Probability that a body of this ln result has a mean on fresh seeds with which it stands.
    fn stands(&self, result: f64) -> f64 {
        1.0 - chance_above(self.freedom, (self.limit - self.shift - result) / self.about)
    }

    /// Probability that a body of these errors (%) on fresh seeds stands once it is judged on as many as are asked for at most.
    fn will_stand(&self, fresh: &[f64]) -> f64 {
        let apart = self.between * (1.0 / fresh.len() as f64 - 1.0 / self.most as f64).sqrt();
        1.0 - chance_above(self.freedom_between, (self.limit - of_seeds(fresh).0) / apart)
    }

    /// Probability that it has at most this ln error on a further seed.
    fn below(&self, limit: f64, result: f64) -> f64 {
        1.0 - chance_above(self.freedom, (limit - self.shift - result) / self.about.hypot(self.between))
    }
}

/// A candidate on fresh seeds: not judged yet, on too few, or with what probability it meets the requirement on a further one.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Judgement {
    None,
    More,
    Final(f64),
}

fn judged(goal: &Goal, candidate: &Candidate) -> Judgement {
    let fresh = &candidate.fresh;
    if fresh.len() < goal.fresh {
        return Judgement::None;
    }
    let chance = chance_below(goal.error, fresh);
    let decides = !(1.0 - goal.confidence..goal.confidence).contains(&chance);
    if decides || fresh.len() >= most_fresh(goal) { Judgement::Final(chance) } else { Judgement::More }
}

/// A search, from its beginning on. It sees what it has asked for alone: kills, and whatever else is stored, change no decision.
#[derive(Debug, Clone)]
pub struct Search {
    goal: Goal,
    /// The candidates with what has been asked of them.
    shown: Vec<Candidate>,
}

impl Search {
    /// Of candidates of which nothing is known.
    pub fn new(goal: &Goal, candidates: impl Iterator<Item = Candidate>) -> Self {
        Self { goal: goal.clone(), shown: candidates.collect() }
    }

    /// How all classes stand, the cheapest first.
    pub fn classes(&self) -> Vec<Class> {
        let view = View::new(&self.goal, &self.shown);
        view.classes.iter().map(|class| view.class(class)).collect()
    }

    /// Follows the search as far as what is stored goes: where it stands then, and what is to be run next.
    pub fn follow(&mut self, stored: &[Candidate]) -> Decision {
        loop {
            let mut decision = decide(&self.goal, &self.shown);
            let asked = decision.work.clone();
            decision.work.retain(|&(i, work)| !is_known(&stored[i], work));
            if asked.is_empty() || !decision.work.is_empty() {
                return decision;
            }
            asked.into_iter().for_each(|(i, work)| show(&mut self.shown[i], &stored[i], work));
        }
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
    let view = View::new(goal, candidates);
    let mut work = view.begin();
    if work.is_empty() {
        work = view.class_by_class();
    }
    if work.is_empty() && view.chosen().is_none() {
        work = view.anywhere();
    }
    let at = view.classes.iter().find(|class| work.iter().any(|(i, _)| class.contains(i)));
    let open = at.map_or(0.0, |class| view.any(class));
    let kinship = (!view.is_blind).then_some(view.prediction.kinship);
    Decision { work, chosen: view.chosen(), open, kinship }
}

/// What is thought of the candidates at one point of a search.
struct View<'a> {
    goal: &'a Goal,
    candidates: &'a [Candidate],
    /// Candidates by cost, the cheapest first; of a class in the order of the plan.
    classes: Vec<Vec<usize>>,
    prediction: Prediction,
    seeds: Seeds,
    judgements: Vec<Judgement>,
    /// Probability that each meets the requirement; as long as fresh seeds have not decided, that they would.
    prospects: Vec<f64>,
    /// Nothing was seen yet.
    is_blind: bool,
}

impl<'a> View<'a> {
    fn new(goal: &'a Goal, candidates: &'a [Candidate]) -> Self {
        let settings: Vec<&Setting> = candidates.iter().map(|c| &c.setting).collect();
        let seen = seen(candidates);
        let mut view = Self {
            goal,
            candidates,
            classes: classes(candidates),
            prediction: Prediction::new(&settings, &seen),
            seeds: Seeds::of(goal, candidates),
            judgements: candidates.iter().map(|c| judged(goal, c)).collect(),
            prospects: Vec::new(),
            is_blind: seen.is_empty(),
        };
        view.prospects = (0..candidates.len()).map(|i| view.meets(i)).collect();
        view
    }

    fn meets(&self, i: usize) -> f64 {
        match self.judgements[i] {
            _ if self.candidates[i].failed || self.falls_short(i) => 0.0,
            Judgement::Final(chance) => chance,
            Judgement::More => self.seeds.will_stand(&self.candidates[i].fresh),
            Judgement::None => self.prediction.chance(|draw| self.seeds.stands(draw[i])),
        }
    }

    /// Its own result is the first judge.
    fn falls_short(&self, i: usize) -> bool {
        let result = self.candidates[i].reached.get(LEVELS - 1);
        result.is_some_and(|told| told.is_none_or(|e| e > self.goal.error))
    }

    fn is_open(&self, i: usize) -> bool {
        let decided = matches!(self.judgements[i], Judgement::Final(_));
        !self.candidates[i].failed && !self.falls_short(i) && !decided
    }

    fn stands(&self, i: usize) -> bool {
        matches!(self.judgements[i], Judgement::Final(chance) if chance >= self.goal.confidence)
    }

    /// The candidate of a class with the best prospects, one that stands before all others.
    fn best_of(&self, class: &[usize]) -> usize {
        let worse = |&a: &usize, &b: &usize| {
            let stands = self.stands(b).cmp(&self.stands(a));
            stands.then(self.order(a, b))
        };
        class.iter().copied().min_by(worse).expect("a class has candidates")
    }

    /// The better first; of equal prospects, in whole per cent, the one whose next level is nearer.
    fn order(&self, a: usize, b: usize) -> Ordering {
        let (begun, mean) = (|i: usize| self.candidates[i].reached.len(), &self.prediction.mean);
        let nearer = begun(b).cmp(&begun(a)).then(mean[a].total_cmp(&mean[b]));
        let prospects = |i: usize| (100.0 * self.prospects[i]).round();
        prospects(b).total_cmp(&prospects(a)).then(nearer).then(a.cmp(&b))
    }

    /// The design that stands in the cheapest class.
    fn chosen(&self) -> Option<usize> {
        self.classes.iter().map(|class| self.best_of(class)).find(|&i| self.stands(i))
    }

    /// Probability that any open candidate of a class meets the requirement.
    fn any(&self, class: &[usize]) -> f64 {
        let open = class.iter().copied().filter(|&i| self.is_open(i));
        let (unjudged, judged): (Vec<usize>, Vec<usize>) =
            open.partition(|&i| self.judgements[i] == Judgement::None);
        let by_draws = self
            .prediction
            .chance(|draw| 1.0 - unjudged.iter().map(|&i| 1.0 - self.seeds.stands(draw[i])).product::<f64>());
        judged.iter().fold(by_draws, |any, &i| 1.0 - (1.0 - any) * (1.0 - self.prospects[i]))
    }

    /// A first look at settings spread over all costs, one trial each.
    fn begin(&self) -> Vec<(usize, Work)> {
        let mut settings: Vec<usize> = Vec::new(); // the first candidate of each, by cost
        for &i in self.classes.iter().flatten() {
            if !settings
                .iter()
                .any(|&known| self.candidates[known].setting.place == self.candidates[i].setting.place)
            {
                settings.push(i);
            }
        }
        let count = settings.len().min(BEGIN);
        let spread = (0..count).map(|n| settings[n * (settings.len() - 1) / (count - 1).max(1)]);
        let lacks = |i: &usize| self.candidates[*i].reached.is_empty() && !self.candidates[*i].failed;
        spread.filter(lacks).map(|i| (i, Work::Level(0))).collect()
    }

    /// Class by class up to the one that a design stands in, as many candidates as leave little to hope for besides.
    fn class_by_class(&self) -> Vec<(usize, Work)> {
        let (mut work, mut besides, chosen) = (Vec::new(), 1.0, self.chosen());
        for class in self.classes.iter().take_while(|class| chosen.is_none_or(|c| !class.contains(&c))) {
            let worth = |i: &usize| self.is_open(*i) && self.prospects[*i] >= WORTH;
            let mut some: Vec<usize> = class.iter().copied().filter(worth).collect();
            some.sort_by(|a, b| self.order(*a, *b));
            for i in some {
                if work.len() < self.goal.at_a_time && besides > LEFT {
                    besides *= 1.0 - self.prospects[i];
                    work.push((i, self.next(i)));
                }
            }
        }
        work
    }

    /// The best candidates of any class: that there is no design is said less lightly than that there is no cheaper one, and not
    /// by a guess of a few results.
    fn anywhere(&self) -> Vec<(usize, Work)> {
        let results = self.candidates.iter().filter(|c| c.reached.len() == LEVELS).count();
        let guess = results < LEAST_RESULTS + self.candidates[0].setting.place.len();
        let worth = |i: &usize| self.is_open(*i) && (guess || self.prospects[*i] >= WORTH_LAST);
        let mut some: Vec<usize> = (0..self.candidates.len()).filter(worth).collect();
        some.sort_by(|a, b| self.order(*a, *b));
        let result = |i: usize| match self.candidates[i].reached.len() {
            LEVELS.. => self.next(i),
            _ => Work::Level(LEVELS - 1),
        };
        some.into_iter().take(self.goal.at_a_time).map(|i| (i, result(i))).collect()
    }

    /// The next rung of a candidate's ladder.
    fn next(&self, i: usize) -> Work {
        match (self.candidates[i].reached.len(), self.judgements[i]) {
            (level, _) if level < LEVELS => Work::Level(level),
            (_, Judgement::None) => Work::Fresh(self.goal.fresh),
            _ => Work::Fresh(most_fresh(self.goal)),
        }
    }

    /// How a class stands.
    fn class(&self, class: &[usize]) -> Class {
        let best = self.best_of(class);
        let candidate = &self.candidates[best];
        let (middle, below): (f64, Box<dyn Fn(f64) -> f64>) = match candidate.fresh.len() {
            0 => (
                self.prediction.mean[best] + self.seeds.shift,
                Box::new(|e| self.prediction.chance(|draw| self.seeds.below(e, draw[best]))),
            ),
            _ => (of_seeds(&candidate.fresh).0, Box::new(|e| chance_below(e.exp(), &candidate.fresh))),
        };
        let any = self.any(class);
        Class {
            best,
            stage: stage(candidate),
            error: [middle.exp(), quantile(self.goal.confidence, middle, &*below).exp()],
            meets: match self.judgements[best] {
                Judgement::None | Judgement::More if self.is_open(best) => below(self.goal.error.ln()),
                _ => self.prospects[best],
            },
            any: if self.stands(best) { any.max(self.prospects[best]) } else { any },
            candidates: [
                class.len(),
                class.iter().filter(|&&i| !self.candidates[i].reached.is_empty()).count(),
            ],
        }
    }
}

/// The ln error that is kept to with this probability, from a middle one on.
fn quantile(probability: f64, middle: f64, below: &dyn Fn(f64) -> f64) -> f64 {
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

/// Candidates by cost, the cheapest first; of a class in the order of the plan.
fn classes(candidates: &[Candidate]) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    let before = |a: &[f64; 3], b: &[f64; 3]| {
        a.iter().zip(b).map(|(a, b)| a.total_cmp(b)).find(|o| o.is_ne()).unwrap_or(Ordering::Equal)
    };
    order.sort_by(|&a, &b| before(&candidates[a].cost, &candidates[b].cost).then(a.cmp(&b)));
    let same = |a: &usize, b: &usize| candidates[*a].cost == candidates[*b].cost;
    order.chunk_by(same).map(<[usize]>::to_vec).collect()
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
