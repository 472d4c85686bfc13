//! The Python class `Body`: properties, feasible designs, stimuli and simulation.

use std::convert::Infallible;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use metasense::export::ligament::CastMaterial;
use metasense::plan::Plan;
use metasense::report::body::sketch;
use metasense_lab::prepare::{placed, prepared};
use metasense_lab::replay::drawing;
use metasense_lab::simulate::{forces, strike};
use metasense_numerics::body::Ligament;
use metasense_numerics::dynamics::{self, Forces, Parameters, Scene, tune};
use metasense_numerics::feasible::FeasibleSet;
use metasense_numerics::random::Purpose;
use metasense_numerics::trial::{Chip, Problem};
use metasense_schemas::spec::TrialSpec;
use metasense_source::Source;
use metasense_worker::design;
use numpy::{IntoPyArray, PyArray1, PyArray3, PyArrayMethods};
use pyo3::exceptions::{PyMemoryError, PyOSError, PyValueError};
use pyo3::prelude::*;

use crate::arrays::{NumericArray, indices, numbers, parse_integer, vector};
use crate::chosen::{Chosen, Pickled};
use crate::inverse::PyTwin;
use crate::simulation::{PyChips, PySimulation};
use crate::threads::{PerProcess, Threads, threads};
use crate::{chain, raised, unpickler};

/// The body of a trial: rigid units joined by ligaments, panels on which forces act, and sensors.
///
/// Lengths are in mm, forces in N, times in s, masses in Mg. Methods release the interpreter's lock and compute on the
/// body's own threads. Results are bit-identical for any number of threads.
#[pyclass(frozen, module = "metasense", name = "Body")]
pub struct PyBody {
    pub problem: Arc<Problem>,
    pub threads: Threads,
    hash: String,
    pub trial: TrialSpec,
    /// Per process: in a forked child, a mutex held by another thread is never released.
    feasible: PerProcess<Arc<Mutex<FeasibleSet>>>,
    tuned: Option<Chosen>,
    /// The sensors' chips, computed on demand; locked only while the interpreter's lock is held.
    chips: Arc<Mutex<Option<Chip>>>,
}

/// Rebuilds a body from its pickle.
#[pyfunction]
pub fn unpickle_body(
    py: Python<'_>,
    trial: &str,
    hash: String,
    threads: usize,
    tuned: Option<Pickled>,
) -> PyResult<PyBody> {
    let trial = serde_json::from_str(trial)
        .map_err(|e| PyValueError::new_err(format!("the pickle of a body of another version: {e}")))?;
    let tuned = tuned.map(Chosen::unpickled).transpose()?;
    py.detach(|| {
        let problem = prepared(&trial).map_err(|e| raised(&e))?;
        Ok(PyBody { tuned, ..PyBody::new(problem, Threads::new(threads)?, hash, trial) })
    })
}

impl PyBody {
    fn new(problem: Problem, threads: Threads, hash: String, trial: TrialSpec) -> Self {
        let feasible = PerProcess::new(Arc::new(Mutex::new(problem.castable())));
        let (problem, chips) = (Arc::new(problem), Arc::default());
        Self { problem, threads, hash, trial, feasible, tuned: None, chips }
    }

    fn of_plan(plan: &Plan, hash: Option<&str>, threads: usize) -> PyResult<Self> {
        let hash = hash.unwrap_or(&plan.trials[0].hash);
        let trial = plan.find(hash).map_err(|e| PyValueError::new_err(e.to_string()))?;
        let threads = Threads::new(threads)?;
        let pool = Python::attach(|py| threads.pool(py))?;
        let problem = placed(&trial.spec, &pool).map_err(|e| raised(&e))?;
        // contains the units that a search has chosen
        let trial_spec = TrialSpec { sensor_units: problem.scene.sensors.clone(), ..trial.spec.clone() };
        Ok(Self::new(problem, threads, trial.hash.clone(), trial_spec))
    }

    fn castable(&self, py: Python<'_>) -> Arc<Mutex<FeasibleSet>> {
        let make = || Ok::<_, Infallible>(Arc::new(Mutex::new(self.problem.castable())));
        self.feasible.get(py, make).unwrap_or_else(|never| match never {})
    }

    /// α from Python, of shape (n) or (n/2, 2).
    fn design(&self, what: &str, alpha: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
        let NumericArray { shape, values } = numbers(what, alpha)?;
        design::check(what, &shape, &values, self.problem.initial.len()).map_err(PyValueError::new_err)?;
        Ok(values)
    }

    /// As `design`; the initial design if `alpha` is omitted.
    pub fn design_or_initial(&self, alpha: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<f64>> {
        alpha.map_or_else(|| Ok(self.problem.initial.clone()), |alpha| self.design("alpha", alpha))
    }

    /// The scene with the material and sensors of a call.
    fn scene(&self, material: &Material<'_>, sensors: Option<&Bound<'_, PyAny>>) -> PyResult<Scene> {
        let mut scene = material.set(&self.problem.scene)?;
        if let Some(units) = sensors {
            let units = indices("sensors", units)?;
            scene.sensors =
                metasense_worker::problem::check_units("sensors", &units, &scene.layout, &scene.clamped)
                    .map_err(|e| PyValueError::new_err(e.to_string()))?;
        }
        if scene.sensors.is_empty() {
            return Err(PyValueError::new_err("sensors = []: must be at least one unit"));
        }
        Ok(scene)
    }

    /// The chips of a call's sensors with this seed, and a problem with these sensors.
    fn chips(&self, py: Python<'_>, scene: &Scene, seed: u64) -> PyResult<PyChips> {
        let (mut problem, pool) = (Arc::clone(&self.problem), self.threads.pool(py)?);
        let own = scene.sensors == problem.scene.sensors;
        if !own {
            Arc::make_mut(&mut problem).scene.sensors.clone_from(&scene.sensors);
        }
        let lock = || self.chips.lock().expect("no panic while it was held");
        let mut found = lock().clone().filter(|_| own);
        if found.is_none() {
            found = py.detach(|| problem.chips(&pool)).map_err(|e| raised(&e.into()))?;
            if own {
                lock().clone_from(&found);
            }
        }
        let remedy =
            "the spec's [sensors] describe no imperfection: set sensors.noise or leave noise_seed out";
        let chip = found.ok_or_else(|| PyValueError::new_err(format!("noise_seed = {seed}: {remedy}")))?;
        Ok(PyChips { problem, chip: chip.seeded(seed) })
    }

    /// Force histories `first` to `first + count` (exclusive) of a set.
    fn samples(&self, set: &str, first: usize, count: Option<usize>) -> PyResult<Forces> {
        let problem = &self.problem;
        let all = match set {
            "train" | "test" => {
                let [train, test] = problem.training_and_test();
                if set == "train" { train } else { test }
            }
            "holdout" => problem.forces(Purpose::Holdout, 0, problem.stimuli.holdout),
            "fresh" => {
                let count = count.ok_or_else(|| {
                    PyValueError::new_err("count must be given: the series of fresh samples is endless")
                })?;
                let one = problem.scene.panels.len() * (problem.scene.instants + 1);
                let room = Vec::<f64>::new().try_reserve_exact(count.saturating_mul(one));
                room.map_err(|e| PyMemoryError::new_err(format!("count = {count}: {e}")))?;
                return Ok(problem.forces(Purpose::Fresh, first as u64, count));
            }
            _ => {
                let remedy = "must be \"train\", \"test\", \"holdout\" or \"fresh\"";
                return Err(PyValueError::new_err(format!("set = {set:?}: {remedy}")));
            }
        };
        let most = all.samples.saturating_sub(first);
        let count = count.unwrap_or(most);
        if count > most || first > all.samples {
            let has = all.samples;
            return Err(PyValueError::new_err(format!(
                "first = {first}, count = {count}: the trial has {has} {set} samples"
            )));
        }
        Ok(all.select(&(first..first + count).collect::<Vec<usize>>()))
    }
}

/// File name in errors of specs from keywords.
const KEYWORDS: &str = "(keywords)";

/// Removes file name and line number, because keywords have no lines.
fn unplaced(said: &str) -> String {
    let bare = |line: &str| {
        let placed = line.strip_prefix(KEYWORDS).and_then(|rest| rest.strip_prefix(':')?.split_once(": "));
        placed
            .filter(|(at, _)| at.bytes().all(|b| b.is_ascii_digit()))
            .map_or(line, |(_, said)| said)
            .to_owned()
    };
    said.lines().map(bare).collect::<Vec<_>>().join("\n")
}

/// A path: text, bytes or `os.PathLike`.
pub fn path(given: &Bound<'_, PyAny>) -> PyResult<PathBuf> {
    given.py().import("os")?.call_method1("fsdecode", (given,))?.extract()
}

/// Plans the trials of a spec file with changes, each `KEY=VALUE`.
pub fn read_plan(spec: &Path, changes: &[String]) -> PyResult<Plan> {
    let text = metasense::files::read_spec(spec).map_err(|e| match e.kind() {
        ErrorKind::InvalidData => PyValueError::new_err(e.to_string()),
        _ => PyOSError::new_err(format!("cannot read {}: {e}", spec.display())),
    })?;
    let plan = Source::spec(spec, text, changes).and_then(Plan::of);
    plan.map_err(|e| PyValueError::new_err(chain(&e)))
}

/// Pickle: trial as JSON, hash, number of threads, solver.
type State = (String, String, usize, Option<Pickled>);

fn first(given: &Bound<'_, PyAny>) -> PyResult<usize> {
    Ok(parse_integer("first", given, 0..=u64::MAX)? as usize)
}

fn count(given: &Bound<'_, PyAny>) -> PyResult<Option<usize>> {
    match given.is_none() {
        true => Ok(None),
        false => Ok(Some(parse_integer("count", given, 0..=u64::MAX)? as usize)),
    }
}

/// Material of a call; `None`: the body's own value.
struct Material<'py> {
    stiffness: Option<Bound<'py, PyAny>>,
    damping_ratio: Option<f64>,
    density: Option<f64>,
}

impl Material<'_> {
    fn set(&self, scene: &Scene) -> PyResult<Scene> {
        let mut p = Parameters::of(scene);
        if let Some(given) = &self.stiffness {
            let given = vector("stiffness", given)?;
            let [stretch, shear, bend] = given[..] else {
                let remedy = "must be [stretch, shear, bend] (N/mm, N/mm, N·mm/rad)";
                return Err(PyValueError::new_err(format!("stiffness = {given:?}: {remedy}")));
            };
            (p.stretch, p.shear, p.bend) = (stretch, shear, bend);
        }
        p.damping_ratio = self.damping_ratio.unwrap_or(p.damping_ratio);
        p.density = self.density.unwrap_or(p.density);
        let above = [("stretch", p.stretch), ("shear", p.shear), ("bend", p.bend), ("density", p.density)];
        for (key, value) in above {
            if !(value > 0.0 && value.is_finite()) {
                return Err(PyValueError::new_err(format!("{key} = {value}: must be a number above 0")));
            }
        }
        if !(p.damping_ratio >= 0.0 && p.damping_ratio.is_finite()) {
            let value = p.damping_ratio;
            return Err(PyValueError::new_err(format!("damping_ratio = {value}: must be 0 or above")));
        }
        Ok(p.set(scene))
    }
}

#[pymethods]
impl PyBody {
    /// The body of a trial in a spec file. `hash`: the beginning of the trial's hash; default: the first trial.
    #[staticmethod]
    #[pyo3(signature = (spec, hash=None, *, threads=1))]
    fn from_spec(
        py: Python<'_>,
        #[pyo3(from_py_with = path)] spec: PathBuf,
        hash: Option<&str>,
        #[pyo3(from_py_with = threads)] threads: usize,
    ) -> PyResult<Self> {
        py.detach(|| Self::of_plan(&read_plan(&spec, &[])?, hash, threads))
    }

    /// The body of the first trial of a spec whose tables are the keywords of `metasense.body`, as JSON.
    #[staticmethod]
    fn _from_json(
        py: Python<'_>,
        json: &str,
        #[pyo3(from_py_with = threads)] threads: usize,
    ) -> PyResult<Self> {
        py.detach(|| {
            let tables: serde_json::Value =
                serde_json::from_str(json).map_err(|e| PyValueError::new_err(e.to_string()))?;
            let text = toml::to_string(&tables).map_err(|e| PyValueError::new_err(e.to_string()))?;
            let plan = Plan::new(KEYWORDS, text).map_err(|e| PyValueError::new_err(unplaced(&chain(&e))))?;
            Self::of_plan(&plan, None, threads)
        })
    }

    /// The trial's hash.
    #[getter]
    fn hash(&self) -> &str {
        &self.hash
    }

    /// The trial's seed.
    #[getter]
    fn seed(&self) -> u64 {
        self.problem.seed
    }

    /// α of the initial body, a copy.
    #[getter]
    fn alpha<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.problem.initial.clone().into_pyarray(py)
    }

    /// Number of units.
    #[getter]
    fn units(&self) -> usize {
        self.problem.scene.layout.units()
    }

    /// Units on which forces act, one per force.
    #[getter]
    fn panels(&self) -> Vec<usize> {
        self.problem.scene.panels.iter().map(|panel| panel.unit).collect()
    }

    /// Units that carry sensors.
    #[getter]
    fn sensors(&self) -> Vec<usize> {
        self.problem.scene.sensors.clone()
    }

    /// Units that are clamped.
    #[getter]
    fn clamped(&self) -> Vec<usize> {
        self.problem.scene.clamped.clone()
    }

    /// Duration of a sample (s).
    #[getter]
    fn duration(&self) -> f64 {
        self.problem.scene.duration
    }

    /// T, the number of instants of the signals: n·duration/T, n = 1…T.
    #[getter]
    pub fn instants(&self) -> usize {
        self.problem.scene.instants
    }

    /// Number of threads of the body.
    #[getter]
    fn threads(&self) -> usize {
        self.threads.count()
    }

    /// [stretch, shear, bend] of a ligament (N/mm, N/mm, N·mm/rad), a copy.
    #[getter]
    fn stiffness<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let k = self.problem.scene.stiffness;
        vec![k.stretch, k.shear, k.bend].into_pyarray(py)
    }

    /// Damping factor ζ, the same for all coordinates. With `body.damping`, a factor on that damping.
    #[getter]
    fn damping_ratio(&self) -> f64 {
        self.problem.scene.damping_ratio
    }

    /// Mass per area (Mg/mm²).
    #[getter]
    fn density(&self) -> f64 {
        self.problem.scene.density
    }

    /// Corners (units, nodes, 2) of all units (mm), counter-clockwise; default: the initial body. All units must have equally many.
    #[pyo3(signature = (alpha=None))]
    fn vertices<'py>(
        &self,
        py: Python<'py>,
        alpha: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let corners = self.problem.scene.layout.vertices(&self.design_or_initial(alpha)?);
        let (units, of_each) = (corners.len(), corners[0].len());
        if corners.iter().any(|unit| unit.len() != of_each) {
            return Err(PyValueError::new_err("units have different numbers of nodes: use polygons()"));
        }
        corners.concat().into_flattened().into_pyarray(py).reshape([units, of_each, 2])
    }

    /// As `vertices`, for any body: a list with the corners of each unit.
    #[pyo3(signature = (alpha=None))]
    fn polygons(&self, alpha: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Vec<[f64; 2]>>> {
        Ok(self.problem.scene.layout.vertices(&self.design_or_initial(alpha)?))
    }

    /// The ligaments as (unit, node, unit, node).
    #[getter]
    fn ligaments(&self) -> Vec<(usize, usize, usize, usize)> {
        let of = |l: &Ligament| (l.a.unit, l.a.node, l.b.unit, l.b.node);
        self.problem.scene.layout.ligaments.iter().map(of).collect()
    }

    /// The limits that `alpha` violates, as text; an empty list if `alpha` is feasible.
    fn violations(&self, py: Python<'_>, alpha: &Bound<'_, PyAny>) -> PyResult<Vec<String>> {
        let alpha = self.design("alpha", alpha)?;
        let feasible = self.castable(py);
        Ok(py.detach(|| {
            let feasible = feasible.lock().expect("no panic while it was held");
            feasible.violations(&alpha).iter().map(ToString::to_string).collect()
        }))
    }

    /// Whether `alpha` violates no limit.
    fn feasible(&self, py: Python<'_>, alpha: &Bound<'_, PyAny>) -> PyResult<bool> {
        Ok(self.violations(py, alpha)?.is_empty())
    }

    /// The feasible design nearest to `alpha`. If none is found, returns `previous`, which must be feasible; default: the
    /// initial design.
    #[pyo3(signature = (alpha, previous=None))]
    fn project<'py>(
        &self,
        py: Python<'py>,
        alpha: &Bound<'py, PyAny>,
        previous: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let target = self.design("alpha", alpha)?;
        let previous = previous.map(|previous| self.design("previous", previous)).transpose()?;
        let previous = previous.unwrap_or_else(|| self.problem.initial.clone());
        let feasible = self.castable(py);
        let found = py.detach(|| {
            let mut feasible = feasible.lock().expect("no panic while it was held");
            feasible.project(&previous, &target, None)
        });
        match found.status.is_feasible() {
            true => Ok(found.design.into_pyarray(py)),
            false => Err(PyValueError::new_err(
                "previous cannot be cast, and no castable design was found near alpha: see `violations`",
            )),
        }
    }

    /// Force histories (N, K, R + 1) (N) of the trial. `set`: "train", "test" or "holdout"; or "fresh", the unlimited series
    /// that trains the body. They exclude deviating blows (`stimuli.offset`, `angle`): `simulate` uses the panels'
    /// nominal points and directions.
    #[pyo3(signature = (set, first=0, count=None))]
    fn stimuli<'py>(
        &self,
        py: Python<'py>,
        set: &str,
        #[pyo3(from_py_with = first)] first: usize,
        #[pyo3(from_py_with = count)] count: Option<usize>,
    ) -> PyResult<Bound<'py, PyArray3<f64>>> {
        let Forces { samples, panels, instants, values, .. } =
            py.detach(|| self.samples(set, first, count))?;
        values.into_pyarray(py).reshape([samples, panels, instants + 1])
    }

    /// Returns the body with a fixed integrator, chosen on the first samples of `forces`, as in a trial. Otherwise each
    /// `simulate` chooses the integrator again, which costs as much as about ten samples.
    fn tuned(&self, py: Python<'_>, alpha: &Bound<'_, PyAny>, forces: &Bound<'_, PyAny>) -> PyResult<Self> {
        let design = self.design("alpha", alpha)?;
        let NumericArray { shape, values } = numbers("forces", forces)?;
        let problem = Arc::clone(&self.problem);
        let forces = self::forces(&problem.scene, &shape, values).map_err(|e| raised(&e))?;
        let pool = self.threads.pool(py)?;
        let found = py.detach(|| tune(&problem.scene, &design, &forces, &problem.solver, &pool));
        Ok(Self {
            threads: self.threads.clone(),
            hash: self.hash.clone(),
            trial: self.trial.clone(),
            feasible: PerProcess::new(Arc::new(Mutex::new(problem.castable()))),
            tuned: Some(Chosen { solver: found.solver, reason: found.plan.reason }),
            chips: Arc::clone(&self.chips),
            problem,
        })
    }

    /// Simulates the design under `forces` (N, K, R + 1) (N); R is a multiple of T.
    ///
    /// `sensors` (units, each with a chip of the spec's mass), `stiffness` ([stretch, shear, bend]), `damping_ratio` and `density`
    /// replace the body's own.
    ///
    /// Signals are ideal without `noise_seed`. With it, they are readings of the chips in the spec's `[sensors]`: only the
    /// `channels`, with low-pass, delay, noise, bias (mm/s², rad/s), resolution and range. Equal force histories have equal noise;
    /// `noise_seed=body.seed` gives the noise of the trial. For relative noise, the first call simulates the training samples.
    ///
    /// With `tape` the simulation can be differentiated; it stores 48 bytes per free unit, instant and sample.
    #[pyo3(signature = (alpha, forces, *, sensors=None, stiffness=None, damping_ratio=None, density=None, noise_seed=None, tape=true))]
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        alpha: &Bound<'py, PyAny>,
        forces: &Bound<'py, PyAny>,
        sensors: Option<&Bound<'py, PyAny>>,
        stiffness: Option<Bound<'py, PyAny>>,
        damping_ratio: Option<f64>,
        density: Option<f64>,
        noise_seed: Option<&Bound<'py, PyAny>>,
        tape: bool,
    ) -> PyResult<PySimulation> {
        let design = self.design("alpha", alpha)?;
        let NumericArray { shape, values } = numbers("forces", forces)?;
        let mut scene = self.scene(&Material { stiffness, damping_ratio, density }, sensors)?;
        let given = self::forces(&scene, &shape, values).map_err(|e| raised(&e))?;
        let (mut forces, pool) = (given.clone(), self.threads.pool(py)?);
        let seed = noise_seed.map(|seed| parse_integer("noise_seed", seed, 0..=u64::MAX)).transpose()?;
        let chips = seed.map(|seed| self.chips(py, &scene, seed)).transpose()?;
        if let Some(PyChips { problem, .. }) = &chips {
            let (fine, of_motion) = problem.in_motion(&scene, &given);
            (scene, forces) = (fine.into_owned(), of_motion.into_owned());
        }
        let (reason, run) = py.detach(|| match &self.tuned {
            None => {
                let (tuned, run) = strike(&scene, &design, &forces, &self.problem.solver, tape, &pool);
                (tuned.plan.reason, run)
            }
            Some(Chosen { solver, reason }) => {
                (reason.clone(), dynamics::simulate(&scene, &design, &forces, solver, tape, &pool))
            }
        });
        PySimulation::new(py, self.threads.clone(), scene, design, [given, forces], chips, reason, run)
    }

    /// Fits a twin to records of a cast: forces (N, K, R + 1) (N) and the chips' readings (N, T, C). `alpha`: the design of
    /// the cast; default: the initial one. The unknowns are the deviations in the spec's `variation`.
    #[pyo3(signature = (forces, signals, alpha=None))]
    fn twin(
        &self,
        py: Python<'_>,
        forces: &Bound<'_, PyAny>,
        signals: &Bound<'_, PyAny>,
        alpha: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<PyTwin> {
        PyTwin::fitted(py, self, self.design_or_initial(alpha)?, forces, signals)
    }

    /// Reads a twin (TOML from `metasense lab identify --out` or `Twin.save`). `alpha`: its design; default: the initial one.
    #[pyo3(signature = (file, alpha=None))]
    fn read_twin(&self, file: PathBuf, alpha: Option<&Bound<'_, PyAny>>) -> PyResult<PyTwin> {
        PyTwin::read(self, self.design_or_initial(alpha)?, file)
    }

    /// Draws the body as SVG; default: the initial body.
    #[pyo3(signature = (alpha=None))]
    fn draw(&self, alpha: Option<&Bound<'_, PyAny>>) -> PyResult<String> {
        let alpha = self.design_or_initial(alpha)?;
        let drawing = drawing(&self.trial, &alpha).map_err(|e| raised(&e))?;
        let cast = CastMaterial::new(&self.trial, &drawing, 1.0).map_err(|e| raised(&e))?;
        Ok(sketch(&drawing, &[]).file("a metamaterial body", cast.ligament.width))
    }

    /// A pickle contains the trial's settings; the process that reads it rebuilds the body with its own threads.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, State)> {
        let trial = serde_json::to_string(&self.trial).expect("a trial is JSON");
        let tuned = self.tuned.as_ref().map(Chosen::pickled);
        Ok((unpickler(py, "unpickle_body")?, (trial, self.hash.clone(), self.threads.count(), tuned)))
    }

    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    fn _repr_svg_(&self) -> PyResult<String> {
        self.draw(None)
    }

    fn __repr__(&self) -> String {
        let scene = &self.problem.scene;
        let (units, panels, sensors) = (scene.layout.units(), scene.panels.len(), scene.sensors.len());
        let alpha = self.problem.initial.len();
        format!("<metasense.Body {}: {units} units, α of {alpha}, K = {panels}, M = {sensors}>", self.hash)
    }
}
