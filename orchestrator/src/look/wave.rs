//! Bodies in motion: modes that swing by a page's style, waves that a script plays.

use maud::{Markup, PreEscaped, html};
use metasense_worker::modes::Mode;
use metasense_worker::replay::{Drawing, Motion};

use super::body::{Frame, Notes, Unit, body};
use super::{Picture, level};

/// How far a mode moves the corner that it moves most, by the pitch of the grid.
const REACH: f64 = 0.4;

/// A body without what its motion would tear.
fn bare(drawing: &Drawing) -> Drawing {
    Drawing { ligaments: Vec::new(), active: Vec::new(), ..drawing.clone() }
}

/// A mode of a body: units where it takes them, coloured by how far it moves their centroids.
#[must_use]
pub fn mode(drawing: &Drawing, frame: Frame, mode: &Mode, title: &str) -> Picture {
    let moved = |u: usize, corner: &[f64; 2]| {
        let ([x, y], [du, dv, turn]) = (drawing.centroids[u], mode.shape[u].map(|c| c.re));
        (du - turn * (corner[1] - y)).hypot(dv + turn * (corner[0] - x))
    };
    let corners = drawing.units.iter().enumerate().flat_map(|(u, unit)| unit.iter().map(move |c| (u, c)));
    let most = corners.map(|(u, corner)| moved(u, corner)).fold(f64::MIN_POSITIVE, f64::max);
    let scale = REACH * drawing.spacing / most;
    let travel = |u: usize| mode.shape[u][0].norm().hypot(mode.shape[u][1].norm());
    let farthest = (0..drawing.units.len()).map(travel).fold(f64::MIN_POSITIVE, f64::max);
    let unit = |u: usize| {
        let ([x, y], [du, dv, turn]) = (drawing.centroids[u], mode.shape[u].map(|c| scale * c.re));
        let (y, dy, turn) = (-y, -dv, -turn.to_degrees());
        // the attribute for what stands still; a page's own style takes it from the variables
        Unit {
            class: Some(format!("unit {}", level(travel(u) / farthest))),
            transform: Some(format!("translate({du:.2} {dy:.2}) rotate({turn:.2} {x:.2} {y:.2})")),
            style: Some(format!("--c:{x:.2}px {y:.2}px;--x:{du:.2}px;--y:{dy:.2}px;--t:{turn:.2}deg")),
        }
    };
    Picture { class: "body mode", ..body(&bare(drawing), frame, title, Notes::default(), unit) }
}

/// A body at an instant of a motion, units where they are and coloured by their speed over `most` (mm/s).
#[must_use]
pub fn snapshot(
    drawing: &Drawing,
    frame: Frame,
    motion: &Motion,
    n: usize,
    most: f64,
    title: &str,
) -> Picture {
    let mut moved = bare(drawing);
    for (unit, [u, v, angle]) in motion.displacements[n].iter().enumerate() {
        let [cx, cy] = drawing.centroids[unit];
        let (sin, cos) = angle.sin_cos();
        for corner in &mut moved.units[unit] {
            let (x, y) = (corner[0] - cx, corner[1] - cy);
            *corner = [cx + u + cos * x - sin * y, cy + v + sin * x + cos * y];
        }
        moved.centroids[unit] = [cx + u, cy + v];
    }
    let speed = |u: usize| motion.velocities[n][u][0].hypot(motion.velocities[n][u][1]);
    let unit = |u| Unit { class: Some(format!("unit {}", level(speed(u) / most))), ..Unit::default() };
    body(&moved, frame, title, Notes::default(), unit)
}

/// Bodies whose units [`SCRIPT`] moves and colours, at first as at instant `start`; without script they stand still.
#[must_use]
pub fn animation(bodies: &[(&str, &Drawing, &Motion)], frame: Frame, most: f64, start: usize) -> Markup {
    // Centroids in µm; then u, v in µm, θ in 0.1 mrad, speed in thousandths of the fastest.
    let numbers = |drawing: &Drawing, motion: &Motion| -> String {
        let middles = drawing.centroids.iter().flat_map(|[x, y]| [1e3 * x, -1e3 * y]);
        let states = motion.displacements.iter().flatten().zip(motion.velocities.iter().flatten());
        let states = states
            .flat_map(|([x, y, angle], v)| [1e3 * x, 1e3 * y, 1e4 * angle, 1e3 * v[0].hypot(v[1]) / most]);
        middles.chain(states).map(|x| format!("{x:.0}")).collect::<Vec<_>>().join(",")
    };
    let clock = &bodies[0].1.clock;
    html! {
        div class="wave" data-duration=(clock.last().copied().unwrap_or(1.0)) data-start=(start) {
            div class="pair" {
                @for (name, drawing, motion) in bodies {
                    @let still = body(&bare(drawing), frame, &format!("{name} body in motion"), Notes::default(), |_| Unit::default());
                    div {
                        h3 { (name) " body" }
                        (still.svg(None))
                        script type="text/plain" { (PreEscaped(numbers(drawing, motion))) }
                    }
                }
            }
            div class="player" {
                button type="button" { "Play" }
                input type="range" min="0" max=(clock.len() - 1) value="0" aria-label="time";
                output { "0 s" }
            }
        }
    }
}

/// Plays the animations of a page; it goes behind them.
pub const SCRIPT: &str = include_str!("wave.js");
