//! Checkpoints of former versions.

use serde::Deserialize;

use super::{Best, Checkpoint, CheckpointError, Comparison, Moments, Training, Waypoint, read, take};
use crate::record::{Band, BodyEvaluation, CastReading, Counters, NetworkEvaluation, Reading, Seconds};

/// Version 3, and the beginnings of it that were versions 1 (up to `protocol`) and 2 (up to `moves`).
#[derive(Deserialize)]
struct ByProtocol {
    step: u32,
    design: Vec<f64>,
    design_moments: Moments<f64>,
    weights: Vec<f32>,
    weight_moments: Moments<f32>,
    best: Option<Best>,
    /// Caution, setbacks, trend (0: none), the ridge where there is one, then step and α of each waypoint.
    protocol: Vec<f64>,
    comparison: Option<FormerComparison>,
    moves: Vec<(u32, Vec<usize>)>,
    found: Vec<f64>,
}

impl From<ByProtocol> for Checkpoint {
    fn from(former: ByProtocol) -> Self {
        let ByProtocol { step, design, design_moments, weights, weight_moments, best, .. } = former;
        let ByProtocol { protocol, comparison, moves, found, .. } = former;
        let waypoint = 1 + design.len();
        let number = |i: usize| protocol.get(i).copied().unwrap_or(0.0);
        // One number beside whole waypoints is the ridge.
        let has_ridge = protocol.len() > 3 && (protocol.len() - 3) % waypoint == 1;
        let trail = protocol.get(3 + usize::from(has_ridge)..).unwrap_or_default().chunks(waypoint);
        let trail = trail.map(|w| Waypoint { step: w[0] as u32, design: w[1..].to_vec() }).collect();
        Self {
            caution: number(0),
            setbacks: number(1) as u32,
            trend: Some(number(2)).filter(|trend| *trend > 0.0),
            ridge: has_ridge.then(|| number(3)),
            step,
            design,
            design_moments,
            weights,
            weight_moments,
            best,
            trail,
            comparison: comparison.map(|former| Box::new(former.into())),
            moves,
            found,
            casts: Vec::new(),
            bands: Vec::new(),
        }
    }
}

/// Of versions 1 to 3. What came later is empty: a length of 0.
pub(super) fn by_protocol(version: u8, bytes: &[u8]) -> Result<Checkpoint, CheckpointError> {
    let lacking = [0; 3];
    let lacking = match version {
        1 => &lacking[..],
        2 => &lacking[..1],
        _ => &[],
    };
    read::<ByProtocol>(&[bytes, lacking].concat()).map(Checkpoint::from)
}

/// Of versions 4 to 7: 4 ends before the casts, 5 before the bands. Fields are read in the order in which they are written here.
pub(super) fn by_name(version: u8, mut bytes: &[u8]) -> Result<Checkpoint, CheckpointError> {
    let rest = &mut bytes;
    let found = Checkpoint {
        step: take(rest)?,
        design: take(rest)?,
        design_moments: take(rest)?,
        weights: take(rest)?,
        weight_moments: take(rest)?,
        best: take(rest)?,
        caution: take(rest)?,
        setbacks: take(rest)?,
        trend: take(rest)?,
        ridge: take(rest)?,
        trail: take(rest)?,
        comparison: take::<Option<FormerComparison>>(rest)?.map(|former| Box::new(former.into())),
        moves: take(rest)?,
        found: take(rest)?,
        casts: if version > 4 { all(take::<Vec<Vec<FormerCast>>>(rest)?) } else { Vec::new() },
        bands: match version {
            7 => take(rest)?,
            6 => all(take::<Vec<Vec<FormerBand>>>(rest)?),
            _ => Vec::new(),
        },
    };
    // nothing is left
    read::<()>(rest)?;
    Ok(found)
}

/// Of each body.
fn all<F, T: From<F>>(former: Vec<Vec<F>>) -> Vec<Vec<T>> {
    former.into_iter().map(many).collect()
}

fn many<F, T: From<F>>(former: Vec<F>) -> Vec<T> {
    former.into_iter().map(T::from).collect()
}

/// A comparison until version 7.
#[derive(Deserialize)]
struct FormerComparison {
    bodies: Vec<FormerBody>,
    training: Option<Training>,
    counters: Counters,
    seconds: Seconds,
}

impl From<FormerComparison> for Comparison {
    fn from(former: FormerComparison) -> Self {
        let FormerComparison { bodies, training, counters, seconds } = former;
        Self { bodies: many(bodies), training, counters, seconds }
    }
}

/// A body until version 7.
#[derive(Deserialize)]
struct FormerBody {
    design: Vec<f64>,
    networks: Vec<FormerNetwork>,
    long: Vec<FormerNetwork>,
    readings: Vec<FormerReading>,
    zero_samples: [u32; 3],
}

impl From<FormerBody> for BodyEvaluation {
    fn from(former: FormerBody) -> Self {
        let FormerBody { design, networks, long, readings, zero_samples } = former;
        Self { design, networks: many(networks), long: many(long), readings: many(readings), zero_samples }
    }
}

/// A network until version 7: without the spread of its errors.
#[derive(Deserialize)]
struct FormerNetwork {
    error_train: Option<f64>,
    error_test: Option<f64>,
    error_holdout: Option<f64>,
    losses: Vec<f32>,
    errors: Vec<(u32, f64)>,
    weights: Vec<f32>,
    outcome: String,
}

impl From<FormerNetwork> for NetworkEvaluation {
    fn from(former: FormerNetwork) -> Self {
        let FormerNetwork { error_train, error_test, error_holdout, losses, errors, weights, outcome } =
            former;
        Self { error_train, error_test, error_holdout, losses, errors, weights, outcome, spread: None }
    }
}

/// A reading until version 7: likewise.
#[derive(Deserialize)]
struct FormerReading {
    before: u32,
    after: u32,
    ridge: f64,
    error_train: Option<f64>,
    error_test: Option<f64>,
    error_holdout: Option<f64>,
}

impl From<FormerReading> for Reading {
    fn from(former: FormerReading) -> Self {
        let FormerReading { before, after, ridge, error_train, error_test, error_holdout } = former;
        Self { before, after, ridge, error_train, error_test, error_holdout, spread: None }
    }
}

/// A cast until version 7: likewise, and without λ and κ.
#[derive(Deserialize)]
struct FormerCast {
    cast: u32,
    reader: String,
    records: u32,
    error: Option<f64>,
    outcome: String,
}

impl From<FormerCast> for CastReading {
    fn from(former: FormerCast) -> Self {
        let FormerCast { cast, reader, records, error, outcome } = former;
        Self { cast, reader, records, error, outcome, spread: None, ridge: None, share: None }
    }
}

/// A band until version 6: without the records that its brain was made from; of twins that of 30 alone was kept.
#[derive(Deserialize)]
struct FormerBand {
    reader: String,
    cast: Option<u32>,
    method: String,
    kind: String,
    level: f64,
    samples: u32,
    coverage: Option<f64>,
    width: Option<f64>,
    half_width: Vec<f64>,
    outcome: String,
}

impl From<FormerBand> for Band {
    fn from(former: FormerBand) -> Self {
        let FormerBand { reader, cast, method, kind, level, samples, .. } = former;
        let FormerBand { coverage, width, half_width, outcome, .. } = former;
        let records = if reader == "twin" { 30 } else { 0 };
        Self { reader, records, cast, method, kind, level, samples, coverage, width, half_width, outcome }
    }
}
