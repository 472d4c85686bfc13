//! Texts of findings: the fault, the measured values, and the key or option that corrects it.

use metasense_numerics::student::median;
use metasense_schemas::spec::ForceUnit;
use metasense_worker::invalid::as_written;
use metasense_worker::records::newtons;

use super::{Described, Looked};
use crate::measured::{AccelerationUnit, AngularVelocityUnit, SignalStart};
use crate::questions::check::{Explanation, RecordFinding};

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// Checked without a finding.
    Ok,
    /// Not checked: the records do not permit it.
    NotChecked,
    /// May affect results.
    Warning,
    /// Makes results wrong.
    Fault,
}

impl Severity {
    /// Name of the level.
    pub fn name(self) -> &'static str {
        ["ok", "not checked", "warning", "fault"][self as usize]
    }
}

/// One finding.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Name of the check.
    pub check: &'static str,
    /// Severity.
    pub level: Severity,
    /// Record and file, or channel and column; empty: all.
    pub place: String,
    /// The fault, with values.
    pub found: String,
    /// How to correct it.
    pub remedy: String,
}

/// Least ratio of the peak force to the noise of the force.
const BLOW: f64 = 8.0;
/// Ratio of the RMS before a blow to the RMS after it above which signals count as early.
const EARLY: f64 = 0.2;
/// Least offset that is reported: in standard deviations of the noise, and relative to the signal's RMS.
const OFFSET: [f64; 2] = [4.0, 0.1];
/// Least offset of a force that is reported, relative to the peak.
const RESTS: f64 = 0.02;
/// Gravity (mm/s²); least offset that is attributed to it, relative to it.
const GRAVITY: [f64; 2] = [9806.65, 0.5];
/// Least mean correlation of the model with the records.
const MODEL: f64 = 0.5;
/// Largest accepted clock error (readings): of all records together; of one record relative to the others.
const LATE: [f64; 2] = [1.0, 0.6];
/// Least reduction of Σ|ln gain| by which other units count as right, and largest |ln gain| that is then accepted.
const UNIT: f64 = 1.4;
const SCALE: f64 = 1.6;
/// Least rise of the agreement for other units.
const AGREES: f64 = 0.1;
/// Largest accepted ratio of a channel's gain to the median gain of its kind.
const OWN: f64 = 4.0;
/// Largest accepted deviation of a time step, relative to the mean step.
const JITTER: f64 = 0.25;

/// Remedy for a channel without signal.
const CABLE: &str =
    "check the cable and the column in signals.channels, or leave the channel out with sensors.channels";

struct Findings<'a> {
    all: Vec<Finding>,
    described: &'a Described,
    channels: &'a [String],
    looked: &'a [Looked],
}

/// All findings, in the order of the checks. A check without findings adds one of level `Ok` or `NotChecked`.
pub(super) fn findings(
    described: &Described,
    channels: &[String],
    looked: &[Looked],
    found: Option<&Explanation>,
    read: &[usize],
) -> Vec<Finding> {
    let mut of = Findings { all: Vec::new(), described, channels, looked };
    of.files();
    of.blows();
    of.ranges();
    let units = found.map_or(1.0, |found| of.scale(found, read));
    let unknown = of.offsets(read, units);
    of.early();
    match found {
        Some(found) => of.model(found, read),
        None if !looked.is_empty() => {
            let what = "the model cannot be simulated under these forces";
            of.fault("model", ["", what, "check recorded.force_unit and recorded.scale"]);
        }
        None => {}
    }
    let is_compared = |c: usize| found.is_some_and(|found| found.channels[c].is_compared());
    let omitted = (0..channels.len()).filter(|c| !is_compared(*c)).map(|c| &*channels[c]);
    let omitted = omitted.collect::<Vec<_>>();
    let (compared, names) = (omitted.len() < channels.len(), omitted.join(", "));
    let without = if omitted.is_empty() { String::new() } else { format!("without {names}") };
    for check in
        ["file", "blow", "range", "offset", "unit", "clock", "panel", "axis", "sensor", "channel", "model"]
    {
        if of.all.iter().any(|finding| finding.check == check) {
            continue;
        }
        let unchecked = |place: &str, what: &str, remedy: &str| {
            (Severity::NotChecked, [place, what, remedy].map(str::to_owned))
        };
        let ok = |what: String| (Severity::Ok, [String::new(), what, String::new()]);
        let (level, texts) = match (check, found) {
            ("file", _) => ok(String::new()),
            _ if looked.is_empty() => unchecked("", "no record is readable", "correct the files"),
            ("blow" | "range", _) => ok(String::new()),
            ("offset", _) if unknown.is_empty() => ok(String::new()),
            ("offset", _) => {
                let what = format!("too few entries before the blows: {}", unknown.join(" and "));
                unchecked("", &what, "record at least five readings at rest before each blow")
            }
            (_, Some(found)) if compared => {
                let [_, after] = found.correlation;
                match check {
                    "channel" => ok(without.clone()),
                    "model" => ok(format!(
                        "mean correlation {after:.2} with a model of {} times the design's stiffness",
                        found.stiffness
                    )),
                    _ if after < MODEL => {
                        let what = format!("mean correlation {after:.2} with the model");
                        unchecked("", &what, "correct what the check of the model reports, then repeat")
                    }
                    _ => ok(without.clone()),
                }
            }
            _ => unchecked(&names, "not compared with the model", "correct the other findings first"),
        };
        of.add(check, level, texts.each_ref().map(String::as_str));
    }
    of.all
}

impl Findings<'_> {
    fn add(&mut self, check: &'static str, level: Severity, texts: [&str; 3]) {
        let [place, found, remedy] = texts.map(str::to_owned);
        self.all.push(Finding { check, level, place, found, remedy });
    }

    /// Adds a fault: its place, its values, and the remedy.
    fn fault(&mut self, check: &'static str, texts: [&str; 3]) {
        self.add(check, Severity::Fault, texts);
    }

    fn place(&self, i: usize) -> String {
        let Looked { number, place, .. } = &self.looked[i];
        format!("record {number} ({place})")
    }

    /// Numbers of the first eight records.
    fn list(&self, records: &[usize]) -> String {
        let numbers: Vec<String> =
            records.iter().take(8).map(|i| self.looked[*i].number.to_string()).collect();
        let more = if records.len() > 8 { ", …" } else { "" };
        format!("record{} {}{more}", if records.len() == 1 { "" } else { "s" }, numbers.join(", "))
    }

    fn files(&mut self) {
        for (number, record) in &self.described.records {
            if let Err(what) = record {
                let place = number.map_or(String::new(), |number| format!("record {number}"));
                let remedy = "correct the file, or leave the record out";
                self.fault("file", [&place, what, remedy]);
            }
        }
        let uneven: Vec<usize> = (0..self.looked.len()).filter(|i| self.looked[*i].jitter > JITTER).collect();
        if let Some(first) = uneven.first() {
            let (place, most) = (self.list(&uneven), 100.0 * self.looked[*first].jitter);
            let found = format!(
                "steps of the clock differ from their mean by up to {most:.0} %; the record is interpolated"
            );
            let remedy = "if the instrument's steps are even, set signals.rate in place of signals.time";
            self.add("file", Severity::Warning, [&place, &found, remedy]);
        }
    }

    fn blows(&mut self) {
        for i in 0..self.looked.len() {
            let of = &self.looked[i].instruments;
            let (peak, blows) = (of.peak, of.blows);
            if peak == 0.0 {
                let remedy = "check recorded.force, or leave the record out";
                self.fault("blow", [&self.place(i), "the force is 0 throughout", remedy]);
            } else if let Some(noise) = of.force_noise.filter(|noise| peak < BLOW * noise) {
                let found = format!(
                    "largest force {peak:.3} N, noise {noise:.3} N: the record contains no clear blow"
                );
                self.fault("blow", [&self.place(i), &found, "leave the record out, or strike harder"]);
            } else if blows > 1 {
                let found = format!("{blows} blows");
                let remedy =
                    "leave the record out, or cut it before the second blow (metasense.records: length)";
                self.add("blow", Severity::Warning, [&self.place(i), &found, remedy]);
            }
        }
    }

    fn ranges(&mut self) {
        for (kind, what) in [(0, "the force"), (1, "readings")] {
            let columns = self.looked.first().map_or(0, |looked| looked.clipped[kind].len());
            for c in 0..columns {
                let count = |i: &usize| self.looked[*i].clipped[kind].get(c).copied().unwrap_or(0);
                let records: Vec<usize> = (0..self.looked.len()).filter(|i| count(i) > 0).collect();
                if records.is_empty() {
                    continue;
                }
                let (sum, list) = (records.iter().map(count).sum::<usize>(), self.list(&records));
                let place = if kind == 0 { format!("force {c}") } else { self.channels[c].clone() };
                let found = format!("{sum} entries of {what} are clipped at the end of the range, in {list}");
                let remedy = "raise the range of the instrument, or strike more softly";
                self.fault("range", [&place, &found, remedy]);
            }
        }
        for c in 0..self.channels.len() {
            let still = |looked: &Looked| {
                let y = &looked.record.signals.values[c];
                y.iter().all(|x| (x - y[0]).abs() <= 1e-12 * y[0].abs())
            };
            if !self.looked.is_empty() && self.looked.iter().all(still) {
                let found = "has a constant value; the channel is probably not connected";
                self.fault("channel", [&self.channels[c], found, CABLE]);
            }
        }
    }

    /// Reports units that would fit the amplitudes better. Returns the factor for accelerations.
    fn scale(&mut self, found: &Explanation, read: &[usize]) -> f64 {
        let kind = |c: usize| usize::from(read[c % read.len()] == 2);
        let gain = |of: usize| {
            let channels =
                (0..self.channels.len()).filter(|c| kind(*c) == of && found.channels[*c].is_compared());
            let gains: Vec<f64> =
                channels.map(|c| found.channels[c].gain.abs()).filter(|g| *g > 0.0).collect();
            (!gains.is_empty()).then(|| median(&gains))
        };
        let gains = [gain(0), gain(1)];
        let (recorded, signals) = (&self.described.spec.recorded, &self.described.spec.signals);
        let (force, acceleration, turning) =
            (recorded.force_unit, signals.acceleration_unit, signals.angular_velocity_unit);
        let cost = |gains: [Option<f64>; 2]| gains.iter().flatten().map(|g| g.ln().abs()).sum::<f64>();
        let mut best = (cost(gains) - UNIT, None, [1.0, 1.0]);
        for f in [ForceUnit::Newton, ForceUnit::Millinewton, ForceUnit::Kilonewton] {
            for a in [AccelerationUnit::Millimetre, AccelerationUnit::Metre, AccelerationUnit::Gravity] {
                for t in [AngularVelocityUnit::Radian, AngularVelocityUnit::Degree] {
                    let by = newtons(force) / newtons(f);
                    let factors =
                        [by * a.factor() / acceleration.factor(), by * t.factor() / turning.factor()];
                    let new = [0, 1].map(|k| gains[k].map(|g| g * factors[k]));
                    let count =
                        usize::from(f != force) + usize::from(a != acceleration) + usize::from(t != turning);
                    let value = cost(new) + 0.5 * count.saturating_sub(1) as f64;
                    if count > 0 && value < best.0 {
                        best = (value, Some((f, a, t)), factors);
                    }
                }
            }
        }
        let (_, units, mut factors) = best;
        // Lin's concordance: the correlation, reduced by a difference in amplitude.
        let agreement = |k: usize, by: f64| {
            let of = found.channels.iter().enumerate().filter(|(c, of)| kind(*c) == k && of.is_compared());
            let of = of.map(|(_, of)| {
                let rho = of.correlation[1];
                let ratio = by * of.gain.abs() / rho.max(0.05);
                2.0 * rho * ratio / (1.0 + ratio * ratio)
            });
            let all: Vec<f64> = of.collect();
            all.iter().sum::<f64>() / all.len().max(1) as f64
        };
        if let Some((f, a, t)) = units {
            let mut explains = false;
            let mut say = |changed: bool, key: &str, value: String, kinds: &[usize]| {
                let mean = |by: [f64; 2]| {
                    let known = kinds.iter().filter(|k| gains[**k].is_some()).map(|k| agreement(*k, by[*k]));
                    let known: Vec<f64> = known.collect();
                    known.iter().sum::<f64>() / known.len().max(1) as f64
                };
                let [before, after] = [[1.0; 2], factors].map(mean);
                if changed && after > before + AGREES {
                    let text = format!("{key} = {value} raises the agreement from {before:.2} to {after:.2}");
                    self.fault("unit", ["", &text, &format!("set {key} = {value}")]);
                    explains = true;
                }
            };
            say(f != force, "recorded.force_unit", as_written(&f), &[0, 1]);
            say(a != acceleration, "signals.acceleration_unit", as_written(&a), &[0]);
            say(t != turning, "signals.angular_velocity_unit", as_written(&t), &[1]);
            if !explains {
                factors = [1.0; 2];
            }
        }
        let after = [0, 1].map(|k| gains[k].map(|g| g * factors[k]));
        for (k, what) in ["accelerations", "rotation rates"].into_iter().enumerate() {
            if let Some(g) = after[k].filter(|g| g.ln().abs() > SCALE && found.correlation[1] > MODEL) {
                let text = format!("{what} are {} times those of the model", significant(g));
                let remedy = "check recorded.scale, signals.factors, the units, and body.density and the chip properties of the spec";
                self.fault("unit", ["", &text, remedy]);
            }
        }
        for (c, of) in
            found.channels.iter().enumerate().filter(|(_, of)| of.is_compared() && of.correlation[1] > MODEL)
        {
            let Some(usual) = gains[kind(c)] else { continue };
            let ratio = of.gain.abs() / usual;
            if !(1.0 / OWN..=OWN).contains(&ratio) {
                let text = format!(
                    "amplitude relative to the model is {} times that of the other channels",
                    significant(ratio)
                );
                let remedy = format!("set signals.factors, {} for this channel", significant(1.0 / ratio));
                self.fault("unit", [&self.channels[c], &text, &remedy]);
            }
        }
        factors[0]
    }

    /// Reports offsets of forces and channels before the blows. Returns those that too few entries leave unknown.
    fn offsets(&mut self, read: &[usize], units: f64) -> Vec<&'static str> {
        let mut unknown = Vec::new();
        let of = self.looked.iter().map(|looked| &looked.instruments);
        let rests: Vec<(&Vec<[f64; 2]>, f64)> =
            of.filter_map(|of| of.rest.as_ref().map(|rest| (rest, of.peak))).collect();
        let forces = rests.iter().map(|(rest, _)| rest.len()).min().unwrap_or(0);
        if !self.described.spec.recorded.remove_offset {
            unknown.extend((forces == 0).then_some("the force"));
            for k in 0..forces {
                let all: Vec<[f64; 3]> =
                    rests.iter().map(|(rest, peak)| [rest[k][0], rest[k][1], *peak]).collect();
                let middle = |i: usize| median(&all.iter().map(|of| of[i]).collect::<Vec<_>>());
                let [level, noise, peak] = [0, 1, 2].map(middle);
                if level.abs() > (OFFSET[0] * noise).max(RESTS * peak) {
                    let found = format!(
                        "reads {} N before the blows, {:.0} % of the peak",
                        significant(level),
                        100.0 * level.abs() / peak
                    );
                    let remedy = "set recorded.remove_offset = true";
                    self.fault("offset", [&format!("force {k}"), &found, remedy]);
                }
            }
        }
        let quiet = |c: usize| -> Vec<[f64; 3]> {
            let of = self.looked.iter().map(|looked| &looked.instruments);
            of.filter_map(|of| of.quiet.as_ref().map(|quiet| [quiet[c][0], quiet[c][1], of.size[c]]))
                .collect()
        };
        for c in 0..self.channels.len() {
            let all = quiet(c);
            if all.len() * 2 <= self.looked.len() {
                unknown.push("the signals");
                break;
            }
            let middle = |i: usize| median(&all.iter().map(|of| of[i]).collect::<Vec<_>>());
            let [offset, noise, size] = [0, 1, 2].map(middle);
            if offset.abs() <= (OFFSET[0] * noise).max(OFFSET[1] * size) {
                continue;
            }
            let turning = read[c % read.len()] == 2;
            let gravity = offset.abs() * units / GRAVITY[0];
            let what = match turning {
                false if (GRAVITY[1]..1.1).contains(&gravity) => "contains gravity: ",
                _ => "",
            };
            let unit = if turning { "rad/s" } else { "mm/s²" };
            let found = format!(
                "{what}reads {} {unit} before the blows, {:.0} % of its RMS after them",
                significant(offset),
                100.0 * (offset / size).abs()
            );
            self.fault("offset", [&self.channels[c], &found, "set recorded.remove_offset = true"]);
        }
        unknown
    }

    /// Reports signals that move before the force.
    fn early(&mut self) {
        let part = |looked: &Looked| {
            let of = &looked.instruments;
            let parts = of
                .quiet
                .iter()
                .flatten()
                .zip(&of.size)
                .map(|(quiet, size)| quiet[1] / size.max(f64::MIN_POSITIVE));
            let mut parts: Vec<f64> = parts.collect();
            parts.sort_by(f64::total_cmp);
            parts.get(parts.len() / 2).copied().unwrap_or(0.0)
        };
        let early: Vec<usize> = (0..self.looked.len()).filter(|i| part(&self.looked[*i]) > EARLY).collect();
        let Some(first) = early.first() else { return };
        let (place, part) = (self.list(&early), 100.0 * part(&self.looked[*first]));
        let found = format!("signals move before the force: {part:.0} % of their RMS after it");
        let remedy = "correct signals.start; or let the body come to rest before each blow";
        self.fault("clock", [&place, &found, remedy]);
    }

    fn model(&mut self, found: &Explanation, read: &[usize]) {
        let aliased = |c: &usize| found.channels[*c].aliased.is_some();
        let aliased: Vec<usize> = (0..self.channels.len()).filter(aliased).collect();
        if !aliased.is_empty() {
            let place: Vec<&str> = aliased.iter().map(|c| &*self.channels[*c]).collect();
            let least = aliased.iter().filter_map(|c| found.channels[*c].aliased).fold(1.0, f64::min);
            let text = format!(
                "the chip samples too slowly for the body's modes: smoothed readings of the model correlate with its motion by \
                 {least:.2}; not compared with the model"
            );
            let remedy = "to compare these signals, raise the rate of the chip; a fit needs no higher rate";
            self.add("channel", Severity::Warning, [&place.join(", "), &text, remedy]);
        }
        if aliased.len() == self.channels.len() {
            return;
        }
        let [before, after] = found.correlation;
        let raises =
            |what: String| format!("{what}: raises the mean correlation from {before:.2} to {after:.2}");
        if found.panels.iter().enumerate().any(|(k, panel)| k != *panel) {
            let pairs = found.panels.iter().enumerate().filter(|(k, panel)| k != *panel);
            let pairs: Vec<String> =
                pairs.map(|(k, panel)| format!("the records of panel {k} fit panel {panel}")).collect();
            let remedy = match &self.described.spec.recorded.panels {
                Some(given) => format!(
                    "set recorded.panels = {:?}",
                    given.iter().map(|k| found.panels[*k]).collect::<Vec<_>>()
                ),
                None => "exchange the columns in recorded.force".into(),
            };
            self.fault("panel", ["", &raises(pairs.join(", ")), &remedy]);
        }
        self.clocks(found);
        self.axes(found, read);
        for (i, of) in found.records.iter().enumerate() {
            let RecordFinding { correlation, panel, clock, .. } = of;
            if let Some((panel, then)) = panel {
                let said = format!("the record fits panel {panel}: correlation {correlation:.2} → {then:.2}");
                let remedy = format!("set this record's entry of recorded.panels to {panel}");
                self.fault("panel", [&self.place(i), &said, &remedy]);
            } else if let Some((lag, then)) = clock {
                let said = format!(
                    "its signals seem to be {} s {}: correlation {correlation:.2} → {then:.2}",
                    significant(lag.abs()),
                    late(*lag)
                );
                let remedy =
                    format!("set this record's entry of signals.start to {:.4}", self.start(i) + lag);
                self.fault("clock", [&self.place(i), &said, &remedy]);
            }
        }
        if after < MODEL {
            let text =
                format!("mean correlation {after:.2} with the model; none of the tested faults explains it");
            let remedy = "check design, panels, sensors.units, signals.channels and signals.start";
            self.fault("model", ["", &text, remedy]);
        }
    }

    fn start(&self, i: usize) -> f64 {
        let number = self.looked[i].number;
        self.described.spec.signals.start.as_ref().map_or(0.0, |start| start.time_of(number))
    }

    fn clocks(&mut self, found: &Explanation) {
        let [before, after] = found.correlation;
        if after < MODEL {
            return;
        }
        let readings = |seconds: f64, i: usize| seconds / self.looked[i].record.signals.dt;
        let declared = 3.0 * self.described.spec.signals.start_deviation.unwrap_or(0.0);
        let follows = |i: &usize| found.records[*i].correlation > MODEL && found.records[*i].clock.is_none();
        let counted: Vec<usize> = (0..found.records.len()).filter(follows).collect();
        let mut lags: Vec<f64> = counted.iter().map(|i| found.records[*i].lag).collect();
        lags.sort_by(f64::total_cmp);
        let Some(&middle) = lags.get(lags.len() / 2) else { return };
        let dt = found.dt;
        let apart = |i: &&usize| (found.records[**i].lag - middle).abs() > (LATE[1] * dt).max(2.0 * declared);
        let off: Vec<usize> = counted.iter().filter(apart).copied().collect();
        let deviation = "or set signals.start_deviation, with which `metasense lab identify` fits them";
        if !off.is_empty() {
            let worst =
                off.iter().map(|i| readings((found.records[*i].lag - middle).abs(), *i)).fold(0.0, f64::max);
            let starts =
                (0..found.records.len()).map(|i| format!("{:.4}", self.start(i) + found.records[i].lag));
            let starts = starts.collect::<Vec<_>>().join(", ");
            let text = format!("clocks of records differ by up to {worst:.1} readings: {}", self.list(&off));
            self.fault("clock", ["", &text, &format!("set signals.start = [{starts}], {deviation}")]);
        } else if middle.abs() > (LATE[0] * dt).max(declared) {
            let change = if after - before > 0.02 {
                format!(": raises the mean correlation from {before:.2} to {after:.2}")
            } else {
                String::new()
            };
            let text = format!("signals seem to be {} s {}{change}", significant(middle.abs()), late(middle));
            let starts: Vec<f64> = (0..found.records.len()).map(|i| self.start(i) + middle).collect();
            let value = match &self.described.spec.signals.start {
                Some(SignalStart::Each(_)) => format!("{starts:.4?}"),
                _ => format!("{:.4}", starts[0]),
            };
            self.fault("clock", ["", &text, &format!("set signals.start = {value}")]);
        }
    }

    fn axes(&mut self, found: &Explanation, read: &[usize]) {
        let own = read.len();
        let live: Vec<usize> =
            (0..self.channels.len()).filter(|c| found.channels[*c].is_compared()).collect();
        if !live.is_empty() && live.iter().all(|c| found.source[*c] == (*c, -1.0)) {
            let [before, after] = found.correlation;
            let text = format!(
                "the force has the opposite sign: raises the mean correlation from {before:.2} to {after:.2}"
            );
            let scale = -self.described.spec.recorded.scale;
            self.fault("force", ["", &text, &format!("set recorded.scale = {scale}")]);
            return;
        }
        for (m, unit) in found.units.iter().enumerate() {
            let channels = m * own..(m + 1) * own;
            let mean = |i: usize| {
                let compared = channels.clone().filter(|c| found.channels[*c].aliased.is_none());
                let all: Vec<f64> = compared.map(|c| found.channels[c].correlation[i]).collect();
                all.iter().sum::<f64>() / all.len().max(1) as f64
            };
            let name = |c: usize| self.channels[c].split(" (").next().unwrap_or_default().to_owned();
            if let Some((unit, [before, after])) = unit {
                let text = format!(
                    "sensor {m} seems to be on unit {unit}: mean correlation {before:.2} → {after:.2}"
                );
                let remedy = format!("set unit {unit} in sensors.units of the spec, or move the chip");
                self.fault("sensor", ["", &text, &remedy]);
                continue;
            }
            let changed: Vec<usize> = channels.clone().filter(|c| found.source[*c] != (*c, 1.0)).collect();
            if changed.is_empty() {
                continue;
            }
            let sensor = found.source[changed[0]].0 / own;
            let whole = sensor != m && channels.clone().all(|c| found.source[c].0 == sensor * own + c % own);
            let (check, text, remedy) = if whole && changed.iter().all(|c| found.source[*c].1 > 0.0) {
                (
                    "sensor",
                    format!("the signals of sensor {m} fit sensor {sensor}"),
                    "exchange their columns in signals.channels (metasense.records: signals)".to_owned(),
                )
            } else {
                let like = |c: &usize| {
                    let (d, sign) = found.source[*c];
                    let other = if d == *c { "itself".to_owned() } else { name(d) };
                    format!("{} fits {}{other}", name(*c), if sign < 0.0 { "minus " } else { "" })
                };
                let moved = changed.iter().any(|c| found.source[*c].0 != *c);
                let turned = changed.iter().any(|c| found.source[*c].1 < 0.0);
                let mut mended = Vec::new();
                if moved {
                    mended.push("reorder signals.channels (metasense.records: signals)".to_owned());
                }
                if turned {
                    let given = self.described.spec.signals.factors.clone();
                    let mut factors = given.unwrap_or_else(|| vec![1.0; self.channels.len()]);
                    changed.iter().for_each(|c| factors[found.source[*c].0] *= found.source[*c].1);
                    mended.push(format!("set signals.factors = {factors:?}"));
                }
                ("axis", changed.iter().map(like).collect::<Vec<_>>().join(", "), mended.join(" and "))
            };
            let text = format!("{text}: mean correlation of the sensor {:.2} → {:.2}", mean(0), mean(1));
            self.fault(check, [&format!("sensor {m}"), &text, &remedy]);
        }
        for (c, of) in found.channels.iter().enumerate().filter(|(_, of)| of.silent) {
            if self.all.iter().any(|finding| finding.check == "channel" && finding.place == self.channels[c])
            {
                continue;
            }
            let text = format!(
                "does not follow the simulated motion: correlation {:.2}; other channels do",
                of.correlation[1]
            );
            self.fault("channel", [&self.channels[c], &text, CABLE]);
        }
    }
}

fn late(lag: f64) -> &'static str {
    if lag < 0.0 { "late" } else { "early" }
}

/// Formats three significant digits.
fn significant(value: f64) -> String {
    let digits = (2 - value.abs().max(f64::MIN_POSITIVE).log10().floor() as i32).clamp(0, 6) as usize;
    if value.abs() >= 1e5 || (value != 0.0 && value.abs() < 1e-3) {
        format!("{value:.1e}")
    } else {
        format!("{value:.digits$}")
    }
}
