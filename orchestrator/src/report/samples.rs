//! The figures that need a trial's signals, predictions and motion: one representative trial, replayed.

use metasense_worker::replay::{Drawing, Motion, Replay, drawing, motion, replay};
use metasense_worker::run::Failure;

use super::figures::BODIES;
use super::modes;
use super::strips::{Curve, Errors, Strip, dots, histories, representative, strips};
use crate::analysis::Body;
use crate::look::body::{Notes, Unit, body, frame};
use crate::look::wave::{animation, snapshot};
use crate::look::{Figure, Table, legend, number, row};
use crate::store::Stored;

/// A trial that has been simulated again.
#[derive(Debug)]
pub struct Replayed {
    stored: Stored,
    drawings: [Drawing; 2],
    replays: [Replay; 2],
    /// Its test samples.
    pub test: Vec<usize>,
    threads: usize,
}

impl Replayed {
    /// Simulates it again.
    ///
    /// # Errors
    /// If the trial cannot be simulated.
    pub fn new(stored: &Stored, threads: usize) -> Result<Self, Failure> {
        let drawn = |b: usize| drawing(&stored.specs[b], &stored.designs[b]);
        let drawings = [drawn(0)?, drawn(1)?];
        let replays =
            [0, 1].map(|b| replay(&stored.specs[b], &stored.designs[b], &stored.weights[b], threads));
        let [initial, optimised] = replays;
        let replays = [initial?, optimised?];
        let test = replays[0].split.iter().enumerate().filter(|(_, s)| **s == 1).map(|(n, _)| n).collect();
        Ok(Self { stored: stored.clone(), drawings, replays, test, threads })
    }

    /// A sample's error by what the brain of either body makes of it (%).
    #[must_use]
    pub fn errors(&self, sample: usize) -> [Option<f64>; 2] {
        [0, 1].map(|b| self.replays[b].errors.get(sample).copied().flatten())
    }

    /// Draws the bodies, a sample, every test sample, the wave; without a sample four of them, and the loudest one's wave.
    ///
    /// # Errors
    /// If the wave cannot be simulated.
    pub fn figures(&self, sample: Option<usize>) -> Result<Vec<Figure>, Failure> {
        let (stored, replays) = (&self.stored, &self.replays);
        let sample = sample.filter(|sample| self.test.contains(sample));
        let mut figures = Vec::new();
        if replays.iter().all(|replay| !replay.predictions.is_empty()) {
            let typical = || representative(&replays[1].errors, self.test.iter().copied());
            let chosen = sample.map_or_else(typical, |sample| vec![sample]);
            figures.push(forces(stored, replays, &chosen));
            figures.push(every_sample(stored, replays, &self.test));
        }
        figures.push(bodies(stored, &self.drawings));
        // a body that floats has none
        figures.extend(modes::figure(stored, &self.drawings, &who(stored)).ok());
        let shown = sample.unwrap_or_else(|| loudest(&replays[0].forces.values, &self.test, stored));
        let motions = [0, 1].map(|b| motion(&stored.specs[b], &stored.designs[b], shown, self.threads));
        let [initial, optimised] = motions;
        figures.push(waves(stored, &self.drawings, &[initial?, optimised?], shown));
        Ok(figures)
    }
}

fn who(stored: &Stored) -> String {
    let p = stored.spec().point;
    format!(
        "trial {} (K = {}, M = {}, placement {}, seed {})",
        &stored.hash[..stored.hash.len().min(8)],
        p.panels,
        p.sensors,
        p.placement,
        p.seed
    )
}

/// The test sample with the greatest impulse.
fn loudest(forces: &[f64], test: &[usize], stored: &Stored) -> usize {
    let size = stored.spec().panel_units.len() * (stored.spec().time.samples + 1);
    let impulse = |n: usize| forces[n * size..(n + 1) * size].iter().sum::<f64>();
    test.iter().copied().max_by(|a, b| impulse(*a).total_cmp(&impulse(*b))).unwrap_or(0)
}

fn forces(stored: &Stored, replays: &[Replay; 2], chosen: &[usize]) -> Figure {
    let (panels, instants) = (stored.spec().panel_units.len(), stored.spec().time.samples);
    let duration = stored.spec().time.duration;
    let mut rows = Vec::new();
    let strip = |&sample: &usize| {
        let errors = [0, 1].map(|b| replays[b].errors[sample].map_or("–".into(), number));
        let forces = &replays[0].forces.values[sample * panels * (instants + 1)..];
        let force =
            |k: usize, n: usize| (n as f64 * duration / instants as f64, forces[k * (instants + 1) + n]);
        let truth: Vec<Curve> = (0..panels).map(|k| (0..=instants).map(|n| force(k, n)).collect()).collect();
        let [initial, optimised] =
            [0, 1].map(|b| histories(&replays[b].predictions, sample, [instants, panels], duration, |_| 1.0));
        for (k, truth) in truth.iter().enumerate() {
            let told = truth[1..].iter().zip(&initial[k]).zip(&optimised[k]);
            rows.extend(told.map(|(((t, f), (_, a)), (_, b))| row![sample, k, t, f, a, b]));
        }
        let names = ["truth", "initial", "optimised"].map(str::to_owned).into_iter();
        let sources = names.zip([truth, initial, optimised]).collect();
        Strip { title: format!("sample {sample}: {} → {} %", errors[0], errors[1]), sources }
    };
    let samples: Vec<Strip> = chosen.iter().map(strip).collect();
    let names: Vec<String> = (0..panels).map(|k| format!("panel {k}")).collect();
    let (pictures, step) = strips(&samples, &names, " N", duration);
    Figure::new(
        "forces",
        "True and predicted forces",
        format!(
            "Force histories of {} of {}, and what the brain of each body (the first network, or the linear \
             one) makes of its sensors' signals. A panel's line lies {} N above that of the next. The \
             titles give the sample's two errors, over all panels.",
            match chosen {
                [one] => format!("test sample {one}"),
                _ => "test samples at the 12th, 37th, 62nd and 87th percentile of the optimised body's error"
                    .into(),
            },
            who(stored),
            number(step)
        ),
        legend(&[("truth", "true force"), BODIES[0], BODIES[1]]),
        pictures,
        Table::new("sample panel seconds force initial optimised", rows),
    )
}

fn every_sample(stored: &Stored, replays: &[Replay; 2], test: &[usize]) -> Figure {
    let mut pairs: Vec<(usize, f64, f64)> =
        test.iter().filter_map(|&n| Some((n, replays[0].errors[n]?, replays[1].errors[n]?))).collect();
    pairs.sort_by(|a, b| a.1.total_cmp(&b.1));
    let bodies = Body::ALL.map(|body| Errors {
        class: body.name(),
        body: body.name(),
        errors: pairs.iter().map(|p| (p.0, [p.1, p.2][body as usize])).collect(),
    });
    let plot = dots("Every test sample", "test samples, by the initial body's error", &bodies, true);
    let better = pairs.iter().filter(|p| p.2 < p.1).count();
    Figure::new(
        "samples",
        "Error of every test sample",
        format!(
            "Prediction error of each test sample of {}: open the initial body, filled the optimised one, \
             joined. The optimised body is better in {better} of {} samples.",
            who(stored),
            pairs.len()
        ),
        legend(&BODIES),
        vec![plot],
        Table::new("sample error_initial error_optimised", pairs.iter().map(|p| row![p.0, p.1, p.2])),
    )
}

fn bodies(stored: &Stored, drawings: &[Drawing; 2]) -> Figure {
    let frame = frame(&[&drawings[0], &drawings[1]]);
    let pictures = Body::ALL.map(|b| {
        let title = format!("{} body", b.name());
        body(&drawings[b as usize], frame, &title, Notes::default(), |_| Unit::default())
    });
    let mut rows = Vec::new();
    for body in Body::ALL {
        for (unit, corners) in drawings[body as usize].units.iter().enumerate() {
            rows.extend(corners.iter().enumerate().map(|(node, [x, y])| row![body.name(), unit, node, x, y]));
        }
    }
    let held = [0, 1].map(|b: usize| drawings[b].active.len());
    let mut entries = vec![("arrow", "input panel"), ("dot sensor", "sensor")];
    if held != [0, 0] {
        entries.push(("active", "constraint at its limit"));
    }
    let moved =
        stored.designs[0].iter().zip(&stored.designs[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    Figure::new(
        "bodies",
        "The body before and after",
        format!(
            "Initial and optimised body of {}: units, ligaments, input panels (arrows: the direction of \
             the blow), sensors (dots), clamped units in a shade of their own. Constraints of a castable \
             body at their limit: {} and {}{}. The farthest shift moved {} mm.",
            who(stored),
            held[0],
            held[1],
            if held == [0, 0] { "" } else { ", edges and gaps drawn as lines, angles as dots" },
            number(moved)
        ),
        legend(&entries),
        pictures.to_vec(),
        Table::new("body unit node x y", rows),
    )
}

/// Snapshots of speed, and what the animation needs.
fn waves(stored: &Stored, drawings: &[Drawing; 2], motions: &[Motion; 2], sample: usize) -> Figure {
    let speed = |b: usize, n: usize, u: usize| {
        let [vx, vy, _] = motions[b].velocities[n][u];
        vx.hypot(vy)
    };
    let (instants, units) = (motions[0].velocities.len(), drawings[0].units.len());
    let fastest = |b: usize| {
        (0..instants).flat_map(|n| (0..units).map(move |u| (n, u))).map(move |(n, u)| speed(b, n, u))
    };
    let most = fastest(0).chain(fastest(1)).fold(1e-9, f64::max);
    // Snapshots follow the wave: where the initial body's mean speed has reached these parts of its integral.
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
    let frame = frame(&[&drawings[0], &drawings[1]]);
    let (mut pictures, mut rows) = (Vec::new(), Vec::new());
    for body in Body::ALL {
        let (b, d) = (body as usize, &drawings[body as usize]);
        for &n in &shots {
            let label = format!("{}, {} s", body.name(), number(d.clock[n]));
            pictures.push(snapshot(d, frame, &motions[b], n, most, &label));
        }
        for &n in &shots {
            rows.extend((0..units).map(|u| {
                let [x, y, angle] = motions[b].displacements[n][u];
                row![body.name(), d.clock[n], u, x, y, angle, speed(b, n, u)]
            }));
        }
    }
    let fastest = (0..instants).max_by(|a, b| mean[*a].total_cmp(&mean[*b])).unwrap_or(0);
    let bodies = Body::ALL.map(|body| (body.name(), &drawings[body as usize], &motions[body as usize]));
    Figure::new(
        "waves",
        "The wave in the body",
        format!(
            "Speed of every unit (0 to {} mm/s, by its root from pale to strong) at four instants and as \
             an animation, under test sample {sample} of {}: the same blows on the initial and on the \
             optimised body, drawn as displaced.",
            number(most),
            who(stored)
        ),
        legend(&[("arrow", "input panel"), ("dot sensor", "sensor"), ("speed", "speed of a unit")]),
        pictures,
        Table::new("body seconds unit u v theta speed", rows),
    )
    .small(Some(animation(&bodies, frame, most, fastest)))
}
