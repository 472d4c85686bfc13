//! `export`: writes a trial or a view in formats of other programs.

use std::path::PathBuf;

use clap::ValueEnum;
use metasense_lab::casts::NO_VARIATION;
use metasense_lab::demands::Demands;
use metasense_lab::replay::{Drawing, Replay, ReplayDecoder, drawing};
use metasense_schemas::database::VIEWS;
use metasense_worker::problem::LigamentMaterial;

use super::named::{Database, Named, Which};
use super::query::answer_in;
use super::{Error, cores, make_folder, print_path, write};
use crate::analysis::BodyState;
use crate::exit::Exit;
use crate::export::device::Numbers;
use crate::export::ligament::CastMaterial;
use crate::export::notes::notes;
use crate::export::{
    FitData, Mould, Outline, brain_of, device, dxf, mould, npz, onnx, replays, series, unreadable,
};
use crate::look::Format;
use crate::provenance;
use crate::reader::{Reader, StoredTrial};
use crate::report::body::sketch;
use crate::store::npy_bytes;

/// Format of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Form {
    /// The whole trial as NumPy arrays: designs, signals, predictions, weights, forces, split, scales, scene
    Npz,
    /// Forces, signals and predictions as a table, one row per sample and instant; or the rows of a view
    Csv,
    /// The same as a Parquet file
    Parquet,
    /// Only the design (α), in the form that specs and commands read
    Npy,
    /// A drawing of the body
    Svg,
    /// The body as closed polylines in mm, by layer: units, ligaments, panels, sensors, holes and notes
    Dxf,
    /// The mould for casting the body, as a closed surface in mm
    Stl,
    /// The decoder as C99 source for a device, with its test
    C,
    /// The decoder as an ONNX graph, from signals of whole samples to forces
    Onnx,
    /// A folder with all files to build a device: mould, outline, design, decoder, and notes on casting and decoding
    Device,
}

/// Writes a trial or a view for other programs: NumPy, CSV, SVG, DXF, STL, C, ONNX
///
/// To export a view, pass its name in place of the hash: DB VIEW. With SPEC, the trial is read from the database of the
/// spec.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    trial: Named,
    /// Format
    #[arg(long, value_enum, help_heading = "Output")]
    format: Form,
    /// File to write; for a device the folder
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    out: PathBuf,
    /// The design, for npy, svg, dxf, stl, c, onnx and device
    #[arg(long, value_enum, value_name = "DESIGN", default_value = "optimised")]
    design: Which,
    /// Lengths of the mould (mm), for dxf, stl and device, such as height=12,wall=3,clearance=0.1,pocket=6x5x2: height of the
    /// cast body [default: the thickness of body.material, else 10], thickness of floor and rim [default: 3], clearance
    /// between body and cavity on every side [default: 0], length, width and depth of a pocket for each chip [default: none]
    #[arg(long, value_name = "KEY=VALUE,...", value_parser = lengths)]
    mould: Option<Lengths>,
    /// Number format of the device, for c and device [default: f32]
    #[arg(long, value_enum, help_heading = "Decoder")]
    numbers: Option<Numbers>,
    /// The data to which the decoder is fitted, for c, onnx and device [default: design]
    #[arg(long, value_enum, help_heading = "Decoder")]
    reader: Option<FitData>,
}

/// Default thickness of a mould's floor and rim (mm).
const WALL: f64 = 3.0;

/// Lengths of a mould (mm) on the command line.
#[derive(Debug, Clone, Copy, Default)]
struct Lengths {
    height: Option<f64>,
    wall: Option<f64>,
    clearance: Option<f64>,
    pocket: Option<[f64; 3]>,
}

/// Parses `--mould`; each key at most once.
fn lengths(text: &str) -> Result<Lengths, String> {
    let mut found = Lengths::default();
    let (least, most) = MEASURES;
    for part in text.split(',') {
        let (key, value) = part.split_once('=').ok_or("must be KEY=VALUE, such as height=12")?;
        let numbers: Option<Vec<f64>> = value.split('x').map(|number| number.trim().parse().ok()).collect();
        let numbers = numbers.unwrap_or_default();
        let fits = |least: f64| numbers.iter().all(|number| (least..=most).contains(number));
        let is_new = match (key, &numbers[..]) {
            ("height", &[mm]) if fits(least) => found.height.replace(mm).is_none(),
            ("wall", &[mm]) if fits(least) => found.wall.replace(mm).is_none(),
            ("clearance", &[mm]) if fits(0.0) => found.clearance.replace(mm).is_none(),
            ("pocket", &[a, b, c]) if fits(least) => found.pocket.replace([a, b, c]).is_none(),
            ("height" | "wall", _) => {
                return Err(format!("{part}: must be a length of {least} to {most} mm"));
            }
            ("clearance", _) => return Err(format!("{part}: must be a length of 0 to {most} mm")),
            ("pocket", _) => {
                return Err(format!("{part}: must be three lengths of {least} to {most} mm, such as 6x5x2"));
            }
            _ => return Err(format!("{key}: unknown; the keys are height, wall, clearance and pocket")),
        };
        if !is_new {
            return Err(format!("{key}: given twice"));
        }
    }
    Ok(found)
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let Args { trial: named, out, .. } = &args;
    let Named { source, words } = named;
    let brain = [Form::C, Form::Onnx];
    let options = [
        ("numbers", args.numbers.is_some(), &brain[..1]),
        ("reader", args.reader.is_some(), &brain[..]),
        ("mould", args.mould.is_some(), &[Form::Dxf, Form::Stl][..]),
    ];
    let has = |forms: &[Form]| args.format == Form::Device || forms.contains(&args.format);
    if let Some((name, _, forms)) = options.iter().find(|(_, given, forms)| *given && !has(forms)) {
        let name_of = |form: &Form| form.to_possible_value().expect("none is hidden").get_name().to_owned();
        let forms = forms.iter().map(name_of).collect::<Vec<_>>().join(", ");
        return usage!("--{name}: only for --format {forms} and device; leave it out");
    }
    if let Some((what, _)) = VIEWS.iter().find(|(view, _)| words.iter().any(|word| word == view)) {
        let format = match args.format {
            Form::Csv => Format::Csv,
            Form::Parquet => Format::Parquet,
            _ => return usage!("{what} is a view: use --format csv or parquet"),
        };
        if words.len() > 1 {
            return usage!("{what} is a view of all trials: leave out the options of single trials");
        }
        let db = if named.is_database() { source.clone() } else { named.plan()?.default_database() };
        let sql = format!("SELECT * FROM {what}");
        Reader::with_reader(Database::at(&db).await?, async |reader| {
            answer_in(reader, &sql, out, format).await
        })
        .await?;
    } else {
        let stored = args.trial.stored().await?;
        provenance::unresolved(&stored.solver).iter().for_each(|caveat| say!("warning: {caveat}"));
        trial(&stored, &args)?;
    }
    print_path(out)?;
    Ok(Exit::Done)
}

fn trial(stored: &StoredTrial, args: &Args) -> Result<(), Error> {
    let which = args.design as usize;
    if matches!(args.format, Form::Npy) {
        return write(&args.out, design(stored, args));
    }
    let body = &drawing(&stored.specs[which], &stored.designs[which]).map_err(unreadable(stored))?;
    let height = height(stored, args);
    let cast = || CastMaterial::new(&stored.specs[which], body, height).map_err(unreadable(stored));
    let bytes = match args.format {
        Form::Npz => npz::of_trial(stored, cores(), &mut |what| say!("note: {what}"))?,
        Form::Csv => series::table(stored, &replays(stored, cores())?).written(Format::Csv),
        Form::Parquet => series::table(stored, &replays(stored, cores())?).written(Format::Parquet),
        Form::Npy => unreachable!("written above, whatever the body is"),
        Form::Svg => picture(stored, body, &cast()?, args),
        Form::C => source_in_c(stored, args)?,
        Form::Onnx if !estimates_forces(stored) => {
            return usage!(
                "--format onnx: writes decoders of forces; this trial reads out brain.task: use --format c"
            );
        }
        Form::Onnx => onnx::onnx(stored, which, &brain(stored, args)?)?,
        Form::Dxf => {
            let cast = cast()?;
            tell(&cast, body);
            outlines(body, &cast)
        }
        Form::Stl => {
            let (cavity, measures) = cavity(stored, body, &cast()?, args)?;
            mould::stl(&cavity, &measures)
        }
        Form::Device => return device(stored, body, &cast()?, args),
    };
    write(&args.out, bytes)
}

/// Writes the folder of a device after all files have been computed.
fn device(stored: &StoredTrial, body: &Drawing, cast: &CastMaterial, args: &Args) -> Result<(), Error> {
    let which = args.design as usize;
    let (cavity, measures) = cavity(stored, body, cast, args)?;
    let brain = match has_form(stored, which) {
        true if !estimates_forces(stored) => Some((source_in_c(stored, args)?, None)),
        true => {
            let brain = brain(stored, args)?;
            Some((encode_c(stored, args, &brain)?, Some(onnx::onnx(stored, which, &brain)?)))
        }
        false if args.numbers.is_some() || args.reader.is_some() => {
            return Err(no_form("with --numbers or --reader, --format device"));
        }
        false => None,
    };
    let text = brain.as_ref().map(|(c, _)| String::from_utf8_lossy(c));
    let head = text.as_deref().and_then(|text| text.split_once("*/")).map(|(head, _)| &head[2..]);
    let fit = args.reader.unwrap_or(FitData::Design);
    let notes = notes(stored, which, body, (cast, &cavity, &measures), (head, fit));
    let mut files = vec![
        ("mould.stl", mould::stl(&cavity, &measures)),
        ("body.dxf", outlines(body, cast)),
        ("body.svg", picture(stored, body, cast, args)),
        ("design.npy", design(stored, args)),
        ("README.md", notes.into_bytes()),
    ];
    if let Some((c, onnx)) = brain {
        files.push(("brain.c", c));
        files.extend(onnx.map(|onnx| ("brain.onnx", onnx)));
    }
    make_folder(&args.out)?;
    files.iter().try_for_each(|(name, bytes)| write(&args.out.join(name), bytes))
}

fn design(stored: &StoredTrial, args: &Args) -> Vec<u8> {
    let design = &stored.designs[args.design as usize];
    npy_bytes(&[design.len()], design)
}

fn picture(stored: &StoredTrial, body: &Drawing, cast: &CastMaterial, args: &Args) -> Vec<u8> {
    let title = format!("{} body of trial {}", BodyState::ALL[args.design as usize].word(), stored.hash);
    sketch(body, &[]).file(&title, cast.ligament.width).into_bytes()
}

fn outlines(body: &Drawing, cast: &CastMaterial) -> Vec<u8> {
    dxf::dxf(body, cast.ligament.width, 0.17 * body.spacing).into_bytes()
}

/// Height of the cast body (mm): from `--mould`, else of the spec's material, else 10.
fn height(stored: &StoredTrial, args: &Args) -> f64 {
    let own = stored.specs[args.design as usize].body.material;
    args.mould.unwrap_or_default().height.or(own.map(|m| m.thickness)).unwrap_or(10.0)
}

/// Prints what casting requires, and warns where the cast moves differently from the simulation.
fn tell(cast: &CastMaterial, body: &Drawing) {
    cast.needs(body).iter().for_each(|need| say!("note: {need}"));
    cast.warnings(body).iter().for_each(|warning| say!("warning: {warning}"));
}

/// The decoder, with a replay of its body.
fn brain(stored: &StoredTrial, args: &Args) -> Result<(Replay, ReplayDecoder), Error> {
    let which = args.design as usize;
    if !has_form(stored, which) {
        return Err(no_form("--format c or onnx"));
    }
    let fit = args.reader.unwrap_or(FitData::Design);
    if fit == FitData::Casts && stored.specs[which].variation.is_none() {
        return usage!("--reader casts: the trial has {NO_VARIATION}");
    }
    Ok(brain_of(stored, which, fit, cores())?)
}

fn encode_c(stored: &StoredTrial, args: &Args, brain: &(Replay, ReplayDecoder)) -> Result<Vec<u8>, Error> {
    let (numbers, fit) = (args.numbers.unwrap_or(Numbers::F32), args.reader.unwrap_or(FitData::Design));
    Ok(device::c(stored, args.design as usize, fit, brain, numbers)?.into_bytes())
}

/// The decoder of a trial in C: that of the forces, or the readouts of its tasks.
fn source_in_c(stored: &StoredTrial, args: &Args) -> Result<Vec<u8>, Error> {
    if estimates_forces(stored) {
        return encode_c(stored, args, &brain(stored, args)?);
    }
    if args.reader == Some(FitData::Casts) {
        return usage!("--reader casts: the trial has {NO_VARIATION}");
    }
    let numbers = args.numbers.unwrap_or(Numbers::F32);
    Ok(device::readout::c(stored, args.design as usize, numbers, cores())?.into_bytes())
}

fn estimates_forces(stored: &StoredTrial) -> bool {
    stored.spec().brain.task.is_forces()
}

/// The error for a decoder that cannot be written as C or ONNX.
fn no_form(what: &str) -> Error {
    Error::Usage(format!(
        "{what} writes linear decoders and networks; the decoder of this trial inverts the model of its body"
    ))
}

/// Whether a decoder can be written as C and ONNX.
fn has_form(stored: &StoredTrial, which: usize) -> bool {
    matches!(Demands::of_trial(&stored.specs[which]), Ok(Some(_)))
}

/// The cavity of the mould and the lengths of the mould; prints notes and warnings.
fn cavity(
    stored: &StoredTrial,
    body: &Drawing,
    cast: &CastMaterial,
    args: &Args,
) -> Result<(Outline, Mould), Error> {
    let LigamentMaterial { width, thickness: height, .. } = cast.ligament;
    let Lengths { wall, clearance, pocket, .. } = args.mould.unwrap_or_default();
    if let Some([_, _, depth]) = pocket.filter(|pocket| pocket[2] >= height) {
        let what =
            format!("--mould pocket {depth} mm deep: must be less than the height of the body, {height} mm");
        return Err(Error::Usage(what));
    }
    let measures =
        Mould { width, height, wall: wall.unwrap_or(WALL), clearance: clearance.unwrap_or(0.0), pocket };
    let spec = &stored.specs[args.design as usize];
    let (offset, tilt) = (spec.sensors.offset.unwrap_or_default(), spec.sensors.tilt.unwrap_or_default());
    let cavity = Outline::new(body, &measures)
        .and_then(|cavity| cavity.with_inserts(body, &measures, offset, tilt.to_radians()))
        .map_err(|e| Error::Usage(e.to_string()))?;
    tell(cast, body);
    say!("note: the cavity holds {:.1} ml", 1e-3 * cavity.volume(&measures));
    if cavity.parted > 0 {
        say!(
            "warning: ligaments {width:.2} mm wide touch parts that they do not join and divide {} voids; the cast body is \
             stiffer there than simulated",
            cavity.parted
        );
    }
    Ok((cavity, measures))
}

/// Smallest and largest length of a mould (mm).
const MEASURES: (f64, f64) = (0.01, 1000.0);
