//! Force histories and chip properties from the spec.

use metasense_numerics::brains::fits;
use metasense_numerics::dynamics::{AddedMass, Mount};
use metasense_numerics::stimuli::{Bell, Gauss, HistorySource, Irregular, StrikeScatter};
use metasense_numerics::trial::{ChipErrors, ForceSets, Size};
use metasense_schemas::spec::{self, StimuliKind, TrialSpec};

use super::body::{lengths, listed};
use super::{INSTANTS_MAX, SAMPLES_MAX};
use crate::invalid::{Invalid, absent, as_written, at_least, at_most, invalid, not_negative, require};
use crate::records;

/// Source of a trial's forces, and numbers of samples.
pub(super) fn stimuli(trial: &TrialSpec) -> Result<ForceSets, Invalid> {
    let mut stimuli = trial.stimuli.clone().resolved();
    if read_under(trial).any(|part| part.kind == StimuliKind::Recorded) && !has_records(&stimuli) {
        stimuli.recorded = None;
    }
    let &spec::Stimuli { samples, test, replacement, holdout, .. } = &stimuli;
    at_most("stimuli.samples", samples, SAMPLES_MAX)?;
    at_most("stimuli.holdout", holdout, SAMPLES_MAX)?;
    at_least("stimuli.test", test, 1)?;
    let remedy = format!("must be less than stimuli.samples = {samples}: the rest trains the decoder");
    require(test < samples, "stimuli.test", test, &remedy)?;
    at_least("stimuli.holdout", holdout, 1)?;
    let instants = force_instants(trial)?;
    Ok(ForceSets {
        source: source(trial, &stimuli, instants)?,
        instants,
        samples,
        test,
        replacement,
        holdout,
    })
}

/// The source of the forces.
fn source(trial: &TrialSpec, stimuli: &spec::Stimuli, instants: usize) -> Result<HistorySource, Invalid> {
    refuse_unread(stimuli)?;
    let source = match (stimuli.kind, &stimuli.recorded) {
        (StimuliKind::Bell, _) => HistorySource::Bell(bell(trial, stimuli)?),
        (StimuliKind::Gauss, _) => HistorySource::Gauss(gauss(trial, stimuli)?),
        (StimuliKind::Irregular, _) => HistorySource::Irregular(irregular(trial, stimuli)?),
        (StimuliKind::Recorded, Some(recorded)) => {
            HistorySource::Recorded(records::load_records(trial, recorded, instants)?)
        }
        (StimuliKind::Recorded, None) => {
            return Err(invalid("stimuli.recorded", "", "must be set: the files and their contents"));
        }
        (StimuliKind::Mix, _) => HistorySource::Mix(mix(trial, stimuli, instants)?),
    };
    let silent = stimuli.silent.unwrap_or_default();
    let remedy = "must lie between 0 and 0.99";
    require((0.0..=0.99).contains(&silent), "stimuli.silent", silent, remedy)?;
    let source = match (anywhere(trial, stimuli)?, silent > 0.0) {
        (true, _) => HistorySource::Anywhere(Box::new(source)),
        (_, true) => HistorySource::Silent(silent, Box::new(source)),
        _ => source,
    };
    Ok(match hand(trial, stimuli)? {
        Some(hand) => HistorySource::Struck(hand, Box::new(source)),
        None => source,
    })
}

/// Whether each sample has one blow at a random point between neighbouring panels.
fn anywhere(trial: &TrialSpec, stimuli: &spec::Stimuli) -> Result<bool, Invalid> {
    if stimuli.anywhere {
        let check = |holds: bool, remedy: &str| require(holds, "stimuli.anywhere", true, remedy);
        check(trial.point.panels > 1, "needs at least two panels (sweep.panels), between which blows act")?;
        let others = [stimuli.silent, stimuli.offset, stimuli.angle].map(Option::unwrap_or_default);
        check(others == [0.0; 3], "cannot be set together with silent, offset and angle")?;
        let is_push = |panel: &spec::Struck| panel.base.is_none() && panel.couple.is_none();
        let pushes = listed(&trial.body).1.iter().take(trial.point.panels).all(is_push);
        check(pushes, "needs panels on which forces act, without base and couple in body.panels")?;
    }
    Ok(stimuli.anywhere)
}

/// Standard deviations of the offset and angle of blows; `None` if both are 0.
fn hand(trial: &TrialSpec, stimuli: &spec::Stimuli) -> Result<Option<StrikeScatter>, Invalid> {
    let (offset, angle) = (stimuli.offset.unwrap_or_default(), stimuli.angle.unwrap_or_default());
    if (offset, angle) == (0.0, 0.0) {
        return Ok(None);
    }
    // two standard deviations then reach a corner
    let [spacing, length] = lengths(&trial.body)?;
    let most = 0.25 * (spacing - length);
    let remedy = format!(
        "must lie between 0 and {most} mm, a quarter of a unit's diagonal: blows with larger offsets would miss the unit"
    );
    require((0.0..=most).contains(&offset), "stimuli.offset", offset, &remedy)?;
    let remedy = "must lie between 0 and 30 degrees: with larger deviations, blows could pull";
    require((0.0..=30.0).contains(&angle), "stimuli.angle", angle, remedy)?;
    let struck = trial.body.panels.is_empty() || trial.body.panels.iter().any(|panel| panel.base.is_none());
    for (key, value) in [("stimuli.offset", offset), ("stimuli.angle", angle)] {
        let remedy = "has no effect: every entry of body.panels prescribes a motion (base)";
        require(struck || value == 0.0, key, value, remedy)?;
    }
    Ok((offset > 0.0 || angle > 0.0).then_some(StrikeScatter { offset, angle: angle.to_radians() }))
}

/// Tolerance of the sum of a mixture's weights.
const ROUNDING: f64 = 1e-6;

/// The parts of a mixture with their weights.
fn mix(
    trial: &TrialSpec,
    stimuli: &spec::Stimuli,
    instants: usize,
) -> Result<Vec<(f64, HistorySource)>, Invalid> {
    let (key, parts) = ("stimuli.mix", stimuli.mix.as_deref().unwrap_or_default());
    let kinds: Vec<StimuliKind> = parts.iter().map(|part| part.kind).collect();
    let kinds = as_written(&kinds);
    let remedy = "must be at least two tables [[stimuli.mix]], each with weight and kind";
    require(parts.len() > 1, key, &kinds, remedy)?;
    let flat = parts.iter().all(|part| part.kind != StimuliKind::Mix);
    require(flat, key, &kinds, "must not contain a mixture: list its parts with their weights")?;
    let weights: Option<Vec<f64>> = parts.iter().map(|part| part.weight).collect();
    let Some(weights) = weights else {
        return Err(invalid("stimuli.mix.weight", "", "must be set for each part"));
    };
    let records = parts.iter().filter(|part| part.kind == StimuliKind::Recorded).count();
    require(records < 2, key, &kinds, "must contain recorded only once: stimuli.recorded lists all records")?;
    let unread = stimuli.recorded.as_ref().filter(|_| records == 0).map(|_| "{ … }");
    absent("stimuli.recorded", unread, "has no effect: no part of stimuli.mix is recorded")?;
    let (shown, sum) = (format!("{weights:?}"), weights.iter().sum::<f64>());
    require(weights.iter().all(|w| *w > 0.0), "stimuli.mix.weight", &shown, "must be numbers above 0")?;
    let remedy = format!("must sum to 1, not to {sum}");
    require((sum - 1.0).abs() < ROUNDING, "stimuli.mix.weight", &shown, &remedy)?;
    let of = |(weight, part)| Ok((weight, source_of_part(trial, key, part, stimuli, instants)?));
    weights.into_iter().zip(parts).map(of).collect()
}

/// Forces of a single kind, from a table of `key`.
fn source_of_part(
    trial: &TrialSpec,
    key: &str,
    part: &spec::Part,
    stimuli: &spec::Stimuli,
    instants: usize,
) -> Result<HistorySource, Invalid> {
    source(trial, &part.alone(stimuli), instants).map_err(|e| match e.key.strip_prefix("stimuli.") {
        Some(own) if !own.starts_with("recorded") => Invalid { key: format!("{key}.{own}"), ..e },
        _ => e,
    })
}

/// Whether some of these forces are records.
fn has_records(stimuli: &spec::Stimuli) -> bool {
    let parts = stimuli.mix.iter().flatten().map(|part| part.kind);
    std::iter::once(stimuli.kind).chain(parts).any(|kind| kind == StimuliKind::Recorded)
}

/// Further kinds of forces under which bodies are evaluated.
fn read_under(trial: &TrialSpec) -> impl Iterator<Item = &spec::Part> {
    trial.evaluation.under.iter().flatten()
}

/// Their sources.
pub(super) fn under(trial: &TrialSpec) -> Result<Vec<HistorySource>, Invalid> {
    let (key, kinds) = ("evaluation.under", read_under(trial).map(|part| part.kind).collect::<Vec<_>>());
    let shown = as_written(&kinds);
    for (n, part) in read_under(trial).enumerate() {
        let sound = part.kind != StimuliKind::Mix && !kinds[..n].contains(&part.kind);
        require(sound, key, &shown, "must contain kinds other than mix, each once")?;
        absent("evaluation.under.weight", part.weight, "has no effect: leave it out")?;
    }
    let readable = fits(trial.time.samples, trial.signals());
    let remedy = "must be left out: a linear decoder of such long samples takes too long";
    require(kinds.is_empty() || readable, key, &shown, remedy)?;
    let instants = force_instants(trial)?;
    read_under(trial).map(|part| source_of_part(trial, key, part, &trial.stimuli, instants)).collect()
}

/// Number of instants of the forces' clock.
fn force_instants(trial: &TrialSpec) -> Result<usize, Invalid> {
    let own = trial.time.samples;
    let instants = trial.stimuli.force_samples.unwrap_or(own);
    let remedy = format!("must be a multiple of time.samples = {own}");
    let whole = own > 0 && instants >= own && instants.is_multiple_of(own);
    require(whole, "stimuli.force_samples", instants, &remedy)?;
    at_most("stimuli.force_samples", instants, 1_000_000)?;
    Ok(instants)
}

/// Rejects keys that the kind of stimuli does not use: otherwise identical trials would get different hashes.
fn refuse_unread(stimuli: &spec::Stimuli) -> Result<(), Invalid> {
    let shown = |interval: Option<[f64; 2]>| interval.map(|i| format!("{i:?}"));
    let pulse = [
        ("amplitude", shown(stimuli.amplitude)),
        ("width", shown(stimuli.width)),
        ("onset", shown(stimuli.onset)),
        ("peak", shown(stimuli.peak)),
        ("power", shown(stimuli.power)),
    ];
    let blow = [
        ("roughness", shown(stimuli.roughness)),
        ("double", stimuli.double.map(|p| p.to_string())),
        ("gap", shown(stimuli.gap)),
        ("rebound", shown(stimuli.rebound)),
    ];
    let hand = [("offset", stimuli.offset), ("angle", stimuli.angle)];
    let hand = hand.map(|(key, deviation)| (key, deviation.map(|d| d.to_string())));
    let files = [("recorded", stimuli.recorded.as_ref().map(|_| "{ … }".to_owned()))];
    let mix = [("mix", stimuli.mix.as_ref().map(|_| "[{ … }]".to_owned()))];
    let silent = ("silent", stimuli.silent.map(|p| p.to_string()));
    let anywhere = ("anywhere", stimuli.anywhere.then(|| "true".to_owned()));
    let unread: Vec<_> = match stimuli.kind {
        StimuliKind::Bell => blow.into_iter().chain(files).chain(mix).collect(),
        StimuliKind::Gauss => pulse.into_iter().skip(3).chain(blow).chain(files).chain(mix).collect(),
        StimuliKind::Irregular => files.into_iter().chain(mix).chain([silent]).collect(),
        StimuliKind::Recorded => pulse.into_iter().chain(blow).chain(mix).chain([silent, anywhere]).collect(),
        StimuliKind::Mix => pulse.into_iter().chain(blow).chain(hand).chain([silent, anywhere]).collect(),
    };
    let remedy = "has no effect on this stimuli.kind";
    unread.into_iter().try_for_each(|(key, given)| absent(&format!("stimuli.{key}"), given, remedy))
}

/// Checks an interval of finite numbers; `resolved` has set its default.
fn interval(
    key: &str,
    given: Option<[f64; 2]>,
    lowest: f64,
    highest: f64,
    remedy: &str,
) -> Result<[f64; 2], Invalid> {
    let [least, most] = given.unwrap_or_default();
    let (key, shown) = (format!("stimuli.{key}"), format!("[{least}, {most}]"));
    require(least.is_finite() && most.is_finite(), &key, &shown, "must be two finite numbers")?;
    require(least <= most, &key, &shown, "must be [least, most]")?;
    require(least >= lowest && most <= highest, &key, &shown, remedy)?;
    Ok([least, most])
}

fn bell(trial: &TrialSpec, stimuli: &spec::Stimuli) -> Result<Bell, Invalid> {
    let (above, any) = (f64::MIN_POSITIVE, f64::INFINITY);
    let bell = Bell {
        amplitude: interval("amplitude", stimuli.amplitude, -any, any, "")?,
        width: interval("width", stimuli.width, above, any, "must be above 0")?,
        onset: interval("onset", stimuli.onset, -any, any, "")?,
        peak: interval("peak", stimuli.peak, above, 1.0 - f64::EPSILON, "must lie between 0 and 1")?,
        power: interval("power", stimuli.power, above, any, "must be above 0")?,
    };
    let shown = format!("{:?}", bell.amplitude);
    let (duration, [first, last]) = (trial.time.duration, bell.onset);
    let remedy = format!("must begin before the sample ends, at time.duration = {duration} s");
    require(first < duration, "stimuli.onset", format!("[{first}, {last}]"), &remedy)?;
    let remedy = "must let the latest and widest pulse end after 0 s, the start of the sample";
    require(last + bell.width[1] > 0.0, "stimuli.onset", format!("[{first}, {last}]"), remedy)?;
    require(bell.amplitude != [0.0; 2], "stimuli.amplitude", shown, "must contain a value other than 0")?;
    Ok(bell)
}

fn gauss(trial: &TrialSpec, stimuli: &spec::Stimuli) -> Result<Gauss, Invalid> {
    let (above, any, duration) = (f64::MIN_POSITIVE, f64::INFINITY, trial.time.duration);
    let remedy = format!("must lie in the sample, between 0 and time.duration = {duration} s");
    let gauss = Gauss {
        amplitude: interval("amplitude", stimuli.amplitude, -any, any, "")?,
        sigma: interval("width", stimuli.width, above, any, "must be above 0")?,
        centre: interval("onset", stimuli.onset, 0.0, duration, &remedy)?,
    };
    let shown = format!("{:?}", gauss.amplitude);
    require(gauss.amplitude != [0.0; 2], "stimuli.amplitude", shown, "must contain a value other than 0")?;
    Ok(gauss)
}

fn irregular(trial: &TrialSpec, stimuli: &spec::Stimuli) -> Result<Irregular, Invalid> {
    let double = stimuli.double.unwrap_or_default();
    require((0.0..=1.0).contains(&double), "stimuli.double", double, "must lie between 0 and 1")?;
    let not_negative = |key, given| interval(key, given, 0.0, f64::INFINITY, "must not be negative");
    Ok(Irregular {
        bell: bell(trial, stimuli)?,
        roughness: not_negative("roughness", stimuli.roughness)?,
        double,
        gap: not_negative("gap", stimuli.gap)?,
        rebound: not_negative("rebound", stimuli.rebound)?,
    })
}

/// Channels that each sensor has.
pub(super) fn channels(sensors: &spec::Sensors) -> Result<Vec<usize>, Invalid> {
    let read = sensors.read();
    let remedy = "must name some of \"ax\", \"ay\", \"omega\", each once";
    let once = read.windows(2).all(|pair| pair[0] < pair[1]);
    require(once && !read.is_empty(), "sensors.channels", as_written(&read), remedy)?;
    Ok(read.iter().map(|&channel| channel as usize).collect())
}

/// Greatest mass of a chip (Mg); more is probably a wrong unit.
const CHIP_MAX: f64 = 1e-3;
/// Greatest moment of inertia of a chip (Mg mm²), and greatest coordinate of its offset (mm).
const INERTIA_MAX: f64 = 1.0;
const OFFSET_MAX: f64 = 1000.0;
/// Greatest cut-off of a chip's low-pass, in readings per second: its clock is then 64 times as fast as the readings.
const BANDWIDTH_MAX: f64 = 2.0;

/// Noise, filters and limits of the sensors' chips; `None` if there are none.
pub(super) fn disturbance(sensors: &spec::Sensors, time: &spec::Time) -> Result<Option<ChipErrors>, Invalid> {
    let ChipErrors { range: wide, noise: still, .. } = ChipErrors::NONE;
    let size = |key: &str, given: Option<spec::Disturbance>| -> Result<Size, Invalid> {
        let (values, size) = match given {
            None => return Ok(still),
            Some(spec::Disturbance::Relative(part)) => (vec![part], Size::Relative(part)),
            Some(spec::Disturbance::Physical(sizes)) => (sizes.to_vec(), Size::Physical(sizes)),
        };
        let sound = values.iter().all(|x| *x >= 0.0 && x.is_finite());
        let remedy = "must be at least 0: a fraction of the RMS, or [mm/s², rad/s]";
        require(sound, key, format!("{values:?}"), remedy)?;
        Ok(size)
    };
    let (noise, bias) = (size("sensors.noise", sensors.noise)?, size("sensors.bias", sensors.bias)?);
    let delay = sensors.delay.unwrap_or(0.0);
    let remedy = "must be at least 0 and less than time.duration (s)";
    require(delay >= 0.0 && delay < time.duration, "sensors.delay", delay, remedy)?;
    let bandwidth = sensors.bandwidth.unwrap_or(f64::INFINITY);
    let interval = time.duration / time.samples as f64;
    let most = BANDWIDTH_MAX / interval;
    let remedy = format!("must be above 0, and at most {most} Hz, twice the rate of the readings");
    let is_valid_bandwidth =
        bandwidth > 0.0 && bandwidth <= most * (1.0 + 1e-9) || bandwidth == f64::INFINITY;
    require(is_valid_bandwidth, "sensors.bandwidth", bandwidth, &remedy)?;
    let (range, resolution) = (sensors.range.unwrap_or(wide), sensors.resolution.unwrap_or_default());
    let remedy = "must be above 0: [mm/s², rad/s]";
    require(range.iter().all(|most| *most > 0.0), "sensors.range", format!("{range:?}"), remedy)?;
    let remedy = "must be at least 0 and less than sensors.range: [mm/s², rad/s]";
    let fine = resolution.iter().zip(range).all(|(step, most)| (0.0..most).contains(step));
    require(fine, "sensors.resolution", format!("{resolution:?}"), remedy)?;
    let disturbance = ChipErrors { noise, bias, delay, bandwidth, range, resolution };
    let clock = disturbance.clock(interval);
    let of_delay =
        delay > 0.0 && ChipErrors { bandwidth: f64::INFINITY, ..disturbance }.clock(interval) == clock;
    let (key, value) = if of_delay { ("sensors.delay", delay) } else { ("sensors.bandwidth", bandwidth) };
    let most = INSTANTS_MAX / clock;
    let remedy =
        format!("needs {clock} instants of motion per reading, so that time.samples must be at most {most}");
    require(time.samples * clock <= INSTANTS_MAX, key, value, &remedy)?;
    Ok((disturbance != ChipErrors::NONE).then_some(disturbance))
}

/// Mass and moment of inertia that a chip adds to its unit.
pub(super) fn inertia(sensors: &spec::Sensors) -> Result<Option<AddedMass>, Invalid> {
    let [mass, moment] = [sensors.mass, sensors.inertia].map(Option::unwrap_or_default);
    not_negative("sensors.mass", mass)?;
    require(mass <= CHIP_MAX, "sensors.mass", mass, "must be at most 1e-3 Mg (1 kg); 9 g = 9e-6 Mg")?;
    not_negative("sensors.inertia", moment)?;
    let remedy = "must be at most 1 Mg mm²; 9 g on 23.5 × 32.5 mm = 1.2e-3 Mg mm²";
    require(moment <= INERTIA_MAX, "sensors.inertia", moment, remedy)?;
    Ok((mass > 0.0 || moment > 0.0).then_some(AddedMass { mass, moment }))
}

/// Offset and tilt of a chip on its unit.
pub(super) fn mount(sensors: &spec::Sensors) -> Result<Option<Mount>, Invalid> {
    let (offset, tilt) = (sensors.offset.unwrap_or_default(), sensors.tilt.unwrap_or_default());
    let shown = format!("{offset:?}");
    let sound = offset.iter().all(|r| r.abs() <= OFFSET_MAX);
    require(sound, "sensors.offset", &shown, "must be two numbers from -1000 to 1000 mm")?;
    require((-360.0..=360.0).contains(&tilt), "sensors.tilt", tilt, "must lie between -360 and 360 degrees")?;
    let weighs = sensors.mass.unwrap_or_default() > 0.0 || sensors.inertia.unwrap_or_default() > 0.0;
    let off = offset != [0.0; 2];
    let remedy = "cannot be set together with sensors.mass or sensors.inertia, which act at the centroid";
    require(!(off && weighs), "sensors.offset", &shown, remedy)?;
    Ok((off || tilt != 0.0).then_some(Mount { offset, tilt: tilt.to_radians() }))
}
