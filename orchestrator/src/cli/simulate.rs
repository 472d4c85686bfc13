//! `simulate`: simulates a body under the forces of an array; writes arrays.

use std::path::{Path, PathBuf};

use metasense_lab::prepare::finite;
use metasense_lab::simulate::{Simulated, simulate};
use metasense_worker::files::{self, Array};
use metasense_worker::run::keeps_error;

use super::named::Designed;
use super::{Error, Format, cores, make_folder, print_rows, write};
use crate::exit::Exit;
use crate::look::{Table, row};
use crate::store::npy_bytes;

/// Simulates a body under given forces: signals, motion, energies and a gradient
///
/// Writes signals.npy (N, T, 3M), displacements.npy and velocities.npy (N, T, units, 3), energies.npy (N, T) and, with
/// --cotangent, gradient.npy, in the units and orders of MODEL.md. Force evaluations are counted per sample, for the
/// simulation and for the gradient. The pilot that chooses the steps runs once before. Exit code 1 if a sample does not
/// reach its end.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    one: Designed,
    /// Force histories (N, K, T + 1) in N, as NPY; T may also be a multiple of the spec's value
    #[arg(long, value_name = "NPY")]
    forces: PathBuf,
    /// Also writes the gradient dα of Σ cotangent·signals; an NPY array with the shape of the signals
    #[arg(long, value_name = "NPY")]
    cotangent: Option<PathBuf>,
    /// The folder for the arrays; created if missing
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out_dir: PathBuf,
    /// Format of the rows: one per outcome in a table, else one per sample
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let (_, spec, design) = &args.one.read().await?;
    let (shape, forces) = array(&args.forces)?;
    let cotangent = args.cotangent.as_deref().map(array).transpose()?;
    let cotangent = cotangent.as_ref().map(|(shape, values)| (&shape[..], &values[..]));
    let found = simulate(spec, design, (&shape, &forces), cotangent, cores());
    let found = found.map_err(|e| args.one.trial.failed(e))?;

    let Simulated { shape: [samples, instants, units, sensors], .. } = found;
    make_folder(&args.out_dir)?;
    let write = |name: &str, shape: &[usize], values: &[f64]| {
        write(&args.out_dir.join(name), npy_bytes(shape, values))
    };
    write("signals.npy", &[samples, instants, 3 * sensors], &found.signals)?;
    write("displacements.npy", &[samples, instants, units, 3], &found.displacements)?;
    write("velocities.npy", &[samples, instants, units, 3], &found.velocities)?;
    write("energies.npy", &[samples, instants], &found.energies)?;
    if let Some(gradient) = &found.gradient {
        write("gradient.npy", &[gradient.len()], gradient)?;
    }
    print_rows(&table(&found, args.format != Format::Table), args.format)?;
    if !keeps_error(&found.solver)[0] {
        say!(
            "warning: no time step reaches solver.tolerance: signals depend on the steps; the column solver contains the remaining error"
        );
    }
    say!("the pilot that chose the steps took {} force evaluations", found.pilot_evaluations);
    Ok(if found.outcomes.iter().all(|o| *o == "ok") { Exit::Done } else { Exit::Failed })
}

/// One row per sample, or one per outcome with its number of samples and the first of them.
fn table(found: &Simulated, per_sample: bool) -> Table {
    let a_sample = found.force_evaluations / found.outcomes.len() as u64;
    let solver = &found.solver;
    if per_sample {
        let row = |(n, outcome)| row![n, outcome, a_sample, solver];
        let rows = found.outcomes.iter().enumerate().map(row);
        return Table::new("sample outcome force_evaluations solver", rows);
    }
    let mut met: Vec<(&str, usize, usize)> = Vec::new();
    for (n, &outcome) in found.outcomes.iter().enumerate() {
        match met.iter_mut().find(|(known, ..)| *known == outcome) {
            Some((_, samples, _)) => *samples += 1,
            None => met.push((outcome, 1, n)),
        }
    }
    let row = |(outcome, samples, first)| row![outcome, samples, first, a_sample, solver];
    let columns = "outcome samples first_sample force_evaluations_per_sample solver";
    Table::new(columns, met.into_iter().map(row))
}

/// Shape and values of an NPY file of finite numbers.
fn array(path: &Path) -> Result<(Vec<usize>, Vec<f64>), Error> {
    let bytes = files::read(path).map_err(Error::unreadable(path))?;
    let wrong = |what: String| Error::Usage(format!("{}: {what}", path.display()));
    let Array { shape, values } = files::array(&bytes).map_err(wrong)?;
    finite("the array", &values).map_err(|e| wrong(e.to_string()))?;
    Ok((shape, values))
}
