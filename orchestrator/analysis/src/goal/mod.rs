//! Search for the cheapest design that meets a requirement. Decisions depend on stored results only.
//!
//! A candidate is a trial of the plan: a body with its sensors and decoder. Its stages are: not begun, two rungs (parts of the
//! outer steps), result, screening on fresh seeds, confirmation on further fresh seeds ([`seeds`]). Candidates of equal cost
//! form a class. The search works on the cheapest class with a candidate that may be confirmed, and there on the most promising
//! candidates ([`Prediction`]). It ends with a confirmed design when no cheaper class has a candidate worth working on.

mod seeds;

use std::cmp::Ordering;

pub use crate::predict::{LEVELS, Setting};
use crate::predict::{ObservedError, Prediction};
use metasense_schemas::spec::Goal;

use self::seeds::{Judgement, Seeds, chance_below, chance_confirmed, judged, latest, log_mean_deviation};
pub use self::seeds::{confirming, most_fresh};

/// Number of settings that are begun before the first prediction.
pub const BEGIN: usize = 8;
/// Smallest probability of confirmation with which a candidate is worked on. A smaller value costs more and makes it more
/// certain that the design is the cheapest; it does not affect whether the design meets the requirement. Chosen on synthetic
/// spaces (tests).
pub const WORTH: f64 = 0.12;
/// The same while no design is confirmed; applies after [`LEAST_RESULTS`] results plus one per coordinate of the settings.
pub const WORTH_LAST: f64 = 0.03;
/// Results before [`WORTH_LAST`] applies.
pub const LEAST_RESULTS: usize = 4;
/// Candidates are added to a round until the probability that none of them is confirmed is at most this.
const LEFT: f64 = 0.05;

/// A trial of the plan and its known results.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Candidate {
    /// Cost, compared lexicographically.
    pub cost: [f64; 3],
    /// Properties known before it runs.
    pub setting: Setting,
    /// Errors (%) at the levels reached so far; `None`: no error is known there.
    pub reached: Vec<Option<f64>>,
    /// Whether it has failed permanently.
    pub failed: bool,
    /// Errors (%) of its trained body on fresh seeds: first the screening seeds, then the confirming seeds.
    pub fresh: Vec<f64>,
    /// Number of confirmations begun before its own; `None` if its own was not begun.
    pub turn: Option<usize>,
}

/// Work on a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Work {
    /// Run the trial to this level: a rung, or its result.
    Level(usize),
    /// Evaluate its body on the screening seeds.
    Screen,
    /// Evaluate its body on the confirming seeds; the number of confirmations begun before.
    Confirm(usize),
}

/// State of a class.
#[derive(Debug, Clone, PartialEq)]
pub struct Class {
    /// The most promising candidate.
    pub best: usize,
    /// Its stage.
    pub stage: CandidateStage,
    /// Expected error (%) of this candidate, and its upper bound with probability `goal.confidence`.
    pub error: [f64; 2],
    /// Probability that a confirmed design meets the requirement on a further seed, else that the candidate will be confirmed.
    pub meets: f64,
    /// The same for any candidate of the class.
    pub any: f64,
    /// Number of candidates of the class, and of those begun.
    pub candidates: [usize; 2],
}

/// Stage of a candidate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CandidateStage {
    /// Not begun; its error is predicted from other candidates.
    Predicted,
    /// Part of its outer steps; its error is predicted from these and from other candidates.
    Looked,
    /// It has a result.
    Trained,
    /// Screened on fresh seeds.
    Screened,
    /// Evaluated on the confirming seeds; whether it passed.
    Judged(bool),
}

/// Next work, and the state of the search.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Work before the next decision; empty once the search has ended.
    pub work: Vec<(usize, Work)>,
    /// The design, if one is confirmed.
    pub chosen: Option<usize>,
    /// Probability that any candidate of the cheapest class in `work` will be confirmed; 0 without work.
    pub open: f64,
    /// Probability that any candidate cheaper than the design would be confirmed; 0 without a design.
    pub cheaper: f64,
    /// Correlation of first rung and result; `None` without observations.
    pub kinship: Option<f64>,
}

/// A search. It uses only results that it has requested, so interruptions and other stored results do not change decisions.
#[derive(Debug, Clone)]
pub struct DesignSearch {
    goal: Goal,
    /// The candidates with the requested results.
    shown: Vec<Candidate>,
}

impl DesignSearch {
    /// Starts a search; `candidates` have no results.
    pub fn new(goal: &Goal, candidates: impl Iterator<Item = Candidate>) -> Self {
        Self { goal: goal.clone(), shown: candidates.collect() }
    }

    /// Returns the state of all classes, the cheapest first.
    pub fn classes(&self) -> Vec<Class> {
        let view = View::new(&self.goal, &self.shown);
        view.classes.iter().map(|class| view.class(class)).collect()
    }

    /// Advances the search with stored results, and returns the next work.
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

/// Whether the stored results of a candidate contain this work.
fn is_known(goal: &Goal, stored: &Candidate, work: Work) -> bool {
    match work {
        Work::Level(level) => stored.failed || stored.reached.len() > level,
        Work::Screen | Work::Confirm(_) => stored.fresh.len() >= fresh_after(goal, work),
    }
}

/// Number of fresh seeds with results after this work.
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

/// Returns the next work and the state of the search.
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
    let open = at.map_or(0.0, |class| view.any_meets(class));
    let (chosen, kinship) = (view.chosen(), (!view.is_blind).then_some(view.prediction.kinship));
    let cheaper: Vec<usize> = view.cheaper(chosen).flatten().copied().collect();
    let cheaper = if chosen.is_some() { view.any_meets(&cheaper) } else { 0.0 };
    Decision { work, chosen, open, cheaper, kinship }
}

/// Predictions and judgements of the candidates at one point of a search.
struct View<'a> {
    goal: &'a Goal,
    candidates: &'a [Candidate],
    /// Candidates by cost, the cheapest class first; within a class in the order of the plan.
    classes: Vec<Vec<usize>>,
    prediction: Prediction,
    /// Number of confirmations begun.
    turns: usize,
    seeds: Seeds,
    judgements: Vec<Judgement>,
    /// Per candidate, the probability as in [`Class::meets`].
    prospects: Vec<f64>,
    /// Whether there are no observations.
    is_blind: bool,
}

impl<'a> View<'a> {
    fn new(goal: &'a Goal, candidates: &'a [Candidate]) -> Self {
        let settings: Vec<&Setting> = candidates.iter().map(|c| &c.setting).collect();
        let observed_errors = seen(candidates);
        let turns = candidates.iter().filter(|c| c.turn.is_some()).count();
        let mut view = Self {
            goal,
            candidates,
            classes: classes(candidates),
            prediction: Prediction::new(&settings, &observed_errors),
            turns,
            seeds: Seeds::of(goal, candidates, turns),
            judgements: candidates.iter().map(|c| judged(goal, c)).collect(),
            prospects: Vec::new(),
            is_blind: observed_errors.is_empty(),
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

    /// Whether its own result misses the requirement, or has no error.
    fn falls_short(&self, i: usize) -> bool {
        let result = self.candidates[i].reached.get(LEVELS - 1);
        result.is_some_and(|told| told.is_none_or(|e| e > self.goal.error))
    }

    fn is_open(&self, i: usize) -> bool {
        let decided = matches!(self.judgements[i], Judgement::Passed(_) | Judgement::Failed);
        !self.candidates[i].failed && !self.falls_short(i) && !decided
    }

    /// Whether the candidate is a confirmed design.
    fn stands(&self, i: usize) -> bool {
        self.prospects[i] > 0.0 && matches!(self.judgements[i], Judgement::Passed(_))
    }

    /// Returns the most promising candidate of a class; confirmed ones come first.
    fn best_of(&self, class: &[usize]) -> usize {
        let worse = |&a: &usize, &b: &usize| {
            let stands = self.stands(b).cmp(&self.stands(a));
            stands.then(self.order(a, b))
        };
        class.iter().copied().min_by(worse).expect("a class has candidates")
    }

    /// Orders candidates by probability, rounded to 1 %, then by levels reached, then by predicted error.
    fn order(&self, a: usize, b: usize) -> Ordering {
        let (begun, mean) = (|i: usize| self.candidates[i].reached.len(), &self.prediction.mean);
        let nearer = begun(b).cmp(&begun(a)).then(mean[a].total_cmp(&mean[b]));
        let prospects = |i: usize| (100.0 * self.prospects[i]).round();
        prospects(b).total_cmp(&prospects(a)).then(nearer).then(a.cmp(&b))
    }

    /// Returns the confirmed design of the cheapest class that has one.
    fn chosen(&self) -> Option<usize> {
        self.classes.iter().map(|class| self.best_of(class)).find(|&i| self.stands(i))
    }

    /// Returns the classes that are cheaper than the design; all without a design.
    fn cheaper(&self, chosen: Option<usize>) -> impl Iterator<Item = &Vec<usize>> {
        self.classes.iter().take_while(move |class| chosen.is_none_or(|c| !class.contains(&c)))
    }

    /// Probability that any of these candidates meets the requirement. Predictions are correlated, judgements on fresh seeds
    /// are independent.
    fn any_meets(&self, some: &[usize]) -> f64 {
        let unjudged = |i: &&usize| self.is_open(**i) && self.judgements[**i] == Judgement::None;
        let (predicted, judged): (Vec<&usize>, Vec<&usize>) = some.iter().partition(unjudged);
        let by_draws = self.prediction.chance(|draw| {
            1.0 - predicted.iter().map(|&&i| 1.0 - self.seeds.confirms(draw[i])).product::<f64>()
        });
        let any = judged.iter().fold(by_draws, |any, &&i| 1.0 - (1.0 - any) * (1.0 - self.prospects[i]));
        // rounding must not make it smaller than the probability of one candidate
        some.iter().map(|&i| self.prospects[i]).fold(any, f64::max)
    }

    /// Returns the first rung of settings spread over all costs, one candidate each.
    fn begin(&self) -> Vec<(usize, Work)> {
        let place = |i: usize| &self.candidates[i].setting.place;
        let mut settings: Vec<usize> = Vec::new(); // the first candidate of each, by cost
        for &i in self.classes.iter().flatten() {
            if !settings.iter().any(|&known| place(known) == place(i)) {
                settings.push(i);
            }
        }
        let count = settings.len().min(BEGIN);
        let spread = (0..count).map(|n| settings[n * (settings.len() - 1) / (count - 1).max(1)]);
        let lacks = |i: &usize| self.candidates[*i].reached.is_empty() && !self.candidates[*i].failed;
        spread.filter(lacks).map(|i| (i, Work::Level(0))).collect()
    }

    /// Returns work on classes cheaper than the design, the cheapest first, until it is unlikely that none of these candidates
    /// is confirmed.
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

    /// Returns work on the best candidates of any class. The limit is lower than in `class_by_class`, because "no design
    /// exists" needs more evidence than "no cheaper one"; with few results there is no limit.
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

    /// Returns the next work on a candidate.
    fn next(&self, i: usize) -> Work {
        match (self.candidates[i].reached.len(), self.judgements[i]) {
            (level, _) if level < LEVELS => Work::Level(level),
            (_, Judgement::None) => Work::Screen,
            _ => Work::Confirm(self.turns),
        }
    }

    /// Returns the stage of a candidate.
    fn stage(&self, i: usize) -> CandidateStage {
        match (self.judgements[i], self.candidates[i].reached.len()) {
            (Judgement::None, 0) => CandidateStage::Predicted,
            (Judgement::None, LEVELS..) => CandidateStage::Trained,
            (Judgement::None, _) => CandidateStage::Looked,
            (Judgement::Screened, _) => CandidateStage::Screened,
            (judgement, _) => CandidateStage::Judged(judgement != Judgement::Failed),
        }
    }

    /// Returns the state of a class.
    fn class(&self, class: &[usize]) -> Class {
        let best = self.best_of(class);
        let candidate = &self.candidates[best];
        let fresh = latest(self.goal, candidate);
        let middle = match self.judgements[best] {
            Judgement::None => self.prediction.mean[best] + self.seeds.shift,
            _ => log_mean_deviation(fresh).0,
        };
        let below = |e: f64| match (self.judgements[best], candidate.turn) {
            (Judgement::None, _) => self.prediction.chance(|draw| self.seeds.below(e, draw[best])),
            (Judgement::Screened, _) | (_, None) => chance_below(e, fresh),
            (_, Some(turn)) => chance_confirmed(e, turn, fresh),
        };
        let begun = class.iter().filter(|&&i| !self.candidates[i].reached.is_empty()).count();
        Class {
            best,
            stage: self.stage(best),
            error: [middle.exp(), quantile(self.goal.confidence, middle, below).exp()],
            meets: self.prospects[best],
            any: self.any_meets(class),
            candidates: [class.len(), begun],
        }
    }
}

/// Returns the ln error that is not exceeded with this probability, by bisection from `middle` − 3 to `middle` + 6.
fn quantile(probability: f64, middle: f64, below: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (middle - 3.0, middle + 6.0);
    for _ in 0..40 {
        let half = 0.5 * (low + high);
        if below(half) < probability { low = half } else { high = half }
    }
    high
}

/// Returns the candidates by cost, the cheapest class first; within a class in the order of the plan.
fn classes(candidates: &[Candidate]) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    let before = |a: &[f64; 3], b: &[f64; 3]| {
        a.iter().zip(b).map(|(a, b)| a.total_cmp(b)).find(|o| o.is_ne()).unwrap_or(Ordering::Equal)
    };
    order.sort_by(|&a, &b| before(&candidates[a].cost, &candidates[b].cost).then(a.cmp(&b)));
    let same = |a: &usize, b: &usize| candidates[*a].cost == candidates[*b].cost;
    order.chunk_by(same).map(<[usize]>::to_vec).collect()
}

/// Returns all known errors of candidates.
fn seen(candidates: &[Candidate]) -> Vec<ObservedError> {
    let of = |(i, candidate): (usize, &Candidate)| {
        let told = candidate.reached.iter().enumerate();
        let told: Vec<ObservedError> =
            told.filter_map(|(level, e)| Some((i, level, e.filter(|e| *e > 0.0)?.ln()))).collect();
        told
    };
    candidates.iter().enumerate().flat_map(of).collect()
}

#[cfg(test)]
mod tests;
