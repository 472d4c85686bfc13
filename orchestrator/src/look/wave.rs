//! Bodies in motion: modes that swing by a page's style; waves, and designs from step to step, that a script plays.

use maud::{Markup, PreEscaped, html};
use metasense_worker::modes::Mode;
use metasense_worker::replay::{Drawing, Motion};

use super::body::{Frame, Notes, Unit, body, frame};
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
            (player(clock.len(), "time", "0 s"))
        }
    }
}

/// A body after so many outer steps of a trial's `steps`: [`SCRIPT`] goes through these designs, and from one into the next,
/// at first to the last; without script the first stands still. On a page that follows a trial they become more.
///
/// # Panics
/// If there is none.
#[must_use]
pub fn course(designs: &[(u32, Drawing)], steps: usize) -> Markup {
    let (at, first) = &designs[0];
    let still = Drawing { active: Vec::new(), ..first.clone() };
    let frame = frame(&designs.iter().map(|design| &design.1).collect::<Vec<_>>());
    let still = body(&still, frame, "The body from step to step", Notes::default(), |_| Unit::default());
    // which corners a ligament joins; then a line a design: its step, all corners, how far panels and sensors have gone (mm)
    let joints = first.joints.iter().flatten().map(|(unit, node)| (4 * unit + node).to_string());
    let point = |[x, y]: [f64; 2]| format!("{x:.3},{:.3}", -y);
    let marks = |drawing: &Drawing| -> Vec<[f64; 2]> {
        let units = drawing.panels.iter().map(|panel| &panel.0).chain(&drawing.sensors);
        units.map(|unit| drawing.centroids[*unit]).collect()
    };
    let line = |(step, drawing): &(u32, Drawing)| {
        let moved = marks(drawing).into_iter().zip(marks(first)).map(|([x, y], [u, v])| [x - u, y - v]);
        let points = drawing.units.iter().flatten().copied().chain(moved).map(point);
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

/// A button and a slider for so many frames, at the first, of which `said` is told.
fn player(frames: usize, name: &str, said: &str) -> Markup {
    html! {
        div class="player" {
            button type="button" { "Play" }
            input type="range" min="0" max=(frames - 1) value="0" aria-label=(name) aria-valuetext=(said);
            output aria-live="off" { (said) }
        }
    }
}

/// Plays the animations of a page; it goes behind them.
pub const SCRIPT: &str = include_str!("wave.js");

#[cfg(test)]
mod tests {
    use super::super::body::tests::squares;
    use super::*;

    /// Of every design its corners and, as they are drawn from the first, how far panel and sensor have gone since: the unit
    /// of the panel with its corners, the sensor to another unit.
    #[test]
    fn a_course_has_every_design_and_where_its_marks_have_gone() {
        let mut designs = [(0, squares()), (8, squares())];
        for (_, drawing) in &mut designs {
            (drawing.panels, drawing.sensors) = (vec![(0, [1.0, 0.0])], vec![1]);
        }
        let [_, (_, last)] = &mut designs;
        last.units[0] = last.units[0].map(|[x, y]| [x + 1.5, y - 0.25]);
        last.centroids[0] = [last.centroids[0][0] + 1.5, last.centroids[0][1] - 0.25];
        last.sensors = vec![2];
        let page = course(&designs, 50).into_string();
        let data = page.split("hidden>").nth(1).unwrap().split('<').next().unwrap();
        let lines: Vec<Vec<f64>> =
            data.lines().map(|line| line.split(',').map(|x| x.parse().unwrap()).collect()).collect();
        let [joints, first, last] = &lines[..] else { panic!("{data}") };
        assert_eq!(joints.len(), 2 * designs[0].1.ligaments.len());
        for (l, ends) in designs[0].1.ligaments.iter().enumerate() {
            for (end, [x, y]) in ends.iter().enumerate() {
                let corner = 1 + 2 * joints[2 * l + end] as usize;
                assert!(
                    (first[corner] - x).abs() < 1e-3 && (first[corner + 1] + y).abs() < 1e-3,
                    "{l} {end}"
                );
            }
        }
        assert!((first[0], first.len(), last.len()) == (0.0, 1 + 9 * 8 + 4, 1 + 9 * 8 + 4), "{data}");
        assert_eq!(first[73..], [0.0; 4]);
        assert_eq!((last[0], &last[73..]), (8.0, &[1.5, 0.25, 15.0, 0.0][..]));
        assert!((last[1] - first[1] - 1.5).abs() < 1e-3 && last[9..73] == first[9..73], "{data}");
        assert!(page.contains("max=\"1\"") && page.contains("aria-valuetext=\"step 0 of 50\""), "{page}");
        assert_eq!(page.matches("<script").count(), 0, "numbers alone");
    }
}
