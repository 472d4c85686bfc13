//! Compares measured records with the model before any fit, and searches for mistakes that explain differences.
//!
//! ```text
//! ρ_cd = Σ y_c s_d / √(Σ y_c² Σ s_d²)      over readings y and simulated signals s within W = 3/f_c of a record's first force
//! ```
//! Both are low-pass filtered at f_c = rate/5. A cast differs from its design by 10 to 20 %, so phases agree for about three periods; the
//! search takes the best of a few stiffnesses. ρ is independent of scale; gains Σ y s/Σ s² reveal wrong units. A channel that aliases modes
//! faster than half its rate is left out.

mod instruments;
mod search;
mod spectra;
mod sums;

pub use instruments::{Instruments, clipped};
#[cfg(test)]
pub use search::ChannelFinding;
pub use search::{Explanation, RecordFinding, compare};
pub use spectra::{Spectra, spectra};

use metasense_numerics::dynamics::{Accuracy, Forces, IntegratorSettings, Parameters, Scene, planned, run};
use metasense_numerics::stimuli::{REACH, anti_aliased, anti_aliased_force};
use metasense_numerics::trial::ChipErrors;

/// Histories on a uniform clock.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct History {
    /// Time of the first entry (s).
    pub start: f64,
    /// Interval between entries (s).
    pub dt: f64,
    /// Histories of equal length.
    pub values: Vec<Vec<f64>>,
}

impl History {
    /// Time of an entry (s).
    pub fn time(&self, n: usize) -> f64 {
        self.start + n as f64 * self.dt
    }

    /// Entries per history.
    pub fn entries(&self) -> usize {
        self.values.first().map_or(0, Vec::len)
    }

    /// Number of entries before an event at `onset` (s), with a margin of 1.5 intervals.
    fn before(&self, onset: f64) -> usize {
        (0..self.entries()).take_while(|n| self.time(*n) < onset - 1.5 * self.dt).count()
    }

    /// Gaussian low-pass with −3 dB at `cutoff` (Hz), normalised at the ends.
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

    /// The history after a low-pass, with the greatest whole multiple of its interval that is at most `interval`.
    pub fn thinned(&self, interval: f64) -> Self {
        let (every, last) = ((interval / self.dt) as usize, self.entries().saturating_sub(1));
        if every < 2 || every > last {
            return self.clone();
        }
        let (count, reach) = (last / every, (REACH as usize + 1) * every);
        let values = self.values.iter().map(|history| {
            let held = [vec![history[0]; reach], history.clone(), vec![history[last]; reach]].concat();
            anti_aliased(&held, -(reach as f64), 1.0, (count * every) as f64, count)
        });
        Self { values: values.collect(), dt: every as f64 * self.dt, ..*self }
    }

    /// Linear interpolation of a history at a time; 0 outside it.
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

/// A record in N, mm/s² and rad/s, with time 0 at the start of the sample.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CheckedRecord {
    /// Force per panel, or the single force on `panel`.
    pub force: History,
    /// Panel of a single force.
    pub panel: Option<usize>,
    /// One history per channel.
    pub signals: History,
}

impl CheckedRecord {
    /// Start of the first force, and the time when 95 % of the total impulse has acted (s).
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

/// Fraction of its peak at which a force begins.
const ONSET: f64 = 0.05;

/// Model for the comparison with records.
#[derive(Clone)]
pub struct ComparisonModel<'a> {
    /// Body with its clock.
    pub scene: &'a Scene,
    /// Design α (mm).
    pub design: &'a [f64],
    /// Integration method and tolerance.
    pub solver: IntegratorSettings,
    /// Channels per sensor: a_x (0), a_y (1), ω (2).
    pub channels: &'a [usize],
    /// Imperfections of the chips; of these the delay and the low-pass count.
    pub chip: Option<ChipErrors>,
    /// Threads.
    pub pool: &'a metasense_numerics::Pool,
}

/// Simulated instants per reading; integration error.
const FINER: f64 = 6.0;
const COARSE: f64 = 0.02;

impl ComparisonModel<'_> {
    /// Simulates a body with scaled `stiffness` and these sensors under each record's forces; `place` gives their panels. Returns one
    /// history per channel, sampled more finely than readings `dt` apart; empty if the simulation fails.
    fn simulate(
        &self,
        records: &[CheckedRecord],
        place: &dyn Fn(&CheckedRecord) -> Vec<usize>,
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
        let plan =
            planned(&scene, self.design, &forces, &IntegratorSettings { accuracy, ..self.solver }).double();
        let signals = run(&scene, self.design, &forces, &plan, false, self.pool).signals;
        let (width, step) = (3 * sensors.len(), duration / instants as f64);
        let of_sample = |sample: &[f64]| {
            let read = |sensor: usize| self.channels.iter().map(move |kind| 3 * sensor + kind);
            let history = |c: usize| sample.iter().skip(c).step_by(width).copied().collect();
            let values = (0..sensors.len()).flat_map(read).map(history).collect();
            History { start: step + self.chip.map_or(0.0, |chip| chip.delay), dt: step, values }
        };
        signals.chunks_exact(instants * width).map(of_sample).collect()
    }
}
