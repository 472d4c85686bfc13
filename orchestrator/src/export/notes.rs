//! The README of a device's files: dimensions, positions of chips and forces, instructions.

use metasense_lab::replay::{Drawing, PrescribedMotion};

use super::ligament::CastMaterial;
use super::outline::{HOLE, largest_pocket, screwed};
use super::{FitData, Mould, Outline};
use crate::analysis::BodyState;
use crate::look::number;
use crate::reader::StoredTrial;

/// Markdown for users who cast the body and flash the decoder. `brain`: head of the decoder's file, if there is one.
pub fn notes(
    stored: &StoredTrial,
    body: usize,
    drawing: &Drawing,
    (cast, cavity, mould): (&CastMaterial, &Outline, &Mould),
    (brain, fit): (Option<&str>, FitData),
) -> String {
    let (spec, hash, name) = (&stored.specs[body], &stored.hash, BodyState::ALL[body].name());
    let (word, version) = (BodyState::ALL[body].word(), env!("CARGO_PKG_VERSION"));
    let mut lines = vec![
        format!("# The {word} body of trial {hash}\n"),
        format!("For a device, by metasense {version}. Lengths in mm, x to the right, y upwards.\n"),
        "| file | contents |\n|---|---|".into(),
        "| mould.stl | the mould, open above |".into(),
        "| body.dxf, body.svg | its outline with chips and panels |".into(),
        "| design.npy | α, for `--design` and `body.design` |".into(),
    ];
    let files = [
        "| brain.c | the decoder, C99; its head describes how to call and test it, and what it needs |",
        "| brain.onnx | the decoder as an ONNX graph in 32-bit floats, for whole samples |",
    ];
    let count = if brain.is_some() { 1 + usize::from(spec.brain.task.is_forces()) } else { 0 };
    lines.extend(files.into_iter().take(count).map(String::from));
    lines.push("\n## Cast\n".into());
    lines.extend(cast.needs(drawing).iter().map(|need| format!("- {need}")));
    lines.extend(cast.warnings(drawing).iter().map(|warning| format!("- **Warning:** {warning}.")));
    let [volume, wall] = [1e-3 * cavity.volume(mould), mould.wall].map(number);
    lines.push(format!("- The volume of the cavity is {volume} ml; walls are {wall} mm thick."));
    let screwed: Vec<usize> = screwed(drawing).collect();
    if !screwed.is_empty() {
        lines.push(format!("- Holes of {HOLE} mm (M3 screws) hold the units {} to a base.", list(&screwed)));
    }
    lines.push(match mould.pocket {
        Some([a, b, c]) => {
            format!(
                "- Each chip has a pocket of {a} × {b} mm, {c} mm deep, open below for its cable."
            )
        }
        None => {
            let tilt = spec.sensors.tilt.unwrap_or_default().to_radians();
            let side = largest_pocket(drawing, spec.sensors.offset.unwrap_or_default(), tilt);
            match side > 0.0 {
                true => format!(
                    "- The mould has no pockets; `--mould pocket=LENGTHxWIDTHxDEPTH` makes one for each chip; the largest square pocket has a side \
                     of {side} mm."
                ),
                false => "- The mould has no pockets for chips.".into(),
            }
        }
    });
    let cure =
        "- Cure according to the data sheet of the rubber: pot life ____ min, cure time ____ h, shore ____.";
    lines.extend([cure.to_owned(), format!("- Held units: {}.", list(&drawing.clamped))]);
    if !drawing.guided.is_empty() {
        lines.push(format!("- Partly held units: {}.", list(&drawing.guided)));
    }
    if let Some([x, y]) = spec.body.compression {
        let [x, y] = [x, y].map(|part| number(100.0 * part));
        lines.push(format!(
            "- Before applying forces, move the held units together by {x} % along x and {y} % along y of the distance between the outermost \
             held units (below 0: apart), as in the simulation."
        ));
    }
    lines.push(String::new());
    lines.push("| what | unit | x | y | |\n|---|---|---|---|---|".into());
    let [off, across] = spec.sensors.offset.unwrap_or_default();
    let place = match [off, across] {
        [0.0, 0.0] => "at the centroid".to_owned(),
        [x, y] => format!("({}, {}) from the centroid", number(x), number(y)),
    };
    let turned = spec.sensors.tilt.map_or(String::new(), |tilt| format!(", turned by {}°", number(tilt)));
    for (n, &unit) in drawing.sensors.iter().enumerate() {
        let [x, y] = drawing.centroids[unit];
        let (x, y) = (number(x + off), number(y + across));
        lines.push(format!("| chip {n} | {unit} | {x} | {y} | {place}{turned} |"));
    }
    for (n, (panel, at)) in drawing.panels.iter().enumerate() {
        // rounding errors of a rotation count as zero
        let [a, b] = panel.direction.map(|d| number(if d.abs() < 1e-12 { 0.0 } else { d }));
        let [x, y] = at.map(number);
        let (unit, moment) = (panel.unit, number(panel.moment));
        lines.push(match panel.moves {
            Some(PrescribedMotion::Base(_)) => {
                format!("| force {n} | all held units | | | moves them along ({a}, {b}) |")
            }
            Some(PrescribedMotion::Unit(_)) => {
                format!("| force {n} | {unit} | {x} | {y} | moves it along ({a}, {b}) |")
            }
            None if panel.direction == [0.0; 2] => {
                format!("| force {n} | {unit} | {x} | {y} | a moment of {moment} mm times the force |")
            }
            None => format!("| force {n} | {unit} | {x} | {y} | along ({a}, {b}) |"),
        });
    }
    lines.push("\n## Decode\n".into());
    lines.push(match (brain, fit) {
        (None, _) => "The decoder of this trial cannot be exported for a device.".into(),
        (Some(head), FitData::Design) => decoder_section(
            "fitted to the body as designed; its error on casts that deviate from the design is higher",
            head,
        ),
        (Some(head), FitData::Casts) => {
            decoder_section("fitted to casts that vary according to `[variation]`", head)
        }
    });
    lines.extend([
        "\nRecord about thirty blows with measured forces, in a file of records (docs/reference/measured.md). DB is the database of \
         the trial. The following commands compute the error of decoders fitted to this cast, and its material.\n"
            .to_owned(),
        format!("    metasense lab evaluate DB {hash} --records {name}=records.toml --out-dir measured"),
        format!("    metasense lab identify DB {hash} --design {name} --records records.toml --out-dir material"),
    ]);
    lines.join("\n") + "\n"
}

/// To what the decoder is fitted, and the head of its file.
fn decoder_section(whom: &str, head: &str) -> String {
    format!("The decoder is {whom}. Its file contains:\n\n```text\n{}\n```", head.trim())
}

fn list(units: &[usize]) -> String {
    let units: Vec<String> = units.iter().map(usize::to_string).collect();
    if units.is_empty() { "none".into() } else { units.join(", ") }
}
