//! What goes with the files of a device: its measures, where chips and forces go, what to do with them.

use std::fmt::Write;

use metasense_worker::replay::Drawing;

use super::{Fit, Mould, Outline};
use crate::analysis::Body;
use crate::look::number;
use crate::store::Stored;

/// Markdown, for whoever casts the body and flashes the brain. `brain`: the head of its file, where there is one.
pub fn notes(
    stored: &Stored,
    body: usize,
    drawing: &Drawing,
    (cavity, mould): (&Outline, &Mould),
    (brain, fit): (Option<&str>, Fit),
) -> String {
    let spec = &stored.specs[body];
    let area: f64 = drawing.units.iter().map(|unit| area(unit)).sum();
    let (volume, mass) = (cavity.volume(mould), spec.body.density.map(|density| 1e6 * density * area));
    let mut text = format!(
        "# The {name} body of trial {hash}\n\nFor a device, by metasense {version}. Lengths in mm, x to the right, y upwards.\n\n\
         | file | is |\n|---|---|\n| mould.stl | the mould, open above |\n| body.dxf, body.svg | its outline with chips and \
         panels |\n| design.npy | α, for `--design` and `body.design` |\n",
        name = Body::ALL[body].name(),
        hash = stored.hash,
        version = env!("CARGO_PKG_VERSION"),
    );
    if brain.is_some() {
        text.push_str(
            "| brain.c | the brain, C99; its head says how it is called, tested, and what it needs |\n",
        );
    }
    let write = |text: &mut String, line: String| writeln!(text, "{line}").expect("text");
    write(&mut text, "\n## Cast\n".into());
    write(
        &mut text,
        format!(
            "- The cavity holds {} ml at a height of {} mm; ligaments are {} mm wide, walls {} mm thick.",
            number(1e-3 * volume),
            number(mould.height),
            number(mould.width),
            number(mould.wall)
        ),
    );
    if let Some(mass) = mass {
        write(
            &mut text,
            format!(
                "- The model's units weigh {} g in all: of a material of {} g/ml. Another one, or another height, is another body: \
                 put its numbers into `[body]` (`body.material`) and train again, or identify it (below).",
                number(mass),
                number(1e3 * mass / (area * mould.height))
            ),
        );
    }
    match mould.pocket {
        Some([a, b, c]) => {
            write(
                &mut text,
                format!(
                    "- Each chip has a pocket of {a} × {b} mm, {c} mm deep, open below: its cable leaves there."
                ),
            );
        }
        None => {
            write(&mut text, "- The mould has no pockets; `--pocket 6x5x2` makes one for each chip.".into())
        }
    }
    write(
        &mut text,
        "- Cure as the rubber's data sheet says: pot life ____ min, cure time ____ h, shore ____.".into(),
    );
    write(
        &mut text,
        "- Units that are held: ".to_owned()
            + &list(&drawing.clamped)
            + ".\n\n| what | unit | x | y | |\n|---|---|---|---|---|",
    );
    let [off, across] = spec.sensors.offset.unwrap_or_default();
    let place = match [off, across] {
        [0.0, 0.0] => "at the centroid".to_owned(),
        [x, y] => format!("({}, {}) from the centroid", number(x), number(y)),
    };
    let turned = spec.sensors.tilt.map_or(String::new(), |tilt| format!(", turned by {}°", number(tilt)));
    for (n, &unit) in drawing.sensors.iter().enumerate() {
        let [x, y] = drawing.centroids[unit];
        let (x, y) = (number(x + off), number(y + across));
        write(&mut text, format!("| chip {n} | {unit} | {x} | {y} | {place}{turned} |"));
    }
    for (n, (panel, at)) in drawing.panels.iter().enumerate() {
        let ([x, y], [a, b]) = (at.map(number), panel.direction.map(number));
        write(&mut text, format!("| force {n} | {} | {x} | {y} | along ({a}, {b}) |", panel.unit));
    }
    write(&mut text, "\n## Read\n".into());
    match brain {
        Some(head) => {
            let whom = match fit {
                Fit::Design => "fitted to the body as designed: a cast that scatters reads worse",
                Fit::Casts => "one for all casts that scatter as `[variation]` says",
            };
            write(&mut text, format!("The brain is {whom}. Its file says:\n\n```text\n{}\n```", head.trim()));
        }
        None => write(&mut text, "The trial's brain has no form for a device.".into()),
    }
    let (hash, name) = (&stored.hash, Body::ALL[body].name());
    // a model of the material knows no other channels
    let material = match spec.sensors.channels {
        Some(_) => format!("metasense twin DB {hash} --body {name} --records records.toml --out twin.toml"),
        None => {
            format!("metasense identify DB {hash} --body {name} --records records.toml --out-dir material")
        }
    };
    write(
        &mut text,
        format!(
            "\nWith some thirty blows whose forces you measure, as a file of records (schemas/README.md, Measured signals), DB being the \
             database of the trial: how well brains fitted to this cast read it, and what the cast is made of.\n\n    \
             metasense evaluate DB {hash} --records {name}=records.toml --out-dir measured\n    {material}"
        ),
    );
    text
}

/// By the shoelace formula (mm²).
fn area(corners: &[[f64; 2]]) -> f64 {
    let next = corners.iter().cycle().skip(1);
    0.5 * corners.iter().zip(next).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>()
}

fn list(units: &[usize]) -> String {
    let units: Vec<String> = units.iter().map(usize::to_string).collect();
    if units.is_empty() { "none".into() } else { units.join(", ") }
}
