//! Measured records beside the model, before anything is fitted: which mistakes would explain them better.
//!
//! ```text
//! ρ_cd = Σ y_c s_d / √(Σ y_c² Σ s_d²)      over readings y and simulated signals s within W = 3/f_c of a record's first force
//! ```
//! Both without what lies above f_c = rate/5. A cast differs from its design by 10 … 20 %, which leaves phases alike for some
//! three periods; of a few stiffnesses the one that agrees best is taken. ρ has no scale: gains Σ y s/Σ s² tell units.

mod instruments;
mod search;
mod spectra;

pub use instruments::{Instruments, blows, clipped};
pub use search::{Found, OfChannel, OfRecord, Source, compare};
pub use spectra::{Spectra, spectra};

use crate::dynamics::{Accuracy, Forces, Parameters, Scene, Solver, planned, run};
use crate::stimuli::anti_aliased_force;

/// Histories on one even clock.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct History {
    /// Time of the first entry, and between two (s).
    pub start: f64,
    /// Likewise.
    pub dt: f64,
    /// Equally long.
    pub values: Vec<Vec<f64>>,
}

impl History {
    /// Time of an entry (s).
    pub fn time(&self, n: usize) -> f64 {
        self.start + n as f64 * self.dt
    }

    /// Entries of each.
    pub fn entries(&self) -> usize {
        self.values.first().map_or(0, Vec::len)
    }

    /// How many entries lie before what begins at `onset` (s), with room for its first step.
    fn before(&self, onset: f64) -> usize {
        (0..self.entries()).take_while(|n| self.time(*n) < onset - 1.5 * self.dt).count()
    }

    /// Without what lies above this frequency (Hz, −3 dB), by a Gaussian; ends count as often as they are within reach.
    #[must_use]
    fn smooth(&self, cutoff: f64) -> Self {
        let deviation = (0.5 * 2f64.ln()).sqrt() / (std::f64::consts::PI * cutoff * self.dt);
        let reach = (3.5 * deviation).ceil() as i64;
        let weights: Vec<f64> =
            (-reach..=reach).map(|i| (-0.5 * (i as f64 / deviation).powi(2)).exp()).collect();
        let values = self.values.iter().map(|history| {
            let of = |n: usize| {
                let (mut sum, mut total) = (0.0, 0.0);
                for (i, weight) in (n as i64 - reach..).zip(&weights) {
                    if let Some(value) = usize::try_from(i).ok().and_then(|i| history.get(i)) {
                        (sum, total) = (sum + weight * value, total + weight);
                    }
                }
                sum / total
            };
            (0..history.len()).map(of).collect()
        });
        Self { values: values.collect(), ..*self }
    }

    /// A history at a time; 0 before its first entry and behind its last.
    fn at(&self, history: usize, time: f64) -> f64 {
        let place = (time - self.start) / self.dt;
        let values = &self.values[history];
        if place < 0.0 || place > (values.len() - 1) as f64 {
            return 0.0;
        }
        let n = (place as usize).min(values.len().saturating_sub(2));
        let part = place - n as f64;
        (1.0 - part) * values[n] + part * values.get(n + 1).unwrap_or(&0.0)
    }
}

/// A record in N, mm/s² and rad/s, on the clock on which a sample begins at 0.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Record {
    /// One force per panel, or that on `panel`.
    pub force: History,
    /// The panel of a single force.
    pub panel: Option<usize>,
    /// A history per channel.
    pub signals: History,
}

impl Record {
    /// When the first force begins, and when 95 % of the impulse of all has acted (s).
    pub fn blow(&self) -> [f64; 2] {
        let History { values, .. } = &self.force;
        let size = |n: usize| values.iter().map(|history| history[n].abs()).fold(0.0, f64::max);
        let peak = (0..self.force.entries()).map(size).fold(0.0, f64::max);
        let acts = |n: usize| if size(n) > ONSET * peak { size(n) } else { 0.0 };
        let total: f64 = (0..self.force.entries()).map(acts).sum();
        let (mut sum, mut first) = (0.0, None);
        for n in 0..self.force.entries() {
            sum += acts(n);
            first = first.or((sum > 0.0).then_some(n));
            if sum >= 0.95 * total {
                return [self.force.time(first.unwrap_or(n)), self.force.time(n)];
            }
        }
        [self.force.start; 2]
    }
}

/// Part of its peak at which a force begins.
const ONSET: f64 = 0.05;

/// What the records are compared with.
#[derive(Clone)]
pub struct Model<'a> {
    /// The body on its own clock.
    pub scene: &'a Scene,
    /// Its design.
    pub design: &'a [f64],
    /// How it is integrated.
    pub solver: Solver,
    /// Which of a_x (0), a_y (1) and ω (2) are read of each sensor.
    pub channels: &'a [usize],
    /// By how much readings are late (s).
    pub delay: f64,
    /// Threads.
    pub pool: &'a crate::Pool,
}

/// Instants of the motion for each reading, and the error of the signals that is enough here.
const FINER: f64 = 6.0;
const COARSE: f64 = 0.02;

impl Model<'_> {
    /// Signals under each record's force, which `place` puts onto panels, of a body `stiffness` times as stiff with these sensors: on a
    /// clock finer than that of readings `dt` apart, a history per channel; empty where the body cannot be simulated.
    fn simulate(
        &self,
        records: &[Record],
        place: &dyn Fn(&Record) -> Vec<usize>,
        sensors: &[usize],
        stiffness: f64,
        dt: f64,
    ) -> Vec<History> {
        let (panels, duration) = (self.scene.panels.len(), self.scene.duration);
        let instants = (duration * FINER / dt).ceil() as usize;
        let p = Parameters::of(self.scene);
        let stiffened = Parameters {
            stretch: stiffness * p.stretch,
            shear: stiffness * p.shear,
            bend: stiffness * p.bend,
            ..p
        };
        let scene = Scene { instants, sensors: sensors.to_vec(), ..stiffened.set(self.scene) };
        let mut values = vec![0.0; records.len() * panels * (instants + 1)];
        for (record, all) in records.iter().zip(values.chunks_exact_mut(panels * (instants + 1))) {
            for (history, panel) in record.force.values.iter().zip(place(record)) {
                let on_clock =
                    anti_aliased_force(history, record.force.start, record.force.dt, duration, instants);
                all[panel * (instants + 1)..][..=instants].copy_from_slice(&on_clock);
            }
        }
        let forces = Forces { samples: records.len(), panels, instants, values, strikes: Vec::new() };
        let accuracy = Accuracy(self.solver.accuracy.0.max(COARSE));
        let plan = planned(&scene, self.design, &forces, &Solver { accuracy, ..self.solver }).double();
        let signals = run(&scene, self.design, &forces, &plan, false, self.pool).signals;
        let (width, step) = (3 * sensors.len(), duration / instants as f64);
        let of_sample = |sample: &[f64]| {
            let read = |sensor: usize| self.channels.iter().map(move |kind| 3 * sensor + kind);
            let history = |c: usize| sample.iter().skip(c).step_by(width).copied().collect();
            let values = (0..sensors.len()).flat_map(read).map(history).collect();
            History { start: step + self.delay, dt: step, values }
        };
        signals.chunks_exact(instants * width).map(of_sample).collect()
    }
}
