//! `evaluate`: compares bodies on measured signals.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use metasense_lab::evaluate::{
    Effort, Evaluated, FoldEstimates, NetworkStore, estimate_by_inverse, evaluate, evaluate_by_twin, parts,
    simulated,
};
use metasense_lab::inverse::holdout;
use metasense_lab::measured::Measured;
use metasense_lab::twin::{self, Twin};
use metasense_schemas::spec::{BrainKind, TrialSpec};
use metasense_worker::problem::external::polygons;
use metasense_worker::run::NoResult;

use super::named::{Named, read_records};
use super::report::write_figures;
use super::unfinished::Unfinished;
use super::{Error, Format, duration, end_on_signal, print_rows, write};
use crate::analysis::records::SignalSource;
use crate::exit::Exit;
use crate::export::npz::Zip;
use crate::report::records::{BodyRecords, ComparableBodies};

/// Compares bodies on measured signals, with decoders fitted to the records
///
/// The trial defines the panels, the sensors, the clock and the decoder. Each record is estimated by decoders that were
/// not fitted to it (cross-validation). If the design of a body is known, the same forces are simulated on it, the
/// simulated signals are evaluated in the same way, and they are compared with the measured signals.
/// docs/reference/measured.md describes the files of records.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    trial: Named,
    /// A body and the file (TOML) of its records; once per body. Ratios are relative to the first body. `initial` and
    /// `optimised` are the trial's own bodies. For the inverse decoder, `holdout` is the held-out set of the trial,
    /// simulated on the body, or on its twin if it has one
    #[arg(long, value_name = "BODY=FILE", required = true, value_parser = pair)]
    records: Vec<(String, PathBuf)>,
    /// The design (.npy or .csv) of a body that is not the trial's own
    #[arg(long, value_name = "BODY=FILE", value_parser = pair)]
    design: Vec<(String, PathBuf)>,
    /// A twin (TOML, from `metasense lab identify --out`) of a body whose design is known. Decoders fitted to its simulated signals,
    /// or its inverse decoder, also estimate the forces of the body's records
    #[arg(long, value_name = "BODY=FILE", value_parser = pair)]
    twin: Vec<(String, PathBuf)>,
    /// Number of folds; each is estimated by decoders fitted to all others [default: 10, at most the number of records]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..), help_heading = "Networks")]
    folds: Option<u32>,
    /// The decoder [default: the trial's brain.kind]
    #[arg(long, value_enum, help_heading = "Networks")]
    brain: Option<Brain>,
    /// Writes a page (index.html), its figures, the table and the error of each record (CSV), and forces, predictions and
    /// signals (records.npz) into this folder. During the evaluation, the folder keeps the trained networks; the same
    /// command resumes from there
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out_dir: Option<PathBuf>,
    /// Threads
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "Workers")]
    threads: u16,
    /// Format of the table
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

/// Kinds of decoders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Brain {
    /// The trial's network
    Cnn,
    /// Least squares over the whole sample, or the trial's brain.memory
    Linear,
    /// A network on the signals and on the predictions of a linear decoder
    Stacked,
    /// The model of the body, inverted, with 95 % bands; only for bodies whose design is known
    Inverse,
}

/// Stands for the trial's held-out set in place of a file.
const HOLDOUT: &str = "holdout";

/// Parses BODY=FILE. Names become parts of array names.
fn pair(text: &str) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((name, file)) if !name.is_empty() && !file.is_empty() => {
            match name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-') {
                true => Ok((name.to_owned(), PathBuf::from(file))),
                false => Err(format!("{name:?}: a name consists of letters, digits, - and _")),
            }
        }
        _ => Err("must be BODY=FILE, such as initial=records.toml".into()),
    }
}

/// Time between two lines of progress.
const LINE_EVERY: Duration = Duration::from_secs(10);
/// Default number of folds: 90 % of the records train, as in a trial.
const FOLDS: usize = 10;

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    end_on_signal(args.out_dir.as_deref());
    let (specs, mut designs) = specs_and_designs(&args).await?;
    let brain = brain(&args, &specs[0])?;
    let inverse = brain == BrainKind::Inverse;
    if inverse || !args.twin.is_empty() {
        let option = if inverse { "--brain inverse" } else { "--twin" };
        polygons(&specs[0].body).map_err(|e| Error::Usage(format!("{option}: {e}")))?;
    }
    let (layout, initial) =
        metasense_lab::simulate::body(&specs[0]).map_err(|e| Error::Usage(format!("trial: {e}")))?;
    designs.entry("initial".into()).or_insert(initial);
    let options = [("--records", &args.records), ("--design", &args.design), ("--twin", &args.twin)];
    for (option, files) in options {
        let before = |i: usize, name: &str| files[..i].iter().any(|(other, _)| other == name);
        if let Some((_, (name, _))) = files.iter().enumerate().find(|(i, (name, _))| before(*i, name)) {
            return usage!("{option} {name}: given twice; pass one file per body");
        }
    }
    if let Some((name, file)) = args.design.iter().find(|(name, _)| designs.contains_key(name)) {
        return usage!(
            "--design {name}={}: {name} is the trial's own body; give the body another name, also in --records",
            file.display()
        );
    }
    for (name, file) in &args.design {
        if !args.records.iter().any(|(other, _)| other == name) {
            return usage!("--design {name}: pass --records {name}=FILE as well");
        }
        let design = match specs[0].body.kind.is_polygons() {
            true => metasense_worker::design::read(file, &layout)?,
            false => metasense_worker::design::read_array(file, designs["initial"].len())?,
        };
        designs.insert(name.clone(), design);
    }
    let mut twins = BTreeMap::new();
    for (name, file) in &args.twin {
        let known = designs.get(name).filter(|_| args.records.iter().any(|(other, _)| other == name));
        let Some(design) = known else {
            return usage!("--twin {name}: pass --records {name}=FILE of a body whose design is known");
        };
        twins.insert(name.clone(), twin::read(file, spec_of_body(&specs, name), design)?);
    }
    let read = |(name, file): &(String, PathBuf)| -> Result<Records, Error> {
        let (spec, design) = (spec_of_body(&specs, name), designs.get(name));
        let usage_error = |why: &str| Error::Usage(format!("--records {name}={}: {why}", file.display()));
        if inverse && design.is_none() {
            let why = "an inverse decoder needs the model of the body: pass --design BODY=FILE";
            return Err(usage_error(why));
        }
        let (by, measured) = match design.filter(|_| file.as_os_str() == HOLDOUT) {
            Some(_) if !inverse => {
                let why = "only for --brain inverse; the trial contains the errors of other decoders";
                return Err(usage_error(why));
            }
            Some(design) => {
                let own = (&design[..], twins.get(name));
                let found = holdout(spec, own, args.threads.into());
                (SignalSource::Holdout, found.map_err(|e| usage_error(&e.to_string()))?)
            }
            None if inverse && spec.sensors.noise.is_none() => {
                let remedy = "must be set: an inverse decoder needs the noise of measured signals";
                return Err(args.trial.refused_key("sensors.noise", remedy));
            }
            None => (SignalSource::Measured, read_records(file, spec)?),
        };
        if measured.start_deviation > 0.0 {
            return Err(usage_error(
                "signals.start_deviation: must be left out: clocks are taken as exact here; set signals.start as `metasense lab identify` \
                 prints it for these records",
            ));
        }
        Ok(Records { name: name.clone(), by, measured })
    };
    let records = args.records.iter().map(read).collect::<Result<Vec<_>, Error>>()?;
    let (comparison, unfinished) = compare(&args, &specs, brain, records, &designs, &twins)?;
    if let Some(folder) = &args.out_dir {
        write_parts(folder, &comparison)?;
    }
    unfinished.done()?;
    print_rows(&comparison.table(), args.format)?;
    let failed = comparison.bodies.iter().filter(|body| !all_trained(body)).count();
    Ok(if failed == 0 { Exit::Done } else { Exit::Failed })
}

/// Specs of the initial and the trained body, whose sensors may differ, and the known designs by body.
async fn specs_and_designs(args: &Args) -> Result<([TrialSpec; 2], BTreeMap<String, Vec<f64>>), Error> {
    if !args.trial.is_database() {
        let (_, spec) = args.trial.read().await?;
        return Ok(([spec.clone(), spec], BTreeMap::new()));
    }
    let stored = args.trial.stored().await?;
    let [initial, optimised] = stored.designs;
    Ok((stored.specs, BTreeMap::from([("initial".into(), initial), ("optimised".into(), optimised)])))
}

/// The spec with the sensors of the body of this name.
fn spec_of_body<'a>([initial, optimised]: &'a [TrialSpec; 2], name: &str) -> &'a TrialSpec {
    if name == "optimised" { optimised } else { initial }
}

/// The requested decoder; refuses options that have no effect on it.
fn brain(args: &Args, trial: &TrialSpec) -> Result<BrainKind, Error> {
    let brain = match args.brain {
        None => trial.brain.kind,
        Some(Brain::Cnn) => BrainKind::Cnn,
        Some(Brain::Linear) => BrainKind::Linear,
        Some(Brain::Stacked) => BrainKind::Stacked,
        Some(Brain::Inverse) => BrainKind::Inverse,
    };
    match args.folds {
        Some(_) if brain == BrainKind::Inverse => {
            usage!("--folds: has no effect on an inverse decoder, which is not trained on records")
        }
        _ => Ok(brain),
    }
}

/// Records of one body.
struct Records {
    name: String,
    by: SignalSource,
    measured: Measured,
}

fn compare(
    args: &Args,
    specs: &[TrialSpec; 2],
    brain: BrainKind,
    records: Vec<Records>,
    designs: &BTreeMap<String, Vec<f64>>,
    twins: &BTreeMap<String, Twin>,
) -> Result<(ComparableBodies, Unfinished<Networks>), Error> {
    let trial = &specs[0];
    check_records(args, specs, brain, &records, designs)?;
    let fewest = records.iter().map(|of| of.measured.forces.samples).min().unwrap_or(0);
    let networks = matches!(brain, BrainKind::Cnn | BrainKind::Stacked);
    let folds = args.folds.map_or(FOLDS.min(fewest).max(2), |n| n as usize);
    let seeds = if networks { trial.evaluation.networks() } else { 1 };
    let effort = Effort { brain, folds, seeds, iterations: trial.brain.iterations };
    let inputs: Vec<_> = (records.iter())
        .map(|Records { name, measured: Measured { forces, signals, low_pass, .. }, .. }| {
            (name, forces.instants, &forces.values, signals, low_pass, designs.get(name))
        })
        .collect();
    let specs_of = specs.each_ref().map(|spec| serde_json::to_string(spec).expect("a trial is JSON"));
    let made_of = (specs_of, effort, inputs, format!("{twins:?}"));
    let (unfinished, kept) = Unfinished::new(args.out_dir.as_deref(), "evaluate", &made_of)?;
    let modelled = |of: &Records| of.by == SignalSource::Measured && designs.contains_key(&of.name);
    let of_body = |of: &Records| match brain {
        BrainKind::Inverse => {
            let times = 1 + usize::from(modelled(of)) + usize::from(twins.contains_key(&of.name));
            times * parts(of.measured.forces.samples)
        }
        _ => (1 + usize::from(modelled(of))) * effort.folds * effort.seeds,
    };
    let progress_unit = if brain == BrainKind::Inverse { "parts decoded" } else { "networks trained" };
    let total_networks = records.iter().map(of_body).sum();
    let progress = Progress::new(progress_unit, total_networks, &unfinished, kept.unwrap_or_default());
    let threads = usize::from(args.threads);
    let evaluate_signals = |name: &str, kind: &str, measured: &Measured| -> Result<Evaluated, Error> {
        let (spec, kept) = (self::spec_of_body(specs, name), BodyProgress { name, kind, of: &progress });
        let found = match brain {
            BrainKind::Inverse => estimate_by_inverse(spec, (&designs[name], None), measured, threads, &kept),
            _ => evaluate(spec, measured, effort, threads, &kept),
        };
        found.map_err(|e| match e {
            NoResult::Rejected(what) => Error::Usage(format!("--records {name}: {what}")),
            NoResult::Shortage(what) => Error::Short(what),
            other => Error::Usage(format!("--records {name}: {other}")),
        })
    };
    let first = &records[0].measured.forces.values;
    let paired = records.iter().all(|of| same_forces(&of.measured.forces.values, first));
    let mut bodies = Vec::new();
    for of in records {
        let modelled = modelled(&of);
        let Records { name, by, measured } = of;
        let spec = self::spec_of_body(specs, &name);
        let by_measured = evaluate_signals(&name, by.name(), &measured)?;
        let model = match designs.get(&name).filter(|_| modelled) {
            None => None,
            Some(design) => match simulated(spec, design, &measured.forces, threads) {
                Ok(signals) => {
                    let modelled = Measured { signals, ..measured.clone() };
                    let judged = evaluate_signals(&name, SignalSource::Simulated.name(), &modelled)?;
                    Some((modelled.signals, judged))
                }
                Err(NoResult::Numerical { detail: why, .. }) => {
                    say!("{name}: the model cannot be simulated: {why}");
                    None
                }
                Err(e) => return usage!("--design {name}: {e}"),
            },
        };
        let of_twin = |twin: &Twin| {
            let kept = BodyProgress { name: &name, kind: SignalSource::Twin.name(), of: &progress };
            let own = (&designs[&name][..], twin);
            evaluate_by_twin(spec, own, &measured, effort, &by_measured.folds, threads, &kept)
                .map_err(|e| Error::Usage(format!("--twin {name}: {e}")))
        };
        let twin = twins.get(&name).map(of_twin).transpose()?;
        let signals = measured.signals;
        bodies.push(BodyRecords { name, by, signals, measured: by_measured, simulated: model, twin });
    }
    Ok((ComparableBodies::new(bodies, paired, trial), unfinished))
}

/// Refuses a single record where folds are needed, and two bodies with the same measured signals.
fn check_records(
    args: &Args,
    specs: &[TrialSpec; 2],
    brain: BrainKind,
    records: &[Records],
    designs: &BTreeMap<String, Vec<f64>>,
) -> Result<(), Error> {
    let file = |of: &Records| {
        let (name, file) = args.records.iter().find(|(name, _)| *name == of.name).expect("it was read");
        format!("--records {name}={}", file.display())
    };
    let single = |of: &&Records| brain != BrainKind::Inverse && of.measured.forces.samples < 2;
    if let Some(of) = records.iter().find(single) {
        let why = "contains one record: pass two or more, because each is predicted by a decoder fitted to the others";
        return usage!("{}: {why}", file(of));
    }
    let body = |of: &Records| designs.get(&of.name).map(|design| (spec_of_body(specs, &of.name), design));
    let samples = |of: &Records| of.measured.signals.len() / of.measured.forces.samples;
    let measured = || records.iter().filter(|of| of.by == SignalSource::Measured).enumerate();
    for (n, of) in measured() {
        let own: Vec<&[f64]> = of.measured.signals.chunks(samples(of)).collect();
        let shared = |signals: &[f64]| signals.iter().any(|x| *x != 0.0) && own.contains(&signals);
        let others = measured().take(n).filter(|(_, other)| body(of).is_none() || body(of) != body(other));
        for (_, other) in others {
            if let Some(record) = other.measured.signals.chunks(samples(other)).position(shared) {
                let [own, other] = [of, other].map(file);
                let why = "two bodies cannot have the same signals";
                return usage!("{own}: contains record {record} of {other}: {why}");
            }
        }
    }
    Ok(())
}

/// Whether two bodies were recorded under the same forces.
fn same_forces(a: &[f64], b: &[f64]) -> bool {
    let scale = b.iter().fold(0.0f64, |most, f| most.max(f.abs()));
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-6 * scale)
}

/// Whether all networks trained without failure; prints the other outcomes.
fn all_trained(body: &BodyRecords) -> bool {
    let kinds = [
        ("measured", Some(&body.measured)),
        ("simulated", body.simulated.as_ref().map(|own| &own.1)),
        ("the twin's", body.twin.as_ref().map(|own| &own.1)),
    ];
    let mut well = true;
    for (kind, evaluated) in kinds {
        let outcomes = evaluated.iter().flat_map(|evaluated| evaluated.outcomes.iter().flatten());
        for outcome in outcomes.filter(|outcome| *outcome != "ok") {
            say!("{}, {kind} signals: the training of a network ended with {outcome}", body.name);
            well = false;
        }
    }
    well
}

fn write_parts(folder: &Path, comparison: &ComparableBodies) -> Result<(), Error> {
    let figures = comparison.figures();
    write_figures(folder, &figures)?;
    write(&folder.join("index.html"), comparison.html(&figures))?;
    write(&folder.join("table.csv"), comparison.table().csv())?;
    write(&folder.join("records.npz"), archive(comparison))
}

/// All data of each record as NumPy arrays.
fn archive(comparison: &ComparableBodies) -> Vec<u8> {
    let [panels, instants, channels] = comparison.shape;
    let mut zip = Zip::default();
    for BodyRecords { name, signals, measured, simulated, twin, .. } in &comparison.bodies {
        let n = measured.folds.len();
        let forces = [n, instants, panels];
        let folds: Vec<i64> = measured.folds.iter().map(|fold| *fold as i64).collect();
        zip.array(&format!("fold_{name}"), &[n], &folds);
        zip.array(&format!("forces_{name}"), &forces, &measured.targets);
        let kinds = [
            ("", Some((signals, measured))),
            ("simulated_", simulated.as_ref().map(|(signals, judged)| (signals, judged))),
            ("twin_", twin.as_ref().map(|(signals, judged)| (signals, judged))),
        ];
        for (prefix, kind) in kinds {
            let Some((signals, judged)) = kind else { continue };
            let errors: Vec<f64> = judged.errors.iter().flatten().map(|e| e.unwrap_or(f64::NAN)).collect();
            zip.array(&format!("{prefix}signals_{name}"), &[n, instants, channels], signals);
            zip.array(&format!("{prefix}predictions_{name}"), &forces, &judged.predictions);
            zip.array(&format!("{prefix}errors_{name}"), &[judged.errors.len(), n], &errors);
            if let Some(posterior) = &judged.posterior {
                zip.array(&format!("{prefix}forces_low_{name}"), &forces, &posterior.low);
                zip.array(&format!("{prefix}forces_high_{name}"), &forces, &posterior.high);
            }
        }
    }
    zip.finish()
}

/// Finished networks, or decoded parts, by body, kind of signals and number.
type Networks = BTreeMap<(String, String, usize), FoldEstimates>;

/// Stores finished networks; prints progress and the remaining time on standard error.
struct Progress<'a> {
    /// The unit of progress, such as "networks trained".
    what: &'static str,
    all: usize,
    unfinished: &'a Unfinished<Networks>,
    start: Instant,
    /// Number finished by an earlier process.
    before: usize,
    /// Finished networks, and the time of the last line.
    said: Mutex<(Networks, Instant)>,
}

impl<'a> Progress<'a> {
    fn new(what: &'static str, all: usize, unfinished: &'a Unfinished<Networks>, kept: Networks) -> Self {
        let (start, before) = (Instant::now(), kept.len());
        if before > 0 {
            say!("resumed: {before} of {all} {what}");
        }
        Self { what, all, unfinished, start, before, said: Mutex::new((kept, start)) }
    }
}

/// Progress for one body and one kind of signals.
struct BodyProgress<'a> {
    name: &'a str,
    kind: &'a str,
    of: &'a Progress<'a>,
}

impl BodyProgress<'_> {
    fn key(&self, number: usize) -> (String, String, usize) {
        (self.name.to_owned(), self.kind.to_owned(), number)
    }
}

impl NetworkStore for BodyProgress<'_> {
    fn network(&self, number: usize) -> Option<FoldEstimates> {
        self.of.said.lock().expect("no line panics").0.get(&self.key(number)).cloned()
    }

    fn store_network(&self, number: usize, network: &FoldEstimates) {
        let Self { name: body, kind, of: Progress { what, all, unfinished, start, before, said } } = self;
        let mut finished_networks = said.lock().expect("no line panics");
        finished_networks.0.insert(self.key(number), network.clone());
        unfinished.keep(&finished_networks.0);
        let (done, spent) = (finished_networks.0.len(), start.elapsed().as_secs_f64());
        if done == *all {
            say!("{} {what} in {}", all - before, duration(spent));
        } else if finished_networks.1.elapsed() >= LINE_EVERY {
            finished_networks.1 = Instant::now();
            let left = duration(spent * (all - done) as f64 / (done - before) as f64);
            say!("{done} of {all} {what}, now {body}, {kind} signals; {left} left");
        }
    }
}
