//! Memory and nonlinearity of a trial's bodies under long random drives of the first panel.

use metasense_numerics::dynamics::{Forces, Scene};
use metasense_numerics::place::placed;
use metasense_numerics::random::{Purpose, Stream};
use metasense_numerics::trial::{PreparedTrial, check_outcomes, simulated};
use metasense_schemas::spec::TrialSpec;
use metasense_worker::run::{NoResult, pool};

use crate::modes::natural_frequencies;
use crate::prepare::{prepared, simulable};
pub use crate::questions::capacity::Measure;
use crate::questions::capacity::{WASHOUT, measures};

/// Number of drives.
const DRIVES: usize = 16;
/// Holds of a drive.
const HOLDS: usize = WASHOUT + 500;
/// Most instants of a hold at which the state is read (virtual nodes, Appeltant et al. 2011, doi:10.1038/ncomms1476).
const NODES: usize = 8;
/// Most state variables, if there are several per channel.
const VARIABLES_MAX: usize = DRIVES * (HOLDS - WASHOUT) / 10;

/// Instants of a hold: those nearest to a quarter of the period of the initial body's first natural frequency, 1 … 50.
///
/// # Errors
/// If the spec is invalid, or the body has no modes.
pub fn hold(trial: &TrialSpec) -> Result<usize, NoResult> {
    let (first, scene) = (natural_frequencies(trial)?.first, prepared(trial)?.scene);
    let instants = scene.instants as f64 / (4.0 * first * scene.duration);
    Ok((instants.round() as usize).clamp(1, 50))
}

/// Measures of a body whose first panel receives a force that is constant for `hold` instants, uniform between ± the largest force of
/// the training samples; other panels are silent. The state consists of the readings at up to eight equidistant instants of a hold.
///
/// # Errors
/// If the spec is invalid, the design has the wrong length, or a simulation fails.
pub fn capacity(
    trial: &TrialSpec,
    design: &[f64],
    hold: usize,
    threads: usize,
) -> Result<Vec<Measure>, NoResult> {
    let pool = pool(threads)?;
    let (problem, _) = placed(&simulable(trial, design)?, &pool)?;
    let trial = PreparedTrial::new(&problem, &pool)?;
    let (problem, channels) = (&trial.problem, trial.scales.channels.len());
    let largest = trial.train.values.iter().fold(0.0f64, |most, f| most.max(f.abs()));
    let (inputs, forces) = drives(problem.seed, largest, problem.scene.panels.len(), hold);
    let duration = problem.scene.duration * forces.instants as f64 / problem.scene.instants as f64;
    let scene = Scene { duration, instants: forces.instants, ..problem.scene.clone() };
    let motion = simulated(problem, &scene, design, &forces, &trial.tuned(design).solver, false, &pool);
    check_outcomes(&motion.outcomes).map_err(|why| {
        let why = why.name();
        NoResult::Rejected(format!(
            "stimuli: random forces of ±{largest:.3} N cannot be simulated ({why}); reduce the largest forces"
        ))
    })?;
    let readings = trial.disturbed_signals(motion.signals, &forces);
    let nodes = hold.min(NODES).min(VARIABLES_MAX / channels).max(1);
    let states: Vec<f64> = readings
        .chunks_exact(hold * channels)
        .flat_map(|own| (1..=nodes).flat_map(move |i| &own[(i * hold / nodes - 1) * channels..][..channels]))
        .copied()
        .collect();
    Ok(measures(&inputs, &states, HOLDS))
}

/// Inputs (drives, holds) in [−1, 1], and the forces on all panels, `largest` (N) times the inputs on the first.
fn drives(seed: u64, largest: f64, panels: usize, hold: usize) -> (Vec<f64>, Forces) {
    let drive = |drive| {
        let mut stream = Stream::new(Purpose::Drive, seed, [drive, 0]);
        (0..HOLDS).map(move |_| stream.between([-1.0, 1.0]))
    };
    let inputs: Vec<f64> = (0..DRIVES as u64).flat_map(drive).collect();
    let instants = HOLDS * hold;
    let mut values = Vec::new();
    for own in inputs.chunks_exact(HOLDS) {
        values.push(0.0);
        values.extend(own.iter().flat_map(|u| vec![largest * u; hold]));
        values.resize(values.len() + (panels - 1) * (instants + 1), 0.0);
    }
    (inputs, Forces { samples: DRIVES, panels, instants, values, strikes: Vec::new() })
}

#[cfg(test)]
mod tests;
