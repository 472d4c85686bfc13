//! The cheapest design that meets a requirement, and what to run next to find it: pure, fed with stored results alone.
//!
//! A candidate is a trial of the plan: one body with its sensors and brain. It climbs a ladder: not begun, two rungs of outer
//! steps, its result, fresh seeds that screen it, fresh seeds that confirm it ([`seeds`]). Candidates of equal cost are a class. Work
//! goes to the cheapest class in which a candidate may still be confirmed, there to the candidates for which this is likeliest
//! ([`Prediction`]). The first design that is confirmed, with no candidate left in a cheaper class that is worth work, is the answer.

mod seeds;

use std::cmp::Ordering;

pub use crate::predict::{LEVELS, Setting};
use crate::predict::{Prediction, Seen};
use metasense_schemas::spec::Goal;

use self::seeds::{Judgement, Seeds, chance_below, chance_confirmed, judged, latest, of_seeds};
pub use self::seeds::{confirming, most_fresh};

/// Settings that are begun before anything is predicted.
pub const BEGIN: usize = 8;
/// Candidates that are less likely to be confirmed are not worked on. By it a search trades what it takes for how surely the design
/// is the cheapest one; that it meets the requirement hangs on fresh seeds alone. Chosen on made-up spaces (tests).
pub const WORTH: f64 = 0.12;
/// The same as long as no design is confirmed, after so many results and one more for each coordinate.
pub const WORTH_LAST: f64 = 0.03;
/// See [`WORTH_LAST`].
pub const LEAST_RESULTS: usize = 4;
/// Candidates are worked on at a time until the chance that none of them is confirmed is as small as this.
const LEFT: f64 = 0.05;

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
    /// Errors (%) of its trained body on fresh seeds: those that screen it, then those that confirm it.
    pub fresh: Vec<f64>,
    /// How many confirmations the search had begun before that of this candidate; `None`: its own was not begun.
    pub turn: Option<usize>,
}

/// What is to be done for a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Work {
    /// Run it to this level: a rung, or its result.
    Level(usize),
    /// Read its body on the fresh seeds that screen it.
    Screen,
    /// Read it on those that confirm it, after so many other confirmations.
    Confirm(usize),
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
    /// Probability that it meets the requirement: of a confirmed design on a further seed, else that it will be confirmed.
    pub meets: f64,
    /// The same of any candidate of the class.
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
    /// Its body was screened on fresh seeds.
    Screened,
    /// Its body was read on the seeds that confirm it, and has passed or not.
    Judged(bool),
}

/// What comes next.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// To be run before the next decision; nothing once the search is over.
    pub work: Vec<(usize, Work)>,
    /// The design, if one is confirmed.
    pub chosen: Option<usize>,
    /// Probability that any candidate will be confirmed, of the cheapest class that is worked on; 0 without work.
    pub open: f64,
    /// Probability that any candidate cheaper than the design would be confirmed; 0 without a design.
    pub cheaper: f64,
    /// How far a first look tells a result: a correlation; `None` as long as nothing was seen.
    pub kinship: Option<f64>,
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
            decision.work.retain(|&(i, work)| !is_known(&self.goal, &stored[i], work));
            if asked.is_empty() || !decision.work.is_empty() {
                return decision;
            }
            asked.into_iter().for_each(|(i, work)| show(&self.goal, &mut self.shown[i], &stored[i], work));
        }
    }
}

/// Whether what is stored of a candidate has this.
fn is_known(goal: &Goal, stored: &Candidate, work: Work) -> bool {
    match work {
        Work::Level(level) => stored.failed || stored.reached.len() > level,
        Work::Screen | Work::Confirm(_) => stored.fresh.len() >= fresh_after(goal, work),
    }
}

/// Fresh seeds that are known after some work.
#[must_use]
pub fn fresh_after(goal: &Goal, work: Work) -> usize {
    match work {
        Work::Level(_) => 0,
        Work::Screen => goal.fresh,
        Work::Confirm(_) => most_fresh(goal),
    }
}

fn show(goal: &Goal, shown: &mut Candidate, stored: &Candidate, work: Work) {
    match work {
        Work::Level(level) if stored.reached.len() > level => {
            shown.reached = stored.reached[..=level].to_vec();
        }
        Work::Level(_) => shown.failed = true,
        Work::Screen | Work::Confirm(_) => shown.fresh = stored.fresh[..fresh_after(goal, work)].to_vec(),
    }
    if let Work::Confirm(turn) = work {
        shown.turn = Some(turn);
    }
}

/// Where the search stands, and what is to be run next.
fn decide(goal: &Goal, candidates: &[Candidate]) -> Decision {
    let mut view = View::new(goal, candidates);
    let mut work = view.begin();
    if work.is_empty() {
        work = view.class_by_class();
    }
    if work.is_empty() && view.chosen().is_none() {
        work = view.anywhere();
    }
    for (_, work) in &mut work {
        if let Work::Confirm(turn) = work {
            *turn = view.turns;
            view.turns += 1;
        }
    }
    let at = view.classes.iter().find(|class| work.iter().any(|(i, _)| class.contains(i)));
    let open = at.map_or(0.0, |class| view.any(class));
    let (chosen, kinship) = (view.chosen(), (!view.is_blind).then_some(view.prediction.kinship));
    let cheaper = if chosen.is_some() {
        view.any(&view.cheaper(chosen).flatten().copied().collect::<Vec<_>>())
    } else {
        0.0
    };
    Decision { work, chosen, open, cheaper, kinship }
}

/// What is thought of the candidates at one point of a search.
struct View<'a> {
    goal: &'a Goal,
    candidates: &'a [Candidate],
    /// Candidates by cost, the cheapest first; of a class in the order of the plan.
    classes: Vec<Vec<usize>>,
    prediction: Prediction,
    /// Confirmations that were begun.
    turns: usize,
    seeds: Seeds,
    judgements: Vec<Judgement>,
    /// Probability that each meets the requirement: of a confirmed design on a further seed, else that it will be confirmed.
    prospects: Vec<f64>,
    /// Nothing was seen yet.
    is_blind: bool,
}

impl<'a> View<'a> {
    fn new(goal: &'a Goal, candidates: &'a [Candidate]) -> Self {
        let settings: Vec<&Setting> = candidates.iter().map(|c| &c.setting).collect();
        let seen = seen(candidates);
        let turns = candidates.iter().filter(|c| c.turn.is_some()).count();
        let mut view = Self {
            goal,
            candidates,
            classes: classes(candidates),
            prediction: Prediction::new(&settings, &seen),
            turns,
            seeds: Seeds::of(goal, candidates, turns),
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
            Judgement::Passed(chance) => chance,
            Judgement::Failed => 0.0,
            Judgement::Screened => self.seeds.confirms_screened(latest(self.goal, &self.candidates[i])),
            Judgement::None => self.prediction.chance(|draw| self.seeds.confirms(draw[i])),
        }
    }

    /// Its own result is the first judge.
    fn falls_short(&self, i: usize) -> bool {
        let result = self.candidates[i].reached.get(LEVELS - 1);
        result.is_some_and(|told| told.is_none_or(|e| e > self.goal.error))
    }

    fn is_open(&self, i: usize) -> bool {
        let decided = matches!(self.judgements[i], Judgement::Passed(_) | Judgement::Failed);
        !self.candidates[i].failed && !self.falls_short(i) && !decided
    }

    /// Whether it is a confirmed design.
    fn stands(&self, i: usize) -> bool {
        self.prospects[i] > 0.0 && matches!(self.judgements[i], Judgement::Passed(_))
    }

    /// The candidate of a class with the best prospects, a confirmed one before all others.
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

    /// The confirmed design of the cheapest class that has one.
    fn chosen(&self) -> Option<usize> {
        self.classes.iter().map(|class| self.best_of(class)).find(|&i| self.stands(i))
    }

    /// Classes that are cheaper than the design, or all.
    fn cheaper(&self, chosen: Option<usize>) -> impl Iterator<Item = &Vec<usize>> {
        self.classes.iter().take_while(move |class| chosen.is_none_or(|c| !class.contains(&c)))
    }

    /// Probability that any of these meets the requirement. Predictions hang together, judgements on fresh seeds do not.
    fn any(&self, some: &[usize]) -> f64 {
        let unjudged = |i: &&usize| self.is_open(**i) && self.judgements[**i] == Judgement::None;
        let (predicted, judged): (Vec<&usize>, Vec<&usize>) = some.iter().partition(unjudged);
        let by_draws = self.prediction.chance(|draw| {
            1.0 - predicted.iter().map(|&&i| 1.0 - self.seeds.confirms(draw[i])).product::<f64>()
        });
        let any = judged.iter().fold(by_draws, |any, &&i| 1.0 - (1.0 - any) * (1.0 - self.prospects[i]));
        // rounding must not make it less than what one of them has
        some.iter().map(|&i| self.prospects[i]).fold(any, f64::max)
    }

    /// The first rung of settings spread over all costs, one trial each.
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

    /// Class by class up to that of the design, as many candidates as leave little to hope for besides.
    fn class_by_class(&self) -> Vec<(usize, Work)> {
        let (mut work, mut besides) = (Vec::new(), 1.0);
        for class in self.cheaper(self.chosen()) {
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
        let worth = |i: &usize| {
            let guess = guess && self.judgements[*i] == Judgement::None;
            self.is_open(*i) && (guess || self.prospects[*i] >= WORTH_LAST)
        };
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
            (_, Judgement::None) => Work::Screen,
            _ => Work::Confirm(self.turns),
        }
    }

    /// How far a candidate has come.
    fn stage(&self, i: usize) -> Stage {
        match (self.judgements[i], self.candidates[i].reached.len()) {
            (Judgement::None, 0) => Stage::Predicted,
            (Judgement::None, LEVELS..) => Stage::Trained,
            (Judgement::None, _) => Stage::Looked,
            (Judgement::Screened, _) => Stage::Screened,
            (judgement, _) => Stage::Judged(judgement != Judgement::Failed),
        }
    }

    /// How a class stands.
    fn class(&self, class: &[usize]) -> Class {
        let best = self.best_of(class);
        let candidate = &self.candidates[best];
        let fresh = latest(self.goal, candidate);
        let (middle, below): (f64, Box<dyn Fn(f64) -> f64>) = match (self.judgements[best], candidate.turn) {
            (Judgement::None, _) => (
                self.prediction.mean[best] + self.seeds.shift,
                Box::new(|e| self.prediction.chance(|draw| self.seeds.below(e, draw[best]))),
            ),
            (Judgement::Screened, _) | (_, None) => (of_seeds(fresh).0, Box::new(|e| chance_below(e, fresh))),
            (_, Some(turn)) => (of_seeds(fresh).0, Box::new(move |e| chance_confirmed(e, turn, fresh))),
        };
        Class {
            best,
            stage: self.stage(best),
            error: [middle.exp(), quantile(self.goal.confidence, middle, &*below).exp()],
            meets: self.prospects[best],
            any: self.any(class),
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
