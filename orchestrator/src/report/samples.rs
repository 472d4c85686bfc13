//! Figures that need a trial's signals, predictions and motion. They replay one representative trial.

use metasense_lab::replay::{Motion, Replay, drawing, motion, replay};
use metasense_worker::design::overlaps;
use metasense_worker::run::NoResult;

use super::body::{self, sketch};
use super::figures::BODIES;
use super::modes;
use super::strips::{Curve, Errors, RESIDUAL, Strip, dots, histories, representative, strips};
use crate::analysis::BodyState;
use crate::analysis::kinds::brains_of;
use crate::look::body::{Sketch, frame};
use crate::look::wave::{self, animation, snapshot};
use crate::look::{Figure, Table, legend, number, row, short_hash};
use crate::reader::StoredTrial;

/// Number of test samples for which an inverse decoder is run again; each takes as long as about a hundred simulations.
const INVERSE: usize = 16;

/// A trial that has been simulated again.
#[derive(Debug)]
pub struct Replayed {
    stored: StoredTrial,
    bodies: [Sketch; 2],
    /// Instants (s) of signals and motion.
    clock: Vec<f64>,
    replays: [Replay; 2],
    /// Indices of the test samples.
    pub test: Vec<usize>,
    threads: usize,
}

impl Replayed {
    /// Simulates a trial again.
    pub fn new(stored: &StoredTrial, threads: usize) -> Result<Self, NoResult> {
        let drawn = |b: usize| drawing(&stored.specs[b], &stored.designs[b]);
        let again =
            |b: usize| replay(&stored.specs[b], &stored.designs[b], &stored.weights[b], INVERSE, threads);
        let ([initial, optimised], replays) = ([drawn(0)?, drawn(1)?], [again(0)?, again(1)?]);
        let test = replays[0].split.iter().enumerate().filter(|(_, s)| **s == 1).map(|(n, _)| n).collect();
        let bodies = [sketch(&initial, &[]), sketch(&optimised, &[])];
        Ok(Self { stored: stored.clone(), bodies, clock: initial.clock, replays, test, threads })
    }

    /// Errors (%) of a sample with the decoders of both bodies.
    pub fn errors(&self, sample: usize) -> [Option<f64>; 2] {
        [0, 1].map(|b| self.replays[b].errors.get(sample).copied().flatten())
    }

    /// Draws the bodies, a sample, all test samples and the wave. Without a sample: four samples, and the wave of the one with the
    /// greatest impulse.
    pub fn figures(&self, sample: Option<usize>) -> Result<Vec<Figure>, NoResult> {
        let (stored, replays) = (&self.stored, &self.replays);
        let sample = sample.filter(|sample| self.test.contains(sample));
        let mut figures = Vec::new();
        if replays.iter().all(|replay| !replay.predictions.is_empty()) {
            // predictions per sample: T · K
            let size = stored.spec().time.samples * stored.spec().panel_units.len();
            let typical = || representative(&replays[1].errors, self.test.iter().copied());
            let read = |sample: &usize| !replays[1].predictions[sample * size].is_nan();
            let chosen = sample.filter(read).map_or_else(typical, |sample| vec![sample]);
            figures.extend([self.forces(&chosen), self.every_sample()]);
        }
        figures.push(self.before_and_after());
        // none for a floating body
        figures.extend(modes::figure(stored, &self.bodies, &self.trial_in_words()).ok());
        let shown = sample.unwrap_or_else(|| self.greatest_impulse());
        let moved = |b: usize| motion(&stored.specs[b], &stored.designs[b], shown, self.threads);
        figures.push(self.waves(&[moved(0)?, moved(1)?], shown));
        Ok(figures)
    }

    fn trial_in_words(&self) -> String {
        let (hash, p) = (&self.stored.hash, self.stored.spec().point);
        let short = short_hash(hash);
        let (k, m, placement, seed) = (p.panels, p.sensors, p.placement, p.seed);
        let [by, with] = brains_of(&serde_json::to_value(self.stored.spec()).unwrap_or_default());
        format!(
            "trial {short} (K = {k}, M = {m}, placement {placement}, seed {seed}; trained with {with}, decoder {by})"
        )
    }

    /// The test sample with the greatest impulse.
    fn greatest_impulse(&self) -> usize {
        let spec = self.stored.spec();
        let size = spec.panel_units.len() * (spec.time.samples + 1);
        let impulse = |n: usize| self.replays[0].forces.values[n * size..(n + 1) * size].iter().sum::<f64>();
        self.test.iter().copied().max_by(|a, b| impulse(*a).total_cmp(&impulse(*b))).unwrap_or(0)
    }

    fn forces(&self, chosen: &[usize]) -> Figure {
        let (spec, replays) = (self.stored.spec(), &self.replays);
        let (panels, instants, duration) = (spec.panel_units.len(), spec.time.samples, spec.time.duration);
        let mut rows = Vec::new();
        let strip = |&sample: &usize| {
            let errors = self.errors(sample).map(|error| error.map_or("–".into(), number));
            let forces = &replays[0].forces.values[sample * panels * (instants + 1)..];
            let force =
                |k: usize, n: usize| (n as f64 * duration / instants as f64, forces[k * (instants + 1) + n]);
            let truth: Vec<Curve> =
                (0..panels).map(|k| (0..=instants).map(|n| force(k, n)).collect()).collect();
            let [initial, optimised] = [0, 1]
                .map(|b| histories(&replays[b].predictions, sample, [instants, panels], duration, |_| 1.0));
            let half_width = |b: usize, k: usize, n: usize| match &replays[b].half_widths[..] {
                [] => self.stored.bands[b][0].get(n * panels + k).copied(),
                own => own.get((sample * instants + n) * panels + k).copied(),
            };
            for (k, truth) in truth.iter().enumerate() {
                let told = truth[1..].iter().zip(&initial[k]).zip(&optimised[k]).enumerate();
                rows.extend(told.map(|(n, (((t, f), (_, a)), (_, b)))| {
                    row![sample, k, t, f, a, b, half_width(0, k, n), half_width(1, k, n)]
                }));
            }
            let band = |b: usize| -> Vec<Vec<f64>> {
                let of = |k: usize| (0..instants).filter_map(|n| half_width(b, k, n)).collect();
                (0..panels).map(of).collect()
            };
            let bands = BodyState::ALL.map(|body| (body.name().to_owned(), band(body as usize)));
            let names = ["truth", "initial", "optimised"].map(str::to_owned).into_iter();
            let sources = names.zip([truth, initial, optimised]).collect();
            let title = format!("sample {sample}: {} → {} %", errors[0], errors[1]);
            Strip { title, sources, bands: bands.into() }
        };
        let samples: Vec<Strip> = chosen.iter().map(strip).collect();
        let names: Vec<String> = (0..panels).map(|k| format!("panel {k}")).collect();
        let (pictures, step) = strips(&samples, &names, " N", duration, true);
        let which = match chosen {
            [one] => format!("test sample {one}"),
            _ => {
                "test samples at the 12th, 37th, 62nd and 87th percentile of the trained body's error".into()
            }
        };
        Figure::new(
            "forces",
            "True and predicted forces",
            format!(
                "Force histories of {which} of {}, and the predictions of each body's decoder (the first \
                 network). Each panel's line is drawn {} N above the next. The titles give the sample's error on \
                 the initial and on the trained body, over all panels.{RESIDUAL}{}",
                self.trial_in_words(),
                number(step),
                match self.stored.bands[1][0].is_empty() && replays[1].half_widths.is_empty() {
                    true => "",
                    false =>
                        " At each instant the shaded band of a body contains the true force with probability 95 %.",
                }
            ),
            legend(&[("truth", "true force"), BODIES[0], BODIES[1]]),
            pictures,
            Table::new("sample panel seconds force initial optimised band_initial band_optimised", rows),
        )
    }

    fn every_sample(&self) -> Figure {
        let pair = |&n: &usize| match self.errors(n) {
            [Some(initial), Some(optimised)] => Some((n, initial, optimised)),
            _ => None,
        };
        let mut pairs: Vec<(usize, f64, f64)> = self.test.iter().filter_map(pair).collect();
        pairs.sort_by(|a, b| a.1.total_cmp(&b.1));
        let errors = |body: BodyState| pairs.iter().map(|p| (p.0, [p.1, p.2][body as usize])).collect();
        let bodies = BodyState::ALL.map(|b| Errors { class: b.name(), body: b.word(), errors: errors(b) });
        let plot = dots("Each test sample", "test samples, by the initial body's error", &bodies, true);
        let better = pairs.iter().filter(|p| p.2 < p.1).count();
        Figure::new(
            "samples",
            "Error of each test sample",
            format!(
                "Prediction error of each test sample of {}. A line joins the sample's error on the initial body and on \
                 the trained body. The trained body is better in {better} of {} samples.",
                self.trial_in_words(),
                pairs.len()
            ),
            legend(&BODIES),
            vec![plot],
            Table::new("sample error_initial error_optimised", pairs.iter().map(|p| row![p.0, p.1, p.2])),
        )
    }

    fn before_and_after(&self) -> Figure {
        let held = [0, 1].map(|b: usize| self.bodies[b].held.len());
        let [initial, optimised] = &self.stored.designs;
        let moved = initial.iter().zip(optimised).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let caption = format!(
            "Initial and trained body of {}: units, ligaments, input panels (arrows in the direction of the force), \
             sensors (dots); clamped units are shaded. Constraints at their limit: {} and {}{}. The \
             largest change of a shift is {} mm.{}",
            self.trial_in_words(),
            held[0],
            held[1],
            if held == [0, 0] { "" } else { "; edges and gaps are drawn as lines, angles as dots" },
            number(moved),
            self.unlimited()
        );
        let drawn = BodyState::ALL.map(|body| {
            (format!("{} body", body.word()), body.name().to_owned(), self.bodies[body as usize].clone())
        });
        body::figure("bodies", "The body before and after training", caption, &drawn)
    }

    /// A sentence about overlaps of the trained body if designs are not limited.
    fn unlimited(&self) -> String {
        let spec = &self.stored.specs[BodyState::Optimised as usize];
        match metasense_worker::problem::layout(&spec.body) {
            Ok(layout) if !spec.feasible.limits => {
                let found = overlaps(&layout, &self.stored.designs[1]);
                format!(" Designs are not limited: in the trained body {found}.")
            }
            _ => String::new(),
        }
    }

    /// Snapshots and animation of the units' speeds.
    fn waves(&self, motions: &[Motion; 2], sample: usize) -> Figure {
        let speed = |b: usize, n: usize, u: usize| {
            let [vx, vy, _] = motions[b].velocities[n][u];
            vx.hypot(vy)
        };
        let (instants, units) = (motions[0].velocities.len(), self.bodies[0].units.len());
        let all = |b: usize| {
            (0..instants).flat_map(|n| (0..units).map(move |u| (n, u))).map(move |(n, u)| speed(b, n, u))
        };
        let most = all(0).chain(all(1)).fold(1e-9, f64::max);
        // Snapshots follow the wave: at 1/8, 3/8, 5/8 and 7/8 of the integral of the initial body's mean speed.
        let mean: Vec<f64> = (0..instants).map(|n| (0..units).map(|u| speed(0, n, u)).sum()).collect();
        let whole: f64 = mean.iter().sum();
        let mut sum = 0.0;
        let mut shots = Vec::new();
        for (n, v) in mean.iter().enumerate() {
            sum += v;
            if sum >= whole * (2 * shots.len() + 1) as f64 / 8.0 && shots.len() < 4 {
                shots.push(n);
            }
        }
        let frame = frame(&self.bodies);
        let (mut pictures, mut rows) = (Vec::new(), Vec::new());
        let shown = BodyState::ALL.map(|body| {
            let Motion { displacements, velocities } = &motions[body as usize];
            (body, &self.bodies[body as usize], wave::DrawnMotion { displacements, velocities })
        });
        for (b, (body, sketch, motion)) in shown.iter().enumerate() {
            for &n in &shots {
                let seconds = self.clock[n];
                let label = format!("{}, {} s", body.word(), number(seconds));
                pictures.push(snapshot(sketch, frame, *motion, n, most, &label));
                rows.extend((0..units).map(|u| {
                    let [x, y, angle] = motion.displacements[n][u];
                    row![body.name(), seconds, u, x, y, angle, speed(b, n, u)]
                }));
            }
        }
        let fastest = (0..instants).max_by(|a, b| mean[*a].total_cmp(&mean[*b])).unwrap_or(0);
        let seconds = self.clock.last().copied().unwrap_or(1.0);
        Figure::new(
            "waves",
            "The wave in the body",
            format!(
                "Speed of each unit (0 to {} mm/s; the colour follows its square root) at four instants and as an animation, \
                 under test sample {sample} of {}. The same forces act on both bodies, drawn as displaced.",
                number(most),
                self.trial_in_words()
            ),
            legend(&[("arrow", "input panel"), ("dot sensor", "sensor"), ("speed", "speed of a unit")]),
            pictures,
            Table::new("body seconds unit u v theta speed", rows),
        )
        .small(Some(animation(&shown.map(|(body, sketch, motion)| (body.word(), sketch, motion)), frame, seconds, most, fastest)))
    }
}
