//! Searches for an explanation of the records: stiffness, panels, clock, axes, sensor positions. Then tests single records.

use super::sums::ProductSums;
use super::{CheckedRecord, ComparisonModel, History};
use metasense_numerics::student::median;

/// Factors on all stiffnesses.
const STIFFNESS: [f64; 5] = [0.7, 0.84, 1.0, 1.19, 1.41];
/// f_c relative to the sampling rate, and W·f_c.
const CUTOFF: f64 = 0.2;
const PERIODS: f64 = 3.0;
/// Mean correlation above which clock errors are not searched.
const GOOD: f64 = 0.6;
/// Least increase of the mean correlation for a reported mistake; additional increase per inverted sign and per exchanged channel.
const RISE: f64 = 0.2;
const TURNED: f64 = 0.04;
const EXCHANGED: f64 = 0.05;
/// Additional increase for another order of panels, or another clock.
const MOVED: f64 = 0.03;
/// Factor on forces in too large a unit, under which the model moves unrealistically.
const WEAKER: f64 = 1e-3;
/// A record is suspicious below this correlation, if also this far below the median.
const OUTLIER_BELOW: f64 = 0.55;
const OUTLIER_GAP: f64 = 0.2;
/// A channel is silent if its correlations with all signals of its sensor are smaller.
const SILENT: f64 = 0.35;
/// A channel is compared if, in the model, its readings correlate at least so much with its motion, both smoothed.
const FAITHFUL: f64 = 0.95;
/// Least fraction of a window's readings.
const MIN_WINDOW_SHARE: f64 = 0.75;

/// Simulated signal that a channel contains (sensor · channels + channel), and its sign.
pub type MatchedSignal = (usize, f64);

/// Comparison of one channel over all records.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelFinding {
    /// Correlation with the signal of its position, and with the signal that it contains.
    pub correlation: [f64; 2],
    /// Gain: measured/simulated.
    pub gain: f64,
    /// Whether it correlates with no signal although other channels do.
    pub silent: bool,
    /// For a channel whose chip samples too slowly for the body's modes: correlation of the model's readings with its motion, both
    /// smoothed. The channel is not compared.
    pub aliased: Option<f64>,
}

impl ChannelFinding {
    /// Whether the channel is compared with the model.
    pub fn is_compared(&self) -> bool {
        !self.silent && self.aliased.is_none()
    }
}

/// Comparison of one record, given the explanation of all.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordFinding {
    /// Correlation with the model.
    pub correlation: f64,
    /// Delay of the readings (s) relative to the record's clock, within three readings of the common delay.
    pub lag: f64,
    /// Panel that explains the record better (first panel of an exchange), and the correlation with it.
    pub panel: Option<(usize, f64)>,
    /// Delay that explains the record better (s), and the correlation with it.
    pub clock: Option<(f64, f64)>,
}

/// Best explanation of the records.
#[derive(Debug, Clone, PartialEq)]
pub struct Explanation {
    /// Factor on the stiffness of the design.
    pub stiffness: f64,
    /// Mean correlation of the channels as described, and with the explanation.
    pub correlation: [f64; 2],
    /// Panel that is struck where the file has panel k.
    pub panels: Vec<usize>,
    /// Delay of the readings relative to the file's clock (s), per record.
    pub lags: Vec<f64>,
    /// Source per channel.
    pub source: Vec<MatchedSignal>,
    /// Per sensor, the unit that explains its signals better; mean correlations with the described unit and with this one.
    pub units: Vec<Option<(usize, [f64; 2])>>,
    /// Comparison per channel.
    pub channels: Vec<ChannelFinding>,
    /// Comparison per record.
    pub records: Vec<RecordFinding>,
    /// Longest interval between compared readings (s).
    pub dt: f64,
    /// Simulated signals per record, with the explanation.
    pub simulated: Vec<History>,
}

/// An explanation and its mean correlation over channels.
#[derive(Debug, Clone)]
struct State {
    stiffness: f64,
    panels: Vec<usize>,
    lags: Vec<f64>,
    source: Vec<MatchedSignal>,
    score: f64,
    /// Score minus penalties for changes, so that fewer changes win among similar scores.
    value: f64,
}

struct RecordSearch<'a> {
    model: &'a ComparisonModel<'a>,
    records: &'a [CheckedRecord],
    /// Low-passed signals minus their mean before the blow.
    smooth: Vec<History>,
    windows: Vec<[f64; 2]>,
    cutoff: f64,
    /// Longest interval between readings (s).
    dt: f64,
    /// Simulated orders of panels: cyclic shifts for single forces, else exchanges.
    orders: Vec<Vec<usize>>,
    /// Orders that can explain all records: exchanges; for single forces the shifts by one place, too.
    candidates: Vec<Vec<usize>>,
    silent: Vec<bool>,
    /// Correlation of the model's readings with its motion, per channel.
    fidelity: Vec<f64>,
}

/// Compares records with the model. `None` if the simulation fails.
///
/// # Panics
/// If there are no records, or their channels differ from the model's.
pub fn compare(model: &ComparisonModel, records: &[CheckedRecord]) -> Option<Explanation> {
    let as_said = find_explanation(model, records);
    if as_said.as_ref().is_some_and(|found| found.correlation[1] > GOOD) {
        return as_said;
    }
    let mut weaker = records.to_vec();
    let forces = weaker.iter_mut().flat_map(|record| &mut record.force.values);
    forces.flatten().for_each(|force| *force *= WEAKER);
    let mut weaker = find_explanation(model, &weaker)?;
    if as_said.as_ref().is_some_and(|found| weaker.correlation[1] < found.correlation[1] + RISE) {
        return as_said;
    }
    weaker.channels.iter_mut().for_each(|channel| channel.gain *= WEAKER);
    Some(weaker)
}

fn find_explanation(model: &ComparisonModel, records: &[CheckedRecord]) -> Option<Explanation> {
    let session = RecordSearch::new(model, records);
    let mut best: Option<(State, Vec<Vec<History>>, f64)> = None;
    for stiffness in STIFFNESS {
        let Some(simulated) = session.simulated(stiffness) else { continue };
        let (state, before) = session.find_best_state(stiffness, &simulated);
        if best.as_ref().is_none_or(|(other, ..)| state.value > other.value) {
            best = Some((state, simulated, before));
        }
    }
    let (state, simulated, before) = best?;
    Some(session.into_explanation(state, &simulated, before))
}

impl<'a> RecordSearch<'a> {
    fn new(model: &'a ComparisonModel<'a>, records: &'a [CheckedRecord]) -> Self {
        let dt = records.iter().map(|r| r.signals.dt).fold(0.0, f64::max);
        let cutoff = CUTOFF / dt;
        let smooth = |record: &CheckedRecord| {
            let [onset, _] = record.blow();
            let mut smooth = record.signals.smooth(cutoff);
            let quiet = smooth.before(onset);
            for (history, raw) in smooth.values.iter_mut().zip(&record.signals.values) {
                let rest = raw[..quiet].iter().sum::<f64>() / quiet.max(1) as f64;
                history.iter_mut().for_each(|y| *y -= rest);
            }
            smooth
        };
        let window = |record: &CheckedRecord| {
            let ([onset, end], w) = (record.blow(), PERIODS / cutoff);
            [onset - 0.25 * w, (onset + w).max(end).min(model.scene.duration)]
        };
        let panels = model.scene.panels.len();
        let shift = |by: usize| (0..panels).map(|k| (k + by) % panels).collect();
        let exchange = |(i, j): (usize, usize)| {
            let mut order: Vec<usize> = shift(0);
            order.swap(i, j);
            order
        };
        let pairs = (0..panels).flat_map(|i| (0..i).map(move |j| (i, j)));
        let mut candidates: Vec<Vec<usize>> = [shift(0)].into_iter().chain(pairs.map(exchange)).collect();
        let mut orders = candidates.clone();
        if records[0].panel.is_some() {
            orders = (0..panels).map(shift).collect();
            candidates.extend([1, panels - 1].into_iter().filter(|_| panels > 2).map(shift));
        }
        let channels = model.scene.sensors.len() * model.channels.len();
        let mut search = Self {
            model,
            records,
            smooth: records.iter().map(smooth).collect(),
            windows: records.iter().map(window).collect(),
            cutoff,
            dt,
            orders,
            candidates,
            silent: vec![false; channels],
            fidelity: vec![1.0; channels],
        };
        search.fidelity = search.find_fidelity();
        search
    }

    /// Correlation per channel of the model's readings with its motion after the chip's filter, both smoothed; 1 without motion.
    fn find_fidelity(&mut self) -> Vec<f64> {
        let (model, channels) = (self.model, self.silent.len());
        let mut motion = self.motion(&self.orders[0], &model.scene.sensors, 1.0);
        for of in &mut motion {
            let filter = |history: &mut Vec<f64>| {
                model.chip.iter().for_each(|chip| chip.low_pass(history, 1, 1, of.dt));
            };
            of.values.iter_mut().for_each(filter);
        }
        let read = |(motion, record): (&History, &CheckedRecord)| {
            let clock = &record.signals;
            let at = |c: usize| (0..clock.entries()).map(|n| motion.at(c, clock.time(n))).collect();
            History { values: (0..channels).map(at).collect(), ..*clock }.smooth(self.cutoff)
        };
        let readings = motion.iter().zip(self.records).map(read).collect();
        let measured = std::mem::replace(&mut self.smooth, readings);
        let smooth: Vec<History> = motion.iter().map(|motion| motion.smooth(self.cutoff)).collect();
        let sums = self.summed(&smooth, &|_| 0.0);
        self.smooth = measured;
        let moves = |c: &usize| sums.simulated.get(*c).is_some_and(|square| square.is_normal());
        let of = |c: usize| if moves(&c) { sums.correlation(c, c) } else { 1.0 };
        (0..channels).map(of).collect()
    }

    /// Whether a channel is faithful enough to be compared.
    fn compares(&self, channel: usize) -> bool {
        self.fidelity[channel] >= FAITHFUL
    }

    /// Number of compared channels among these, at least 1.
    fn compared(&self, channels: std::ops::Range<usize>) -> f64 {
        channels.filter(|c| self.compares(*c)).count().max(1) as f64
    }

    /// Low-passed simulated signals by order of panels and record. `None` if the simulation fails or nothing moves.
    fn simulated(&self, stiffness: f64) -> Option<Vec<Vec<History>>> {
        let all = self.orders.iter().map(|order| self.run(order, &self.model.scene.sensors, stiffness));
        let all: Vec<Vec<History>> = all.collect();
        let finite = |h: &History| h.values.iter().flatten().all(|x| x.is_finite());
        let moves = |h: &History| h.values.iter().flatten().any(|x| *x != 0.0);
        (all.iter().flatten().all(finite) && all[0].iter().any(moves)).then_some(all)
    }

    fn run(&self, order: &[usize], sensors: &[usize], stiffness: f64) -> Vec<History> {
        let motion = self.motion(order, sensors, stiffness);
        motion.iter().map(|history| history.smooth(self.cutoff)).collect()
    }

    fn motion(&self, order: &[usize], sensors: &[usize], stiffness: f64) -> Vec<History> {
        let place = |record: &CheckedRecord| match record.panel {
            Some(panel) => vec![order[panel]],
            None => order.to_vec(),
        };
        self.model.simulate(self.records, &place, sensors, stiffness, self.dt)
    }

    /// Index of a simulated order that acts on this record as `panels` does.
    fn order(&self, record: usize, panels: &[usize]) -> usize {
        let alike = |order: &Vec<usize>| match self.records[record].panel {
            Some(k) => order[k] == panels[k],
            None => order == panels,
        };
        self.orders.iter().position(alike).unwrap_or(0)
    }

    /// Sums over a record's window; 0 for channels that are not compared. `None` without a force or enough readings.
    fn moments(&self, record: usize, simulated: &History, lag: f64) -> Option<ProductSums> {
        let (y, [from, to]) = (&self.smooth[record], self.windows[record]);
        let first = ((from - lag - y.start) / y.dt).ceil().max(0.0) as usize;
        let last = ((to - lag - y.start) / y.dt).floor();
        if last < 0.0 {
            return None;
        }
        let readings = first..(last as usize + 1).min(y.entries());
        let peak = self.records[record].force.values.iter().flatten().fold(0.0f64, |m, f| m.max(f.abs()));
        if (readings.len() as f64) < MIN_WINDOW_SHARE * (to - from) / y.dt || peak == 0.0 {
            return None;
        }
        let (rows, columns) = (y.values.len(), simulated.values.len());
        let mut found = ProductSums::zeros(rows, columns);
        let weight = peak.max(f64::MIN_POSITIVE).powi(-2);
        let mut s = vec![0.0; columns];
        for n in readings {
            let time = y.time(n) + lag;
            let compared = |(c, _): &(usize, _)| self.compares(*c);
            s.iter_mut().enumerate().filter(compared).for_each(|(d, s)| *s = simulated.at(d, time));
            found.simulated.iter_mut().zip(&s).for_each(|(sum, s)| *sum += weight * s * s);
            for (c, history) in y.values.iter().enumerate().filter(|(c, _)| self.compares(*c)) {
                let y = history[n];
                found.measured[c] += weight * y * y;
                let row = &mut found.products[c * columns..][..columns];
                row.iter_mut().zip(&s).for_each(|(sum, s)| *sum += weight * y * s);
            }
        }
        Some(found)
    }

    /// Sums over all records with readings in their windows; empty if there are none.
    fn summed(&self, simulated: &[History], lag: &dyn Fn(usize) -> f64) -> ProductSums {
        let mut sums = ProductSums::default();
        for (record, of) in simulated.iter().enumerate() {
            self.moments(record, of, lag(record)).iter().for_each(|found| sums.add(found));
        }
        sums
    }

    /// Sums over all records; `None` unless more than half of them have readings in their windows.
    fn pooled(
        &self,
        simulated: &[Vec<History>],
        panels: &[usize],
        lag: &dyn Fn(usize) -> f64,
    ) -> Option<ProductSums> {
        let (mut all, mut count) = (ProductSums::default(), 0);
        for record in 0..self.records.len() {
            let of = &simulated[self.order(record, panels)][record];
            if let Some(found) = self.moments(record, of, lag(record)) {
                all.add(&found);
                count += 1;
            }
        }
        (2 * count > self.records.len()).then_some(all)
    }

    /// Source per channel, mean correlation, and that minus penalties. A sensor keeps its channels unless another sensor, order or sign is
    /// much better.
    fn assigned(&self, all: &ProductSums) -> (Vec<MatchedSignal>, f64, f64) {
        let (own, sensors) = (self.model.channels.len(), self.model.scene.sensors.len());
        let orders = permutations(own);
        let (mut source, mut sum, mut cost) = (Vec::new(), 0.0, 0.0);
        for m in 0..sensors {
            let as_said: f64 = (0..own).map(|k| all.correlation(m * own + k, m * own + k)).sum();
            let same = (0..own).map(|k| (m * own + k, 1.0)).collect();
            let rise = RISE * self.compared(m * own..(m + 1) * own);
            let mut best = (as_said + rise, as_said, same, 0.0);
            for other in 0..sensors {
                for order in &orders {
                    let changed = order.iter().enumerate().filter(|(k, d)| k != *d).count();
                    let mut paid = EXCHANGED * (changed + usize::from(other != m)) as f64;
                    let (mut value, mut sources) = (0.0, Vec::new());
                    for (k, d) in order.iter().enumerate() {
                        let rho = all.correlation(m * own + k, other * own + d);
                        value += rho.abs();
                        paid += if rho < 0.0 { TURNED } else { 0.0 };
                        sources.push((other * own + d, if rho < 0.0 { -1.0 } else { 1.0 }));
                    }
                    if value - paid > best.0 {
                        best = (value - paid, value, sources, paid);
                    }
                }
            }
            source.extend(best.2);
            (sum, cost) = (sum + best.1, cost + best.3);
        }
        let count = self.compared(0..own * sensors);
        (source, sum / count, (sum - cost) / count)
    }

    /// Best explanation at this stiffness, and the mean correlation as described.
    fn find_best_state(&self, stiffness: f64, simulated: &[Vec<History>]) -> (State, f64) {
        let (count, same) = (self.records.len(), self.candidates[0].clone());
        let state = |order: &[usize], lag: f64| {
            let all = self.pooled(simulated, order, &|_| lag)?;
            let (source, score, value) = self.assigned(&all);
            let moved = u8::from(order != same) + u8::from(lag != 0.0);
            let value = value - MOVED * f64::from(moved);
            Some(State { stiffness, panels: order.to_vec(), lags: vec![lag; count], source, score, value })
        };
        let width = self.silent.len();
        let as_said = self.pooled(simulated, &same, &|_| 0.0);
        let mean = |all: &ProductSums| {
            (0..width).map(|c| all.correlation(c, c)).sum::<f64>() / self.compared(0..width)
        };
        let before = as_said.as_ref().map_or(0.0, mean);
        let source: Vec<MatchedSignal> = (0..width).map(|c| (c, 1.0)).collect();
        let lags = vec![0.0; count];
        let none = State { stiffness, panels: same.clone(), lags, source, score: before, value: before };
        // If most records match as described, only single records can be wrong.
        let follows = |all: &ProductSums| {
            let of = |r: usize| {
                Some(self.moments(r, &simulated[0][r], 0.0)?.agreement(all, &none.source, &self.silent))
            };
            2 * (0..count).filter_map(of).filter(|rho| *rho > GOOD).count() > count
        };
        if as_said.as_ref().is_some_and(follows) {
            return (state(&same, 0.0).unwrap_or(none), before);
        }
        let best_of = |lag: f64| {
            let all = self.candidates.iter().filter_map(|order| state(order, lag));
            all.max_by(|a, b| a.value.total_cmp(&b.value))
        };
        let better = |new: &State, old: &State| new.value > old.value + 0.5 * RISE;
        let mut best = best_of(0.0).filter(|new| new.panels == same || better(new, &none)).unwrap_or(none);
        if best.score < GOOD {
            let late = self.lags().filter_map(best_of).max_by(|a, b| a.value.total_cmp(&b.value));
            best = late.filter(|new| better(new, &best)).unwrap_or(best);
        }
        if best.score < GOOD {
            let each: Vec<f64> = (0..count).map(|record| self.own_lag(record, simulated, &best)).collect();
            if let Some(all) = self.pooled(simulated, &same, &|record| each[record]) {
                let (source, score, value) = self.assigned(&all);
                let new = State { stiffness, panels: same, lags: each, source, score, value: value - RISE };
                best = Some(new).filter(|new| better(new, &best)).unwrap_or(best);
            }
        }
        (best, before)
    }

    /// Candidate delays: multiples of half a reading up to the longest record.
    fn lags(&self) -> impl Iterator<Item = f64> + use<'_> {
        let longest =
            self.records.iter().map(|r| r.signals.entries() as f64 * r.signals.dt).fold(0.0, f64::max);
        let most = (2.0 * longest / self.dt) as i64;
        (-most..=most).map(|n| 0.5 * n as f64 * self.dt)
    }

    /// Delay that maximises the correlation of one record, with its panels as described.
    fn own_lag(&self, record: usize, simulated: &[Vec<History>], state: &State) -> f64 {
        let own = |lag: f64| {
            let found = self.moments(record, &simulated[0][record], lag)?;
            let of = |c: usize| found.correlation(c, state.source[c].0) * state.source[c].1;
            Some(((0..state.source.len()).map(of).sum::<f64>(), lag))
        };
        self.lags().filter_map(own).max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |best| best.1)
    }

    /// Evaluates an explanation: channels, single records, sensor positions.
    fn into_explanation(mut self, mut state: State, simulated: &[Vec<History>], before: f64) -> Explanation {
        let own = self.model.channels.len();
        let width = state.source.len();
        let all = self.pooled(simulated, &state.panels, &|r| state.lags[r]);
        let all = all.unwrap_or_else(|| ProductSums::zeros(width, width));
        let strongest = |c: usize| {
            let sensor = c / own * own;
            (sensor..sensor + own).map(|d| all.correlation(c, d).abs()).fold(0.0, f64::max)
        };
        let follows = |c: usize| all.correlation(c, state.source[c].0) * state.source[c].1;
        let compared: Vec<usize> = (0..state.source.len()).filter(|c| self.compares(*c)).collect();
        let of_compared: Vec<f64> = compared.iter().map(|c| follows(*c)).collect();
        let usual = if compared.is_empty() { 0.0 } else { median(&of_compared) };
        compared.iter().for_each(|&c| self.silent[c] = usual > GOOD && strongest(c) < SILENT);
        let channels = (0..state.source.len()).map(|c| {
            let (d, sign) = state.source[c];
            let size = all.simulated[d];
            let gain = sign * all.products[c * all.simulated.len() + d] / if size > 0.0 { size } else { 1.0 };
            let aliased = (!self.compares(c)).then(|| self.fidelity[c]);
            let correlation = [all.correlation(c, c), follows(c)];
            ChannelFinding { correlation, gain, silent: self.silent[c], aliased }
        });
        let channels: Vec<ChannelFinding> = channels.collect();
        // A silent channel keeps its own signal.
        for c in 0..state.source.len() {
            if self.silent[c] {
                state.source[c] = (c, 1.0);
            }
        }
        let records = self.one_by_one(&state, simulated, &all);
        let units = self.places(&state, &all);
        let of = |record: usize| simulated[self.order(record, &state.panels)][record].clone();
        Explanation {
            stiffness: state.stiffness,
            correlation: [before, state.score],
            units,
            channels,
            records,
            simulated: (0..self.records.len()).map(of).collect(),
            dt: self.dt,
            panels: state.panels,
            lags: state.lags,
            source: state.source,
        }
    }

    fn one_by_one(&self, state: &State, simulated: &[Vec<History>], all: &ProductSums) -> Vec<RecordFinding> {
        let agreement = |record: usize, order: usize, lag: f64| {
            let found = self.moments(record, &simulated[order][record], lag)?;
            Some(found.agreement(all, &state.source, &self.silent))
        };
        let own: Vec<usize> = (0..self.records.len()).map(|r| self.order(r, &state.panels)).collect();
        let alone = |r: usize| agreement(r, own[r], state.lags[r]).unwrap_or(0.0);
        let follow: Vec<f64> = (0..self.records.len()).map(alone).collect();
        let usual = median(&follow);
        let of = |record: usize| {
            let (correlation, lag) = (follow[record], state.lags[record]);
            let near = (-24..=24).map(|n| lag + n as f64 / 8.0 * self.dt);
            let near = near.filter_map(|lag| Some((agreement(record, own[record], lag)?, lag)));
            let near = near.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(lag, |best| best.1);
            let mut told = RecordFinding { correlation, lag: near, panel: None, clock: None };
            if usual < GOOD || correlation > OUTLIER_BELOW.min(usual - OUTLIER_GAP) {
                return told;
            }
            let other = (0..self.orders.len()).filter(|order| *order != own[record]);
            let other = other.filter_map(|order| Some((order, agreement(record, order, lag)?)));
            let other = other.max_by(|a, b| a.1.total_cmp(&b.1));
            let clock = self.lags().filter_map(|lag| Some((lag, agreement(record, own[record], lag)?)));
            let clock = clock.max_by(|a, b| a.1.total_cmp(&b.1));
            let explains = |value: f64| value > correlation + RISE && value > GOOD.max(0.8 * usual);
            told.panel = other.filter(|(_, value)| explains(*value)).map(|(order, value)| {
                let order = &self.orders[order];
                let moved = |k: &usize| order[*k] != state.panels[*k];
                let panel = self.records[record].panel.or((0..order.len()).find(moved)).unwrap_or(0);
                (order[panel], value)
            });
            told.clock = clock.filter(|(_, value)| explains(*value) && told.panel.is_none());
            told
        };
        (0..self.records.len()).map(of).collect()
    }

    /// Better units for sensors that match poorly, or match only with changed axes.
    fn places(&self, state: &State, all: &ProductSums) -> Vec<Option<(usize, [f64; 2])>> {
        let (own, scene) = (self.model.channels.len(), self.model.scene);
        let place = |m: usize| {
            let compared = self.compared(m * own..(m + 1) * own);
            let mean = |of: &dyn Fn(usize) -> f64| (0..own).map(of).sum::<f64>() / compared;
            let as_said = mean(&|k| all.correlation(m * own + k, m * own + k));
            let explained = mean(&|k| {
                let (d, sign) = state.source[m * own + k];
                sign * all.correlation(m * own + k, d)
            });
            if as_said > GOOD || (m * own..(m + 1) * own).any(|c| self.silent[c]) {
                return None;
            }
            let free = (0..scene.layout.units())
                .filter(|u| !scene.clamped.contains(u) && !scene.sensors.contains(u));
            let moved = |unit: usize| {
                let mut sensors = scene.sensors.clone();
                sensors[m] = unit;
                let simulated = self.run(&state.panels, &sensors, state.stiffness);
                let sums = self.summed(&simulated, &|record| state.lags[record]);
                let at = |k: usize| {
                    if sums.measured.is_empty() { 0.0 } else { sums.correlation(m * own + k, m * own + k) }
                };
                (unit, mean(&at))
            };
            let best = free.map(moved).max_by(|a, b| a.1.total_cmp(&b.1))?;
            (best.1 > GOOD && best.1 > (as_said + RISE).max(explained + 0.25 * RISE))
                .then_some((best.0, [as_said, best.1]))
        };
        (0..scene.sensors.len()).map(place).collect()
    }
}

/// All permutations of 0 … count − 1.
fn permutations(count: usize) -> Vec<Vec<usize>> {
    if count == 0 {
        return vec![Vec::new()];
    }
    let mut all = Vec::new();
    for order in permutations(count - 1) {
        for place in 0..count {
            let mut next = order.clone();
            next.insert(place, count - 1);
            all.push(next);
        }
    }
    all.sort();
    all
}
