//! A body that another program simulates. The worker sends requests as JSON lines; arrays are in shared memory.
//!
//! ```text
//! {"call": "apply", "memory": "/proc/self/fd/9", "alpha": [0, 168], "forces": [168, 32, 2, 201], "signals": [13032, 32, 200, 1, 3], …}
//! {"shape": [32, 200, 1, 3]}
//! ```
//! An array is its offset in the memory, in units of 8 bytes (one f64, little endian), followed by its shape. A worker keeps one
//! process, which ends when its standard input closes. Each call restarts a process that dies up to twice; calls have no state.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use metasense_numerics::body::Freedom;
use metasense_numerics::dynamics::{Forces, IntegratorSettings, Outcome, Scene, SimulationCounts};
use metasense_numerics::feasible::{Castable, LinearLimits, LinearRow, Projection, Status, distance};
use metasense_numerics::random::{Purpose, Stream};
use metasense_numerics::trial::{
    BodyFailure, BodyModel, BodyTape, Pilot, Problem, SimulationInput, SimulationOutput,
};
use metasense_numerics::{Heartbeat, Pool};
use metasense_schemas::reason::BodyFault;
use metasense_schemas::spec::{self, Description};
use serde_json::{Value, json};

mod process;

use process::{Array, Process};

/// Default of `body.time_limit` (s).
pub const TIME_LIMIT: f64 = 600.0;
/// Restarts of the process per call.
const RESTARTS: usize = 2;
/// Largest drawing that is stored with a result (bytes).
const DRAWING: usize = 1 << 20;

/// The process of this worker; it runs the command of the last call.
static PROCESS: Mutex<Option<Process>> = Mutex::new(None);
/// Total duration of all calls (ns).
static WAITED: AtomicU64 = AtomicU64::new(0);

/// Seconds that this worker has waited for external bodies; they count as its own computing time.
pub fn waited() -> f64 {
    WAITED.load(Ordering::Relaxed) as f64 * 1e-9
}

/// Ends the worker's external process, if any.
pub fn end() {
    *process() = None;
}

fn process() -> MutexGuard<'static, Option<Process>> {
    PROCESS.lock().unwrap_or_else(PoisonError::into_inner)
}

fn duration(time_limit: Option<f64>) -> Duration {
    Duration::from_secs_f64(time_limit.unwrap_or(TIME_LIMIT))
}

/// The kind of a fault.
pub(crate) fn named(fault: &BodyFailure) -> BodyFault {
    BodyFault::ALL.iter().find(|known| known.name() == fault.name).copied().unwrap_or(BodyFault::Invalid)
}

/// The description that a command's program returns, with the digest of description and source.
///
/// # Errors
/// If the program cannot be started, does not answer, or returns an invalid description.
pub fn describe(command: &[String], time_limit: Option<f64>) -> Result<Description, BodyFailure> {
    let mut process = process();
    Ok(Process::of(&mut process, command, duration(time_limit))?.description.clone())
}

/// Sensor placement number `p`: a random permutation of `sensors` places.
pub fn placement(sensors: usize, p: u64) -> Vec<usize> {
    Stream::new(Purpose::Placement, 0, [p, sensors as u64]).permutation(sensors)
}

/// Bounds and constraints of designs with `numbers` components.
pub fn limits(described: &Description, numbers: usize) -> LinearLimits {
    let row = |given: &spec::Constraint| LinearRow {
        terms: given.terms.clone(),
        least: given.least.unwrap_or(f64::NEG_INFINITY),
        most: given.most.unwrap_or(f64::INFINITY),
    };
    LinearLimits {
        lower: described.lower.clone().unwrap_or_else(|| vec![f64::NEG_INFINITY; numbers]),
        upper: described.upper.clone().unwrap_or_else(|| vec![f64::INFINITY; numbers]),
        rows: described.constraints.iter().map(row).collect(),
    }
}

/// A body that another program simulates.
#[derive(Debug, Clone)]
pub struct External(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    command: Vec<String>,
    limit: Duration,
    described: Description,
    fault: OnceLock<BodyFailure>,
    /// Whether repeatability has been checked.
    tried: AtomicBool,
}

/// Input of a simulation.
#[derive(Debug, Clone, Copy)]
pub struct SimulationRequest<'a> {
    /// Panels, sensors and clock.
    pub scene: &'a Scene,
    /// α, the design.
    pub design: &'a [f64],
    /// Forces; their clock is an integer multiple of the scene's.
    pub forces: &'a Forces,
    /// Requested relative error of the signals.
    pub tolerance: f64,
}

impl SimulationRequest<'_> {
    fn request(&self, call: &str) -> Value {
        let Self { scene, tolerance, .. } = self;
        let panels: Vec<usize> = scene.panels.iter().map(|panel| panel.unit).collect();
        let (sensors, duration) = (&scene.sensors, scene.duration);
        json!({ "call": call, "panels": panels, "sensors": sensors, "duration": duration, "tolerance": tolerance })
    }

    fn arrays(&self) -> Vec<Array<'_>> {
        let Self { design, forces, .. } = self;
        let shape = [forces.samples, forces.panels, forces.instants + 1];
        vec![Array::new("alpha", &[design.len()], design), Array::new("forces", &shape, &forces.values)]
    }
}

impl External {
    /// The body of a trial. The first call starts its process.
    pub fn new(body: &spec::Body, described: &Description) -> Self {
        Self(Arc::new(Shared {
            command: body.command.clone(),
            limit: duration(body.time_limit),
            described: described.clone(),
            fault: OnceLock::new(),
            tried: AtomicBool::new(false),
        }))
    }

    fn fault(&self, kind: BodyFault, what: &str) -> BodyFailure {
        BodyFailure { name: kind.name(), detail: format!("{}: {what}", self.0.command.join(" ")) }
    }

    /// Records and returns the first fault, which invalidates all results.
    fn failed(&self, fault: BodyFailure) -> BodyFailure {
        self.0.fault.get_or_init(|| fault).clone()
    }

    /// Calls the process, restarting it if it dies. Returns its answer and the output array.
    fn ask(
        &self,
        request: &Value,
        arrays: &[Array],
        output: (&str, &[usize]),
        heartbeat: &Heartbeat,
    ) -> Result<(Value, Vec<f64>), BodyFailure> {
        if let Some(fault) = self.failure() {
            return Err(fault);
        }
        let Shared { command, limit, described, .. } = &*self.0;
        let started = Instant::now();
        let mut kept = process();
        let mut once = || {
            let process = Process::of(&mut kept, command, *limit)?;
            if process.description.digest != described.digest {
                let what =
                    "its description or a text file of the command has changed since the trial was planned";
                return Err(self.fault(BodyFault::Changed, what));
            }
            // a process that closed its output may still run
            process.call(request, arrays, output, *limit, heartbeat).inspect_err(|_| *kept = None)
        };
        let mut found = once();
        for _ in 0..RESTARTS {
            if found.as_ref().is_err_and(|fault| fault.name == BodyFault::Died.name()) {
                found = once();
            }
        }
        if found.is_err() {
            *kept = None;
        }
        WAITED.fetch_add(started.elapsed().as_nanos() as u64, Ordering::Relaxed);
        found.map_err(|fault| self.failed(fault))
    }

    fn shape(&self, SimulationRequest { scene, forces, .. }: &SimulationRequest) -> [usize; 4] {
        [forces.samples, scene.instants, scene.sensors.len(), self.channels()]
    }

    /// Signals (N, T, M, C) of a design under forces.
    ///
    /// # Errors
    /// If the process fails; all later calls then fail, too.
    pub fn apply(
        &self,
        question: &SimulationRequest,
        heartbeat: &Heartbeat,
    ) -> Result<Vec<f64>, BodyFailure> {
        let (request, output) = (question.request("apply"), self.shape(question));
        Ok(self.ask(&request, &question.arrays(), ("signals", &output), heartbeat)?.1)
    }

    /// dL/dα from a cotangent on the signals.
    ///
    /// # Errors
    /// As `apply`.
    pub fn vjp(
        &self,
        question: &SimulationRequest,
        cotangent: &[f64],
        heartbeat: &Heartbeat,
    ) -> Result<Vec<f64>, BodyFailure> {
        let mut arrays = question.arrays();
        arrays.push(Array::new("cotangent", &self.shape(question), cotangent));
        let output = ("gradient", &[question.design.len()][..]);
        Ok(self.ask(&question.request("vjp"), &arrays, output, heartbeat)?.1)
    }

    /// The drawing of a design, as SVG.
    ///
    /// # Errors
    /// As `apply`, or if the answer contains no drawing.
    pub fn draw(&self, design: &[f64]) -> Result<String, BodyFailure> {
        let arrays = [Array::new("alpha", &[design.len()], design)];
        let (answer, _) = self.ask(&json!({ "call": "draw" }), &arrays, ("", &[]), &Heartbeat::default())?;
        let svg = answer["svg"].as_str().map(str::to_owned);
        svg.ok_or_else(|| self.fault(BodyFault::Invalid, "its answer to `draw` has no text `svg`"))
    }

    /// Checks that repeated calls return identical bits.
    ///
    /// # Errors
    /// As `apply`, or if a call returns other values.
    pub fn check_repeats(
        &self,
        question: &SimulationRequest,
        heartbeat: &Heartbeat,
    ) -> Result<(), BodyFailure> {
        let bits = |values: &[f64]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let signals = self.apply(question, heartbeat)?;
        let finite: Vec<f64> = signals.iter().map(|x| if x.is_finite() { *x } else { 0.0 }).collect();
        let vjp = || self.vjp(question, &finite, heartbeat);
        let again = bits(&self.apply(question, heartbeat)?) == bits(&signals);
        let same = [("apply", again), ("vjp", bits(&vjp()?) == bits(&vjp()?))];
        match same.iter().find(|(_, same)| !same) {
            None => Ok(()),
            Some((call, _)) => {
                let what =
                    format!("`{call}` returned other values when it was called again with the same arrays");
                Err(self.failed(self.fault(BodyFault::NotRepeatable, &what)))
            }
        }
    }
}

impl BodyModel for External {
    fn channels(&self) -> usize {
        self.0.described.channels.len()
    }

    /// Checks repeatability once per trial: without it, trials can be neither resumed nor compared.
    fn pilot(
        &self,
        scene: &Scene,
        design: &[f64],
        forces: &Forces,
        solver: &IntegratorSettings,
        pool: &Pool,
    ) -> Pilot {
        if !self.0.tried.swap(true, Ordering::Relaxed) {
            let question = SimulationRequest { scene, design, forces, tolerance: solver.accuracy.0 };
            // `failure` returns the fault
            let _ = self.check_repeats(&question, pool.heartbeat());
        }
        let Description { name, version, .. } = &self.0.described;
        let reason = format!("external body {name} {version}").trim_end().to_owned();
        Pilot { solver: *solver, reason, error: None, counters: SimulationCounts::default() }
    }

    fn simulate(&self, scene: &Scene, run: &SimulationInput, pool: &Pool) -> SimulationOutput {
        let SimulationInput { design, forces, solver, .. } = *run;
        let question = SimulationRequest { scene, design, forces, tolerance: solver.accuracy.0 };
        let one = scene.instants * scene.sensors.len() * self.channels();
        let found = self.apply(&question, pool.heartbeat());
        let mut signals = found.unwrap_or_else(|_| vec![f64::NAN; forces.samples * one]);
        let outcome = |sample: &mut [f64]| match sample.iter().all(|x| x.is_finite()) {
            true => Outcome::Ok,
            false => {
                sample.fill(0.0);
                Outcome::NonFinite
            }
        };
        let outcomes: Vec<Outcome> = signals.chunks_exact_mut(one).map(outcome).collect();
        let well: Vec<usize> =
            (0..forces.samples).filter(|i| run.keep_tape && outcomes[*i] == Outcome::Ok).collect();
        let (body, scene, design) = (self.clone(), scene.clone(), design.to_vec());
        let forces = forces.select(&well);
        let call = Call { body, scene, design, forces, tolerance: question.tolerance, well };
        SimulationOutput { signals, outcomes, counters: SimulationCounts::default(), tape: Box::new(call) }
    }

    fn freedom(&self, problem: &Problem) -> Freedom {
        Freedom::unconstrained(problem.initial.len())
    }

    fn castable(&self, problem: &Problem) -> Box<dyn Castable> {
        Box::new(Limits { body: self.clone(), linear: limits(&self.0.described, problem.initial.len()) })
    }

    fn svg(&self, design: &[f64]) -> Option<String> {
        let svg = self.0.described.draw.then(|| self.draw(design))?.ok()?;
        (svg.len() <= DRAWING).then_some(svg)
    }

    fn failure(&self) -> Option<BodyFailure> {
        self.0.fault.get().cloned()
    }
}

/// Input of a gradient: the process simulates the successful samples again.
struct Call {
    body: External,
    scene: Scene,
    design: Vec<f64>,
    forces: Forces,
    tolerance: f64,
    /// Numbers of the successful samples.
    well: Vec<usize>,
}

impl BodyTape for Call {
    fn vjp(&self, cotangent: &[f64], pool: &Pool) -> (Vec<f64>, SimulationCounts) {
        let Self { body, scene, design, forces, tolerance, well } = self;
        let one = scene.instants * scene.sensors.len() * body.channels();
        let mut own = Vec::with_capacity(well.len() * one);
        well.iter().for_each(|i| own.extend_from_slice(&cotangent[i * one..][..one]));
        let question = SimulationRequest { scene, design, forces, tolerance: *tolerance };
        let found = body.vjp(&question, &own, pool.heartbeat());
        (found.unwrap_or_else(|_| vec![f64::NAN; design.len()]), SimulationCounts::default())
    }
}

/// Feasible designs of an external body.
struct Limits {
    body: External,
    linear: LinearLimits,
}

impl Castable for Limits {
    fn project(&mut self, previous: &[f64], target: &[f64], weights: Option<&[f64]>) -> Projection {
        let found = self.linear.project(previous, target, weights);
        if !self.body.0.described.project || !matches!(found.status, Status::Untouched | Status::Projected) {
            return found;
        }
        let (request, design) = (json!({ "call": "project" }), &found.design);
        let (arrays, shape) = ([Array::new("alpha", &[design.len()], design)], [design.len()]);
        let asked = self.body.ask(&request, &arrays, ("projected", &shape), &Heartbeat::default());
        let Ok((_, design)) = asked else { return found };
        if !self.linear.hold(&design) {
            let status = if self.linear.hold(previous) { Status::Kept } else { Status::Infeasible };
            return Projection { design: previous.to_vec(), status, ..found };
        }
        let status = if design == target { Status::Untouched } else { Status::Projected };
        let distance = distance(&design, target);
        Projection { design, status, distance, ..found }
    }
}
