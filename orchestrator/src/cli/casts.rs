//! `casts`: errors of decoders on virtual casts of a body.

use std::path::{Path, PathBuf};
use std::time::Instant;

use metasense_lab::casts::casts;
use metasense_schemas::record::CastRecord;
use metasense_schemas::spec::{Variation, VariationFile};
use metasense_source::Source;
use metasense_worker::problem::INVERTED_PER_CAST;

use super::named::Designed;
use super::{Error, Format, cores, print_rows};
use crate::analysis::numbers::quantile;
use crate::exit::Exit;
use crate::look::{Table, row, short_hash};

/// Computes the errors of decoders on virtual casts of a body
///
/// Each cast has its own material and node positions, drawn from `[variation]`. Linear decoders estimate the forces of its
/// held-out samples. `nominal` is fitted to the body as designed, `casts` to samples of 24 other casts, `records` to these
/// samples and to samples of the cast itself. The first casts are those of the trial's own comparison,
/// `v_cast`. A cast that cannot be simulated counts as 100 %.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    one: Designed,
    /// Number of casts
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u16).range(1..=10_000))]
    casts: u16,
    /// A TOML file with a [variation] table that replaces the trial's
    #[arg(long, value_name = "FILE")]
    variation: Option<PathBuf>,
    /// Prints one row per cast and decoder instead of medians
    #[arg(long, help_heading = "Output")]
    rows: bool,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    let (hash, trial, design) = args.one.read().await?;
    let variation = args.variation.as_deref().map(read_variation).transpose()?;
    let count = usize::from(args.casts);
    let mut said = Instant::now();
    let mut progress = |done: usize| {
        if said.elapsed().as_secs() >= SAY_EVERY {
            said = Instant::now();
            say!("{done} of {count} casts");
        }
    };
    let found = casts(&trial, &design, count, variation, cores(), &mut progress)
        .map_err(|e| args.one.trial.failed(e))?;
    let failed = found.iter().filter(|r| r.reader == "nominal" && r.outcome != "ok").count();
    let holdout = trial.stimuli.holdout;
    let table = if args.rows { row_per_cast(&found, holdout) } else { medians(&found, holdout) };
    print_rows(&table, args.format)?;
    say!("trial {}: {count} casts, {failed} of which failed", short_hash(&hash));
    Ok(Exit::Done)
}

fn read_variation(file: &Path) -> Result<Variation, Error> {
    let text = std::fs::read_to_string(file).map_err(Error::unreadable(file))?;
    Ok(Source::new(file, text)?.parse::<VariationFile>()?.variation)
}

/// Seconds between two lines of progress.
const SAY_EVERY: u64 = 10;

/// Number of held-out samples that a decoder estimates per cast.
fn samples(reader: &str, holdout: usize) -> usize {
    if matches!(reader, "inverse" | "twin") { holdout.min(INVERTED_PER_CAST) } else { holdout }
}

fn row_per_cast(found: &[CastRecord], holdout: usize) -> Table {
    let row = |r: &CastRecord| {
        let spread = r.spread.unwrap_or_default();
        let errors = row![r.error, spread.median, spread.p90, r.spread.map(|spread| spread.above)];
        let names = row![r.cast, &r.reader, r.records, samples(&r.reader, holdout)];
        [names, errors, row![r.ridge, r.share, &r.outcome]].concat()
    };
    let columns = "casting reader records samples error median p90 above ridge kappa outcome";
    Table::new(columns, found.iter().map(row))
}

/// Median, 90th percentile and worst error of each decoder over the casts.
fn medians(found: &[CastRecord], holdout: usize) -> Table {
    let brains = found.iter().take_while(|reading| reading.cast == 0);
    let rows = brains.map(|brain| {
        let own = || found.iter().filter(|r| (&r.reader, r.records) == (&brain.reader, brain.records));
        let above: u32 = own().filter_map(|r| Some(r.spread?.above)).sum();
        let mut errors: Vec<f64> = own().filter_map(|r| r.error).collect();
        errors.sort_by(f64::total_cmp);
        let [median, most] = [0.5, 0.9].map(|part| (!errors.is_empty()).then(|| quantile(&errors, part)));
        let samples = samples(&brain.reader, holdout);
        row![&brain.reader, brain.records, samples, median, most, errors.last(), above]
    });
    Table::new("reader records samples median percentile_90 worst above", rows)
}
