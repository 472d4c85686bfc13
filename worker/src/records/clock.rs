//! Clocks of records: even, resampled to even, or rejected.

use metasense_schemas::spec::TimeUnit;

use super::{Pick, Record, median};

/// Largest deviation of a step from the mean step of an even clock, relative to it.
const UNEVEN: f64 = 0.02;
/// Largest distance of an entry from an even clock (steps): small deviations of equal sign accumulate.
const DRIFT: f64 = 0.1;
/// Largest number of entries of a resampled record.
const LONGEST: usize = 10_000_000;
/// A regular clock has at least this share of steps within this distance of a whole multiple of the median step, up to the largest
/// multiple; entries may be missing.
const REGULAR: [f64; 2] = [0.9, 0.1];
const LARGEST_MULTIPLE: f64 = 20.0;
/// Least length of a gap: in medians of all steps of a regular clock; of another clock in medians of the neighbouring steps, or
/// means of all, if these are longer: entries may come in bursts.
const GAP: [f64; 2] = [1.5, 6.0];
/// Neighbours on either side for the local median step of a clock that is not regular.
const AROUND: usize = 8;
/// Largest sum of two neighbouring steps (medians) for which a late entry, not a gap, explains the longer one.
const LATE: f64 = 2.5;

/// Least step of a resampled record, in mean steps: bursts of a radio or bus contain far shorter ones.
const FINEST: f64 = 0.25;

/// Combines a record with its clock; interpolates uneven clocks linearly onto even ones with their finest step, at least `FINEST`.
/// `place` gives an entry's location for messages.
///
/// # Errors
/// If times do not increase, entries are missing, or the clock is too uneven to resample.
pub(super) fn with_clock(
    pick: &Pick,
    clock: &[f64],
    place: &dyn Fn(usize) -> String,
    values: Vec<Vec<f64>>,
) -> Result<Record, String> {
    if let Some(history) = values.iter().find(|history| history.len() != clock.len()) {
        return Err(format!("has {} entries of {}, but {} times", history.len(), pick.key, clock.len()));
    }
    if clock.len() < 2 {
        return Err("must contain at least two entries".into());
    }
    let unit = match pick.unit {
        TimeUnit::Second => 1.0,
        TimeUnit::Millisecond => 1e-3,
        TimeUnit::Microsecond => 1e-6,
    };
    let steps = || clock.windows(2).map(|w| w[1] - w[0]);
    if let Some(n) = steps().position(|step| !(step > 0.0 && step.is_finite())) {
        let (before, after) = (clock[n], clock[n + 1]);
        return Err(format!("{} = {after} must be later than the entry before, at {before}", place(n + 1)));
    }
    if let Some((n, usual)) = gap(&steps().collect::<Vec<_>>()) {
        let (length, step) = ((clock[n + 1] - clock[n]) * unit, usual * unit);
        return Err(format!(
            "{} = {} comes {length:.6} s after the entry before, but a step is {step:.6} s: entries are missing. Remove the record, \
             or cut it before the gap",
            place(n + 1),
            clock[n + 1]
        ));
    }
    let span = clock[clock.len() - 1] - clock[0];
    let mean = span / (clock.len() - 1) as f64;
    let start = clock[0] * unit;
    let off = steps().fold(0.0f64, |most, step| most.max((step - mean).abs()));
    let jitter = off / mean;
    let drift = |(n, t): (usize, &f64)| (t - clock[0] - n as f64 * mean).abs();
    if off <= UNEVEN * mean && clock.iter().enumerate().map(drift).all(|off| off <= DRIFT * mean) {
        return Ok(Record { start, dt: mean * unit, values, jitter });
    }
    let finest = steps().fold(f64::INFINITY, f64::min).max(FINEST * mean);
    let count = (span / finest).ceil();
    if count > LONGEST as f64 {
        return Err("time is uneven, and has too many entries: resample the record first".into());
    }
    let dt = span / count;
    let read = |history: &Vec<f64>| {
        let mut i = 0;
        let value = |n: usize| {
            let t = clock[0] + n as f64 * dt;
            while i + 2 < clock.len() && clock[i + 1] < t {
                i += 1;
            }
            let w = ((t - clock[i]) / (clock[i + 1] - clock[i])).clamp(0.0, 1.0);
            (1.0 - w) * history[i] + w * history[i + 1]
        };
        (0..=count as usize).map(value).collect()
    };
    Ok(Record { start, dt: dt * unit, values: values.iter().map(read).collect(), jitter })
}

/// The first step with missing entries, and the normal step there.
fn gap(steps: &[f64]) -> Option<(usize, f64)> {
    let (usual, mean) = (median(steps), steps.iter().sum::<f64>() / steps.len() as f64);
    let is_whole = |step: &&f64| {
        let medians = *step / usual;
        (1.0..=LARGEST_MULTIPLE).contains(&medians.round()) && (medians - medians.round()).abs() <= REGULAR[1]
    };
    let regular = steps.iter().filter(is_whole).count() as f64 >= REGULAR[0] * steps.len() as f64;
    let missing = |n: usize| {
        if regular {
            let beside = [n.checked_sub(1).and_then(|n| steps.get(n)), steps.get(n + 1)];
            let late = beside.into_iter().flatten().any(|other| steps[n] + other <= LATE * usual);
            return (steps[n] > GAP[0] * usual && !late).then_some((n, usual));
        }
        let around = median(&steps[n.saturating_sub(AROUND)..steps.len().min(n + AROUND + 1)]).max(mean);
        (steps[n] > GAP[1] * around).then_some((n, around))
    };
    (0..steps.len()).find_map(missing)
}
