//! `modes`: eigenmodes of a body at rest, and responses to forces on its panels.

use std::path::PathBuf;

use metasense_lab::modes::{FrequencyResponse, responses, slowest};

use super::named::Designed;
use super::{Error, Format, print_rows, write};
use crate::exit::Exit;
use crate::look::{Table, file, row};
use crate::report::modes as pictures;

/// Computes a body's eigenmodes at rest, or the response of a unit to a panel's force
///
/// Valid for small motions only: the stimuli of a sweep cause strongly nonlinear motion (`v_trial` contains the error of
/// the linear model). Modes are proportional to exp(s t) with complex s: the frequency is |s|/2π, the damping ratio −Re
/// s/|s|. A mode with damping ratio 1 does not oscillate; a mode with damping ratio 0 has no decay time.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    one: Designed,
    /// Number of modes, the slowest first
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u16).range(1..=1000))]
    count: u16,
    /// Instead of the modes, prints acceleration (mm/s²) and angular velocity (rad/s) of this unit under 1 N on each panel,
    /// as amplitudes and phases (degrees), at 200 frequencies up to that of the last mode
    #[arg(long, value_name = "UNIT")]
    response: Option<usize>,
    /// Draws the shapes of the modes, or the responses
    #[arg(long, value_name = "FILE.svg", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

/// Number of frequencies of a response.
const FREQUENCIES: usize = 200;

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let (_, spec, design) = &args.one.read().await?;
    let modes = slowest(spec, design, args.count.into()).map_err(|e| args.one.trial.failed(e))?;
    let (table, columns, (drawn, legend)) = match args.response {
        None => {
            let rows = modes.iter().enumerate().map(|(n, mode)| pictures::row(n, mode));
            let drawn = pictures::shapes(spec, design, &modes).map_err(|e| args.one.trial.failed(e))?;
            (Table::new(pictures::COLUMNS, rows), modes.len().clamp(1, 4), drawn)
        }
        Some(unit) => {
            let last = modes.last().map_or(0.0, metasense_lab::modes::Mode::frequency);
            let frequencies: Vec<f64> =
                (1..=FREQUENCIES).map(|i| last * i as f64 / FREQUENCIES as f64).collect();
            let found = responses(spec, design, unit, &frequencies)
                .map_err(|e| Error::Usage(format!("--response {unit}: {e}")))?;
            (table(&frequencies, &found), 1, pictures::responses(unit, &frequencies, &found))
        }
    };
    print_rows(&table, args.format)?;
    if let Some(out) = &args.out {
        write(out, file(&drawn, columns, 160.0 * columns.max(3) as f64, &legend))?;
        say!("written {}", out.display());
    }
    Ok(Exit::Done)
}

/// One row per frequency and panel.
fn table(frequencies: &[f64], found: &[Vec<FrequencyResponse>]) -> Table {
    let columns = "frequency panel a_x a_x_phase a_y a_y_phase omega omega_phase";
    let each = frequencies.iter().zip(found);
    let rows = each.flat_map(|(hertz, of)| of.iter().enumerate().map(move |of| (hertz, of)));
    let row = |(hertz, (panel, response)): (&f64, (usize, &FrequencyResponse))| {
        let parts = response.iter().flat_map(|c| row![c.norm(), c.arg().to_degrees()]);
        row![hertz, panel].into_iter().chain(parts).collect()
    };
    Table::new(columns, rows.map(row))
}
