//! `expand`: the trials that a spec stands for; starts nothing.

use std::collections::BTreeSet;
use std::path::PathBuf;

use metasense_worker::simd::name;
use serde_json::Value;

use super::named::Spec;
use super::simd::Simd;
use super::{Error, Format, print_rows};
use crate::cluster::{Assignment, Shard};
use crate::exit::Exit;
use crate::look::{Table, row};
use crate::plan::{Trial, cost, counted};

/// Lists the trials of a spec with hash, size and estimated cost; starts nothing
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    spec: Spec,
    /// Only those of shard I of N
    #[arg(long, value_name = "I/N", help_heading = "Shards")]
    shard: Option<Shard>,
    /// The folder of the shards, with their assignment; without it, the assignment that `cluster submit` would make now
    #[arg(long, value_name = "DIR", requires = "shard", help_heading = "Shards")]
    folder: Option<PathBuf>,
    #[command(flatten)]
    simd: Simd,
    /// The form of the rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    args.simd.choose()?;
    let mut plan = args.spec.plan()?;
    plan.check_memory()?;
    if let Some(shard) = args.shard {
        let assignment = match &args.folder {
            Some(folder) if !folder.is_dir() => {
                return Err(Error::Usage(format!("--folder {}: there is no such folder", folder.display())));
            }
            Some(folder) => Assignment::in_folder(folder, &plan.trials, shard.count())?,
            None => Assignment::new(&plan.trials, shard.count()),
        };
        assignment.restrict(shard, &mut plan);
    }
    let sweep = &plan.spec.sweep;
    let linked = sweep.points.iter().flat_map(|point| point.keys()).filter(|key| key.contains('.'));
    let axes: BTreeSet<&String> = sweep.axes.keys().chain(linked).collect();
    let axes: Vec<&String> = axes.into_iter().collect();
    let named = "hash panels sensors placement seed units panel_units sensor_units design_parameters \
        brain_parameters cost_seconds";
    let columns = [named, &axes.iter().map(|axis| axis.as_str()).collect::<Vec<_>>().join(" ")].join(" ");
    let mut table = Table::new(&columns, plan.trials.iter().map(|trial| row(trial, &axes)));
    if args.format == Format::Table {
        table.rows.iter_mut().flatten().for_each(shorten);
    }
    print_rows(&table, args.format)?;
    let total = cost::total(&plan.trials);
    let most = if plan.spec.until.is_some() { "at most " } else { "" };
    let (trials, time) = (counted(plan.trials.len(), "trial"), super::duration(total));
    say!("{most}{trials}, about {time} on one core with {}", name());
    Ok(Exit::Done)
}

/// Characters of a cell that is read; a mixture of forces has hundreds.
const WIDEST: usize = 48;

fn shorten(cell: &mut Value) {
    if let Value::String(text) = cell
        && let Some((end, _)) = text.char_indices().nth(WIDEST)
    {
        text.truncate(end);
        text.push('…');
    }
}

/// Two digits: more is not known.
fn rounded(cost: f64) -> f64 {
    format!("{cost:.1e}").parse().expect("a number")
}

fn row(trial: &Trial, axes: &[&String]) -> Vec<Value> {
    let Trial { hash, spec, units, design_parameters, brain_parameters, .. } = trial;
    let point = spec.point;
    let list = |units: &[usize]| units.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ");
    let mut row = row![
        hash,
        point.panels,
        point.sensors,
        point.placement,
        point.seed,
        units,
        list(&spec.panel_units),
        list(&spec.sensor_units),
        design_parameters,
        brain_parameters,
        rounded(trial.seconds())
    ];
    if !axes.is_empty() {
        let spec = serde_json::to_value(spec).expect("a trial is JSON");
        row.extend(axes.iter().map(|path| {
            spec.pointer(&format!("/{}", path.replace('.', "/"))).cloned().map_or(Value::Null, |v| match v {
                Value::Array(_) | Value::Object(_) => Value::from(v.to_string()),
                scalar => scalar,
            })
        }));
    }
    row
}
