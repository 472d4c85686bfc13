//! Validates a trial's spec and converts it to the types of the numerics crate.
//!
//! Degrees become radians; rules ("bottom") become unit lists. The plan calls this for every trial before any process starts, and a
//! worker calls it again for its trial.

use metasense_numerics::body::Layout;
use metasense_numerics::brain::linear::Lags;
use metasense_numerics::brain::{Architecture, LAYERS_MAX, Shape};
use metasense_numerics::brains::{RECORDS_MIN, SensingTask, Tasks, fits};
use metasense_numerics::dynamics::{
    AccelerationFrame, Accuracy, EdgeContact, Forces, Integrator, IntegratorSettings, LigamentStiffness,
    PartFactors, Scene, unwrapped_void,
};
use metasense_numerics::feasible::Limits;
use metasense_numerics::place::CANDIDATES;
use metasense_numerics::random::Purpose;
use metasense_numerics::trial::{
    BodyModel, Decoder, DecoderKind, FinalComparison, Normalisation, OuterLoop, Placing, Problem,
    RateSchedule, RidgeChoice, ScenePolygons, Training,
};
use metasense_schemas::spec::{self, SweepPoint, TrialSpec};
use std::sync::Arc;

mod body;
mod casts;
pub mod external;
mod material;
mod optimise;
mod size;
mod stimuli;

pub use crate::invalid::{Invalid, as_written};
use crate::invalid::{absent, at_least, invalid, not_negative, positive, require, within};
pub use body::{
    check_units, clamp, clamped, driven, guided, held, initial_design, layout, panel_units, panels,
};
pub use metasense_numerics::brains::READINGS_MAX;
pub use metasense_numerics::dynamics::Panel;
pub use metasense_numerics::material::{LigamentMaterial, shore_a};
pub use metasense_numerics::nested::INVERTED_PER_CAST;

use body::{build_panels, check_castable};
use casts::{casting, casts, variation};
pub use material::{material, sheet};
pub use optimise::{castable, design_parameters};
use optimise::{frozen, protocol, tie};
pub use size::scale_to_size;
use stimuli::{channels, disturbance, inertia, mount, stimuli, under};

/// Greatest number of instants per sample.
const INSTANTS_MAX: usize = 100_000;
/// Greatest duration of a sample (s).
const DURATION_MAX: f64 = 86_400.0;
/// Greatest number of samples per set or step, and of iterations of a network: more would exceed time and memory.
const SAMPLES_MAX: usize = 1_000_000;
const ITERATIONS_MAX: usize = 10_000_000;
/// Greatest number of channels and of weights of a network.
const WIDTH_MAX: usize = 1024;
const WEIGHTS_MAX: usize = 10_000_000;

/// The problem that the nested optimisation solves for this trial.
///
/// # Errors
/// Names the first key with an invalid value, and the requirement.
pub fn problem(trial: &TrialSpec) -> Result<Problem, Invalid> {
    let designed = trial.variation.is_none() && trial.optimise.objective.is_none();
    let remedy =
        "remove [variation] and optimise.objective: bodies are trained for this task as designed only";
    require(trial.brain.task.is_forces() || designed, "brain.task", as_written(&trial.brain.task), remedy)?;
    let OfBody { body, scene, limits, initial, relative_to } = match &trial.body.description {
        Some(description) => {
            check_clock_and_training(trial)?;
            external::parts(trial, description)?
        }
        None => parts(trial)?,
    };
    // what a body cannot do coarsely it does not do
    let coarsens = trial.body.description.as_ref().is_none_or(|description| description.tolerance);
    let (steps, coarse) = (trial.optimise.steps(), trial.optimise.clone().resolved().coarse);
    let mut problem = Problem {
        body,
        frozen: frozen(&trial.optimise, &scene.layout)?,
        tie: tie(&trial.optimise)?,
        initial,
        solver: solver(&trial.solver),
        limits,
        stimuli: stimuli(trial)?,
        channels: channels(&trial.sensors)?,
        disturbance: disturbance(&trial.sensors, &trial.time)?,
        relative_to,
        variation: variation(trial, scene.layout.units())?,
        decoder_kind: kind(trial.brain.kind),
        tasks: Tasks::default(),
        decoder: decoder(trial)?,
        brain: Training {
            iterations: trial.brain.iterations,
            rate: trial.brain.learning_rate,
            architecture: architecture(trial)?,
            scaling: scaling(trial)?,
        },
        optimise: OuterLoop {
            brain: if trial.optimise.linear() { DecoderKind::Linear } else { DecoderKind::Network },
            protocol: protocol(&trial.optimise)?,
            iterations: u32::try_from(steps)
                .map_err(|_| invalid("optimise.iterations", steps, "must be below 2^32"))?,
            rate: trial.optimise.clone().resolved().learning_rate.unwrap_or_default(),
            coarse: coarse.as_ref().filter(|_| coarsens).map(solver),
            casting: casting(trial)?,
        },
        evaluation: FinalComparison {
            seeds: trial.evaluation.networks(),
            schedule: match trial.evaluation.schedule {
                spec::Schedule::Cosine => RateSchedule::Cosine,
                spec::Schedule::Constant => RateSchedule::Constant,
            },
            batch: trial.evaluation.batch,
            long: trial.evaluation.long_iterations,
            casts: casts(trial)?,
            records: trial.evaluation.records.unwrap_or(true),
            initial: trial.evaluation.initial.unwrap_or(true),
            tasks: trial.evaluation.tasks == Some(true),
        },
        under: under(trial)?,
        seed: trial.point.seed,
        search: search(trial, &scene)?,
        scene,
    };
    problem.tasks = tasks(trial, &problem)?;
    if problem.evaluation.tasks {
        estimable(trial, &problem)?;
    }
    Ok(problem)
}

/// Checks that readouts of tasks can be fitted to the samples of a trial and tested.
///
/// # Errors
/// Names the key that must change.
pub fn estimable(trial: &TrialSpec, problem: &Problem) -> Result<(), Invalid> {
    let readable = fits(trial.time.samples, trial.signals());
    let remedy = "is too large for the linear decoder of the whole sample, which sensing tasks need: lower it, or use fewer sensors";
    require(readable, "time.samples", trial.time.samples, remedy)?;
    let [train, _] = problem.training_and_test();
    let remedy = "sensing tasks need ten samples with force for training (without stimuli.test): raise it, or lower stimuli.silent";
    require(with_force(&train) >= RECORDS_MIN, "stimuli.samples", trial.stimuli.samples, remedy)?;
    let remedy = "sensing tasks need ten held-out samples with force: raise it, or lower stimuli.silent";
    require(with_force(&problem.holdout()) >= RECORDS_MIN, "stimuli.holdout", trial.stimuli.holdout, remedy)
}

/// Why a trial without forces is refused.
pub const NO_FORCE: &str = "no training sample has a force; check stimuli.onset, stimuli.width and stimuli.amplitude against \
                                   time.duration and time.samples, or the clock and the scale of the records";
/// Greatest number of forces that the plan draws to find one that is not 0.
const DRAWN_MAX: usize = 10_000_000;

/// Whether a training sample of some seed has a force; true if this takes long to find out.
pub fn has_force(mut problem: Problem, seeds: &[u64]) -> bool {
    let mut left = DRAWN_MAX;
    for &seed in seeds {
        problem.seed = seed;
        for i in problem.stimuli.split(seed).0 {
            let forces = problem.forces(Purpose::Stimulus, i as u64, 1);
            match left.checked_sub(forces.values.len()) {
                Some(rest) if with_force(&forces) == 0 => left = rest,
                _ => return true,
            }
        }
    }
    false
}

/// Names of the tasks whose labels vary among the training samples of a trial.
///
/// # Errors
/// If the spec is invalid.
pub fn varied_tasks(trial: &TrialSpec) -> Result<Vec<&'static str>, Invalid> {
    Ok(problem(trial).map(|problem| varied(&problem))?.into_iter().map(|task| task.name().0).collect())
}

/// The tasks whose labels vary among the training samples.
fn varied(problem: &Problem) -> Vec<SensingTask> {
    let ([train, _], [parts, ..]) = (problem.training_and_test(), problem.parts());
    problem.labeller().varied(&problem.targets(&train), &parts, problem.scene.instants)
}

/// Number of samples with force.
fn with_force(forces: &Forces) -> usize {
    (0..forces.samples).filter(|&i| forces.sample(i).iter().any(|f| *f != 0.0)).count()
}

/// What readouts estimate.
fn tasks(trial: &TrialSpec, problem: &Problem) -> Result<Tasks, Invalid> {
    let window = window(trial)?;
    if trial.brain.task.is_forces() {
        return Ok(Tasks { window, ..Tasks::default() });
    }
    // none: all of them
    let task = SensingTask::ALL.into_iter().find(|task| task.name().0 == trial.brain.task.name());
    let check =
        |holds: bool, remedy: &str| require(holds, "brain.task", as_written(&trial.brain.task), remedy);
    let linear = trial.brain.kind == spec::BrainKind::Linear && trial.optimise.linear();
    check(linear, "set brain.kind = \"linear\": other decoders estimate forces only")?;
    let remedy = "set optimise.protocol = \"joint\" or \"random\": \"paper\" trains for forces only";
    check(trial.optimise.protocol != spec::Protocol::Paper, remedy)?;
    if let Some(batch) = trial.optimise.batch {
        at_least("optimise.batch", batch, RECORDS_MIN)?;
    }
    let contact = window.is_some() && task == Some(SensingTask::Onset);
    check(!contact, "the contact gives the onset: remove brain.window, or choose another task")?;
    let mut varied = varied(problem);
    varied.retain(|varied| match task {
        Some(task) => *varied == task,
        None => *varied != SensingTask::Kind && (window.is_none() || *varied != SensingTask::Onset),
    });
    let remedy = "the label is the same in all training samples: vary [stimuli] (stimuli.silent varies the number of struck \
                  panels, stimuli.kind = \"mix\" the kind), or choose another task; with brain.window, onsets do not count";
    check(!varied.is_empty(), remedy)?;
    at_least("stimuli.test", trial.stimuli.test, RECORDS_MIN)?;
    Ok(Tasks { trained: varied, window })
}

/// Number of instants of `brain.window`.
fn window(trial: &TrialSpec) -> Result<Option<usize>, Invalid> {
    let Some(window) = trial.brain.window else { return Ok(None) };
    let instants = (window * trial.time.samples as f64 / trial.time.duration).round();
    let holds = instants >= 1.0 && instants <= trial.time.samples as f64;
    let remedy =
        "must be at least one sampling interval (time.duration / time.samples) and at most time.duration";
    require(holds, "brain.window", window, remedy)?;
    Ok(Some(instants as usize))
}

/// The part of a problem that its body gives.
struct OfBody {
    body: Arc<dyn BodyModel>,
    scene: Scene,
    limits: Limits,
    initial: Vec<f64>,
    relative_to: Option<Vec<f64>>,
}

/// That of polygons.
fn parts(trial: &TrialSpec) -> Result<OfBody, Invalid> {
    let layout = layout(&trial.body)?;
    let material = material(&trial.body)?;
    check_clock_and_training(trial)?;
    let limits = limits(&trial.feasible)?;
    let initial = initial_design(&trial.body, &layout, limits)?;
    let relative_to = relative_to(trial, &layout, limits)?;
    check_castable(&trial.body, &layout, limits, &initial)?;
    let scene = scene(trial, layout, material)?;
    check_contact(&trial.body, &scene, &initial)?;
    Ok(OfBody { body: Arc::new(ScenePolygons), scene, limits, initial, relative_to })
}

/// Rejects a contact whose energy is infinite in the initial body.
fn check_contact(body: &spec::Body, scene: &Scene, initial: &[f64]) -> Result<(), Invalid> {
    let Some(contact) = body.contact.filter(|_| scene.imposed.is_empty()) else { return Ok(()) };
    let voids = scene.geometry(initial).void_angles(&scene.layout);
    let least = voids.into_iter().flatten().map(unwrapped_void).fold(f64::INFINITY, f64::min).to_degrees();
    let remedy = format!("must be below {least:.3} degrees, the least void angle of the initial body");
    require(contact.min_angle < least, "body.contact.min_angle", contact.min_angle, &remedy)
}

/// Design of the body to whose signals relative noise refers, if it is not the initial body.
fn relative_to(trial: &TrialSpec, layout: &Layout, limits: Limits) -> Result<Option<Vec<f64>>, Invalid> {
    let Some(design) = trial.sensors.relative_to.clone() else { return Ok(None) };
    let body = spec::Body { design: Some(design), ..trial.body.clone() };
    let named = |wrong: Invalid| Invalid { key: "sensors.relative_to".into(), ..wrong };
    initial_design(&body, layout, limits).map(Some).map_err(named)
}

/// Mass of units and chips (g) of the initial body, and the longer side of its bounding box (mm).
///
/// # Errors
/// As [`problem`].
pub fn measures(trial: &TrialSpec) -> Result<[f64; 2], Invalid> {
    external::polygons(&trial.body)?;
    let Problem { scene, initial, .. } = problem(trial)?;
    let units: f64 = scene.geometry(&initial).mass.iter().sum();
    let chips = trial.point.sensors as f64 * scene.chip.map_or(0.0, |chip| chip.mass);
    let at = |d: usize| scene.layout.vertices(&initial).into_iter().flatten().map(move |node| node[d]);
    let side = |d: usize| at(d).fold(f64::NEG_INFINITY, f64::max) - at(d).fold(f64::INFINITY, f64::min);
    Ok([1e6 * (units + chips), side(0).max(side(1))])
}

fn check_clock_and_training(trial: &TrialSpec) -> Result<(), Invalid> {
    let duration = trial.time.duration;
    positive("time.duration", duration)?;
    require(duration <= DURATION_MAX, "time.duration", duration, "must be at most 86400 s, a day")?;
    within("time.samples", trial.time.samples, 3, INSTANTS_MAX)?;
    check_tolerance("solver.tolerance", trial.solver.tolerance)?;
    if let Some(coarse) = &trial.optimise.coarse {
        check_tolerance("optimise.coarse.tolerance", coarse.tolerance)?;
    }
    within("brain.iterations", trial.brain.iterations, 1, ITERATIONS_MAX)?;
    positive("brain.learning_rate", trial.brain.learning_rate)?;
    positive("optimise.learning_rate", trial.optimise.clone().resolved().learning_rate.unwrap_or_default())?;
    within("evaluation.long_iterations", trial.evaluation.long_iterations.unwrap_or(1), 1, ITERATIONS_MAX)?;
    within("evaluation.batch", trial.evaluation.batch.unwrap_or(1), 1, SAMPLES_MAX)?;
    within("evaluation.seeds", trial.evaluation.networks(), 1, 1000)
}

/// Normalisation of the network's signals and forces. Extremes of the initial body cannot serve casts.
fn scaling(trial: &TrialSpec) -> Result<Normalisation, Invalid> {
    let extremes = trial.brain.scaling == spec::Scaling::MinMax;
    let casts = trial.variation.is_some() || trial.optimise.objective.is_some();
    let stacked = trial.brain.kind == spec::BrainKind::Stacked;
    let remedy = "must be \"rms\" with casts, an optimise.objective, or brain.kind = \"stacked\"";
    require(!(extremes && (casts || stacked)), "brain.scaling", "\"minmax\"", remedy)?;
    Ok(if extremes { Normalisation::Extremes } else { Normalisation::Rms })
}

/// The layers of the network.
pub fn architecture(trial: &TrialSpec) -> Result<Architecture, Invalid> {
    let spec::Network { width, kernels, dilations, causal } = trial.brain.network();
    let instants = trial.time.samples;
    within("brain.width", width, 1, WIDTH_MAX)?;
    let all = |key: &str, values: &[usize], holds: bool, remedy: &str| {
        require(holds, key, format!("{values:?}"), remedy)
    };
    let of_kernels = |holds: bool, remedy: &str| all("brain.kernels", &kernels, holds, remedy);
    let of_dilations = |holds: bool, remedy: &str| all("brain.dilations", &dilations, holds, remedy);
    let remedy = format!("must contain 2 to {LAYERS_MAX} layers, the output layer last");
    of_kernels((2..=LAYERS_MAX).contains(&kernels.len()), &remedy)?;
    let remedy = format!("must contain one number per entry of brain.kernels = {kernels:?}");
    of_dilations(dilations.len() == kernels.len(), &remedy)?;
    of_kernels(!kernels.contains(&0), "must be numbers of at least 1")?;
    of_dilations(!dilations.contains(&0), "must be numbers of at least 1")?;
    let remedy = "must be odd if brain.causal = false: an even kernel has no centre";
    of_kernels(causal || kernels.iter().all(|k| k % 2 == 1), remedy)?;
    for (layer, (kernel, dilation)) in kernels.iter().zip(&dilations).enumerate() {
        let reach = (kernel - 1).saturating_mul(*dilation) / if causal { 1 } else { 2 };
        let remedy = format!(
            "layer {} reaches over {reach} instants: must be less than time.samples = {instants}",
            layer + 1
        );
        let of = if *dilation > 1 { &of_dilations as &dyn Fn(_, &str) -> _ } else { &of_kernels };
        of(reach < instants, &remedy)?;
    }
    let architecture = Architecture::new(width, &kernels, &dilations, causal);
    let (inputs, outputs) = (trial.signals(), trial.point.panels);
    let weights = Shape { instants, inputs, outputs, architecture }.weights();
    let remedy = format!("gives {weights} weights with these kernels; the limit is {WEIGHTS_MAX}");
    require(weights <= WEIGHTS_MAX, "brain.width", width, &remedy)?;
    Ok(architecture)
}

fn check_tolerance(key: &str, tolerance: f64) -> Result<(), Invalid> {
    // below 1e-12, rounding errors dominate and more steps do not help
    require((1e-12..=0.5).contains(&tolerance), key, tolerance, "must lie in [1e-12, 0.5]")
}

fn solver(solver: &spec::Solver) -> IntegratorSettings {
    let method = match solver.method {
        spec::Method::Auto => Integrator::Auto,
        spec::Method::Tsit5 => Integrator::Tsit5,
        spec::Method::Leapfrog => Integrator::Leapfrog,
        spec::Method::Nystrom4 => Integrator::Nystrom4,
        spec::Method::Nystrom6 => Integrator::Nystrom6,
    };
    IntegratorSettings::new(method, Accuracy(solver.tolerance))
}

/// Greatest number of unknowns of a linear decoder: 3 GB and a minute per step.
const UNKNOWNS_MAX: usize = 20_000;

/// The numerics type of a decoder's kind.
pub fn kind(kind: spec::BrainKind) -> DecoderKind {
    match kind {
        spec::BrainKind::Cnn => DecoderKind::Network,
        spec::BrainKind::Linear => DecoderKind::Linear,
        spec::BrainKind::Stacked => DecoderKind::Stacked,
        spec::BrainKind::Inverse => DecoderKind::Inverse,
    }
}

/// The lags of a linear decoder with this memory (s); by default those of the whole sample.
pub fn lags(time: &spec::Time, memory: Option<[f64; 2]>) -> Lags {
    let Some(memory) = memory else { return Lags::whole(time.samples) };
    let [before, after] = memory.map(|s| (s / time.duration * time.samples as f64 + 1e-9) as usize);
    Lags { before, after }.within(time.samples)
}

/// Settings of the linear decoder.
fn decoder(trial: &TrialSpec) -> Result<Decoder, Invalid> {
    let duration = trial.time.duration;
    if let Some(memory) = trial.brain.memory {
        let sound = memory.iter().all(|s| (0.0..=duration).contains(s));
        let remedy = format!("must be two times from 0 to time.duration = {duration} (s): before, after");
        require(sound, "brain.memory", format!("{memory:?}"), &remedy)?;
    }
    let lags = lags(&trial.time, trial.brain.memory);
    if trial.brain.kind != spec::BrainKind::Cnn || trial.optimise.linear() {
        solvable(trial, lags)?;
    }
    let ridge = match trial.brain.ridge {
        None | Some(spec::Ridge::Auto(_)) => RidgeChoice::Auto,
        Some(spec::Ridge::Given(ridge)) => {
            not_negative("brain.ridge", ridge)?;
            RidgeChoice::Given(ridge)
        }
    };
    Ok(Decoder { lags, ridge })
}

/// Instants per sample at which the motion is computed: those of the readings, or more if chips filter.
pub fn instants(trial: &TrialSpec) -> usize {
    let readings = trial.time.samples;
    let interval = trial.time.duration / readings as f64;
    disturbance(&trial.sensors, &trial.time).ok().flatten().map_or(1, |d| d.clock(interval)) * readings
}

/// Checks that a linear decoder with these lags fits into memory.
pub fn solvable(trial: &TrialSpec, lags: Lags) -> Result<(), Invalid> {
    let (instants, channels) = (trial.time.samples, trial.signals());
    let readings = channels * instants;
    let remedy = format!(
        "gives a linear decoder {readings} readings per sample (time.samples × sensors.channels × sensors); the limit is {READINGS_MAX}"
    );
    require(fits(instants, channels), "sweep.sensors", trial.point.sensors, &remedy)?;
    let unknowns = lags.unknowns(channels);
    let remedy = format!(
        "gives {unknowns} unknowns per force, at most {UNKNOWNS_MAX} are allowed: use a shorter memory, fewer sensors \
         or fewer time.samples"
    );
    let shown = trial.brain.memory.map_or(String::new(), |memory| format!("{memory:?}"));
    require(unknowns <= UNKNOWNS_MAX, "brain.memory", shown, &remedy)
}

/// The limits of a feasible design (rad, mm).
///
/// # Errors
/// If an angle or a length is out of range.
pub fn limits(feasible: &spec::Feasible) -> Result<Limits, Invalid> {
    let angles = [
        ("feasible.min_block_angle", feasible.min_block_angle),
        ("feasible.max_block_angle", feasible.max_block_angle),
        ("feasible.min_void_angle", feasible.min_void_angle),
        ("feasible.min_ligament_angle", feasible.min_ligament_angle),
    ];
    for (key, angle) in angles {
        require((0.0..=180.0).contains(&angle), key, angle, "must lie between 0 and 180 degrees")?;
    }
    let (least, most) = (feasible.min_block_angle, feasible.max_block_angle);
    let average = "90 degrees, the average of the four angles of a unit";
    require(least < 90.0, "feasible.min_block_angle", least, &format!("must be below {average}"))?;
    require(most > 90.0, "feasible.max_block_angle", most, &format!("must be above {average}"))?;
    not_negative("feasible.min_edge", feasible.min_edge)?;
    not_negative("feasible.clearance", feasible.clearance)?;
    not_negative("feasible.ligament_clearance", feasible.ligament_clearance)?;
    Ok(Limits {
        enforced: feasible.limits,
        min_block_angle: feasible.min_block_angle.to_radians(),
        max_block_angle: feasible.max_block_angle.to_radians(),
        min_void_angle: feasible.min_void_angle.to_radians(),
        min_ligament_angle: feasible.min_ligament_angle.to_radians(),
        min_edge: feasible.min_edge,
        clearance: feasible.clearance,
        ligament_clearance: feasible.ligament_clearance,
    })
}

fn scene(
    trial: &TrialSpec,
    layout: Layout,
    (density, stiffness): (f64, LigamentStiffness),
) -> Result<Scene, Invalid> {
    let body = &trial.body;
    if layout.rigid.contains(&true) {
        let remedy = "must be left out for bodies with rigid units";
        require(body.contact.is_none(), "body.contact", "", remedy)?;
        let scattered = trial.variation.as_ref().and_then(|variation| variation.ligament_length);
        let none = scattered.unwrap_or(0.0) == 0.0;
        require(none, "variation.ligament_length", scattered.unwrap_or(0.0), remedy)?;
    }
    let clamped = clamped(body, &layout)?;
    let guided = guided(body, &layout)?;
    let panels = build_panels(trial, &layout, &clamped)?;
    for panel in panels.iter().filter(|panel| panel.moves.is_none()) {
        let [x, y] = panel.direction;
        let acts = [x, y, if panel.node.is_some() { 1.0 } else { panel.moment }];
        let is_immovable = |(unit, held): &(usize, [bool; 3])| {
            *unit == panel.unit && (0..3).all(|d| held[d] || acts[d] == 0.0)
        };
        let remedy = "fixes the only coordinate in which the force on this unit could move it";
        require(!guided.iter().any(is_immovable), "body.guides", panel.unit, remedy)?;
    }
    let remedy = format!("the layout has {} panels", panels.len());
    let found = panels.len() == trial.point.panels && !panels.is_empty();
    require(found, "sweep.panels", trial.point.panels, &remedy)?;
    let sensors = check_units("sensors.placements", &trial.sensor_units, &layout, &clamped)?;
    let searched = trial.sensors.search.is_some() && sensors.is_empty();
    let remedy = format!("the layout has {} free units to carry sensors", sensors.len());
    let found = searched || sensors.len() == trial.point.sensors && !sensors.is_empty();
    require(found, "sweep.sensors", trial.point.sensors, &remedy)?;
    let angle = f64::to_radians;
    let scene = Scene {
        density,
        stiffness,
        parts: PartFactors::default(),
        relaxation: None,
        damping_ratio: if body.damping.is_some() { 1.0 } else { body.damping_ratio },
        damping: body.damping,
        inertia: match body.inertia {
            spec::Inertia::Design => None,
            spec::Inertia::Initial => Some(layout.initial_design(angle(body.initial_angle))),
        },
        contact: body.contact.map(|c| EdgeContact {
            stiffness: c.stiffness,
            min_angle: angle(c.min_angle),
            cutoff_angle: angle(c.cutoff_angle),
        }),
        linearised: body.linearised,
        imposed: body::compression_shifts(body, &layout, &clamped, &guided)?,
        clamped,
        guided,
        panels,
        sensors,
        chip: inertia(&trial.sensors)?,
        mount: mount(&trial.sensors)?,
        frame: match trial.sensors.frame {
            spec::Frame::World => AccelerationFrame::World,
            spec::Frame::Body => AccelerationFrame::Body,
        },
        duration: trial.time.duration,
        instants: trial.time.samples,
        layout,
    };
    let pressed = !scene.imposed.is_empty();
    let shaken = scene.panels.iter().any(|panel| panel.base_acceleration().is_some());
    if (pressed || shaken) && scene.is_loose() {
        let remedy = "needs a body that cannot move as a whole: hold it with body.clamp and body.guides";
        return Err(match body.compression.filter(|_| pressed) {
            Some(parts) => invalid("body.compression", format!("{parts:?}"), remedy),
            None => invalid("body.panels", "base", remedy),
        });
    }
    Ok(scene)
}

/// The sensor search, if the trial needs one.
fn search(trial: &TrialSpec, scene: &Scene) -> Result<Option<Placing>, Invalid> {
    let spec::Sensors { search, from, spacing, .. } = &trial.sensors;
    if matches!(search, None | Some(spec::Search::Random)) {
        let remedy = "has no effect without sensors.search = \"greedy\"";
        absent("sensors.from", from.map(|from| as_written(&from)), remedy)?;
        absent("sensors.spacing", *spacing, remedy)?;
        return Ok(None);
    }
    let spacing = spacing.unwrap_or(0.0);
    not_negative("sensors.spacing", spacing)?;
    let inside = from.unwrap_or(spec::SearchFrom::Interior) == spec::SearchFrom::Interior;
    // a driven unit moves as prescribed, independently of the body
    let moves_as_prescribed = |unit: &usize| scene.clamped.contains(unit) || scene.is_driven(*unit);
    let may_carry = |unit: &usize| !(moves_as_prescribed(unit) || inside && !scene.layout.carriers[*unit]);
    let candidates: Vec<usize> = (0..scene.layout.units()).filter(may_carry).collect();
    let SweepPoint { sensors, placement, .. } = trial.point;
    let remedy =
        format!("the body has {} units on which sensors.search may place a sensor", candidates.len());
    require((1..=candidates.len()).contains(&sensors), "sweep.sensors", sensors, &remedy)?;
    require(placement < candidates.len(), "sweep.placements", placement + 1, &remedy)?;
    let of_best = format!(
        "must be at most {CANDIDATES}: the search starts each placement from a different one of its {CANDIDATES} best units"
    );
    require(placement < CANDIDATES, "sweep.placements", placement + 1, &of_best)?;
    // greedily, row by row: nearly the greatest possible number
    let mut spaced_units: Vec<usize> = Vec::new();
    for &unit in &candidates {
        if spaced_units.iter().all(|&other| scene.layout.are_apart(unit, other, spacing)) {
            spaced_units.push(unit);
        }
    }
    let remedy =
        format!("leaves room for {} sensors, but sweep.sensors contains {sensors}", spaced_units.len());
    require(sensors <= spaced_units.len(), "sensors.spacing", spacing, &remedy)?;
    let given = !trial.sensor_units.is_empty();
    Ok((!given).then_some(Placing { candidates, sensors, turn: placement, spacing }))
}

#[cfg(test)]
pub(crate) mod tests;
