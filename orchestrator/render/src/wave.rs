//! Moving bodies: modes animated by the page's style; waves, and designs of successive steps, played by a script.

use maud::{Markup, PreEscaped, html};

use super::body::{Numbering, Position, Sketch, UnitStyle, ViewBox, frame};
use super::picture::Picture;
use super::style::level;

/// Greatest displacement of a corner in a mode, relative to the grid spacing.
const REACH: f64 = 0.4;

/// (u, v, θ) of every unit, in mm and rad.
type State = Vec<[f64; 3]>;

/// Motion of a body.
#[derive(Debug, Clone, Copy)]
pub struct DrawnMotion<'a> {
    /// Displacements per instant.
    pub displacements: &'a [State],
    /// Velocities per instant (mm/s, rad/s).
    pub velocities: &'a [State],
}

/// A body without ligaments and constraints, which motion would distort.
fn bare(sketch: &Sketch) -> Sketch {
    Sketch { ligaments: Vec::new(), held: Vec::new(), ..sketch.clone() }
}

/// A mode of a body: units displaced along its shape (u, v, θ), coloured by the travel of their centroids.
pub fn mode(sketch: &Sketch, frame: ViewBox, shape: &[[f64; 3]], travel: &[f64], title: &str) -> Picture {
    let moved = |u: usize, corner: &Position| {
        let ([x, y], [du, dv, turn]) = (sketch.centroids[u], shape[u]);
        (du - turn * (corner[1] - y)).hypot(dv + turn * (corner[0] - x))
    };
    let corners = sketch.units.iter().enumerate().flat_map(|(u, unit)| unit.iter().map(move |c| (u, c)));
    let max_displacement = corners.map(|(u, corner)| moved(u, corner)).fold(f64::MIN_POSITIVE, f64::max);
    let scale = REACH * sketch.spacing / max_displacement;
    let farthest = travel.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let unit = |u: usize| {
        let ([x, y], [du, dv, turn]) = (sketch.centroids[u], shape[u].map(|c| scale * c));
        let (y, dy, turn) = (-y, -dv, -turn.to_degrees());
        // the attribute is for still pictures; a page's style uses the variables
        UnitStyle {
            class: Some(format!("unit {}", level(travel[u] / farthest))),
            transform: Some(format!("translate({du:.2} {dy:.2}) rotate({turn:.2} {x:.2} {y:.2})")),
            style: Some(format!("--c:{x:.2}px {y:.2}px;--x:{du:.2}px;--y:{dy:.2}px;--t:{turn:.2}deg")),
        }
    };
    Picture { class: "body mode", ..bare(sketch).drawn(frame, title, Numbering::None, unit) }
}

/// A body at instant `n` of a motion, units coloured by speed relative to `most` (mm/s).
pub fn snapshot(
    sketch: &Sketch,
    frame: ViewBox,
    motion: DrawnMotion,
    n: usize,
    most: f64,
    title: &str,
) -> Picture {
    let mut moved = bare(sketch);
    for (unit, [u, v, angle]) in motion.displacements[n].iter().enumerate() {
        let [cx, cy] = sketch.centroids[unit];
        let (sin, cos) = angle.sin_cos();
        for corner in &mut moved.units[unit] {
            let (x, y) = (corner[0] - cx, corner[1] - cy);
            *corner = [cx + u + cos * x - sin * y, cy + v + sin * x + cos * y];
        }
        moved.centroids[unit] = [cx + u, cy + v];
    }
    let speed = |u: usize| motion.velocities[n][u][0].hypot(motion.velocities[n][u][1]);
    let unit =
        |u| UnitStyle { class: Some(format!("unit {}", level(speed(u) / most))), ..UnitStyle::default() };
    moved.drawn(frame, title, Numbering::None, unit)
}

/// Bodies whose motion [`SCRIPT`] plays in `seconds`, coloured by speed relative to `most` (mm/s). Shows instant `start` at first.
/// Without scripts, bodies stand still.
pub fn animation(
    bodies: &[(&str, &Sketch, DrawnMotion)],
    frame: ViewBox,
    seconds: f64,
    most: f64,
    start: usize,
) -> Markup {
    // Centroids in µm; then u, v in µm, θ in 0.1 mrad, speed in thousandths of the fastest.
    let numbers = |sketch: &Sketch, motion: &DrawnMotion| -> String {
        let middles = sketch.centroids.iter().flat_map(|[x, y]| [1e3 * x, -1e3 * y]);
        let states = motion.displacements.iter().flatten().zip(motion.velocities.iter().flatten());
        let states = states
            .flat_map(|([x, y, angle], v)| [1e3 * x, 1e3 * y, 1e4 * angle, 1e3 * v[0].hypot(v[1]) / most]);
        middles.chain(states).map(|x| format!("{x:.0}")).collect::<Vec<_>>().join(",")
    };
    html! {
        div class="wave" data-duration=(seconds) data-start=(start) {
            div class="pair" {
                @for (name, sketch, motion) in bodies {
                    @let still = bare(sketch).picture(frame, &format!("{name} body in motion"), Numbering::None);
                    div {
                        h3 { (name) " body" }
                        (still.svg(None))
                        script type="text/plain" { (PreEscaped(numbers(sketch, motion))) }
                    }
                }
            }
            (player(bodies[0].2.velocities.len(), "time", "0 s"))
        }
    }
}

/// A body after each of the listed outer steps, of `steps`. [`SCRIPT`] interpolates between these designs and begins with the last;
/// without scripts, the first is shown. Pages that follow a running trial append designs.
///
/// # Panics
/// If there is no design.
pub fn course(designs: &[(u32, Sketch)], steps: usize) -> Markup {
    let (at, first) = &designs[0];
    let still = Sketch { held: Vec::new(), ..first.clone() };
    let view = frame(designs.iter().map(|design| &design.1));
    let still = still.picture(view, "The body during training", Numbering::None);
    // corners that ligaments join; then one line per design: step, all corners, displacements of panels and sensors (mm)
    let corner = |unit: usize| first.units[..unit].iter().map(Vec::len).sum::<usize>();
    let joints = first.joints.iter().flatten().map(|&(unit, node)| (corner(unit) + node).to_string());
    let point = |[x, y]: [f64; 2]| format!("{x:.3},{:.3}", -y);
    let marks = |sketch: &Sketch| -> Vec<Position> {
        let units = sketch.panels.iter().map(|panel| &panel.unit).chain(&sketch.sensors);
        units.map(|unit| sketch.centroids[*unit]).collect()
    };
    let line = |(step, sketch): &(u32, Sketch)| {
        let moved = marks(sketch).into_iter().zip(marks(first)).map(|([x, y], [u, v])| [x - u, y - v]);
        let points = sketch.units.iter().flatten().copied().chain(moved).map(point);
        std::iter::once(step.to_string()).chain(points).collect::<Vec<_>>().join(",")
    };
    let lines = std::iter::once(joints.collect::<Vec<_>>().join(",")).chain(designs.iter().map(line));
    html! {
        div class="course" data-steps=(steps) {
            (still.svg(None))
            (player(designs.len(), "outer step", &format!("step {at} of {steps}")))
            div id="designs" data-live hidden { (lines.collect::<Vec<_>>().join("\n")) }
        }
    }
}

/// A button and a slider for `frames` frames, with `said` as the first frame's description.
fn player(frames: usize, name: &str, said: &str) -> Markup {
    html! {
        div class="player" {
            button type="button" { "Play" }
            input type="range" min="0" max=(frames - 1) value="0" aria-label=(name) aria-valuetext=(said);
            output aria-live="off" { (said) }
        }
    }
}

/// Plays the animations of a page; place it after them.
pub const SCRIPT: &str = include_str!("wave.js");
