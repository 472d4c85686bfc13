//! `export`: a trial, or a view, in the forms of other programs.

use std::path::PathBuf;

use clap::ValueEnum;
use metasense_schemas::database::VIEWS;
use metasense_schemas::spec::BrainKind;
use metasense_worker::replay::drawing;

use super::named::{Database, Named, Which};
use super::query::answer_in;
use super::{Error, write};
use crate::analysis::Body;
use crate::exit::Exit;
use crate::export::device::Numbers;
use crate::export::{Mould, Outline, device, dxf, mould, npz, replay_of, replays, series, unreadable};
use crate::look::Format;
use crate::report::body::sketch;
use crate::store::{Reader, Stored, npy_bytes};

/// The form of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Form {
    /// The whole trial as NumPy arrays: designs, signals, predictions, weights, forces, split, scales, scene
    Npz,
    /// Forces, signals and predictions as a table, a row per sample and instant; or a view's rows
    Csv,
    /// The same as a Parquet file
    Parquet,
    /// The design alone (α), as specs and commands read it
    Npy,
    /// The body, drawn
    Svg,
    /// The body as closed polylines in mm, by layer: units, ligaments, panels, sensors
    Dxf,
    /// The mould to cast the body in, as a closed surface in mm
    Stl,
    /// The linear brain or the network as C99 source for a device, with its test
    C,
}

/// Writes a trial or a view for other programs: NumPy, CSV, Parquet, SVG, DXF, STL, C
///
/// A view's name goes in place of the hash: DB VIEW. Of a SPEC, the trial is taken from the database that it writes to.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    trial: Named,
    /// The form
    #[arg(long, value_enum)]
    format: Form,
    /// The file to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Which body, for npy, svg, dxf, stl and c
    #[arg(long, value_enum, default_value = "optimised")]
    body: Which,
    /// Width of a ligament (mm), for dxf and stl
    #[arg(long, default_value_t = 1.0)]
    ligament_width: f64,
    /// Height of the cast body (mm), for stl
    #[arg(long, default_value_t = 10.0)]
    height: f64,
    /// Thickness of the mould's floor and rim (mm), for stl
    #[arg(long, default_value_t = 3.0)]
    wall: f64,
    /// Clearance between the body and the mould's cavity on every side (mm), for stl
    #[arg(long, default_value_t = 0.0)]
    clearance: f64,
    /// Size of a pocket for the chip on each sensor's unit, along, across and deep, such as 6x5x2 (mm), for stl
    #[arg(long, value_name = "AxBxC", value_parser = size)]
    pocket: Option<[f64; 3]>,
    /// What the device computes with, for c [default: f32]
    #[arg(long, value_enum)]
    numbers: Option<Numbers>,
    /// Threads for simulating the trial again
    #[arg(long, default_value_t = 1)]
    threads: usize,
}

/// Three lengths.
fn size(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split('x').map(|number| number.trim().parse().ok()).collect();
    let sides: Option<[f64; 3]> = numbers.and_then(|numbers| numbers.try_into().ok());
    let sides = sides.filter(|sides| sides.iter().all(|side| (MEASURES.0..=MEASURES.1).contains(side)));
    sides
        .ok_or_else(|| format!("must be three lengths of {} to {} mm, such as 6x5x2", MEASURES.0, MEASURES.1))
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let Args { trial: Named { source: db, words, .. }, out, .. } = &args;
    if args.numbers.is_some() && args.format != Form::C {
        return Err(Error::Usage("--numbers is for --format c: leave it out, or write the brain".into()));
    }
    if let Some((what, _)) = VIEWS.iter().find(|(view, _)| words.iter().any(|word| word == view)) {
        let format = match args.format {
            Form::Csv => Format::Csv,
            Form::Parquet => Format::Parquet,
            _ => return Err(Error::Usage(format!("{what} is a view: --format csv or parquet"))),
        };
        let sql = format!("SELECT * FROM {what}");
        Reader::asked(Database::at(db).await?, async |reader| answer_in(reader, &sql, out, format).await)
            .await?;
    } else {
        write(out, trial(&args.trial.stored().await?, &args)?)?;
    }
    print_line!("{}", out.display())?;
    Ok(Exit::Done)
}

fn trial(stored: &Stored, args: &Args) -> Result<Vec<u8>, Error> {
    let which = args.body as usize;
    let body = drawing(&stored.specs[which], &stored.designs[which]).map_err(unreadable(stored))?;
    for (name, value, least) in [
        ("ligament-width", args.ligament_width, MEASURES.0),
        ("height", args.height, MEASURES.0),
        ("wall", args.wall, MEASURES.0),
        ("clearance", args.clearance, 0.0),
    ] {
        if !(least..=MEASURES.1).contains(&value) {
            return Err(Error::Usage(format!("--{name} {value}: must be {least} to {} mm", MEASURES.1)));
        }
    }
    Ok(match args.format {
        Form::Npz => npz::of_trial(stored, args.threads, &mut |what| say!("note: {what}"))?,
        Form::Csv | Form::Parquet => {
            let format = if args.format == Form::Csv { Format::Csv } else { Format::Parquet };
            series::table(stored, &replays(stored, args.threads)?).written(format)
        }
        Form::Npy => {
            let design = &stored.designs[args.body as usize];
            npy_bytes(&[design.len()], design)
        }
        Form::Svg => {
            let title = format!("{} body of trial {}", Body::ALL[args.body as usize].name(), stored.hash);
            sketch(&body, &[]).file(&title).into_bytes()
        }
        Form::C => {
            if matches!(stored.specs[which].brain.kind, BrainKind::Stacked | BrainKind::Inverse) {
                let what = "--format c writes linear brains and networks; this trial's brain is neither";
                return Err(Error::Usage(what.into()));
            }
            let numbers = args.numbers.unwrap_or(Numbers::F32);
            device::c(stored, which, &replay_of(stored, which, args.threads)?, numbers)?.into_bytes()
        }
        Form::Dxf => dxf::dxf(&body, args.ligament_width, 0.17 * body.spacing).into_bytes(),
        Form::Stl => {
            let (width, height) = (args.ligament_width, args.height);
            let (clearance, pocket) = (args.clearance, args.pocket);
            if let Some([_, _, depth]) = pocket.filter(|pocket| pocket[2] >= height) {
                let what =
                    format!("--pocket {depth} mm deep: must be less than the body's --height {height}");
                return Err(Error::Usage(what));
            }
            let measures = Mould { width, height, wall: args.wall, clearance, pocket };
            let spec = &stored.specs[which];
            let (offset, tilt) =
                (spec.sensors.offset.unwrap_or_default(), spec.sensors.tilt.unwrap_or_default());
            let cavity = Outline::new(&body, &measures)
                .and_then(|cavity| cavity.with_pockets(&body, &measures, offset, tilt.to_radians()))
                .map_err(|e| Error::Usage(e.to_string()))?;
            say!("note: the cavity holds {:.1} ml", 1e-3 * cavity.volume(&measures));
            if cavity.parted > 0 {
                say!(
                    "note: ligaments {width} mm wide touch what they do not join and part {} voids: cast, the body is \
                     stiffer there than simulated; make them narrower with --ligament-width",
                    cavity.parted
                );
            }
            mould::stl(&cavity, &measures)
        }
    })
}

/// The least and the largest measure of something cast (mm).
const MEASURES: (f64, f64) = (0.01, 1000.0);
