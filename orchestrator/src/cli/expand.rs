//! `expand`: lists the trials of a spec; starts nothing.

use std::collections::BTreeSet;

use metasense_lab::cost;
use metasense_lab::modes::{Natural, natural_frequencies};
use metasense_worker::problem::measures;
use metasense_worker::run::NoResult;
use metasense_worker::simd::name;
use serde_json::Value;

use super::named::Spec;
use super::point::values_at;
use super::simd::Simd;
use super::warnings::warn_of;
use super::{Error, Format, print_rows};
use crate::cell::{brief, plain};
use crate::cluster::{Assignment, Shard};
use crate::exit::Exit;
use crate::export::ligament::impossible;
use crate::look::{Table, number, row};
use crate::plan::{PlannedTrial, counted};

/// Lists the trials of a spec with hash, size and estimated cost; starts nothing
///
/// Also prints mass and natural frequencies of the initial bodies, and warns if these values are
/// implausible.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    spec: Spec,
    /// Lists only the trials of shard I of N, as `cluster submit` would assign them now
    #[arg(long, value_name = "I/N", help_heading = "Shards")]
    shard: Option<Shard>,
    #[command(flatten)]
    simd: Simd,
    /// Format of the rows
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

pub(super) async fn execute(args: Args) -> Result<Exit, Error> {
    args.simd.choose()?;
    let mut plan = args.spec.plan()?;
    plan.check_memory()?;
    if let Some(shard) = args.shard {
        Assignment::new(&plan.trials, shard.count()).restrict(shard, &mut plan);
    }
    let axes = plan.spec.sweep.keys();
    let named = "hash panels sensors placement seed units panel_units sensor_units design_parameters \
        brain_parameters cost_seconds";
    let columns = std::iter::once(named).chain(axes.iter().copied()).collect::<Vec<_>>().join(" ");
    let text = if args.format == Format::Table { brief } else { plain };
    let table = Table::new(&columns, plan.trials.iter().map(|trial| row(trial, &axes, text)));
    print_rows(&table, args.format)?;
    let total = cost::total(&plan.trials);
    let most = if plan.spec.until.is_some() { "at most " } else { "" };
    let (trials, time) = (counted(plan.trials.len(), "trial"), super::duration(total));
    say!("{most}{trials}, about {time} on one core with {}", name());
    warn_of(&plan);
    say_bodies(&plan.trials);
    Ok(Exit::Done)
}

/// Maximum number of bodies whose mass and frequencies are computed.
const BODIES: usize = 8;
/// Units of a body above which its frequencies are not computed.
const FREQUENCY_UNITS: usize = 1000;
/// Oscillations of the first mode per sample below which a warning is printed.
const LEAST_OSCILLATIONS: f64 = 0.1;
/// Mass (g) above which a warning is printed.
const MOST_GRAMS: f64 = 1e5;

/// Prints mass and natural frequencies of the bodies, and warns if they are implausible.
fn say_bodies(trials: &[PlannedTrial]) {
    let mut known = BTreeSet::new();
    let body = |trial: &&PlannedTrial| {
        known.insert(serde_json::to_string(&trial.spec.body).expect("a body is JSON"))
    };
    let bodies: Vec<&PlannedTrial> = trials.iter().filter(body).take(BODIES).collect();
    if let Some(why) = bodies.iter().find_map(|trial| impossible(&trial.spec)) {
        say!("warning: {why}");
    }
    let mass = |trial: &&PlannedTrial| Some(measures(&trial.spec).ok()?[0]).filter(|m| m.is_finite());
    let grams: Vec<f64> = bodies.iter().filter_map(mass).collect();
    let (small, large): (Vec<_>, Vec<_>) = bodies.iter().copied().partition(|t| t.units <= FREQUENCY_UNITS);
    let (mut found, mut missing): (Vec<(&PlannedTrial, Natural)>, _) = (Vec::new(), None);
    for trial in small {
        match natural_frequencies(&trial.spec) {
            Ok(natural) => found.push((trial, natural)),
            // a body without small motions about rest
            Err(NoResult::Rejected(why)) => missing = missing.or(Some(why)),
            Err(_) => {}
        }
    }
    let range = |values: &[f64]| {
        let [least, most] = [f64::min, f64::max].map(|pick| values.iter().copied().reduce(pick));
        let [least, most] = [least, most].map(|x| number(x.unwrap_or(0.0)));
        if least == most { least } else { format!("{least} to {most}") }
    };
    if grams.is_empty() {
        return;
    }
    if let Some(why) = missing {
        say!("no natural frequencies: {why}");
    }
    if !large.is_empty() {
        say!(
            "natural frequencies are not computed for bodies of more than {FREQUENCY_UNITS} units; `metasense body modes` does"
        );
    }
    let of: [fn(&Natural) -> f64; 3] = [|found| found.first, |found| found.damping, |found| found.highest];
    let ranges = of.map(|of| range(&found.iter().map(|(_, natural)| of(natural)).collect::<Vec<_>>()));
    let [first, damping, highest] = ranges;
    let frequencies = match found.is_empty() {
        true => String::new(),
        false => {
            format!(", first natural frequency {first} Hz (damping ratio {damping}), highest {highest} Hz")
        }
    };
    let some = if bodies.len() == BODIES { format!(" (the first {BODIES} bodies)") } else { String::new() };
    say!("mass of a body {} g{frequencies}{some}", range(&grams));
    let check = "check body.density (Mg/mm²), body.stiffness (N/mm) and time.duration (s)";
    if grams.iter().any(|grams| *grams > MOST_GRAMS) {
        say!("warning: a body of more than {} kg: {check}", MOST_GRAMS / 1e3);
    }
    let oscillations = |(trial, natural): &(&PlannedTrial, Natural)| natural.first * trial.spec.time.duration;
    if let Some(slow) = found.iter().find(|of| oscillations(of) < LEAST_OSCILLATIONS) {
        let s = slow.0.spec.time.duration;
        let [hz, count] = [slow.1.first, oscillations(slow)].map(number);
        say!("warning: at {hz} Hz the slowest mode makes {count} oscillations in a sample of {s} s: {check}");
    }
    let rate = |trial: &PlannedTrial| trial.spec.time.samples as f64 / trial.spec.time.duration;
    if let Some((trial, natural)) = found.iter().find(|(trial, natural)| natural.first > rate(trial)) {
        let [hz, rate] = [natural.first, rate(trial)].map(number);
        say!(
            "warning: even the slowest mode, {hz} Hz, is faster than the signals' {rate} samples per second: {check}"
        );
    }
}

fn row(trial: &PlannedTrial, axes: &BTreeSet<&str>, text: fn(&Value) -> String) -> Vec<Value> {
    let PlannedTrial { hash, spec, units, design_parameters, brain_parameters, .. } = trial;
    let point = spec.point;
    // two significant digits
    let cost: f64 = format!("{:.1e}", trial.seconds()).parse().expect("a number");
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
        cost
    ];
    if !axes.is_empty() {
        let spec = serde_json::to_value(spec).expect("a trial is JSON");
        row.extend(values_at(&spec, axes, text));
    }
    row
}
