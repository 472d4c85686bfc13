//! What is needed to go on inside a trial, and how it is stored: postcard bytes behind a version byte. These bytes name no
//! field, so that a field more, in what a checkpoint holds too, is a version more. Versions from 1 are read.

use serde::{Deserialize, Serialize};

use super::{Band, BodyEvaluation, CastReading, Counters, Seconds};

/// Adam on some parameters.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Moments<T> {
    /// First moments.
    pub first: Vec<T>,
    /// Second moments.
    pub second: Vec<T>,
    /// Steps so far.
    pub steps: u64,
}

/// The best design so far.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Best {
    /// α (mm).
    pub design: Vec<f64>,
    /// Its test error (%).
    pub error: f64,
    /// The outer step that started from it.
    pub step: u32,
}

/// A design that the outer loop has passed.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Waypoint {
    /// The outer step that started from it.
    pub step: u32,
    /// α (mm).
    pub design: Vec<f64>,
}

/// A network in training.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Training {
    /// Its weights.
    pub weights: Vec<f32>,
    /// Adam on them.
    pub moments: Moments<f32>,
    /// Training loss (normalised) at every iteration so far.
    pub losses: Vec<f32>,
    /// (Iteration, from 1, prediction error on the holdout before it (%)), thinned.
    pub errors: Vec<(u32, f64)>,
}

/// How far the comparison at the end has come.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Comparison {
    /// The bodies, the initial one first; the last may lack networks.
    pub bodies: Vec<BodyEvaluation>,
    /// The network that is being trained on it.
    pub training: Option<Training>,
    /// Counts of work.
    pub counters: Counters,
    /// Where the time went.
    pub seconds: Seconds,
}

/// What is needed to go on inside a trial.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Checkpoint {
    /// The next outer step.
    pub step: u32,
    /// α (mm).
    pub design: Vec<f64>,
    /// Adam on α.
    pub design_moments: Moments<f64>,
    /// Brain weights, where the protocol keeps them.
    pub weights: Vec<f32>,
    /// Adam on the brain.
    pub weight_moments: Moments<f32>,
    /// The best design so far.
    pub best: Option<Best>,
    /// The body's rate as a part of what the protocol asks for.
    pub caution: f64,
    /// Steps taken back in a row.
    pub setbacks: u32,
    /// Running geometric mean of the training loss after training.
    pub trend: Option<f64>,
    /// λ of the linear brain, where the body is trained with one and a step has found it.
    pub ridge: Option<f64>,
    /// The last designs before this one, newest last.
    pub trail: Vec<Waypoint>,
    /// The comparison, where it has begun.
    pub comparison: Option<Box<Comparison>>,
    /// Where sensors have moved under programs that moved them: the first outer step there, and their units.
    pub moves: Vec<(u32, Vec<usize>)>,
    /// Fitness of the candidates of a search without gradient so far.
    pub found: Vec<f64>,
    /// How casts of the bodies of the comparison are read so far.
    pub casts: Vec<Vec<CastReading>>,
    /// Bands about what is read of these bodies and casts.
    pub bands: Vec<Vec<Band>>,
}

impl Checkpoint {
    /// What a trial that trains the same body goes on from: all but the comparison, which is its own, and the weights of a
    /// network that trains no body, whose shape may be its own.
    #[must_use]
    pub fn of_body(mut self, by_network: bool) -> Self {
        (self.comparison, self.casts, self.bands) = (None, Vec::new(), Vec::new());
        if !by_network {
            (self.weights, self.weight_moments) = (Vec::new(), Moments::default());
        }
        self
    }

    /// Behind all outer steps, of what is left of them once a trial is done: its best design (mm), found by that step.
    #[must_use]
    pub fn trained(steps: u32, design: Vec<f64>, best_step: u32) -> Self {
        let nothing = vec![0.0; design.len()];
        let design_moments = Moments { first: nothing.clone(), second: nothing, steps: steps.into() };
        let best = Some(Best { design: design.clone(), error: 0.0, step: best_step });
        Self { step: steps, design, design_moments, best, caution: 1.0, ..Self::default() }
    }
}

/// Version 3, and the beginnings of it that were versions 1 (up to `protocol`) and 2 (up to `moves`).
#[derive(Deserialize)]
struct Former {
    step: u32,
    design: Vec<f64>,
    design_moments: Moments<f64>,
    weights: Vec<f32>,
    weight_moments: Moments<f32>,
    best: Option<Best>,
    /// Caution, setbacks, trend (0: none), the ridge where there is one, then step and α of each waypoint.
    protocol: Vec<f64>,
    comparison: Option<Box<Comparison>>,
    moves: Vec<(u32, Vec<usize>)>,
    found: Vec<f64>,
}

impl From<Former> for Checkpoint {
    fn from(former: Former) -> Self {
        let Former { step, design, design_moments, weights, weight_moments, best, .. } = former;
        let Former { protocol, comparison, moves, found, .. } = former;
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
            comparison,
            moves,
            found,
            casts: Vec::new(),
            bands: Vec::new(),
        }
    }
}

/// What comes before the bands, by field.
type BeforeBands = (
    u32,
    Vec<f64>,
    Moments<f64>,
    Vec<f32>,
    Moments<f32>,
    Option<Best>,
    f64,
    u32,
    Option<f64>,
    Option<f64>,
    Vec<Waypoint>,
    Option<Box<Comparison>>,
    Vec<(u32, Vec<usize>)>,
    Vec<f64>,
    Vec<Vec<CastReading>>,
);

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

/// Bytes of version 6 as those of version 7.
fn with_records(bytes: &[u8]) -> Result<Vec<u8>, CheckpointError> {
    let (_, rest) = postcard::take_from_bytes::<BeforeBands>(bytes)
        .map_err(|error| CheckpointError::Damaged(error.to_string()))?;
    let bands = read::<Vec<Vec<FormerBand>>>(rest)?;
    let bands: Vec<Vec<Band>> =
        bands.into_iter().map(|of| of.into_iter().map(Band::from).collect()).collect();
    let before = bytes[..bytes.len() - rest.len()].to_vec();
    Ok(postcard::to_extend(&bands, before).expect("bands are plain data"))
}

/// A stored checkpoint that this program cannot go on from.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CheckpointError {
    /// Of another program.
    #[error("it is of version {0}, this program knows version {known}", known = Checkpoint::VERSION)]
    Version(u8),
    /// Cut short, or of another shape than its version says.
    #[error("it is damaged: {0}")]
    Damaged(String),
}

impl Checkpoint {
    /// Of what [`Checkpoint::to_bytes`] writes.
    pub const VERSION: u8 = 7;

    /// As it is stored.
    ///
    /// # Panics
    /// Never: it is plain data.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_extend(self, vec![Self::VERSION]).expect("a checkpoint is plain data")
    }

    /// From what is stored.
    ///
    /// # Errors
    /// If it is of another version, or not whole.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        let former = |bytes: &[u8]| read::<Former>(bytes).map(Self::from);
        match bytes.split_first() {
            Some((&Self::VERSION, rest)) => read(rest),
            Some((6, rest)) => read(&with_records(rest)?),
            // It ends before what came later, of which there is nothing; so do the others.
            Some((5, rest)) => read(&[rest, &[0]].concat()),
            Some((4, rest)) => read(&[rest, &[0, 0]].concat()),
            Some((3, rest)) => former(rest),
            Some((2, rest)) => former(&[rest, &[0]].concat()),
            Some((1, rest)) => former(&[rest, &[0, 0, 0]].concat()),
            Some((version, _)) => Err(CheckpointError::Version(*version)),
            None => Err(CheckpointError::Damaged("it is empty".into())),
        }
    }
}

/// All of some bytes.
fn read<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, CheckpointError> {
    match postcard::take_from_bytes(bytes) {
        Ok((value, [])) => Ok(value),
        Ok((_, more)) => Err(CheckpointError::Damaged(format!("{} bytes too many", more.len()))),
        Err(error) => Err(CheckpointError::Damaged(error.to_string())),
    }
}

#[cfg(test)]
mod tests;
